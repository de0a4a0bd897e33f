# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of face, feet and hands: where a person looks, where the feet point, and how far off the joints are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray
from reconstruction import Models, list_people, track_people

from experiments.detector_views import DetectedView
from mocap_ros.config import Config
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import BODY26, CORE_COUNT

Array = NDArray[np.float64]

START_FRAMES = 15  # frames at the beginning that do not count: nobody is known before
# Joints whose error is measured, and the core joint on which they hang.
OUTER = {
    'toes': (('ltoe', 'lankle'), ('rtoe', 'rankle')),
    'hands': (('lhand', 'lwrist'), ('rhand', 'rwrist')),
    'face': tuple((n, 'head') for n in ('nose', 'leye', 'reye', 'lear', 'rear')),
}
KEYS = ('head', 'feet', *OUTER, *(f'{name} alone' for name in OUTER), 'head tremble')


def reconstruct_body(way: str, seen: DetectedView, models: Models, config: Config) -> Array:
    """Return the poses (F, 26, 3) m of one of `reconstruction.WAYS`; NaN in frames without output."""
    view, times = seen.view, seen.times
    if way == 'whole':
        return reconstruct_sequence(
            seen.keypoints, view.joint_names, times, view.intrinsics, models, config
        ).joints
    out = np.full((view.frames, len(BODY26.joints), 3), np.nan)
    frames = [[p] for p in list_people(view)]
    for frame, (_, people) in enumerate(track_people(frames, times, view.intrinsics, models, config)):
        if people:
            out[frame] = people[0].joints
    return out


def find_directions(poses: Array) -> Array:
    """Return the directions (F, 3, 3) of the head, from the ears to the nose, and of the feet, heel to toe."""
    at = {name: poses[:, i] for i, name in enumerate(BODY26.joints)}
    head = at['nose'] - (at['lear'] + at['rear']) / 2
    directions = np.stack([head, at['ltoe'] - at['lheel'], at['rtoe'] - at['rheel']], axis=1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def compute_angles(first: Array, second: Array) -> Array:
    """Return the angles in degrees between unit vectors (..., 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1, 1))))


def measure_tremble(directions: Array) -> float:
    """Return the median angle in degrees between directions (F, 3) and those that two frames before lead to."""
    ahead = 2 * directions[1:-1] - directions[:-2]
    return float(np.median(compute_angles(directions[2:], ahead / np.linalg.norm(ahead, axis=-1, keepdims=True))))


def compute_extremity_errors(seen: DetectedView, poses: Array) -> dict[str, float]:
    """Return the median errors of directions in degrees, and the mean errors of joints in mm.

    Poses are about the mean of their core, with one scale for the sequence as in the MPJPE. `toes alone` and so on
    are the errors of the joints relative to the core joint on which they hang.
    """
    names = [str(n) for n in seen.view.sequence['joints3d_names']]
    truth = seen.view.sequence['joints3d'][:, [names.index(n) for n in BODY26.joints]].astype(float)
    known = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    known[:START_FRAMES] = False
    found, truth = (p[known] - p[known, :CORE_COUNT].mean(axis=1, keepdims=True) for p in (poses, truth))
    core, true_core = found[:, :CORE_COUNT], truth[:, :CORE_COUNT]
    found *= (core * true_core).sum() / (core * core).sum()
    directions, true_directions = find_directions(found), find_directions(truth)
    angles = compute_angles(directions, true_directions)
    out = {'head': float(np.median(angles[:, 0])), 'feet': float(np.median(angles[:, 1:]))}
    for name, pairs in OUTER.items():
        joints, anchors = (np.array([BODY26.index(pair[i]) for pair in pairs]) for i in (0, 1))
        error = found - truth
        out[name] = float(np.linalg.norm(error[:, joints], axis=-1).mean() * 1e3)
        out[f'{name} alone'] = float(np.linalg.norm(error[:, joints] - error[:, anchors], axis=-1).mean() * 1e3)
    return out | {'head tremble': measure_tremble(directions[:, 0])}


def summarise_extremities(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the means over the records: degrees, mm, mm of the joints alone, degrees of tremble."""
    mean = {k: common.mean_error(records, k) for k in KEYS}
    joints = ' / '.join(f'{mean[n]:.0f}' for n in OUTER)
    alone = ' / '.join(f'{mean[f"{n} alone"]:.0f}' for n in OUTER)
    return [f'{mean["head"]:.1f}', f'{mean["feet"]:.1f}', joints, alone, f'{mean["head tremble"]:.1f}']
