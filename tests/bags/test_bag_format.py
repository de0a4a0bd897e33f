# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Format of recorded bags: other readers (rosbags, mcap, rerun, mcap_ros2) and our own read every message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from mocap_ros.config import RecorderConfig
from mocap_ros.messages.cdr import DEFINITIONS_DISTRO, decode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import FRAMES, START_NS, STEP_NS, Message, write_bag


@pytest.fixture(scope='module', params=['zstd', 'lz4', 'none'])
def recorded(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Message]]:
    """Return the folder and the messages of a bag, for each compression."""
    folder = tmp_path_factory.mktemp('bags') / request.param
    return folder, write_bag(folder, RecorderConfig(compression=request.param))


def test_rosbags_reads_the_folder_and_the_bare_file(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    expected = [(topic, log_time_ns, data) for topic, log_time_ns, _, data in written]
    for path in (folder, folder / f'{folder.name}_0.mcap'):
        with Reader(path) as reader:
            assert [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()] == expected
            assert reader.message_count == FRAMES + 1
            durability = {}
            for connection in reader.connections:
                assert isinstance(connection.ext, ConnectionExtRosbag2)
                durability[connection.topic] = connection.ext.offered_qos_profiles[0].durability.name
            assert durability == {'/keypoints': 'VOLATILE', '/skeleton_definition': 'TRANSIENT_LOCAL'}
        with AnyReader([path]) as any_reader:  # checks the type hashes of metadata.yaml against the definitions
            for connection, _, raw in any_reader.messages():
                message = any_reader.deserialize(raw, connection.msgtype)
                assert repr(message) == repr(decode(bytes(raw), connection.msgtype))


def test_mcap_reads_the_file_by_its_index(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == FRAMES + 1
        assert len(summary.chunk_indexes) >= FRAMES * STEP_NS / 1.1e9
        read = [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in reader.iter_messages()]
        assert read == written
        assert reader.get_header().profile == 'ros2'
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
            assert channel.metadata['topic_type_hash'] == typestore().hash_rihs01(schema.name)
            assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['history'] == 'keep_last'
        (metadata,) = [m for m in reader.iter_metadata() if m.name == 'rosbag2']
        inside = yaml.safe_load(metadata.metadata['serialized_metadata'])
    beside = yaml.safe_load((folder / 'metadata.yaml').read_text())
    assert beside == {'rosbag2_bagfile_information': inside}
    assert inside['version'] == 9
    assert inside['storage_identifier'] == 'mcap'
    assert inside['relative_file_paths'] == [f'{folder.name}_0.mcap']
    assert inside['starting_time']['nanoseconds_since_epoch'] == START_NS
    assert inside['duration']['nanoseconds'] == (FRAMES - 1) * STEP_NS


def test_mcap_ros2_decodes_the_messages(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = [(m.log_time, message) for _, _, m, message in reader.iter_decoded_messages(['/keypoints'])]
    assert len(read) == FRAMES
    for (time_ns, decoded), (_, log_time_ns, _, data) in zip(read, written[1:], strict=True):
        expected = decode(data, KEYPOINTS)
        assert time_ns == log_time_ns
        assert decoded.header.stamp.nanosec == expected.header.stamp.nanosec
        np.testing.assert_array_equal(decoded.people[0].x, expected.people[0].x)


def read_ros_distro(folder: Path) -> str:
    """Return the distribution that the metadata beside the file and in the file name."""
    beside = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']['ros_distro']
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        (metadata,) = [m for m in make_reader(file).iter_metadata() if m.name == 'rosbag2']
    assert yaml.safe_load(metadata.metadata['serialized_metadata'])['ros_distro'] == beside
    return str(beside)


@pytest.mark.parametrize(
    ('sourced', 'rclpy_version', 'expected'),
    [
        ('humble', '7.1.9', 'humble'),
        ('', '7.1.9', 'jazzy'),
        ('', '3.3.15', 'humble'),
        ('', '99.0.0', DEFINITIONS_DISTRO),
        ('rolling', '99.0.0', 'rolling'),
    ],
)
def test_a_bag_names_the_distribution_that_is_sourced_or_to_which_rclpy_belongs(
    sourced: str, rclpy_version: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    metadata = tmp_path / 'site' / f'rclpy-{rclpy_version}.dist-info' / 'METADATA'
    metadata.parent.mkdir(parents=True)
    metadata.write_text(f'Metadata-Version: 2.1\nName: rclpy\nVersion: {rclpy_version}\n')
    monkeypatch.syspath_prepend(metadata.parents[1])
    monkeypatch.setenv('ROS_DISTRO', sourced)
    write_bag(tmp_path / 'bag', RecorderConfig())
    assert read_ros_distro(tmp_path / 'bag') == expected
