# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be read are refused with an error that names the cause."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from tests.support.bag_writing import FRAMES, STEP_NS, write_bag


def test_a_bag_without_metadata_recommends_recover(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.raises(InputError, match=r'not finished: metadata\.yaml is missing; `mocap-ros recover'):
        Bag(tmp_path / 'bag')
    with Bag(tmp_path / 'bag' / 'bag_0.mcap') as bag:
        assert bag.count(bag.topics) == FRAMES + 1


def test_duration_and_counts(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    with Bag(tmp_path / 'bag') as bag:
        times = [message.time_ns for message in bag.messages(bag.topics)]
        assert bag.duration_s == pytest.approx((max(times) - min(times)) / 1e9)
        assert bag.duration_s == pytest.approx((FRAMES - 1) * STEP_NS / 1e9)


def test_paths_that_are_no_bags_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'x.mcap').write_bytes(b'no bag')
    (tmp_path / 'x.txt').write_bytes(b'no bag')
    os.mkfifo(tmp_path / 'pipe.mcap')
    for name, reason in {
        'none': 'does not exist',
        'pipe.mcap': 'neither a file',
        'x.mcap': 'magic',
        'x.txt': 'storage',
        '.': 'metadata',
    }.items():
        with pytest.raises(InputError, match=f'{name if name != "." else ""}.*{reason}'):
            Bag(tmp_path / name)
