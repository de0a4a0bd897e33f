# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files of cameras: written and read again, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.cameras_file import Cameras, load_cameras, save_cameras
from mocap_ros.geometry.rigid_transform import format_camera_pose, parse_camera_pose

POSES = '0 0 1.5 0 0 0', '1 -2 0.5 0.1 0.2 -3', '0 0 3 0 1.5707963 0.3'  # the last looks straight down


def test_cameras_are_read_as_they_were_written(tmp_path: Path) -> None:
    poses = np.array([parse_camera_pose(text, 'test').matrix for text in POSES])
    names = ('left', '1', 'ümlaut: #')
    save_cameras(tmp_path / 'c.yaml', Cameras(names, poses, np.array([0, -3.217, 1e9])), ['z is up.'])
    assert '# z is up.\n' in (tmp_path / 'c.yaml').read_text(encoding='utf-8')
    found = load_cameras(tmp_path / 'c.yaml')
    assert found.names == names
    assert found.poses == pytest.approx(poses, abs=3e-4)
    assert found.clock_offsets.tolist() == [0, -3.217, 1e9]


@pytest.mark.parametrize('text', POSES)
def test_a_camera_pose_is_read_as_it_was_formatted(text: str) -> None:
    pose = parse_camera_pose(text, 'test').matrix
    assert parse_camera_pose(format_camera_pose(pose), 'test').matrix == pytest.approx(pose, abs=3e-4)


def test_a_file_that_somebody_wrote_by_hand_is_read(tmp_path: Path) -> None:
    (tmp_path / 'c.yaml').write_text('cameras:\n  a: {camera_pose: 1 2 3 0 0 0}\n', encoding='utf-8')
    found = load_cameras(tmp_path / 'c.yaml')
    assert found.poses[0, :3, 3].tolist() == [1, 2, 3]
    assert found.clock_offsets.tolist() == [0]


@pytest.mark.parametrize(
    ('text', 'place'),
    [
        ('{', 'not YAML'),
        ('', 'cameras: expected'),
        ('cameras: {}', 'cameras: expected'),
        ('cameras: [1]', 'cameras: expected'),
        ('cameras: {a: 1}', 'cameras: a: expected'),
        ('cameras: {a: {clock_offset: 1}}', 'cameras: a: expected'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0 0, pose: 1}}', 'cameras: a: expected'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0}}', 'cameras: a: camera_pose'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0 90}}', 'cameras: a: camera_pose'),
        ('cameras: {a: {camera_pose: [0, 0]}}', 'cameras: a: camera_pose'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0 0, clock_offset: x}}', 'cameras: a: clock_offset'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0 0, clock_offset: .nan}}', 'cameras: a: clock_offset'),
        ('cameras: {a: {camera_pose: 0 0 0 0 0 0, clock_offset: true}}', 'cameras: a: clock_offset'),
    ],
)
def test_a_bad_file_is_refused_with_the_place(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / 'c.yaml').write_text(text, encoding='utf-8')
    with pytest.raises(InputError, match=rf'c\.yaml: .*{place}'):
        load_cameras(tmp_path / 'c.yaml')
    with pytest.raises(InputError, match=r'missing\.yaml'):
        load_cameras(tmp_path / 'missing.yaml')
