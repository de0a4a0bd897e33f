# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training of base poses: linear models are recovered, other bodies are symmetric, bad trials are refused."""

import numpy as np
import pytest

from mocap_ros.errors import ModelError
from mocap_ros.geometry import rotations
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import Array, BasePoses, mirror_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.training.fit_base_poses import fit_base_poses


def test_random_bodies_have_equal_left_and_right_bones(walk_model: BasePoses) -> None:
    standing = (walk_model.mean + mirror_poses(walk_model.mean, CMU15)) / 2
    direction = (walk_model.components[0] + mirror_poses(walk_model.components[0], CMU15)) / 2
    poses = standing + 0.2 * np.sin(np.linspace(0, 6, 30))[:, None, None] * direction
    model = fit_base_poses([poses], alignment='heading', bodies=6)
    assert model.mean == pytest.approx(mirror_poses(model.mean, CMU15), abs=1e-6)
    for component in model.components:
        assert component == pytest.approx(mirror_poses(component, CMU15), abs=1e-4)
    assert len(model.std) > 3, 'the bodies differ'


def test_a_share_counts_as_often_as_the_trial_were_there(walk_model: BasePoses, rng: np.random.Generator) -> None:
    one, other = (walk_model.poses(rng.normal(0, 0.1, (20, 5))) for _ in range(2))
    weighted = fit_base_poses([one, other], shares=[3, 1], alignment='heading', mirror=True, bodies=1)
    repeated = fit_base_poses([one, one, one, other], alignment='heading', mirror=True)
    plain = fit_base_poses([one, other], shares=[3, 1], alignment='heading', mirror=True)
    assert plain.mean == pytest.approx(repeated.mean, abs=1e-6)
    assert plain.std == pytest.approx(repeated.std, rel=1e-4)
    assert plain.stature == pytest.approx(repeated.stature)
    assert weighted.std[: len(plain.std)] != pytest.approx(plain.std, rel=1e-4), 'the bodies differ'


def make_poses(rng: np.random.Generator, model: BasePoses, k: int = 3) -> Array:
    theta = rng.normal(size=(400, k)) * model.std[:k]
    rotation = rotation_from_vector(np.outer(rng.uniform(-3, 3, 400), [0, 0, 1]))
    return model.poses(theta) @ np.swapaxes(rotation, -1, -2) + rng.normal(size=(400, 1, 3))


@pytest.mark.parametrize('alignment', ['rotation', 'heading'])
def test_fit_spans_the_poses_it_was_trained_on(
    rng: np.random.Generator, walk_model: BasePoses, alignment: str
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


def test_invalid_training_data_is_refused_by_name(walk_model: BasePoses) -> None:
    good = np.repeat(walk_model.mean[None], 5, axis=0)
    bad = good.copy()
    bad[2, 3, 1] = np.nan
    for trials, message in (
        ([], 'at least two'),
        ([good[:1]], 'at least two'),
        ([good, good[:, :14]], 'trial b has shape'),
        ([bad], 'trial a'),
        ([good], 'do not vary'),
        ([good, good * 0], 'trial b: a body 0 m tall'),
        ([good * 1e160], 'trial a: joints more than 6 m apart'),
    ):
        with pytest.raises(ModelError, match=message):
            fit_base_poses(trials, labels=['a', 'b'][: len(trials)])
