# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The keyframe method on minutes of mixed action with a moving camera and a bad detector.

It is compared with the tracker and with the whole-sequence solver.

The base poses are trained without the subjects of the test. The lifter is the one that `benchmarks/lifter.py`
trains without most of these subjects; if it is missing, the shipped lifter is used, which has seen them. The
output says which.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import common
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from common import View
from matplotlib.figure import Figure
from numpy.typing import NDArray
from reconstruction import reconstruct_whole, track
from report import Report, Section, group, run

from mocap_ros.config import Config, with_values
from mocap_ros.evaluation.metrics import LIMB_JOINTS
from mocap_ros.formats.sequence_file import KeypointSequence, load_sequence
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.offline.keyframes.alignment import align_motion
from mocap_ros.offline.keyframes.half_poses import (
    build_averaging_matrix,
    compute_distances,
    denoise_distances,
    extract_half_poses,
    split_into_halves,
)
from mocap_ros.offline.keyframes.keyframe_set import find_interpolatable, select_keyframes
from mocap_ros.offline.keyframes.motion import fit_motion
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.viewing.keyframe_plots import draw_distances_figure, draw_keyframes_figure
from mocap_ros.viewing.plots import TRUTH_COLOUR, draw_bones, project_from_side

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

mpl.use('Agg')
PICTURES = 'docs/img/keyframes'  # from the root of the repository

# Trials of playground games, dance, martial arts and gestures, in this order in the mixed sequence.
MIXED_TRIALS = ('01_03', '05_18', '135_02', 'UB_02', '01_07', '05_20', '135_06', '01_06', 'UB_04')
# Trials that the held-out lifter was not trained on.
UNSEEN_TRIALS = (
    '01_03', '05_18', '01_06', '05_19', '01_07', '05_20', '01_12', '05_05', '05_06', '05_08', '05_10', '05_17',
)  # fmt: skip
SEQUENCE_S = 120.0  # s, length of the test sequence
SEGMENT_S = 15.0  # s, length of the part of each trial
# Options of the protocol: a camera that orbits and shakes, and a good detector.
CAMERA_OPTIONS = {'distance': 5.0, 'orbit': 6.0, 'shake': 3.0, 'noise': 0.01, 'missing': 0.03}
BODY_HEIGHT_M = 1.7  # m, to convert shares of the body height into pixels
MIN_OUTLIER = 0.2  # body heights, smallest distance of an outlier from its joint
MAX_OUTLIER = 0.5  # body heights, largest distance of an outlier from its joint
OUTLIER_SHARE = 0.05  # share of the points that are outliers
OUTLIER_RUN_FRAMES = (1, 1, 1, 2, 3, 5, 8)  # frames, lengths of the runs of outliers, drawn with equal probability
MAX_GAP_S = 0.5  # s, longest gap without detection
GAP_INTERVAL_S = 10.0  # s, mean time between gaps
BLUR_NOISE = 0.03  # body heights, standard deviation of the noise in a burst of motion blur
MAX_BLUR_S = 0.3  # s, longest burst of motion blur
BLUR_INTERVAL_S = 5.0  # s, mean time between bursts
BETAS = (0.14, 0.18, 0.22)  # values of keyframes.beta that are compared
HOUR_S = 3600.0  # s, an hour
DETECTORS = {'openpose': 'OpenPose', 'mediapipe': 'MediaPipe'}  # of the recordings, and what the page calls them
ERROR_COLUMNS = ('clean', 'corrupted', 'corrupted frames only')


@dataclass(frozen=True, eq=False)
class DegradedView:
    """A view with the errors of a bad detector.

    Attributes:
        view: the view with the degraded keypoints.
        wrong: (F, J) whether a point is an outlier.
        corrupted: (F,) whether a frame has an outlier or lies in a burst of blur or in a gap.
        untouched: (F, J) whether a point is the same as in the clean view.
    """

    view: View
    wrong: Mask
    corrupted: Mask
    untouched: Mask


