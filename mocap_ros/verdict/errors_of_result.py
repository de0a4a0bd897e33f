# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Evaluation of one reconstructed sequence against its truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.skeleton import Skeleton
from mocap_ros.verdict import metrics

MIN_PERSON_SIZE_M = 0.01  # m; a smaller truth is a single point, against which no pose can be compared
MAX_PERSON_SIZE_M = 10.0  # m; a larger truth is probably in mm


@dataclass(frozen=True)
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

    mpjpe_mm: float | None
    metric_mpjpe_mm: float | None
    abs_mpjpe_mm: float | None
    root_mm: float | None
    seq_mpjpe_mm: float | None
    pa_mpjpe_mm: float | None
    e_paper_cm: float | None
    accel_mm_s2: float | None
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
    _check_shapes(joints, skeleton, residual, truth, truth_names, keypoint_names, keypoint_scores)
    limbs_only = keypoint_scores is not None
    is_known = np.asarray(np.isfinite(truth).all(axis=-1))
    known_names = tuple(n if is_known[:, i].any() else '' for i, n in enumerate(truth_names))
    try:
        predicted_index, truth_index = metrics.match_joints(skeleton.joints, known_names, limbs_only)
    except InputError as error:
        known = ', '.join(name for name in known_names if name)
        what = str(error).rstrip(': ')
        raise InputError(
            f'joints3d_names: {what}; the truth has {known}; the result has {", ".join(skeleton.joints)}'
        ) from None
    frames = np.asarray(is_known[:, truth_index].all(axis=1))
    if keypoint_scores is not None:
        frames &= metrics.find_well_seen_frames(keypoint_names, keypoint_scores)
    check_person_size('joints3d', truth[frames][:, truth_index])
    if not frames.any():
        raise InputError('joints3d: no frame in which all joints are known' + ' and most are seen' * limbs_only)
    check_person_size('joints', joints[frames][:, predicted_index])
    errors = metrics.compute_errors(joints[:, predicted_index], truth[:, truth_index], fps, frames, times)
    lengths = skeleton.bone_lengths(joints)
    is_each_bone_known = np.isfinite(lengths).any(axis=0).all()
    record: dict[str, Any] = dict.fromkeys(f.name for f in fields(Evaluation)) | errors
    record['bone_std_mm'] = float(np.nanstd(lengths, axis=0).mean() * 1e3) if is_each_bone_known else math.nan
    record['residual_px'] = float(np.nanmean(residual)) if np.isfinite(residual).any() else math.nan
    return Evaluation(**{**record, 'fps': fps})


def check_truth(truth: Array) -> None:
    """Check that a truth (F, J3, 3) can be compared with anything; else raise an InputError with the field."""
    if not np.isfinite(truth).all(axis=-1).any():
        raise InputError('joints3d: no joint is known in any frame')


def measure_person_size(joints: Array) -> float:
    """Return the median longest side (m) of the box around joints (F, J, 3), 0 if no frame is complete."""
    complete = joints[np.isfinite(joints).all(axis=(1, 2))]
    return float(np.median(np.ptp(complete, axis=1).max(axis=-1))) if len(complete) else 0.0


def check_person_size(field: str, joints: Array) -> None:
    """Raise an InputError if the complete frames of joints (F, J, 3) in m show a single point."""
    is_any_complete = np.isfinite(joints).all(axis=(1, 2)).any()
    if is_any_complete and measure_person_size(joints) < MIN_PERSON_SIZE_M:
        raise InputError(f'{field}: all joints at one point')


def estimate_frame_rate(times: Array) -> float:
    """Return the frames a second by the median time (s) between frames (F,), or NaN for a single frame."""
    return 1 / float(np.median(np.diff(times))) if len(times) > 1 else math.nan


def _check_shapes(
    joints: Array,
    skeleton: Skeleton,
    residual: Array,
    truth: Array,
    truth_names: Sequence[str],
    keypoint_names: Sequence[str],
    keypoint_scores: Array | None,
) -> None:
    frames = len(truth)
    expected = {
        'joints': (joints, (frames, len(skeleton.joints), 3)),
        'residual': (residual, (frames,)),
        'joints3d': (truth, (frames, len(truth_names), 3)),
    }
    if keypoint_scores is not None:
        expected['keypoint_scores'] = (keypoint_scores, (frames, len(keypoint_names)))
    for field, (array, shape) in expected.items():
        if array.shape != shape:
            raise InputError(f'{field}: shape {array.shape}, expected {shape}')
