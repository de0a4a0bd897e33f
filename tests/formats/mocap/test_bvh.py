# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""BVH files are read, and written files are read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.bvh import load_bvh, save_bvh
from tests.support.motion_files import check_refusal, make_bvh, rotation_matrix


def test_positions_follow_from_the_channels(tmp_path: Path) -> None:
    path = tmp_path / 'a.bvh'
    path.write_text(
        'HIERARCHY\nROOT Hips {\n OFFSET 9 9 9\n'
        ' CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n'
        ' JOINT A\n {\n OFFSET 0 2 0\n CHANNELS 3 Yrotation Zrotation Xrotation\n End Site\n {\n OFFSET 1 0 0\n'
        ' }\n }\n}\nMOTION\nFrames: 2\nFrame Time: .05\n0 0 0 0 0 0 0 0 0\n1 2 3 10 20 30 40 50 60\n'
    )
    bvh = load_bvh(path)
    assert bvh.names == ('Hips', 'A', 'A_end')
    root = rotation_matrix('z', 10) @ rotation_matrix('x', 20) @ rotation_matrix('y', 30)
    joint = np.array([1, 2, 3]) + root @ [0, 2, 0]
    end = joint + root @ rotation_matrix('y', 40) @ rotation_matrix('z', 50) @ rotation_matrix('x', 60) @ [1, 0, 0]
    assert bvh.compute_positions()[1] == pytest.approx(np.array([[1, 2, 3], joint, end]))
    assert bvh.compute_positions()[0] == pytest.approx(np.array([[0, 0, 0], [0, 2, 0], [1, 2, 0]]))
    save_bvh(tmp_path / 'b.bvh', bvh)
    assert load_bvh(tmp_path / 'b.bvh').compute_positions() == pytest.approx(bvh.compute_positions(), abs=1e-4)


INVALID = {
    'empty': ('', 'not BVH'),
    'rig': (make_bvh(lambda t: t), 'joints of no known rig; .* lacks .*; there are Hips, Hips_end'),
    'cut': (make_bvh(lambda t: t.split('MOTION')[0][:-4]), 'not BVH, or cut off'),
    'value': (make_bvh(lambda t: t.replace('1 2 3', '1 x 3')), 'MOTION: could not convert'),
    'values': (make_bvh(lambda t: t.replace('1 2 3', '1 3')), r'1 frames of 2 values, expected 1 of 3'),
    'nan': (make_bvh(lambda t: t.replace('1 2 3', '1 nan 3')), 'not finite'),
    'channel': (make_bvh(lambda t: t.replace('Xrot', 'Wrot')), 'line 5: .CHANNELS 3'),
    'no values': (make_bvh(lambda t: t.replace('1 2 3', '')), 'MOTION: no frames'),
    'no time': (make_bvh(lambda t: t.replace('0.1', '0')), 'MOTION: no frames'),
    'two joints of a name': (
        make_bvh(lambda t: t.replace('End Site', 'JOINT Hips')),
        "two joints are called 'Hips'",
    ),
    'more channels than it says': (
        make_bvh(lambda t: t.replace('CHANNELS 3', 'CHANNELS 2')),
        'line 5: .CHANNELS 2',
    ),
    'no number of frames': (
        make_bvh(lambda t: t.replace('Frames: 1', 'Frames: many')),
        'line 12: expected Frames: and',
    ),
    'deep': ('HIERARCHY\nROOT a\n{\n' + 'JOINT b\n{\n' * 5000, 'line 4002'),
}


@pytest.mark.parametrize('case', INVALID)
def test_an_invalid_file_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = INVALID[case]
    check_refusal(tmp_path / 'a.bvh', content, message)
