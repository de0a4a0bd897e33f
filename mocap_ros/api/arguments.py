# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of the arguments of the public functions; every error begins with the name of the argument."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.config import Config, format_value, values, with_values
from mocap_ros.errors import ConfigError, InputError, MocapError, ModelError
from mocap_ros.formats.npz_arrays import ArrayReader
from mocap_ros.formats.sequence_file import (
    GroundTruth,
    KeypointSequence,
    check_timestamps,
    create_intrinsics,
    validate_camera,
    validate_sequence,
)
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.validation import describe_points_outside
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import AUTO, load_base_pose_models
from mocap_ros.skeleton import keypoint_layout
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]
Parameters = Mapping[str, object] | Config | None  # argument `parameters`: values by name, or a configuration
Model = str | Path | BasePoses  # argument `model`: the name of shipped base poses, a model file, or base poses

# Names of fields and arguments that hold the same as a key of a sequence file of another name.
TRUTH_KEYS = {'joints3d': 'truth', 'joints3d_names': 'truth'}
ARGUMENT_KEYS = {**TRUTH_KEYS, 'timestamps': 'times'}

MAX_PATH_BYTES = 4095  # bytes; the longest path of Linux
MAX_PATH_PART_BYTES = 255  # bytes; the longest name of a file or folder
MIN_FOCAL_LENGTH_PX = 10.0  # px; a shorter one is probably a share of the image or in mm
MAX_CENTRE_IN_SIZES = 3.0  # image sizes; a principal point farther from the origin belongs to another image
LOGGER = logging.getLogger('mocap_ros')

Result = TypeVar('Result')


def name_argument(argument: str, function: Callable[[], Result]) -> Result:
    """Return the function's result, and put the argument's name in front of its errors.

    Raises:
        MocapError: the function raised an error of the same type.
    """
    try:
        return function()
    except MocapError as error:
        raise type(error)(f'{argument}: {error}') from None


def rename_key(error: InputError, names: Mapping[str, str]) -> InputError:
    """Return an error that begins with a key of a sequence file as one that begins with the key's other name."""
    key, colon, what = str(error).partition(':')
    return InputError(f'{names.get(key, key)}{colon}{what}')


def read_array(argument: str, given: ArrayLike) -> NDArray[np.generic]:
    """Convert an argument to an array; masked numbers become NaN.

    Raises:
        InputError: the values do not form an array.
    """
    if isinstance(given, np.ma.MaskedArray) and given.dtype.kind in 'fiu':
        return np.where(np.ma.getmaskarray(given), np.nan, np.ma.getdata(given))
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        raise InputError(f'{argument}: rows of different lengths, expected an array') from None


