# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Greedy keyframe selection (Loy et al. 2004, section 4.3, eq. 1 to 4), in seconds instead of frames.

    |W u J| >= alpha N                                                                              (eq. 1)
    C_K = sum_i ( min_{f in W, f < i} |t_i - t_f| + min_{f in W, f > i} |t_i - t_f| )               (eq. 2)
    K <- K u {j},   j = argmin_k C_{K u {k}}                                                  (eq. 3 and 4)

W are the frames well represented by a keyframe k of K, D(k, f) < beta or f = k; J those between two frames of W
that are less than T apart. At the ends, one frame interval before the first and after the last frame count as in
W. For neighbours a and b in W with g frames between them, all terms of eq. 2 sum to (g + 2) T_ab, so C_K is a sum
over gaps, and a new keyframe changes only the gaps in which it represents a frame.

Beyond `keyframes.max_matrix_frames` frames, sections bound the memory: keyframes of earlier sections first
represent the frames that they can, by the mean pose of the frames nearer than beta. A later keyframe cannot
replace an earlier one, D is de-noised within its section, and max B is that of the first section.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Array32, Indices, Mask
from mocap_ros.config import KeyframesConfig
from mocap_ros.offline.keyframes.half_poses import (
    BodyHalf,
    HalfPoses,
    build_averaging_matrix,
    compute_distances,
    denoise_distances,
)

SINGLE_FRAME_INTERVAL_S = 1 / 30  # s; stands for the frame interval of a sequence of one frame, which has none
# relative; incremental sums differ by rounding from direct ones, so equal costs count as ties
TIE_TOLERANCE = 1e-9


def estimate_frame_interval(times: Array) -> float:
    """Return the median time in s between successive frames."""
    return float(np.median(np.diff(times))) if len(times) > 1 else SINGLE_FRAME_INTERVAL_S


def find_interpolatable(well_represented: Mask, times: Array, gap: float) -> Mask:
    """Return J (N,): the frames outside W, `well_represented`, between two frames of W less than `gap` s apart."""
    w_frames = np.flatnonzero(well_represented)
    out = np.zeros(len(well_represented), bool)
    if len(w_frames) > 1:
        right = np.searchsorted(w_frames, np.arange(len(well_represented)))
        inside = ~well_represented & (right > 0) & (right < len(w_frames))
        right = right[inside]
        out[inside] = times[w_frames[right]] - times[w_frames[right - 1]] < gap
    return out


def select_keyframes(
    represents: Mask, times: Array, alpha: float, gap: float, well_represented: Mask | None = None
) -> Indices:
    """Select keyframes by eq. 3 and 4 until eq. 1 holds; return their frames in the order of selection.

    Among candidates of equal cost the earliest is selected. Row k of `represents` (N, N) are the frames that k
    represents well, `well_represented` (N,) those of keyframes of earlier sections; `gap` is T in s.
    """
    represents = represents | np.eye(len(times), dtype=bool)
    initial = np.zeros(len(times), bool) if well_represented is None else well_represented.copy()
    costs = _CandidateCosts(represents, times, initial)
    keyframes: list[int] = []

    def count_covered() -> int:
        return int((costs.well_represented | find_interpolatable(costs.well_represented, times, gap)).sum())

    while count_covered() < alpha * len(times) and len(keyframes) < len(times):
        keyframes.append(costs.find_best_candidate())
        costs.add_keyframe(keyframes[-1])
    return np.array(keyframes, int)


