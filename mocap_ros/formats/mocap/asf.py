"""ASF/AMC files: the skeleton and the motion of Acclaim, in which the CMU database comes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import read_text

Array = NDArray[np.float64]

ROOT = 'root'
_Fields = dict[str, list[str]]

TURNS, MOVES = ('rx', 'ry', 'rz'), ('tx', 'ty', 'tz')


@dataclass(eq=False)
class _Bone:
    """A bone, or the root: a rest offset (3,) along it, the rotation of its axes, and its degrees of freedom."""

    name: str
    offset: Array
    axes: Rotation
    freedom: tuple[str, ...]
    parent: str = ''


def load_amc(motion: Path, skeleton: Path) -> dict[str, Array]:
    """The ends of all bones over time.

    Args:
        motion: the .amc.
        skeleton: the .asf.

    Returns:
        (F, 3) positions by bone, and of `root`, in the skeleton's frame (y up) and unit of length.

    Raises:
        InputError: either cannot be read, or they do not fit; names file and line.
    """
    bones = _skeleton(skeleton)
    values = _motion(motion, bones)
    frames = len(values[ROOT])
    position: dict[str, Array] = {}
    rotation: dict[str, Rotation] = {}
    for bone in bones.values():
        moved, turn = np.zeros((frames, 3)), Rotation.identity(frames)
        for column, freedom in enumerate(bone.freedom):
            if freedom in MOVES:
                moved[:, MOVES.index(freedom)] = values[bone.name][:, column]
            else:
                turn = Rotation.from_euler(freedom[1], values[bone.name][:, [column]], degrees=True) * turn
        local = bone.axes * turn * bone.axes.inv()
        if bone.parent:
            rotation[bone.name] = rotation[bone.parent] * local
            position[bone.name] = position[bone.parent] + rotation[bone.name].apply(bone.offset)
        else:
            rotation[bone.name] = local
            position[bone.name] = bone.offset + moved
    return position


def _skeleton(path: Path) -> dict[str, _Bone]:
    """Bones by name, parents first."""
    bones: dict[str, _Bone] = {}
    parents: dict[str, str] = {}
    root: _Fields = {}
    fields: _Fields = {}
    section, degrees, number, line = '', True, 0, ''
    try:
        for number, line in enumerate(read_text(path, 'replace').splitlines(), 1):  # noqa: B007, the error names it
            key, *words = line.split('#')[0].split() or ['']
            if key.startswith(':'):
                section = key
            elif section == ':units' and key == 'angle':
                degrees = words[0].startswith('deg')
            elif section == ':root':
                root[key] = words
            elif section == ':bonedata' and key == 'end':
                bones[fields['name'][0]] = _bone(fields, degrees)
                fields = {}
            elif section == ':bonedata':
                fields[key] = words
            elif section == ':hierarchy' and key not in ('', 'begin', 'end'):
                parents.update(dict.fromkeys(words, key))
        line = ':root'
        bones[ROOT] = _root(root, degrees)
    except (ValueError, IndexError, KeyError):
        raise InputError(f'{path}: line {number}: {line.strip()[:60]!r} ends what is not ASF') from None
    return _ordered(bones, parents, path)


def _bone(fields: _Fields, degrees: bool) -> _Bone:
    return _Bone(
        fields['name'][0],
        _vector(fields['direction']) * float(fields['length'][0]),
        _axes(fields.get('axis', ['0', '0', '0', 'xyz']), degrees),
        _freedom(fields.get('dof', [])),
    )


def _root(fields: _Fields, degrees: bool) -> _Bone:
    zeros = ['0', '0', '0']
    return _Bone(
        ROOT,
        _vector(fields.get('position', zeros)),
        _axes([*fields.get('orientation', zeros), 'xyz'], degrees),
        _freedom(fields['order']),
    )


def _vector(words: list[str]) -> Array:
    x, y, z = (float(word) for word in words)
    if not np.isfinite([x, y, z]).all():
        raise ValueError
    return np.array([x, y, z])


def _axes(words: list[str], degrees: bool) -> Rotation:
    """`x y z ORDER`: turned about the fixed axes in that order."""
    order = words[3].lower()
    by_axis = dict(zip('xyz', _vector(words[:3]), strict=True))
    return Rotation.from_euler(order, [by_axis[axis] for axis in order], degrees=degrees)


def _freedom(words: list[str]) -> tuple[str, ...]:
    freedom = tuple(word.lower() for word in words)
    if not set(freedom) <= {*TURNS, *MOVES}:
        raise ValueError
    return freedom


def _ordered(bones: dict[str, _Bone], parents: dict[str, str], path: Path) -> dict[str, _Bone]:
    ordered = {ROOT: bones[ROOT]}
    waiting = {name: parent for name, parent in parents.items() if name != ROOT}
    while waiting:
        ready = [name for name, parent in waiting.items() if parent in ordered]
        if not ready:
            raise InputError(f'{path}: hierarchy: no way from the root to {next(iter(waiting))!r}')
        for name in ready:
            if name not in bones:
                raise InputError(f'{path}: hierarchy: there is no bone {name!r}')
            bones[name].parent = waiting.pop(name)
            ordered[name] = bones[name]
    if len(ordered) < 2:
        raise InputError(f'{path}: no bones; not an ASF file')
    return ordered


def _motion(path: Path, bones: dict[str, _Bone]) -> dict[str, Array]:
    """(F, degrees of freedom) values by bone; zeros for bones that the file does not move."""
    rows: dict[str, list[list[float]]] = {name: [] for name, bone in bones.items() if bone.freedom}
    frames = 0
    for number, line in enumerate(read_text(path, 'replace').splitlines(), 1):
        key, *words = line.split('#')[0].split() or ['']
        try:
            if key.upper() == ':RADIANS':
                raise InputError(f'{path}: line {number}: angles in radians; degrees expected')
            if not key or key.startswith(':'):
                continue
            if not words:
                frames = _next_frame(int(key), frames, rows)
            elif key not in rows or len(words) != len(bones[key].freedom) or len(rows[key]) != frames - 1:
                raise ValueError
            else:
                rows[key].append([float(word) for word in words])
        except ValueError:
            raise InputError(
                f'{path}: line {number}: {line.strip()[:60]!r} is not AMC, or of another skeleton'
            ) from None
    if not frames:
        raise InputError(f'{path}: no frames; not an AMC file')
    return {name: _filled(name, rows.get(name, []), frames, path) for name in bones}


def _next_frame(number: int, frames: int, rows: dict[str, list[list[float]]]) -> int:
    if number < 0 or any(len(values) not in (0, frames) for values in rows.values()):
        raise ValueError
    return frames + 1


def _filled(name: str, values: Iterable[list[float]], frames: int, path: Path) -> Array:
    array = np.array(list(values), np.float64)
    if not array.size:
        return np.zeros((frames, len(TURNS) + len(MOVES)))
    if len(array) != frames or not np.isfinite(array).all():
        raise InputError(f'{path}: {name}: a frame is cut off, or holds numbers that are not finite')
    return array
