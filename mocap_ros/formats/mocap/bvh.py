"""BVH files read: a hierarchy of bones with constant lengths, and its joint angles over time."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import read_text

Array = NDArray[np.float64]


END = '_end'


POSITIONS = ('Xposition', 'Yposition', 'Zposition')


ROTATIONS = ('Zrotation', 'Yrotation', 'Xrotation')


KNOWN_CHANNELS = {name.lower(): name for name in POSITIONS + ROTATIONS}


MOST_NODES = 2000


@dataclass(frozen=True, eq=False)
class Bvh:
    """A hierarchy and its motion.

    Attributes:
        names: (N,) of the joints, parents first; an end site is called as its joint with `END` behind it.
        parents: (N,) index of each one's parent, -1 for the root.
        offsets: (N, 3) from the parent, in the file's unit of length.
        channels: (N,) names of each one's channels, in their order.
        frame_time: s.
        motion: (F, C) values of all channels, unit of length and degrees.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    channels: tuple[tuple[str, ...], ...]
    frame_time: float
    motion: Array

    def positions(self) -> Array:
        """(F, N, 3) joints in the file's own frame and unit (forward kinematics)."""
        frames = len(self.motion)
        position = np.zeros((frames, len(self.names), 3))
        rotation: list[Rotation] = []
        first = 0
        for node, (parent, channels) in enumerate(zip(self.parents, self.channels, strict=True)):
            values = self.motion[:, first : first + len(channels)]
            first += len(channels)
            local = np.tile(self.offsets[node], (frames, 1))
            for column, name in enumerate(channels):
                if name in POSITIONS:
                    local[:, POSITIONS.index(name)] = values[:, column]
            turning = [column for column, name in enumerate(channels) if name in ROTATIONS]
            turn = Rotation.identity(frames)
            for column in turning:
                turn = turn * Rotation.from_euler(channels[column][0], values[:, [column]], degrees=True)
            if parent < 0:
                position[:, node] = local
                rotation.append(turn)
            else:
                position[:, node] = position[:, parent] + rotation[parent].apply(local)
                rotation.append(rotation[parent] * turn)
        return position


def load_bvh(path: Path) -> Bvh:
    """Read a file.

    Raises:
        InputError: not BVH, or broken; names file and line.
    """
    text = read_text(path, 'replace')
    lines = iter(enumerate(text.splitlines(keepends=True), 1))
    try:
        tree = _hierarchy(lines)
        frame_time, motion = _motion(lines, sum(map(len, tree.channels)))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    offsets = np.array(tree.offsets)
    return Bvh(tuple(tree.names), tuple(tree.parents), offsets, tuple(tree.channels), frame_time, motion)


class _Tree:
    """The hierarchy as far as it was read; as in `Bvh`."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[tuple[str, ...]] = []
        self.open: list[int] = []

    def take(self, key: str, words: list[str]) -> None:
        """One line (ValueError, KeyError or IndexError where it is out of place)."""
        if key in ('ROOT', 'JOINT', 'END'):
            self._begin(key, ' '.join(words))
        elif key == 'OFFSET':
            x, y, z = (float(word) for word in words)
            self.offsets[self.open[-1]] = [x, y, z]
        elif key == 'CHANNELS':
            self.channels[self.open[-1]] = tuple(KNOWN_CHANNELS[word.lower()] for word in words[1:])
            if int(words[0]) != len(words) - 1:
                raise ValueError
        elif key == '}':
            self.open.pop()
        elif key not in ('', 'HIERARCHY'):
            raise ValueError

    def _begin(self, key: str, name: str) -> None:
        parent = self.open[-1] if self.open else -1
        if (parent < 0) != (key == 'ROOT') or len(self.names) >= MOST_NODES:
            raise ValueError
        self.open.append(len(self.names))
        self.names.append(self.names[parent] + END if key == 'END' else name)
        self.parents.append(parent)
        self.offsets.append([0.0, 0.0, 0.0])
        self.channels.append(())


def _hierarchy(lines: Iterator[tuple[int, str]]) -> _Tree:
    tree = _Tree()
    for number, line in lines:
        key, *words = line.replace('{', ' ').split() or ['']
        if key.upper() == 'MOTION':
            break
        try:
            tree.take(key.upper(), words)
        except (ValueError, KeyError, IndexError):
            raise InputError(
                f'line {number}: {line.strip()[:60]!r} does not belong into a BVH hierarchy'
            ) from None
    if not tree.names or tree.open or not np.isfinite(tree.offsets).all():
        raise InputError('not BVH, or cut off before the MOTION')
    if len(set(tree.names)) != len(tree.names):
        raise InputError(f'two joints called {max(tree.names, key=tree.names.count)!r}')
    return tree


def _motion(lines: Iterator[tuple[int, str]], columns: int) -> tuple[float, Array]:
    said: dict[str, float] = {}
    for number, line in lines:
        label, _, value = line.partition(':')
        if line.strip():
            try:
                said[' '.join(label.split()).lower()] = float(value)
            except ValueError:
                raise InputError(f'line {number}: expected Frames: and Frame Time:') from None
        if 'frame time' in said:
            break
    frames, frame_time = said.get('frames', 0.0), said.get('frame time', 0.0)
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
