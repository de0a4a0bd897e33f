# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which swaps of left and right are undone, and which joints are exchanged that were not swapped.

What is undone is read from the solver's input, so it holds for any way of deciding it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from reconstruction import Models, track

from experiments.detector_views import DetectedView
from mocap_ros.config import Config, with_settings
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import observe_sequence

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MIN_SWAP_FRAMES = 2  # frames; a swap of a single frame is hard to tell from an error of the detector
# Joints of the limbs; the protocol's detectors swap legs and arms alone without the shoulders.
LEGS, ARMS = ('hip', 'knee', 'ankle'), ('elbow', 'wrist')
LIMBS = np.array([n.endswith((*LEGS, *ARMS, 'shoulder')) for n in CMU15.joints])
KINDS = ('whole body', 'legs', 'arms')


def find_exchanged(way: str, seen: DetectedView, models: Models, config: Config) -> tuple[Bools, Bools]:
    """Return the joints (F, 15) that the solver gets from the other side, and those that it gets at all.

    Live, the decision about a frame is the one that was in force when it was the newest.
    """
    view = seen.view
    if way == 'whole':
        detected, corrected = (
            observe_sequence(
                seen.keypoints,
                view.joint_names,
                seen.times,
                view.intrinsics,
                with_settings(config, {'tracker.undo_swaps': on}).tracker,
            )
            for on in (False, True)
        )
        return _compare_labels(detected.rays, corrected.rays, corrected.weight), corrected.weight > 0
    exchanged, given = np.zeros((2, view.frames, len(CMU15.joints)), bool)
    for frame, window in enumerate(track(view, models, config).newest):
        if window is not None:
            newest = window.observed.select_frames(slice(-1, None))
            exchanged[frame] = _compare_labels(window.rays[-1:], newest.rays, newest.weight)[0]
            given[frame] = newest.weight[0] > 0
    return exchanged, given


def _compare_labels(detected: Array, corrected: Array, weight: Array) -> Bools:
    """Return which joints (F, J) of the corrected rays are the detected rays (F, J, 2) of the other side."""
    own, other = (np.all(corrected == d, axis=-1) for d in (detected, detected[:, list(CMU15.mirror)]))
    return np.asarray((weight > 0) & other & ~own)


def find_runs(on: Bools) -> list[slice]:
    """Return the runs of True of a mask (F,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False]))))
    return [slice(a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def count_swaps(swapped: Bools, exchanged: Bools, given: Bools) -> dict[str, Any]:
    """Count the true swaps, those that were undone, and the frames in which joints were exchanged wrongly.

    A frame of a swap is undone if every joint of the limbs that the detector swapped, and that the solver gets, is
    exchanged. A frame is wrong if any joint of the limbs is exchanged that was not swapped.

    Args:
        swapped: (F, 15) joints that the detector swapped.
        exchanged: (F, 15) joints that were exchanged.
        given: (F, 15) joints that the solver gets.
    """
    true, done, given = swapped[:, LIMBS], exchanged[:, LIMBS], given[:, LIMBS]
    legs, arms = (np.array([n.endswith(k) for n in CMU15.joints])[LIMBS] for k in (LEGS, ARMS))
    in_kind: dict[str, Bools] = {
        'whole body': np.asarray(true.all(axis=1)),
        'legs': np.asarray(true[:, legs].all(axis=1) & ~true[:, ~legs].any(axis=1)),
        'arms': np.asarray(true[:, arms].all(axis=1) & ~true[:, ~arms].any(axis=1)),
    }
    wrong = np.asarray((done & ~true).any(axis=1))
    undone = np.asarray((done | ~true | ~given).all(axis=1))
    out: dict[str, Any] = {
        'frames': len(true),
        'wrong': int(wrong.sum()),
        'wrong without swap': int((wrong & ~true.any(axis=1)).sum()),
        'longest wrong': max((s.stop - s.start for s in find_runs(wrong)), default=0),
    }
    for kind in KINDS:
        runs = find_runs(in_kind[kind])
        long = [s for s in runs if s.stop - s.start >= MIN_SWAP_FRAMES]
        single = [s for s in runs if s.stop - s.start < MIN_SWAP_FRAMES]
        out[kind] = {
            'swaps': len(long),
            'frames': sum(s.stop - s.start for s in long),
            'undone': sum(int(undone[s].sum()) for s in long),
            'single': len(single),
            'single undone': sum(int(undone[s].sum()) for s in single),
        }
    return out
