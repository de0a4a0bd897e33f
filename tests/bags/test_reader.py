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
from tests.support.bag_writing import FRAMES, START_NS, STEP_NS, make_keypoints, write_bag


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
        (r'message_count: \d+', f'message_count: {"9" * 5000}', 'a number, a date or a tag in it has no meaning'),
        ('version: 9', 'version: new', "version is 'new', expected an integer"),
        ('identifier: mcap', 'identifier: [mcap]', r"storage_identifier is \['mcap'\], expected text"),
        (r'  - bag_0\.mcap\n', '  - bag_0.mcap\n' * 2, "relative_file_paths: 'bag_0.mcap' occurs 2 times"),
        (
            'name: /keypoints',
            'name:',
            r'topics_with_message_count\[1\]\.topic_metadata\.name is empty, expected text',
        ),
        (
            'depth: 10',
            'depth: deep',
            r"topics_with_message_count\[1\] \(/keypoints\): offered_qos_profiles\[0\]\.depth is 'deep'",
        ),
        ('message_count: 61', 'message_count: !!bool maybe', 'a number, a date or a tag in it has no meaning'),
        ('version: 9', 'version: 10', 'version is 10, and versions up to 9 are known'),
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
    assert re.search(rf'bag: the bag cannot be read: metadata\.yaml: {error}', reason)
    assert advice == f'`mocap-ros recover {tmp_path / "bag"}` saves the messages that can be read'


@pytest.mark.parametrize(
    ('old', 'new'),
    [
        (r'(name: /keypoints(.*\n)*?    message_count:) \d+', r'\1 0'),
        ('type: mocap_ros_msgs/msg/Keypoints2DArray', 'type: mocap_ros_msgs/msg/Keypoints'),
        ('name: /keypoints', 'name: /points'),
    ],
)
def test_messages_that_metadata_hide_are_told(tmp_path: Path, old: str, new: str) -> None:
    """Otherwise a topic of a bag, such as CameraInfo, is taken for empty in silence."""
    write_bag(tmp_path / 'bag', RecorderConfig())
    metadata = tmp_path / 'bag' / METADATA
    text = metadata.read_text()
    metadata.write_text(changed := re.sub(old, new, text, count=1))
    assert changed != text
    reason = rf'metadata\.yaml has no messages of {KEYPOINTS} on /keypoints, of which a file has {FRAMES}; `mocap'
    with pytest.raises(InputError, match=reason):
        Bag(tmp_path / 'bag')


def test_metadata_that_are_not_utf_8_are_refused(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    (tmp_path / 'bag' / 'metadata.yaml').write_bytes(b'a: \xff')
    with pytest.raises(InputError, match=r'bag/metadata\.yaml: not UTF-8 at byte 3; `mocap-ros recover .*/bag`'):
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
