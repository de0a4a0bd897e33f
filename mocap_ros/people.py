# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A reconstructed person in 3D, and the kind of motion that the person is in."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.skeleton import CMU15, CORE_COUNT, Skeleton

HIPS = CMU15.index('lhip'), CMU15.index('rhip')  # joints between which the root is


class MotionKind(IntEnum):
    """Kinds of motion, numbered as in `mocap_ros_msgs/msg/MotionState`."""

    UNKNOWN = 0
    PERIODIC = 1
    NON_PERIODIC = 2


@dataclass(frozen=True)
class Motion:
    """Classification of the motion in a window of frames.

    Attributes:
        kind: periodic, non-periodic or unknown.
        category: name of the base-pose model in use, e.g. `walk`; empty if unknown.
        residual: RMS 2D residual of the category's model, divided by the body radius; NaN if unknown.
        cadence: Hz, full cycles; NaN for motion that is not periodic.
    """

    kind: MotionKind
    category: str
    residual: float
    cadence: float

    def __str__(self) -> str:
        words = [self.category, self.kind.name.lower().replace('_', '-') + ' motion']
        return ', '.join(w for w in words if w) + (f' of {self.cadence:.2f} Hz' if self.cadence > 0 else '')


class CameraVertical(NamedTuple):
    """The vertical of a camera: (3,) unit vector upwards in its optical frame, and the standard deviation, rad.

    `is_given`: whether a parameter or the floor gives it, so that it owes nothing to people.
    """

    direction: Array
    std: float
    is_given: bool = False


def _unknown(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True, eq=False)
class Person3D:
    """One reconstructed person in one frame.

    Attributes:
        id: name of the person, the same in all frames.
        joints: (J, 3) m, joint positions in the camera's optical frame, in the order of `skeleton`.
        std: (J,) m, standard deviation of each joint position; NaN if unknown.
        inferred: (J,) True for joints that were not seen and were inferred by the model.
        scale: px/m, scale of the weak-perspective camera.
        rotation: (3, 3) rotation from the body frame to the camera's optical frame.
        translation: (2,) px, image point of the body's origin, which is the mean of its joints.
        motion: classification of the motion up to this frame.
        residual: px, RMS reprojection error over the seen joints; NaN if no joint was seen.
        scale_known: True if the focal length is known and not nominal.
        predicted: True if the person was not detected in this frame.
        tentative: True if the person has been seen too shortly to be certain.
        velocity: (J, 3) m/s, velocity of each joint in the same frame as `joints`; NaN if unknown.
        velocity_std: (J,) m/s, standard deviation of each joint's velocity; NaN if unknown.
        root_covariance: (3, 3) m^2, covariance of `root`; NaN if unknown.
        root_velocity_covariance: (3, 3) m^2/s^2, covariance of `root_velocity`; NaN if unknown.
        age: s, time since the person was first seen; NaN if unknown.
        unseen_for: s, time since the person was last seen; 0 if in this frame.
        skeleton: names and order of the joints; the first are always those of `skeleton.CMU15`, the core.
        orientation: (J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the frame of
            `joints` (`solvers.extremities` has the axes); NaN if unknown.
        contact: (2,) probabilities that the left and the right foot stand; NaN if unknown.
        turn_inferred: (J,) True where nothing in the image shows how that segment is turned about its own axis.
    """

    id: str
    joints: Array
    std: Array
    inferred: NDArray[np.bool_]
    scale: float
    rotation: Array
    translation: Array
    motion: Motion
    residual: float
    scale_known: bool
    predicted: bool
    tentative: bool = False
    velocity: Array = field(default_factory=lambda: _unknown(len(CMU15.joints), 3))
    velocity_std: Array = field(default_factory=lambda: _unknown(len(CMU15.joints)))
    root_covariance: Array = field(default_factory=lambda: _unknown(3, 3))
    root_velocity_covariance: Array = field(default_factory=lambda: _unknown(3, 3))
    age: float = float('nan')
    unseen_for: float = 0.0
    skeleton: Skeleton = CMU15
    orientation: Array = field(default_factory=lambda: _unknown(len(CMU15.joints), 4))
    turn_inferred: NDArray[np.bool_] = field(default_factory=lambda: np.ones(len(CMU15.joints), bool))
    contact: Array = field(default_factory=lambda: _unknown(2))

    def __repr__(self) -> str:
        if self.predicted:
            how = 'predicted'
        else:
            how = f'{(~self.inferred).sum()} of {len(self.inferred)} joints seen, residual {self.residual:.1f} px'
        how = f'tentative, {how}' if self.tentative else how
        return f'Person3D {self.id!r}: {self.core.mean(axis=0)[2]:.1f} m away, {how}, {self.motion}'

    @property
    def core(self) -> Array:
        """(15, 3) m, the joints of `skeleton.CMU15`, without face, feet and hands."""
        return self.joints[:CORE_COUNT]

    @property
    def root(self) -> Array:
        """(3,) m, midway between the hips."""
        return np.asarray((self.joints[HIPS[0]] + self.joints[HIPS[1]]) / 2)

    @property
    def root_velocity(self) -> Array:
        """(3,) m/s, velocity of `root`; NaN if unknown."""
        return np.asarray((self.velocity[HIPS[0]] + self.velocity[HIPS[1]]) / 2)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (J,) of the joints."""
        return self.skeleton.joints


@dataclass(frozen=True, eq=False)
class PredictedPerson:
    """A person at a time ahead of an image."""

    id: str
    joints: Array  # (J, 3) m, in the same frame and order as those of `Person3D`
    std: Array  # (J,) m, standard deviation of each joint position about the root; NaN if unknown
    root_covariance: Array  # (3, 3) m^2, covariance of `root`; NaN if unknown

    @property
    def root(self) -> Array:
        """(3,) m, midway between the hips."""
        return np.asarray((self.joints[HIPS[0]] + self.joints[HIPS[1]]) / 2)
