"""Keyframes: minutes of mixed action, a moving camera and a bad detector, beside the tracker and the whole.

Base poses are trained without the subjects of the test. The lifter is one that has not seen most of them where
`benchmarks/lifter.py` has trained it, else the one that ships, which has; the output says which.
"""

from __future__ import annotations

import common

# isort: split
import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from common import View
from lifter import HELD_OUT_FILE
from numpy.typing import NDArray
from tracker import intrinsics_of, track

from mocap_ros.config import Config, with_values
from mocap_ros.evaluation.metrics import LIMBS
from mocap_ros.formats.sequence_file import Sequence as Recorded
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.rotations import centred, rotation_to
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes import reconstruct as keyframe_method
from mocap_ros.offline.keyframes.body_halves import half_poses, halves
from mocap_ros.offline.keyframes.distance import averaging, denoised, distances
from mocap_ros.offline.keyframes.gradient_fit import fitted, placed
from mocap_ros.offline.keyframes.observations import Observed, observe
from mocap_ros.offline.keyframes.selection import select
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing.keyframe_plots import distances_figure, keyframes_figure
from mocap_ros.viewing.plots import TRUTH, draw_bones, from_the_side, save_figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
T = TypeVar('T')

mpl.use('Agg')
PICTURES = common.ROOT / 'docs' / 'img' / 'keyframes'

MIXED = ('01_03', '05_18', '135_02', 'UB_02', '01_07', '05_20', '135_06', '01_06', 'UB_04')
NEVER_TRAINED_ON = (
    '01_03', '05_18', '01_06', '05_19', '01_07', '05_20', '01_12', '05_05', '05_06', '05_08', '05_10', '05_17',
)  # fmt: skip
TWO_MINUTES = 120.0
SEGMENT = 15.0
CAMERA = {'distance': 5.0, 'orbit': 6.0, 'shake': 3.0, 'noise': 0.01, 'missing': 0.03}
STATURE = 1.7
LEAST_OUTLIER, MOST_OUTLIER, OUTLIERS = 0.2, 0.5, 0.05
RUNS = (1, 1, 1, 2, 3, 5, 8)
LONGEST_GAP, GAP_EVERY = 0.5, 10.0
BLUR, LONGEST_BLUR, BLUR_EVERY = 0.03, 0.3, 5.0
BETAS = (0.14, 0.18, 0.22)
HOUR = 3600.0
DETECTORS = ('openpose', 'mediapipe')


@dataclass(frozen=True, eq=False)
class Degraded:
    """A view as a bad detector has it, and what was done to it.

    Attributes:
        view: with the disturbed keypoints.
        wrong: (F, J) points in a wrong place.
        corrupted: (F,) frames with such a point, in a burst of blur or in a gap.
        untouched: (F, J) points that are as in the clean view.
    """

    view: View
    wrong: Mask
    corrupted: Mask
    untouched: Mask


def cpu_seconds(action: Callable[[], T]) -> tuple[T, float]:
    """The result, and the processor time it took: other processes on the machine do not count."""
    begun = time.process_time()
    result = action()
    return result, time.process_time() - begun


def mixed(trials: Sequence[str], seconds: float, heading: float = 30.0) -> View:
    """Trials one after the other, `SEGMENT` s of each, seen by a camera that goes round them and shakes."""
    motion, _ = common.capture()
    parts = [motion[t][: int(SEGMENT * common.FPS)] for t in trials]
    xyz = np.concatenate([p - p.mean(axis=(0, 1)) for p in parts])[: int(seconds * common.FPS)]
    return common.views(xyz, (heading,), frames=len(xyz), **CAMERA)[0]


