# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What kind of input a path is, by its name and by its content."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.runtime.input_kind import InputKind, find_input_kind
from tests.support.keypoint_files import make_walker


def test_kinds_by_name_and_content(tmp_path: Path) -> None:
    save_sequence(tmp_path / 'walk.npz', make_walker())
    (tmp_path / 'walk.dat').write_bytes((tmp_path / 'walk.npz').read_bytes())
    np.savez(tmp_path / 'result.npz', joints3d=np.zeros(1), theta=np.zeros(1), residual_px=np.zeros(1))
    for folder, file in (
        ('bag', 'bag_0.mcap'),
        ('bag.npz', 'metadata.yaml'),
        ('openpose', 'a_0_keypoints.json'),
        ('images', '1.PNG'),
        ('folder', 'readme.txt'),
    ):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / file).write_bytes(b'content')
    for suffix in ('mcap', 'db3', 'bag', 'json', 'JSON', 'MP4', 'gif', 'jpeg', 'csv', 'xyz'):
        (tmp_path / f'a.{suffix}').write_bytes(b'content')
    (tmp_path / 'bad.npz').write_bytes(b'content')
    (tmp_path / 'empty.mp4').touch()
    os.mkfifo(tmp_path / 'pipe.npz')
    os.mkfifo(tmp_path / 'pipe.mcap')
    (tmp_path / 'zero.json').symlink_to('/dev/zero')
    expected = {
        'pipe.npz': InputKind.SPECIAL,
        'pipe.mcap': InputKind.SPECIAL,
        'zero.json': InputKind.SPECIAL,
        'walk.npz': InputKind.SEQUENCE,
        'walk.dat': InputKind.SEQUENCE,
        'bad.npz': InputKind.SEQUENCE,
        'result.npz': InputKind.RESULT,
        'bag': InputKind.BAG,
        'bag.npz': InputKind.BAG,
        'a.mcap': InputKind.BAG,
        'a.db3': InputKind.BAG,
        'a.bag': InputKind.BAG,
        'openpose': InputKind.OPENPOSE,
        'a.json': InputKind.JSON,
        'a.JSON': InputKind.JSON,
        'a.MP4': InputKind.VIDEO,
        'a.gif': InputKind.VIDEO,
        'a.jpeg': InputKind.IMAGE,
        'images': InputKind.IMAGES,
        'a.csv': InputKind.WRITTEN,
        'a.xyz': InputKind.OTHER,
        'folder': InputKind.FOLDER,
        'empty.mp4': InputKind.EMPTY_FILE,
        'none.mp4': InputKind.MISSING,
    }
    assert {name: find_input_kind(tmp_path / name) for name in expected} == expected
