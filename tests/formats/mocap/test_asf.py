# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ASF/AMC files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.mocap.asf import load_amc
from tests.support.motion_files import AMC, ASF, check_refusal, rotation_matrix


def test_positions_follow_from_the_degrees_of_freedom(tmp_path: Path) -> None:
    (tmp_path / '07.asf').write_text(ASF)
    (tmp_path / '07_01.amc').write_text(AMC)
    positions = load_amc(tmp_path / '07_01.amc', tmp_path / '07.asf')
    root = rotation_matrix('z', 30) @ rotation_matrix('y', 20) @ rotation_matrix('x', 10)
    axes = rotation_matrix('z', 40) @ rotation_matrix('y', 30) @ rotation_matrix('x', 20)
    upper = root @ axes @ rotation_matrix('z', 35) @ rotation_matrix('y', 25) @ rotation_matrix('x', 15) @ axes.T
    axes = rotation_matrix('z', -7) @ rotation_matrix('x', 5)
    lower = upper @ axes @ rotation_matrix('x', 45) @ axes.T
    knee = np.array([1, 2, 3]) + upper @ [0, -3, 0]
    assert positions['root'][0] == pytest.approx([1, 2, 3])
    assert positions['upper'][0] == pytest.approx(knee)
    assert positions['lower'][0] == pytest.approx(knee + lower @ [1.2, -1.6, 0])
    assert positions['lower'][1] == pytest.approx([1.2, -4.6, 0])


INVALID = {
    'empty': ('', r'a\.amc: no frames'),
    'bone': ('1\nnose 1 2\n', r"a\.amc: line 2: 'nose 1 2' is not AMC, or of another skeleton"),
    'degrees': (':RADIANS\n', 'line 1: angles in radians'),
    'cut': ('1\nroot 0 0 0 0 0 0\nupper 1 2 3\n2\nroot 0 0 0 0 0 0\n', 'upper: a frame is cut off'),
    'nan': (
        AMC.replace('lower 45', 'lower nan'),
        'lower: a frame is cut off, or holds numbers that are not finite',
    ),
    'rig': (AMC, r'a\.amc: joints of no known rig'),
}


@pytest.mark.parametrize('case', INVALID)
def test_an_invalid_file_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = INVALID[case]
    (tmp_path / 'a.asf').write_text(ASF)
    check_refusal(tmp_path / 'a.amc', content, message)


INVALID_SKELETONS = {
    'a bone that is not defined': (ASF.replace('upper lower', 'upper hand'), "there is no bone 'hand'"),
    'a bone that hangs in the air': (
        ASF.replace('upper lower', 'hand lower'),
        "no path from the root to 'lower'",
    ),
    'no hierarchy': (
        ASF.replace('    root upper\n', '').replace('    upper lower\n', ''),
        'no bones; not an ASF file',
    ),
    'a direction that is not finite': (ASF.replace('0.6 -0.8 0', '0.6 nan 0'), "line 33: 'end' is not valid"),
    'an unknown degree of freedom': (ASF.replace('dof rx ry rz', 'dof rx ry rw'), "line 24: 'end' is not valid"),
    'empty': ('', r'a\.asf: '),
}


@pytest.mark.parametrize('case', INVALID_SKELETONS)
def test_an_invalid_skeleton_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = INVALID_SKELETONS[case]
    (tmp_path / 'a.amc').write_text(AMC)
    check_refusal(tmp_path / 'a.asf', content, message)
