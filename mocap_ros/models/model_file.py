# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files of base poses and lifters: .npz without pickles, untrusted, so every array and size is checked."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import ModelError, describe_read_error, suggest
from mocap_ros.input_file import open_input_file
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.lifter import OUTPUT_COUNT, Lifter
from mocap_ros.models.lifter_input import FEATURE_COUNT, HISTORY_SLOTS_S
from mocap_ros.models.motion_predictor import MotionPredictor
from mocap_ros.models.network import Layers
from mocap_ros.models.velocity_correction import VelocityCorrection
from mocap_ros.npz_file import open_npz, write_npz
from mocap_ros.skeleton import CMU15, Skeleton, keypoint_layout

AUTO = 'auto'  # value of `tracker.model` that selects all shipped base-pose models
LEARNED = 'learned'  # value of `solver.prior` that selects the shipped lifter
PCA = 'pca'  # value of `solver.prior` that selects the base poses alone, as in the paper
PRIORS = (LEARNED, PCA)  # values of `solver.prior` that are not the path of a lifter

# Names of shipped files that are no base-pose models.
LIFTER_NAME, PREDICTOR_NAME, VELOCITY_NAME = 'lifter', 'predictor', 'velocity'
BASE_POSES_FORMAT = 'mocap_ros base poses 1'  # identifier in every base-pose file; changes with the format
LIFTER_FORMAT = 'mocap_ros lifter 2'  # identifier in every lifter file; changes with the format

MAX_BASE_POSES_BYTES = 16 << 20  # bytes, also unpacked; guards against zip bombs, shipped models have 15 kB
MAX_LIFTER_BYTES = 64 << 20  # bytes, also unpacked; guards against zip bombs, the shipped lifter has 6 MB
MAX_NAME_LENGTH = 100  # characters; bounds a name that appears in messages and on screens
STATURE_RANGE_M = 0.3, 3.0  # m; from children to giants, but refuses models in mm or cm
MAX_MEAN_COORDINATE_M = 3.0  # m from the body's origin; refuses models in mm or cm
WEIGHT_STD_RANGE_M = 1e-6, 10.0  # m; guards divisions by the standard deviation, refuses models in mm
ORTHONORMALITY_TOLERANCE = 1e-2  # 1; far above the rounding of single precision, in which models are stored
MAX_PARAMETER = 1e3  # 1; bounds weights and biases of a lifter, far beyond those that training gives

_SHIPPED = files('mocap_ros') / 'models' / 'shipped'


def save_base_poses(model: PoseModel, path: str | Path | io.BytesIO) -> None:
    """Write a base-pose model as .npz; the same model gives the same bytes."""
    meta = {
        'format': BASE_POSES_FORMAT,
        'name': model.name,
        'skeleton': model.skeleton.name,
        'stature': model.stature,
        'provenance': dict(model.provenance),
    }
    arrays = {
        'mean': model.mean.astype('f4'),
        'components': model.components.astype('f4'),
        'std': model.std.astype('f4'),
        'explained': model.explained.astype('f4'),
        'meta': np.array(json.dumps(meta, sort_keys=True)),
    }
    write_npz(path, arrays)


def list_shipped_base_poses() -> tuple[str, ...]:
    """Return the names of the base-pose models that are shipped with the package."""
    names = {p.name.removesuffix('.npz') for p in _SHIPPED.iterdir() if p.name.endswith('.npz')}
    return tuple(sorted(names - {LIFTER_NAME, PREDICTOR_NAME, VELOCITY_NAME}))


def load_base_poses(name_or_path: str | Path) -> PoseModel:
    """Load a shipped base-pose model by name, or another one by path.

    Raises:
        ModelError: No model has this name and no file this path, or the file is not a base-pose model.
    """
    text, path, shipped = str(name_or_path), Path(name_or_path), list_shipped_base_poses()
    if text in shipped:
        return decode_base_poses((_SHIPPED / f'{text}.npz').read_bytes(), text)
    if not path.is_file():
        raise ModelError(f'no base-pose model {text!r}: neither a file nor shipped; {suggest(text, shipped)}')
    try:
        with open_input_file(path) as file:
            return decode_base_poses(file.read(MAX_BASE_POSES_BYTES + 1), text)
    except OSError as error:
        raise ModelError(f'{text}: {error.strerror}') from None


