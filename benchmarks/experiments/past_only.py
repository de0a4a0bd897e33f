# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The live result against a solution from scratch of the same past.

The live result of frame t comes from a tracker that has seen the frames up to t and no later one. The solution
from scratch has only the frames of the window [t - window, t] of the tracker, solves them as a sequence of their
own in all rounds, and its last frame is compared: the best that the solver makes of this past without regard to
time. The ratio of the two errors is what the tracker loses by solving little at every frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray
from reconstruction import Models, reconstruct_whole, track

from experiments.detector_views import CAMERAS, HEADING_STEP_DEG
from mocap_ros.config import Config
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

# Trials of 5 s and more of the persons that neither base poses nor lifter were trained on, by category of motion.
TRIALS: Mapping[str, tuple[str, ...]] = {
    'walk': ('UW_24', 'UW_50', '05_01'),
    'jump': ('UJ_01', 'UJ_02'),
    'dance': ('05_02', '05_13'),
    'martial arts': ('135_04', '135_09'),
    'gesture': ('UB_03', 'UT_01', 'UWW_01'),
}
# Models of detectors' errors of the protocol; None for clean points.
DETECTORS = (None, 'openpose', 'mediapipe', 'movenet')
MAX_FRAMES = 300  # frames of a trial, to limit the time
FIRST_S = 2.0  # s; before, the window is not full
STEP_FRAMES = 11  # frames from one solution from scratch to the next; no multiple of any interval of the tracker


def choose_frames(view: common.View) -> list[int]:
    """Return the frames that are compared."""
    first = int(np.searchsorted(view.sequence['timestamps'], FIRST_S))
    return list(range(first, view.frames, STEP_FRAMES))


def solve_past(view: common.View, frame: int, models: Models, config: Config) -> Array:
    """Return the pose (J, 3) m of a frame, solved from scratch from the frames of its window."""
    times = view.sequence['timestamps']
    first = int(np.searchsorted(times, times[frame] - config.tracker.window - 1e-6))
    return reconstruct_whole(view, models, config, slice(first, frame + 1))[-1]


def compute_error(view: common.View, joints: Array, frames: Sequence[int]) -> float:
    """Return the MPJPE of the protocol over some frames (poses about their centres, one scale), mm."""
    truth, names = view.sequence['joints3d'][frames], view.sequence['joints3d_names']
    found = common.load_protocol().score(joints, CMU15.joints, truth, names)
    if found['failed_frames']:
        raise AssertionError(f'{found["failed_frames"]} of {found["frames"]} frames have no result')
    return float(found['mpjpe_mm'])


def compare_view(view: common.View, models: Models, config: Config) -> tuple[float, float]:
    """Return the errors of the live result and of the solutions from scratch, mm."""
    frames = choose_frames(view)
    live = track(view, models, config).joints[frames]
    scratch = np.stack([solve_past(view, f, models, config) for f in frames])
    return compute_error(view, live, frames), compute_error(view, scratch, frames)


def compare_all(models: Models, config: Config, quick: bool) -> list[dict[str, Any]]:
    """Compare every trial under every detector and camera; `quick`: a trial and a camera, with two detectors.

    Returns:
        A record for each view: MPJPE over the sampled frames, mm, of the `live` result and from `scratch`.
    """
    trials = [(category, t) for category, names in TRIALS.items() for t in names]
    todo = [
        (number, category, trial, detector, camera)
        for number, (category, trial) in enumerate(trials[:1] if quick else trials)
        for detector in (DETECTORS[:2] if quick else DETECTORS)
        for camera in (list(CAMERAS)[:1] if quick else CAMERAS)
    ]
    out = []
    for number, category, trial, detector, camera in common.show_progress(todo, 'live and from scratch'):
        options: dict[str, Any] = {'frames': 110 if quick else MAX_FRAMES, 'detector': detector, **CAMERAS[camera]}
        (view,) = common.make_views(trial, [number * HEADING_STEP_DEG % 360], **options)
        about = {'category': category, 'detector': detector or 'clean', 'camera': camera}
        live, scratch = compare_view(view, models, config)
        out.append({**about, 'live': live, 'scratch': scratch})
    return out


def compute_ratio(comparisons: Sequence[Mapping[str, Any]]) -> float:
    """Return the mean live error over the mean error from scratch."""
    return float(sum(c['live'] for c in comparisons) / sum(c['scratch'] for c in comparisons))