def make_mixed_view(trials: Sequence[str], seconds: float, heading: float = 30.0) -> View:
    """Concatenate `SEGMENT_S` of each trial, seen by a camera that orbits and shakes."""
    motion, _ = common.load_capture()
    parts = [motion[t][: int(SEGMENT_S * common.FPS)] for t in trials]
    xyz = np.concatenate([p - p.mean(axis=(0, 1)) for p in parts])[: int(seconds * common.FPS)]
    return common.make_views(xyz, (heading,), frames=len(xyz), **CAMERA_OPTIONS)[0]


def degrade_view(clean: View) -> DegradedView:
    """Add gross outliers in runs, gaps without detection, and bursts of noise as from motion blur."""
    rng = np.random.default_rng(0)
    keypoints = clean.sequence['keypoints'].astype(float)
    frames, joints = keypoints.shape[:2]
    height = BODY_HEIGHT_M * clean.sequence['camera_matrix'][0, 0] / clean.truth[..., 2].mean(axis=1)
    wrong, blurred, gone = np.zeros((frames, joints), bool), np.zeros(frames, bool), np.zeros(frames, bool)
    while wrong.mean() < OUTLIER_SHARE:
        length = int(rng.choice(OUTLIER_RUN_FRAMES))
        run = slice(first := int(rng.integers(frames - length)), first + length)
        joint = int(rng.integers(joints))
        if not wrong[run, joint].any():
            angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(MIN_OUTLIER, MAX_OUTLIER)
            keypoints[run, joint, :2] += far * height[run, None] * [np.cos(angle), np.sin(angle)]
            wrong[run, joint] = True
    for marked, longest, every in ((blurred, MAX_BLUR_S, BLUR_INTERVAL_S), (gone, MAX_GAP_S, GAP_INTERVAL_S)):
        for _ in range(int(frames / common.FPS / every)):
            length = int(rng.integers(2, int(longest * common.FPS) + 1))
            first = int(rng.integers(frames - length))
            marked[first : first + length] = True
    noise = BLUR_NOISE * height[:, None, None] * rng.standard_normal((frames, joints, 2))
    keypoints[..., :2] += blurred[:, None, None] * noise
    keypoints[gone] = [np.nan, np.nan, 0]
    seen = keypoints[..., 2] > 0
    wrong &= seen
    view = View({**clean.sequence, 'keypoints': keypoints.astype('f4')}, clean.heading)
    return DegradedView(view, wrong, wrong.any(axis=1) | blurred | gone, seen & ~wrong & ~blurred[:, None])


@cache
def train_test_base_poses() -> dict[str, BasePoses]:
    subjects = tuple(sorted({t.partition('_')[0] for t in (*MIXED_TRIALS, *UNSEEN_TRIALS)}))
    return {'all': common.train_base_poses('', without_subjects=subjects)}


def make_config(**values: Any) -> Config:
    prior = {'solver.prior': str(common.HELD_OUT_LIFTER)}
    return with_values(Config(), {**prior, **{k.replace('__', '.'): v for k, v in values.items()}})


def reconstruct_by_keyframes(view: View, config: Config) -> keyframe_method.KeyframeResult:
    keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
    models = train_test_base_poses()
    return keyframe_method.reconstruct(keypoints, CMU15.joints, times, view.intrinsics, models, config)


def observe_view(view: View, config: Config) -> ObservedWindow:
    keypoints = view.sequence['keypoints'].astype(float)
    times = view.sequence['timestamps']
    return keyframe_method.observe_shots(keypoints, CMU15.joints, times, view.intrinsics, config.tracker)


def compute_frame_errors(view: View, joints: Array) -> Array:
    """Return the MPJPE of each frame, (F,) mm; NaN in frames without a reconstruction."""
    found, truth = common.align_scale(joints, view.truth)
    return common.compute_pose_errors(found, truth, similarity=False)