def load_base_pose_models(name: str) -> dict[str, PoseModel]:
    """Load the base-pose model of a name or path, or all shipped models for `auto`; returns them by name."""
    return {n: load_base_poses(n) for n in (list_shipped_base_poses() if name == AUTO else (name,))}


@contextmanager
def _open_model(data: bytes, max_bytes: int, source: str, kind: str) -> Iterator[tuple[Any, dict[str, Array]]]:
    try:
        with open_npz(io.BytesIO(data), max_bytes) as archive:
            meta = json.loads(str(archive['meta']))
            arrays = {name: archive[name] for name in archive.files if name != 'meta'}
        for name, array in arrays.items():
            if array.dtype.kind != 'f':
                raise ValueError(f'{name}: holds {array.dtype}, expected floating point')
            if not np.isfinite(array).all():
                raise ValueError(f'{name}: numbers that are not finite')
        yield meta, arrays
    except KeyError as error:
        raise ModelError(f'{source}: not a {kind} (no {str(error.args[0]).split()[0]})') from None
    except Exception as error:  # malformed bytes of an untrusted file can raise almost any exception
        raise ModelError(f'{source}: not a {kind} ({describe_read_error(error)})') from None


def decode_base_poses(data: bytes, source: str) -> PoseModel:
    """Decode a base-pose model from the bytes of its file; `source` names it in a `ModelError`."""
    with _open_model(data, MAX_BASE_POSES_BYTES, source, 'base-pose model') as (meta, arrays):
        if meta['format'] != BASE_POSES_FORMAT:
            raise ValueError(f'format {meta["format"]!r}, expected {BASE_POSES_FORMAT!r}')
        model = PoseModel(
            name=meta['name'],
            skeleton=keypoint_layout(meta['skeleton']),
            stature=float(meta['stature']),
            provenance=meta['provenance'],
            **{key: arrays[key] for key in ('mean', 'components', 'std', 'explained')},
        )
        check_base_poses(model)
    return model


def check_base_poses(model: PoseModel) -> None:
    """Raise `ModelError` for shapes and values of a model that no training produces."""
    if model.skeleton != CMU15:
        raise ModelError(f'skeleton: {model.skeleton.name}, expected {CMU15.name}: {", ".join(CMU15.joints)}')
    joints, k = len(CMU15.joints), len(model.components)
    if not 0 < k <= 3 * joints:  # more cannot be orthonormal, and their products would fill the memory
        raise ModelError(f'components: shape {model.components.shape}, expected 1 to {3 * joints} base poses')
    shapes = {'mean': (joints, 3), 'components': (k, joints, 3), 'std': (k,), 'explained': (k,)}
    for key, shape in shapes.items():
        if getattr(model, key).shape != shape:
            raise ModelError(f'{key}: shape {getattr(model, key).shape}, expected {shape}')
    (low, high), (low_std, high_std) = STATURE_RANGE_M, WEIGHT_STD_RANGE_M
    has_name = isinstance(model.name, str) and len(model.name) <= MAX_NAME_LENGTH
    is_decreasing = np.diff(model.std) <= ORTHONORMALITY_TOLERANCE * model.std[:-1]
    flat = model.components.reshape(k, -1)
    for is_valid, reason in (
        (has_name, f'name: expected a text of at most {MAX_NAME_LENGTH} characters'),
        (isinstance(model.provenance, dict), 'provenance: expected a mapping'),
        (low <= model.stature <= high, f'stature: {model.stature:g}, expected {low} to {high} m'),
        (np.abs(model.mean).max() <= MAX_MEAN_COORDINATE_M, f'mean: a joint beyond {MAX_MEAN_COORDINATE_M:g} m'),
        (low_std <= model.std.min() <= model.std.max() <= high_std, f'std: outside {low_std:g} to {high_std:g} m'),
        (is_decreasing.all(), 'std: not decreasing'),
        (np.abs(flat @ flat.T - np.eye(k)).max() <= ORTHONORMALITY_TOLERANCE, 'components: not orthonormal'),
    ):
        if not is_valid:
            raise ModelError(reason)


