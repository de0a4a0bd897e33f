# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be read are refused with the cause; topics of people and entries of the journal are read."""

import os
import re
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.bags.journal import Entry, Verdict, decode_entry, encode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA
from mocap_ros.bags.topics import Source, find_people_topics, list_input_types
from mocap_ros.config import RecorderConfig
from mocap_ros.config.defaults import Value
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, YOLO_DETECTIONS
from mocap_ros.messages.input_types import decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.versions import make_converter
from tests.support.bag_writing import START_NS, make_keypoints, write_bag
from tests.support.foreign_messages import (
    HRI_IDS_TOPIC,
    IMAGE_SIZE,
    LIMITS,
    encode_yolo,
    make_hri_inputs,
    make_inputs,
)


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
        ('(?s).*', '[' * 3000, 'nested too deep'),
        ('(?s).*', 'a: \udcff', ''),
    ],
)
def test_damaged_metadata_recommend_recover(tmp_path: Path, old: str, new: str, reason: str) -> None:
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
def test_renamed_packages_are_read(tmp_path: Path, package: str, edit: tuple[str, str], is_read: bool) -> None:
    write_foreign(tmp_path / 'bag', package, edit=edit)
    with Bag(tmp_path / 'bag') as bag:
        found = bag.topics_of_type([YOLO_DETECTIONS])
        assert found == (['/yolo/tracking'] if is_read else [])
        raws = [message.raw for message in bag.messages(found)]
    frames = [decode_frame(raw, YOLO_DETECTIONS, LIMITS, IMAGE_SIZE) for raw in raws]
    assert [len(frame.people) for frame in frames] == [2] * len(raws)


EMPTY_IDS = bytes([0, 1, 0, 0]) + bytes(24)  # an hri_msgs/IdsList with nobody in it


def test_a_bag_of_several_detectors_requires_a_choice(tmp_path: Path) -> None:
    other_topic = '/other/bodies/tracked'
    other_inputs = [(source, raw, topic.replace('/humans', '/other')) for source, raw, topic in make_hri_inputs(0)]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for msgtype, inputs in (
            (YOLO_DETECTIONS, make_inputs(YOLO_DETECTIONS, 0)),
            (HRI_SKELETON, make_hri_inputs(0)),
            (HRI_SKELETON, other_inputs),
        ):
            for source, raw, topic in inputs:
                recorder.write(topic, list_input_types(msgtype)[source], raw, 1, 1)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match=f'choose one: /keypoints, {HRI_IDS_TOPIC}, {other_topic}$'):
            find_people_topics(bag)
        assert find_people_topics(bag, '/keypoints') == {'/keypoints': Source.KEYPOINTS}
        assert find_people_topics(bag, other_topic) == {topic: source for source, _, topic in other_inputs}
        with pytest.raises(
            InputError, match=r'no topic /yolo of .*hri_msgs/msg/Skeleton2D; the bag has /keypoints'
        ):
            find_people_topics(bag, '/yolo')


def test_bodies_that_the_package_published_itself_are_no_input(tmp_path: Path) -> None:
    """`mocap_bridge` publishes a list of bodies, but no keypoints of theirs."""
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
        recorder.write('/humans/bodies/tracked', HRI_IDS, EMPTY_IDS, START_NS, START_NS)
    with Bag(tmp_path / 'bag') as bag:
        assert find_people_topics(bag) == {'/keypoints': Source.KEYPOINTS}
        tracked = '/humans/bodies/tracked'
        assert find_people_topics(bag, tracked) == {tracked: Source.TRACKED_BODIES}


def test_an_unknown_type_is_refused() -> None:
    with pytest.raises(ConfigError, match='yolo_msgs/msg/DetectionArray'):
        list_input_types('std_msgs/msg/String')


def test_journal_entries_round_trip() -> None:
    parameters: dict[str, Value] = {
        'solver.components': 20,
        'tracker.model': 'all',
        'solver.tolerance': 1e-05,
        'x': True,
    }
    for entry in (
        Entry('input', 3, Verdict.BACKLOG, 'late', '/keypoints'),
        Entry('parameters', 0, parameters=parameters),
    ):
        assert decode_entry(encode_entry(entry)) == entry