def report_methods(report: Report, quick: bool) -> dict[str, Any]:
    """Compare the keyframe method, the tracker and the whole-sequence solver on clean and corrupted views."""
    config = make_config()
    rows: list[dict[str, Any]] = []
    figures: dict[str, float] = {}
    kinds = {'mixed': MIXED_TRIALS, 'unseen by the lifter': UNSEEN_TRIALS}
    methods: dict[str, Callable[[View], Array]] = {
        'keyframes': lambda v: reconstruct_by_keyframes(v, config).result.joints,
        'whole sequence': lambda v: reconstruct_whole(v, train_test_base_poses(), config),
        'tracker': lambda v: track(v, train_test_base_poses(), config).joints,
    }
    for kind, trials in list(kinds.items())[: 1 if quick else 2]:
        clean = make_mixed_view(trials, 20.0 if quick else SEQUENCE_S)
        bad = degrade_view(clean)
        seconds = clean.frames / common.FPS
        for name, reconstruct in common.show_progress(methods.items(), kind):
            best = reconstruct(clean)
            found, took = common.measure_time(partial(reconstruct, bad.view))
            one, two = compute_frame_errors(clean, best), compute_frame_errors(clean, found)
            there = bad.corrupted
            rows.append(
                {
                    'sequence': f'{kind}, {seconds:.0f} s',
                    'method': name,
                    'clean': float(np.nanmean(one)),
                    'corrupted': float(np.nanmean(two)),
                    'corrupted frames only': float(np.nanmean(two[there])),
                    'ratio to clean': float(np.nanmean(two[there]) / np.nanmean(one[there])),
                    'no answer': f'{np.isnan(two).mean():.1%}',
                    'CPU s': took,
                }
            )
        done = reconstruct_by_keyframes(bad.view, config)
        key = '' if kind == 'mixed' else 'unseen_'
        figures[key + 'outliers_found'] = float(done.outliers[bad.wrong].mean())
        figures[key + 'outliers_false'] = float(done.outliers[bad.untouched].mean())
        figures[key + 'corrupted_error_ratio'] = rows[-3]['ratio to clean']
        figures[key + 'corrupted_frames'] = float(bad.corrupted.mean())
        figures[key + 'two_minutes_s'] = rows[-3]['CPU s'] * SEQUENCE_S / seconds
        for label, result in (('clean', reconstruct_by_keyframes(clean, config)), ('corrupted', done)):
            for half in result.keyframes:
                figures[f'{key}{half.body_half.name}_keyframes_per_s_{label}'] = len(half.frames) / seconds
    title = 'Keyframe method, whole-sequence solver and tracker: MPJPE, mm'
    report.rows(title, rows)
    report.keep(
        'keyframes.methods',
        ['sequence and method', *ERROR_COLUMNS, 'corrupted frames / clean', 'CPU s'],
        (
            [
                f'{row["sequence"].split()[0].rstrip(",")}: {row["method"]}',
                *(f'{row[k]:.0f}' for k in ERROR_COLUMNS),
                f'{row["ratio to clean"]:.2f}',
                f'{row["CPU s"]:.1f}',
            ]
            for row in rows
        ),
    )
    report.rows('Targets', [{'figure': k, 'value': f'{v:.4g}'} for k, v in figures.items()])
    return {**figures, 'side_by_side': rows}


def keep_targets(report: Report, seconds: Mapping[str, float]) -> None:
    """Keep the table of the targets, with what `report_methods` found and the times of the paper's length."""
    found = report.results

    def rate(label: str) -> list[str]:
        return [
            ', '.join(f'{found[f"{key}{half}_keyframes_per_s_{label}"]:.2f}' for half in ('upper', 'lower'))
            for key in ('', 'unseen_')
        ]

    def both(name: str, form: str) -> list[str]:
        return [form.format(found[key + name]) for key in ('', 'unseen_')]

    rows = [
        ['2 minutes from 2D to 3D in under 20 s', *both('two_minutes_s', '{:.1f} s')],
        ['90 % of injected outliers found', *both('outliers_found', '{:.1%}')],
        ['at most 2 % of correct points called outliers', *both('outliers_false', '{:.1%}')],
        ['corrupted frames at most 1.5 times the clean error', *both('corrupted_error_ratio', '{:.2f}')],
        *([f'at most one keyframe a second: upper, lower body, {k}', *rate(k)] for k in ('clean', 'corrupted')),
        [
            '1,800 frames at 50 fps: matrices of both halves in under 2 s',
            f'{seconds["matrices_1800_s"]:.2f} s, and {seconds["selection_1800_s"]:.2f} s for the selection',
            '',
        ],
    ]
    report.keep('keyframes.targets', ['target (alpha 0.95, T 0.2 s, beta 0.18)', 'mixed', 'unseen'], rows)