def degraded(clean: View, seed: int = 0) -> Degraded:
    """Gross outliers in runs, gaps without detection, and bursts of noise as of motion blur."""
    rng = np.random.default_rng(seed)
    keypoints = clean.sequence['keypoints'].astype(float)
    frames, joints = keypoints.shape[:2]
    height = STATURE * clean.sequence['camera_matrix'][0, 0] / clean.truth[..., 2].mean(axis=1)
    wrong, blurred, gone = np.zeros((frames, joints), bool), np.zeros(frames, bool), np.zeros(frames, bool)
    while wrong.mean() < OUTLIERS:
        length = int(rng.choice(RUNS))
        run = slice(first := int(rng.integers(frames - length)), first + length)
        joint = int(rng.integers(joints))
        if not wrong[run, joint].any():
            angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(LEAST_OUTLIER, MOST_OUTLIER)
            keypoints[run, joint, :2] += far * height[run, None] * [np.cos(angle), np.sin(angle)]
            wrong[run, joint] = True
    for marked, longest, every in ((blurred, LONGEST_BLUR, BLUR_EVERY), (gone, LONGEST_GAP, GAP_EVERY)):
        for _ in range(int(frames / common.FPS / every)):
            length = int(rng.integers(2, longest * common.FPS + 1))
            first = int(rng.integers(frames - length))
            marked[first : first + length] = True
    noise = BLUR * height[:, None, None] * rng.standard_normal((frames, joints, 2))
    keypoints[..., :2] += blurred[:, None, None] * noise
    keypoints[gone] = [np.nan, np.nan, 0]
    seen = keypoints[..., 2] > 0
    wrong &= seen
    view = View({**clean.sequence, 'keypoints': keypoints.astype('f4')}, clean.heading)
    return Degraded(view, wrong, wrong.any(axis=1) | blurred | gone, seen & ~wrong & ~blurred[:, None])


@cache
def base_poses() -> dict[str, BasePoses]:
    subjects = tuple(sorted({t.partition('_')[0] for t in (*MIXED, *NEVER_TRAINED_ON)}))
    return {'all': common.trained('', without_subjects=subjects)}


def settings(**values: Any) -> Config:
    prior = {'solver.prior': str(HELD_OUT_FILE)} if HELD_OUT_FILE.is_file() else {}
    return with_values(Config(), {**prior, **{k.replace('__', '.'): v for k, v in values.items()}})


def by_keyframes(view: View, config: Config) -> keyframe_method.KeyframeResult:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return keyframe_method.reconstruct(keypoints, CMU15.joints, times, intrinsics_of(view), base_poses(), config)


def whole(view: View, config: Config) -> Array:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return reconstruct_sequence(keypoints, CMU15.joints, times, intrinsics_of(view), base_poses(), config).joints


def live(view: View, config: Config) -> Array:
    return track(view, base_poses(), config).joints


def observed(view: View, config: Config) -> Observed:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return observe(keypoints, CMU15.joints, times, intrinsics_of(view), config.tracker)


def frame_errors(view: View, joints: Array) -> Array:
    """(F,) mm, as MPJPE before the mean over frames; NaN without an answer."""
    found, truth = centred(joints), centred(view.truth)
    answered = np.isfinite(found).all(axis=(1, 2))
    factor = (found * truth)[answered].sum() / (found * found)[answered].sum()
    return np.linalg.norm(factor * found - truth, axis=-1).mean(axis=1) * 1e3