def read_numbers(argument: str, given: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Convert an argument to an array of numbers.

    Args:
        argument: name of the argument.
        given: the argument.
        shape: expected shape; None stands for any length.

    Raises:
        InputError: the values are no numbers or have another shape.
    """
    return ArrayReader({argument: read_array(argument, given)}).read_numbers(argument, shape)


def read_joint_names(argument: str, given: Sequence[str] | str) -> tuple[str, ...]:
    """Return the joint names of an argument, which may be the name of a keypoint layout.

    Raises:
        SkeletonError: no layout has that name.
        InputError: these are no names.
    """
    if isinstance(given, str):
        return name_argument(argument, lambda: keypoint_layout(given).joints)
    try:
        names: tuple[object, ...] = tuple(given)
    except TypeError:
        names = (given,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(f'{argument}: expected names, or the name of a keypoint layout such as coco17')
    return tuple(map(str, names))


def read_times(times: ArrayLike, frames: int) -> Array:
    """Return the times (F,) in s of this number of frames, checked like those of a sequence file.

    Raises:
        InputError: they are not finite or not increasing, or their unit seems to be another.
    """
    array = read_numbers('times', times, (frames,))
    try:
        check_timestamps(array)
    except InputError as error:
        raise rename_key(error, ARGUMENT_KEYS) from None
    return array


def read_path(argument: str, given: str | Path, error_type: type[MocapError] = InputError) -> Path:
    """Return an argument as a path that the operating system can look up.

    Raises:
        MocapError: it is none; the error has the type `error_type`.
    """
    if not isinstance(given, str | Path) or not str(given):
        raise error_type(f'{argument}: {format_value(given)}, expected a path')
    path = Path(given)
    try:
        parts = [os.fsencode(part) for part in path.parts]
    except UnicodeEncodeError:
        raise error_type(f'{argument}: has characters that no path can have') from None
    if any(b'\0' in part for part in parts):
        raise error_type(f'{argument}: has a NUL character, which no path can have')
    if len(os.fsencode(path)) > MAX_PATH_BYTES or any(len(part) > MAX_PATH_PART_BYTES for part in parts):
        raise error_type(f'{argument}: {len(str(given))} characters, longer than any path')
    return path


def make_sequence(
    keypoints: ArrayLike,
    joint_names: Sequence[str] | str,
    times: ArrayLike,
    image_size: ArrayLike,
    camera_matrix: ArrayLike | None,
    distortion: ArrayLike | None,
) -> KeypointSequence:
    """Return one person's keypoints as a sequence, with all checks that a sequence file gets.

    Raises:
        InputError: an argument is not valid; the error names it, and the frame.
        SkeletonError: no layout has the name given as `joint_names`.
    """
    arrays = {
        'keypoints': read_array('keypoints', keypoints),
        'joint_names': np.array(read_joint_names('joint_names', joint_names), np.str_),
        'timestamps': read_array('times', times),
        **_read_camera_arrays(image_size, camera_matrix, distortion),
    }
    _check_camera(arrays)
    try:
        sequence = validate_sequence(arrays)
    except InputError as error:
        raise rename_key(error, ARGUMENT_KEYS) from None
    outside = describe_points_outside(sequence.keypoints[..., :2], sequence.keypoints[..., 2], sequence.image_size)
    if outside:
        LOGGER.warning('keypoints: %s', outside)
    return sequence


def check_sequence(sequence: KeypointSequence) -> KeypointSequence:
    """Return the sequence with all checks that a sequence file gets, since anybody can create one.

    Raises:
        InputError: a field is not valid; the error names it, and the frame.
    """
    arrays = {
        'keypoints': read_array('keypoints', sequence.keypoints),
        'joint_names': np.array(read_joint_names('joint_names', sequence.joint_names), np.str_),
        'timestamps': read_array('timestamps', sequence.timestamps),
        **_read_camera_arrays(sequence.image_size, sequence.camera_matrix, sequence.distortion),
    }
    if sequence.truth is not None:
        if not isinstance(sequence.truth, GroundTruth):
            raise InputError(f'truth: {format_value(sequence.truth)}, expected a GroundTruth')
        arrays['joints3d'] = read_array('truth', sequence.truth.joints)
        arrays['joints3d_names'] = np.array(read_joint_names('truth', sequence.truth.joint_names), np.str_)
    try:
        checked = validate_sequence(arrays)
    except InputError as error:
        raise rename_key(error, TRUTH_KEYS) from None
    for argument, name in (('person_id', sequence.person_id), ('frame_id', sequence.frame_id)):
        if not isinstance(name, str):
            raise InputError(f'{argument}: {format_value(name)}, expected a text')
    if sequence.calibration is not None:
        if not isinstance(sequence.calibration, Intrinsics):
            raise InputError(f'calibration: {format_value(sequence.calibration)}, expected Intrinsics')
        if sequence.camera_matrix is not None or sequence.distortion is not None:
            raise InputError('calibration: given beside camera_matrix or distortion; set it to None to use those')
    return replace(
        checked,
        person_id=sequence.person_id,
        frame_id=sequence.frame_id,
        recorded_ns=_keep_exact_stamps(sequence.recorded_ns, checked.timestamps),
        calibration=sequence.calibration,
    )


def _keep_exact_stamps(recorded_ns: Sequence[int], timestamps: Array) -> tuple[int, ...]:
    """Return the stamps in ns of a recording, or none if the timestamps (F,) in s have been changed since."""
    stamps = read_array('recorded_ns', recorded_ns)
    if stamps.shape != timestamps.shape or stamps.dtype.kind not in 'iu':
        return ()
    is_same = np.array_equal(stamps.astype(np.int64) / NS_PER_S, timestamps)
    return tuple(stamps.tolist()) if is_same else ()


def make_intrinsics(
    image_size: ArrayLike, camera_matrix: ArrayLike | None, distortion: ArrayLike | None, config: Config
) -> tuple[tuple[int, int], Intrinsics]:
    """Return the image size (width, height) in px and the intrinsics of a camera.

    Raises:
        InputError: an argument is not valid; the error names it.
    """
    arrays = _read_camera_arrays(image_size, camera_matrix, distortion)
    _check_camera(arrays)
    size, matrix, coefficients = validate_camera(arrays)
    return size, create_intrinsics(size, matrix, coefficients, config.tracker.nominal_focal_length)


def _read_camera_arrays(
    image_size: ArrayLike, camera_matrix: ArrayLike | None, distortion: ArrayLike | None
) -> dict[str, NDArray[np.generic]]:
    """Return the arguments that describe a camera, by the keys of a sequence file."""
    optional = {'camera_matrix': camera_matrix, 'distortion': distortion}
    given = {'image_size': image_size, **{key: value for key, value in optional.items() if value is not None}}
    return {key: read_array(key, value) for key, value in given.items()}


def _check_camera(arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Check a camera by the keys of a sequence file more strictly than a file, whose camera was calibrated once.

    Raises:
        InputError: the camera matrix is none in px for this image, or is missing although there is a distortion.
    """
    if 'camera_matrix' not in arrays:
        if 'distortion' in arrays:
            raise InputError('distortion: needs a camera_matrix')
        return
    size, _, _ = validate_camera({'image_size': arrays['image_size']})
    matrix = read_numbers('camera_matrix', arrays['camera_matrix'], (3, 3))
    if not np.isfinite(matrix).all():
        raise InputError('camera_matrix: has numbers that are not finite')
    if not np.array_equal(matrix[2], [0, 0, 1]):
        raise InputError(f'camera_matrix: last row {matrix[2].tolist()}, expected 0 0 1')
    focal_lengths, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    if (focal_lengths < MIN_FOCAL_LENGTH_PX).any():
        given = f'focal lengths {focal_lengths[0]:g} and {focal_lengths[1]:g} px'
        raise InputError(f'camera_matrix: {given}: looks normalised; at least {MIN_FOCAL_LENGTH_PX:g} px expected')
    if (np.abs(centre) > MAX_CENTRE_IN_SIZES * np.array(size)).any():
        point = f'principal point {centre[0]:g}, {centre[1]:g} px'
        raise InputError(f'camera_matrix: {point}, far outside the image of {size[0]} x {size[1]} px')


def make_config(parameters: Parameters) -> Config:
    """Return the configuration with these parameters; those that are not given have their defaults.

    Raises:
        ConfigError: a parameter is unknown, or its value has the wrong type or is out of range.
    """
    if isinstance(parameters, Config):
        given: Mapping[str, object] = values(parameters)
    elif isinstance(parameters, Mapping) and all(isinstance(name, str) for name in parameters):
        given = parameters
    elif parameters is None:
        given = {}
    else:
        raise ConfigError(f'parameters: {format_value(parameters)}: expected values by name, or a Config')
    return name_argument('parameters', lambda: with_values(Config(), given))


def load_models(model: Model, config: Config) -> dict[str, BasePoses]:
    """Return the base poses by name; `auto` leaves the choice to the parameter `tracker.model`.

    Raises:
        ModelError: no model has this name and no file this path, or the file is not a model.
    """
    if isinstance(model, BasePoses):
        return {model.name: model}
    if not isinstance(model, str | Path):
        raise ModelError(f'model: {format_value(model)}: expected a name, a path or BasePoses')
    name = str(read_path('model', config.tracker.model if model == AUTO else model, ModelError))
    return name_argument('model', lambda: load_base_pose_models(name))


def check_positive(argument: str, value: float) -> float:
    """Return a number that is positive and finite.

    Raises:
        InputError: it is not.
    """
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (is_number and 0 < value < math.inf):
        raise InputError(f'{argument}: {format_value(value)}, expected a positive number')
    return float(value)


def check_image_size(image_size: tuple[int, int]) -> tuple[int, int]:
    """Return the image size (width, height) in px as whole numbers.

    Raises:
        InputError: it is none.
    """
    try:
        return validate_camera(_read_camera_arrays(image_size, None, None))[0]
    except InputError as error:
        raise InputError(f'{error}, expected (width, height) in px') from None
