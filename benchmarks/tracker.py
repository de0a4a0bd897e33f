"""The tracker: time of a person-frame, and accuracy against the whole-sequence solve, in perspective, under swaps.

Accuracy is measured on subjects (`common.HELD_OUT`) that neither base poses nor lifter were trained on, with
a lifter that this trains if there is none (12 minutes). `Same subject`: base poses of that subject's other trials.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import resource
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, with_values
from mocap_ros.errors import FrameDropped
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.people import MotionKind
from mocap_ros.skeleton import CMU15, stature
from mocap_ros.tracking.tracker import Tracker

Array = NDArray[np.float64]
NS = 1_000_000_000
ORTHOGRAPHIC = 20.0  # image widths: a focal length at which the protocol's orthographic views are perspective
CATEGORIES = ('walk', 'run', 'jump')
UNSEEN = (
    ('35_02', 'walk'),
    ('35_12', 'walk'),
    ('35_17', 'run'),
    ('35_22', 'run'),
    ('13_11', 'jump'),
    ('13_32', 'jump'),
)
SAME = (('35_02', 'walk'), ('35_17', 'run'))
SWAPPED = ('35_02', '35_17', 'UW_22', 'UJ_01', '13_11', '05_04', 'UB_01')
RELIABLE = ('35_20', '35_23', 'UW_22', '13_19x', 'UT_01', 'UWW_01', '135_04', '135_08')
HIDDEN = ((), ('lelbow', 'lwrist'), ('rknee', 'rankle'))
NOISES = (0.0, 0.01, 0.02)
mpl.use('Agg')
PICTURES = common.ROOT / 'docs' / 'img' / 'tracker'


@dataclass(frozen=True, eq=False)
class Run:
    """What the tracker said of a sequence of one person, NaN where nothing."""

    joints: Array
    std: Array
    inferred: NDArray[np.bool_]
    milliseconds: Array
    kinds: list[MotionKind]
    tracker: Tracker


def intrinsics_of(view: common.View) -> Intrinsics:
    if 'camera_matrix' in view.sequence:
        return Intrinsics.from_matrix(view.sequence['camera_matrix'])
    width, height = (int(v) for v in view.sequence['image_size'])
    return Intrinsics.nominal(width, height, ORTHOGRAPHIC)


def people_of(views: Sequence[common.View], frame: int) -> list[Person2D]:
    return [
        Person2D(f'p{i}', CMU15.joints, k[:, :2].astype(float), k[:, 2].astype(float))
        for i, k in enumerate(v.sequence['keypoints'][frame] for v in views)
    ]


def track(view: common.View, models: Mapping[str, BasePoses], config: Config) -> Run:
    tracker, camera = Tracker(models, config), intrinsics_of(view)
    stamps = [round(t * NS) + 1 for t in view.sequence['timestamps']]
    joints = np.full(view.truth.shape, np.nan)
    std, inferred = np.full(joints.shape[:2], np.nan), np.zeros(joints.shape[:2], bool)
    spent, kinds = [], []
    for frame, stamp in enumerate(stamps):
        begun = time.process_time()
        people = tracker.update(stamp, people_of([view], frame), camera)
        spent.append((time.process_time() - begun) * 1e3)
        kinds.append(people[0].motion.kind if people else MotionKind.UNKNOWN)
        if people:
            at = stamps.index(tracker.output_ns)
            joints[at], std[at], inferred[at] = people[0].joints, people[0].std, people[0].inferred
    return Run(joints, std, inferred, np.array(spent), kinds, tracker)


def whole(view: common.View, models: Mapping[str, BasePoses], config: Config) -> Array:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return reconstruct_sequence(keypoints, CMU15.joints, times, intrinsics_of(view), models, config).joints


def models_for(categories: Iterable[str] = (*CATEGORIES, '')) -> dict[str, BasePoses]:
    return {c or 'all': common.trained(c, without_subjects=common.HELD_OUT) for c in categories}


def configured(prior: str, **values: Any) -> Config:
    """Defaults but for the prior, and `group__field` values."""
    return with_values(Config(), {'solver.prior': prior, **{k.replace('__', '.'): v for k, v in values.items()}})


def priors() -> dict[str, str]:
    return {'learned': str(common.HELD_OUT_FILE), 'pca': 'pca'}


def cost(quick: bool) -> list[dict[str, Any]]:
    """CPU milliseconds of a person-frame: of an update alone, and with the questions asked between updates."""
    rows = []
    frames = 90 if quick else 240
    views = common.views('09_12', np.arange(10) * 36, frames=frames)
    models = models_for()
    cases = [(2.0, 30, 1, 'learned'), (2.0, 30, 10, 'learned'), (2.0, 40, 1, 'learned'), (2.0, 40, 10, 'learned')]
    cases = cases[:2] if quick else cases
    if not quick:
        cases += [(1.0, 30, 1, 'learned'), (4.0, 30, 1, 'learned'), (2.0, 15, 1, 'learned')]
        cases += [(2.0, 40, 20, 'learned'), (2.0, 40, 1, 'pca'), (2.0, 40, 10, 'pca')]
    for window, components, people, prior in common.progress(cases, 'time'):
        config = configured(prior, tracker__window=window, tracker__components=components)
        tracker, camera = Tracker(models, config), intrinsics_of(views[0])
        updates, questions = [], []
        for frame in range(views[0].frames):
            seen = people_of([views[i % 10] for i in range(people)], frame)
            begun = time.process_time()
            tracker.update(round(frame / 30 * NS) + 1, seen, camera)
            between = time.process_time()
            tracker.examine()
            updates.append((between - begun) * 1e3 / people)
            questions.append((time.process_time() - between) * 1e3 / people)
        late = slice(len(updates) // 3, None)
        update, question = np.array(updates[late]), np.array(questions[late])
        rows.append(
            {
                'window s': window,
                'K': components,
                'people': people,
                'prior': prior,
                'median ms': float(np.median(update)),
                'p99 ms': float(np.percentile(update, 99)),
                'mean ms, with examine()': float((update + question).mean()),
                'longest examine(), ms': float(question.max() * people),
            }
        )
    return rows


def lags(quick: bool) -> list[dict[str, Any]]:
    """MPJPE of the tracker, mean over headings, and of the whole-sequence solve; category unknown and known."""
    rows = []
    headings = (45,) if quick else common.HEADINGS
    auto = models_for()
    for prior, value in priors().items():
        for trial, category in common.progress(UNSEEN[::2] if quick else UNSEEN, f'lag, {prior}'):
            views, known, config = common.views(trial, headings), models_for((category,)), configured(value)
            late = [slice(min(v.frames // 2, 30), None) for v in views]
            offline = [whole(v, auto, config) for v in views]
            record: dict[str, Any] = {
                'trial': f'{trial} {category}',
                'prior': prior,
                'whole': mean_error(views, offline),
            }
            for lag in (0.0, 0.1, 0.5) if prior == 'learned' and not quick else (0.0,):
                found = [track(v, auto, configured(value, tracker__lag=lag)).joints for v in views]
                record[f'lag {lag:g} s'] = mean_error(views, found)
                if lag == 0:
                    record['whole, after 1 s'] = mean_error(views, offline, late)
                    record['lag 0 s, after 1 s'] = mean_error(views, found, late)
            if not quick:
                record['whole, category known'] = mean_error(views, [whole(v, known, config) for v in views])
                live = [track(v, known, config).joints for v in views]
                record['lag 0 s, category known'] = mean_error(views, live)
            rows.append(record)
    return rows


def ratio_of(rows: Sequence[Mapping[str, Any]], prior: str, category: str = '') -> float:
    """Of the error at lag 0 and of the whole sequence, means over all views of these trials."""
    mine = [r for r in rows if r['prior'] == prior and r['trial'].endswith(category)]
    return float(np.mean([r['lag 0 s'] for r in mine]) / np.mean([r['whole'] for r in mine]))


def mean_error(
    views: Sequence[common.View],
    answers: Sequence[Array],
    frames: Sequence[slice] | None = None,
    key: str = 'mpjpe_mm',
) -> float:
    parts = frames or [slice(None)] * len(views)
    return float(np.mean([error(v, a, p, key) for v, a, p in zip(views, answers, parts, strict=True)]))


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
    cases = cases[:3:2] if quick else cases
    for trial, category in SAME[:1] if quick else SAME:
        model = common.trained(category, only_subjects=(trial[:2],), without_trials=(trial,))
        for options in common.progress(cases, 'perspective'):
            views = common.views(trial, headings, **options)
            record: dict[str, Any] = {'case': f'{trial} {options or "orthographic"}'}
            for prior, value in priors().items():
                for label, on in (('weak', False), ('perspective', True)):
                    config = configured(value, tracker__perspective=on)
                    record[f'{prior}, {label}'] = mean_error(
                        views, [whole(v, {'m': model}, config) for v in views]
                    )
            rows.append(record)
    return rows


def metric(quick: bool) -> list[dict[str, Any]]:
    """Metres at 3 m, the true stature given, subject left out: whole sequence and tracker."""
    rows = []
    for trial, category in SAME[:1] if quick else SAME:
        truth = stature(common.capture()[0][trial] / 1e3, CMU15)
        views = common.views(trial, (45,) if quick else common.HEADINGS, distance=3.0)
        for prior, value in priors().items():
            config = configured(value, tracker__body_height=truth)
            for label, models in (('unknown', models_for()), ('known', models_for((category,))))[
                : 1 if quick else 2
            ]:
                for way, answers in (
                    ('whole', [whole(v, models, config) for v in views]),
                    ('lag 0', [track(v, models, config).joints for v in views]),
                ):
                    row: dict[str, Any] = {'case': f'{trial}, {way}', 'prior': prior, 'category': label}
                    for key in ('metric_mpjpe_mm', 'root_mm'):
                        row[key] = mean_error(views, answers, key=key)
                    rows.append(row)
    return rows


def swaps(quick: bool) -> dict[str, float]:
    """Left and right swapped in 10 % of the frames, bursts of up to 0.3 s: shares undone, and undone in error."""
    mirror = np.array(CMU15.mirror)
    undone = missed = wrong = right = 0
    models, config = models_for(), configured(priors()['learned'])
    for trial in common.progress(SWAPPED[:2] if quick else SWAPPED, 'swaps'):
        for view in common.views(trial, (110,) if quick else common.HEADINGS, frames=240, noise=0.01):
            rng = np.random.default_rng(int(view.heading))
            swapped = bursts(view.frames, 0.1, 9, rng)
            keypoints = view.sequence['keypoints'].copy()
            keypoints[swapped] = keypoints[swapped][:, mirror]
            disturbed = common.View({**view.sequence, 'keypoints': keypoints})
            tracker, camera, before = Tracker(models, config), intrinsics_of(view), 0
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


def reliability(quick: bool, prior: str, headings: Sequence[float]) -> dict[str, Any]:
    """Share of true errors within the standard deviation, by its size, for seen and for hidden joints.

    Every trial without noise and with two amounts of it, with everything seen and with an arm or a leg hidden,
    after the first half second. None of these trials served to choose the factors.
    """
    trials = RELIABLE[::4] if quick else RELIABLE
    noises = NOISES[::2] if quick else NOISES
    models, config = models_for(), configured(prior)
    pairs: dict[str, list[Array]] = {'seen': [], 'hidden': []}
    by_trial: dict[str, list[Array]] = {}
    by_noise: dict[str, list[Array]] = {}
    for number, trial in enumerate(common.progress(trials, 'reliability')):
        for noise in noises:
            for view in common.views(trial, [h + 37 * number for h in headings], frames=100, noise=noise):
                for limb in HIDDEN:
                    run = track(view.hiding(limb), models, config)
                    pose, truth = (p - p.mean(axis=1, keepdims=True) for p in (run.joints, view.truth))
                    pose = pose * (pose * truth).sum() / (pose * pose).sum()
                    wrong = np.linalg.norm(pose - truth, axis=-1)
                    for label, chosen in (('seen', ~run.inferred), ('hidden', run.inferred)):
                        late = chosen & (np.arange(view.frames) >= 15)[:, None]
                        pair = np.stack([run.std[late], wrong[late]])
                        pairs[label].append(pair)
                        by_trial.setdefault(f'{trial}, {label}', []).append(pair)
                        by_noise.setdefault(f'noise {noise:g}, {label}', []).append(pair)
    out: dict[str, Any] = {}
    for label, parts in pairs.items():
        std, wrong = np.concatenate(parts, axis=1)
        groups = np.array_split(np.argsort(std), 8)
        out[label] = {
            'within': share_within(parts),
            'std mm': [float(std[g].mean() * 1e3) for g in groups],
            'two thirds within mm': [float(np.quantile(wrong[g], 2 / 3) * 1e3) for g in groups],
            'trials': {k.partition(',')[0]: share_within(p) for k, p in by_trial.items() if k.endswith(label)},
            'noises': {k.partition(',')[0]: share_within(p) for k, p in by_noise.items() if k.endswith(label)},
        }
    return out


def share_within(pairs: Sequence[Array]) -> float:
    std, wrong = np.concatenate(pairs, axis=1)
    return float((wrong <= std).mean())


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
    """People who come and go, gaps, swaps, garbage, stamps that repeat and jump: memory and answers."""
    minutes = 0.1 if quick else 30.0
    rng = np.random.default_rng(0)
    views = common.views('16_32', (0, 60, 120, 200), frames=120)
    tracker = Tracker(models_for(), Config())
    camera = intrinsics_of(views[0])
    exceptions, given, answered, dropped, peaks, begun = 0, 0, 0, 0, [], 0
    frames = int(minutes * 60 * 30)
    for frame in common.progress(range(frames), 'endurance'):
        people = [p for i, p in enumerate(people_of(views, frame % 120)) if (frame // (40 + 17 * i)) % 3]
        if rng.random() < 0.1:
            people = [replace(p, points=p.points[list(CMU15.mirror)]) for p in people]
        if rng.random() < 0.05:
            wild = rng.normal(size=(15, 2)) * 10.0 ** rng.integers(-3, 6)
            people.append(Person2D('', CMU15.joints, wild, rng.uniform(0.2, 1.0, 15)))
        if rng.random() < 0.005:
            begun += round(rng.choice([-1.5, 0.4, 3.0]) * NS)
        stamp = begun + round((frame / 30 + rng.uniform(0, 0.02)) * NS) + 1
        for _ in range(1 + (rng.random() < 0.02)):
            given += len(people)
            try:
                answered += sum(not p.predicted for p in tracker.update(stamp, people, camera))
            except FrameDropped:
                dropped += len(people)
            except Exception:
                exceptions += 1
        if frame % max(frames // 8, 1) == 0:
            peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return {
        'frames': frames,
        'people given': given,
        'answered': answered,
        'dropped with their frame': dropped,
        'counted as unusable': tracker.unusable_people,
        'unaccounted for': given - answered - dropped - tracker.unusable_people,
        'exceptions': exceptions,
        'MB after 1/8': peaks[1],
        'MB at the end': peaks[-1],
    }


def switching() -> dict[str, Any]:
    """A walk, a jump and a walk, spliced: when the live answer changes."""
    motion, _ = common.capture()
    parts = [motion['35_29'][:120], motion['UJ_01'][:150], motion['35_29'][:120]]
    parts = [p - p.mean(axis=(0, 1)) for p in parts]
    (view,) = common.views(np.concatenate(parts), (60,), frames=390)
    run = track(view, models_for(), configured(priors()['learned']))
    periodic = np.array([k is MotionKind.PERIODIC for k in run.kinds])
    seams = np.cumsum([len(p) for p in parts])[:-1]
    return {
        'changes': int(np.abs(np.diff(periodic.astype(int))).sum()),
        'not periodic after s': float(np.argmin(periodic[seams[0] :]) / 30),
        'periodic again after s': float(np.argmax(periodic[seams[1] :]) / 30),
    }


def show(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    print(f'\n## {title}\n')
    header = list(dict.fromkeys(k for r in rows for k in r))
    cells = ([r.get(k) for k in header] for r in rows)
    print(common.table(header, cells), flush=True)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--only', nargs='+', choices=SECTIONS, default=SECTIONS, help='these sections alone')


SECTIONS = ('cost', 'lags', 'perspective', 'metric', 'swaps', 'reliability', 'endurance', 'switching')
NEED_NO_LIFTER = ('cost', 'endurance')


def main() -> None:
    args = common.arguments(__doc__, options)
    machine = common.machine()
    print(f'# Tracker\n\n{machine}')
    record: dict[str, Any] = {'machine': machine}
    wanted = tuple(args.only)
    if not common.HELD_OUT_FILE.is_file() and not set(wanted) <= set(NEED_NO_LIFTER):
        if args.quick:
            missing = [s for s in wanted if s not in NEED_NO_LIFTER]
            print(
                f'\nskipped: {", ".join(missing)}, which need {common.HELD_OUT_FILE}; '
                'without --quick it is trained'
            )
            wanted = tuple(s for s in wanted if s in NEED_NO_LIFTER)
        else:
            common.held_out_lifter()
    for section in wanted:
        record |= measure(section, args.quick)
    common.write_json(args.json, record)


def measure(section: str, quick: bool) -> dict[str, Any]:
    """Run and print a section; its part of the results."""
    match section:
        case 'cost':
            rows = cost(quick)
            show('Time of a person-frame', rows)
            one, ten = rows[0]['median ms'], rows[1]['median ms']
            return {'cost': rows, 'tracker_ms_person_frame_1': one, 'tracker_ms_person_frame_10': ten}
        case 'lags':
            rows = lags(quick)
            show('MPJPE against the whole sequence, mm', rows)
            ratios = {p: {c or 'all': ratio_of(rows, p, c) for c in ('', *CATEGORIES)} for p in priors()}
            show('Lag 0 over the whole sequence', [{'prior': p, **r} for p, r in ratios.items()])
            return {'lag': rows, 'ratios': ratios, 'windowed_over_whole': ratios['learned']['all']}
        case 'perspective':
            rows = perspective(quick)
            show('Perspective: whole sequence, same subject, MPJPE, mm', rows)
            return {'perspective': rows}
        case 'metric':
            rows = metric(quick)
            show('Metres at 3 m, stature given, subject left out', rows)
            return {'metric': rows}
        case 'swaps':
            undone = swaps(quick)
            show('Left and right swapped by the detector', [undone])
            return {'swaps': undone}
        case 'reliability':
            found = {'learned': reliability(quick, priors()['learned'], (20,) if quick else (20, 200))}
            if not quick:
                found['pca'] = reliability(quick, 'pca', (20,))
            show_reliability(found)
            if not quick:
                draw_reliability(found['learned'])
            return {'reliability': found}
        case 'endurance':
            lasting = endurance(quick)
            show('Endurance', [lasting])
            return {'endurance': lasting}
        case _:
            live = switching()
            show('Periodic or not, live', [live])
            return {'switching': live}


def show_reliability(found: Mapping[str, Any]) -> None:
    each = [(p, label, found[p][label]) for p in found for label in ('seen', 'hidden')]
    rows = [{'prior': p, 'joints': j, 'within': f['within'], **f['noises'], **f['trials']} for p, j, f in each]
    show('Errors within the standard deviation', rows)
    bins = [
        [p, j, *(f'{a:.0f} / {b:.0f}' for a, b in zip(f['std mm'], f['two thirds within mm'], strict=True))]
        for p, j, f in each
    ]
    print('\nBy its size: standard deviation / two thirds of errors within, mm\n')
    print(common.table(['prior', 'joints', *(f'{i + 1}' for i in range(8))], bins), flush=True)


if __name__ == '__main__':
    main()
