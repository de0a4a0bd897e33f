# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The keypoints of many Keypoints2DArray at once, as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.messages.columns import Columns, Path, read_columns, read_stamps
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.skeleton import keypoint_layout

Indices = NDArray[np.intp]


class DetectionColumns(NamedTuple):
    """The people who are at one place in the list of people of N messages, all with the same joints.

    Attributes:
        joints: (J,) names of the keypoints.
        rows: (N,) indices of the messages among those of `KeypointMessages`.
        numbers: (N, J, 3) x and y in px, and the score, as they are in the messages.
    """

    joints: tuple[str, ...]
    rows: Indices
    numbers: NDArray[np.float32]


class KeypointMessages(NamedTuple):
    """N messages, whether there are people in them or not.

    Attributes:
        rows: (N,) indices of the messages among all those that were given.
        stamps_ns: (N,) ns.
        image_size: (N, 2) width and height in px; 0 where unknown.
        people: the people in them.
    """

    rows: Indices
    stamps_ns: NDArray[np.int64]
    image_size: NDArray[np.uint32]
    people: list[DetectionColumns]


def read_keypoints(raws: Sequence[bytes]) -> Iterator[KeypointMessages]:
    """Yield the keypoints of many Keypoints2DArray, in groups of messages of one form, without checking numbers.

    Args:
        raws: CDR bytes of the messages.

    Raises:
        InputError: the bytes are not such messages, a layout is not known, or the arrays of a person are not as
            long as it; groups before it were yielded.
    """
    for columns in read_columns(raws, KEYPOINTS):
        size = np.column_stack([columns.read('image_width'), columns.read('image_height')])
        people = [person for i in range(columns.count('people')) for person in _read_people(columns, i)]
        yield KeypointMessages(columns.rows, read_stamps(columns), size, people)


def _read_people(columns: Columns, index: int) -> Iterator[DetectionColumns]:
    """Yield the people at one place in the list of people, by their joints."""
    arrays = [columns.read('people', index, name) for name in ('x', 'y', 'score')]
    named = columns.count('people', index, 'joint_names')
    paths: list[Path] = [('people', index, 'joint_names', i) for i in range(named)]
    for texts, rows in columns.group_texts(*(paths or [('people', index, 'skeleton')])):
        try:
            joints = texts if named else keypoint_layout(texts[0]).joints
        except SkeletonError as error:
            raise InputError(f'people: {error}') from None
        lengths = {array.shape[1] for array in arrays}
        if lengths != {len(joints)}:
            raise InputError(f'people: {arrays[0].shape[1]} keypoints, expected {len(joints)}')
        yield DetectionColumns(joints, rows, np.stack([array[rows] for array in arrays], axis=2))
