"""The tracker: time of a person-frame, and accuracy against the whole-sequence solve, in perspective, under swaps.

All models are trained without the subject of the test (rows marked `same subject` without the trial).
"""

from __future__ import annotations

import common

# isort: split
import resource
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from mocap_ros.base_poses import BasePoses, stature
from mocap_ros.config import Config, with_values
from mocap_ros.offline import reconstruct_sequence
from mocap_ros.people import Intrinsics, MotionKind, Person2D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracker import Tracker

Array = NDArray[np.float64]
NS = 1_000_000_000
CATEGORIES = ('walk', 'run', 'jump')
UNSEEN = (
    ('35_02', 'walk'),
    ('07_01', 'walk'),
    ('16_15', 'walk'),
    ('35_17', 'run'),
    ('09_01', 'run'),
    ('13_11', 'jump'),
)
SAME = (('35_02', 'walk'), ('35_17', 'run'))
mpl.use('Agg')
PICTURES = common.ROOT / 'docs' / 'img' / 'tracker'


@dataclass(frozen=True, eq=False)
class Run:
    """What the tracker said of a sequence of one person, NaN where nothing."""

    joints: Array
    std: Array
    filled: NDArray[np.bool_]
    milliseconds: Array
    kinds: list[MotionKind]
    tracker: Tracker


def intrinsics_of(view: common.View) -> Intrinsics:
    if 'camera_matrix' in view.sequence:
        return Intrinsics.from_matrix(view.sequence['camera_matrix'])
    width, height = (int(v) for v in view.sequence['image_size'])
    return Intrinsics.nominal(width, height, 1.0)


def people_of(views: Sequence[common.View], frame: int) -> list[Person2D]:
    return [
        Person2D(f'p{i}', CMU15.joints, k[:, :2].astype(float), k[:, 2].astype(float))
        for i, k in enumerate(v.sequence['keypoints'][frame] for v in views)
    ]


def track(view: common.View, models: Mapping[str, BasePoses], config: Config) -> Run:
    tracker, camera = Tracker(models, config), intrinsics_of(view)
    stamps = [round(t * NS) + 1 for t in view.sequence['timestamps']]
    joints = np.full(view.truth.shape, np.nan)
    std, filled = np.full(joints.shape[:2], np.nan), np.zeros(joints.shape[:2], bool)
    spent, kinds = [], []
    for frame, stamp in enumerate(stamps):
        begun = time.process_time()
        people = tracker.update(stamp, people_of([view], frame), camera)
        spent.append((time.process_time() - begun) * 1e3)
        kinds.append(people[0].motion.kind if people else MotionKind.UNKNOWN)
        if people:
            at = stamps.index(tracker.output_ns)
            joints[at], std[at], filled[at] = people[0].joints, people[0].std, people[0].filled
    return Run(joints, std, filled, np.array(spent), kinds, tracker)


def whole(view: common.View, models: Mapping[str, BasePoses], config: Config) -> Array:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return reconstruct_sequence(keypoints, CMU15.joints, times, intrinsics_of(view), models, config).joints


def models_for(trial: str, categories: Iterable[str]) -> dict[str, BasePoses]:
    return {c or 'all': common.trained(c, without_subjects=(trial[:2],)) for c in categories}


