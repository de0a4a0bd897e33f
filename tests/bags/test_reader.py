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
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA, make_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.foreign_types import YOLO_DETECTIONS
from mocap_ros.messages.input_types import decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.versions import make_converter
from tests.support.bag_writing import START_NS, make_keypoints, write_bag
from tests.support.foreign_messages import IMAGE_SIZE, LIMITS, encode_yolo


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
    for name in ('x.mcap', 'x.txt'):
        (tmp_path / name).write_bytes(b'no bag')
    os.mkfifo(tmp_path / 'pipe.mcap')
    reasons = {'none': 'does not exist', 'pipe.mcap': 'neither a file', 'x.mcap': 'magic', 'x.txt': 'storage'}
    for name, reason in {**reasons, '.': 'metadata'}.items():
        with pytest.raises(InputError, match=f'{name if name != "." else ""}.*{reason}'):
            Bag(tmp_path / name)


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('identifier', ['', "''", 'sqlite3', 'mcap'])
def test_the_files_say_how_a_bag_is_stored(tmp_path: Path, storage: StoragePlugin, identifier: str) -> None:
    write_foreign(tmp_path / 'bag', 'yolo_msgs', storage)
    metadata = tmp_path / 'bag' / METADATA
    metadata.write_text(
        re.sub(r'storage_identifier: .*', f'storage_identifier: {identifier}', metadata.read_text())
    )
    with Bag(tmp_path / 'bag') as bag:
        assert len(list(bag.messages(bag.topics))) == 3


def write_foreign(
    folder: Path, package: str, storage: StoragePlugin = StoragePlugin.MCAP, edit: tuple[str, str] = ('', '')
) -> None:
    """Write messages of yolo_ros under another name of their package, whose definition may be edited."""
    store = get_typestore(Stores.ROS2_JAZZY)
    msgtype = YOLO_DETECTIONS.replace('yolo_msgs', package)
    text = typestore().generate_msgdef(YOLO_DETECTIONS)[0].replace('yolo_msgs', package).replace(*edit)
    store.register(get_types_from_msg(text, msgtype))
    with Rosbag2Writer(folder, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection('/yolo/tracking', msgtype, typestore=store)
        for frame in range(3):
            raw = make_converter(typestore(), store, YOLO_DETECTIONS, msgtype)(encode_yolo(frame))
            writer.write(connection, frame + 1, raw)


@pytest.mark.parametrize(
    ('package', 'edit', 'is_read'),
    [
        ('yolo_msgs', ('', ''), True),
        ('yolov8_msgs', ('', ''), True),
        ('yolov8_msgs', ('string class_name', 'int64 more\nstring class_name'), True),
        ('yolo_of_mine_msgs', ('', ''), True),
        ('yolo_of_mine_msgs', ('string class_name', 'int64 more\nstring class_name'), False),
    ],
)
def test_messages_of_a_package_by_another_name_are_read(
    tmp_path: Path, package: str, edit: tuple[str, str], is_read: bool
) -> None:
    write_foreign(tmp_path / 'bag', package, edit=edit)
    with Bag(tmp_path / 'bag') as bag:
        found = bag.topics_of_type([YOLO_DETECTIONS])
        assert found == (['/yolo/tracking'] if is_read else [])
        raws = [message.raw for message in bag.messages(found)]
    frames = [decode_frame(raw, YOLO_DETECTIONS, LIMITS, IMAGE_SIZE) for raw in raws]
    assert [len(frame.people) for frame in frames] == [2] * len(raws)
