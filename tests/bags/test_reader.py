# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be read are refused with an error that names the cause."""

from __future__ import annotations

import os
import re
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


@pytest.mark.parametrize(
    ('old', 'new', 'error'),
    [
        (r'message_count: \d+', 'message_count: many', "message_count is 'many', expected an integer from 0"),
        (r'message_count: \d+', 'message_count: -1', 'message_count is -1, expected an integer from 0'),
        (r'\n    message_count: \d+', '', r'topics_with_message_count\[0\]\.message_count is missing'),
        (r'message_count: \d+', f'message_count: {"9" * 5000}', r'value has 5000 digits$'),
        ('version: 9', 'version: new', "version is 'new', expected an integer"),
        ('identifier: mcap', 'identifier: [mcap]', r"storage_identifier is \['mcap'\], expected text"),
        (r'  - bag_0\.mcap\n', '  - bag_0.mcap\n' * 2, "'bag_0.mcap' occurs 2 times"),
        ('name: /keypoints', 'name:', r'\[1\]\.topic_metadata\.name is empty, expected text'),
        ('depth: 10', 'depth: deep', r"offered_qos_profiles\[0\]\.depth is 'deep', expected an integer"),
        ('(?s).*', '', 'expected a mapping with the key rosbag2_bagfile_information'),
        ('(?s).*', '- 1', 'expected a mapping with the key rosbag2_bagfile_information'),
        ('(?s).*', '[' * 100_000, 'nested too deep'),
    ],
)
def test_the_error_about_damaged_metadata_names_the_value(tmp_path: Path, old: str, new: str, error: str) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    text = metadata.read_text()
    metadata.write_text(damaged := re.sub(old, new, text, count=1))
    assert damaged != text
    with pytest.raises(InputError) as raised:
        Bag(tmp_path / 'bag')
    reason, _, advice = str(raised.value).partition('; ')
    assert re.search(f'metadata.*{error}', reason)
    assert advice == f'`mocap-ros recover {tmp_path / "bag"}` saves the messages that can be read'


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
