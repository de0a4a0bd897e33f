# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The 2D poses of the upper and the lower half of the body, and their distances (Loy et al. 2004, section 4).

Trunk, arms and head are the upper half, legs the lower one. Poses are measured in torso lengths. The distance
matrix between those of all frames (sections 4.1 and 4.2) is

    C(i, j) = A(i, j) B(i, j) + (1 - A(i, j)) max B
    D = M C M^T      with M(i, k) = [C(i, k) < beta] / #{k : C(i, k) < beta}

B(i, j) is the mean distance between the joints seen in both frames, after one pose is translated onto the other,
and A(i, j) their number divided by that of those seen in either. (The paper compares edge elements of images.) D
is de-noised: the mean over the frames at a distance less than beta.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Array32, Mask
from mocap_ros.offline.keyframes.image_points import build_low_pass_matrix, interpolate_gaps
from mocap_ros.skeleton import CMU15, Skeleton

MIN_SEEN_JOINTS = 4  # joints; a half with fewer seen joints fits almost any pose once it is translated
LOW_PASS_S = 0.05  # s, standard deviation; removes the detector's jitter, which would add to every distance
TORSO_STEP_S = 0.5  # s between estimates of the torso length, which changes slowly with the person's distance
TORSO_HALF_WINDOW_S = 1.5  # s; half of the 3 s whose frames take part in one estimate of the torso length
TORSO_PERCENTILE = 75  # %; above the median since foreshortening only shortens, below the highest for outliers
MIN_TORSO_PX = 1e-9  # px; guards the division by the torso length when all joints are in one place
MIN_FILTER_WEIGHT = 1e-6  # guards the division below where no frame near in time sees the joint


@dataclass(frozen=True)
class BodyHalf:
    """The joints and bones of one half of the body."""

    name: str  # `upper` or `lower`
    joints: tuple[int, ...]  # indices into the skeleton's joints, increasing; the pelvis is in both halves
    # (parent, child) joint indices; each bone of the skeleton is in one half only
    bones: tuple[tuple[int, int], ...]


def split_into_halves(skeleton: Skeleton = CMU15) -> tuple[BodyHalf, BodyHalf]:
    """Return the upper and the lower half of a skeleton."""
    legs = [skeleton.index(side + joint) for joint in ('hip', 'knee', 'ankle') for side in 'lr']
    lower = tuple(b for b in skeleton.bones if b[1] in legs)
    upper = tuple(b for b in skeleton.bones if b[1] not in legs)
    return (
        BodyHalf('upper', tuple(sorted({j for bone in upper for j in bone})), upper),
        BodyHalf('lower', tuple(sorted({j for bone in lower for j in bone})), lower),
    )


@dataclass(frozen=True, eq=False)
class HalfPoses:
    """The 2D poses of one half of the body, in the frames that show enough joints of that half."""

    frames: NDArray[np.intp]  # (N,) indices of these frames in the sequence, increasing
    times: Array  # (N,) s
    points: Array32  # (N, J, 2) torso lengths, up to a translation; arbitrary where not seen
    seen: Mask  # (N, J) True where a joint is seen or interpolated

    def __len__(self) -> int:
        return len(self.frames)

    def subset(self, index: NDArray[np.intp] | slice) -> HalfPoses:
        """Return the poses of the frames at the given positions."""
        return HalfPoses(self.frames[index], self.times[index], self.points[index], self.seen[index])


def extract_half_poses(points: Array, weight: Array, times: Array, half: BodyHalf, max_gap: float) -> HalfPoses:
    """Return the low-passed 2D poses of one half of the body; gaps of at most `max_gap` s are interpolated."""
    in_torsos = points / estimate_torso_lengths(points, weight, times)[:, None, None]
    joints = list(half.joints)
    low_pass = build_low_pass_matrix(times, LOW_PASS_S)
    seen = weight > 0
    filter_weight = np.maximum(low_pass @ seen, MIN_FILTER_WEIGHT)
    in_torsos = np.stack([(low_pass @ (in_torsos[..., d] * seen)) / filter_weight for d in (0, 1)], axis=-1)
    half_points, known = interpolate_gaps(in_torsos[:, joints], weight[:, joints] > 0, times, max_gap)
    frames = np.flatnonzero(known.sum(axis=1) >= MIN_SEEN_JOINTS)
    return HalfPoses(frames, times[frames], half_points[frames].astype(np.float32), known[frames])


