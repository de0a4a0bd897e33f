# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The description of a bag that rosbag2 reads: definitions, type hashes and QoS of topics, and metadata.yaml."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import yaml

from mocap_ros.errors import RecordingError
from mocap_ros.messages.cdr import DEFINITIONS_DISTRO, typestore

try:
    from yaml import CSafeDumper as SafeDumper  # four times faster, where PyYAML comes with it
except ImportError:
    from yaml import SafeDumper  # type: ignore[assignment]

METADATA = 'metadata.yaml'  # name of the file that describes a bag folder
BAG_INFORMATION = 'rosbag2_bagfile_information'  # the one key of that file
METADATA_VERSION = 9  # layout of metadata.yaml; version 9 lists QoS profiles with the names of their policies
ROSBAG2 = 'rosbag2'  # name of the metadata record that holds the same description inside an MCAP file
# Distribution by the first two numbers of the version of rclpy, which differ between all distributions.
DISTRO_BY_RCLPY_RELEASE = {'3.3': 'humble', '4.1': 'iron', '7.1': 'jazzy', '9.1': 'kilted'}
TRANSIENT_LOCAL = 'transient_local'  # durability with which late subscribers receive the last message
UNLIMITED = {'sec': 9223372036, 'nsec': 854775807}  # 2**63 - 1 ns, the infinite duration of the ROS middleware


class TypeDefinition(NamedTuple):
    """The definition of a message type and of all types that it contains, as .msg text, and its hash (RIHS01)."""

    text: str
    type_hash: str


@dataclass(frozen=True)
class Topic:
    """A topic as a bag describes it."""

    name: str  # absolute name
    type: str  # such as `sensor_msgs/msg/CameraInfo`
    definition: str  # text of the message type and of all types that it contains
    encoding: str = 'ros2msg'  # of the definition; empty where there is none
    type_hash: str = ''  # hash of the message type (RIHS01); empty where it is unknown
    # QoS profiles that the publishers offer, by rosbag2's names of the policies
    qos: tuple[Mapping[str, Any], ...] = ()

    @property
    def is_latched(self) -> bool:
        """Whether a late subscriber receives the last message."""
        return any(q.get('durability') == TRANSIENT_LOCAL for q in self.qos)


def make_topic(
    name: str,
    msgtype: str,
    *,
    latched: bool = False,
    qos: Sequence[Mapping[str, Any]] = (),
    definition: TypeDefinition | None = None,
) -> Topic:
    """Describe a topic; the definition of its type is by default this package's.

    Of equal QoS profiles one is held. If there is none, or none that is transient local for a latched topic, one
    reliable profile takes their place.
    """
    text, type_hash = definition or _generate_definition(msgtype)
    profiles = tuple(q for i, q in enumerate(qos) if q not in qos[:i])
    topic = Topic(name, msgtype, text, type_hash=type_hash, qos=profiles)
    if profiles and (topic.is_latched or not latched):
        return topic
    own = {
        'history': 'keep_last',
        'depth': 1 if latched else 10,
        'reliability': 'reliable',
        'durability': TRANSIENT_LOCAL if latched else 'volatile',
        'deadline': UNLIMITED,
        'lifespan': UNLIMITED,
        'liveliness': 'automatic',
        'liveliness_lease_duration': UNLIMITED,
        'avoid_ros_namespace_conventions': False,
    }
    return replace(topic, qos=(own,))


@cache
def _generate_definition(msgtype: str) -> TypeDefinition:
    store = typestore()
    if msgtype not in store.types:
        raise RecordingError(f'message type {msgtype} is not known and cannot be recorded')
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return TypeDefinition(text, store.hash_rihs01(msgtype))


def find_ros_distro() -> str:
    """Return the name of the ROS 2 distribution on which a bag is recorded.

    This is the distribution of the sourced workspace (the environment variable ROS_DISTRO), else that of the
    installed rclpy, else the one whose definitions of the standard messages this package uses.
    """
    if name := os.environ.get('ROS_DISTRO'):
        return name
    try:
        release = '.'.join(version('rclpy').split('.')[:2])
    except PackageNotFoundError:
        return DEFINITIONS_DISTRO
    return DISTRO_BY_RCLPY_RELEASE.get(release, DEFINITIONS_DISTRO)


@dataclass
class MessageStatistics:
    """Number and log times, in ns, of the messages in a file; the times are -1 where there is no message."""

    counts: Counter[str] = field(default_factory=Counter)  # by topic
    first_ns: int = -1
    last_ns: int = -1

    def add(self, topic: str, log_time_ns: int) -> None:
        """Count a message."""
        self.counts[topic] += 1
        self.first_ns = min(self.first_ns, log_time_ns) if self.first_ns >= 0 else log_time_ns
        self.last_ns = max(self.last_ns, log_time_ns)


def describe_bag(
    topics: Iterable[Topic], files: Mapping[str, MessageStatistics], ros_distro: str
) -> dict[str, Any]:
    """Return the content of metadata.yaml."""

    def summarise(files: Iterable[MessageStatistics]) -> dict[str, Any]:
        filled = [f for f in files if f.first_ns >= 0]
        first_ns = min((f.first_ns for f in filled), default=0)
        last_ns = max((f.last_ns for f in filled), default=0)
        return {
            'starting_time': {'nanoseconds_since_epoch': first_ns},
            'duration': {'nanoseconds': last_ns - first_ns},
            'message_count': sum(f.counts.total() for f in filled),
        }

    return {
        'version': METADATA_VERSION,
        'storage_identifier': 'mcap',
        **summarise(files.values()),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [dict(q) for q in topic.qos],
                    'type_description_hash': topic.type_hash,
                },
                'message_count': sum(f.counts[topic.name] for f in files.values()),
            }
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': list(files),
        'files': [{'path': name, **summarise([statistics])} for name, statistics in files.items()],
        'custom_data': None,
        'ros_distro': ros_distro,
    }


class _PlainDumper(SafeDumper):
    """A YAML writer without anchors and aliases, which some readers of metadata.yaml do not understand."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        """Return True: no value is written as an alias."""
        return True


def encode_yaml(content: Any) -> str:
    """Return content as YAML, without anchors."""
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)
