# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training recovers a linear model, files preserve it, and anything that is not a model is refused."""

import contextlib
import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.errors import ModelError
from mocap_ros.geometry import rotations
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models import base_poses, model_file
from mocap_ros.skeleton import CMU15
from mocap_ros.training.fit_base_poses import fit_base_poses


def make_poses(rng: np.random.Generator, model: base_poses.BasePoses, k: int = 3) -> base_poses.Array:
    theta = rng.normal(size=(400, k)) * model.std[:k]
    rotation = rotation_from_vector(np.outer(rng.uniform(-3, 3, 400), [0, 0, 1]))
    return model.poses(theta) @ np.swapaxes(rotation, -1, -2) + rng.normal(size=(400, 1, 3))


@pytest.mark.parametrize('alignment', ['rotation', 'heading'])
def test_fit_spans_the_poses_it_was_trained_on(
    rng: np.random.Generator, walk_model: base_poses.BasePoses, alignment: str
) -> None:
    poses = make_poses(rng, walk_model)
    model = fit_base_poses([poses], alignment=alignment)
    align = rotations.fit_rotation if alignment == 'rotation' else rotations.fit_heading_rotation
    body = rotations.centre_poses(poses)
    body = body @ np.swapaxes(align(body, model.mean), -1, -2)
    assert np.abs(model.poses(model.weights(body)) - body).max() < 1e-3
    flat = model.components.reshape(len(model.std), -1)
    assert flat @ flat.T == pytest.approx(np.eye(len(flat)), abs=1e-9)
    assert (np.diff(model.std) <= 0).all()
    assert model.explained[2] > 0.99


def test_save_and_load(tmp_path: Path, walk_model: base_poses.BasePoses) -> None:
    model_file.save_base_poses(walk_model, tmp_path / 'a.npz')
    model_file.save_base_poses(walk_model, tmp_path / 'b.npz')
    assert (tmp_path / 'a.npz').read_bytes() == (tmp_path / 'b.npz').read_bytes()
    loaded = model_file.load_base_poses(tmp_path / 'a.npz')
    assert loaded.components == pytest.approx(walk_model.components, abs=1e-6)
    assert loaded.provenance == walk_model.provenance


@pytest.mark.parametrize('name', ['walk', 'run', 'jump', 'all'])
def test_shipped_models_have_provenance_and_axes(name: str) -> None:
    model = model_file.load_base_poses(name)
    assert model.name == name
    assert len(model.std) >= 30
    assert 'mocap.cs.cmu.edu' in str(model.provenance['acknowledgement'])
    assert model.mean[CMU15.index('lshoulder')][1] > 0.1, 'left is +y'
    assert model.mean[CMU15.index('head')][2] > 0.4, 'up is +z'
    assert model.mean[CMU15.index('lknee')][0] > model.mean[CMU15.index('lankle')][0], 'front is +x'


def test_files_that_are_not_models_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / 'm.npz'
    for data in (b'', b'PK\x03\x04 not really', rng.bytes(2000)):
        path.write_bytes(data)
        with pytest.raises(ModelError, match=r'm\.npz'):
            model_file.load_base_poses(path)
    np.savez(path, mean=np.array([object()], dtype=object))
    with pytest.raises(ModelError, match=r'm\.npz'):
        model_file.load_base_poses(path)
    with pytest.raises(ModelError, match=r"'moonwalk'.*all, jump, run, walk"):
        model_file.load_base_poses('moonwalk')


def test_invalid_training_data_is_refused_by_name(walk_model: base_poses.BasePoses) -> None:
    def bodies(count: int) -> base_poses.Array:
        return np.repeat(walk_model.mean[None], count, axis=0)

    bad = bodies(5)
    bad[2, 3, 1] = np.nan
    for trials, message in (
        ([], 'at least two'),
        ([bodies(1)], 'at least two'),
        ([bodies(5), bodies(5)[:, :14]], r'trial b has shape \(5, 14, 3\)'),
        ([bad], 'trial a holds numbers that are not finite'),
        ([bodies(5)], 'the poses do not vary'),
        ([bodies(5), bodies(5) * 0], 'trial b: a body 0 m tall, expected 0.3 to 3.0 m'),
        ([bodies(5) * 1000], 'trial a: joints more than 6 m apart; m expected'),
        ([bodies(5) * 1e160], 'trial a: joints more than 6 m apart'),
    ):
        with pytest.raises(ModelError, match=message):
            fit_base_poses(trials, labels=['a', 'b'][: len(trials)])


