# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""BVH files: a hierarchy of bones of constant length, and its joint angles over time.

The position x_n and rotation R_n of node n with parent p are (forward kinematics)

    x_n = x_p + R_p t_n,    R_n = R_p L_n,

where t_n is the offset of the node, in which a position channel replaces its coordinate, and L_n is the product of
the rotations about the axes of the rotation channels, in the order of the channels.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.text_files import check_position_count, quote_line, read_text

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

END_SUFFIX = '_end'  # follows the joint's name in the name of its end site, which has no name in a file
POSITION_CHANNELS = ('Xposition', 'Yposition', 'Zposition')
ROTATION_CHANNELS = ('Zrotation', 'Yrotation', 'Xrotation')  # in the order in which BVH files are written
CHANNEL_BY_LOWER_CASE = {name.lower(): name for name in POSITION_CHANNELS + ROTATION_CHANNELS}
MAX_NODES = 2000  # guards the memory; the largest rigs, with fingers and faces, have some hundreds
MAX_NAME_CHARACTERS = 200  # of a joint; guards the memory, because the end of each bone repeats the name
DECIMALS = 6  # of written lengths in cm and angles in degrees: far finer than any reconstruction
FRAME_TIME_DECIMALS = 8  # of a time in s: an hour of frames drifts by less than 2 ms at 100 Hz
# How a file of `build_armature` is imported into Blender, whose importer takes lengths as metres by default.
BLENDER_IMPORT = 'File > Import > Motion Capture (.bvh) with Scale 0.01, Forward -Z and Up Y'


@dataclass(frozen=True, eq=False)
class BvhMotion:
    """A hierarchy of joints and its motion."""

    # (N,) names of the joints and end sites, parents first; an end site has its joint's name and `END_SUFFIX`
    names: tuple[str, ...]
    parents: tuple[int, ...]  # (N,) index of each node's parent, -1 for the root
    offsets: Array  # (N, 3) offset from the parent, in the file's unit of length
    channels: tuple[tuple[str, ...], ...]  # (N,) names of each node's channels, in the order of their values
    frame_time: float  # time between frames in s
    motion: Array  # (F, C) values of all channels, in the file's unit of length and in degrees

    @staticmethod
    def from_nodes(nodes: Sequence[Node], frame_time: float, motion: Array) -> BvhMotion:
        """Return the motion of nodes, parents first; the other arguments are the attributes."""
        names = tuple(node.name for node in nodes)
        parents = tuple(node.parent for node in nodes)
        channels = tuple(node.channels for node in nodes)
        return BvhMotion(names, parents, np.array([node.offset for node in nodes]), channels, frame_time, motion)

    def compute_positions(self) -> Array:
        """Compute the positions (F, N, 3) of all nodes in the file's own frame and unit (forward kinematics)."""
        frames = len(self.motion)
        position = np.zeros((frames, len(self.names), 3))
        rotation: list[Rotation] = []
        first_column = 0
        for node, (parent, channels) in enumerate(zip(self.parents, self.channels, strict=True)):
            values = self.motion[:, first_column : first_column + len(channels)]
            first_column += len(channels)
            translation, local_rotation = compose_channels(self.offsets[node], channels, values)
            if parent < 0:
                position[:, node] = translation
                rotation.append(local_rotation)
            else:
                position[:, node] = position[:, parent] + rotation[parent].apply(translation)
                rotation.append(rotation[parent] * local_rotation)
        return position


@dataclass
class Node:
    """A node of a hierarchy; the attributes are those of `BvhMotion`."""

    name: str
    parent: int
    offset: Array = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()


def compose_channels(offset: Array, channels: Sequence[str], values: Array) -> tuple[Array, Rotation]:
    """Return the translations (F, 3) and the rotations of a node by its offset (3,) and the values (F, C).

    A position channel replaces its coordinate of the offset; each rotation is about the axes that those before it
    have turned.
    """
    from scipy.spatial.transform import Rotation

    translation = np.tile(offset, (len(values), 1))
    rotation = Rotation.identity(len(values))
    for name, column in zip(channels, values.T, strict=True):
        if name in POSITION_CHANNELS:
            translation[:, POSITION_CHANNELS.index(name)] = column
        else:
            rotation = rotation * Rotation.from_euler(name[0], column[:, None], degrees=True)
    return translation, rotation


def load_bvh(path: Path) -> BvhMotion:
    """Read a BVH file."""
    lines = iter(enumerate(read_text(path, 'replace').splitlines(keepends=True), 1))
    with naming(path):
        nodes = _read_hierarchy(lines)
        frame_time, motion = _read_motion(lines, sum(len(node.channels) for node in nodes))
        check_position_count(len(motion), len(nodes))
    return BvhMotion.from_nodes(nodes, frame_time, motion)


