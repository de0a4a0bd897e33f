# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The skeletons of many Skeleton3DArray at once, as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.messages.columns import Columns, read_columns, read_stamps
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.skeleton import Skeleton, keypoint_layout

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MAX_COMPONENT = 2.0  # of a unit vector, far beyond its rounding; a larger one is damaged


class SkeletonMessages(NamedTuple):
    """N messages, whether there are people in them or not.

    Attributes:
        rows: (N,) indices of the messages among all those that were given.
        stamps_ns: (N,) ns.
        vertical: (N, 3) unit vectors upwards in the camera's optical frame; NaN where unknown.
        people: what is known of the people in them.
    """

    rows: Indices
    stamps_ns: NDArray[np.int64]
    vertical: Array
    people: list[SkeletonColumns]


class SkeletonColumns(NamedTuple):
    """One person in N messages.

    Attributes:
        id: id of the person.
        skeleton: skeleton of the joints.
        rows: (N,) indices of the messages among those of `SkeletonMessages`.
        joints: (N, J, 3) m in the camera's optical frame.
        std: (N, J) m, standard deviations; NaN where unknown.
        inferred: (N, J) True where the joint was not seen.
        cameras: (N, 3) scale in px/m, and translation in px, of the weak-perspective cameras.
        residual: (N,) px.
        cadence: (N,) Hz; NaN where the motion is not periodic.
        motion: (N,) kind of motion.
        predicted: (N,) True where the person was not detected.
        tentative: (N,) True where the person was seen too shortly.
    """

    id: str
    skeleton: Skeleton
    rows: Indices
    joints: Array
    std: NDArray[np.float32]
    inferred: NDArray[np.bool_]
    cameras: Array
    residual: NDArray[np.float32]
    cadence: NDArray[np.float32]
    motion: NDArray[np.uint8]
    predicted: NDArray[np.bool_]
    tentative: NDArray[np.bool_]


def read_skeletons(raws: Sequence[bytes]) -> Iterator[SkeletonMessages]:
    """Yield the skeletons of many Skeleton3DArray, in groups of messages of one form.

    Args:
        raws: CDR bytes of the messages.

    Raises:
        InputError: the bytes are not such messages, a camera pose is not valid, or the arrays of a person are not
            as long as the skeleton; groups before it were yielded.
    """
    for columns in read_columns(raws, SKELETONS):
        to_optical = _read_transforms(columns)
        vertical = columns.read('vertical')
        is_known = (np.abs(vertical) <= MAX_COMPONENT).all(axis=1) & vertical.any(axis=1)
        vertical = to_optical.rotate(np.where(is_known[:, None], vertical, np.nan))
        people = [p for i in range(columns.count('people')) for p in _read_person(columns, i, to_optical)]
        yield SkeletonMessages(columns.rows, read_stamps(columns), vertical, people)


def _read_person(columns: Columns, index: int, to_optical: _Transforms) -> Iterator[SkeletonColumns]:
    """Yield the people who are at one place in the list of people, each with the messages in which they are."""

    def read(*path: str) -> NDArray[Any]:
        return columns.read('people', index, *path)

    joints, std, inferred = read('joints'), read('joint_std'), read('inferred')
    if std.shape[1] != joints.shape[1]:
        std = np.full(joints.shape[:2], np.nan, np.float32)
    if not inferred.shape[1]:  # messages of 0.1, whose flags had another name
        inferred = np.zeros(joints.shape[:2], bool)
    arrays: tuple[NDArray[Any], ...] = (
        to_optical.apply(joints),
        std,
        inferred,
        np.column_stack([read('camera', 'scale'), read('camera', 'translation')]),
        read('reprojection_residual'),
        read('motion', 'cadence'),
        read('motion', 'state'),
        read('predicted'),
        read('tentative'),
    )
    paths = [('people', index, name) for name in ('id', 'skeleton')]
    for (person_id, name), rows in columns.group_texts(*paths):
        try:
            skeleton = keypoint_layout(name)
        except SkeletonError as error:
            raise InputError(f'skeleton: {error}') from None
        lengths = joints.shape[1], inferred.shape[1]
        if set(lengths) != {len(skeleton.joints)}:
            raise InputError(f'{lengths[0]} joints and {lengths[1]} flags, {name} has {len(skeleton.joints)}')
        yield SkeletonColumns(person_id, skeleton, rows, *(array[rows] for array in arrays))


class _Transforms(NamedTuple):
    """The transforms to the optical frame in N messages, most often none.

    Attributes:
        moved: messages (M,) whose frame is another one.
        transforms: (M,) transforms from that frame to the optical frame.
    """

    moved: list[int]
    transforms: list[RigidTransform]

    def apply(self, joints: Array) -> Array:
        """Return the joints (N, J, 3) in the optical frame."""
        out = joints.copy() if self.moved else joints
        for row, transform in zip(self.moved, self.transforms, strict=True):
            out[row] = transform.apply(joints[row])
        return out

    def rotate(self, vectors: Array) -> Array:
        """Return the vectors (N, 3) in the optical frame."""
        out = vectors.copy()
        for row, transform in zip(self.moved, self.transforms, strict=True):
            out[row] = transform.rotate(vectors[row])
        return out


def _read_transforms(columns: Columns) -> _Transforms:
    """Return the inverses of the camera poses; version 0.1 recorded none, which is converted to zeros.

    Raises:
        InputError: a pose is not valid.
    """
    poses = np.column_stack([columns.read('camera_pose', part) for part in ('position', 'orientation')])
    is_moved = (poses != SAME_POSE).any(axis=1) & poses[:, 3:].any(axis=1)
    moved = np.flatnonzero(is_moved).tolist()
    try:
        return _Transforms(moved, [RigidTransform.from_numbers(poses[row].tolist()).inverse() for row in moved])
    except InputError as error:
        raise InputError(f'camera_pose: {error}') from None
