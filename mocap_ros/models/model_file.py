"""Files of base poses and of the lifter: shipped with the package, or trained by its users."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import ModelError, reader_reason
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import FEATURES, OUTPUTS, SLOTS, Lifter
from mocap_ros.npz_file import open_npz, write_npz
from mocap_ros.skeleton import CMU15, Skeleton, layout

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

AUTO = 'auto'


LIFTER = 'lifter'


BASE_POSES_FORMAT = 'mocap_ros base poses 1'


LARGEST_MODEL = 16 << 20


LONGEST_NAME = 100


STATURES = 0.3, 3.0


FARTHEST_JOINT = 3.0


STDS = 1e-6, 10.0


ORTHONORMAL = 1e-2


def save_base_poses(model: BasePoses, path: str | Path | io.BytesIO) -> None:
    """Write a model as .npz (no pickles); the same model gives the same bytes."""
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


def shipped_base_poses() -> tuple[str, ...]:
    """Names of the models that come with the package."""
    folder = files('mocap_ros') / 'models' / 'shipped'
    names = (p.name.removesuffix('.npz') for p in folder.iterdir() if p.name.endswith('.npz'))
    return tuple(sorted(n for n in names if n != LIFTER))


def load_base_poses(name_or_path: str | Path) -> BasePoses:
    """A shipped model by name, or a trained one by path.

    Raises:
        ModelError: there is none of that name, or the file is not a base-pose model.
    """
    text = str(name_or_path)
    if text in shipped_base_poses():
        return base_poses_from_bytes(
            (files('mocap_ros') / 'models' / 'shipped' / f'{text}.npz').read_bytes(), text
        )
    path = Path(name_or_path)
    if not path.is_file():
        raise ModelError(
            f'no base-pose model {text!r}: neither a file nor one of {", ".join(shipped_base_poses())}'
        )
    try:
        with path.open('rb') as file:
            return base_poses_from_bytes(file.read(LARGEST_MODEL + 1), text)
    except OSError as error:
        raise ModelError(f'{text}: {error.strerror}') from None


def load_base_pose_models(name: str) -> dict[str, BasePoses]:
    """The model of that name or path, or for `auto` all shipped ones, by name.

    Raises:
        ModelError: as `load_base_poses`.
    """
    return {n: load_base_poses(n) for n in (shipped_base_poses() if name == AUTO else (name,))}


def base_poses_from_bytes(data: bytes, source: str) -> BasePoses:
    """A model from the bytes of its file; `source` names it in errors (ModelError)."""
    try:
        if len(data) > LARGEST_MODEL:
            raise ValueError(f'larger than {LARGEST_MODEL >> 20} MiB')
        with open_npz(io.BytesIO(data), LARGEST_MODEL) as archive:
            meta = json.loads(str(archive['meta']))
            arrays = {k: _numbers(archive[k], k) for k in ('mean', 'components', 'std', 'explained')}
        if meta['format'] != BASE_POSES_FORMAT:
            raise ValueError(f'format {meta["format"]!r}, expected {BASE_POSES_FORMAT!r}')
        model = BasePoses(
            name=meta['name'],
            skeleton=layout(meta['skeleton']),
            stature=float(meta['stature']),
            provenance=meta['provenance'],
            **arrays,
        )
        _check_base_poses(model)
    except KeyError as error:
        raise ModelError(f'{source}: not a base-pose model (no {str(error.args[0]).split()[0]})') from None
    except Exception as error:  # any malformed byte ends up here: the file comes from a stranger
        raise ModelError(f'{source}: not a base-pose model ({reader_reason(error)})') from None
    return model


def _numbers(array: NDArray[np.generic], key: str) -> Array:
    if array.dtype.kind != 'f':
        raise ValueError(f'{key}: holds {array.dtype}, expected floating point')
    numbers = array.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError(f'{key}: numbers that are not finite')
    return numbers


def _check_base_poses(model: BasePoses) -> None:
    """Refuse what no training makes (ValueError)."""
    joints, k = len(CMU15.joints), len(model.components)
    shapes = {'mean': (joints, 3), 'components': (k, joints, 3), 'std': (k,), 'explained': (k,)}
    for key, shape in shapes.items():
        if getattr(model, key).shape != shape or not k:
            raise ValueError(f'{key}: shape {getattr(model, key).shape}, expected {shape}')
    flat = model.components.reshape(k, -1)
    low, high = STATURES
    for fine, what in (
        (model.skeleton == CMU15, f'skeleton: {model.skeleton.name}, expected {CMU15.name}'),
        (isinstance(model.name, str) and len(model.name) <= LONGEST_NAME, 'name: no short text'),
        (isinstance(model.provenance, dict), 'provenance: no mapping'),
        (low <= model.stature <= high, f'stature: {model.stature:g}, expected {low} to {high} m'),
        ((np.abs(model.mean) <= FARTHEST_JOINT).all(), f'mean: a joint beyond {FARTHEST_JOINT:g} m'),
        (((model.std >= STDS[0]) & (model.std <= STDS[1])).all(), 'std: outside {:g} to {:g} m'.format(*STDS)),
        ((np.diff(model.std) <= ORTHONORMAL * model.std[:-1]).all(), 'std: not falling'),
        (np.abs(flat @ flat.T - np.eye(k)).max() <= ORTHONORMAL, 'components: not orthonormal'),
    ):
        if not fine:
            raise ValueError(what)


LIFTER_FORMAT = 'mocap_ros lifter 1'


LEARNED, PCA = PRIORS = 'learned', 'pca'


LARGEST_LIFTER = 64 << 20


LARGEST_NUMBER = 1e3


def save_lifter(lifter: Lifter, path: str | Path | io.BytesIO) -> None:
    """Write as .npz (no pickles), weights in half precision; the same lifter gives the same bytes."""
    arrays = {f'w{i}': weights.astype('f2') for i, (weights, _) in enumerate(lifter.layers)}
    arrays |= {f'b{i}': bias.astype('f2') for i, (_, bias) in enumerate(lifter.layers)}
    meta = {'format': LIFTER_FORMAT, 'slots': SLOTS.tolist(), 'provenance': dict(lifter.provenance)}
    write_npz(path, {**arrays, 'meta': np.array(json.dumps(meta, sort_keys=True))})


@cache
def shipped_lifter() -> Lifter:
    """The lifter that comes with the package."""
    return lifter_from_bytes((files('mocap_ros') / 'models' / 'shipped' / 'lifter.npz').read_bytes(), 'lifter')


@cache
def lifter_for_prior(name: str, skeleton: Skeleton) -> Lifter | None:
    """The lifter that `solver.prior` names: the shipped one for `learned`, none for `pca`, else that of a file.

    Lifters know the joints of `skeleton.CMU15` only; base poses of another `skeleton` go without. A file is read
    once in the life of a process.

    Raises:
        ModelError: no such file, or it is not a lifter.
    """
    if name == PCA or skeleton.joints != CMU15.joints:
        return None
    return shipped_lifter() if name == LEARNED else load_lifter(name)


def load_lifter(path: str | Path) -> Lifter:
    """A trained lifter.

    Raises:
        ModelError: no such file, or it is not a lifter.
    """
    try:
        with Path(path).open('rb') as file:
            return lifter_from_bytes(file.read(LARGEST_LIFTER + 1), str(path))
    except OSError as error:
        raise ModelError(f'solver.prior: {path}: {error.strerror}; expected learned, pca or a lifter') from None


def lifter_from_bytes(data: bytes, source: str) -> Lifter:
    """A lifter from the bytes of its file; `source` names it in errors (ModelError)."""
    try:
        with open_npz(io.BytesIO(data), LARGEST_LIFTER) as archive:
            meta = json.loads(str(archive['meta']))
            if meta['format'] != LIFTER_FORMAT or not np.allclose(meta['slots'], SLOTS):
                raise ValueError(f'format {meta["format"]!r}, expected {LIFTER_FORMAT!r}')
            count = (len(archive.files) - 1) // 2
            arrays = {k: archive[k] for k in archive.files if k != 'meta'}
            if any(a.dtype.kind != 'f' for a in arrays.values()) or not isinstance(meta['provenance'], dict):
                raise ValueError('arrays of real numbers and a mapping as provenance expected')
            layers = tuple(
                (np.ascontiguousarray(arrays[f'w{i}'], np.float32), np.asarray(arrays[f'b{i}'], np.float32))
                for i in range(count)
            )
        _check_lifter(layers)
        return Lifter(layers, meta['provenance'])
    except KeyError as error:
        raise ModelError(f'{source}: not a lifter (no {str(error.args[0]).split()[0]})') from None
    except Exception as error:  # any malformed byte ends up here: the file comes from a stranger
        raise ModelError(f'{source}: not a lifter ({reader_reason(error)})') from None


def _check_lifter(layers: Sequence[tuple[Array32, Array32]]) -> None:
    """Refuse what no training makes (ValueError)."""
    if len(layers) < 2 or len(layers) % 2:
        raise ValueError(f'{len(layers)} layers')
    width = layers[0][0].shape[-1]
    sizes = [FEATURES, *[width] * (len(layers) - 1), OUTPUTS]
    for i, (weights, bias) in enumerate(layers):
        if weights.shape != (sizes[i], sizes[i + 1]) or bias.shape != (sizes[i + 1],):
            raise ValueError(f'layer {i}: shapes {weights.shape}, {bias.shape}')
        if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
            raise ValueError(f'layer {i}: numbers that are not finite')
        if max(np.abs(weights).max(), np.abs(bias).max()) > LARGEST_NUMBER:
            raise ValueError(f'layer {i}: numbers beyond {LARGEST_NUMBER:g}')