def side_by_side(quick: bool) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Keyframes, tracker and whole sequence, clean and corrupted."""
    config, rows = settings(), []
    figures: dict[str, float] = {}
    kinds = {'mixed': MIXED, "never the lifter's": NEVER_TRAINED_ON}
    methods: dict[str, Callable[[View], Array]] = {
        'keyframes': lambda v: by_keyframes(v, config).result.joints,
        'whole sequence': lambda v: whole(v, config),
        'tracker': lambda v: live(v, config),
    }
    for kind, trials in list(kinds.items())[: 1 if quick else 2]:
        clean = mixed(trials, 20.0 if quick else TWO_MINUTES)
        bad = degraded(clean)
        seconds = clean.frames / common.FPS
        for name, reconstruct in common.progress(methods.items(), kind):
            best = reconstruct(clean)
            found, took = cpu_seconds(lambda r=reconstruct, v=bad.view: r(v))
            one, two = frame_errors(clean, best), frame_errors(clean, found)
            there = bad.corrupted
            rows.append(
                {
                    'sequence': f'{kind}, {seconds:.0f} s',
                    'method': name,
                    'clean': float(np.nanmean(one)),
                    'corrupted': float(np.nanmean(two)),
                    'its corrupted frames': float(np.nanmean(two[there])),
                    'ratio to clean': float(np.nanmean(two[there]) / np.nanmean(one[there])),
                    'no answer': f'{np.isnan(two).mean():.1%}',
                    'CPU s': took,
                }
            )
        done = by_keyframes(bad.view, config)
        key = '' if kind == 'mixed' else 'unseen_'
        figures[key + 'outliers_found'] = float(done.outliers[bad.wrong].mean())
        figures[key + 'outliers_false'] = float(done.outliers[bad.untouched].mean())
        figures[key + 'corrupted_error_ratio'] = rows[-3]['ratio to clean']
        figures[key + 'corrupted_frames'] = float(bad.corrupted.mean())
        figures[key + 'two_minutes_s'] = rows[-3]['CPU s'] * TWO_MINUTES / seconds
        for label, result in (('clean', by_keyframes(clean, config)), ('corrupted', done)):
            for half in result.keyframes:
                figures[f'{key}{half.half.name}_keyframes_per_s_{label}'] = len(half.frames) / seconds
    return rows, figures


def counts(quick: bool) -> list[dict[str, Any]]:
    """Keyframes a second against alpha, for some beta, of the mixed sequence."""
    clean = mixed(MIXED, 20.0 if quick else TWO_MINUTES)
    config, rows = settings(), []
    for label, view in (('clean', clean), ('corrupted', degraded(clean).view)):
        seen = observed(view, config)
        seen = seen.without(keyframe_method.suspects(seen))
        for beta in (Config().keyframes.beta,) if quick else BETAS:
            found = keyframe_method.summarise(seen, replace(config.keyframes, alpha=0.99, beta=beta))
            for half in found:
                inside = half.matrix_frames
                curve = select(half.matrix < beta, seen.times[inside], 0.99, config.keyframes.gap).coverage
                row: dict[str, Any] = {'sequence': label, 'beta': beta, 'half': half.half.name}
                for alpha in (0.8, 0.9, 0.95, 0.99):
                    row[f'alpha {alpha:g}'] = float((np.argmax(curve >= alpha) + 1) / (view.frames / common.FPS))
                rows.append({**row, 'curve': curve})
    return rows


def draw_counts(rows: Sequence[dict[str, Any]], seconds: float) -> None:
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout='constrained', sharey=True)
    for axes, label in zip(panels, ('clean', 'corrupted'), strict=True):
        for row in (r for r in rows if r['sequence'] == label):
            colour = dict(zip(BETAS, ('#1f77b4', '#444444', '#d62728'), strict=True))[row['beta']]
            per_second = np.arange(1, len(row['curve']) + 1) / seconds
            style = '-' if row['half'] == 'upper' else '--'
            axes.plot(row['curve'], per_second, style, color=colour, label=f'beta {row["beta"]:g}, {row["half"]}')
        axes.axvline(0.95, color=TRUTH, linewidth=1)
        axes.axhline(1.0, color=TRUTH, linewidth=1)
        axes.set(xlabel='share of frames covered (alpha)', xlim=(0.5, 1.0), ylim=(0, 1.5), title=label)
    panels[0].set_ylabel('keyframes a second')
    panels[1].legend(frameon=False, fontsize=8)
    _save(figure, 'alpha')


def burst(draw: bool) -> dict[str, float]:
    """Figure 14: an arm in a wrong place for a quarter of a second, with smoothness enforced and without."""
    clean = mixed(('05_18', '135_06'), 20.0, heading=60.0)
    keypoints = clean.sequence['keypoints'].astype(float).copy()
    when = slice(100, 108)
    arm = [CMU15.index(j) for j in ('rwrist', 'relbow')]
    height = STATURE * clean.sequence['camera_matrix'][0, 0] / clean.truth[when, :, 2].mean(axis=1)
    keypoints[when, arm[0], :2] += 0.35 * height[:, None] * [0.7, -0.7]
    keypoints[when, arm[1], :2] += 0.25 * height[:, None] * [0.9, -0.4]
    view = View({**clean.sequence, 'keypoints': keypoints.astype('f4')})
    config = settings()
    smooth = by_keyframes(view, config)
    seen = observed(view, config)
    motion = smooth.motion
    start = placed(motion, seen.points, seen.weight, seen.times, seen.focal)
    raw = fitted(
        start,
        seen.points,
        seen.weight,
        seen.times,
        CMU15.bone_lengths(motion[0]),
        CMU15,
        focal=seen.focal,
        step=config.keyframes.step,
        smoothing=0.0,
        iterations=config.keyframes.iterations,
    )
    without = seen.view.to_camera(raw.placed.joints)
    if draw:
        _draw_burst(view, 104, without, smooth.result.joints)
    out = {}
    for label, joints in (('without smoothing', without), ('with', smooth.result.joints)):
        out[f'{label}: arm, mm'] = float(_arm_errors(clean, joints, arm)[when].mean())
    out['clean: arm, mm'] = float(_arm_errors(clean, by_keyframes(clean, config).result.joints, arm)[when].mean())
    out['called outliers'] = float(smooth.outliers[when][:, arm].mean())
    return out


def _arm_errors(view: View, joints: Array, arm: Sequence[int]) -> Array:
    found, truth = centred(joints), centred(view.truth)
    factor = (found * truth).sum() / (found * found).sum()
    return np.linalg.norm(factor * found - truth, axis=-1)[:, list(arm)].mean(axis=1) * 1e3


def _draw_burst(view: View, frame: int, without: Array, smooth: Array) -> None:
    figure, panels = plt.subplots(1, 5, figsize=(12, 3.6), layout='constrained')
    draw_bones(panels[0], view.sequence['keypoints'][frame, :, :2], CMU15, linewidth=2)
    panels[0].set_title('(a) 2D input, right arm wrong', fontsize=9)
    panels[0].set_aspect('equal', adjustable='datalim')
    panels[0].invert_yaxis()
    truth = view.truth[frame] - view.truth[frame].mean(axis=0)
    sides: tuple[tuple[str, Callable[[Array], Array]], ...] = (
        ('camera', lambda j: j[..., :2]),
        ('side', from_the_side),
    )
    cases = [
        (f'{what}, {name}', j, see)
        for what, j in (('(b) as is', without), ('(c) smooth', smooth))
        for name, see in sides
    ]
    for axes, (title, joints, see) in zip(panels[1:], cases, strict=True):
        draw_bones(axes, see(truth), CMU15, TRUTH, linewidth=4)
        draw_bones(axes, see(joints[frame] - joints[frame].mean(axis=0)), CMU15, linewidth=2)
        axes.set_title(title, fontsize=9)
        axes.set(xlim=(-0.7, 0.7), ylim=(1.0, -1.0), aspect='equal')
    for axes in panels:
        axes.set_axis_off()
    _save(figure, 'burst')


def second_camera(quick: bool, draw: bool) -> list[dict[str, Any]]:
    """Figures 11 to 13: reconstructed from one camera, seen from another, beside what that one detected."""
    rows = []
    models, config = load_base_pose_models('all'), Config()
    for detector in DETECTORS[:1] if quick else DETECTORS:
        recorded = {
            c: load_sequence(common.shared('data', 'detections', f'balance_{detector}_cam{c}.npz'))
            for c in (1, 2, 3)
        }
        for one, two in ((1, 3),) if quick else ((1, 2), (1, 3), (2, 1), (3, 1)):
            a, b = recorded[one], recorded[two]
            args = (a.keypoints, a.joint_names, a.timestamps, a.intrinsics(1.0), models, config)
            found = {'keyframes': keyframe_method.reconstruct(*args).result.joints}
            found['whole sequence'] = reconstruct_sequence(*args).joints
            for name, joints in found.items():
                errors, seen_from_two = _from_the_other(a, b, joints)
                rows.append({'detector': detector, 'from': one, 'seen by': two, 'method': name, **errors})
                if draw and detector == 'openpose' and (one, two) == (1, 3) and name == 'keyframes':
                    _draw_second(a, b, seen_from_two)
    return rows


def _limbs(recorded: Recorded) -> tuple[Array, list[int]]:
    """True limb joints (F, 12, 3), and their indices in the model."""
    assert recorded.truth is not None
    names = [n for n in LIMBS if n in recorded.truth.joint_names]
    columns = [recorded.truth.joint_names.index(n) for n in names]
    return recorded.truth.joints[:, columns], [CMU15.index(n) for n in names]


def _from_the_other(a: Recorded, b: Recorded, joints: Array) -> tuple[dict[str, float], Array]:
    """Errors of a reconstruction from camera a, in 3D and in the image of camera b; and its image there.

    The rigid motion between the cameras is that between the reference points in their frames; size and place are
    put right before projecting, since one camera cannot know them.
    """
    (truth, mine), (other, _) = _limbs(a), _limbs(b)
    known = np.isfinite(truth).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    p, q = truth[known].reshape(-1, 3), other[known].reshape(-1, 3)
    turn = rotation_to(p - p.mean(axis=0), q - q.mean(axis=0))
    limbs = joints[:, mine]
    middle, centre = limbs.mean(axis=1, keepdims=True), truth.mean(axis=1, keepdims=True)
    scale = ((limbs - middle) * (truth - centre))[known].sum() / ((limbs - middle) ** 2)[known].sum()
    there = scale * (joints - middle) + centre
    view = b.intrinsics(1.0).project((there - p.mean(axis=0)) @ turn.T + q.mean(axis=0))
    columns = [b.joint_names.index(CMU15.joints[j]) for j in mine]
    points = np.where(b.keypoints[:, columns, 2:] > 0.2, b.keypoints[:, columns, :2], np.nan)
    whole_frames = np.isfinite(points).all(axis=(1, 2))
    height = np.median(np.ptp(points[whole_frames, :, 1], axis=1))
    missed = np.linalg.norm(view[:, mine] - points, axis=-1)[known]
    wrong = np.linalg.norm(there[:, mine] - truth, axis=-1)[known].mean() * 1e3
    return {'MPJPE mm': float(wrong), 'image error, % of height': float(100 * np.nanmean(missed) / height)}, view


def _draw_second(a: Recorded, b: Recorded, view: Array) -> None:
    frames = np.linspace(5, len(a) - 6, 6).round().astype(int)
    figure, panels = plt.subplots(3, len(frames), figsize=(12, 6.4), layout='constrained')
    for column, frame in enumerate(frames):
        for row, (recorded, name) in enumerate(((a, 'camera 1: 2D input'), (b, 'camera 3: its detections'))):
            points, weight = observe_pixels(recorded)
            shown = np.where(weight[frame][:, None] > 0, points[frame], np.nan)
            axes = panels[2 * row, column]
            draw_bones(axes, shown, CMU15, linewidth=2)
            if not np.isfinite(shown).any():
                axes.text(0.5, 0.5, 'not detected', ha='center', transform=axes.transAxes)
            if column == 0:
                panels[2 * row, 0].set_title(name, fontsize=9, loc='left')
        draw_bones(panels[1, column], view[frame], CMU15, linewidth=2)
    panels[1, 0].set_title('reconstruction from camera 1, as camera 3 sees it', fontsize=9, loc='left')
    for axes in panels.ravel():
        axes.set_aspect('equal', adjustable='datalim')
        axes.invert_yaxis()
        axes.set_axis_off()
    _save(figure, 'second_camera')


def observe_pixels(recorded: Recorded) -> tuple[Array, Array]:
    """The model's joints (F, J, 2) px and their weights (F, J)."""
    seen = observe(
        recorded.keypoints, recorded.joint_names, recorded.timestamps, recorded.intrinsics(1.0), Config().tracker
    )
    return seen.pixels, seen.weight


