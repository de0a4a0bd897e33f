# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of ASF/AMC files: a skeleton (.asf) and its motion (.amc) in Acclaim's format, as in the CMU database.

The rotation R_n of bone n with parent p, and the position x_n of the bone's end, are (forward kinematics)

    R_n = R_p C_n M_n C_n^-1,    x_n = x_p + R_n l_n d_n,

where C_n are the bone's axes, M_n is the product of its rotations in the motion, the later to the left, l_n its
length and d_n its direction.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.bvh import compose_channels
from mocap_ros.formats.text_files import check_position_count, quote_line, read_text

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ROOT = 'root'  # name of the root in both files
# Channel of a BVH file by the degree of freedom, of which the root alone has translations
CHANNELS = {
    **{f'r{axis}': f'{axis.upper()}rotation' for axis in 'xyz'},
    **{f't{axis}': f'{axis.upper()}position' for axis in 'xyz'},
}
ZEROS = ['0', '0', '0']
MAX_BONES = 2000  # guards the time that the hierarchy takes; the CMU database has 31
MAX_SKELETON_BYTES = 1 << 20  # guards the memory that bones take; the CMU database's skeletons have 10 kB


class _Bone(NamedTuple):
    offset: Array  # (3,) vector from the start to the end of the bone in the rest pose; position of the root
    axes: Rotation  # rotation of the axes about which the bone rotates
    channels: tuple[str, ...]  # channels of the degrees of freedom, in the order of their values in the motion


def load_amc(motion: Path, skeleton: Path) -> dict[str, Array]:
    """Read a motion (.amc) of a skeleton (.asf) and compute the positions of the ends of all bones.

    Returns the positions (F, 3) of the end of each bone and of `root`, by name, in the skeleton's frame (y up) and
    in its unit of length.
    """
    bones, parents = _read_skeleton(skeleton)
    values = _read_motion(motion, bones)
    position: dict[str, Array] = {}
    rotation: dict[str, Rotation] = {}
    for name, parent in parents.items():
        offset, axes, channels = bones[name]
        translation, turns = compose_channels(
            np.zeros(3), channels[::-1], values[name][:, ::-1]
        )  # about fixed axes
        local = axes * turns * axes.inv()
        if parent:
            rotation[name] = rotation[parent] * local
            position[name] = position[parent] + rotation[name].apply(offset)
        else:
            rotation[name] = local
            position[name] = offset + translation
    return position


def _read_skeleton(path: Path) -> tuple[dict[str, _Bone], dict[str, str]]:
    """Return the bones by name, and the name of each bone's parent, empty for the root; parents come first."""
    bones: dict[str, _Bone] = {}
    parents: dict[str, str] = {}
    root: dict[str, list[str]] = {}  # the words of each line of a section, by the line's first word
    fields: dict[str, list[str]] = {}
    section = ''
    in_degrees = True
    for number, line in enumerate(read_text(path, 'replace', MAX_SKELETON_BYTES).splitlines(), 1):
        key, *words = line.split('#')[0].split() or ['']
        with naming(f'{path}: line {number}: {quote_line(line)}', 'not valid in an ASF file'):
            if key.startswith(':'):
                section = key
            elif section == ':units' and key == 'angle':
                in_degrees = words[0].startswith('deg')
            elif section == ':root':
                root[key] = words
            elif section == ':bonedata' and key == 'end':
                offset = _parse_vector(fields['direction']) * float(fields['length'][0])
                axes = _parse_axes(fields.get('axis', [*ZEROS, 'xyz']), in_degrees)
                bones[fields['name'][0]] = _Bone(offset, axes, _parse_channels(fields.get('dof', [])))
                fields = {}
            elif section == ':bonedata':
                fields[key] = words
            elif section == ':hierarchy' and key not in ('', 'begin', 'end'):
                parents.update(dict.fromkeys(words, key))
    with naming(f'{path}: :root', 'no valid root; not an ASF file'):
        axes = _parse_axes([*root.get('orientation', ZEROS), 'xyz'], in_degrees)
        bones[ROOT] = _Bone(_parse_vector(root.get('position', ZEROS)), axes, _parse_channels(root['order']))
    with naming(path):
        return bones, _order_bones(bones, parents)


def _parse_vector(words: list[str]) -> Array:
    x, y, z = (float(word) for word in words)
    if not np.isfinite([x, y, z]).all():
        raise ValueError
    return np.array([x, y, z])


def _parse_axes(words: list[str], in_degrees: bool) -> Rotation:
    """Parse `x y z ORDER`: the angles of rotations about the fixed axes, which are applied in that order."""
    from scipy.spatial.transform import Rotation

    order = words[3].lower()
    by_axis = dict(zip('xyz', _parse_vector(words[:3]), strict=True))
    return Rotation.from_euler(order, [by_axis[axis] for axis in order], degrees=in_degrees)


def _parse_channels(freedom: list[str]) -> tuple[str, ...]:
    return tuple(CHANNELS[word.lower()] for word in freedom)


def _order_bones(bones: dict[str, _Bone], parents: dict[str, str]) -> dict[str, str]:
    if max(len(bones), len(parents)) > MAX_BONES:
        raise InputError(f'more than {MAX_BONES} bones')
    ordered = {ROOT: ''}
    unordered = {name: parent for name, parent in parents.items() if name != ROOT}
    while unordered:
        ready = [name for name, parent in unordered.items() if parent in ordered]
        if not ready:
            raise InputError(f'hierarchy: no path from the root to {next(iter(unordered))!r}')
        for name in ready:
            if name not in bones:
                raise InputError(f'hierarchy: there is no bone {name!r}')
            ordered[name] = unordered.pop(name)
    if len(ordered) < 2:
        raise InputError('no bones; not an ASF file')
    return ordered


def _read_motion(path: Path, bones: dict[str, _Bone]) -> dict[str, Array]:
    """Read the values (F, degrees of freedom) of each bone; zeros for bones that are not in the file."""
    rows: dict[str, list[list[float]]] = {name: [] for name, bone in bones.items() if bone.channels}
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
            elif key not in rows or len(words) != len(bones[key].channels) or len(rows[key]) != frames - 1:
                raise ValueError
            else:
                rows[key].append([float(word) for word in words])
        except InputError as error:
            raise InputError(f'{path}: line {number}: {error}') from None
        except ValueError:
            quoted = quote_line(line)
            raise InputError(f'{path}: line {number}: {quoted} is not AMC, or of another skeleton') from None
    if not frames:
        raise InputError(f'{path}: no frames; not an AMC file')
    return {
        name: _build_array(f'{path}: {name}', bone, rows.get(name, []), frames) for name, bone in bones.items()
    }


def _start_frame(number: int, frames: int, rows: dict[str, list[list[float]]]) -> int:
    """Return the number of frames with the next one; ValueError where the last frame lacks a bone."""
    if number < 0 or any(len(values) not in (0, frames) for values in rows.values()):
        raise ValueError
    return frames + 1


def _build_array(place: str, bone: _Bone, rows: list[list[float]], frames: int) -> Array:
    if not rows:
        return np.zeros((frames, len(bone.channels)))
    array = np.array(rows, np.float64)
    if len(array) != frames or not np.isfinite(array).all():
        raise InputError(f'{place}: a frame is cut off, or holds numbers that are not finite')
    return array
