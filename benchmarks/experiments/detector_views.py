# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture as detectors see it: trials of `data/motion` through the protocol's models of detectors.

The protocol's own code makes the views and draws the errors. Where a view should lack some of the errors, its
table `DETECTORS` is changed for a while; what it does to left and right is recorded.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray

from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CLEAN = 'clean'  # no detector: the true image points with scores of 1
DETECTORS = (CLEAN, 'openpose', 'mediapipe', 'movenet')
# Options of the protocol for the two cameras; the perspective one is 3 m from the nearest point of the person.
CAMERAS: Mapping[str, dict[str, float]] = {'orthographic': {}, 'perspective': {'distance': 3.0}}
HEADING_STEP_DEG = 77.0  # degrees between the headings of successive trials, so that they come from all sides
SEED_STEP_DEG = 120.0  # degrees between the headings of successive seeds
# Errors of a detector that are taken away, as values of `DETECTORS` of the protocol. The scores, and which points
# are missing, stay as they are.
_NO_OFFSETS: dict[str, Any] = {'offset': 0.0, 'mean': {}}
_NO_SWAPS: dict[str, Any] = {'swap': (0.0, 0.0, 0.0)}
_NO_NOISE: dict[str, Any] = {'slow': 0.0, 'white': 0.0, 'astray': 0.0}
ORACLES: Mapping[str, dict[str, Any]] = {
    'true 2D points': _NO_OFFSETS | _NO_SWAPS | _NO_NOISE,
    'no offsets': _NO_OFFSETS,
    'no swaps': _NO_SWAPS,
    'no noise': _NO_NOISE,
}


@functools.cache
def load_motion() -> tuple[Mapping[str, Array], list[str], dict[str, dict[str, str]]]:
    """Load the trials, (F, 26, 3) mm with y up, the names of their joints, and their rows of the manifest."""
    folder = common.data_path('data', 'motion')
    archive = np.load(folder / 'body26_30fps.npz')
    with (folder / 'manifest.csv').open(newline='', encoding='utf-8') as file:
        rows = {row['trial']: row for row in csv.DictReader(file)}
    return archive, [str(j) for j in archive['_joints']], rows


def load_middle(trial: str, frames: int) -> Array:
    """Load the poses (F, 26, 3) mm in the middle of a trial: many trials begin and end standing."""
    poses = load_motion()[0][trial].astype(float)
    first = max(len(poses) - frames, 0) // 2
    return poses[first : first + frames]


def choose_trials(persons: str, count: int, min_frames: int = 0) -> list[str]:
    """Return the longest trials of each kind of motion, so that no person and no motion dominates.

    Args:
        persons: `held-out` for people on whom no model is trained, each with trials of their own; `training` for
            all others together.
        count: largest number of trials for each category, and for each of the held-out people.
        min_frames: frames of the shortest trial.
    """
    groups: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for name, row in load_motion()[2].items():
        is_held_out, frames = row['subject'] in common.HELD_OUT_SUBJECTS, int(row['frames'])
        if is_held_out == (persons == 'held-out') and frames >= min_frames:
            person = row['subject'].partition('_')[0] if is_held_out else ''
            groups.setdefault((person, row['category']), []).append((-frames, name))
    return [name for group in groups.values() for _, name in sorted(group)[:count]]


@dataclass(frozen=True)
class ViewOptions:
    """How a trial is seen.

    Attributes:
        trial: name of the trial.
        detector: name of the detector.
        camera: key of `CAMERAS`.
        heading: degrees, direction from which the camera looks at the person.
        frames: largest number of frames, from the middle.
        seed: seed of the detector's errors.
        oracle: key of `ORACLES`, or empty for all of the detector's errors.
    """

    trial: str
    detector: str
    camera: str
    heading: float
    frames: int
    seed: int
    oracle: str = ''

    @property
    def category(self) -> str:
        return load_motion()[2][self.trial]['category']


def list_views(
    trials: Sequence[str], detectors: Sequence[str], frames: int, seeds: Sequence[int], oracle: str = ''
) -> list[ViewOptions]:
    """Return one view for each trial, seed and detector, with headings and cameras in turn."""
    cameras = list(CAMERAS)
    return [
        ViewOptions(
            trial,
            detector,
            cameras[(number + seed) % len(cameras)],
            (number * HEADING_STEP_DEG + seed * SEED_STEP_DEG) % 360,
            frames,
            seed,
            oracle,
        )
        for number, trial in enumerate(trials)
        for seed in seeds
        for detector in detectors
    ]


@dataclass(frozen=True, eq=False)
class DetectedView:
    """A trial as a detector sees it, F frames.

    Attributes:
        view: the sequence, truth included.
        body: (F, 26, 3) m, true joints with y up.
        is_swapped: (F, 15) True where the detector took a joint for its counterpart on the other side.
    """

    view: View
    body: Array
    is_swapped: Bools

    @property
    def times(self) -> Array:
        return self.view.sequence['timestamps']

    @property
    def keypoints(self) -> Array:
        return self.view.sequence['keypoints'].astype(float)

    @property
    def truth(self) -> Array:
        return self.view.true_poses


@contextmanager
def _record_orders() -> Iterator[list[NDArray[np.intp]]]:
    """Collect, for every view made meanwhile, the joint (F, J) that the detector took each joint for."""
    protocol, orders = common.load_protocol(), []
    detect: Callable[..., tuple[Array, Array, Array, NDArray[np.intp]]] = protocol.detect

    @functools.wraps(detect)
    def detect_and_record(*args: Any) -> tuple[Array, Array, Array, NDArray[np.intp]]:
        out = detect(*args)
        orders.append(out[3])
        return out

    protocol.__dict__['detect'] = detect_and_record
    try:
        yield orders
    finally:
        protocol.__dict__['detect'] = detect


@contextmanager
def _change_errors(detector: str, changes: Mapping[str, Any]) -> Iterator[None]:
    """Replace some of the protocol's values for a detector meanwhile."""
    table: dict[str, dict[str, Any]] = common.load_protocol().DETECTORS
    before = table[detector]
    table[detector] = {**before, **changes}
    try:
        yield
    finally:
        table[detector] = before


def make_view(options: ViewOptions) -> DetectedView:
    """Return a trial as a detector sees it."""
    joints, poses = load_motion()[1], load_middle(options.trial, options.frames)
    chosen: dict[str, Any] = {'frames': options.frames, 'seed': options.seed, **CAMERAS[options.camera]}
    order = np.tile(np.arange(len(joints)), (len(poses), 1))
    make = functools.partial(common.load_protocol().make_view, poses, joints, options.heading, **chosen)
    if options.detector == CLEAN:
        sequence = make()
    else:
        changes = ORACLES[options.oracle] if options.oracle else {}
        with _change_errors(options.detector, changes), _record_orders() as orders:
            sequence = make(detector=options.detector)
        (order,) = orders
    columns = [joints.index(name) for name in CMU15.joints]
    is_swapped = (order != np.arange(len(joints)))[:, columns]
    return DetectedView(View(sequence, options.heading), poses / 1e3, is_swapped)
