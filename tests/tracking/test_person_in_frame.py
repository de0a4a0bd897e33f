"""The person that the tracker returns: standard deviations in metres, at any distance."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk

CONFIG = with_values(Config(), {'solver.components': 8, 'solver.prior': 'learned'})


def track(model: BasePoses, size: float) -> Person3D:
    """Return the person at the end of a walk whose image is `size` times as large."""
    _, _, points, _ = make_walk(model, frames=12)
    camera = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    tracker = Tracker(model, CONFIG)
    for frame, image in enumerate(points):
        seen = Person2D('', CMU15.joints, (image - camera.center) * size + camera.center, np.ones(15))
        (person,) = tracker.update(frame * 33_333_333, [seen], camera)
    return person


def test_standard_deviations_are_in_metres_at_any_distance(walk_model: BasePoses) -> None:
    near, far = track(walk_model, 1.0), track(walk_model, 0.5)
    assert far.joints[:, 2].mean() == pytest.approx(2 * near.joints[:, 2].mean(), rel=0.02)
    assert far.std == pytest.approx(near.std, rel=0.1)
    assert 0.005 < np.median(near.std) < 0.1, 'm'