def estimate_torso_lengths(points: Array, weight: Array, times: Array) -> Array:
    """Estimate the lengths (F,) that the torso (pelvis to neck) would have in the image without foreshortening.

    It is the upper quartile of those seen within 3 s or, if none is, one size of the body's image.
    """
    neck, pelvis = CMU15.index('neck'), CMU15.index('pelvis')
    torso_frames = np.flatnonzero((weight[:, [neck, pelvis]] > 0).all(axis=1))
    if not len(torso_frames):
        seen = points[weight > 0]
        size = max(float(np.sqrt(seen.var(axis=0).sum())), MIN_TORSO_PX) if len(seen) else 1.0
        return np.full(len(times), size)
    length = np.linalg.norm(points[torso_frames, neck] - points[torso_frames, pelvis], axis=-1)
    knots = np.arange(times[0], times[-1] + TORSO_STEP_S, TORSO_STEP_S)
    first = np.searchsorted(times[torso_frames], knots - TORSO_HALF_WINDOW_S)
    last = np.searchsorted(times[torso_frames], knots + TORSO_HALF_WINDOW_S, side='right')
    known = np.flatnonzero(last > first)
    at_knots = [np.percentile(length[first[k] : last[k]], TORSO_PERCENTILE) for k in known]
    return np.maximum(np.interp(times, knots[known], at_knots), MIN_TORSO_PX)


BLOCK_FRAMES = 256  # frames on a side of the blocks computed at once; bounds the memory of the temporaries


def compare_poses(a: HalfPoses, b: HalfPoses) -> tuple[Array32, Array32]:
    """Return B (Na, Nb) in torso lengths, 0 without common joints, and A (Na, Nb) between poses of one half."""
    seen_a, seen_b = a.seen.astype(np.float32), b.seen.astype(np.float32)
    x_a, x_b = a.points * seen_a[..., None], b.points * seen_b[..., None]
    common = seen_a @ seen_b.T
    either = seen_a.sum(axis=1)[:, None] + seen_b.sum(axis=1) - common
    divisor = np.maximum(common, 1)
    translation = [(x_a[..., d] @ seen_b.T - seen_a @ x_b[..., d].T) / divisor for d in (0, 1)]
    total = np.zeros_like(common)
    all_seen = bool(a.seen.all() and b.seen.all())
    for j in range(a.points.shape[1]):
        dx = x_a[:, None, j, 0] - x_b[None, :, j, 0] - translation[0]
        dy = x_a[:, None, j, 1] - x_b[None, :, j, 1] - translation[1]
        dx *= dx
        dy *= dy
        dx += dy
        np.sqrt(dx, out=dx)
        if not all_seen:
            dx *= seen_a[:, None, j] * seen_b[None, :, j]
        total += dx
    return total / divisor, common / np.maximum(either, 1)


def compute_distances(a: HalfPoses, b: HalfPoses, max_b: float | None = None) -> tuple[Array32, float]:
    """Return the initial distance matrix C (Na, Nb), and the max B used in it, in torso lengths.

    Passing `a` itself as `b` saves half of the work.
    """
    c = np.empty((len(a), len(b)), np.float32)
    shares = np.empty_like(c)
    for first in range(0, len(a), BLOCK_FRAMES):
        rows = slice(first, first + BLOCK_FRAMES)
        for start in range(first if a is b else 0, len(b), BLOCK_FRAMES):
            columns = slice(start, start + BLOCK_FRAMES)
            c[rows, columns], shares[rows, columns] = compare_poses(a.subset(rows), b.subset(columns))
            if a is b and start > first:
                c[columns, rows], shares[columns, rows] = c[rows, columns].T, shares[rows, columns].T
    if max_b is None:
        max_b = float(c.max(initial=0.0))
    c *= shares
    np.subtract(1, shares, out=shares)
    shares *= np.float32(max_b)
    c += shares
    return c, max_b


def build_averaging_matrix(c: Array32, beta: float) -> Array32:
    """Return the averaging matrix M (N, N) of C (N, N) in torso lengths (section 4.2)."""
    m = (c < beta).astype(np.float32)
    np.fill_diagonal(m, 1)
    m /= m.sum(axis=1, keepdims=True)
    return m


def denoise_distances(c: Array32, averaging: Array32) -> Array32:
    """Return D = M C M^T (section 4.2); rows of C (K, N), from K mean poses, are not averaged again."""
    rows = averaging @ c if len(c) == len(averaging) else c
    return np.asarray(rows @ averaging.T)
