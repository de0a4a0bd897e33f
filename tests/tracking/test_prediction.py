# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A person who is not seen is predicted: moved on, ever less certain, and never behind the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.config import Config, with_settings
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15, CORE_COUNT
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.motion_filter import UNFILTERED
from mocap_ros.tracking.prediction import MIN_CLEARANCE_M, predict_people
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import change

Array = NDArray[np.float64]

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
FRAMES = 20
STEP_NS = 33_333_333
ONES = np.ones(15)  # scores
GAP = 12  # frames without a detection; 0.4 s


def make_scene(model: BasePoses, start: list[float], velocity: list[float]) -> Array:
    """Return the joints (FRAMES, 15, 3) m of a walk; start in m in the camera's frame, velocity in m/s."""
    theta, cameras, _, times = make_walk(model, FRAMES)
    size = Config().tracker.body_height / model.stature
    poses = model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2) * size
    return np.asarray(poses + np.array(start) + times[:, None, None] * np.array(velocity))


def track_walk(
    model: BasePoses, start: list[float], velocity: list[float], values: Mapping[str, object] | None = None
) -> Tracker:
    """Return a tracker that has seen the walk of `make_scene`."""
    tracker = Tracker(
        model, with_settings(Config(), {'solver.components': 8, 'tracker.predict_for': 1.0, **(values or {})})
    )
    see_walk(tracker, make_scene(model, start, velocity))
    tracker.run_deferred_work()
    return tracker


def see_walk(tracker: Tracker, scene: Array) -> Person3D:
    """Track joints (FRAMES, 15, 3) m; return the last person."""
    for frame, joints in enumerate(scene):
        found = tracker.update(frame * STEP_NS, [Person2D('', CMU15.joints, CAMERA.project(joints), ONES)], CAMERA)
    return found[0]


def predict(track: Track, stamp_ns: int) -> Person3D:
    (person,) = predict_people([track], stamp_ns, None, [BodySize(1.0, 0.08)], CMU15)
    return person


def test_a_person_who_walks_on_is_found_farther_on_and_less_certain(walk_model: BasePoses) -> None:
    tracker = Tracker(walk_model, with_settings(Config(), {'solver.components': 8, 'tracker.predict_for': 1.0}))
    last = see_walk(tracker, make_scene(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0]))
    soon, late = (tracker.update((FRAMES - 1 + gap) * STEP_NS, [], CAMERA)[0] for gap in (3, GAP))
    assert 0.6 < (late.root - last.root)[0] / (0.9 * 0.4) < 1.3, 'slower, as it walks otherwise than it moves'
    root = late.core.mean(axis=0)
    assert late.translation == pytest.approx(CAMERA.project(root))
    assert late.scale == pytest.approx(CAMERA.focal / root[2])
    assert 0.3 < late.root_velocity[0] < 1.5
    assert late.predicted
    assert late.inferred.all()
    assert late.unseen_for == pytest.approx(0.4, abs=1e-6)
    for before, after in ((last, soon), (soon, late)):
        assert (before.std[:CORE_COUNT] <= after.std[:CORE_COUNT]).all(), 'about the root'
        assert before.std.mean() < after.std.mean()
        assert (np.linalg.eigvalsh(after.root_covariance - before.root_covariance) > 0).all()


def test_a_person_who_reaches_the_camera_stays_there(walk_model: BasePoses) -> None:
    tracker = track_walk(walk_model, [0.0, 0.0, 4.0], [0.0, 0.0, -2.5])
    (track,) = tracker.tracks
    solution = track.solved
    depth = solution.sample_joints(track.observed.times, FRAMES - 1, np.zeros(1))[0, :, 2]
    nearer = [0.0, 0.0, depth.max() - 2 * depth.mean() + 0.6]  # m; then some of the way is left
    near = change(track, solution=replace(solution, roots=solution.roots + nearer), motion_filter=UNFILTERED)
    predicted = [predict(near, (FRAMES + gap) * STEP_NS) for gap in range(20)]
    depth = predicted[-1].joints[:CORE_COUNT, 2]
    assert 2 * depth.mean() - depth.max() == pytest.approx(MIN_CLEARANCE_M, abs=0.01)
    assert predicted[-1].joints[:, 2].min() > 0
    speeds = np.array([person.root_velocity[2] for person in predicted])
    assert speeds[0] < -1
    assert abs(speeds[-1]) < 0.5
    assert speeds.max() < 0.5, 'no jump back to where the person was'
    depths = np.array([person.root[2] for person in predicted])
    assert np.diff(depths).max() < 0.02
    assert depths[-1] < depths[0] - 0.3


def test_ahead_of_the_newest_image_and_through_a_gap_are_one_prediction(walk_model: BasePoses) -> None:
    tracker = track_walk(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0])
    (half_way,), (end,) = tracker.predict((GAP / 2 / 30, GAP / 30))
    (at_gap,) = tracker.update((FRAMES - 1 + GAP // 2) * STEP_NS, [], CAMERA)
    np.testing.assert_allclose(half_way.joints, at_gap.core, atol=1e-6)
    np.testing.assert_allclose(half_way.std, at_gap.std[:15], atol=1e-6)
    np.testing.assert_allclose(half_way.root_covariance, at_gap.root_covariance, atol=1e-6)
    ((from_gap,),) = tracker.predict((GAP / 2 / 30,))
    np.testing.assert_allclose(from_gap.joints, end.joints, atol=1e-6)
    assert from_gap.id == at_gap.id


def test_who_is_tentative_or_delayed_is_not_predicted(
    walk_model: BasePoses,
) -> None:
    tracker = Tracker(walk_model, with_settings(Config(), {'solver.components': 8}))
    assert tracker.predict((0.2, 0.4)) == [[], []]
    joints = make_scene(walk_model, [0.0, 0.0, 4.0], [0.0, 0.0, 0.0])
    for frame in range(2):
        tracker.update(frame * STEP_NS, [Person2D('', CMU15.joints, CAMERA.project(joints[frame]), ONES)], CAMERA)
        assert tracker.predict((0.2,)) == [[]], 'seen too shortly'
    lagged = track_walk(walk_model, [0.0, 0.0, 4.0], [0.0, 0.0, 0.0], {'tracker.lag': 0.2})
    assert lagged.predict((0.2,)) == [[]]
