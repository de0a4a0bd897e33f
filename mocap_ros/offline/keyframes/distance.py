# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The distance matrix between the 2D poses of all frames (Loy et al. 2004, sections 4.1 and 4.2).

    C(i, j) = A(i, j) B(i, j) + (1 - A(i, j)) max B
    D = M C M^T      with M(i, k) = [C(i, k) < beta] / #{k : C(i, k) < beta}

The paper compares edge elements of images; this module compares joints. B(i, j) is the mean distance in torso
lengths between the joints seen in both frames, after one pose is translated onto the other. A(i, j) is the number
of joints seen in both frames divided by the number seen in either. D is the de-noised matrix: every row and
column of C is replaced by the mean over the frames at a distance less than beta.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.body_halves import HalfPoses

Array32 = NDArray[np.float32]

BLOCK_FRAMES = 256  # frames on a side of the blocks computed at once; bounds the memory of the temporaries


def compare_poses(a: HalfPoses, b: HalfPoses) -> tuple[Array32, Array32]:
    """Return B and A between Na and Nb poses of the same half of the body.

    Returns:
        B: (Na, Nb) torso lengths, 0 where the two frames have no joint in common.
        A: (Na, Nb) share of the seen joints that are seen in both frames.
    """
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
    """Return the initial distance matrix C (Na, Nb) in torso lengths, and the max B used in it.

    Args:
        a: Na poses.
        b: Nb poses; passing `a` itself saves half of the work, since C is then symmetric.
        max_b: max B, torso lengths; None for the largest B of these poses.
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
    """Return the averaging matrix M (N, N) of C (N, N) in torso lengths (section 4.2).

    Its row i takes the mean over the frames at a distance less than beta from frame i: these show the same pose,
    and so does the frame itself.
    """
    m = (c < beta).astype(np.float32)
    np.fill_diagonal(m, 1)
    m /= m.sum(axis=1, keepdims=True)
    return m


def denoise_distances(c: Array32, averaging: Array32) -> Array32:
    """Return the de-noised distance matrix D = M C M^T (section 4.2).

    C may be (K, N), distances from K mean poses, whose rows are not averaged again.
    """
    rows = averaging @ c if len(c) == len(averaging) else c
    return np.asarray(rows @ averaging.T)
