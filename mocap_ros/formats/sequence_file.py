# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sequence files (.npz): one person's keypoints in the images of one camera, and the true 3D joints if known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.npz_arrays import ArrayReader, iterate_arrays, list_keys
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence, create_distortion
from mocap_ros.keypoints.validation import (
    check_places,
    describe_other_unit,
    describe_rate,
    describe_step,
    find_border_points,
    mark_unknown_depth,
    mark_unseen,
)
from mocap_ros.messages.camera_info import check_coefficients
from mocap_ros.npz_file import write_npz
from mocap_ros.skeleton import (
    KNOWN_JOINTS,
    canonical_joint_names,
    detector_joint_names,
)
from mocap_ros.units import NS_PER_S

MAX_TIMESTAMP_S = 2.0**31  # s; the seconds of a ROS stamp are an int32
MAX_IMAGE_SIDE_PX = 100_000  # px; guard against garbage, far above any real image
MAX_COORDINATE_M = 1e6  # m; guard against garbage, far above any real distance
FISHEYE = 'equidistant'  # the lens model of a CameraInfo whose coefficients a sequence file cannot hold

# All keys of a sequence file; a file may have others, which are ignored.
SEQUENCE_KEYS = (
    'keypoints', 'joint_names', 'timestamps', 'image_size', 'camera_matrix', 'distortion', 'joints3d',
    'joints3d_names', 'depth',
)  # fmt: skip
# A file with all of these keys is a result of `reconstruct`.
RESULT_KEYS = frozenset(('joints3d', 'theta', 'residual_px'))


def make_camera_arrays(sequence: KeypointSequence) -> tuple[Array | None, Array | None]:
    """Return the camera matrix (3, 3) in px and the distortion coefficients, as a file has them; None if unknown.

    They are those of `calibration` where there is one, unless its lens is a fisheye, which no file can hold.
    """
    calibration = sequence.calibration
    if calibration is None or not calibration.is_focal_known:
        return sequence.camera_matrix, sequence.distortion
    if calibration.distortion.model == FISHEYE:
        return None, None
    fx, fy = calibration.focal_lengths
    cx, cy = calibration.center
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    coefficients = calibration.distortion.coefficients
    return matrix, np.array(coefficients) if coefficients else None


def save_sequence(path: str | Path, sequence: KeypointSequence) -> None:
    """Write a sequence file, without the ids and a fisheye lens, which the format does not have."""
    camera_matrix, distortion = make_camera_arrays(sequence)
    arrays: dict[str, NDArray[np.generic]] = {
        'keypoints': sequence.keypoints.astype(np.float32),
        'joint_names': np.array(sequence.joint_names),
        'timestamps': np.asarray(sequence.timestamps, np.float64),
        'image_size': np.array(sequence.image_size, np.int64),
    }
    if camera_matrix is not None:
        arrays['camera_matrix'] = np.asarray(camera_matrix, np.float64)
    if distortion is not None:
        arrays['distortion'] = np.asarray(distortion, np.float64)
    if sequence.depth is not None:
        arrays['depth'] = sequence.depth.astype(np.float32)
    if sequence.truth is not None:
        arrays['joints3d'] = sequence.truth.joints.astype(np.float32)
        arrays['joints3d_names'] = np.array(sequence.truth.joint_names)
    write_npz(path, arrays)


def load_sequence(path: str | Path) -> KeypointSequence:
    """Read and validate a sequence file."""
    with naming(path):
        if list_keys(Path(path)) >= RESULT_KEYS:
            raise InputError('is a result of reconstruct; give the sequence file that it was made from')
        return validate_sequence(dict(iterate_arrays(Path(path), SEQUENCE_KEYS, 'a sequence file')))