def model_bytes(model: base_poses.BasePoses, meta: dict[str, Any], **arrays: Any) -> bytes:
    """Return the bytes of a model's file with some entries replaced."""
    buffer = io.BytesIO()
    model_file.save_base_poses(model, buffer)
    with np.load(io.BytesIO(buffer.getvalue())) as archive:
        content = dict(archive)
    content['meta'] = np.array(json.dumps(json.loads(str(content['meta'])) | meta))
    out = io.BytesIO()
    np.savez_compressed(out, **{**content, **arrays})
    return out.getvalue()


BAD_MODELS: dict[str, tuple[dict[str, Any], Callable[[base_poses.BasePoses], dict[str, Any]], str]] = {
    'format': ({'format': 'x'}, lambda _: {}, "format 'x'"),
    'provenance': ({'provenance': [1]}, lambda _: {}, 'provenance: expected a mapping'),
    'name': ({'name': 'x' * 101}, lambda _: {}, 'name: expected a text of at most 100 characters'),
    'stature': ({'stature': 170}, lambda _: {}, 'stature: 170, expected'),
    'stature not a number': ({'stature': math.nan}, lambda _: {}, 'stature: nan'),
    'stature as text': ({'stature': 'tall'}, lambda _: {}, 'could not convert'),
    'skeleton': ({'skeleton': 'coco17'}, lambda _: {}, 'skeleton: coco17, expected cmu15'),
    'unknown skeleton': ({'skeleton': 3}, lambda _: {}, 'unknown keypoint layout 3'),
    'mean': ({}, lambda m: {'mean': m.mean * 1000}, 'mean: a joint beyond 3 m'),
    'shape': ({}, lambda m: {'mean': m.mean[:14]}, r'mean: shape \(14, 3\), expected \(15, 3\)'),
    'fewer': ({}, lambda m: {'std': m.std[:3]}, r'std: shape \(3,\), expected'),
    'none': ({}, lambda m: {'std': m.std[:0], 'components': m.components[:0], 'explained': m.std[:0]}, 'shape'),
    'zero': ({}, lambda m: {'std': m.std * 0}, 'std: outside'),
    'infinite': ({}, lambda m: {'std': m.std / 0.0}, 'std: numbers that are not finite'),
    'rising': ({}, lambda m: {'std': m.std[::-1]}, 'std: not decreasing'),
    'long': ({}, lambda m: {'components': m.components * 2}, 'components: not orthonormal'),
    'oblique': (
        {},
        lambda m: {'components': m.components[:1].repeat(len(m.std), 0)},
        'components: not orthonormal',
    ),
    'integers': ({}, lambda m: {'mean': m.mean.astype(int)}, 'mean: holds int64'),
    'objects': ({}, lambda m: {'mean': m.mean.astype(object)}, 'holds Python objects'),
    'bomb': ({}, lambda _: {'more': np.zeros(1 << 22)}, 'holds more than 16 MiB'),
}


@pytest.mark.parametrize('case', BAD_MODELS)
def test_every_value_of_a_model_is_checked(walk_model: base_poses.BasePoses, case: str) -> None:
    meta, arrays, message = BAD_MODELS[case]
    with np.errstate(divide='ignore'):
        data = model_bytes(walk_model, meta, **arrays(walk_model))
    with pytest.raises(ModelError, match=rf'm\.npz: not a base-pose model \(.*{message}') as caught:
        model_file.decode_base_poses(data, 'm.npz')
    assert 'pickle' not in str(caught.value)


@settings(max_examples=60)
@given(data=st.data())
def test_a_corrupted_model_is_read_or_refused(walk_model: base_poses.BasePoses, data: st.DataObject) -> None:
    content = bytearray(model_bytes(walk_model, {}))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ModelError):
        assert model_file.decode_base_poses(bytes(content), 'm.npz').skeleton == CMU15
