# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of the arguments of the public functions; every error begins with the name of the argument."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import Config, format_value, values, with_values
from mocap_ros.errors import ConfigError, InputError, MocapError, ModelError, name_errors
from mocap_ros.formats.npz_arrays import ArrayReader
from mocap_ros.formats.sequence_file import validate_camera, validate_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import AUTO, check_base_poses, load_base_pose_models
from mocap_ros.skeleton import keypoint_layout
from mocap_ros.units import NS_PER_S

Arrays = dict[str, NDArray[np.generic]]  # arrays by the keys of a sequence file
Parameters = Mapping[str, object] | Config | None  # argument `parameters`: values by name, or a configuration
Model = str | Path | PoseModel  # argument `model`: the name of shipped base poses, a model file, or base poses

MIN_FOCAL_LENGTH_PX = 10.0  # px; a shorter one is probably a share of the image or in mm
MAX_CENTRE_IN_SIZES = 3.0  # image sizes; a principal point farther from the origin belongs to another image
LOGGER = logging.getLogger('mocap_ros')


@contextmanager
def rename_errors(names: Mapping[str, str]) -> Iterator[None]:
    """Let errors that begin with a key of `names`, such as that of an array in a file, begin with its value."""
    try:
        yield
    except InputError as error:
        key, colon, what = str(error).partition(':')
        raise InputError(f'{names.get(key, key)}{colon}{what}') from None


def read_array(argument: str, given: ArrayLike) -> NDArray[np.generic]:
    """Convert an argument to an array; masked numbers become NaN."""
    if isinstance(given, np.ma.MaskedArray) and given.dtype.kind in 'fiu':
        return np.where(np.ma.getmaskarray(given), np.nan, np.ma.getdata(given))
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        raise InputError(f'{argument}: rows of different lengths, expected an array') from None