def validate_sequence(array_by_key: Mapping[str, NDArray[np.generic]]) -> KeypointSequence:
    """Return the sequence of arrays that have the keys, the shapes and the units of a sequence file."""
    arrays = ArrayReader(array_by_key)
    timestamps = arrays.read_numbers('timestamps', (None,))
    frames = len(timestamps)
    if not frames:
        raise InputError('timestamps: no frames')
    check_timestamps(timestamps)

    given_names = arrays.read_joint_names('joint_names')
    joint_names = detector_joint_names(given_names)
    with naming('joint_names'):
        build_joint_map(joint_names)
    raw = arrays.read_numbers('keypoints', (frames, len(joint_names), 3))
    points, score, fault = mark_unseen(raw[..., :2], raw[..., 2])
    if fault:
        frame, joint = fault.index
        raise InputError(f'keypoints: frame {frame}: {fault.field} of {joint_names[joint]} is {fault.what}')
    image_size, camera_matrix, distortion = validate_camera(array_by_key)
    if not (score > 0).any() and (raw[..., :2] > 0).any():
        raise InputError('keypoints: every score is 0, which means not seen; write 1 where there are no scores')
    if other_unit := describe_other_unit(points, score, image_size[0]):
        raise InputError(f'keypoints: {other_unit}')
    with naming('image_size'):
        check_places(points, score, image_size)
    keypoints = np.concatenate([points, score[..., None]], axis=-1)
    keypoints[find_border_points(points, image_size)] = np.nan, np.nan, 0
    depth = arrays.read_numbers('depth', score.shape) if 'depth' in arrays else None
    return KeypointSequence(
        keypoints=keypoints,
        joint_names=joint_names,
        timestamps=timestamps,
        image_size=image_size,
        camera_matrix=camera_matrix,
        distortion=distortion,
        truth=_read_truth(arrays, frames) if 'joints3d' in arrays else None,
        depth=None if depth is None else mark_unknown_depth(depth),
        notes=_describe_replaced_names(given_names, joint_names),
    )


def _describe_replaced_names(given: Sequence[str], used: Sequence[str]) -> tuple[str, ...]:
    """Return a line about names that no layout has, for which joints of the layout of the others are used."""
    pairs = zip(given, canonical_joint_names(given), used, strict=True)
    replaced = [f'{name!r} as {joint!r}' for name, own, joint in pairs if own != joint and own not in KNOWN_JOINTS]
    return (f'joint_names: no known joints, used by their places: {", ".join(replaced)}',) if replaced else ()


def _read_truth(arrays: ArrayReader, frames: int) -> GroundTruth:
    names = arrays.read_joint_names('joints3d_names')
    joints = arrays.read_numbers('joints3d', (frames, len(names), 3))
    too_far = np.abs(joints) > MAX_COORDINATE_M
    if too_far.any():
        frame, joint, _ = np.argwhere(too_far)[0]
        raise InputError(f'joints3d: frame {frame}: {names[joint]} is more than {MAX_COORDINATE_M:g} m away')
    return GroundTruth(joints, names)


def validate_camera(
    array_by_key: Mapping[str, NDArray[np.generic]],
) -> tuple[tuple[int, int], Array | None, Array | None]:
    """Return the image size (width, height) in px, the camera matrix and the distortion of a file's arrays.

    The camera matrix (3, 3) in px and the distortion coefficients are None where they are missing.
    """
    arrays = ArrayReader(array_by_key)
    size = arrays.read_numbers('image_size', (2,))
    if not ((size >= 1) & (size <= MAX_IMAGE_SIDE_PX)).all():
        raise InputError(
            f'image_size: {size[0]:g} x {size[1]:g} px, expected width and height of 1 to {MAX_IMAGE_SIDE_PX} px'
        )
    camera_matrix = distortion = None
    if 'camera_matrix' in arrays:
        camera_matrix = arrays.read_numbers('camera_matrix', (3, 3))
        with naming('camera_matrix'):
            Intrinsics.from_matrix(camera_matrix)
    if 'distortion' in arrays:
        distortion = arrays.read_numbers('distortion', (None,))
        check_coefficients(create_distortion(distortion), 'distortion')
    return (int(size[0]), int(size[1])), camera_matrix, distortion


def check_timestamps(timestamps: Array) -> None:
    """Check that timestamps (F,) in s can be those of a video."""
    invalid = ~(np.abs(timestamps) < MAX_TIMESTAMP_S) | (timestamps < 0)
    if invalid.any():
        frame = int(invalid.argmax())
        steps = np.diff(timestamps[np.isfinite(timestamps)])
        fault = describe_step(float(np.median(steps))) if len(steps) else ''
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:g} s{fault and "; "}{fault}')
    if (np.diff(timestamps) > 0).all() and (fault := describe_rate(timestamps)):
        raise InputError(f'timestamps: {fault}')
    not_increasing = np.diff(timestamps) < 1 / NS_PER_S
    if not_increasing.any():
        frame = int(not_increasing.argmax()) + 1
        relation = 'repeats' if timestamps[frame] == timestamps[frame - 1] else 'is not later than'
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:.9g} s {relation} frame {frame - 1}')


def find_longest_gap(times: Array) -> tuple[float, float]:
    """Return the longest step between times (F,) in s, and the time before it; 0 s if there is no step."""
    if len(times) < 2:
        return 0.0, 0.0
    steps = np.diff(times)
    longest = int(steps.argmax())
    return float(steps[longest]), float(times[longest])