def paper_length() -> dict[str, float]:
    """The paper's 1,800 frames, 36 s at 50 fps: distance matrices and choice of keyframes, both halves."""
    clean = mixed(MIXED[:3], 36.0)
    times = np.arange(1800) / 50
    old = clean.sequence['timestamps']
    flat = clean.sequence['keypoints'][..., :2].astype(float)
    seen = np.isfinite(flat).all(axis=-1)
    both = [np.interp(times, old[seen[:, j]], flat[seen[:, j], j, d]) for j in range(15) for d in (0, 1)]
    points = np.stack(both, axis=-1).reshape(1800, 15, 2)
    weight = np.ones((1800, 15))
    rules = Config().keyframes
    out = {}

    def matrices() -> list[Any]:
        found = []
        for half in halves(CMU15):
            poses = half_poses(points, weight, times, half, keyframe_method.BRIDGE)
            c, _ = distances(poses, poses)
            found.append((poses, denoised(c, averaging(c, rules.beta))))
        return found

    made, out['matrices_1800_s'] = cpu_seconds(matrices)
    (_, out['selection_1800_s']) = cpu_seconds(
        lambda: [select(d < rules.beta, p.times, rules.alpha, rules.gap) for p, d in made]
    )
    return out


def peak_mb() -> float:
    """Most resident memory of this process so far; `ru_maxrss` would count its parent's."""
    status = Path('/proc/self/status')
    lines = status.read_text().splitlines() if status.is_file() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith('VmHWM')), float('nan'))


