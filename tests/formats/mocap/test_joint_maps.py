# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rigs are recognised by name, and marker maps are read from YAML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.errors import MocapError
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.joint_maps import load_marker_map
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import Z_UP_TO_Y_UP


def rename_joints(bvh: str, names: dict[str, str]) -> str:
    """Return the text of a BVH file in which joints have other names."""
    for name, replacement in names.items():
        bvh = bvh.replace(f' {name}\n', f' {replacement}\n')
    return bvh


@pytest.mark.parametrize('rig', ['Mixamo', 'LAFAN', 'joints'])
def test_known_rigs_are_recognised(tmp_path: Path, poses: np.ndarray, rig: str) -> None:
    path = tmp_path / 'a.bvh'
    save_bvh(path, build_armature(poses @ Z_UP_TO_Y_UP.T, 30.0))
    expected = load_trials(path)[0].poses
    text = path.read_text()
    names = [w for line in text.splitlines() for w in line.split()[1:2] if 'JOINT' in line or 'ROOT' in line]
    if rig == 'Mixamo':
        text = rename_joints(text, {w: f'mixamorig:{w}' for w in names})
    elif rig == 'LAFAN':
        text = rename_joints(text, {w: f'Model_{w}' for w in names})
    else:
        arm = [('Shoulder', 'Collar'), ('Arm', 'Shoulder'), ('ForeArm', 'Elbow'), ('Hand', 'Wrist')]
        leg = [('UpLeg', 'Hip'), ('Leg', 'Knee'), ('Foot', 'Ankle')]
        for side in ('Left', 'Right'):
            text = rename_joints(text, {side + part: f'{side}{name}!' for part, name in arm + leg})
        text = text.replace('!', '')
    path.write_text(text)
    assert load_trials(path)[0].poses == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('[1]', 'expected joint'),
        ('nose: x', 'nose unknown; joints missing: head, neck'),
        ('\n'.join(f'{j}: []' for j in CMU15.joints), 'head: expected the name of a marker'),
        ('{' * 3000, 'm.yaml: not YAML: '),
        ('a: 1\na: 2', "line 2: the key 'a' occurs twice"),
    ],
)
def test_an_invalid_marker_map_is_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / 'm.yaml').write_text(content)
    with pytest.raises(MocapError, match=message):
        load_marker_map(tmp_path / 'm.yaml')
