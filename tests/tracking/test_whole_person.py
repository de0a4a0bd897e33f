# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People of the tracker with face, feet, hands, orientations and standard deviations."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk

FRAMES = 24
STEP_NS = 33_333_333
FACE = [BODY26.index(n) for n in ('nose', 'leye', 'reye', 'lear', 'rear')]


def track(frames: int = FRAMES, **values: object) -> list[tuple[Person3D, ...]]:
    """Return the people of the demo frame by frame, and those predicted for the frame after the last."""
    config = with_values(Config(), {f'tracker.{name}': value for name, value in values.items()})
    tracker, sequence = Tracker(load_base_pose_models('auto'), config), make_recording().sequence()
    found = []
    for frame in range(frames + 1):
        seen: list[Person2D] = [sequence.person(frame)] if frame < frames else []
        found.append(tracker.update(frame * STEP_NS, seen, sequence.intrinsics(1.0)))
        tracker.run_deferred_work()
    return found


@pytest.fixture(scope='module')
def whole() -> list[tuple[Person3D, ...]]:
    return track()


def test_without_face_feet_and_hands_people_have_the_same_core(whole: list[tuple[Person3D, ...]]) -> None:
    for (one,), (other,) in zip(whole, track(skeleton='cmu15'), strict=True):
        assert (one.skeleton, other.skeleton) == (BODY26, CMU15)
        for name in ('joints', 'std', 'inferred', 'velocity', 'orientation', 'turn_inferred'):
            np.testing.assert_array_equal(getattr(one, name)[:CORE_COUNT], getattr(other, name))
        np.testing.assert_array_equal(one.core, other.joints)


def test_what_the_detector_gives_is_seen_and_the_rest_inferred(whole: list[tuple[Person3D, ...]]) -> None:
    (last,), (predicted,) = whole[-2:]
    others = [j for j in range(CORE_COUNT, len(BODY26.joints)) if j not in FACE]
    assert not last.inferred[FACE].any()  # of coco17
    assert last.inferred[others].all()
    assert predicted.predicted
    assert predicted.inferred.all()
    assert predicted.turn_inferred.all()
    for person in (last, predicted):
        assert (person.std[CORE_COUNT:] > 0).all()
        assert np.isfinite(person.velocity).all()
        assert np.linalg.norm(person.orientation, axis=1) == pytest.approx(np.ones(len(BODY26.joints)))
    moved = np.linalg.norm(
        (predicted.joints - predicted.core.mean(axis=0)) - (last.joints - last.core.mean(axis=0)), axis=1
    )
    assert moved.max() < 0.15  # m in one frame


CONFIG = with_settings(Config(), {'solver.components': 8, 'solver.prior': 'learned'})


def follow(model: BasePoses, images: Array, camera: Intrinsics) -> Person3D:
    """Return the person at the end of image points (F, 15, 2) px."""
    tracker = Tracker(model, CONFIG)
    for frame, points in enumerate(images):
        (person,) = tracker.update(frame * STEP_NS, [Person2D('', CMU15.joints, points, np.ones(15))], camera)
    return person


@pytest.mark.parametrize('degrees', [30.0, 55.0])
def test_sizes_and_deviations_are_the_same_beside_the_optical_axis(walk_model: BasePoses, degrees: float) -> None:
    theta, cameras, _, _ = make_walk(walk_model, frames=12)
    bodies = walk_model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2) + [0.0, 0.0, 4.0]
    camera, turns = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True), np.radians([0.0, degrees])
    people = [
        follow(walk_model, camera.project(bodies @ rotation_from_vector(np.array([0.0, turn, 0.0])).T), camera)
        for turn in turns
    ]
    assert people[1].std == pytest.approx(people[0].std, rel=0.05)
    reach = [np.linalg.norm(p.joints[-11:].mean(axis=0) - p.joints[:15].mean(axis=0)) for p in people]
    noses = [np.linalg.norm(p.joints[BODY26.index('nose')] - p.joints[CMU15.index('head')]) for p in people]
    assert reach[1] == pytest.approx(reach[0], rel=0.03)
    assert noses[1] == pytest.approx(noses[0], rel=0.03)


def test_standard_deviations_are_in_metres_at_any_distance(walk_model: BasePoses) -> None:
    camera = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    points = make_walk(walk_model, frames=12)[2] - camera.center
    near, far = (follow(walk_model, points * size + camera.center, camera) for size in (1.0, 0.5))
    assert far.joints[:, 2].mean() == pytest.approx(2 * near.joints[:, 2].mean(), rel=0.02)
    assert far.std == pytest.approx(near.std, rel=0.1)
    assert 0.005 < np.median(near.std) < 0.1, 'm'
