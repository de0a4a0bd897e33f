# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The set of keyframes of a sequence of any length (Loy et al. 2004, section 4).

Up to `keyframes.max_matrix_frames` frames the distance matrix D covers the whole sequence, and the selection is
the paper's. A longer sequence is processed section by section, so that a section bounds the memory. In each
section the keyframes of earlier sections first represent the frames that they can; the section then adds the
keyframes that it still needs. This differs from one whole matrix in three ways: a later keyframe cannot replace an
earlier one, D is de-noised within its section only, and max B is that of the first section. An earlier keyframe is
compared with the frames of later sections by the mean pose of the frames at a distance less than beta from it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import KeyframesConfig
from mocap_ros.offline.keyframes.body_halves import BodyHalf, HalfPoses
from mocap_ros.offline.keyframes.distance import build_averaging_matrix, compute_distances, denoise_distances
from mocap_ros.offline.keyframes.selection import find_interpolatable, select_keyframes

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

MIN_WEIGHT = 1e-9  # guards the division by the number of frames that show a joint


@dataclass(frozen=True, eq=False)
class KeyframeSet:
    """The keyframes K of one half of the body, and the frames that they represent.

    Attributes:
        body_half: half of the body.
        frames: (K,) indices of the keyframes in the sequence, in the order of selection.
        nearest: (F,) index into `frames` of the keyframe nearest to each frame; -1 where the frame has no pose.
        distance: (F,) torso lengths, distance D to that keyframe; infinite where the frame has no pose.
        well_represented: (F,) True for the frames of W: the nearest keyframe is closer than beta.
        covered: (F,) True for the frames of W u J: well represented or interpolatable.
        has_pose: (F,) True for the frames that show enough joints of this half.
        distance_matrix: (N, N) torso lengths, D of the first section.
        matrix_frames: (N,) frame indices of the rows and columns of `distance_matrix`.
    """

    body_half: BodyHalf
    frames: Indices
    nearest: Indices
    distance: Array
    well_represented: Mask
    covered: Mask
    has_pose: Mask
    distance_matrix: Array32
    matrix_frames: Indices

    @property
    def coverage(self) -> float:
        """Share of the frames with a pose that are covered: |W u J| / N of eq. 1."""
        return float(self.covered.sum() / max(self.has_pose.sum(), 1))

    @property
    def chronological_order(self) -> Indices:
        """(K,) indices into `frames` that sort the keyframes by time."""
        return np.argsort(self.frames, kind='stable')

    @property
    def assignment(self) -> Indices:
        """(F,) index into `frames` of the keyframe that represents each frame well, -1 where none does."""
        return np.where(self.well_represented, self.nearest, -1)

    def find_runs(self, keyframe: int) -> list[tuple[int, int]]:
        """Return the first and last frame of every run of frames assigned to a keyframe (index into `frames`)."""
        assigned = np.flatnonzero(self.assignment == keyframe)
        runs = np.split(assigned, np.flatnonzero(np.diff(assigned) > 1) + 1) if len(assigned) else []
        return [(int(run[0]), int(run[-1])) for run in runs]


def find_keyframe_set(poses: HalfPoses, half: BodyHalf, frames: int, config: KeyframesConfig) -> KeyframeSet:
    """Find the keyframes of one half of the body, of whose 2D poses there are some in a number of frames.

    Of the parameters, `alpha`, `beta`, `gap` and `max_matrix_frames` apply.
    """
    sections = np.array_split(np.arange(len(poses)), max(-(-len(poses) // config.max_matrix_frames), 1))
    keyframes: list[Indices] = []
    mean_poses = poses.subset(slice(0))
    nearest, distance = np.full(len(poses), -1), np.full(len(poses), np.inf, np.float32)
    first_matrix = np.zeros((0, 0), np.float32)
    max_b: float | None = None
    for section in sections if len(poses) else ():
        section_poses = poses.subset(section)
        c, max_b = compute_distances(section_poses, section_poses, max_b)
        averaging = build_averaging_matrix(c, config.beta)
        matrix = denoise_distances(c, averaging)
        np.fill_diagonal(matrix, 0.0)
        rows = matrix[:0]
        if len(mean_poses):
            rows = denoise_distances(compute_distances(mean_poses, section_poses, max_b)[0], averaging)
        represented_before = np.asarray((rows < config.beta).any(axis=0))
        represents = matrix < config.beta
        selected = select_keyframes(represents, section_poses.times, config.alpha, config.gap, represented_before)
        keyframes.append(section[selected])
        rows = np.concatenate([rows, matrix[selected]])
        if len(rows):
            nearest[section] = rows.argmin(axis=0)
            distance[section] = rows.min(axis=0)
        section_means = average_similar_poses(section_poses, averaging[selected], selected)
        mean_poses = concatenate_poses(mean_poses, section_means)
        first_matrix = first_matrix if len(first_matrix) else matrix
    well_represented = distance < config.beta

    def expand(values: NDArray[Any] | bool, unknown: float) -> NDArray[Any]:
        out = np.full(frames, unknown)
        out[poses.frames] = values
        return out

    return KeyframeSet(
        body_half=half,
        frames=poses.frames[np.concatenate([np.zeros(0, int), *keyframes])],
        nearest=expand(nearest, -1),
        distance=expand(distance, np.inf),
        well_represented=expand(well_represented, False),
        covered=expand(well_represented | find_interpolatable(well_represented, poses.times, config.gap), False),
        has_pose=expand(True, False),
        distance_matrix=first_matrix,
        matrix_frames=poses.frames[: len(first_matrix)],
    )


def average_similar_poses(poses: HalfPoses, averaging: Array32, keyframes: Indices) -> HalfPoses:
    """Return, for each keyframe, the mean pose of the frames at a distance less than beta.

    Args:
        poses: N poses.
        averaging: (K, N) the keyframes' rows of the averaging matrix M.
        keyframes: (K,) indices into `poses`.

    Returns:
        K poses; a joint that the keyframe does not show counts as not seen.
    """
    weight = averaging[..., None] * poses.seen
    seen = poses.seen.astype(np.float32)
    centroid = (seen[..., None] * poses.points).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    centred = poses.points - centroid[:, None]
    total = np.maximum(weight.sum(axis=1), MIN_WEIGHT)
    mean = np.einsum('knj,njd->kjd', weight, centred) / total[..., None]
    return HalfPoses(
        poses.frames[keyframes], poses.times[keyframes], mean.astype(np.float32), poses.seen[keyframes]
    )


def concatenate_poses(a: HalfPoses, b: HalfPoses) -> HalfPoses:
    """Return the poses of `a` followed by those of `b`."""
    return HalfPoses(*(np.concatenate([getattr(p, f.name) for p in (a, b)]) for f in fields(HalfPoses)))
