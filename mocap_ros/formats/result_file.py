# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Result files (.npz): one person's 3D poses over time, the keypoints that they were made from, and the camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.npz_arrays import ArrayReader, iterate_arrays, list_keys
from mocap_ros.formats.sequence_file import RESULT_KEYS, make_camera_arrays, validate_sequence
from mocap_ros.geometry.intrinsics import Intrinsics, recover_intrinsics
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.npz_file import write_npz
from mocap_ros.people import SEQUENCE_COLUMNS, PoseSequence, Posture
from mocap_ros.skeleton import CORE_COUNT, skeleton_from_joints
from mocap_ros.summary import UNKNOWN_SUMMARY, StoredSummary

# The keys of the 2D points from which a result was made, each with its key in a sequence file.
INPUT_KEYS = {
    'keypoints': 'keypoints', 'keypoint_names': 'joint_names', 'timestamps': 'timestamps',
    'image_size': 'image_size', 'camera_matrix': 'camera_matrix', 'distortion': 'distortion',
}  # fmt: skip
POSE_KEYS = 'joints3d', 'joint_names', 'timestamps', 'seen', 'residual_px'
# Those that older results, and those of others, do not have
OPTIONAL_KEYS = (
    'scale', 'translation', 'scale_known', 'world_from_camera', 'floor_std', 'grade', 'summary', 'orientation',
    'orientation_order', 'turn_inferred',
)  # fmt: skip
# Columns that have their names as keys, with the types of their numbers; older results do not have them either
COLUMN_TYPES = {
    'vertical': 'f8', 'vertical_std': 'f8', 'contact': 'f4', 'joint_std': 'f4', 'root_covariance': 'f4',
    'posture': 'u1', 'posture_probability': 'f4',
}  # fmt: skip
ORDER = 'xyzw'  # of the quaternions' numbers
UNKNOWN_CAMERA = Intrinsics.from_image_size(640, 480, 1.0)  # px and sides; of a camera of which nothing is known


def is_result_file(path: Path) -> bool:
    """Return whether a file is an .npz file with the keys of a result."""
    return list_keys(path) >= RESULT_KEYS


def save_result_file(path: Path, poses: PoseSequence) -> None:
    """Write a reconstructed person with the keypoints and the camera."""
    arrays: dict[str, NDArray[np.generic]] = {
        'joints3d': poses.joints.astype('f4'),
        'joint_names': np.array(poses.joint_names),
        'parents': np.array(poses.parents),
        'timestamps': poses.times,
        'seen': ~poses.inferred,
        'scale': poses.scale,
        'rotation': poses.rotation,
        'translation': poses.translation,
        'scale_known': np.array(poses.is_scale_known),
        'residual_px': poses.reprojection_residual,
        'theta': poses.weights,
        **{name: getattr(poses, name).astype(kind) for name, kind in COLUMN_TYPES.items()},
        'world_from_camera': poses.world_from_camera,
        'floor_std': np.array(poses.floor_std),
    }
    if poses.sequence is not None:
        arrays |= _make_input_arrays(poses.sequence, poses.intrinsics)
    if poses.summary is not None:
        arrays |= {'grade': np.array(poses.summary.grade), 'summary': np.array(str(poses.summary))}
    if np.isfinite(poses.joint_orientation).any():
        arrays |= {'orientation': poses.joint_orientation.astype('f4'), 'orientation_order': np.array(ORDER)}
        arrays['turn_inferred'] = poses.turn_inferred
    write_npz(path, arrays)


def _make_input_arrays(sequence: KeypointSequence, intrinsics: Intrinsics) -> dict[str, NDArray[np.generic]]:
    known = replace(intrinsics, is_focal_known=True)
    camera_matrix, distortion = make_camera_arrays(replace(sequence, calibration=known))
    camera = {'camera_matrix': camera_matrix, 'distortion': distortion}
    return {
        'keypoints': sequence.keypoints.astype('f4'),
        'keypoint_names': np.array(sequence.joint_names),
        'image_size': np.array(sequence.image_size),
        **{key: values for key, values in camera.items() if values is not None},
    }


