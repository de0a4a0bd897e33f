# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rigid transforms between coordinate frames, their composition and their interpolation.

    x_parent = R x_child + t,    T_1 T_2 = (R_1 R_2, R_1 t_2 + t_1),    T^-1 = (R^T, -R^T t)
    q(a) = (sin((1 - a) w) q_0 + sin(a w) q_1) / sin w,    cos w = q_0 . q_1

At the share a of the time between two transforms, the translation is interpolated linearly, and the rotation along
the shortest arc of unit quaternions q_0 and q_1.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import parse_numbers
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.rotations import quaternion_from_rotation, rotation_from_vector

Quaternion = tuple[float, float, float, float]  # x, y, z, w, of unit length

NO_ROTATION: Quaternion = (0.0, 0.0, 0.0, 1.0)  # unit quaternion of no rotation
SAME_POSE = (0.0, 0.0, 0.0, *NO_ROTATION)  # translation in m and quaternion that leave everything where it is

MAX_COSINE = 0.9999999  # 1; above it two rotations are so close that the arc is a straight line
ROUNDING = 1e-12  # 1; a quaternion whose length is nearer to 1 is left as it is: another division changes bits
MAX_DISTANCE_M = 1e9  # m; beyond it, positions in single precision say nothing
QUATERNION_TOLERANCE = 0.1  # 1; a quaternion whose length is further from 1 is no rotation
# Rotation from a camera's optical frame (x right, y down, z forward) to a body's frame (x forward, y left, z up).
OPTICAL_TO_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
MAX_CAMERA_DISTANCE_M = 1e7  # m; frames of whole countries (UTM) are as large, and none is larger
POSE_NUMBERS = 6  # numbers of a pose in a parameter: x, y, z in m and roll, pitch, yaw in rad


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """A transform from a child frame to its parent frame."""

    translation: Array  # (3,) m, origin of the child frame in the parent frame
    quaternion: Quaternion  # rotation from the child frame to the parent frame

    @staticmethod
    def identity() -> RigidTransform:
        """Return the transform between two frames that are one."""
        return RigidTransform(np.zeros(3), NO_ROTATION)

    @staticmethod
    def from_numbers(numbers: Sequence[float]) -> RigidTransform:
        """Return the transform of the translation x, y, z in m and of the quaternion x, y, z, w, normalised.

        Raises:
            InputError: a number is not finite or beyond `MAX_DISTANCE_M`, or the quaternion is not of unit length.
        """
        length = math.sqrt(sum(q * q for q in numbers[3:7]))
        if not all(abs(n) <= MAX_DISTANCE_M for n in numbers) or not abs(length - 1) < QUATERNION_TOLERANCE:
            raise InputError(
                'the translation is not finite or absurdly far, or the quaternion is not of unit length'
            )
        if abs(length - 1) < ROUNDING:  # so that a transform that is written and read again is the same
            length = 1.0
        x, y, z, w = (q / length for q in numbers[3:7])
        return RigidTransform(np.array(numbers[:3], np.float64), (x, y, z, w))

    @staticmethod
    def from_matrix(matrix: Array) -> RigidTransform:
        """Return the transform of a matrix (4, 4)."""
        return RigidTransform(matrix[:3, 3].copy(), quaternion_from_rotation(matrix[:3, :3]))

    @property
    def rotation(self) -> Array:
        """(3, 3) rotation from the child frame to the parent frame."""
        x, y, z, w = self.quaternion
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def matrix(self) -> Array:
        """(4, 4) transform from the child frame to the parent frame."""
        return np.block([[self.rotation, self.translation[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

    def apply(self, points: Array) -> Array:
        """Return points (..., 3) of the child frame in the parent frame."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def rotate(self, vectors: Array) -> Array:
        """Return vectors (..., 3) of the child frame, such as velocities, in the parent frame."""
        return np.asarray(vectors @ self.rotation.T)

    def rotate_covariance(self, covariance: Array) -> Array:
        """Return the covariances (..., 3, 3) of vectors of the child frame in the parent frame."""
        rotation = self.rotation
        return np.asarray(rotation @ covariance @ rotation.T)

    def inverse(self) -> RigidTransform:
        """Return the transform from the parent frame to the child frame."""
        x, y, z, w = self.quaternion
        return RigidTransform(-(self.translation @ self.rotation), (-x, -y, -z, w))

    def compose(self, child: RigidTransform) -> RigidTransform:
        """Return this transform after another, whose parent frame is the child frame of this one."""
        x, y, z, w = self.quaternion
        a, b, c, d = child.quaternion
        product = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        length = math.sqrt(sum(q * q for q in product))
        x, y, z, w = (q / length for q in product)
        return RigidTransform(self.apply(child.translation), (x, y, z, w))


def interpolate(first: RigidTransform, second: RigidTransform, share: float) -> RigidTransform:
    """Return the transform at a share in [0, 1] of the way between two transforms (formula of the module)."""
    cosine = sum(p * q for p, q in zip(first.quaternion, second.quaternion, strict=True))
    sign = math.copysign(1.0, cosine)  # q and -q are one rotation; the arc between them must be the shorter one
    if abs(cosine) > MAX_COSINE:
        before, after = 1 - share, share
    else:
        angle = math.acos(abs(cosine))
        before, after = (math.sin(part * angle) / math.sin(angle) for part in (1 - share, share))
    mixed = [before * p + sign * after * q for p, q in zip(first.quaternion, second.quaternion, strict=True)]
    length = math.sqrt(sum(q * q for q in mixed))
    x, y, z, w = (q / length for q in mixed)
    translation = (1 - share) * first.translation + share * second.translation
    return RigidTransform(translation, (x, y, z, w))


def parse_camera_pose(text: str, name: str) -> RigidTransform:
    """Return the transform from a camera's optical frame to the frame in which its pose is given, as a text.

    The text is x, y, z in m and roll, pitch, yaw in rad, about the fixed axes in this order, of a camera that
    looks along x with z up where the angles are 0; `name` is that of the parameter.

    Raises:
        ConfigError: the text is not six finite numbers, an angle is beyond a turn, or a position too far.
    """
    numbers = parse_numbers(text)
    if len(numbers) != POSE_NUMBERS or not all(map(math.isfinite, numbers)):
        raise ConfigError(f'{name} = {text!r}: expected six numbers: x y z in m and roll pitch yaw in rad')
    if max(map(abs, numbers[:3])) > MAX_CAMERA_DISTANCE_M:
        raise ConfigError(f'{name} = {text!r}: the camera is more than {MAX_CAMERA_DISTANCE_M / 1e3:g} km away')
    if max(map(abs, numbers[3:])) > 2 * math.pi:
        raise ConfigError(f'{name} = {text!r}: an angle is more than a turn; angles are in rad, not in degrees')
    about_x, about_y, about_z = rotation_from_vector(np.diag(numbers[3:]))
    rotation = about_z @ about_y @ about_x @ OPTICAL_TO_BODY
    return RigidTransform(np.array(numbers[:3]), quaternion_from_rotation(rotation))


def format_camera_pose(pose: Array) -> str:
    """Return the text that `parse_camera_pose` reads, of a transform (4, 4) in m from a camera's optical frame."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)  # of a camera that looks straight down: its roll becomes 0
        angles = Rotation.from_matrix(pose[:3, :3] @ OPTICAL_TO_BODY.T).as_euler('xyz')
    return ' '.join(f'{number + 0.0:.4f}' for number in np.round([*pose[:3, 3], *angles], 4))
