# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be read are refused with an error that names the cause."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import yaml
from mcap.writer import Writer

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA, make_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import FRAMES, START_NS, make_keypoints, write_bag


def test_a_bag_without_metadata_recommends_recover(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.raises(InputError, match=r'not finished: metadata\.yaml is missing; `mocap-ros recover'):
        Bag(tmp_path / 'bag')
    with Bag(tmp_path / 'bag' / 'bag_0.mcap') as bag:
        assert bag.count(bag.topics) == FRAMES + 1


@pytest.mark.parametrize(
    ('old', 'new', 'reason'),
    [
        (r'\n    message_count: \d+', r'\n    message_count: many', ''),
        (r'\n    message_count: \d+', '', 'message_count'),
        ('version: 9', 'version: 10', 'version 10'),
        ('identifier: mcap', 'identifier: [mcap]', ''),
        (r'bag_0\.mcap', 'other.mcap', r'other\.mcap'),
        ('depth: 10', 'width: 10', 'depth'),
        ('(?s).*', '', ''),
        ('(?s).*', '[' * 100_000, 'nested too deep'),
        ('(?s).*', 'a: \udcff', ''),
    ],
)
def test_damaged_metadata_are_an_error_that_recommends_recover(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    metadata = tmp_path / 'bag' / METADATA
    text = metadata.read_text()
    changed = re.sub(old, new, text, count=1)
    assert changed != text
    metadata.write_bytes(changed.encode(errors='surrogateescape'))
    match = rf'bag: the bag cannot be read: .*{reason}.*; `mocap-ros recover {tmp_path / "bag"}`'
    with pytest.raises(InputError, match=match):
        Bag(tmp_path / 'bag')


# The first version of metadata.yaml that has a key, by key: of the bag, and of a topic.
BAG_KEYS = {'compression_format': 3, 'compression_mode': 3, 'files': 5, 'custom_data': 6, 'ros_distro': 8}
TOPIC_KEYS = {'offered_qos_profiles': 4, 'type_description_hash': 7}


@pytest.mark.parametrize('version', range(1, 9))
def test_all_versions_of_metadata_are_read(tmp_path: Path, version: int) -> None:
    """Below version 9, QoS profiles are a text, with numbers for the policies."""
    written = write_bag(tmp_path / 'bag', RecorderConfig())
    path = tmp_path / 'bag' / METADATA
    content = yaml.safe_load(path.read_text())
    bag = content[BAG_INFORMATION]
    bag['version'] = version
    if version < 4:
        bag['relative_file_paths'] = [f'bag/{name}' for name in bag['relative_file_paths']]
    topics = [topic['topic_metadata'] for topic in bag['topics_with_message_count']]
    for topic in topics:
        numbers = {'history': 1, 'reliability': 1, 'durability': 2, 'liveliness': 1}
        profiles = [{**profile, **numbers} for profile in topic['offered_qos_profiles']]
        topic['offered_qos_profiles'] = yaml.safe_dump(profiles)
    for keys, places in ((BAG_KEYS, [bag]), (TOPIC_KEYS, topics)):
        for place in places:
            for key in [key for key, first in keys.items() if version < first]:
                del place[key]
    path.write_text(yaml.safe_dump(content))
    with Bag(tmp_path / 'bag') as reader:
        assert reader.count(reader.topics) == len(written)
        depths = {topic: [profile.depth for profile in profiles] for topic, profiles in reader.qos.items()}
        assert depths == {'/skeleton_definition': [1] * (version >= 4), '/keypoints': [10] * (version >= 4)}


def test_a_recovered_bag_with_any_time_is_read(tmp_path: Path) -> None:
    """A time of an MCAP file is any number of 64 bits without a sign."""
    times = [START_NS, (1 << 63) + 5, (1 << 64) - 1]
    with (tmp_path / 'damaged.mcap').open('wb') as file:
        writer = Writer(file)
        writer.start('ros2', '')
        schema = writer.register_schema(
            KEYPOINTS, 'ros2msg', make_topic('/keypoints', KEYPOINTS).definition.encode()
        )
        channel = writer.register_channel('/keypoints', 'cdr', schema)
        for time_ns in times:
            writer.add_message(channel, time_ns, make_keypoints(0), time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    recover(tmp_path / 'damaged.mcap', tmp_path / 'whole')
    with Bag(tmp_path / 'whole') as bag:
        assert [message.time_ns for message in bag.messages(bag.topics)] == times


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
