# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of 3D poses against the truth, each with the alignment that precedes it.

    MPJPE = mean_{t,j} || s P_tj - Q_tj ||                                                    (mpjpe_mm)
    e = sqrt( sum_{t,j} || S(P_tj) - Q_tj ||^2 ) / F                        (e_paper_cm, eq. 25 of TPAMI 2016)

P and Q are the predicted and the true poses over their common joints, both centred in each frame; s is one scale
and S one similarity for the whole sequence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import centre_poses, fit_rotation

# the twelve joints that every keypoint layout and every motion capture skeleton has
LIMB_JOINTS = (
    'lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist',
    'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle',
)  # fmt: skip
SEEN_SCORE = 0.2  # confidence score above which a limb joint counts as seen in the measuring protocol
SEEN_LIMB_JOINTS = 8  # joints; a frame with more seen limb joints than these is compared in the measuring protocol
MAX_STEP_FRAMES = 1.5  # frames; between two frames further apart, others are missing
MIN_COMMON_JOINTS = 4  # joints; with fewer, aligned poses hardly differ


def match_joints(
    predicted: Sequence[str], truth: Sequence[str], limbs_only: bool = False
) -> tuple[list[int], list[int]]:
    """Return the indices of the common joints in both, in the order of the truth or of `LIMB_JOINTS`."""
    names = [n for n in (LIMB_JOINTS if limbs_only else truth) if n in predicted and n in truth]
    if len(names) < MIN_COMMON_JOINTS:
        raise InputError(f'only {len(names)} joints in common with the reference: {", ".join(names)}')
    return [list(predicted).index(n) for n in names], [list(truth).index(n) for n in names]


def find_well_seen_frames(joint_names: Sequence[str], score: Array) -> NDArray[np.bool_]:
    """Return (F,) whether more than eight limb joints have a confidence score (F, J) above 0.2."""
    limbs = [i for i, n in enumerate(joint_names) if n in LIMB_JOINTS]
    return np.asarray((np.nan_to_num(score[:, limbs]) > SEEN_SCORE).sum(axis=1) > SEEN_LIMB_JOINTS)


def scale_to_reference(poses: Array, reference: Array) -> Array:
    """Return the poses P scaled by the factor s = <P, Q> / <P, P> that brings them closest to a reference Q."""
    return np.asarray(poses * ((poses * reference).sum() / (poses * poses).sum()))


def compute_errors(
    predicted: Array, truth: Array, fps: float, frames: NDArray[np.bool_] | None = None, times: Array | None = None
) -> dict[str, float]:
    """Return all errors of a sequence, named as in `Evaluation`; only the counts if every compared frame failed.

    Poses (F, J, 3) are in m in one frame of reference; a frame with a NaN counts as failed. `frames` (F,) are
    compared, `times` (F,) s are None where no frame is missing. Accelerations are second differences, scaled as
    `mpjpe_mm`.
    """
    compared = np.flatnonzero(np.ones(len(truth), bool) if frames is None else frames)
    predicted, truth = predicted[compared], truth[compared]
    has_prediction = np.isfinite(predicted).all(axis=(1, 2))
    counts = {'joints': truth.shape[1], 'frames': len(compared), 'failed_frames': int((~has_prediction).sum())}
    if not has_prediction.any():
        return {**counts}
    predicted, truth, index = predicted[has_prediction], truth[has_prediction], compared[has_prediction]
    p, q = centre_poses(predicted), centre_poses(truth)

    def mean_mm(difference: Array) -> float:
        return float(np.linalg.norm(difference, axis=-1).mean() * 1e3)

    scaled = scale_to_reference(p, q)
    sequence_rotation = fit_rotation(p.reshape(-1, 3), q.reshape(-1, 3))
    sequence_aligned = scale_to_reference(p @ sequence_rotation.T, q)
    rotated = p @ np.swapaxes(fit_rotation(p, q), -1, -2)
    frame_scale = (rotated * q).sum(axis=(1, 2)) / (rotated * rotated).sum(axis=(1, 2))
    is_next = np.diff(index) == 1
    if times is not None:
        is_next &= np.diff(times[index]) * fps < MAX_STEP_FRAMES
    is_adjacent = is_next[1:] & is_next[:-1]
    acceleration_error = (np.diff(scaled, 2, axis=0) - np.diff(q, 2, axis=0))[is_adjacent]
    return {
        'mpjpe_mm': mean_mm(scaled - q),
        'metric_mpjpe_mm': mean_mm(p - q),
        'abs_mpjpe_mm': mean_mm(predicted - truth),
        'root_mm': mean_mm(predicted.mean(axis=1) - truth.mean(axis=1)),
        'seq_mpjpe_mm': mean_mm(sequence_aligned - q),
        'pa_mpjpe_mm': mean_mm(rotated * frame_scale[:, None, None] - q),
        'e_paper_cm': float(np.sqrt(((sequence_aligned - q) ** 2).sum()) / len(q) * 100),
        'accel_mm_s2': mean_mm(acceleration_error) * fps**2 if len(acceleration_error) else float('nan'),
        **counts,
    }
