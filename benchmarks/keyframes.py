# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The keyframe method on minutes of mixed action with a moving camera and a bad detector.

It is compared with the tracker and with the whole-sequence solver. A perspective camera at 5 m orbits at 6
degrees/s and shakes by 3 degrees; noise is 1 % of the range of motion, and 3 % of the points are missing. In the
corrupted sequences, 5 % of the points are moved by 0.2 to 0.5 of body height in runs of 1 to 8 frames; there is a
gap of up to 0.5 s every 10 s, and a burst of up to 0.3 s with noise of 3 % of body height every 5 s. Base poses
and lifter were not trained on the tested subjects.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray
from report import Report, run

from mocap_ros.config import Config, with_values
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import ALL_MOTIONS
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEQUENCES = {
    # trials of playground games, dance, martial arts and gestures
    'mixed': ('01_03', '05_18', '135_02', 'UB_02', '01_07', '05_20', '135_06', '01_06', 'UB_04'),
    # trials that no lifter was trained on, half of them leaps of 6 to 9 s
    'unseen': (
        *('01_03', '05_18', '01_06', '05_19', '01_07', '05_20'),
        *('01_12', '05_05', '05_06', '05_08', '05_10', '05_17'),
    ),
}
SEQUENCE_S, SEGMENT_S = 120.0, 15.0  # s, length of the sequence, and of the part of each trial
CAMERA_OPTIONS = {'distance': 5.0, 'orbit': 6.0, 'shake': 3.0, 'noise': 0.01, 'missing': 0.03}
BODY_HEIGHT_M = 1.7  # m, to convert shares of the body height into pixels
OUTLIER_RANGE = 0.2, 0.5  # body heights, distance of an outlier from its joint
OUTLIER_SHARE = 0.05  # share of the points that are outliers
OUTLIER_RUN_FRAMES = (1, 1, 1, 2, 3, 5, 8)  # frames, lengths of the runs of outliers, drawn with equal probability
MAX_GAP_S, GAP_INTERVAL_S = 0.5, 10.0  # s, longest gap without detection, and mean time between gaps
BLUR_NOISE = 0.03  # body heights, standard deviation of the noise in a burst of motion blur
MAX_BLUR_S, BLUR_INTERVAL_S = 0.3, 5.0  # s, longest burst of motion blur, and mean time between bursts


@dataclass(frozen=True, eq=False)
class DegradedView:
    """A view with a bad detector's errors: outliers (F, J), frames with any error (F,), sound points (F, J)."""

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
    keypoints = clean.keypoints
    frames, joints = keypoints.shape[:2]
    height = BODY_HEIGHT_M * clean.sequence['camera_matrix'][0, 0] / clean.truth[..., 2].mean(axis=1)
    wrong, blurred, gone = np.zeros((frames, joints), bool), np.zeros(frames, bool), np.zeros(frames, bool)
    while wrong.mean() < OUTLIER_SHARE:
        length = int(rng.choice(OUTLIER_RUN_FRAMES))
        run = slice(first := int(rng.integers(frames - length)), first + length)
        joint = int(rng.integers(joints))
        if not wrong[run, joint].any():
            angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(*OUTLIER_RANGE)
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


def report_methods(report: Report) -> None:
    seconds = 20.0 if report.quick else SEQUENCE_S
    subjects = tuple(sorted({t.partition('_')[0] for trials in SEQUENCES.values() for t in trials}))
    model = common.train_base_poses('', without_subjects=subjects)
    parameters = {'solver.prior': str(common.HELD_OUT_LIFTER)}
    config = with_values(Config(), parameters)

    def by_keyframes(view: View) -> keyframe_method.KeyframeResult:
        size = view.intrinsics.image_size or (1, 1)
        given = KeypointSequence(view.keypoints, CMU15.joints, view.times, size, calibration=view.intrinsics)
        return keyframe_method.reconstruct(given, {ALL_MOTIONS: model}, config)

    ways: dict[str, Any] = {
        'keyframes': lambda v: by_keyframes(v).solved.poses.joints,
        'whole sequence': lambda v: common.reconstruct_whole(v, model, parameters),
        'tracker': lambda v: common.track(v, model, parameters).joints,
    }
    rows = []
    for name in list(SEQUENCES)[: 1 if report.quick else 2]:
        clean = make_mixed_view(SEQUENCES[name], seconds)
        bad = degrade_view(clean)
        there = bad.corrupted
        for way, reconstruct in common.show_progress(ways.items(), name):
            one = common.compute_frame_errors(clean, reconstruct(clean))
            found, took_s = common.measure_time(partial(reconstruct, bad.view))
            two = common.compute_frame_errors(clean, found)
            errors = np.nanmean(one), np.nanmean(two), np.nanmean(two[there])
            cells = [*(f'{e:.0f}' for e in errors), f'{errors[2] / np.nanmean(one[there]):.2f}', f'{took_s:.1f}']
            rows.append([f'{name}: {way}', *cells])
        corrupted = by_keyframes(bad.view)
        found_share, false_share = (corrupted.outliers[m].mean() for m in (bad.wrong, bad.untouched))
        rates = ', '.join(f'{len(half.frames) / seconds:.2f}' for half in corrupted.keyframes)
        report.text(f'{name}: {found_share:.1%} of outliers found, {false_share:.1%} of correct points called so')
        report.text(f'{name}, corrupted: {rates} keyframes a second of the upper and the lower body')
    header = [
        'sequence and method',
        'clean',
        'corrupted',
        'corrupted frames only',
        'corrupted frames / clean',
        'CPU s',
    ]
    report.table(header, rows, 'Keyframes, whole sequences and tracker: MPJPE, mm', 'keyframes.methods')


if __name__ == '__main__':
    run(__doc__, {'methods': report_methods})
