# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A person who walks in a circle, as several cameras see them: each of a wrong size, with noise."""

from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.people import People
from mocap_ros.skeleton import CMU15, find_roots
from tests.support.bodies import make_swinging_body

CENTRES = np.array([[0.0, 0, 0], [4.0, 0, 4], [0.0, 0, 8], [-4.0, 0, 4]])  # m, around the middle at z = 4
FOCAL_PX = 600.0
FPS, SIZE_STD, JOINT_STD, ROOT_STD = 30.0, 0.07, 0.06, 0.015


def find_camera_pose(centre: Array) -> RigidTransform:
    """Return the pose of a camera at a centre of `CENTRES` that looks at the middle."""
    forward = np.array([0.0, 0, 4]) - centre
    forward /= np.linalg.norm(forward)
    down = np.array([0.0, 1, 0])
    rotation = np.stack([np.cross(down, forward), down, forward], axis=1)
    return RigidTransform(centre, quaternion_from_rotation(rotation))


def place_camera(centre: Array) -> CameraPlacement:
    return CameraPlacement(f'optical {centre.tolist()}', find_camera_pose(centre))


def make_truth(frames: int, place: Sequence[float] = (0.0, 0.0, 4.0), phase: float = 0.0) -> Array:
    """Return joints (F, 15, 3) m of a person who walks in a small circle about a place."""
    angle = 0.8 * np.arange(frames) / FPS + phase
    path = np.stack([0.4 * np.cos(angle), np.zeros(frames), 0.4 * np.sin(angle)], axis=1)
    return make_swinging_body(frames)[0] + (path + place)[:, None]


def see(truth: Array, centre: Array, size: float, rng: np.random.Generator, person_id: str = 'a') -> list[People]:
    """Return a person as a camera sees them in each frame: of a wrong size, so farther away, with noise."""
    seen, camera = [], find_camera_pose(centre)
    for joints in truth:
        root = find_roots(joints)
        sight = (root - centre) / np.linalg.norm(root - centre)
        outer = np.outer(sight, sight)
        shape = np.linalg.cholesky(np.eye(3) / 6 + outer / 2)
        noise = JOINT_STD * rng.standard_normal(joints.shape) @ shape.T
        noise -= find_roots(noise)
        found = centre + size * (joints + noise - centre) + ROOT_STD * rng.standard_normal(3)
        distance = float(np.linalg.norm(find_roots(found) - centre))
        in_camera = camera.inverse().apply(found.mean(axis=0))
        covariance = ROOT_STD**2 * np.eye(3) + (SIZE_STD * distance) ** 2 * outer
        seen.append(
            People(
                ids=(person_id,),
                skeleton=CMU15,
                joints=found[None],
                inferred=np.zeros((1, 15), bool),
                joint_std=np.full((1, 15), JOINT_STD),
                root_covariance=covariance[None],
                joint_velocity=np.zeros((1, 15, 3)),
                joint_velocity_std=np.full((1, 15), 0.1),
                root_velocity_covariance=np.eye(3)[None],
                joint_orientation=np.tile([0.0, 0, 0, 1], (1, 15, 1)),
                turn_inferred=np.zeros((1, 15), bool),
                scale=np.array([FOCAL_PX / in_camera[2]]),
                translation=FOCAL_PX * in_camera[None, :2] / in_camera[2] + [320.0, 240.0],
                rotation=np.eye(3)[None],
                age=np.zeros(1),
                is_scale_known=True,
            )
        )
    return seen
