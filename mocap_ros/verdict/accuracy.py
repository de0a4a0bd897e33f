# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How far results are from the truth: errors of 3D poses, each with the alignment that precedes it.

    MPJPE = mean_{t,j} || s P_tj - Q_tj ||                                                    (mpjpe_mm)
    e = sqrt( sum_{t,j} || S(P_tj) - Q_tj ||^2 ) / F                        (e_paper_cm, eq. 25 of TPAMI 2016)

P and Q are the predicted and the true poses over their common joints, both centred in each frame; s is one scale
and S one similarity for the whole sequence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.skeleton import Skeleton

# the twelve joints that every keypoint layout and every motion capture skeleton has
LIMB_JOINTS = (
    'lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist',
    'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle',
)  # fmt: skip
SEEN_SCORE = 0.2  # confidence score above which a limb joint counts as seen in the measuring protocol
SEEN_LIMB_JOINTS = 8  # joints; a frame with more seen limb joints than these is compared in the measuring protocol
MAX_STEP_FRAMES = 1.5  # frames; between two frames further apart, others are missing
MIN_COMMON_JOINTS = 4  # joints; with fewer, aligned poses hardly differ
MIN_PERSON_SIZE_M = 0.01  # m; a smaller truth is a single point, against which no pose can be compared
MAX_PERSON_SIZE_M = 10.0  # m; a larger truth is probably in mm


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The errors of one sequence; an error is None if no compared frame has a prediction.

    Attributes:
        mpjpe_mm: mean joint error after one scale for the sequence.
        metric_mpjpe_mm: mean joint error without a scale.
        abs_mpjpe_mm: mean joint error without any alignment.
        root_mm: mean error of the poses' centroids.
        seq_mpjpe_mm: mean joint error after one similarity transform for the sequence.
        pa_mpjpe_mm: mean joint error after one similarity transform for each frame.
        e_paper_cm: eq. 25 of TPAMI 2016 after one similarity transform for the sequence.
        accel_mm_s2: mean error of the joints' accelerations; NaN without three successive frames.
        joints: number of compared joints.
        frames: number of compared frames.
        failed_frames: number of these without a prediction.
        bone_std_mm: standard deviation of bone lengths over time, mean over the bones; NaN if one is never known.
        residual_px: root mean square reprojection error, mean over the frames; NaN if it is unknown in all.
        fps: frames a second; NaN for a sequence of one frame.
    """

    mpjpe_mm: float | None = None
    metric_mpjpe_mm: float | None = None
    abs_mpjpe_mm: float | None = None
    root_mm: float | None = None
    seq_mpjpe_mm: float | None = None
    pa_mpjpe_mm: float | None = None
    e_paper_cm: float | None = None
    accel_mm_s2: float | None = None
    joints: int
    frames: int
    failed_frames: int
    bone_std_mm: float
    residual_px: float
    fps: float

    def __repr__(self) -> str:
        errors = (
            ('MPJPE', self.mpjpe_mm),
            ('PA-MPJPE', self.pa_mpjpe_mm),
            ('without a scale', self.metric_mpjpe_mm),
        )
        shown = ''.join(f'{name} {error:.1f} mm, ' for name, error in errors if error is not None)
        counts = f'{self.joints} joints in {self.frames} frames, {self.failed_frames} of them failed'
        return f'Evaluation: {shown}{counts}'

    def as_dict(self) -> dict[str, float]:
        """Return the record that `mocap-ros evaluate --json` writes, without the errors that are None."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def evaluate(
    joints: Array,
    skeleton: Skeleton,
    residual: Array,
    truth: Array,
    truth_names: Sequence[str],
    fps: float,
    keypoint_names: Sequence[str] = (),
    keypoint_scores: Array | None = None,
    times: Array | None = None,
) -> Evaluation:
    """Compare a sequence (F, J, 3) with its truth (F, J3, 3), both in m in the camera's optical frame.

    Joints of the truth that are known in no frame are left out, then frames in which another is unknown.
    `residual` (F,) is in px; NaN is no prediction, or unknown. With scores (F, Jk) of keypoints, only the twelve
    limb joints are compared, in the frames in which most of them are seen. `times` (F,) s show where frames are
    missing; None if none are.
    """
    check_truth(truth)
    limbs_only = keypoint_scores is not None
    is_known = np.asarray(np.isfinite(truth).all(axis=-1))
    known_names = tuple(n if is_known[:, i].any() else '' for i, n in enumerate(truth_names))
    try:
        predicted_index, truth_index = match_joints(skeleton.joints, known_names, limbs_only)
    except InputError as error:
        known = ', '.join(name for name in known_names if name)
        what = str(error).rstrip(': ')
        raise InputError(
            f'joints3d_names: {what}; the truth has {known}; the result has {", ".join(skeleton.joints)}'
        ) from None
    frames = np.asarray(is_known[:, truth_index].all(axis=1))
    if keypoint_scores is not None:
        frames &= find_well_seen_frames(keypoint_names, keypoint_scores)
    check_person_size('joints3d', truth[frames][:, truth_index])
    if not frames.any():
        raise InputError('joints3d: no frame in which all joints are known' + ' and most are seen' * limbs_only)
    check_person_size('joints', joints[frames][:, predicted_index])
    errors = compute_errors(joints[:, predicted_index], truth[:, truth_index], fps, frames, times)
    lengths = skeleton.bone_lengths(joints)
    is_each_bone_known = np.isfinite(lengths).any(axis=0).all()
    return Evaluation(
        **errors,
        bone_std_mm=float(np.nanstd(lengths, axis=0).mean() * 1e3) if is_each_bone_known else math.nan,
        residual_px=float(np.nanmean(residual)) if np.isfinite(residual).any() else math.nan,
        fps=fps,
    )


def check_truth(truth: Array) -> None:
    """Check that a truth (F, J3, 3) can be compared with anything; else raise an InputError with the field."""
    if not np.isfinite(truth).all(axis=-1).any():
        raise InputError('joints3d: no joint is known in any frame')


def measure_person_size(joints: Array) -> float:
    """Return the median longest side (m) of the box around joints (F, J, 3), NaN if no frame is complete."""
    complete = joints[np.isfinite(joints).all(axis=(1, 2))]
    return float(np.median(np.ptp(complete, axis=1).max(axis=-1))) if len(complete) else math.nan


def check_person_size(field: str, joints: Array) -> None:
    """Raise an InputError if the complete frames of joints (F, J, 3) in m show a single point."""
    if measure_person_size(joints) < MIN_PERSON_SIZE_M:
        raise InputError(f'{field}: all joints at one point')


def estimate_frame_rate(times: Array) -> float:
    """Return the frames a second by the median time (s) between frames (F,), or NaN for a single frame."""
    return 1 / float(np.median(np.diff(times))) if len(times) > 1 else math.nan


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
) -> dict[str, Any]:
    """Return all errors of a sequence, named as in `Evaluation`; only the counts if every compared frame failed.

    Poses (F, J, 3) are in m in one frame of reference; a frame with a NaN counts as failed. `frames` (F,) are
    compared, `times` (F,) s are None where no frame is missing. Accelerations are second differences, scaled as
    `mpjpe_mm`.
    """
    compared = np.flatnonzero(np.ones(len(truth), bool) if frames is None else frames)
    predicted, truth = predicted[compared], truth[compared]
    has_prediction = np.isfinite(predicted).all(axis=(1, 2))
    failed_frames = int((~has_prediction).sum())
    counts = {'joints': truth.shape[1], 'frames': len(compared), 'failed_frames': failed_frames}
    if not has_prediction.any():
        return counts
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