def measure_coverage(represents: NDArray[np.bool_], times: Array, config: Config) -> Array:
    """Return the share of covered frames after each keyframe was added, up to 0.99."""
    gap, represents = config.keyframes.gap, represents | np.eye(len(times), dtype=bool)
    well = np.logical_or.accumulate(represents[select_keyframes(represents, times, 0.99, gap)])
    return np.array([(w | find_interpolatable(w, times, gap)).mean() for w in well])


def report_counts(report: Report, quick: bool) -> dict[str, Any]:
    """Count the keyframes per second of the mixed sequence against alpha, for some beta."""
    clean = make_mixed_view(MIXED_TRIALS, 20.0 if quick else SEQUENCE_S)
    config, rows = make_config(), []
    for label, view in (('clean', clean), ('corrupted', degrade_view(clean).view)):
        seen = observe_view(view, config)
        seen = seen.exclude_points(keyframe_method.find_suspect_points(seen))
        for beta in (Config().keyframes.beta,) if quick else BETAS:
            found = keyframe_method.find_keyframes(seen, replace(config.keyframes, alpha=0.99, beta=beta))
            for half in found:
                curve = measure_coverage(half.distance_matrix < beta, seen.times[half.matrix_frames], config)
                row: dict[str, Any] = {'sequence': label, 'beta': beta, 'half': half.body_half.name}
                for alpha in (0.8, 0.9, 0.95, 0.99):
                    row[f'alpha {alpha:g}'] = float((np.argmax(curve >= alpha) + 1) / (view.frames / common.FPS))
                rows.append({**row, 'curve': curve})
    counts = [{k: v for k, v in r.items() if k != 'curve'} for r in rows]
    report.rows('Keyframes per second against alpha', counts)
    report.picture(draw_counts(rows, view.frames / common.FPS), f'{PICTURES}/alpha.png')
    return {'alpha': counts}


def draw_counts(rows: Sequence[dict[str, Any]], seconds: float) -> Figure:
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout='constrained', sharey=True)
    for axes, label in zip(panels, ('clean', 'corrupted'), strict=True):
        for row in (r for r in rows if r['sequence'] == label):
            colour = dict(zip(BETAS, ('#1f77b4', '#444444', '#d62728'), strict=True))[row['beta']]
            per_second = np.arange(1, len(row['curve']) + 1) / seconds
            style = '-' if row['half'] == 'upper' else '--'
            axes.plot(row['curve'], per_second, style, color=colour, label=f'beta {row["beta"]:g}, {row["half"]}')
        axes.axvline(0.95, color=TRUTH_COLOUR, linewidth=1)
        axes.axhline(1.0, color=TRUTH_COLOUR, linewidth=1)
        axes.set(xlabel='share of frames covered (alpha)', xlim=(0.5, 1.0), ylim=(0, 1.5), title=label)
    panels[0].set_ylabel('keyframes per second')
    panels[1].legend(frameon=False, fontsize=8)
    return figure


