# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training of base poses: other bodies are as symmetric as people are."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.base_poses import BasePoses, mirror_poses
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
