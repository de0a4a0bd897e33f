# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shots and sections of a long sequence."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.offline.keyframes.half_poses import estimate_torso_lengths
from mocap_ros.offline.keyframes.image_points import nan_median
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import MIN_JOINTS_FOR_CAMERA

CUT_DISPLACEMENT = 0.5  # torso lengths between frames; more than a body moves, less than it jumps at a cut
MAX_ABSENCE_S = 0.5  # s without a pose, after which the motion before no longer says which side is left


def split_into_sections(times: Array, max_seconds: float, margin: float) -> list[tuple[slice, slice]]:
    """Split the frames of a sequence into sections of about equal duration, with and without margins in s."""
    count = max(int(np.ceil((times[-1] - times[0]) / max_seconds)), 1)
    edges = np.searchsorted(times, np.linspace(times[0], times[-1], count + 1)[1:-1]).tolist()
    bounds = sorted({0, *edges, len(times)})
    out = []
    for first, last in pairwise(bounds):
        padded = np.searchsorted(times, [times[first] - margin, times[last - 1] + margin], side='left')
        out.append((slice(int(padded[0]), max(int(padded[1]), last)), slice(first, last)))
    return out


def find_shots(points: Array, weight: Array, times: Array) -> list[slice]:
    """Split a sequence into shots, the slices of frames between its cuts.

    A cut is where the median joint of points (F, J, 2) in any unit moves by more than `CUT_DISPLACEMENT`, or after
    more than `MAX_ABSENCE_S` without a pose. Swapped left and right are no cut.
    """
    pose_frames = np.flatnonzero((weight > 0).sum(axis=1) >= MIN_JOINTS_FOR_CAMERA)
    torso = estimate_torso_lengths(points, weight, times)[pose_frames[1:]]
    mirror = np.array(CMU15.mirror)
    before, after = pose_frames[:-1], pose_frames[1:]
    displacements = []
    for order in (np.arange(len(mirror)), mirror):  # with the labels as they are, and with left and right swapped
        both_seen = (weight[after] > 0) & (weight[before][:, order] > 0)
        moved = np.linalg.norm(points[after] - points[before][:, order], axis=-1)
        displacements.append(np.nan_to_num(nan_median(np.where(both_seen, moved, np.nan), axis=1)))
    displacement = np.minimum(*displacements)
    is_cut = (displacement > CUT_DISPLACEMENT * torso) | (np.diff(times[pose_frames]) > MAX_ABSENCE_S)
    bounds = [0, *after[is_cut].tolist(), len(times)]
    return [slice(a, b) for a, b in pairwise(bounds)]