def report_burst(report: Report, _quick: bool) -> dict[str, Any]:
    """Put an arm in a wrong place for a quarter of a second, and fit with and without smoothing (figure 14)."""
    clean = make_mixed_view(('05_18', '135_06'), 20.0, heading=60.0)
    keypoints = clean.sequence['keypoints'].astype(float).copy()
    when = slice(100, 108)
    arm = [CMU15.index(j) for j in ('rwrist', 'relbow')]
    height = BODY_HEIGHT_M * clean.sequence['camera_matrix'][0, 0] / clean.truth[when, :, 2].mean(axis=1)
    keypoints[when, arm[0], :2] += 0.35 * height[:, None] * [0.7, -0.7]
    keypoints[when, arm[1], :2] += 0.25 * height[:, None] * [0.9, -0.4]
    view = View({**clean.sequence, 'keypoints': keypoints.astype('f4')})
    config = make_config()
    smooth = reconstruct_by_keyframes(view, config)
    seen = observe_view(view, config)
    motion = smooth.motion
    start = align_motion(motion, seen.points, seen.weight, seen.times, seen.focal)
    raw = fit_motion(
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
    without = seen.virtual_camera.to_real_camera(raw.motion.joints)
    report.picture(_draw_burst(view, 104, without, smooth.result.joints), f'{PICTURES}/burst.png')
    best = reconstruct_by_keyframes(clean, config)
    kinds = {'without smoothing': without, 'with': smooth.result.joints, 'clean': best.result.joints}
    out = {f'{k}: arm, mm': float(_compute_arm_errors(clean, p, arm)[when].mean()) for k, p in kinds.items()}
    out['called outliers'] = float(smooth.outliers[when][:, arm].mean())
    report.rows('An arm in a wrong place for 0.27 s (figure 14)', [out])
    return {'burst': out}


def _compute_arm_errors(view: View, joints: Array, arm: Sequence[int]) -> Array:
    found, truth = common.align_scale(joints, view.truth)
    return np.linalg.norm(found - truth, axis=-1)[:, list(arm)].mean(axis=1) * 1e3


def _draw_burst(view: View, frame: int, without: Array, smooth: Array) -> Figure:
    figure, panels = plt.subplots(1, 5, figsize=(12, 3.6), layout='constrained')
    draw_bones(panels[0], view.sequence['keypoints'][frame, :, :2], CMU15, linewidth=2)
    panels[0].set_title('(a) 2D input, right arm wrong', fontsize=9)
    panels[0].set_aspect('equal', adjustable='datalim')
    panels[0].invert_yaxis()
    truth = view.truth[frame] - view.truth[frame].mean(axis=0)
    sides: tuple[tuple[str, Callable[[Array], Array]], ...] = (
        ('camera', lambda j: j[..., :2]),
        ('side', project_from_side),
    )
    cases = [
        (f'{what}, {name}', j, see)
        for what, j in (('(b) as is', without), ('(c) smooth', smooth))
        for name, see in sides
    ]
    for axes, (title, joints, see) in zip(panels[1:], cases, strict=True):
        draw_bones(axes, see(truth), CMU15, TRUTH_COLOUR, linewidth=4)
        draw_bones(axes, see(joints[frame] - joints[frame].mean(axis=0)), CMU15, linewidth=2)
        axes.set_title(title, fontsize=9)
        axes.set(xlim=(-0.7, 0.7), ylim=(1.0, -1.0), aspect='equal')
    for axes in panels:
        axes.set_axis_off()
    return figure


def report_second_camera(report: Report, quick: bool) -> dict[str, Any]:
    """Reconstruct from one camera and compare with the detections of another camera (figures 11 to 13)."""
    rows = []
    models, config = load_base_pose_models('all'), Config()
    for detector in list(DETECTORS)[: 1 if quick else None]:
        recorded = {
            c: load_sequence(common.data_path('data', 'detections', f'balance_{detector}_cam{c}.npz'))
            for c in (1, 2, 3)
        }
        for one, two in ((1, 3),) if quick else ((1, 2), (1, 3), (2, 1), (3, 1)):
            a, b = recorded[one], recorded[two]
            args = (a.keypoints, a.joint_names, a.timestamps, a.intrinsics(1.0), models, config)
            found = {'keyframes': keyframe_method.reconstruct(*args).result.joints}
            found['whole sequence'] = reconstruct_sequence(*args).joints
            for name, joints in found.items():
                errors, seen_from_two = _compare_in_second_camera(a, b, joints)
                rows.append({'detector': detector, 'from': one, 'seen by': two, 'method': name, **errors})
                if detector == 'openpose' and (one, two) == (1, 3) and name == 'keyframes':
                    report.picture(_draw_second_camera(a, b, seen_from_two), f'{PICTURES}/second_camera.png')
    title = 'Real detections, seen from a second camera (figures 11 to 13)'
    report.rows(title, rows)
    by_case = group(rows, 'detector', 'from', 'seen by')
    report.keep(
        'keyframes.second_camera',
        [
            'detector, input camera, second camera',
            *(f'{r["method"]}: MPJPE, image error' for r in next(iter(by_case.values()))),
        ],
        (
            [
                f'{DETECTORS[detector]}, {one}, {two}',
                *(f'{r["MPJPE mm"]:.0f} mm, {r["image error, % of height"]:.1f} %' for r in mine),
            ]
            for (detector, one, two), mine in by_case.items()
        ),
    )
    return {'second_camera': rows}


def _select_limbs(recorded: KeypointSequence) -> tuple[Array, list[int]]:
    """Return the true joints of the limbs (F, 12, 3) and their indices in the model."""
    assert recorded.truth is not None
    names = [n for n in LIMB_JOINTS if n in recorded.truth.joint_names]
    columns = [recorded.truth.joint_names.index(n) for n in names]
    return recorded.truth.joints[:, columns], [CMU15.index(n) for n in names]


def _compare_in_second_camera(
    a: KeypointSequence, b: KeypointSequence, joints: Array
) -> tuple[dict[str, float], Array]:
    """Return the errors of a reconstruction from camera a in 3D and in the image of camera b, and that image.

    The rigid motion between the cameras is estimated from the true joints in both camera frames. Scale and
    position are corrected before the projection, since a single camera cannot measure them.
    """
    (truth, mine), (other, _) = _select_limbs(a), _select_limbs(b)
    known = np.isfinite(truth).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    p, q = truth[known].reshape(-1, 3), other[known].reshape(-1, 3)
    turn = fit_rotation(p - p.mean(axis=0), q - q.mean(axis=0))
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


def _draw_second_camera(a: KeypointSequence, b: KeypointSequence, view: Array) -> Figure:
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
    return figure


def observe_pixels(recorded: KeypointSequence) -> tuple[Array, Array]:
    """Return the image points (F, J, 2) px of the model's joints and their weights (F, J)."""
    intrinsics = recorded.intrinsics(1.0)
    seen = keyframe_method.observe_shots(
        recorded.keypoints, recorded.joint_names, recorded.timestamps, intrinsics, Config().tracker
    )
    pixels = intrinsics.project(np.concatenate([seen.rays, np.ones_like(seen.rays[..., :1])], axis=-1))
    return pixels, seen.weight


def report_paper_length(report: Report, _quick: bool) -> dict[str, Any]:
    """Measure the CPU time of the distance matrices and the selection for the paper's 1,800 frames (36 s)."""
    clean = make_mixed_view(MIXED_TRIALS[:3], 36.0)
    times = np.arange(1800) / 50
    old = clean.sequence['timestamps']
    flat = clean.sequence['keypoints'][..., :2].astype(float)
    seen = np.isfinite(flat).all(axis=-1)
    both = [np.interp(times, old[seen[:, j]], flat[seen[:, j], j, d]) for j in range(15) for d in (0, 1)]
    points, weight = np.stack(both, axis=-1).reshape(1800, 15, 2), np.ones((1800, 15))
    rules, out = Config().keyframes, {}

    def matrices() -> list[Any]:
        found = []
        for half in split_into_halves(CMU15):
            poses = extract_half_poses(points, weight, times, half, keyframe_method.MAX_BRIDGED_GAP_S)
            c, _ = compute_distances(poses, poses)
            found.append((poses, denoise_distances(c, build_averaging_matrix(c, rules.beta))))
        return found

    made, out['matrices_1800_s'] = common.measure_time(matrices)
    (_, out['selection_1800_s']) = common.measure_time(
        lambda: [select_keyframes(d < rules.beta, p.times, rules.alpha, rules.gap) for p, d in made]
    )
    report.rows("The paper's 1,800 frames", [out])
    if 'unseen_two_minutes_s' in report.results:
        keep_targets(report, out)
    return out


def make_long_keypoints(seconds: float) -> Array:
    """Return keypoints (F, 15, 3): all trials in sequence, repeated as needed from another side each time."""
    motion, _ = common.load_capture()
    frames = int(seconds * common.FPS)
    once = np.concatenate([x - x.mean(axis=(0, 1)) for x in motion.values()])
    parts = [
        common.make_views(once[: frames - at], (20.0 + 60.0 * number,), frames=frames, noise=0.005)[0]
        for number, at in enumerate(range(0, frames, len(once)))
    ]
    return np.concatenate([v.sequence['keypoints'] for v in parts]).astype(float)


def find_long_keyframes(seconds: float) -> dict[str, Any]:
    """Find the keyframes of a long sequence; return the time and the coverage."""
    keypoints = make_long_keypoints(seconds)
    before = common.read_peak_mb()
    intrinsics = View({'image_size': np.array([640, 800])}).intrinsics
    times = np.arange(len(keypoints)) / common.FPS

    def find() -> Any:
        seen = keyframe_method.observe_shots(keypoints, CMU15.joints, times, intrinsics, Config().tracker)
        seen = seen.exclude_points(keyframe_method.find_suspect_points(seen))
        return keyframe_method.find_keyframes(seen, Config().keyframes)

    found, cpu_s = common.measure_time(find)
    return {
        'frames': len(times),
        'CPU s': cpu_s,
        'MB before': before,
        'one whole matrix, MB': len(times) ** 2 * 4 / 1e6,
        **{f'keyframes, {half.body_half.name}': len(half.frames) for half in found},
        'covered': min(h.coverage for h in found),
    }


def report_long(report: Report, quick: bool) -> dict[str, Any]:
    """Measure time and memory of the keyframes of ten minutes and of an hour."""
    rows = []
    for seconds in () if quick else (HOUR_S / 6, HOUR_S):
        found, peak = common.run_in_process(find_long_keyframes, seconds, fresh=True)
        rows.append({**found, 'MB at most': peak})
    report.rows('Ten minutes and an hour', rows)
    if rows:
        header = ['keyframes of', 'CPU s', 'peak memory of the process, MB', 'memory of one whole matrix, MB']
        cells = (
            [
                f'{r["frames"] / common.FPS / 60:.0f} minutes at {common.FPS:.0f} fps',
                f'{r["CPU s"]:.0f}',
                f'{r["MB at most"]:,.0f} ({r["MB before"]:.0f} before)',
                f'{r["one whole matrix, MB"]:,.0f}',
                f'{r["keyframes, upper"]} and {r["keyframes, lower"]}, {r["covered"]:.0%} covered',
            ]
            for r in rows
        )
        report.keep('keyframes.long', [*header, 'keyframes of upper and lower body'], cells)
    return {'long': rows}


def report_sections(report: Report, quick: bool) -> dict[str, Any]:
    """Compare the keyframes of two minutes at once and in sections of 30 s."""
    config, out = make_config(), {}
    seen = observe_view(make_mixed_view(MIXED_TRIALS, 20.0 if quick else SEQUENCE_S), config)
    for label, largest in (('at once', 3600), ('in sections of 30 s', 900)):
        found = keyframe_method.find_keyframes(seen, replace(config.keyframes, max_matrix_frames=largest))
        for half in found:
            out[f'{half.body_half.name}, {label}'] = f'{len(half.frames)} ({half.coverage:.1%})'
    report.rows('Keyframes at once and section by section', [out])
    return {'sections': out}


def draw_pictures(report: Report, _quick: bool) -> None:
    """Draw the first 36 s of the mixed sequence as in figures 3, 4 and 6 of the paper."""
    config = Config()
    seen = observe_view(make_mixed_view(MIXED_TRIALS[:3], 36.0), config)
    found = keyframe_method.find_keyframes(seen, config.keyframes)
    title = 'playground, dance and martial arts, 36 s'
    report.picture(draw_keyframes_figure(seen, found, title), f'{PICTURES}/keyframes.png')
    distances = draw_distances_figure(seen, found, config.keyframes.beta, title)
    report.picture(distances, f'{PICTURES}/distances.png')


SECTIONS: Mapping[str, Section] = {
    'methods': report_methods,
    'counts': report_counts,
    'burst': report_burst,
    'second_camera': report_second_camera,
    'paper_length': report_paper_length,
    'sections': report_sections,
    'long': report_long,
    'pictures': draw_pictures,
}

if __name__ == '__main__':
    run(__doc__, 'Keyframes', SECTIONS)
