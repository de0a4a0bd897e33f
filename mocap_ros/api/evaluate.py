# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Comparison of 3D joints with the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.api.arguments import read_array, read_joint_names, read_numbers, rename_errors
from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import MAX_COORDINATE_M, check_timestamps
from mocap_ros.keypoints.keypoint_sequence import GroundTruth
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import BODY26, CMU15, canonical_joint_names
from mocap_ros.verdict import accuracy


def evaluate(
    joints: PoseSequence | ArrayLike,
    truth: GroundTruth | ArrayLike | None = None,
    *,
    truth_names: Sequence[str] | str = 'cmu15',
    times: ArrayLike | None = None,
    limbs_only: bool = False,
) -> accuracy.Evaluation:
    """Compare 3D joints with the truth over the joints that both have.

    Joints of the truth that are known in no frame are left out, then frames in which another joint is unknown.

    Args:
        joints: a result of `mocap_ros.reconstruct`; or (F, J, 3) m in the camera's optical frame, in the order of
            the layout `body26` or `cmu15`, NaN in frames without a person.
        truth: (F, J, 3) m in the camera's optical frame, NaN where unknown; or a `GroundTruth`; None for the truth
            that came with the keypoints of the result.
        truth_names: (J,) names of the joints of an array `truth`, or the name of a layout.
        times: (F,) s, times of the frames of an array `joints`; without them the error of the accelerations is
            NaN.
        limbs_only: True to compare the twelve joints of the limbs only, in the frames in which most of them were
            seen. That needs a result of `mocap_ros.reconstruct`.

    Returns:
        The errors.

    Raises:
        InputError: an argument is not valid, or nothing is left to compare; the error names the argument.
        SkeletonError: no layout has the name given as `truth_names`.
    """
    if isinstance(joints, PoseSequence):
        if times is not None:
            raise InputError('times: the PoseSequence has its own')
        result = joints
        predicted, residual, frame_times = result.joints, result.reprojection_residual, result.times
        skeleton = result.skeleton
        names: tuple[str, ...] = ()
        scores: Array | None = None
        if result.sequence is not None:
            truth = result.sequence.truth if truth is None else truth
            names, scores = result.sequence.joint_names, result.sequence.keypoints[..., 2]
    else:
        if limbs_only:
            raise InputError('limbs_only: needs a result of reconstruct, which knows the seen joints')
        joints = read_array('joints', joints)
        skeleton = BODY26 if joints.shape[1:2] == (len(BODY26.joints),) else CMU15
        predicted = read_numbers('joints', joints, (None, len(skeleton.joints), 3))
        _check_unit('joints', predicted)
        collapsed = np.ptp(predicted, axis=1).max(axis=-1) < accuracy.MIN_PERSON_SIZE_M
        if collapsed.any():
            frame = int(collapsed.argmax())
            raise InputError(
                f'joints: frame {frame}: all joints at one point; NaN expected where there is no person'
            )
        residual, names, scores = np.full(len(predicted), math.nan), (), None
        frame_times = np.zeros(1)
        if times is not None:
            frame_times = read_numbers('times', times, (len(predicted),))
            with rename_errors({'timestamps': 'times'}):
                check_timestamps(frame_times)
    if truth is None:
        raise InputError('truth: missing')
    names_argument = 'truth_names'
    if isinstance(truth, GroundTruth):
        names_argument, truth_names, truth = 'truth', truth.joint_names, truth.joints
    true_names = canonical_joint_names(read_joint_names(names_argument, truth_names))
    true_joints = read_numbers('truth', truth, (len(predicted), len(true_names), 3))
    _check_unit('truth', true_joints)
    with rename_errors({'joints3d': 'truth', 'joints3d_names': names_argument}):
        return accuracy.evaluate(
            predicted,
            skeleton,
            residual,
            true_joints,
            true_names,
            accuracy.estimate_frame_rate(frame_times),
            names,
            scores if limbs_only else None,
            frame_times if len(frame_times) == len(predicted) else None,
        )


def _check_unit(argument: str, joints: Array) -> None:
    """Check that joints (F, J, 3) have the coordinates and the size of a person in m; NaN is no fault."""
    too_far = np.abs(joints) > MAX_COORDINATE_M
    if too_far.any():
        frame, joint, _ = np.argwhere(too_far)[0]
        raise InputError(f'{argument}: frame {frame}: joint {joint} is more than {MAX_COORDINATE_M:g} m away')
    if accuracy.measure_person_size(joints) > accuracy.MAX_PERSON_SIZE_M:
        size = f'a person of more than {accuracy.MAX_PERSON_SIZE_M:g} m'
        raise InputError(f'{argument}: {size}; looks like mm, m expected')