def long_keypoints(seconds: float) -> Array:
    """(F, 15, 3) px: all trials one after the other, as often as needed, from another side each time."""
    motion, _ = common.capture()
    frames = int(seconds * common.FPS)
    once = np.concatenate([x - x.mean(axis=(0, 1)) for x in motion.values()])
    parts = [
        common.views(once[: frames - at], (20.0 + 60.0 * number,), frames=frames, noise=0.005)[0]
        for number, at in enumerate(range(0, frames, len(once)))
    ]
    return np.concatenate([v.sequence['keypoints'] for v in parts]).astype(float)


def summarised_alone(path: str, connection: Any) -> None:
    """In a process of its own: the keyframes of a sequence, time and memory they take, and what they cover."""
    keypoints = np.load(path)
    times = np.arange(len(keypoints)) / common.FPS
    before = peak_mb()
    begun = time.process_time()
    intrinsics = intrinsics_of(View({'image_size': np.array([640, 800])}))
    seen = observe(keypoints, CMU15.joints, times, intrinsics, Config().tracker)
    found = keyframe_method.summarise(seen.without(keyframe_method.suspects(seen)), Config().keyframes)
    connection.send(
        {
            'frames': len(times),
            'CPU s': time.process_time() - begun,
            'MB before': before,
            'MB at most': peak_mb(),
            'one whole matrix, MB': len(times) ** 2 * 4 / 1e6,
            'keyframes, upper': len(found[0].frames),
            'keyframes, lower': len(found[1].frames),
            'covered': min(h.coverage for h in found),
        }
    )


