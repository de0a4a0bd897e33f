# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files of models: what is saved is read again, what ships is complete, and anything else is refused."""

import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import ModelError
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import OUTPUT_COUNT, Lifter
from mocap_ros.models.lifter_input import FEATURE_COUNT
from mocap_ros.skeleton import CMU15

SHAPES = (FEATURE_COUNT, 2), (2, OUTPUT_COUNT)
SMALL_LIFTER = Lifter(tuple((np.zeros(s, 'f4'), np.zeros(s[1], 'f4')) for s in SHAPES), {})


def test_models_are_saved_and_read(tmp_path: Path, walk_model: BasePoses) -> None:
    lifter = model_file.load_shipped_lifter()
    for name in 'ab':
        model_file.save_base_poses(walk_model, tmp_path / f'{name}.npz')
        model_file.save_lifter(lifter, tmp_path / f'lifter_{name}.npz')
    for kind in ('', 'lifter_'):
        assert (tmp_path / f'{kind}a.npz').read_bytes() == (tmp_path / f'{kind}b.npz').read_bytes()
    model, read = model_file.load_base_poses(tmp_path / 'a.npz'), model_file.load_lifter(tmp_path / 'lifter_a.npz')
    assert model.components == pytest.approx(walk_model.components, abs=1e-6)
    assert model.provenance == walk_model.provenance
    for layer, expected in zip(read.layers, lifter.layers, strict=True):
        assert all((a == b).all() for a, b in zip(layer, expected, strict=True))
    assert 'mocap.cs.cmu.edu' in str(read.provenance['acknowledgement'])


@pytest.mark.parametrize('name', ['walk', 'run', 'jump', 'all'])
def test_shipped_models_have_provenance_and_axes(name: str) -> None:
    model = model_file.load_base_poses(name)
    assert model.name == name
    assert len(model.std) >= 30
    assert 'mocap.cs.cmu.edu' in str(model.provenance['acknowledgement'])
    assert model.mean[CMU15.index('lshoulder')][1] > 0.1, 'left is +y'
    assert model.mean[CMU15.index('head')][2] > 0.4, 'up is +z'
    assert model.mean[CMU15.index('lknee')][0] > model.mean[CMU15.index('lankle')][0], 'front is +x'


@pytest.mark.parametrize('data', [b'', b'PK\x03\x04 not really', bytes(range(256)) * 8])
def test_files_that_are_not_models_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / 'm.npz').write_bytes(data)
    with pytest.raises(ModelError, match=r'm\.npz'):
        model_file.load_base_poses(tmp_path / 'm.npz')
    with pytest.raises(ModelError, match=r"'zumba'.*all, jump, run, walk"):
        model_file.load_base_poses('zumba')


def change_file(data: bytes, meta: dict[str, Any], arrays: dict[str, Any]) -> bytes:
    """Return the bytes of a model's file with entries replaced, or taken out where they are None."""
    with np.load(io.BytesIO(data)) as archive:
        content: dict[str, Any] = dict(archive)
    content['meta'] = np.array(json.dumps(json.loads(str(content['meta'])) | meta))
    out = io.BytesIO()
    np.savez_compressed(out, **{n: a for n, a in {**content, **arrays}.items() if a is not None})
    return out.getvalue()


def encode(save: Callable[..., None], model: Any) -> bytes:
    buffer = io.BytesIO()
    save(model, buffer)
    return buffer.getvalue()


BAD_MODELS: dict[str, tuple[dict[str, Any], Callable[[BasePoses], dict[str, Any]], str]] = {
    'format': ({'format': 'x'}, lambda _: {}, "format 'x'"),
    'provenance': ({'provenance': [1]}, lambda _: {}, 'provenance: '),
    'stature': ({'stature': 170}, lambda _: {}, 'stature: '),
    'stature not a number': ({'stature': math.nan}, lambda _: {}, 'stature: '),
    'skeleton': ({'skeleton': 'coco17'}, lambda _: {}, 'skeleton: '),
    'mean': ({}, lambda m: {'mean': m.mean * 1000}, 'mean: '),
    'fewer': ({}, lambda m: {'std': m.std[:3]}, 'std: '),
    'none': ({}, lambda m: {'std': m.std[:0], 'components': m.components[:0], 'explained': m.std[:0]}, 'shape'),
    'infinite': ({}, lambda m: {'std': m.std / 0.0}, 'std: '),
    'long': ({}, lambda m: {'components': m.components * 2}, 'components: '),
    'oblique': ({}, lambda m: {'components': m.components[:1].repeat(len(m.std), 0)}, 'components'),
    'integers': ({}, lambda m: {'mean': m.mean.astype(int)}, 'mean: '),
    'objects': ({}, lambda m: {'mean': m.mean.astype(object)}, 'holds Python objects'),
    'bomb': ({}, lambda _: {'more': np.zeros(1 << 22)}, 'holds more than 16 MiB'),
}


@pytest.mark.parametrize('case', BAD_MODELS)
def test_every_value_of_a_model_is_checked(walk_model: BasePoses, case: str) -> None:
    meta, arrays, message = BAD_MODELS[case]
    with np.errstate(divide='ignore'):
        data = change_file(encode(model_file.save_base_poses, walk_model), meta, arrays(walk_model))
    with pytest.raises(ModelError, match=rf'm\.npz: not a base-pose model \(.*{message}'):
        model_file.decode_base_poses(data, 'm.npz')


def end_with(array: np.ndarray, value: float) -> np.ndarray:
    return np.append(array.astype(float).ravel()[:-1], value).reshape(array.shape)


BAD_LIFTERS: dict[str, tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    'format': ({'format': 'x'}, lambda _: {}, "format 'x'"),
    'other times of the history': ({'slots': [0.0, 1.0]}, lambda _: {}, ''),
    'provenance': ({'provenance': [1]}, lambda _: {}, 'provenance: '),
    'integers': ({}, lambda a: {'w0': a['w0'].astype(int)}, 'w0: '),
    'no weights': ({}, lambda _: {'b0': None}, 'no b0'),
    'one layer': ({}, lambda _: {'w1': None, 'b1': None}, '1 layers, expected an even number of at least 2'),
    'other outputs': ({}, lambda a: {'b1': a['b1'][1:]}, r'layer 1: '),
    'not a number': ({}, lambda a: {'w1': end_with(a['w1'], np.nan)}, 'w1: '),
    'huge': ({}, lambda a: {'b1': end_with(a['b1'], 1e6)}, 'layer 1: '),
}


@pytest.mark.parametrize('case', BAD_LIFTERS)
def test_every_value_of_a_lifter_is_checked(case: str) -> None:
    meta, change, message = BAD_LIFTERS[case]
    data = encode(model_file.save_lifter, SMALL_LIFTER)
    with np.load(io.BytesIO(data)) as archive:
        arrays = change(dict(archive))
    model_file.decode_lifter(change_file(data, {}, {}), 'x')
    with pytest.raises(ModelError, match=rf'^x: not a lifter \(.*{message}'):
        model_file.decode_lifter(change_file(data, meta, arrays), 'x')
