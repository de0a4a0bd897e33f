# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of BVH files."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.formats.bvh_motion import END_SUFFIX, POSITION_CHANNELS, ROTATION_CHANNELS, BvhMotion
from mocap_ros.formats.mocap.limits import check_position_count
from mocap_ros.formats.text_files import read_text

Array = NDArray[np.float64]

CHANNEL_BY_LOWER_CASE = {name.lower(): name for name in POSITION_CHANNELS + ROTATION_CHANNELS}
MAX_NODES = 2000  # guards the memory; the largest rigs, with fingers and faces, have some hundreds
MAX_NAME_CHARACTERS = 200  # of a joint; guards the memory, because the end of each bone repeats the name
MAX_QUOTED_CHARACTERS = 60  # of a line in an error message


def load_bvh(path: Path) -> BvhMotion:
    """Read a BVH file.

    Raises:
        InputError: the file is not BVH, or is damaged; the error names the file and the line.
    """
    text = read_text(path, 'replace')
    lines = iter(enumerate(text.splitlines(keepends=True), 1))
    try:
        hierarchy = _read_hierarchy(lines)
        frame_time, motion = _read_motion(lines, sum(map(len, hierarchy.channels)))
        check_position_count(len(motion), len(hierarchy.names))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    return BvhMotion(
        tuple(hierarchy.names),
        tuple(hierarchy.parents),
        np.array(hierarchy.offsets),
        tuple(hierarchy.channels),
        frame_time,
        motion,
    )


class _HierarchyReader:
    """The part of a hierarchy that has been read.

    Attributes:
        names: names of the nodes, as in `BvhMotion`.
        parents: index of each node's parent, as in `BvhMotion`.
        offsets: offset of each node, as in `BvhMotion`.
        channels: channels of each node, as in `BvhMotion`.
        open_nodes: indices of the nodes whose closing brace has not been read, outermost first.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[tuple[str, ...]] = []
        self.open_nodes: list[int] = []

    def read_line(self, key: str, words: list[str]) -> None:
        """Read one line.

        Args:
            key: first word of the line, in upper case.
            words: all other words of the line.

        Raises:
            ValueError, KeyError, IndexError: the line is not valid at this place.
        """
        if key in ('ROOT', 'JOINT', 'END'):
            self._open_node(key, ' '.join(words))
        elif key == 'OFFSET':
            x, y, z = (float(word) for word in words)
            self.offsets[self.open_nodes[-1]] = [x, y, z]
        elif key == 'CHANNELS':
            self.channels[self.open_nodes[-1]] = tuple(CHANNEL_BY_LOWER_CASE[word.lower()] for word in words[1:])
            if int(words[0]) != len(words) - 1:
                raise ValueError
        elif key == '}':
            self.open_nodes.pop()
        elif key not in ('', 'HIERARCHY'):
            raise ValueError

    def _open_node(self, key: str, name: str) -> None:
        parent = self.open_nodes[-1] if self.open_nodes else -1
        if (parent < 0) != (key == 'ROOT') or len(self.names) >= MAX_NODES or len(name) > MAX_NAME_CHARACTERS:
            raise ValueError
        self.open_nodes.append(len(self.names))
        self.names.append(self.names[parent] + END_SUFFIX if key == 'END' else name)
        self.parents.append(parent)
        self.offsets.append([0.0, 0.0, 0.0])
        self.channels.append(())


def _read_hierarchy(lines: Iterator[tuple[int, str]]) -> _HierarchyReader:
    """Read the numbered lines up to the line MOTION."""
    hierarchy = _HierarchyReader()
    for number, line in lines:
        key, *words = line.replace('{', ' ').split() or ['']
        if key.upper() == 'MOTION':
            break
        try:
            hierarchy.read_line(key.upper(), words)
        except (ValueError, KeyError, IndexError):
            raise InputError(
                f'line {number}: {line.strip()[:MAX_QUOTED_CHARACTERS]!r} is not valid in a BVH hierarchy'
            ) from None
    if not hierarchy.names or hierarchy.open_nodes or not np.isfinite(hierarchy.offsets).all():
        raise InputError('not BVH, or cut off before the MOTION')
    if len(set(hierarchy.names)) != len(hierarchy.names):
        raise InputError(f'two joints are called {max(hierarchy.names, key=hierarchy.names.count)!r}')
    return hierarchy


def _read_motion(lines: Iterator[tuple[int, str]], columns: int) -> tuple[float, Array]:
    """Read the numbered lines after the line MOTION; return the time between frames in s and the values (F, C)."""
    value_by_label: dict[str, float] = {}
    for number, line in lines:
        label, _, value = line.partition(':')
        if line.strip():
            try:
                value_by_label[' '.join(label.split()).lower()] = float(value)
            except ValueError:
                raise InputError(f'line {number}: expected Frames: and Frame Time:') from None
        if 'frame time' in value_by_label:
            break
    frames, frame_time = value_by_label.get('frames', 0.0), value_by_label.get('frame time', 0.0)
    values = ''.join(line for _, line in lines)
    if not (frames >= 1 and 0 < frame_time < np.inf and values.strip()):
        raise InputError('MOTION: no frames')
    try:
        motion = np.loadtxt(io.StringIO(values), ndmin=2, comments=None)
    except ValueError as error:
        raise InputError(f'MOTION: {error}') from None
    if motion.shape != (frames, columns):
        raise InputError(
            f'MOTION: {motion.shape[0]} frames of {motion.shape[1]} values, expected {frames:g} of {columns}'
        )
    if not np.isfinite(motion).all():
        raise InputError('MOTION: a value that is not finite')
    return frame_time, motion