def load_result_file(path: Path) -> tuple[PoseSequence, StoredSummary]:
    """Read and validate a result file; in one without a camera, the cameras of the frames give its intrinsics."""
    with naming(path):
        keys = {*POSE_KEYS, *OPTIONAL_KEYS, *COLUMN_TYPES, *INPUT_KEYS}
        array_by_key = dict(iterate_arrays(path, keys, 'a result of reconstruct'))
        arrays = ArrayReader(array_by_key)
        times = arrays.read_numbers('timestamps', (None,))
        if not len(times) or not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise InputError('timestamps: expected increasing times in s')
        names = arrays.read_joint_names('joint_names')
        frames = len(times)
        skeleton = skeleton_from_joints(names)
        if not skeleton.name:
            raise InputError(f'joint_names: {", ".join(names)}: not those of a known skeleton')
        joints = arrays.read_numbers('joints3d', (frames, len(names), 3))
        if np.isinf(joints).any():
            raise InputError('joints3d: not finite')
        sequence = None
        is_scale_known = False
        if 'keypoint_names' in arrays:
            named = {INPUT_KEYS[key]: array_by_key[key] for key in INPUT_KEYS if key in array_by_key}
            sequence = validate_sequence(named)
        intrinsics = _find_intrinsics(arrays, sequence, joints)
        if 'scale_known' in arrays:
            is_scale_known = bool(arrays.read_flags('scale_known', ()))
        world = np.full((4, 4), np.nan)
        floor_std = np.nan
        if 'floor_std' in arrays:
            world = arrays.read_numbers('world_from_camera', (4, 4))
            floor_std = float(arrays.read_numbers('floor_std', ()))
        seen = arrays.read_flags('seen', joints.shape[:2])

        poses = PoseSequence(
            id='',
            times=times,
            skeleton=skeleton,
            joints=joints,
            inferred=~seen,
            reprojection_residual=arrays.read_numbers('residual_px', (frames,)),
            intrinsics=replace(intrinsics, is_focal_known=is_scale_known),
            **_read_columns(arrays, joints),
            predicted=np.asarray(~seen[:, :CORE_COUNT].any(axis=1)),
            world_from_camera=world,
            floor_std=floor_std,
            sequence=sequence,
        )
        if 'grade' not in arrays or 'summary' not in arrays:
            return poses, UNKNOWN_SUMMARY
        return poses, StoredSummary(arrays.read_texts('grade', ())[0], arrays.read_texts('summary', ())[0])


def _read_columns(arrays: ArrayReader, joints: Array) -> dict[str, Any]:
    """Return those of the columns that a file may lack."""
    shape = joints.shape[:2]
    columns: dict[str, NDArray[Any]] = {
        name: arrays.read_numbers(name, SEQUENCE_COLUMNS[name].find_shape(*shape))
        for name in COLUMN_TYPES
        if name in arrays
    }
    if 'posture' in columns:
        columns['posture'] = Posture.read(columns['posture'])
    if 'orientation_order' in arrays and arrays.read_texts('orientation_order', ())[0] == ORDER:
        columns['joint_orientation'] = arrays.read_numbers('orientation', (*shape, 4))
    if 'turn_inferred' in arrays:
        columns['turn_inferred'] = arrays.read_flags('turn_inferred', shape)
    return columns


def _find_intrinsics(arrays: ArrayReader, sequence: KeypointSequence | None, joints: Array) -> Intrinsics:
    if sequence is not None and sequence.is_camera_known:
        return sequence.intrinsics(1.0)
    if 'scale' not in arrays:
        return UNKNOWN_CAMERA
    scale = arrays.read_numbers('scale', (len(joints),))
    translation = arrays.read_numbers('translation', (len(joints), 2))
    return recover_intrinsics(joints[:, :CORE_COUNT].mean(axis=1), scale, translation)