def save_lifter(lifter: Lifter, path: str | Path | io.BytesIO) -> None:
    """Write a lifter as .npz, weights in half precision; the same lifter gives the same bytes."""
    arrays = {f'w{i}': weights.astype('f2') for i, (weights, _) in enumerate(lifter.layers)}
    arrays |= {f'b{i}': bias.astype('f2') for i, (_, bias) in enumerate(lifter.layers)}
    meta = {'format': LIFTER_FORMAT, 'slots': HISTORY_SLOTS_S.tolist(), 'provenance': dict(lifter.provenance)}
    write_npz(path, {**arrays, 'meta': np.array(json.dumps(meta, sort_keys=True))})


@cache
def load_shipped_lifter() -> Lifter:
    """Load the lifter that is shipped with the package; its file is read once in the life of a process."""
    return decode_lifter((_SHIPPED / f'{LIFTER_NAME}.npz').read_bytes(), LIFTER_NAME)


@cache
def load_motion_predictor() -> MotionPredictor:
    """Load the shipped predictor; its file is read once in the life of a process."""
    return MotionPredictor(**_read_shipped(PREDICTOR_NAME, MotionPredictor, np.float64))


@cache
def load_velocity_correction() -> VelocityCorrection:
    """Load the shipped correction of velocities; its file is read once in the life of a process."""
    return VelocityCorrection(**_read_shipped(VELOCITY_NAME, VelocityCorrection, np.float32))


def _read_shipped(name: str, kind: type[Any], dtype: type[np.floating[Any]]) -> dict[str, Any]:
    with np.load(io.BytesIO((_SHIPPED / f'{name}.npz').read_bytes()), allow_pickle=False) as archive:
        return {field.name: archive[field.name].astype(dtype, order='C') for field in fields(kind)}


@cache
def load_prior_lifter(name: str, skeleton: Skeleton) -> Lifter | None:
    """Load the lifter that `solver.prior` names, once a process; none for `pca` or another skeleton.

    Raises:
        ModelError: The file cannot be read, or it is not a lifter.
    """
    if name == PCA or skeleton.joints != CMU15.joints:
        return None
    return load_shipped_lifter() if name == LEARNED else load_lifter(name)


def load_lifter(path: str | Path) -> Lifter:
    """Load a lifter from a file; a `ModelError` says why it cannot be."""
    try:
        with open_input_file(path) as file:
            return decode_lifter(file.read(MAX_LIFTER_BYTES + 1), f'solver.prior: {path}')
    except OSError as error:
        raise ModelError(f'solver.prior: {path}: {error.strerror}; expected learned, pca or a lifter') from None


def decode_lifter(data: bytes, source: str) -> Lifter:
    """Decode a lifter from the bytes of its file; `source` names it in a `ModelError`."""
    with _open_model(data, MAX_LIFTER_BYTES, source, 'lifter') as (meta, arrays):
        if meta['format'] != LIFTER_FORMAT or not np.allclose(meta['slots'], HISTORY_SLOTS_S):
            raise ValueError(f'format {meta["format"]!r}, expected {LIFTER_FORMAT!r}')
        if not isinstance(meta['provenance'], dict):
            raise ValueError('provenance: expected a mapping')
        layers = tuple((arrays[f'w{i}'], arrays[f'b{i}']) for i in range(len(arrays) // 2))
        _check_lifter(layers)
        return Lifter(layers, meta['provenance'])


def _check_lifter(layers: Layers) -> None:
    """Raise `ValueError` for shapes and values of a lifter's layers that no training produces."""
    if len(layers) < 2 or len(layers) % 2:
        raise ValueError(f'{len(layers)} layers, expected an even number of at least 2')
    width = layers[0][0].shape[-1]
    sizes = [FEATURE_COUNT, *[width] * (len(layers) - 1), OUTPUT_COUNT]
    for i, (weights, bias) in enumerate(layers):
        if weights.shape != (sizes[i], sizes[i + 1]) or bias.shape != (sizes[i + 1],):
            raise ValueError(f'layer {i}: shapes {weights.shape}, {bias.shape}')
        if max(float(np.abs(weights).max()), float(np.abs(bias).max())) > MAX_PARAMETER:
            raise ValueError(f'layer {i}: numbers beyond {MAX_PARAMETER:g}')
