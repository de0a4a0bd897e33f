"""Training of base poses: other bodies are as symmetric as people are."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.base_poses import BasePoses, mirror_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.training.base_poses import fit_base_poses


def test_random_bodies_have_equal_left_and_right_bones(walk_model: BasePoses) -> None:
    standing = (walk_model.mean + mirror_poses(walk_model.mean, CMU15)) / 2
    direction = (walk_model.components[0] + mirror_poses(walk_model.components[0], CMU15)) / 2
    poses = standing + 0.2 * np.sin(np.linspace(0, 6, 30))[:, None, None] * direction
    model = fit_base_poses([poses], alignment='heading', bodies=6)
    assert model.mean == pytest.approx(mirror_poses(model.mean, CMU15), abs=1e-6)
    for component in model.components:
        assert component == pytest.approx(mirror_poses(component, CMU15), abs=1e-4)
    assert len(model.std) > 3, 'the bodies differ'