def cost(quick: bool) -> list[dict[str, Any]]:
    """Milliseconds of a person-frame; the median over frames, every part of an update included."""
    rows = []
    frames = 90 if quick else 240
    views = common.views('09_12', np.arange(10) * 36, frames=frames)
    models = models_for('09_12', (*CATEGORIES, ''))
    cases = [(2.0, 30, 1), (2.0, 30, 10), (2.0, 40, 1), (2.0, 40, 10)]
    if not quick:
        cases += [(1.0, 30, 1), (4.0, 30, 1), (2.0, 15, 1), (2.0, 30, 20)]
    for window, components, people in common.progress(cases, 'time'):
        config = with_values(Config(), {'tracker.window': window, 'tracker.components': components})
        tracker, camera = Tracker(models, config), intrinsics_of(views[0])
        spent = []
        for frame in range(views[0].frames):
            seen = people_of([views[i % 10] for i in range(people)], frame)
            begun = time.process_time()
            tracker.update(round(frame / 30 * NS) + 1, seen, camera)
            spent.append((time.process_time() - begun) * 1e3 / people)
        late = np.array(spent[len(spent) // 3 :])
        rows.append(
            {
                'window s': window,
                'K': components,
                'people': people,
                'median ms': float(np.median(late)),
                'mean ms': float(late.mean()),
                'p99 ms': float(np.percentile(late, 99)),
            }
        )
    return rows


def lags(quick: bool) -> list[dict[str, Any]]:
    """MPJPE of the tracker, mean over headings, and of the whole-sequence solve."""
    rows = []
    headings = (45, 180) if quick else common.HEADINGS
    for trial, category in common.progress(UNSEEN[::3] if quick else UNSEEN, 'lag'):
        known, auto = models_for(trial, (category,)), models_for(trial, (*CATEGORIES, ''))
        record: dict[str, Any] = {'trial': f'{trial} {category}'}
        views = common.views(trial, headings)
        late = [slice(min(v.frames // 2, 30), None) for v in views]
        offline = [whole(v, known, Config()) for v in views]
        record['whole'] = np.mean([error(v, p) for v, p in zip(views, offline, strict=True)])
        record['whole, after 1 s'] = np.mean(
            [error(v, p, s) for v, p, s in zip(views, offline, late, strict=True)]
        )
        for lag in (0.0,) if quick else (0.0, 0.1, 0.5):
            config = with_values(Config(), {'tracker.lag': lag})
            found = [track(v, known, config).joints for v in views]
            label = f'lag {lag:g} s'
            record[label] = np.mean([error(v, p) for v, p in zip(views, found, strict=True)])
            record[label + ', after 1 s'] = np.mean(
                [error(v, p, s) for v, p, s in zip(views, found, late, strict=True)]
            )
        record['lag 0, category unknown'] = np.mean([error(v, track(v, auto, Config()).joints) for v in views])
        rows.append(record)
    return rows


def error(view: common.View, joints: Array, frames: slice = slice(None), key: str = 'mpjpe_mm') -> float:
    """Over the frames that have an answer."""
    part = common.View(
        {**view.sequence, **{k: view.sequence[k][frames] for k in ('keypoints', 'timestamps', 'joints3d')}}
    )
    return float(common.score(part, joints[frames], CMU15.joints)[key])


def perspective(quick: bool) -> list[dict[str, Any]]:
    """Whole sequences near the camera: MPJPE under weak perspective and under perspective, same subject."""
    rows = []
    headings = (45, 180) if quick else common.HEADINGS
    cases: list[dict[str, Any]] = [{}, {'distance': 2.0}, {'distance': 3.0}, {'distance': 5.0}]
    cases.append({'distance': 3.0, 'offset': (0.8, 0.0)})
    for trial, category in SAME[:1] if quick else SAME:
        model = common.trained(category, only_subjects=(trial[:2],), without_trials=(trial,))
        for options in common.progress(cases, 'perspective'):
            record: dict[str, Any] = {'case': f'{trial} {options or "orthographic"}'}
            for label, on in (('weak perspective', False), ('perspective', True)):
                config = with_values(Config(), {'tracker.perspective': on})
                views = common.views(trial, headings, **options)
                record[label] = np.mean([error(v, whole(v, {'m': model}, config)) for v in views])
            rows.append(record)
    return rows


def metric(quick: bool) -> list[dict[str, Any]]:
    """Metres at 3 m, the true stature given, subject left out: whole sequence and tracker."""
    rows = []
    for trial, category in SAME[:1] if quick else SAME:
        truth = stature(common.capture()[0][trial] / 1e3, CMU15)
        config = with_values(Config(), {'tracker.body_height': truth})
        models = models_for(trial, (category,))
        views = common.views(trial, (45, 180) if quick else common.HEADINGS, distance=3.0)
        for label, answers in (
            ('whole', [whole(v, models, config) for v in views]),
            ('lag 0', [track(v, models, config).joints for v in views]),
        ):
            row: dict[str, Any] = {'case': f'{trial}, {label}'}
            for key in ('metric_mpjpe_mm', 'root_mm'):
                row[key] = np.mean([error(v, a, key=key) for v, a in zip(views, answers, strict=True)])
            rows.append(row)
    return rows


def swaps(quick: bool) -> dict[str, float]:
    """Left and right swapped in 10 % of the frames, bursts of up to 0.3 s: shares undone, and undone in error."""
    mirror = np.array(CMU15.mirror)
    undone = missed = wrong = right = 0
    trials = ('35_02', '35_17') if quick else ('35_02', '07_01', '16_15', '35_17', '09_12', '13_11')
    for trial in common.progress(trials, 'swaps'):
        models = models_for(trial, ('walk',))
        for view in common.views(trial, (0, 110) if quick else common.HEADINGS, frames=240, noise=0.01):
            rng = np.random.default_rng(int(view.heading))
            swapped = bursts(view.frames, 0.1, 9, rng)
            keypoints = view.sequence['keypoints'].copy()
            keypoints[swapped] = keypoints[swapped][:, mirror]
            disturbed = common.View({**view.sequence, 'keypoints': keypoints})
            tracker, camera, before = Tracker(models, Config()), intrinsics_of(view), 0
            for frame in range(view.frames):
                tracker.update(round(frame / 30 * NS) + 1, people_of([disturbed], frame), camera)
                said = tracker.swapped_frames > before
                before = tracker.swapped_frames
                undone += said and swapped[frame]
                missed += not said and swapped[frame]
                wrong += said and not swapped[frame]
                right += not said and not swapped[frame]
    return {'undone': undone / max(undone + missed, 1), 'false': wrong / max(wrong + right, 1)}


def bursts(frames: int, share: float, longest: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    out = np.zeros(frames, bool)
    for _ in range(100):
        if out.sum() >= share * frames:
            break
        length = int(rng.integers(1, longest + 1))
        start = int(rng.integers(1, max(frames - length, 2)))
        if not out[max(start - 3, 0) : start + length + 3].any():
            out[start : start + length] = True
    return out


def reliability(quick: bool) -> dict[str, Any]:
    """Share of true errors within the standard deviation, by its size, for seen and for hidden joints."""
    trials = (
        (('35_04', 'walk'),)
        if quick
        else (('35_04', 'walk'), ('16_32', 'walk'), ('09_12', 'walk'), ('16_35', 'run'))
    )
    trials = tuple((t, c) for t, c in trials if t in common.capture()[0])
    pairs: dict[str, list[Array]] = {'seen': [], 'hidden': []}
    for trial, _ in common.progress(trials, 'reliability'):
        models = models_for(trial, (*CATEGORIES, ''))
        for view in common.views(
            trial, (20, 200) if quick else (20, 65, 110, 155, 200, 245, 290), frames=90, noise=0.02
        ):
            limb = ('lelbow', 'lwrist') if view.heading < 180 else ('rknee', 'rankle')
            run = track(view.hiding(limb), models, Config())
            pose, truth = (p - p.mean(axis=1, keepdims=True) for p in (run.joints, view.truth))
            pose = pose * (pose * truth).sum() / (pose * pose).sum()
            wrong = np.linalg.norm(pose - truth, axis=-1)
            for label, chosen in (('seen', ~run.filled), ('hidden', run.filled)):
                pairs[label].append(np.stack([run.std[10:][chosen[10:]], wrong[10:][chosen[10:]]]))
    out: dict[str, Any] = {}
    for label, parts in pairs.items():
        std, wrong = np.concatenate(parts, axis=1)
        groups = np.array_split(np.argsort(std), 8)
        out[label] = {
            'within': float((wrong <= std).mean()),
            'std mm': [float(std[g].mean() * 1e3) for g in groups],
            'two thirds within mm': [float(np.quantile(wrong[g], 2 / 3) * 1e3) for g in groups],
        }
    return out


def draw_reliability(found: Mapping[str, Any]) -> None:
    figure, axes = plt.subplots(figsize=(4.5, 4), layout='constrained')
    for label, marker in (('seen', 'o'), ('hidden', 's')):
        axes.plot(
            found[label]['std mm'], found[label]['two thirds within mm'], marker=marker, label=f'{label} joints'
        )
    most = max(max(found[k]['two thirds within mm']) for k in found) * 1.05
    axes.plot([0, most], [0, most], color='0.6', linewidth=1, label='as said')
    axes.set(xlabel='standard deviation said, mm', ylabel='two thirds of true errors within, mm')
    axes.legend(frameon=False)
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / 'reliability.png', dpi=110)


def endurance(quick: bool) -> dict[str, float]:
    """People who come and go, gaps, swaps and garbage: memory, exceptions, and an output for every input."""
    minutes = 0.5 if quick else 30.0
    rng = np.random.default_rng(0)
    views = common.views('16_32', (0, 60, 120, 200), frames=120)
    tracker = Tracker(models_for('16_32', CATEGORIES), Config())
    camera = intrinsics_of(views[0])
    exceptions, peaks = 0, []
    frames = int(minutes * 60 * 3)  # at a tenth of the frames, which is ten times the speed
    for frame in common.progress(range(frames), 'endurance'):
        people = [p for i, p in enumerate(people_of(views, frame % 120)) if (frame // (40 + 17 * i)) % 3]
        if rng.random() < 0.1:
            people = [replace(p, points=p.points[list(CMU15.mirror)]) for p in people]
        if rng.random() < 0.05:
            wild = rng.normal(size=(15, 2)) * 10.0 ** rng.integers(-3, 6)
            people.append(Person2D('', CMU15.joints, wild, rng.random(15)))
        stamp = round((frame / 30 + rng.uniform(0, 0.02)) * NS) + 1
        try:
            tracker.update(stamp, people, camera)
        except Exception:
            exceptions += 1
        if frame % max(frames // 8, 1) == 0:
            peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return {'frames': frames, 'exceptions': exceptions, 'MB after 1/8': peaks[1], 'MB at the end': peaks[-1]}


def switching() -> dict[str, Any]:
    """A walk, a jump and a walk, spliced: when the live answer changes."""
    motion, _ = common.capture()
    parts = [motion['16_32'][:150], motion['13_11'][:150], motion['16_32'][:150]]
    parts = [p - p.mean(axis=(0, 1)) for p in parts]
    (view,) = common.views(np.concatenate(parts), (60,), frames=450)
    run = track(view, models_for('16_32', (*CATEGORIES, '')), Config())
    periodic = np.array([k is MotionKind.PERIODIC for k in run.kinds])
    seams = np.cumsum([len(p) for p in parts])[:-1]
    return {
        'changes': int(np.abs(np.diff(periodic.astype(int))).sum()),
        'not periodic after s': float(np.argmin(periodic[seams[0] :]) / 30),
        'periodic again after s': float(np.argmax(periodic[seams[1] :]) / 30),
    }


def show(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    print(f'\n## {title}\n')
    header = list(rows[0])
    print(common.table(header, [[f'{v:.2f}' if isinstance(v, float) else v for v in r.values()] for r in rows]))


def main() -> None:
    args = common.arguments(__doc__)
    machine = common.machine()
    print(f'# Tracker\n\n{machine}\n\nReference kernel: {common.reference_seconds() * 1e3:.0f} ms')
    by_cost, by_lag = cost(args.quick), lags(args.quick)
    show('Time of a person-frame', by_cost)
    show('MPJPE against the whole sequence, mm; category known', by_lag)
    by_distance, by_metre = perspective(args.quick), metric(args.quick)
    show('Perspective: whole sequence, same subject, MPJPE, mm', by_distance)
    show('Metres at 3 m, stature given, subject left out', by_metre)
    undone, certain = swaps(args.quick), reliability(args.quick)
    show('Left and right swapped by the detector', [undone])
    show('Errors within the standard deviation', [{k: v['within'] for k, v in certain.items()}])
    if not args.quick:
        draw_reliability(certain)
    lasting, live = endurance(args.quick), switching()
    show('Endurance', [lasting])
    show('Periodic or not, live', [live])
    whole_mean = np.mean([r['whole'] for r in by_lag])
    common.write_json(
        args.json,
        {
            'machine': machine,
            'tracker_ms_person_frame_1': by_cost[0]['median ms'],
            'tracker_ms_person_frame_10': by_cost[1]['median ms'],
            'windowed_over_whole': float(np.mean([r['lag 0 s'] for r in by_lag]) / whole_mean),
            'cost': by_cost,
            'lag': by_lag,
            'perspective': by_distance,
            'metric': by_metre,
            'swaps': undone,
            'reliability': certain,
            'endurance': lasting,
            'switching': live,
        },
    )


if __name__ == '__main__':
    main()
