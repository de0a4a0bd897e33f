# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find where the cameras of several recordings of the same people are, in one level frame.

In it z is up and the floor is z = 0, the first camera is above the origin, and x is where it looks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.formats.cameras_file import Cameras
from mocap_ros.geometry.level import average_vertical, build_world
from mocap_ros.offline.whole_sequence import Report, report_part
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.input_kind import find_kind_with_results, select_options
from mocap_ros.recordings.reconstruct import ReconstructionOptions, load_or_reconstruct
from mocap_ros.recordings.recording import Recording
from mocap_ros.solvers.camera_poses import FoundCameras, find_camera_poses

MAX_ROTATION_STD = math.radians(5.0)  # rad; people merged with poses that are further off are 0.3 m apart
MIN_SECONDS = 20.0  # s of people whom two cameras see; the rotation is then known to 1 or 2 degrees
MIN_ACROSS = 0.1  # 1; of the optical axis that is not vertical, so that it says where the camera looks
MIN_BASELINE_M = 0.01  # m; between two cameras whose distance shows the scale


class MeasuredDistance(NamedTuple):
    """A distance in m between two cameras, by their numbers, that somebody measured."""

    first: int
    second: int
    distance: float


class LocatedCameras(NamedTuple):
    """Cameras in one level frame, and what they were found from."""

    cameras: Cameras
    found: FoundCameras  # in the frame of the first camera, of the scale of `cameras`
    scale: float  # of the cameras, where that of the people, as their trackers gave them, is 1
    views: tuple[tuple[PoseSequence, ...], ...]  # the people of each camera
    remarks: tuple[str, ...]  # what the frame rests on, a sentence each


def name_cameras(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return the names of the cameras of recordings: those of the files, or the paths where names repeat."""
    names = tuple(path.stem if path.is_file() else path.resolve().name for path in paths)
    return names if len({*names}) == len(names) else tuple(map(str, paths))


def load_views(paths: Sequence[Path], options: ReconstructionOptions, report: Report) -> list[Recording]:
    """Load results and bags of skeletons, and reconstruct the people of other recordings.

    An option of reading counts for the recordings to whose kinds it applies.

    Raises:
        InputError: a recording cannot be read, or shows nobody; it names the path.
    """
    recordings = []
    for index, path in enumerate(paths):
        reading = select_options(options.reading, find_kind_with_results(path))
        part = report_part(report, index, len(paths))
        recordings.append(load_or_reconstruct(path, options._replace(reading=reading), part))
    return recordings


def find_cameras(
    names: Sequence[str], views: Sequence[Sequence[PoseSequence]], distance: MeasuredDistance | None = None
) -> LocatedCameras:
    """Find where cameras are that saw the same people, by their people in 3D.

    Raises:
        InputError: the people are not enough to find a camera; it names the camera.
    """
    found = find_camera_poses(views)
    for name, std, seconds in zip(names, found.rotation_std, found.seconds, strict=True):
        if not std <= MAX_ROTATION_STD:
            raise InputError(
                f'{name}: its rotation is known to {math.degrees(std):.1f} degrees only, '
                f'{math.degrees(MAX_ROTATION_STD):.0f} are needed, after {seconds:.0f} s of people whom another '
                f'camera sees as well: walk about for {MIN_SECONDS:.0f} s more, through the middle of both views'
            )
    scale, remarks = 1.0, ['The scale is that of the body height that is assumed or known of the people.']
    if distance is not None:
        scale = _find_scale(names, found, distance)
        pair = f'{names[distance.first]} and {names[distance.second]}'
        remarks = [f'The scale is that of the measured distance of {distance.distance:g} m between {pair}.']
    level, remark = _find_level(views, found.poses)
    level[2, 3] *= scale
    poses = found.poses.copy()
    poses[:, :3, 3] *= scale
    found = found._replace(poses=poses, translation_std=scale * found.translation_std)
    cameras = Cameras(tuple(names), level @ poses, found.clock_offsets)
    return LocatedCameras(cameras, found, scale, tuple(map(tuple, views)), (remark, *remarks))


def _find_scale(names: Sequence[str], found: FoundCameras, measured: MeasuredDistance) -> float:
    between = found.poses[measured.first, :3, 3] - found.poses[measured.second, :3, 3]
    length = float(np.linalg.norm(between))
    if length < MIN_BASELINE_M:
        raise InputError(f'{names[measured.first]} and {names[measured.second]} are in one place')
    return measured.distance / length


def _find_level(views: Sequence[Sequence[PoseSequence]], poses: Array) -> tuple[Array, str]:
    """Return the transform (4, 4) from the first optical frame to the level frame, and what it rests on."""
    first = views[0][0]
    height, upward = first.camera_height, first.world_from_camera[2, :3]
    remark = 'z is up and z = 0 is the floor, as the first camera knows them.'
    if height is None:
        verticals = [p.vertical @ pose[:3, :3].T for pose, view in zip(poses, views, strict=True) for p in view]
        std = [p.vertical_std for view in views for p in view]
        upward = average_vertical(np.concatenate(verticals), np.concatenate(std))
        remark = "z is up by the balance of the people, and z = 0 the height of the first camera's lowest joints."
        if not np.isfinite(upward).all():
            remark = 'Nothing shows the vertical: the first camera is taken to be level, above its lowest joints.'
    joints = np.concatenate([person.joints for person in views[0]])
    level = build_world(joints, upward, height)
    up = level[2, :3]
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if np.linalg.norm(ahead) < MIN_ACROSS:  # it looks straight down or up: x is up in its image
        ahead = np.array([0.0, -1.0, 0.0]) + up[1] * up
    ahead /= np.linalg.norm(ahead)
    level[:3, :3] = ahead, np.cross(up, ahead), up
    level[:2, 3] = 0.0
    return level, remark
