# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of ASF/AMC files: a skeleton (.asf) and its motion (.amc) in Acclaim's format, as in the CMU database.

The rotation R_n of bone n with parent p, and the position x_n of the bone's end, are (forward kinematics)

    R_n = R_p C_n M_n C_n^-1,    x_n = x_p + R_n l_n d_n,

where C_n are the bone's axes, M_n is the product of its rotations in the motion, the later to the left, l_n its
length and d_n its direction.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.errors import InputError
from mocap_ros.formats.mocap.limits import check_position_count
from mocap_ros.formats.text_files import read_text

Array = NDArray[np.float64]

_Fields = dict[str, list[str]]  # the words of each line of a section, by the line's first word

ROOT = 'root'  # name of the root in both files
ROTATIONS = ('rx', 'ry', 'rz')  # degrees of freedom of a bone
TRANSLATIONS = ('tx', 'ty', 'tz')  # degrees of freedom of the root
MAX_BONES = 2000  # guards the time that the hierarchy takes; the CMU database has 31
MAX_SKELETON_BYTES = 1 << 20  # guards the memory that bones take; the CMU database's skeletons have 10 kB
MAX_QUOTED_CHARACTERS = 60  # of a line in an error message


@dataclass(eq=False)
class _Bone:
    """A bone, or the root.

    Attributes:
        name: name of the bone.
        offset: (3,) vector from the start to the end of the bone in the rest pose; position of the root.
        axes: rotation of the axes about which the bone rotates.
        freedom: names of the degrees of freedom, in the order of their values in the motion.
        parent: name of the parent bone, empty for the root.
    """

    name: str
    offset: Array
    axes: Rotation
    freedom: tuple[str, ...]
    parent: str = ''


def load_amc(motion: Path, skeleton: Path) -> dict[str, Array]:
    """Read a motion and compute the positions of the ends of all bones.

    Args:
        motion: path of the .amc file.
        skeleton: path of the .asf file.

    Returns:
        The positions (F, 3) of the end of each bone and of `root`, by name, in the skeleton's frame (y up) and in
        the skeleton's unit of length.

    Raises:
        InputError: a file is not valid, or the motion is of another skeleton; the error names the file and, if one
            line is at fault, that line.
    """
    bones = _read_skeleton(skeleton)
    values = _read_motion(motion, bones)
    frames = len(values[ROOT])
    position: dict[str, Array] = {}
    rotation: dict[str, Rotation] = {}
    for bone in bones.values():
        translation, rotations = np.zeros((frames, 3)), Rotation.identity(frames)
        for column, freedom in enumerate(bone.freedom):
            if freedom in TRANSLATIONS:
                translation[:, TRANSLATIONS.index(freedom)] = values[bone.name][:, column]
            else:
                turn = Rotation.from_euler(freedom[1], values[bone.name][:, [column]], degrees=True)
                rotations = turn * rotations
        local = bone.axes * rotations * bone.axes.inv()
        if bone.parent:
            rotation[bone.name] = rotation[bone.parent] * local
            position[bone.name] = position[bone.parent] + rotation[bone.name].apply(bone.offset)
        else:
            rotation[bone.name] = local
            position[bone.name] = bone.offset + translation
    return position


def _read_skeleton(path: Path) -> dict[str, _Bone]:
    """Read the bones by name, parents first."""
    bones: dict[str, _Bone] = {}
    parents: dict[str, str] = {}
    root: _Fields = {}
    fields: _Fields = {}
    section, in_degrees, number, line = '', True, 0, ''
    try:
        for number, line in enumerate(read_text(path, 'replace', MAX_SKELETON_BYTES).splitlines(), 1):  # noqa: B007
            key, *words = line.split('#')[0].split() or ['']
            if key.startswith(':'):
                section = key
            elif section == ':units' and key == 'angle':
                in_degrees = words[0].startswith('deg')
            elif section == ':root':
                root[key] = words
            elif section == ':bonedata' and key == 'end':
                bones[fields['name'][0]] = _create_bone(fields, in_degrees)
                fields = {}
            elif section == ':bonedata':
                fields[key] = words
            elif section == ':hierarchy' and key not in ('', 'begin', 'end'):
                parents.update(dict.fromkeys(words, key))
        line = ':root'
        bones[ROOT] = _create_root(root, in_degrees)
    except (ValueError, IndexError, KeyError):
        raise InputError(
            f'{path}: line {number}: {line.strip()[:MAX_QUOTED_CHARACTERS]!r} is not valid in an ASF file'
        ) from None
    return _order_bones(bones, parents, path)


