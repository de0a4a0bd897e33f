# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files as Sports2D writes them: one in px for each person, beside others in m."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.runtime.load_keypoints import InputOptions, load_input, load_people

WALK = make_recording().sequence()
NAMES = [
    n[0].upper() + n[1:2].upper() + n[2:] if n[0] in 'lr' else n.title() for n in WALK.joint_names
]  # LShoulder
OPTIONS = InputOptions(Video(image_size=WALK.image_size))


def write(path: Path, shift: float = 0.0, depth: float = 0.0) -> Path:
    count = len(NAMES)
    axes = '\t\t' + '\t'.join(f'X{i}\tY{i}\tZ{i}' for i in range(1, count + 1))
    head = [f'PathFileType\t4\t(X/Y/Z)\t{path}', 'DataRate\t...', '30\t...']
    lines = [*head, 'Frame#\tTime\t' + '\t\t\t'.join(NAMES) + '\t\t\t', axes]
    for frame, keypoints in enumerate(WALK.keypoints):
        cells = ['\t\t0.0' if np.isnan(x) else f'{x + shift}\t{y}\t{depth}' for x, y, _ in keypoints]
        lines.append('\t'.join([str(frame), f'{frame / 30}', *cells]))
    path.write_text('\n'.join(lines) + '\n')
    return path


def test_a_file_or_a_folder_of_people_is_read(tmp_path: Path) -> None:
    folder = tmp_path / 'walk_Sports2D'
    folder.mkdir()
    path = write(folder / 'walk_Sports2D_px_person00.trc')
    write(folder / 'walk_Sports2D_px_person01.trc', 3000.0)
    write(folder / 'walk_Sports2D_m_person00.trc', depth=1.0)
    sequence, _ = load_input(path, OPTIONS)
    assert sequence.joint_names == WALK.joint_names
    seen = WALK.keypoints[..., 2] > 0
    np.testing.assert_allclose(sequence.keypoints[seen, :2], WALK.keypoints[seen, :2], atol=1e-3)
    np.testing.assert_array_equal(sequence.keypoints[..., 2] > 0, seen)
    np.testing.assert_allclose(sequence.timestamps, np.arange(len(WALK)) / 30, atol=1e-9)
    assert [s.person_id for s in load_people(folder, InputOptions())[0]] == ['00', '01']


def test_other_files_are_refused_by_line(tmp_path: Path) -> None:
    save_trc(tmp_path / 'own.trc', ['lhip', 'rhip'], np.ones((3, 2, 3)), 30.0)
    write(tmp_path / 'walk_m_person00.trc', depth=0.1)
    damaged = write(tmp_path / 'walk_px_person00.trc')
    damaged.write_text(damaged.read_text() + '3\tlater\n')
    for name, problem in (
        ('own', '3D markers'),
        ('walk_m_person00', '3D'),
        ('walk_px_person00', r'line \d+: expec'),
    ):
        with pytest.raises(InputError, match=rf'{re.escape(name)}\.trc: .*{problem}'):
            load_input(tmp_path / f'{name}.trc', OPTIONS)
