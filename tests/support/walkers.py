# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People who walk about before several cameras, whose trackers know them but for errors of depth and size."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import CMU15
from tests.support.bodies import make_swinging_body

INTRINSICS = Intrinsics(800.0, (640.0, 480.0), is_focal_known=True, image_size=(1280, 960))
FLOOR_M = 0.88  # of the ankles below the pelvis of a body
DEPTH_STD = 0.01  # of the distance; of a joint in all frames along the line of sight
JITTER_M = 0.003  # of a joint in each frame


class Camera(NamedTuple):
    """A camera: pose (4, 4) from its optical frame to the world, in which y is down; rate and clock."""

    pose: Array
    rate_hz: float = 30.0
    clock_s: float = 0.0


def place_camera(azimuth_deg: float, distance: float = 4.0, pitch: float = 0.1, **options: float) -> Camera:
    """Return a camera that looks down at the middle of the world, from the height of a head."""
    pose, angle = np.eye(4), np.radians(azimuth_deg)
    pose[:3, :3] = rotation_from_vector(np.array([0, angle, 0])) @ rotation_from_vector(np.array([-pitch, 0, 0]))
    pose[:3, 3] = [-distance * np.sin(angle), -0.6, -distance * np.cos(angle)]
    return Camera(pose, **options)


def make_bodies(person: int, seconds: float, rate_hz: float) -> tuple[Array, Array]:
    """Return joints (F, 15, 3) m in the world of somebody who walks in a curve, and times (F,) s."""
    poses, times = make_swinging_body(round(seconds * rate_hz), rate_hz)
    if person:
        poses = poses[:, :, [2, 1, 0]] * np.array([1.0, 1.1, 1.0])  # moves otherwise
    turn = (0.7 + 0.4 * person) * times + 0.4 * np.sin(times) + 2 * person
    place = np.stack([np.cos(turn), 0 * turn, np.sin(2 * turn) / 2 + person], axis=1)
    return poses @ np.swapaxes(rotation_from_vector(turn[:, None] * [0, 1, 0]), 1, 2) + place[:, None], times


def see(camera: Camera, people: Sequence[int], seconds: float, seed: int = 0) -> list[PoseSequence]:
    """Return what the tracker of a camera makes of people."""
    rng = np.random.default_rng(seed)
    return [watch(camera, *make_bodies(person, seconds, camera.rate_hz), rng) for person in people]


def watch(camera: Camera, bodies: Array, times: Array, rng: np.random.Generator) -> PoseSequence:
    """Return what the tracker of a camera makes of joints (F, 15, 3) m in the world at times (F,) s."""
    true = (bodies - camera.pose[:3, 3]) @ camera.pose[:3, :3]
    pixels = INTRINSICS.project(true) + rng.normal(size=(*true.shape[:2], 2))
    joints = true * rng.normal(1, 0.02) * (1 + DEPTH_STD * rng.normal(size=(1, len(CMU15.joints), 1)))
    joints += JITTER_M * rng.normal(size=joints.shape)
    seen = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], axis=-1)
    count, stamps = len(times), times + camera.clock_s
    return PoseSequence(
        id=str(rng.integers(1000)),
        times=stamps,
        skeleton=CMU15,
        joints=joints,
        inferred=np.zeros(joints.shape[:2], bool),
        reprojection_residual=np.ones(count),
        intrinsics=INTRINSICS,
        vertical=np.tile(-camera.pose[1, :3], (count, 1)),
        vertical_std=np.full(count, 0.05),
        sequence=KeypointSequence(seen, CMU15.joints, stamps, (1280, 960), calibration=INTRINSICS),
    )
