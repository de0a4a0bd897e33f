# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People in 3D: those of one frame, and one person over time; and the kind of motion that they are in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Indices, Mask, copy_with
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence, describe_frames
from mocap_ros.skeleton import CMU15, CORE_COUNT, Skeleton, find_roots
from mocap_ros.summary import Summary
from mocap_ros.units import NS_PER_S


class MotionKind(IntEnum):
    """Kinds of motion, numbered as in `mocap_ros_msgs/msg/MotionState`."""

    UNKNOWN = 0
    PERIODIC = 1
    NON_PERIODIC = 2


class Posture(IntEnum):
    """What a person does, numbered as in `mocap_ros_msgs/msg/Skeleton3D` and `hri_msgs/msg/BodyPosture`."""

    UNKNOWN = 0
    STANDING = 1
    SITTING = 2
    CROUCHING = 3
    LYING = 4

    @staticmethod
    def read(numbers: Array) -> NDArray[np.int_]:
        """Return numbers as postures, unknown where they are none of them."""
        return np.where(np.isin(numbers, [*Posture]), numbers, Posture.UNKNOWN).astype(int)


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


UNKNOWN_COLUMN: NDArray[Any] = np.empty(0)  # stands for a column of which nothing is known


class Column(NamedTuple):
    """A column: its shape after that of the rows and, of some, of the joints, and what stands for the unknown."""

    shape: tuple[int, ...] = ()
    unknown: float = math.nan
    is_of_joints: bool = False

    def find_shape(self, rows: int, joints: int) -> tuple[int, ...]:
        """Return the shape of the column."""
        return (rows, joints, *self.shape) if self.is_of_joints else (rows, *self.shape)

    def fill(self, rows: int, joints: int) -> NDArray[Any]:
        """Return the column of which nothing is known."""
        return np.full(self.find_shape(rows, joints), self.unknown, type(self.unknown))


def _column(*shape: int, unknown: float = math.nan, is_of_joints: bool = False) -> Any:
    """Return the field of a column that may be left out, where nothing is known."""
    column = Column(shape, unknown, is_of_joints)
    return field(default_factory=lambda: UNKNOWN_COLUMN, metadata={'column': column})


def _list_columns(kind: type) -> dict[str, Column]:
    """Return all columns of a class by their names: those that have to be known, and the fields of the others."""
    known = {
        'joints': Column((3,), is_of_joints=True),
        'inferred': Column((), unknown=True, is_of_joints=True),
        'reprojection_residual': Column(),
    }
    return known | {own.name: own.metadata['column'] for own in fields(kind) if own.metadata}


def _fill_columns(instance: People | PoseSequence, columns: Mapping[str, Column]) -> None:
    for name, column in columns.items():
        if getattr(instance, name) is UNKNOWN_COLUMN:
            object.__setattr__(instance, name, column.fill(*instance.inferred.shape))