def _create_bone(fields: _Fields, in_degrees: bool) -> _Bone:
    return _Bone(
        fields['name'][0],
        _parse_vector(fields['direction']) * float(fields['length'][0]),
        _parse_axes(fields.get('axis', ['0', '0', '0', 'xyz']), in_degrees),
        _parse_freedom(fields.get('dof', [])),
    )


def _create_root(fields: _Fields, in_degrees: bool) -> _Bone:
    zeros = ['0', '0', '0']
    return _Bone(
        ROOT,
        _parse_vector(fields.get('position', zeros)),
        _parse_axes([*fields.get('orientation', zeros), 'xyz'], in_degrees),
        _parse_freedom(fields['order']),
    )


def _parse_vector(words: list[str]) -> Array:
    x, y, z = (float(word) for word in words)
    if not np.isfinite([x, y, z]).all():
        raise ValueError
    return np.array([x, y, z])


def _parse_axes(words: list[str], in_degrees: bool) -> Rotation:
    """Parse `x y z ORDER`: the angles of rotations about the fixed axes, which are applied in that order."""
    order = words[3].lower()
    by_axis = dict(zip('xyz', _parse_vector(words[:3]), strict=True))
    return Rotation.from_euler(order, [by_axis[axis] for axis in order], degrees=in_degrees)


def _parse_freedom(words: list[str]) -> tuple[str, ...]:
    freedom = tuple(word.lower() for word in words)
    if not set(freedom) <= {*ROTATIONS, *TRANSLATIONS}:
        raise ValueError
    return freedom


def _order_bones(bones: dict[str, _Bone], parents: dict[str, str], path: Path) -> dict[str, _Bone]:
    """Set the parent of every bone and return the bones with parents first."""
    if max(len(bones), len(parents)) > MAX_BONES:
        raise InputError(f'{path}: more than {MAX_BONES} bones')
    ordered = {ROOT: bones[ROOT]}
    unordered = {name: parent for name, parent in parents.items() if name != ROOT}
    while unordered:
        ready = [name for name, parent in unordered.items() if parent in ordered]
        if not ready:
            raise InputError(f'{path}: hierarchy: no path from the root to {next(iter(unordered))!r}')
        for name in ready:
            if name not in bones:
                raise InputError(f'{path}: hierarchy: there is no bone {name!r}')
            bones[name].parent = unordered.pop(name)
            ordered[name] = bones[name]
    if len(ordered) < 2:
        raise InputError(f'{path}: no bones; not an ASF file')
    return ordered


def _read_motion(path: Path, bones: dict[str, _Bone]) -> dict[str, Array]:
    """Read the values (F, degrees of freedom) of each bone; zeros for bones that are not in the file."""
    rows: dict[str, list[list[float]]] = {name: [] for name, bone in bones.items() if bone.freedom}
    frames = 0
    for number, line in enumerate(read_text(path, 'replace').splitlines(), 1):
        key, *words = line.split('#')[0].split() or ['']
        try:
            if key.upper() == ':RADIANS':
                raise InputError('angles in radians; degrees expected')
            if not key or key.startswith(':'):
                continue
            if not words:
                frames = _start_frame(int(key), frames, rows)
                check_position_count(frames, len(bones))
            elif key not in rows or len(words) != len(bones[key].freedom) or len(rows[key]) != frames - 1:
                raise ValueError
            else:
                rows[key].append([float(word) for word in words])
        except InputError as error:
            raise InputError(f'{path}: line {number}: {error}') from None
        except ValueError:
            quoted = line.strip()[:MAX_QUOTED_CHARACTERS]
            raise InputError(f'{path}: line {number}: {quoted!r} is not AMC, or of another skeleton') from None
    if not frames:
        raise InputError(f'{path}: no frames; not an AMC file')
    return {name: _build_array(name, rows.get(name, []), frames, path) for name in bones}


def _start_frame(number: int, frames: int, rows: dict[str, list[list[float]]]) -> int:
    """Return the number of frames with the next one; ValueError where the last frame lacks a bone."""
    if number < 0 or any(len(values) not in (0, frames) for values in rows.values()):
        raise ValueError
    return frames + 1


def _build_array(name: str, values: Iterable[list[float]], frames: int, path: Path) -> Array:
    """Return the values (F, degrees of freedom) of a bone; zeros where the file has none."""
    array = np.array(list(values), np.float64)
    if not array.size:
        return np.zeros((frames, len(ROTATIONS) + len(TRANSLATIONS)))
    if len(array) != frames or not np.isfinite(array).all():
        raise InputError(f'{path}: {name}: a frame is cut off, or holds numbers that are not finite')
    return array
