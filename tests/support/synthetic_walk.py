# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A synthetic walk with known weights and cameras; its detections, trackers and tracks, frame by frame."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import Config
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.keypoints.left_right import BodySides, SwapFilter
from mocap_ros.keypoints.matching import DetectedBody
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Window
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.verdict.accuracy import scale_to_reference

# Rotation from the body frame (x forward, z up) to the optical frame of a camera that looks along x.
BODY_TO_OPTICAL = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])


class Walk(NamedTuple):
    """Weights (F, K) m, cameras, points (F, J, 2) px and times (F,) s of a motion."""

    theta: Array
    cameras: WeakPerspectiveCameras
    points: Array
    times: Array

    @property
    def window(self) -> Window:
        return Window(self.points, np.ones(self.points.shape[:2]), self.times)

    def poses(self, model: PoseModel) -> Array:
        """Return the joints (F, J, 3) m about the body's origin, along the axes of the camera."""
        return model.poses(self.theta) @ np.swapaxes(self.cameras.rotation, -1, -2)


def make_walk(model: PoseModel, frames: int = 40, k: int = 4, seed: int = 0) -> Walk:
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 30
    phase = rng.uniform(0, 6, k)
    theta = np.zeros((frames, len(model.std)))
    theta[:, :k] = model.std[:k] * np.sin(6 * times[:, None] + phase)
    heading = 0.8 + 0.3 * times
    rotation = BODY_TO_OPTICAL @ rotation_from_vector(heading[:, None] * [0, 0, 1])
    cameras = WeakPerspectiveCameras(200 + 10 * times, rotation)
    return Walk(theta, cameras, cameras.project(model.poses(theta)) + [320, 240], times)


def mpjpe_mm(found: Array, truth: Array) -> float:
    """Return the mean error of joints (F, J, 3) about their centroids, after one scale for the sequence."""
    found, truth = centre_poses(found), centre_poses(truth)
    return float(np.linalg.norm(scale_to_reference(found, truth) - truth, axis=-1).mean() * 1e3)


def with_scores(points: Array, score: float = 1.0) -> Array:
    """Return keypoints (F, J, 3) of points (F, J, 2) px that all have one score."""
    return np.concatenate([points, np.full((*points.shape[:2], 1), score)], axis=-1)


def make_sequence(
    keypoints: Array, times: Array, camera: Intrinsics, names: tuple[str, ...] = CMU15.joints
) -> KeypointSequence:
    """Return keypoints (F, J, 3) at times (F,) s in the images of a camera as a sequence."""
    return KeypointSequence(keypoints, names, times, camera.image_size or (640, 480), calibration=camera)


CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
STEP_NS = 33_333_333  # ns, 30 frames/s
MIRROR = np.array(CMU15.mirror)
UPPER = ~np.isin(CMU15.joints, ['pelvis', 'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle'])


def see(points: Array, name: str = '', score: Any = 1.0) -> Person2D:
    """Return a person at points (J, 2) px with scores (J,), or one score for all joints."""
    return Person2D(name, CMU15.joints, points, np.full(len(points), score, float))


def make_detection(points: Array, name: str = '', score: Any = 1.0) -> DetectedBody:
    (detection,) = DetectedBody.from_people([see(points, name, score)], CAMERA, min_score=0.1, min_joints=6)
    assert detection is not None
    return detection


def make_track(points: Array, window_s: float = 2.0) -> Track:
    """Return the track, without a solution, of a person seen at points (F, J, 2) px."""
    first, *rest = points
    track = Track.begin('person', 0, make_detection(first), SwapFilter(BodySides.of(CMU15)), CAMERA, CAMERA.focal)
    for frame, image in enumerate(rest, 1):
        track.add_frame(frame * STEP_NS, make_detection(image), window_s)
    return track


def change(track: Track, **values: Any) -> Track:
    """Return a copy of a track with other values of some attributes."""
    changed = track.copy()
    vars(changed).update(values)
    return changed


def feed(tracker: PeopleTracker, points: Array, start_ns: int = 0, camera: Intrinsics = CAMERA) -> list[Person3D]:
    """Track one person at points (F, J, 2) px; return the person of each frame."""
    return [tracker.update(start_ns + f * STEP_NS, [see(p)], camera).people[0] for f, p in enumerate(points)]


def track_walk(models: Mapping[str, PoseModel], config: Config, points: Array) -> PeopleTracker:
    """Return a tracker that has seen one person at points (F, J, 2) px and whose deferred work is done."""
    tracker = PeopleTracker(models, config)
    feed(tracker, points)
    tracker.run_deferred_work()
    return tracker
