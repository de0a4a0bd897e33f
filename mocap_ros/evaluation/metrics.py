"""Errors of 3D poses against a reference, each with its alignment named (METHOD of the field and of the paper).

Poses are compared joint by joint over the joints both skeletons have. Unless said otherwise each pose is first
centred on the mean of those joints; millimetres throughout.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import centred, rotation_to
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]

LIMBS = (
    'lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist',
    'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle',
)  # fmt: skip
SEEN_SCORE = 0.2
SEEN_LIMBS = 8


def common_joints(
    predicted: Sequence[str], truth: Sequence[str], limbs_only: bool = False
) -> tuple[list[int], list[int]]:
    """Indices of the joints both have, in the truth's order, or in that of the twelve limb joints.

    Raises:
        InputError: fewer than four in common.
    """
    names = [n for n in (LIMBS if limbs_only else truth) if n in predicted and n in truth]
    if len(names) < 4:
        raise InputError(f'only {len(names)} joints in common with the reference: {", ".join(names)}')
    return [list(predicted).index(n) for n in names], [list(truth).index(n) for n in names]


def well_seen(joints: Sequence[str], score: Array) -> NDArray[np.bool_]:
    """(F,) frames in which more than eight of the limb joints score above 0.2; `score` (F, J)."""
    limbs = [i for i, n in enumerate(joints) if n in LIMBS]
    return np.asarray((np.nan_to_num(score[:, limbs]) > SEEN_SCORE).sum(axis=1) > SEEN_LIMBS)


def scale_to(poses: Array, truth: Array) -> Array:
    """Poses times the one factor that brings them closest to `truth`."""
    return np.asarray(poses * ((poses * truth).sum() / (poses * poses).sum()))


def errors(
    predicted: Array, truth: Array, fps: float, frames: NDArray[np.bool_] | None = None
) -> dict[str, float]:
    """All errors of a sequence.

    Args:
        predicted: (F, J, 3) m in the camera's optical frame; frames with NaN count as failed.
        truth: (F, J, 3) m, same joints.
        fps: frames a second, for accelerations.
        frames: (F,) which frames count; all by default.

    Returns:
        mpjpe_mm: one scale for the sequence, no rotation. metric_mpjpe_mm: no scale. abs_mpjpe_mm: nothing
        aligned. root_mm: error of the pose's centre. seq_mpjpe_mm: one similarity for the sequence.
        pa_mpjpe_mm: one similarity a frame. e_paper_cm: eq. 25 of TPAMI 2016 after the sequence similarity.
        accel_mm_s2: error of the second differences. joints, frames, failed_frames: counts.
    """
    counted = np.flatnonzero(np.ones(len(truth), bool) if frames is None else frames)
    predicted, truth = predicted[counted], truth[counted]
    good = np.isfinite(predicted).all(axis=(1, 2))
    counts = {
        'joints': truth.shape[1],
        'frames': len(counted),
        'failed_frames': int((~good).sum()),
    }
    if not good.any():
        return {**counts}
    predicted, truth, index = predicted[good], truth[good], counted[good]
    p, t = centred(predicted), centred(truth)

    def mean_mm(difference: Array) -> float:
        return float(np.linalg.norm(difference, axis=-1).mean() * 1e3)

    scaled = scale_to(p, t)
    whole = rotation_to(p.reshape(-1, 3), t.reshape(-1, 3))
    sequence = scale_to(p @ whole.T, t)
    turned = p @ np.swapaxes(rotation_to(p, t), -1, -2)
    factor = (turned * t).sum(axis=(1, 2)) / (turned * turned).sum(axis=(1, 2))
    adjacent = (index[2:] - index[:-2]) == 2
    acceleration = (np.diff(scaled, 2, axis=0) - np.diff(t, 2, axis=0))[adjacent]
    return {
        'mpjpe_mm': mean_mm(scaled - t),
        'metric_mpjpe_mm': mean_mm(p - t),
        'abs_mpjpe_mm': mean_mm(predicted - truth),
        'root_mm': mean_mm(predicted.mean(axis=1) - truth.mean(axis=1)),
        'seq_mpjpe_mm': mean_mm(sequence - t),
        'pa_mpjpe_mm': mean_mm(turned * factor[:, None, None] - t),
        'e_paper_cm': float(np.sqrt(((sequence - t) ** 2).sum()) / len(t) * 100),
        'accel_mm_s2': mean_mm(acceleration) * fps**2 if len(acceleration) else float('nan'),
        **counts,
    }


def bone_std_mm(poses: Array, skeleton: Skeleton) -> float:
    """Standard deviation over time of bone lengths, mean over the bones, mm; `poses` (F, J, 3) m."""
    return float(np.nanstd(skeleton.bone_lengths(poses), axis=0).mean() * 1e3)