def _read_hierarchy(lines: Iterator[tuple[int, str]]) -> list[Node]:
    nodes: list[Node] = []
    open_nodes: list[int] = []  # whose closing brace has not been read, outermost first
    for number, line in lines:
        key, *words = line.replace('{', ' ').split() or ['']
        if key.upper() == 'MOTION':
            break
        with naming(f'line {number}: {quote_line(line)}', 'not valid in a BVH hierarchy'):
            _read_hierarchy_line(key.upper(), words, nodes, open_nodes)
    if not nodes or open_nodes or not np.isfinite([node.offset for node in nodes]).all():
        raise InputError('not BVH, or cut off before the MOTION')
    names = [node.name for node in nodes]
    if len(set(names)) != len(names):
        raise InputError(f'two joints are called {max(names, key=names.count)!r}')
    return nodes


def _read_hierarchy_line(key: str, words: list[str], nodes: list[Node], open_nodes: list[int]) -> None:
    if key in ('ROOT', 'JOINT', 'END'):
        name = ' '.join(words)
        parent = open_nodes[-1] if open_nodes else -1
        is_misplaced = (parent < 0) != (key == 'ROOT')
        if is_misplaced or len(nodes) >= MAX_NODES or len(name) > MAX_NAME_CHARACTERS:
            raise ValueError
        open_nodes.append(len(nodes))
        nodes.append(Node(nodes[parent].name + END_SUFFIX if key == 'END' else name, parent))
    elif key == 'OFFSET':
        x, y, z = (float(word) for word in words)
        nodes[open_nodes[-1]].offset = np.array([x, y, z])
    elif key == 'CHANNELS':
        nodes[open_nodes[-1]].channels = tuple(CHANNEL_BY_LOWER_CASE[word.lower()] for word in words[1:])
        if int(words[0]) != len(words) - 1:
            raise ValueError
    elif key == '}':
        open_nodes.pop()
    elif key not in ('', 'HIERARCHY'):
        raise ValueError


def _read_motion(lines: Iterator[tuple[int, str]], columns: int) -> tuple[float, Array]:
    """Read the numbered lines after the line MOTION; return the time between frames in s and the values (F, C)."""
    value_by_label: dict[str, float] = {}
    for number, line in lines:
        label, _, value = line.partition(':')
        if line.strip():
            with naming(f'line {number}', 'expected Frames: and Frame Time:'):
                value_by_label[' '.join(label.split()).lower()] = float(value)
        if 'frame time' in value_by_label:
            break
    frames = value_by_label.get('frames', 0.0)
    frame_time = value_by_label.get('frame time', 0.0)
    values = ''.join(line for _, line in lines)
    if not (frames >= 1 and 0 < frame_time < np.inf and values.strip()):
        raise InputError('MOTION: no frames')
    with naming('MOTION', 'expected numbers, as many in each line'):
        motion = np.loadtxt(io.StringIO(values), ndmin=2, comments=None)
    if motion.shape != (frames, columns):
        raise InputError(
            f'MOTION: {motion.shape[0]} frames of {motion.shape[1]} values, expected {frames:g} of {columns}'
        )
    if not np.isfinite(motion).all():
        raise InputError('MOTION: a value that is not finite')
    return frame_time, motion


def save_bvh(path: Path, bvh: BvhMotion) -> None:
    """Write a BVH file; the hierarchy must have one root."""
    lines = ['HIERARCHY']
    _append_node(bvh, 0, '', lines)
    lines += ['MOTION', f'Frames: {len(bvh.motion)}', f'Frame Time: {bvh.frame_time:.{FRAME_TIME_DECIMALS}f}']
    lines += [' '.join(f'{value:.{DECIMALS}f}' for value in row) for row in bvh.motion]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def _append_node(bvh: BvhMotion, node: int, indent: str, lines: list[str]) -> None:
    name, channels = bvh.names[node], bvh.channels[node]
    is_end_site = name.endswith(END_SUFFIX)
    keyword = 'ROOT' if bvh.parents[node] < 0 else 'JOINT'
    lines += [f'{indent}End Site' if is_end_site else f'{indent}{keyword} {name}', f'{indent}{{']
    lines.append(f'{indent}\tOFFSET ' + ' '.join(f'{v:.{DECIMALS}f}' for v in bvh.offsets[node]))
    if not is_end_site:
        lines.append(f'{indent}\tCHANNELS {len(channels)} {" ".join(channels)}')
    for child in [child for child, parent in enumerate(bvh.parents) if parent == node]:
        _append_node(bvh, child, indent + '\t', lines)
    lines.append(f'{indent}}}')
