"""A person who is not seen is predicted: moved on, ever less certain, and never behind the camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Motion, MotionKind, Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.person_in_frame import make_person
from mocap_ros.tracking.prediction import PREDICTION_STD_PER_S, predict_person
from mocap_ros.tracking.schedule import Classification
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
FRAMES = 20
STEP_NS = 33_333_333
GAP = 12  # frames without a detection; 0.4 s


def track_walker(model: BasePoses, start: list[float], velocity: list[float], gap: int) -> list[Person3D]:
    """Return the last two people of a tracker: as last seen, and as predicted after a gap.

    Args:
        model: base poses of the motion.
        start: m, place of the body at first, in the camera's frame.
        velocity: m/s.
        gap: frames from the last detection to the prediction.
    """
    theta, cameras, _, times = make_walk(model, FRAMES)
    config = with_values(Config(), {'solver.components': 8, 'tracker.predict_for': 1.0})
    tracker = Tracker(model, config)
    poses = (
        model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2) * (config.tracker.body_height / model.stature)
    )
    joints = poses + np.array(start) + times[:, None, None] * np.array(velocity)
    for frame in range(FRAMES):
        seen = Person2D('', CMU15.joints, CAMERA.project(joints[frame]), np.ones(15))
        tracker.update(frame * STEP_NS, [seen], CAMERA)
    tracker.run_deferred_work()
    (track,) = tracker.snapshot().tracks
    last = make_person(track, len(track.seen.stamps_ns) - 1, tracker.models[track.solved.model_name])
    (predicted,) = tracker.update((FRAMES - 1 + gap) * STEP_NS, [], CAMERA)
    return [last, predicted]


def test_pose_and_image_move_on_with_the_velocity_of_the_body(walk_model: BasePoses) -> None:
    last, predicted = track_walker(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.3], GAP)
    movement = predicted.joints - last.joints
    assert movement == pytest.approx(np.broadcast_to(movement[0], (15, 3)), abs=1e-9)
    assert movement[0, :2] == pytest.approx([0.9 * 0.4, 0.0], abs=0.05)  # m; the depth is less certain
    root = last.joints.mean(axis=0) + movement[0]
    assert predicted.translation == pytest.approx(CAMERA.project(root), abs=15)
    assert predicted.translation[0] - last.translation[0] > 15, 'px to the right'
    assert predicted.scale == pytest.approx(CAMERA.focal / root[2], rel=0.02)
    assert predicted.predicted
    assert predicted.inferred.all()
    assert np.isnan(predicted.residual)


def test_the_standard_deviation_grows_with_the_gap(walk_model: BasePoses) -> None:
    for gap in (3, GAP):
        last, predicted = track_walker(walk_model, [0.0, 0.0, 4.0], [0.0, 0.0, 0.0], gap)
        growth = PREDICTION_STD_PER_S * gap / 30
        assert predicted.std == pytest.approx(np.sqrt(last.std**2 + growth**2), rel=1e-6)


def test_a_person_who_walks_towards_the_camera_is_not_predicted_behind_it(walk_model: BasePoses) -> None:
    last, predicted = track_walker(walk_model, [0.0, 0.0, 3.2], [0.0, 0.0, -2.5], 28)
    assert last.joints[:, 2].mean() < 2.0, 'in the next second the body would pass the camera'
    assert predicted.joints == pytest.approx(last.joints)
    assert predicted.translation == pytest.approx(last.translation)
    assert predicted.scale == pytest.approx(last.scale)


@pytest.mark.parametrize(('window_s', 'goes_on'), [(3.0, True), (0.8, False)])
def test_a_gait_goes_on_during_a_gap_if_a_cycle_is_known(
    walk_model: BasePoses, window_s: float, goes_on: bool
) -> None:
    cadence = 6 / (2 * np.pi)  # Hz of `make_walk`, whose cycle takes 1.05 s
    last, gaps = 55, (4, 8, 15)  # frames
    theta, cameras, _, _ = make_walk(walk_model, last + max(gaps) + 1)
    config = with_values(Config(), {'solver.components': 8, 'tracker.window': window_s})
    size = config.tracker.body_height / walk_model.stature
    joints = walk_model.poses(theta) @ np.swapaxes(cameras.rotation[:1], -1, -2) * size + [0.0, 0.0, 4.0]
    tracker = Tracker(walk_model, config)
    for frame in range(last + 1):
        seen = Person2D('', CMU15.joints, CAMERA.project(joints[frame]), np.ones(15))
        tracker.update(frame * STEP_NS, [seen], CAMERA)
    (track,) = tracker.snapshot().tracks
    model = tracker.models[track.solved.model_name]

    def measure_error(motion: Motion, gap: int) -> float:
        """Return the mean error of the joints about their centre, m."""
        schedule = replace(track.schedule, classification=Classification(motion, 'walk'))
        pose = predict_person(replace(track, schedule=schedule), (last + gap) * STEP_NS, model).joints
        truth = joints[last + gap]
        difference = pose - pose.mean(axis=0) - truth + truth.mean(axis=0)
        return float(np.linalg.norm(difference, axis=1).mean())

    for gap in gaps:
        periodic = measure_error(Motion(MotionKind.PERIODIC, 'walk', 0.0, cadence), gap)
        other = measure_error(Motion(MotionKind.NON_PERIODIC, 'walk', 0.0, math.nan), gap)
        assert periodic < 0.5 * other if goes_on else periodic == pytest.approx(other, abs=1e-9)
