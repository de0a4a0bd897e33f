# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Key poses by Taylor's method (Taylor, CVIU 80(3), 2000, as used by Loy et al. 2004, section 6).

    dz^2 = l^2 - (du^2 + dv^2) / s^2

Under scaled orthographic projection with scale s, the image (du, dv) of a limb of length l gives its depth dz up
to the sign, which a user chooses: whether the outer joint is nearer to the camera. The scale must suffice for all
limbs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.skeleton import CMU15

HALF_NAMES = ('upper', 'lower')  # names of the body halves, in the order of `split_into_halves`
MAX_ENTRIES = 100_000  # keyframes in a file; guards against files that are not lists of keyframes
MAX_NUMBER = 1e15  # s or px/m; guards the arithmetic against overflow
MIN_SCALE = 1e-6  # px/m; guards divisions by the scale
SCALE_TOLERANCE = 1e-9  # relative; a scale equal to the minimum must not be refused for rounding
ENTRY_KEYS = {'time', 'half', 'represents', 'spans', 'forward', 'scale'}  # keys that an entry of the file may have


@dataclass(frozen=True)
class DepthChoice:
    """A user's forward/backward choice for the limbs of one keyframe."""

    half: str  # `upper` or `lower`
    time_s: float  # s, time of the keyframe since the beginning of the sequence
    # outer joints of the limbs that point towards the camera; all other limbs point away from it
    forward: frozenset[str]
    scale: float | None  # px/m, scale of the projection; None for the minimum that every limb allows
    location: str  # file and entry of the choice, for error messages


def reconstruct_limbs(
    points: Array,
    lengths: Array,
    bones: Sequence[tuple[int, int]],
    forward: frozenset[str],
    scale: float | None = None,
) -> tuple[Array, float]:
    """Reconstruct limbs (B, 3) from points (J, 2) px by Taylor's method; return also the scale used.

    Vectors are from inner to outer joint, in the camera's axes. Without `scale`, px per unit of the lengths, it is
    the least that every limb allows; the outer joints `forward` are nearer to the camera.
    """
    outer = [CMU15.joints[child] for _, child in bones]
    for name in sorted(forward):
        if name not in outer:
            raise InputError(f'no limb of this half ends in {name!r}; expected {", ".join(outer)}')
    unseen = [CMU15.joints[j] for bone in bones for j in bone if not np.isfinite(points[j]).all()]
    if unseen:
        raise InputError(f'{unseen[0]} is not seen')
    flat = np.array([points[child] - points[parent] for parent, child in bones])
    needed_scale = np.linalg.norm(flat, axis=-1) / lengths
    min_scale = float(needed_scale.max())
    if scale is None:
        scale = min_scale
    elif scale < min_scale * (1 - SCALE_TOLERANCE):
        raise InputError(
            f'scale: {scale:g} px/m is too small for the limb to {outer[int(needed_scale.argmax())]}; '
            f'the minimum is {min_scale:.4g}'
        )
    flat = flat / scale
    depth = np.sqrt(np.maximum(lengths**2 - (flat**2).sum(axis=-1), 0.0))
    sign = np.where([name in forward for name in outer], -1.0, 1.0)
    return np.concatenate([flat, (sign * depth)[:, None]], axis=-1), scale


def parse_depth_choices(tree: object, source: str) -> tuple[DepthChoice, ...]:
    """Parse the choices in a YAML tree of keyframes as `mocap-ros keyframes` writes it; `source` is the file."""
    entries = tree.get('keyframes') if isinstance(tree, Mapping) else None
    if not isinstance(entries, list) or len(entries) > MAX_ENTRIES:
        raise InputError(f'{source}: expected a list named keyframes')
    out = []
    for number, entry in enumerate(entries):
        location = f'{source}: keyframes[{number}]'
        if not isinstance(entry, Mapping):
            raise InputError(f'{location}: expected time, half and forward')
        unknown = sorted(str(k) for k in entry.keys() - ENTRY_KEYS)
        if unknown:
            raise InputError(f'{location}: unknown {unknown[0]!r}; expected {", ".join(sorted(ENTRY_KEYS))}')
        if 'forward' in entry:
            out.append(_parse_depth_choice(entry, location))
    return tuple(out)


def _parse_depth_choice(entry: Mapping[str, object], location: str) -> DepthChoice:
    half, forward = entry.get('half'), entry['forward']
    if half not in HALF_NAMES:
        raise InputError(f'{location}: half: expected {" or ".join(HALF_NAMES)}')
    if not (isinstance(forward, list) and all(isinstance(name, str) for name in forward)):
        raise InputError(f'{location}: forward: expected a list of joints')
    has_scale = entry.get('scale') is not None
    scale = _parse_number(entry['scale'], f'{location}: scale', minimum=MIN_SCALE) if has_scale else None
    time_s = _parse_number(entry.get('time'), f'{location}: time', minimum=0.0)
    return DepthChoice(str(half), time_s, frozenset(forward), scale, location)


def _parse_number(value: object, location: str, minimum: float) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and minimum <= value <= MAX_NUMBER):  # type: ignore[operator]
        raise InputError(f'{location}: expected a number from {minimum:g} to {MAX_NUMBER:g}')
    return float(value)  # type: ignore[arg-type]
