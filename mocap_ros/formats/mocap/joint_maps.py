"""Which joint or marker of a motion-capture rig is which joint of the model.

The model's head is the tip of the head bone, its neck the point where spine and collar bones meet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import load_yaml
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import read_text
from mocap_ros.skeleton import CMU15, own_names, stature

Array = NDArray[np.float64]

Markers = Mapping[str, Sequence[str]]

CMU_UNIT = 0.0254 / 0.45
UNITS = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'inch': 0.0254, 'unit of the CMU database': CMU_UNIT}
STATURES = 1.2, 2.2
LONGEST_MAP = 1 << 20


def _rig(middle: str, sides: Mapping[str, str], limbs: str) -> dict[str, str]:
    """Names of a rig by joint of the model; `{}` in `limbs` stands for the side."""
    rig = dict(zip(('head', 'neck', 'pelvis'), middle.split(), strict=True))
    joints = ('shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle')
    for side, word in sides.items():
        names = limbs.replace('{}', word).split()
        rig |= {side + joint: name for joint, name in zip(joints, names, strict=True)}
    return rig


_WORDS = {'l': 'left', 'r': 'right'}
_LETTERS = {'l': 'l', 'r': 'r'}
_MIXAMO_LIMBS = '{}arm {}forearm {}hand {}upleg {}leg {}foot'
_PLAIN_LIMBS = '{}shoulder {}elbow {}wrist {}hip {}knee {}ankle'

RIGS = {
    'CMU ASF': _rig('head thorax root', _LETTERS, '{}clavicle {}humerus {}radius {}hipjoint {}femur {}tibia'),
    'Mixamo': _rig('headtopend neck hips', _WORDS, _MIXAMO_LIMBS),
    'CMU BVH or MotionBuilder': _rig('headend neck hips', _WORDS, _MIXAMO_LIMBS),
    'Poser': _rig('headend neck hip', _LETTERS, '{}shldr {}forearm {}hand {}thigh {}shin {}foot'),
    'Biovision': _rig('headend neck hips', _WORDS, '{}uparm {}lowarm {}hand {}upleg {}lowleg {}foot'),
    'joints by name': _rig('headend neck hips', _WORDS, _PLAIN_LIMBS),
    'the model': {joint: joint for joint in CMU15.joints},
}


def _plain(names: Sequence[str]) -> list[str]:
    """Names in lower case without separators and without the prefix that all share, as of Mixamo."""
    bare = [name.rpartition(':')[2] for name in names]
    starts = {name.partition('_')[0] for name in bare}
    if len(starts) == 1 and len(bare) > 1:
        bare = [name.partition('_')[2] for name in bare]
    return [''.join(c for c in name.lower() if c.isalnum()) for name in bare]


def model_joints(positions: Mapping[str, Array], markers: Markers | None = None) -> Array:
    """The model's joints.

    Args:
        positions: (F, 3) by name of joint or marker.
        markers: for each joint of the model the names whose mean it is; by default those of a known rig.

    Returns:
        (F, 15, 3) in the same frame and unit, of `skeleton.CMU15`.

    Raises:
        InputError: names are missing; lists them.
    """
    if markers is None:
        markers = _known_rig(positions)
    missing = [name for names in markers.values() for name in names if name not in positions]
    if missing:
        raise InputError(f'no {", ".join(dict.fromkeys(missing))}; there are {_few(positions)}')
    return np.stack([np.mean([positions[n] for n in markers[j]], axis=0) for j in CMU15.joints], axis=1)


def _known_rig(positions: Mapping[str, Array]) -> Markers:
    names = list(positions)
    spelt = dict(zip(_plain(names), names, strict=True))
    spelt |= {
        own: name
        for own, name in zip(own_names(names), names, strict=True)
        if own in CMU15.joints and own not in spelt
    }
    lacking = {rig: [n for n in joints.values() if n not in spelt] for rig, joints in RIGS.items()}
    nearest = min(lacking, key=lambda rig: len(lacking[rig]))
    if lacking[nearest]:
        raise InputError(
            f'joints of no known rig; for {nearest} it lacks {", ".join(lacking[nearest])}; '
            f'there are {_few(positions)}; --markers says which is which'
        )
    return {joint: [spelt[name]] for joint, name in RIGS[nearest].items()}


def _few(names: Mapping[str, Array], most: int = 40) -> str:
    return ', '.join(list(names)[:most]) + (', ...' if len(names) > most else '') or 'none'


def load_markers(path: Path) -> Markers:
    """A YAML file with, for each joint of the model, the name or the names whose mean it is.

    Raises:
        InputError: not such a file; names the joint.
        ConfigError: not YAML.
    """
    content = load_yaml(read_text(path, largest=LONGEST_MAP), str(path))
    if not isinstance(content, dict):
        raise InputError(f'{path}: expected joint: [marker, ...]')
    unknown = [str(joint) for joint in content if joint not in CMU15.joints]
    missing = [joint for joint in CMU15.joints if joint not in content]
    if unknown or missing:
        wrong = f'{", ".join(unknown)} unknown; ' if unknown else ''
        raise InputError(f'{path}: {wrong}joints missing: {", ".join(missing) or "none"}')
    markers = {joint: [names] if isinstance(names, str) else names for joint, names in content.items()}
    for joint, names in markers.items():
        if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
            raise InputError(f'{path}: {joint}: expected the name of a marker, or a list of names')
    return markers


def unit_of(joints: Array) -> float:
    """m, the unit of length in which people of these joints (F, 15, 3) are as tall as people are.

    Raises:
        InputError: none of `UNITS` makes them so.
    """
    tall = stature(joints, CMU15)
    low, high = STATURES
    for metres in UNITS.values():
        if low <= tall * metres <= high:
            return metres
    raise InputError(f'people {tall:.4g} units tall, in none of {", ".join(UNITS)}; --unit says the unit in m')
