# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""YAML files of cameras: where they are in one frame, and how far their clocks are apart.

    cameras:
      left: {camera_pose: 0.0 0.0 1.42 0.0 0.12 0.0, clock_offset: 0.0}

`camera_pose` is that of the parameter `node.camera_pose`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from mocap_ros.arrays import Array
from mocap_ros.config import load_yaml
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.formats.text_files import read_text
from mocap_ros.geometry.rigid_transform import format_camera_pose, parse_camera_pose

MAX_BYTES = 1 << 20  # bytes; thousands of cameras
KEYS = {'camera_pose', 'clock_offset'}
HEADER = """\
# Cameras in one frame. camera_pose: x y z in m and roll pitch yaw in rad, as the parameter node.camera_pose;
# clock_offset: s, to be added to the times of the camera to have those of the first.
"""


class Cameras(NamedTuple):
    """C cameras in one frame.

    Attributes:
        names: (C,), different ones.
        poses: (C, 4, 4) m, transforms from each camera's optical frame to the common frame.
        clock_offsets: (C,) s, to be added to the times of each camera to have those of the first.
    """

    names: tuple[str, ...]
    poses: Array
    clock_offsets: Array


def save_cameras(path: Path, cameras: Cameras, remarks: Sequence[str] = ()) -> None:
    """Write a file of cameras with remarks, a line each, as comments above them."""
    entries = {
        name: {'camera_pose': format_camera_pose(pose), 'clock_offset': round(float(offset), 4)}
        for name, pose, offset in zip(*cameras, strict=True)
    }
    content = yaml.safe_dump({'cameras': entries}, sort_keys=False, allow_unicode=True)
    path.write_text(HEADER + ''.join(f'# {line}\n' for line in remarks) + content, encoding='utf-8')


def load_cameras(path: Path) -> Cameras:
    """Read a file of cameras.

    Raises:
        InputError: it cannot be read, or is no file of cameras; the error names the place in it.
    """
    try:
        tree = load_yaml(read_text(path, max_bytes=MAX_BYTES), str(path))
        entries = tree.get('cameras') if isinstance(tree, dict) else None
        if not isinstance(entries, dict) or not entries:
            raise InputError(f'{path}: cameras: expected a mapping from names of cameras to their poses')
        found = [_read_entry(entry, f'{path}: cameras: {name}') for name, entry in entries.items()]
    except ConfigError as error:
        raise InputError(str(error)) from None
    poses, offsets = zip(*found, strict=True)
    return Cameras(tuple(entries), np.array(poses), np.array(offsets))


def _read_entry(entry: object, place: str) -> tuple[Array, float]:
    if not isinstance(entry, dict) or 'camera_pose' not in entry or entry.keys() - KEYS:
        raise InputError(f'{place}: expected camera_pose, and clock_offset if it is not 0')
    given = entry['camera_pose']
    text = ' '.join(map(str, given)) if isinstance(given, list) else str(given)
    pose = parse_camera_pose(text, f'{place}: camera_pose')
    offset = entry.get('clock_offset', 0.0)
    if not isinstance(offset, int | float) or isinstance(offset, bool) or not math.isfinite(offset):
        raise InputError(f'{place}: clock_offset = {offset!r}: expected a number in s')
    return pose.matrix, float(offset)