def lasting(seconds: float) -> dict[str, Any]:
    """Keyframes of a long sequence: time and memory."""
    context = multiprocessing.get_context('spawn')
    receiver, sender = context.Pipe(duplex=False)
    with TemporaryDirectory() as folder:
        path = str(Path(folder) / 'keypoints.npy')
        np.save(path, long_keypoints(seconds))
        process = context.Process(target=summarised_alone, args=(path, sender))
        process.start()
        sender.close()
        try:
            return receiver.recv()
        finally:
            process.join()


def sections_against_whole() -> dict[str, Any]:
    """What going section by section costs: keyframes of two minutes at once, and in sections of 30 s."""
    clean = mixed(MIXED, TWO_MINUTES)
    config = settings()
    seen = observed(clean, config)
    out = {}
    for label, largest in (('at once', 3600), ('in sections of 30 s', 900)):
        found = keyframe_method.summarise(seen, replace(config.keyframes, max_matrix_frames=largest))
        for half in found:
            out[f'{half.half.name}, {label}'] = f'{len(half.frames)} ({half.coverage:.1%})'
    return out


def pictures() -> None:
    """Of the first 36 s of the mixed sequence, as the paper's figures 3, 4 and 6."""
    clean = mixed(MIXED[:3], 36.0)
    config = Config()
    seen = observed(clean, config)
    found = keyframe_method.summarise(seen, config.keyframes)
    PICTURES.mkdir(parents=True, exist_ok=True)
    title = 'playground, dance and martial arts, 36 s'
    save_figure(keyframes_figure(seen, found, title), PICTURES / 'keyframes.png')
    save_figure(distances_figure(seen, found, config.keyframes.beta, title), PICTURES / 'distances.png')


def _save(figure: Any, name: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / f'{name}.png', dpi=100)
    plt.close(figure)


def show(title: str, rows: Sequence[dict[str, Any]]) -> None:
    print(f'\n## {title}\n')
    kept = [{k: v for k, v in r.items() if k != 'curve'} for r in rows]
    print(common.table(list(kept[0]), [list(r.values()) for r in kept]), flush=True)


def main() -> None:
    args = common.arguments(__doc__)
    machine = common.machine()
    lifter = 'held out' if HELD_OUT_FILE.is_file() else 'as shipped'
    print(f'# Keyframes\n\n{machine}\n\nLifter: {lifter}', flush=True)
    rows, figures = side_by_side(args.quick)
    show('Keyframes, whole sequence and tracker: MPJPE, mm', rows)
    show('Targets', [{'figure': k, 'value': f'{v:.4g}'} for k, v in figures.items()])
    by_alpha = counts(args.quick)
    show('Keyframes a second against alpha', by_alpha)
    wrong_arm = burst(draw=not args.quick)
    show('An arm in a wrong place for 0.27 s (figure 14)', [wrong_arm])
    elsewhere = second_camera(args.quick, draw=not args.quick)
    show('Real detections, seen from a second camera (figures 11 to 13)', elsewhere)
    lengths = paper_length()
    show("The paper's 1,800 frames", [lengths])
    record: dict[str, Any] = {
        'machine': machine,
        'lifter': lifter,
        **figures,
        'side_by_side': rows,
        'alpha': [{k: v for k, v in r.items() if k != 'curve'} for r in by_alpha],
        'burst': wrong_arm,
        'second_camera': elsewhere,
        **lengths,
    }
    if not args.quick:
        draw_counts(by_alpha, TWO_MINUTES)
        pictures()
        apart = sections_against_whole()
        long = [lasting(seconds) for seconds in (HOUR / 6, HOUR)]
        show('Section by section', [apart])
        show('Ten minutes and an hour', long)
        record |= {'sections': apart, 'long': long}
    common.write_json(args.json, record)


if __name__ == '__main__':
    main()
