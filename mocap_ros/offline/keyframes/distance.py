"""Distances between the 2D poses of all frames (Loy et al. 2004, sections 4.1 and 4.2).

Where the paper matches edge elements of images, the input here is joints:

    C = A o B + (1 - A) max B

with B(i, j) the mean distance of the joints seen in both frames, the poses brought together by translation, in
torso lengths, and A(i, j) the share of joints seen in both among those seen in either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.body_halves import HalfPoses

Array32 = NDArray[np.float32]

BLOCK = 256


def joint_distances(a: HalfPoses, b: HalfPoses) -> tuple[Array32, Array32]:
    """B, torso lengths (0 where no joint is common), and A; both (Na, Nb)."""
    seen_a, seen_b = a.seen.astype(np.float32), b.seen.astype(np.float32)
    x_a, x_b = a.points * seen_a[..., None], b.points * seen_b[..., None]
    common = seen_a @ seen_b.T
    either = seen_a.sum(axis=1)[:, None] + seen_b.sum(axis=1) - common
    share = np.maximum(common, 1)
    offset = [(x_a[..., d] @ seen_b.T - seen_a @ x_b[..., d].T) / share for d in (0, 1)]
    total = np.zeros_like(common)
    whole = bool(a.seen.all() and b.seen.all())
    for j in range(a.points.shape[1]):
        dx = x_a[:, None, j, 0] - x_b[None, :, j, 0] - offset[0]
        dy = x_a[:, None, j, 1] - x_b[None, :, j, 1] - offset[1]
        dx *= dx
        dy *= dy
        dx += dy
        np.sqrt(dx, out=dx)
        if not whole:
            dx *= seen_a[:, None, j] * seen_b[None, :, j]
        total += dx
    return total / share, common / np.maximum(either, 1)


def distances(a: HalfPoses, b: HalfPoses, largest: float | None = None) -> tuple[Array32, float]:
    """C between two sets of poses, and the max B that went into it.

    Args:
        a: Na poses.
        b: Nb poses; `a` itself halves the work.
        largest: max B, torso lengths; None for that of these poses.

    Returns:
        (Na, Nb) torso lengths, and max B.
    """
    c = np.empty((len(a), len(b)), np.float32)
    shares = np.empty_like(c)
    for first in range(0, len(a), BLOCK):
        rows = slice(first, first + BLOCK)
        for start in range(first if a is b else 0, len(b), BLOCK):
            columns = slice(start, start + BLOCK)
            c[rows, columns], shares[rows, columns] = joint_distances(a.take(rows), b.take(columns))
            if a is b and start > first:
                c[columns, rows], shares[columns, rows] = c[rows, columns].T, shares[rows, columns].T
    most = float(c.max(initial=0.0)) if largest is None else largest
    c *= shares
    np.subtract(1, shares, out=shares)
    shares *= np.float32(most)
    c += shares
    return c, most


def averaging(c: Array32, beta: float) -> Array32:
    """(N, N) matrix whose products average over the frames nearer than beta (a frame is near itself)."""
    near = (c < beta).astype(np.float32)
    np.fill_diagonal(near, 1)
    near /= near.sum(axis=1, keepdims=True)
    return near


def denoised(c: Array32, near: Array32) -> Array32:
    """D: every row and column of C replaced by the mean of those of the frames near it (section 4.2).

    Args:
        c: (N, N), or (M, N) whose rows are not to be averaged again.
        near: (N, N) as of `averaging`.
    """
    rows = near @ c if len(c) == len(near) else c
    return np.asarray(rows @ near.T)
