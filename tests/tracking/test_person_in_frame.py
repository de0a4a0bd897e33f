# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The person that the tracker returns: standard deviations in metres, at any distance."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk

CONFIG = with_settings(Config(), {'solver.components': 8, 'solver.prior': 'learned'})


def track(model: BasePoses, size: float) -> Person3D:
    """Return the person at the end of a walk whose image is `size` times as large."""
    _, _, points, _ = make_walk(model, frames=12)
    camera = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    tracker = Tracker(model, CONFIG)
    for frame, image in enumerate(points):
        seen = Person2D('', CMU15.joints, (image - camera.center) * size + camera.center, np.ones(15))
        (person,) = tracker.update(frame * 33_333_333, [seen], camera)
    return person


@pytest.mark.parametrize('degrees', [30.0, 55.0])
def test_sizes_and_deviations_are_the_same_beside_the_optical_axis(walk_model: BasePoses, degrees: float) -> None:
    theta, cameras, _, _ = make_walk(walk_model, frames=12)
    bodies = walk_model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2) + [0.0, 0.0, 4.0]
    camera, people = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True), []
    for angle in (0.0, degrees):
        tracker = Tracker(walk_model, CONFIG)
        turn = rotation_from_vector(np.array([0.0, np.radians(angle), 0.0]))
        for frame, body in enumerate(bodies @ turn.T):
            seen = Person2D('', CMU15.joints, camera.project(body), np.ones(15))
            (person,) = tracker.update(frame * 33_333_333, [seen], camera)
        people.append(person)
    before, beside = people
    assert beside.std == pytest.approx(before.std, rel=0.05)
    reach = [np.linalg.norm(p.joints[-11:].mean(axis=0) - p.joints[:15].mean(axis=0)) for p in people]
    noses = [np.linalg.norm(p.joints[BODY26.index('nose')] - p.joints[CMU15.index('head')]) for p in people]
    assert reach[1] == pytest.approx(reach[0], rel=0.03)
    assert noses[1] == pytest.approx(noses[0], rel=0.03)


def test_standard_deviations_are_in_metres_at_any_distance(walk_model: BasePoses) -> None:
    near, far = track(walk_model, 1.0), track(walk_model, 0.5)
    assert far.joints[:, 2].mean() == pytest.approx(2 * near.joints[:, 2].mean(), rel=0.02)
    assert far.std == pytest.approx(near.std, rel=0.1)
    assert 0.005 < np.median(near.std) < 0.1, 'm'
