# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Maps from the joints or markers of motion-capture rigs to the joints of the model.

The head of the model is the tip of the head bone, and its neck is the point where the spine and the collar bones
meet.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import load_yaml
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import read_text
from mocap_ros.skeleton import CMU15, canonical_joint_names, estimate_stature

# For each joint of the model, the names of the joints or markers whose mean it is.
MarkerMap = Mapping[str, Sequence[str]]

CMU_UNIT_M = 0.0254 / 0.45  # m; the CMU database's files give lengths in inches, scaled by 0.45

# Units of length that are tried where a file does not name its unit, in m.
LENGTH_UNITS_M = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'inch': 0.0254, 'unit of the CMU database': CMU_UNIT_M}
MIN_STATURE_M = 1.2  # m; the unit of a file is the one that makes people at least as tall as this,
MAX_STATURE_M = 2.2  # m; and at most as tall as this; the factor between is below all factors between units
MAX_MAP_BYTES = 1 << 20  # guards the YAML reader; a map has some hundred bytes
MAX_LISTED_NAMES = 40  # names in an error message; keeps it readable


def _build_rig(middle: str, left: str, right: str, limbs: str) -> dict[str, str]:
    """Build the map from the joints of the model to the names of a rig.

    `middle` has the names of the head, the neck and the pelvis, and `limbs` those of the shoulder, elbow, wrist,
    hip, knee and ankle, in which `{}` stands for the word for the side.
    """
    joints = ('shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle')
    rig = dict(zip(('head', 'neck', 'pelvis'), middle.split(), strict=True))
    for side, word in (('l', left), ('r', right)):
        rig |= {side + joint: name.format(word) for joint, name in zip(joints, limbs.split(), strict=True)}
    return rig


_MIXAMO_LIMBS = '{}arm {}forearm {}hand {}upleg {}leg {}foot'

# The known rigs: the name of each joint of the model, as `_simplify_names` writes it.
RIGS = {
    'CMU ASF': _build_rig(
        'head thorax root', 'l', 'r', '{}clavicle {}humerus {}radius {}hipjoint {}femur {}tibia'
    ),
    'Mixamo': _build_rig('headtopend neck hips', 'left', 'right', _MIXAMO_LIMBS),
    'CMU BVH or MotionBuilder': _build_rig('headend neck hips', 'left', 'right', _MIXAMO_LIMBS),
    'Poser': _build_rig('headend neck hip', 'l', 'r', '{}shldr {}forearm {}hand {}thigh {}shin {}foot'),
    'Biovision': _build_rig(
        'headend neck hips', 'left', 'right', '{}uparm {}lowarm {}hand {}upleg {}lowleg {}foot'
    ),
    'joints by name': _build_rig(
        'headend neck hips', 'left', 'right', '{}shoulder {}elbow {}wrist {}hip {}knee {}ankle'
    ),
    'the model': {joint: joint for joint in CMU15.joints},
}


def _simplify_names(names: Sequence[str]) -> list[str]:
    """Return the names in lower case, without separators and without a common prefix such as `mixamorig:`."""
    bare = [name.rpartition(':')[2] for name in names]
    prefixes = {name.partition('_')[0] for name in bare}
    if len(prefixes) == 1 and len(bare) > 1:
        bare = [name.partition('_')[2] for name in bare]
    return [''.join(c for c in name.lower() if c.isalnum()) for name in bare]


def map_to_model(positions: Mapping[str, Array], markers: MarkerMap | None = None) -> Array:
    """Return the joints (F, 15, 3) of the model from positions (F, 3) by the name of a rig's joint or marker.

    They are in the same frame and unit. `markers` is by default the map of the known rig that fits.
    """
    if markers is None:
        markers = _recognise_rig(positions)
    missing = [name for names in markers.values() for name in names if name not in positions]
    if missing:
        raise InputError(f'no {", ".join(dict.fromkeys(missing))}; there are {_list_names(positions)}')
    return np.stack([np.mean([positions[n] for n in markers[j]], axis=0) for j in CMU15.joints], axis=1)


def _recognise_rig(positions: Mapping[str, Array]) -> MarkerMap:
    """Return the map of the known rig that has the fewest names missing; InputError where names are missing.

    A name that several subjects have, such as `anna:head` and `ben:head`, is none of a rig.
    """
    names = list(positions)
    subjects = Counter(name.rpartition(':')[2] for name in names)
    names = [name for name in names if subjects[name.rpartition(':')[2]] == 1]
    name_by_spelling = dict(zip(_simplify_names(names), names, strict=True))
    name_by_spelling |= {
        joint: name
        for joint, name in zip(canonical_joint_names(names), names, strict=True)
        if joint in CMU15.joints and joint not in name_by_spelling
    }
    missing_by_rig = {
        rig: [n for n in joints.values() if n not in name_by_spelling] for rig, joints in RIGS.items()
    }
    nearest = min(missing_by_rig, key=lambda rig: len(missing_by_rig[rig]))
    if missing_by_rig[nearest]:
        raise InputError(
            f'joints of no known rig; for {nearest} it lacks {", ".join(missing_by_rig[nearest])}; '
            f'there are {_list_names(positions)}; give the map by --markers'
        )
    return {joint: [name_by_spelling[name]] for joint, name in RIGS[nearest].items()}


def _list_names(names: Mapping[str, Array]) -> str:
    listed = ', '.join(list(names)[:MAX_LISTED_NAMES])
    return listed + (', ...' if len(names) > MAX_LISTED_NAMES else '') or 'none'


def load_marker_map(path: Path) -> MarkerMap:
    """Read a map from a YAML file: for each joint of the model, a name, or a list of names whose mean it is."""
    content = load_yaml(read_text(path, max_bytes=MAX_MAP_BYTES), str(path))
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


def infer_unit(joints: Array) -> float:
    """Return the unit of length in m of joints (F, 15, 3) of `skeleton.CMU15`, by the stature of the people."""
    height = estimate_stature(joints, CMU15)
    for metres in LENGTH_UNITS_M.values():
        if MIN_STATURE_M <= height * metres <= MAX_STATURE_M:
            return metres
    raise InputError(
        f'people are {height:.4g} units tall, which is not the height of a person in any of '
        f'{", ".join(LENGTH_UNITS_M)}; give the unit in m by --unit'
    )