_UNKNOWN_MOTION = Motion(MotionKind.UNKNOWN, '', math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Person3D:
    """One reconstructed person in one frame: a row of `People`.

    Attributes:
        id: name of the person, the same in all frames.
        skeleton: names and order of the joints; the first are always those of `skeleton.CMU15`, the core.
        joints: (J, 3) m, joint positions in the camera's optical frame, in the order of `skeleton`.
        joint_std: (J,) m, standard deviation of each joint position; NaN if unknown.
        inferred: (J,) True for joints that were not seen and were inferred by the model.
        joint_velocity: (J, 3) m/s, velocity of each joint in the same frame as `joints`; NaN if unknown.
        joint_velocity_std: (J,) m/s, standard deviation of each joint's velocity; NaN if unknown.
        root_covariance: (3, 3) m^2, covariance of `root`; NaN if unknown.
        root_velocity_covariance: (3, 3) m^2/s^2, covariance of `root_velocity`; NaN if unknown.
        joint_orientation: (J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the
            frame of `joints` (`solvers.extremities` has the axes); NaN if unknown.
        turn_inferred: (J,) True where nothing in the image shows how that segment is turned about its own axis.
        contact: (2,) probabilities that the left and the right foot stand; NaN if unknown.
        posture: a `Posture`.
        posture_probability: its probability; 0 if unknown.
        scale: px/m, scale of the weak-perspective camera.
        rotation: (3, 3) rotation from the body frame to the camera's optical frame.
        translation: (2,) px, image point of the body's origin, which is the mean of its joints.
        motion: classification of the motion up to this frame.
        reprojection_residual: px, RMS reprojection error over the seen joints; NaN if no joint was seen.
        is_scale_known: True if the focal length is known and not nominal.
        predicted: True if the person was not detected in this frame.
        tentative: True if the person has been seen too shortly to be certain.
        age: s, time since the person was first seen; NaN if unknown.
        unseen_for: s, time since the person was last seen; 0 if in this frame.
    """

    id: str
    skeleton: Skeleton
    joints: Array
    joint_std: Array
    inferred: Mask
    joint_velocity: Array
    joint_velocity_std: Array
    root_covariance: Array
    root_velocity_covariance: Array
    joint_orientation: Array
    turn_inferred: Mask
    contact: Array
    posture: int
    posture_probability: float
    scale: float
    rotation: Array
    translation: Array
    motion: Motion
    reprojection_residual: float
    is_scale_known: bool
    predicted: bool
    tentative: bool
    age: float
    unseen_for: float

    def __repr__(self) -> str:
        if self.predicted:
            how = 'predicted'
        else:
            seen, residual = (~self.inferred).sum(), self.reprojection_residual
            how = f'{seen} of {len(self.inferred)} joints seen, residual {residual:.1f} px'
        how = f'tentative, {how}' if self.tentative else how
        return f'Person3D {self.id!r}: {self.core.mean(axis=0)[2]:.1f} m away, {how}, {self.motion}'

    @property
    def core(self) -> Array:
        """(15, 3) m, the joints of `skeleton.CMU15`, without face, feet and hands."""
        return self.joints[:CORE_COUNT]

    @property
    def root(self) -> Array:
        """(3,) m, midway between the hips."""
        return find_roots(self.joints)

    @property
    def root_velocity(self) -> Array:
        """(3,) m/s, velocity of `root`; NaN if unknown."""
        return find_roots(self.joint_velocity)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (J,) of the joints."""
        return self.skeleton.joints


@dataclass(frozen=True, eq=False)
class People:
    """The N people of one frame, in columns; each has the shape that `Person3D` says after N rows.

    `people[i]` is a person, and the people can be iterated.
    """

    ids: tuple[str, ...]
    skeleton: Skeleton
    joints: Array
    inferred: Mask
    is_scale_known: bool = False  # of all
    motion: tuple[Motion, ...] = ()
    joint_std: Array = _column(is_of_joints=True)
    reprojection_residual: Array = _column()
    rotation: Array = _column(3, 3)
    root_covariance: Array = _column(3, 3)
    joint_orientation: Array = _column(4, is_of_joints=True)
    turn_inferred: Mask = _column(unknown=True, is_of_joints=True)
    contact: Array = _column(2)
    posture: NDArray[np.integer[Any]] = _column(unknown=0)
    posture_probability: Array = _column(unknown=0.0)
    predicted: Mask = _column(unknown=False)
    tentative: Mask = _column(unknown=False)
    joint_velocity: Array = _column(3, is_of_joints=True)
    joint_velocity_std: Array = _column(is_of_joints=True)
    root_velocity_covariance: Array = _column(3, 3)
    scale: Array = _column()
    translation: Array = _column(2)
    age: Array = _column()
    unseen_for: Array = _column(unknown=0.0)

    def __post_init__(self) -> None:
        _fill_columns(self, PEOPLE_COLUMNS)
        if len(self.motion) != len(self.ids):
            object.__setattr__(self, 'motion', (_UNKNOWN_MOTION,) * len(self.ids))

    @staticmethod
    @lru_cache(maxsize=10)  # skeletons
    def none(skeleton: Skeleton = CMU15) -> People:
        """Return nobody."""
        count = len(skeleton.joints)
        return People((), skeleton, np.zeros((0, count, 3)), np.zeros((0, count), bool))

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Person3D]:
        return (self[row] for row in range(len(self.ids)))

    def __getitem__(self, row: int) -> Person3D:
        values = {name: getattr(self, name)[row] for name in PEOPLE_COLUMNS}
        values |= {name: value.item() for name, value in values.items() if not value.ndim}
        return Person3D(
            id=self.ids[row],
            skeleton=self.skeleton,
            motion=self.motion[row],
            is_scale_known=self.is_scale_known,
            **values,
        )

    @property
    def core(self) -> Array:
        """(N, 15, 3) m, the joints of `skeleton.CMU15`, without face, feet and hands."""
        return self.joints[:, :CORE_COUNT]

    @property
    def roots(self) -> Array:
        """(N, 3) m, midway between the hips."""
        return find_roots(self.joints)

    @property
    def root_velocities(self) -> Array:
        """(N, 3) m/s, velocities of the roots; NaN if unknown."""
        return find_roots(self.joint_velocity)

    @property
    def certain(self) -> People:
        """Those who are not tentative."""
        return self.select(np.flatnonzero(~self.tentative)) if self.tentative.any() else self

    def select(self, rows: Sequence[int] | Indices) -> People:
        """Return the people of some rows, in that order."""
        rows = [int(row) for row in rows]
        columns = {name: getattr(self, name)[rows] for name in PEOPLE_COLUMNS}
        ids, motion = tuple(self.ids[row] for row in rows), tuple(self.motion[row] for row in rows)
        return copy_with(self, ids=ids, motion=motion, **columns)

    @staticmethod
    def concatenate(parts: Sequence[People]) -> People:
        """Return the people of one part or more, who have the same skeleton, one part after another."""
        shown = [part for part in parts if len(part)] or parts[:1]
        if len(shown) == 1:
            return shown[0]
        columns = {name: np.concatenate([getattr(part, name) for part in shown]) for name in PEOPLE_COLUMNS}
        ids = tuple(person_id for part in shown for person_id in part.ids)
        return copy_with(shown[0], ids=ids, motion=tuple(m for part in shown for m in part.motion), **columns)


PEOPLE_COLUMNS = _list_columns(People)


class PredictedPeople(NamedTuple):
    """The N people at a time ahead of an image."""

    ahead: float  # s after the image
    ids: tuple[str, ...]
    joints: Array  # (N, 15, 3) m, of `skeleton.CMU15`, in the same frame as those of the people
    joint_std: Array  # (N, 15) m, standard deviation of each joint position about the root; NaN if unknown
    root_covariance: Array  # (N, 3, 3) m^2, covariance of the root, midway between the hips; NaN if unknown


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """What a tracker returns for a frame."""

    stamp_ns: int  # of the frame that is shown; with `tracker.lag`, of an older one than the newest
    people: People  # in the order of the detections, and then those who are predicted
    vertical: CameraVertical | None  # what is known of the camera's vertical; None if nothing is
    has_restarted: bool = False  # whether the newest frame is the first after a start or restart
    backward_jump_s: float = 0.0  # s by which the stamp went back, so that tracking restarted
    is_floor_seen: bool = False  # whether anybody's feet fit a floor of known height, so that it shows their size
    swapped: int = 0  # people whose left and right were swapped back in the newest frame
    unusable: int = 0  # detections of the newest frame that were a part of a person, or of too few joints
    faults: tuple[str, ...] = ()  # what seems wrong with how people are detected, in words

    @property
    def time_s(self) -> float:
        """Time in s of the frame that is shown."""
        return self.stamp_ns / NS_PER_S


@dataclass(frozen=True, eq=False, repr=False)
class PoseSequence:
    """One person's 3D poses over time, as `mocap_ros.reconstruct` returns and result files and bags hold them.

    F frames, J = 26 joints of the layout `body26` (15 of `cmu15` with `tracker.skeleton: cmu15`, or by the method
    `keyframes`), K base poses. Coordinates are in metres in the camera's optical frame: x to the right, y down, z
    forward. NaN where something is not known.

    Attributes:
        id: name of the person; empty where there is none.
        times: (F,) s, times of the frames.
        skeleton: names and tree of the joints.
        joints: (F, J, 3) m, positions of the joints; NaN in frames in which the person was out of sight.
        inferred: (F, J) True where the joint was not seen in the image, so that the model inferred it.
        reprojection_residual: (F,) px, RMS reprojection error over the seen joints; NaN in frames without any.
        intrinsics: of the camera.
        rotation: (F, 3, 3) rotation from the body frame (x forward, y left, z up) to the camera's optical frame.
        joint_std: (F, J) m, standard deviation of each joint in the body.
        joint_orientation: (F, J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the
            optical frame. If a person stands upright with hanging arms, the axes of all segments are x forward, y
            left and z up. Successive quaternions do not change their sign. NaN where the joints are, or with the
            method `keyframes`.
        turn_inferred: (F, J) True where the image does not show how that segment is turned about its own axis z.
        root_covariance: (F, 3, 3) m^2, covariance of the place between the hips.
        contact: (F, 2) probabilities that the left and the right foot stand; NaN as the joints, where the image
            shows nothing of it, or with the method `keyframes`.
        posture: (F,) what the person does, a `Posture`.
        posture_probability: (F,) its probability; 0 where unknown.
        vertical: (F, 3) unit vectors upwards in the camera's optical frame.
        vertical_std: (F,) rad, standard deviations of the direction of `vertical`.
        motion: (F,) kind of motion, a `MotionKind`.
        cadence: (F,) Hz, full cycles; NaN for motion that is not periodic.
        predicted: (F,) True where the person was not detected.
        tentative: (F,) True where the person had been seen too shortly to be certain.
        world_from_camera: (4, 4) transform in m from the optical frame to a world: z up, the floor at z = 0, x
            where the person looks first, the origin below the first pelvis.
        floor_std: m, standard deviation of the height of the camera over that floor; NaN where no standing feet
            showed it, so that the lowest joints are the floor.
        body_height: m, the stature by which metres are measured.
        base_poses: name of the base poses that were used, such as `walk`, or the path of their file.
        weights: (F, K) m, weights of the base poses.
        success: True if the solver converged.
        message: why the solver stopped, as a sentence.
        iterations: number of iterations of the solver.
        cost: final value of the objective, m^2.
        sequence: the keypoints that were reconstructed; None where they are not stored.
        summary: what the poses rest on, and whether the input is `good`, `doubtful` or `wrong` (`grade`); as text,
            the line that the commands print. None where it is not known.
        recorded_ns: (F,) times in ns, where they are known more exactly than in s, or empty.
    """

    id: str
    times: Array
    skeleton: Skeleton
    joints: Array
    inferred: Mask
    reprojection_residual: Array
    intrinsics: Intrinsics
    rotation: Array = _column(3, 3)
    joint_std: Array = _column(is_of_joints=True)
    joint_orientation: Array = _column(4, is_of_joints=True)
    turn_inferred: Mask = _column(unknown=True, is_of_joints=True)
    root_covariance: Array = _column(3, 3)
    contact: Array = _column(2)
    posture: NDArray[np.integer[Any]] = _column(unknown=0)
    posture_probability: Array = _column(unknown=0.0)
    vertical: Array = _column(3)
    vertical_std: Array = _column()
    motion: NDArray[np.integer[Any]] = _column(unknown=0)
    cadence: Array = _column()
    predicted: Mask = _column(unknown=False)
    tentative: Mask = _column(unknown=False)
    world_from_camera: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    floor_std: float = math.nan
    body_height: float = math.nan
    base_poses: str = ''
    weights: Array = _column(0)
    success: bool = True
    message: str = ''
    iterations: int = 0
    cost: float = math.nan
    sequence: KeypointSequence | None = None
    summary: Summary | None = None
    recorded_ns: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        _fill_columns(self, SEQUENCE_COLUMNS)

    def __len__(self) -> int:
        """Return the number of frames F."""
        return len(self.times)

    def __repr__(self) -> str:
        words = f'PoseSequence: {describe_frames(self.times)}, {len(self.joint_names)} joints '
        words += f'({self.inferred.mean():.0%} inferred)'
        words += f', base poses {self.base_poses}' if self.base_poses else ''
        if self.summary is not None:
            words += f', residual {self.summary.residual_px:.2f} px, {self.summary.distance_m:.1f} m away'
            words += '' if self.is_scale_known else ' by the nominal focal length'
        return words if self.success else f'{words}. {self.message}'

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(J,) names of the joints."""
        return self.skeleton.joints

    @property
    def parents(self) -> tuple[int, ...]:
        """(J,) index of each joint's parent, -1 for the root."""
        return self.skeleton.parents

    @property
    def core(self) -> Array:
        """(F, 15, 3) m, the joints of `skeleton.CMU15`, without face, feet and hands."""
        return self.joints[:, :CORE_COUNT]

    @property
    def is_scale_known(self) -> bool:
        """True if the focal length was given; False if it is nominal, and the distances with it."""
        return self.intrinsics.is_focal_known

    @property
    def scale(self) -> Array:
        """(F,) px/m, scale of the weak-perspective camera."""
        return np.asarray(self.intrinsics.focal / self.core.mean(axis=1)[:, 2])

    @property
    def translation(self) -> Array:
        """(F, 2) px, image point of the mean of the joints of `skeleton.CMU15`."""
        return self.intrinsics.project(self.core.mean(axis=1))

    @property
    def stamps_ns(self) -> list[int]:
        """Times (F,) in ns."""
        return list(self.recorded_ns) or [round(float(t) * NS_PER_S) for t in self.times]

    @property
    def in_sight(self) -> Mask:
        """(F,) True in the frames that have a skeleton."""
        return np.asarray(np.isfinite(self.joints).all(axis=(1, 2)))

    @property
    def camera_height(self) -> float | None:
        """Height in m of the camera over the floor; None where nothing shows it."""
        return float(self.world_from_camera[2, 3]) if math.isfinite(self.floor_std) else None

    def select(self, frames: Mask) -> PoseSequence:
        """Return these frames alone, without the keypoints."""
        stamps = tuple(np.array(self.recorded_ns)[frames].tolist()) if self.recorded_ns else ()
        columns = {name: getattr(self, name)[frames] for name in SEQUENCE_COLUMNS}
        return replace(self, times=self.times[frames], recorded_ns=stamps, sequence=None, **columns)


SEQUENCE_COLUMNS = _list_columns(PoseSequence)
SHARED_COLUMNS = {name: column for name, column in PEOPLE_COLUMNS.items() if name in SEQUENCE_COLUMNS}
