"""Key poses from the image and a person's eye (Taylor, CVIU 80(3), 2000, as Loy et al. 2004 use it).

Under scaled orthography the image of a limb of length l is foreshortened by what it points towards or away from
the camera:

    dz^2 = l^2 - (du^2 + dv^2) / s^2

The scale s must be large enough for every limb; of each limb somebody must say whether its outer joint is nearer
to the camera than its inner one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.skeleton import CMU15, Skeleton

Array = NDArray[np.float64]

HALVES = ('upper', 'lower')
LONGEST_LIST = 100_000
LARGEST = 1e15
SHOWN = {'time', 'half', 'represents', 'spans', 'forward', 'scale'}


@dataclass(frozen=True)
class Choice:
    """What somebody says of one keyframe.

    Attributes:
        half: `upper` or `lower`.
        time: s, of the keyframe, from the beginning of the sequence.
        forward: outer joints of the limbs that point towards the camera; the others point away.
        scale: px per m, or None for the least that every limb allows.
        place: where it was said, for errors.
    """

    half: str
    time: float
    forward: frozenset[str]
    scale: float | None
    place: str


def taylor_pose(
    points: Array,
    lengths: Array,
    bones: Sequence[tuple[int, int]],
    forward: frozenset[str],
    scale: float | None = None,
    skeleton: Skeleton = CMU15,
) -> tuple[Array, float]:
    """Limbs in 3D from one image, up to the depth of the whole.

    Args:
        points: (J, 2) px, x right and y down; NaN where not seen.
        lengths: (B,) m or any unit: relative lengths are enough.
        bones: (B,) inner and outer joint.
        forward: names of the outer joints nearer to the camera than their inner ones.
        scale: px per unit of the lengths; None for the least possible.
        skeleton: names the joints.

    Returns:
        (B, 3) limbs from inner to outer joint, unit of the lengths, camera's axes (z away from it); and the scale.

    Raises:
        InputError: a joint is not seen or not one of these limbs', or the scale is too small; names it.
    """
    outer = [skeleton.joints[child] for _, child in bones]
    for name in sorted(forward):
        if name not in outer:
            raise InputError(f'no limb ends in {name!r}; there are {", ".join(outer)}')
    unseen = [skeleton.joints[j] for bone in bones for j in bone if not np.isfinite(points[j]).all()]
    if unseen:
        raise InputError(f'{unseen[0]} is not seen')
    flat = np.array([points[child] - points[parent] for parent, child in bones])
    needed = np.linalg.norm(flat, axis=-1) / lengths
    least = float(needed.max())
    if scale is None:
        scale = least
    elif scale < least * (1 - 1e-9):
        raise InputError(
            f'scale: {scale:g} px/m is too small for {outer[int(needed.argmax())]}, least {least:.4g}'
        )
    flat = flat / scale
    depth = np.sqrt(np.maximum(lengths**2 - (flat**2).sum(axis=-1), 0.0))
    sign = np.where([name in forward for name in outer], -1.0, 1.0)
    return np.concatenate([flat, (sign * depth)[:, None]], axis=-1), scale


def choices_from(tree: object, source: str) -> tuple[Choice, ...]:
    """The choices in a file as `mocap-ros keyframes` writes it; entries without `forward` have none.

    Args:
        tree: what the YAML holds.
        source: names the file in errors.

    Raises:
        InputError: it is not as it should be; names the entry.
    """
    entries = tree.get('keyframes') if isinstance(tree, Mapping) else None
    if not isinstance(entries, list) or len(entries) > LONGEST_LIST:
        raise InputError(f'{source}: expected a list named keyframes')
    out = []
    for number, entry in enumerate(entries):
        place = f'{source}: keyframes[{number}]'
        if not isinstance(entry, Mapping):
            raise InputError(f'{place}: expected time, half and forward')
        unknown = sorted(str(k) for k in entry.keys() - SHOWN)
        if unknown:
            raise InputError(f'{place}: unknown {unknown[0]!r}; known: {", ".join(sorted(SHOWN))}')
        if 'forward' in entry:
            out.append(_choice(entry, place))
    return tuple(out)


def _choice(entry: Mapping[str, object], place: str) -> Choice:
    half, forward = entry.get('half'), entry['forward']
    if half not in HALVES:
        raise InputError(f'{place}: half: expected {" or ".join(HALVES)}')
    if not (isinstance(forward, list) and all(isinstance(name, str) for name in forward)):
        raise InputError(f'{place}: forward: expected a list of joints')
    scale = None if entry.get('scale') is None else _positive(entry['scale'], f'{place}: scale', least=1e-6)
    time = _positive(entry.get('time'), f'{place}: time', least=0.0)
    return Choice(str(half), time, frozenset(forward), scale, place)


def _positive(value: object, place: str, least: float) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and least <= value <= LARGEST):  # type: ignore[operator]
        raise InputError(f'{place}: expected a number from {least:g} to {LARGEST:g}')
    return float(value)  # type: ignore[arg-type]
