"""From key poses to a smooth first motion (Loy et al. 2004, section 6.1).

Limbs are unit vectors in the camera's frame; a control point is a frame whose pose is taken for that of its
keyframe. Between control points limbs turn at constant speed (Shoemake 1985, spherical linear interpolation).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.filters import median
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

Bones = Sequence[tuple[int, int]]

ROBUST = 0.1
SMALLEST = 1e-9
NEARLY_OPPOSITE = np.pi - 0.05


def limb_directions(poses: Array, bones: Bones) -> Array:
    """(..., J, 3) -> (..., B, 3) unit vectors from parent to child."""
    parents, children = (list(side) for side in zip(*bones, strict=True))
    limbs = poses[..., children, :] - poses[..., parents, :]
    return np.asarray(limbs / np.maximum(np.linalg.norm(limbs, axis=-1, keepdims=True), SMALLEST))


def pose_of(directions: Array, lengths: Array, skeleton: Skeleton) -> Array:
    """(..., B, 3) limb directions and (..., B) lengths, of `skeleton.bones` -> (..., J, 3) about the mean."""
    number = {bone: i for i, bone in enumerate(skeleton.bones)}
    out = np.zeros((*directions.shape[:-2], len(skeleton.joints), 3))
    for bone in skeleton.outward():
        parent, child = bone
        i = number[bone]
        out[..., child, :] = out[..., parent, :] + lengths[..., i, None] * directions[..., i, :]
    return out - out.mean(axis=-2, keepdims=True)


def misfits(keys: Array, points: Array, seen: NDArray[np.bool_]) -> Array:
    """(N,) robust mean distance of reprojected key poses from frames, torso lengths, translation removed.

    Args:
        keys: (N, J, 2) reprojected 3D key poses, torso lengths.
        points: (N, J, 2) of the frames, torso lengths.
        seen: (N, J) joints of the frames.
    """
    difference = np.where(seen[..., None], keys - points, np.nan)
    difference = np.nan_to_num(difference - median(difference, axis=1)[:, None])
    loss = np.where(seen, np.log1p((difference**2).sum(axis=-1) / ROBUST**2), 0.0)
    return np.asarray(ROBUST * np.sqrt(loss.sum(axis=1) / np.maximum(seen.sum(axis=1), SMALLEST)))


def thinned(keyframe: Indices, misfit: Array, times: Array, gap: float) -> Indices:
    """Control points: of each run of frames with one keyframe, the worst fitting are dropped.

    Args:
        keyframe: (F,) which keyframe represents each frame, -1 for frames that none represents well.
        misfit: (F,) of each frame to its key pose.
        times: (F,) s, increasing.
        gap: T, s; dropping a frame must not leave control points further apart. The best fitting one always stays.

    Returns:
        Frames, increasing.
    """
    at = np.flatnonzero(keyframe >= 0)
    before = dict(zip(at[1:].tolist(), at[:-1].tolist(), strict=True))
    after = dict(zip(at[:-1].tolist(), at[1:].tolist(), strict=True))
    kept = dict.fromkeys(at.tolist(), True)
    breaks = np.flatnonzero((np.diff(at) > 1) | (np.diff(keyframe[at]) != 0)) + 1
    for run in np.split(at, breaks):
        for frame in run[np.argsort(-misfit[run], kind='stable')][:-1].tolist():
            a, b = before.get(frame), after.get(frame)
            if a is None or b is None or times[b] - times[a] > gap:
                continue
            kept[frame] = False
            after[a], before[b] = b, a
    return np.array([frame for frame in at.tolist() if kept[frame]], int)


def slerp(directions: Array, knots: Array, times: Array) -> Array:
    """Unit vectors between those at some times; held before the first and after the last.

    Args:
        directions: (C, B, 3) unit vectors.
        knots: (C,) s, increasing.
        times: (F,) s.

    Returns:
        (F, B, 3) unit vectors. Nearly opposite ones are joined by way of whatever straight interpolation meets.
    """
    after = np.clip(np.searchsorted(knots, times), 0, len(knots) - 1)
    before = np.maximum(after - 1, 0)
    share = np.clip((times - knots[before]) / np.maximum(knots[after] - knots[before], SMALLEST), 0, 1)
    share = np.where(before == after, 0.0, share)[:, None, None]
    a, b = directions[before], directions[after]
    cosine = np.clip((a * b).sum(axis=-1, keepdims=True), -1, 1)
    angle = np.clip(np.arccos(cosine), 1e-6, NEARLY_OPPOSITE)
    mixed = (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)
    length = np.linalg.norm(mixed, axis=-1, keepdims=True)
    return np.asarray(np.where(length > SMALLEST, mixed / np.maximum(length, SMALLEST), a))
