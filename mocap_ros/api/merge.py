# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Merging of the people whom several cameras saw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.api.arguments import read_numbers
from mocap_ros.errors import InputError, name_errors
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.find_cameras import find_cameras
from mocap_ros.recordings.merge_people import merge_recordings

MAX_SKEW = 1e-3  # 1; by which a rotation matrix of rounded numbers is none


def merge(
    results: Sequence[PoseSequence | Sequence[PoseSequence]],
    camera_poses: ArrayLike | None = None,
    *,
    clock_offsets: ArrayLike | None = None,
) -> list[PoseSequence]:
    """Merge the people whom C >= 2 cameras saw at the same time, so that each camera gives what it sees best.

    Args:
        results: (C,) of each camera the result of `reconstruct`, or a list of those of several people.
        camera_poses: (C, 4, 4) transforms in m from the optical frame of each camera to a common frame; by default
            they and the clock offsets are found from people who walk about.
        clock_offsets: (C,) s, to be added to the times of each camera to have those of a common clock; by default
            0, where the poses are given.

    Returns:
        Every person whom a camera saw, in the optical frame and at the times of the first camera.

    Raises:
        InputError: an argument is not valid, nobody is seen at the times of the first camera, or the people do not
            show where a camera is; the error names the argument.
    """
    recordings: list[list[PoseSequence]] = [
        list(entry) if isinstance(entry, list | tuple) else [entry]  # type: ignore[list-item] # checked below
        for entry in results
    ]
    if not all(isinstance(poses, PoseSequence) for people in recordings for poses in people):
        raise InputError('results: expected results of reconstruct, or lists of them')
    if len(recordings) < 2 or not all(recordings):
        raise InputError('results: expected those of two cameras or more, of one person or more each')
    offsets = np.zeros(len(recordings))
    if clock_offsets is not None:
        offsets = read_numbers('clock_offsets', clock_offsets, (len(recordings),))
        if not np.isfinite(offsets).all():
            raise InputError('clock_offsets: not finite')
    poses = None
    if camera_poses is not None:
        poses = read_numbers('camera_poses', camera_poses, (len(recordings), 4, 4))
        turns = poses[:, :3, :3]
        is_rotation = np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3)).max() < MAX_SKEW
        is_transform = np.isfinite(poses).all() and (poses[:, 3] == [0, 0, 0, 1]).all()
        if not (is_transform and is_rotation and (np.linalg.det(turns) > 0).all()):
            raise InputError('camera_poses: expected rotations and translations, as matrices (4, 4)')
    elif clock_offsets is not None:
        raise InputError('clock_offsets: needs camera_poses')
    with name_errors('results'):
        if poses is None:
            names = [f'recording {number}' for number in range(1, len(recordings) + 1)]
            _, poses, offsets = find_cameras(names, recordings).cameras
        return [poses for poses, _ in merge_recordings(recordings, poses, offsets)]