def read_numbers(argument: str, given: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Convert an argument to an array of numbers of a shape, in which None stands for any length."""
    return ArrayReader({argument: read_array(argument, given)}).read_numbers(argument, shape)


def read_number(argument: str, given: object, limits: tuple[float, float], unit: str) -> float:
    """Return a number that is within limits."""
    low, high = limits
    number = int | float | np.integer | np.floating
    if isinstance(given, bool) or not isinstance(given, number) or not low <= given <= high:
        raise InputError(f'{argument}: {format_value(given)}, expected {low:g} to {high:g} {unit}')
    return float(given)


def read_joint_names(argument: str, given: Sequence[str] | str) -> tuple[str, ...]:
    """Return the joint names of an argument, which may be the name of a keypoint layout."""
    if isinstance(given, str):
        with name_errors(argument):
            return keypoint_layout(given).joints
    return read_names(argument, given, 'names, or the name of a keypoint layout such as coco17')


def read_names(argument: str, given: Sequence[str], expected: str) -> tuple[str, ...]:
    """Return the names of an argument; `expected` describes it in errors."""
    names = tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (None,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(f'{argument}: {format_value(given)}, expected {expected}')
    return tuple(map(str, names))


def read_path(
    argument: str, given: str | Path, error_type: type[MocapError] = InputError, expected: str = 'a path'
) -> Path:
    """Return an argument as a path that the operating system can look up; `expected` describes it in errors."""
    try:
        if not str(given):
            raise ValueError('empty')
        Path(given).stat()
    except (TypeError, ValueError, OSError) as error:
        if not isinstance(error, OSError) or error.errno == errno.ENAMETOOLONG:
            raise error_type(f'{argument}: {format_value(given)}, expected {expected}') from None
    return Path(given)


def read_camera(
    image_size: ArrayLike, camera_matrix: ArrayLike | None = None, distortion: ArrayLike | None = None
) -> Arrays:
    """Return the arrays that describe a camera, by the keys of a sequence file."""
    given = {'image_size': image_size, 'camera_matrix': camera_matrix, 'distortion': distortion}
    return {key: read_array(key, value) for key, value in given.items() if value is not None}


def check_camera(
    image_size: ArrayLike, camera_matrix: ArrayLike | None, distortion: ArrayLike | None
) -> tuple[tuple[int, int], Array | None, Array | None]:
    """Check a camera more strictly than that of a file, which was calibrated once; return it as it is used."""
    if camera_matrix is None and distortion is not None:
        raise InputError('distortion: needs a camera_matrix')
    arrays = read_camera(image_size, camera_matrix, distortion)
    if camera_matrix is not None:
        (width, height), _, _ = validate_camera({'image_size': arrays['image_size']})
        matrix = read_numbers('camera_matrix', camera_matrix, (3, 3))
        (fx, fy), (x, y) = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if not np.array_equal(matrix[2], [0, 0, 1]):
            raise InputError(f'camera_matrix: last row {matrix[2].tolist()}, expected 0 0 1')
        if min(fx, fy) < MIN_FOCAL_LENGTH_PX:
            what = f'looks normalised; at least {MIN_FOCAL_LENGTH_PX:g} px expected'
            raise InputError(f'camera_matrix: focal lengths {fx:g} and {fy:g} px: {what}')
        if max(abs(x) / width, abs(y) / height) > MAX_CENTRE_IN_SIZES:
            what = f'principal point {x:g}, {y:g} px, far outside the image of {width} x {height} px'
            raise InputError(f'camera_matrix: {what}')
    return validate_camera(arrays)


def check_sequence(sequence: KeypointSequence, times: str = 'timestamps') -> KeypointSequence:
    """Return the sequence after the checks that a sequence file gets; `times` names its timestamps in errors."""
    for field, kind, default in (
        ('person_id', str, ''),
        ('frame_id', str, ''),
        ('focal_source', str, ''),
        ('is_size_assumed', bool, False),
        ('recording_start', float, None),
        ('truth', GroundTruth, None),
        ('calibration', Intrinsics, None),
    ):
        value = getattr(sequence, field)
        if not isinstance(value, kind) and value is not default:
            raise InputError(f'{field}: {format_value(value)}, expected {kind.__name__}')
    camera = read_camera(sequence.image_size, sequence.camera_matrix, sequence.distortion)
    if sequence.calibration is not None and len(camera) > 1:
        raise InputError('calibration: given beside camera_matrix or distortion; set it to None to use those')
    arrays = {
        'keypoints': read_array('keypoints', sequence.keypoints),
        'joint_names': np.array(read_joint_names('joint_names', sequence.joint_names), np.str_),
        'timestamps': read_array(times, sequence.timestamps),
        **camera,
    }
    if sequence.depth is not None:
        arrays['depth'] = read_array('depth', sequence.depth)
    if sequence.truth is not None:
        arrays['joints3d'] = read_array('truth', sequence.truth.joints)
        arrays['joints3d_names'] = np.array(read_joint_names('truth', sequence.truth.joint_names), np.str_)
    with rename_errors({'timestamps': times, 'joints3d': 'truth', 'joints3d_names': 'truth'}):
        checked = validate_sequence(arrays)
    stamps = np.asarray(sequence.recorded_ns)
    is_same = np.array_equal(stamps / NS_PER_S, checked.timestamps)  # they have not been changed since
    return replace(
        checked,
        person_id=sequence.person_id,
        frame_id=sequence.frame_id,
        recorded_ns=tuple(stamps.tolist()) if is_same else (),
        calibration=sequence.calibration,
        focal_source=sequence.focal_source,
        is_size_assumed=sequence.is_size_assumed,
        recording_start=sequence.recording_start if is_same else None,
    )


def make_config(parameters: Parameters) -> Config:
    """Return the configuration with these parameters, none of the node's; others have their defaults."""
    config = parameters if isinstance(parameters, Config) else Config()
    given: object = values(config) if isinstance(parameters, Config) else parameters or {}
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise ConfigError(f'parameters: {format_value(parameters)}: expected values by name, or a Config')
    with name_errors('parameters'):
        config = with_values(config, given)
        for name in () if isinstance(parameters, Config) else given:
            group, field = name.split('.')
            if group in ('node', 'recorder'):
                instead = f'; give camera_matrix, or {field} to read' if field in ('hfov', 'focal') else ''
                raise ConfigError(f'{name}: is a parameter of the node{instead}')
    return config


def load_models(model: Model, config: Config) -> dict[str, PoseModel]:
    """Return the base poses by name; `auto` leaves the choice to the parameter `tracker.model`."""
    if isinstance(model, PoseModel):
        with name_errors('model'):
            check_base_poses(model)
        return {model.name: model}
    given = config.tracker.model if model == AUTO else model
    name = str(read_path('model', given, ModelError, 'a name, a path or BasePoses'))
    with name_errors('model'):
        return load_base_pose_models(name)
