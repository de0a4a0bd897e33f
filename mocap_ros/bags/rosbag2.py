"""What rosbag2 wants to find in a bag: definitions, hashes and QoS of topics, and metadata.yaml."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import yaml

from mocap_ros.errors import RecordingError
from mocap_ros.messages.cdr import ROS_DISTRO, typestore

METADATA = 'metadata.yaml'
METADATA_VERSION = 9
ROSBAG2 = 'rosbag2'  # name of its metadata record in an MCAP file
TRANSIENT_LOCAL = 'transient_local'
UNLIMITED = {'sec': 9223372036, 'nsec': 854775807}


@dataclass(frozen=True)
class Topic:
    """A topic as a bag describes it.

    Attributes:
        name: absolute.
        type: such as `sensor_msgs/msg/CameraInfo`.
        definition: full text of the type with all that it uses.
        encoding: of the definition, `ros2msg` or `ros2idl`.
        hash: of the type (RIHS01), empty where not known.
        qos: profiles that its publishers offer, by rosbag2's policy names.
    """

    name: str
    type: str
    definition: str
    encoding: str = 'ros2msg'
    hash: str = ''
    qos: tuple[Mapping[str, Any], ...] = ()

    @property
    def latched(self) -> bool:
        """Whether a late subscriber gets the last message."""
        return any(q.get('durability') == TRANSIENT_LOCAL for q in self.qos)

    @property
    def channel_metadata(self) -> dict[str, str]:
        """What the channel of an MCAP file says of it."""
        return {'offered_qos_profiles': dump([dict(q) for q in self.qos]), 'topic_type_hash': self.hash}


@dataclass
class Span:
    """What is in a file, or in several: messages by topic, log times of the first and the last in ns."""

    counts: Counter[str] = field(default_factory=Counter)
    first_ns: int = -1
    last_ns: int = -1

    def add(self, topic: str, log_time_ns: int) -> None:
        """Count a message."""
        self.counts[topic] += 1
        self.include(log_time_ns, log_time_ns)

    def include(self, first_ns: int, last_ns: int) -> None:
        """Reach from the one to the other too."""
        self.first_ns = first_ns if self.first_ns < 0 else min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)

    def as_metadata(self) -> dict[str, Any]:
        """The three entries of metadata.yaml."""
        return {
            'starting_time': {'nanoseconds_since_epoch': max(self.first_ns, 0)},
            'duration': {'nanoseconds': self.last_ns - self.first_ns},
            'message_count': self.counts.total(),
        }


def known_topic(name: str, msgtype: str, *, latched: bool = False, qos: Sequence[Mapping[str, Any]] = ()) -> Topic:
    """A topic of a type that we know.

    Args:
        name: absolute.
        msgtype: its type.
        latched: transient local.
        qos: profiles that its publishers offer; by default ours, which is reliable.

    Raises:
        RecordingError: the type is not known.
    """
    definition, type_hash = _definition(msgtype)
    return Topic(name, msgtype, definition, hash=type_hash, qos=tuple(qos) or (_qos(latched=latched),))


def information(topics: Iterable[Topic], files: Mapping[str, Span]) -> dict[str, Any]:
    """What rosbag2 keeps of a bag.

    Args:
        topics: all of them, those without messages too.
        files: by name, in their order.
    """
    total = Span()
    for span in files.values():
        total.counts.update(span.counts)
        if span.first_ns >= 0:
            total.include(span.first_ns, span.last_ns)
    return {
        'version': METADATA_VERSION,
        'storage_identifier': 'mcap',
        **total.as_metadata(),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [dict(q) for q in topic.qos],
                    'type_description_hash': topic.hash,
                },
                'message_count': total.counts[topic.name],
            }
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': list(files),
        'files': [{'path': name, **span.as_metadata()} for name, span in files.items()],
        'custom_data': None,
        'ros_distro': ROS_DISTRO,
    }


def dump(content: Any) -> str:
    """As YAML."""
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)


class _PlainDumper(yaml.SafeDumper):
    """No anchors and aliases, which other readers of metadata.yaml stumble over."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        """Always."""
        return True


@cache
def _definition(msgtype: str) -> tuple[str, str]:
    """Full text of a message type with all it uses, and its hash."""
    store = typestore()
    if msgtype not in store.types:
        raise RecordingError(f'message type {msgtype} is not known and cannot be recorded')
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return text, store.hash_rihs01(msgtype)


def _qos(*, latched: bool) -> dict[str, Any]:
    return {
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