@dataclass(eq=False)
class _CandidateCosts:
    """The costs C_{K u {k}} (eq. 2 to 4) of adding each frame k to the keyframes K.

    The costs are sums over the gaps between neighbours in W, the set of well-represented frames. A new keyframe
    changes only the terms of the gaps in which it represents a frame.
    """

    represents: Mask  # (N, N) True in row k for the frames that keyframe k represents well, k itself included
    times: Array  # (N,) s, increasing
    well_represented: Mask  # (N,) True for the frames of W
    cost: Array = field(init=False)  # (N,) s, C_{K u {k}} of each frame k
    is_keyframe: Mask = field(init=False)  # (N,) True for the frames of K
    # (N + 2,) s; `times` with one frame interval added before the first and after the last
    padded_times: Array = field(init=False)

    def __post_init__(self) -> None:
        step = estimate_frame_interval(self.times)
        self.padded_times = np.concatenate([[self.times[0] - step], self.times, [self.times[-1] + step]])
        self.cost = np.zeros(len(self.times))
        self.is_keyframe = np.zeros(len(self.times), bool)
        for first, last in self._split_gap(-1, len(self.times)):
            self.cost += self._compute_gap_costs(first, last)

    def find_best_candidate(self) -> int:
        """Return the candidate of least cost, or the earliest of those that differ by rounding only."""
        cost = np.where(self.is_keyframe, np.inf, self.cost)
        least = cost.min()
        return int(np.argmax(cost <= least + TIE_TOLERANCE * max(abs(least), 1.0)))

    def add_keyframe(self, keyframe: int) -> None:
        """Add a keyframe to K, and update the costs of the gaps in which it represents a frame."""
        newly_represented = np.flatnonzero(self.represents[keyframe] & ~self.well_represented)
        members = np.concatenate([[-1], np.flatnonzero(self.well_represented), [len(self.well_represented)]])
        changed_gaps = np.unique(np.searchsorted(members, newly_represented))
        self.well_represented = self.well_represented | self.represents[keyframe]
        self.is_keyframe[keyframe] = True
        for right in changed_gaps.tolist():
            first, last = int(members[right - 1]), int(members[right])
            self.cost -= self._compute_gap_costs(first, last)
            for a, b in self._split_gap(first, last):
                self.cost += self._compute_gap_costs(a, b)

    def _split_gap(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return the pairs of neighbours in W from `first` to `last`; -1 and N stand for the sequence's ends."""
        inside = np.flatnonzero(self.well_represented[max(first + 1, 0) : last]) + first + 1
        return list(pairwise([first, *inside.tolist(), last]))

    def _compute_gap_costs(self, first: int, last: int) -> Array:
        """Return (N,) s, the terms of eq. 2 between two neighbours in W, for each candidate added to W."""
        block = self.represents[:, first + 1 : last]
        candidate, frame = np.nonzero(block)
        frame = frame + first + 1
        head = np.searchsorted(candidate, np.arange(len(block)))
        has_frames = np.diff(head, append=len(candidate)) > 0
        # the next frame that the same candidate represents, or the end of the gap
        following = np.append(frame[1:], last)
        following[head[has_frames][1:] - 1] = last
        following[-1:] = last
        terms = np.bincount(candidate, self._compute_pair_cost(frame, following), minlength=len(block))
        first_frame = np.full(len(block), last)
        first_frame[has_frames] = frame[head[has_frames]]
        return np.asarray(terms + self._compute_pair_cost(np.full(len(block), first), first_frame))

    def _compute_pair_cost(self, a: Indices, b: Indices) -> Array:
        """Return (g + 2) T_ab in s for neighbours a < b in W; the sequence's ends have no terms of their own."""
        end_terms = (a >= 0).astype(int) + (b < len(self.times))
        return np.asarray((b - a - 1 + end_terms) * (self.padded_times[b + 1] - self.padded_times[a + 1]))


MIN_WEIGHT = 1e-9  # guards the division by the number of frames that show a joint


@dataclass(frozen=True, eq=False)
class KeyframeSet:
    """The keyframes K of one half of the body, and the frames that they represent."""

    body_half: BodyHalf
    frames: Indices  # (K,) indices of the keyframes in the sequence, in the order of selection
    # (F,) index into `frames` of the keyframe nearest to each frame; -1 where the frame has no pose
    nearest: Indices
    distance: Array  # (F,) torso lengths, distance D to that keyframe; infinite where the frame has no pose
    well_represented: Mask  # (F,) True for the frames of W: the nearest keyframe is closer than beta
    covered: Mask  # (F,) True for the frames of W u J: well represented or interpolatable
    has_pose: Mask  # (F,) True for the frames that show enough joints of this half
    distance_matrix: Array32  # (N, N) torso lengths, D of the first section
    matrix_frames: Indices  # (N,) frame indices of the rows and columns of `distance_matrix`

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
        both = ([getattr(p, f.name) for p in (mean_poses, section_means)] for f in fields(HalfPoses))
        mean_poses = HalfPoses(*map(np.concatenate, both))
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
    """Return K mean poses of the frames nearer than beta; joints that a keyframe lacks count as not seen."""
    weight = averaging[..., None] * poses.seen
    seen = poses.seen.astype(np.float32)
    centroid = (seen[..., None] * poses.points).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    centred = poses.points - centroid[:, None]
    total = np.maximum(weight.sum(axis=1), MIN_WEIGHT)
    mean = np.einsum('knj,njd->kjd', weight, centred) / total[..., None]
    return HalfPoses(
        poses.frames[keyframes], poses.times[keyframes], mean.astype(np.float32), poses.seen[keyframes]
    )
