"""Writing bags: MCAP files that rosbag2 and every MCAP reader accept.

A bag is a folder holding `<name>_0.mcap` and `metadata.yaml`. Chunks are closed by size and by time, so that a
killed process loses no more than the last one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import yaml
from mcap.writer import CompressionType, Writer

from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError
from mocap_ros.io.messages import NS, ROS_DISTRO, typestore

if TYPE_CHECKING:
    from typing_extensions import Self

METADATA_VERSION = 9
COMPRESSION = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}
UNLIMITED = {'sec': 9223372036, 'nsec': 854775807}


def new_bag_folder(root: Path, time_ns: int) -> Path:
    """A path in `root` that does not exist yet, named by the UTC time.

    Args:
        root: the recording folder.
        time_ns: since the epoch.
    """
    name = datetime.fromtimestamp(time_ns // NS, timezone.utc).strftime('mocap_%Y%m%dT%H%M%SZ')
    candidates = (root / (name + (f'_{n}' if n else '')) for n in count())
    return next(path for path in candidates if not path.exists())


@dataclass
class _Channel:
    """What is known of one recorded topic."""

    number: int
    type: str
    hash: str
    qos: list[dict[str, Any]]
    messages: int = field(default=0)


class Recorder:
    """Writes one bag.

    Args:
        folder: of the new bag; its parents are made where they are missing.
        config: compression, and when a chunk is closed.

    Raises:
        RecordingError: the folder exists or cannot be written.
    """

    def __init__(self, folder: Path, config: RecorderConfig) -> None:
        self.folder = folder
        self.path = folder / f'{folder.name}_0.mcap'
        self._config = config
        self._channels: dict[str, _Channel] = {}
        self._first_ns = self._last_ns = self._chunk_ns = -1
        self._stream: BinaryIO | None = None
        self._writer: Writer | None = None
        with self._disk():
            folder.mkdir(parents=True)
            self._stream = self.path.open('xb')
            self._writer = Writer(
                self._stream,
                chunk_size=config.chunk_bytes,
                compression=COMPRESSION[config.compression],
            )
            self._writer.start('ros2', 'mocap_ros')

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, topic: str, msgtype: str, *, latched: bool = False) -> None:
        """Make a topic known before its first message; needed only for latched (transient local) ones.

        Raises:
            RecordingError: unknown message type, another type than before, or a failing disk.
        """
        if topic in self._channels:
            if self._channels[topic].type != msgtype:
                known = self._channels[topic].type
                raise RecordingError(f'{self.path}: topic {topic} is {known}, not {msgtype}')
            return
        writer = self._open_writer
        definition, type_hash = _definition(msgtype)
        qos = [_qos(latched)]
        with self._disk():
            schema = writer.register_schema(msgtype, 'ros2msg', definition.encode())
            number = writer.register_channel(
                topic,
                'cdr',
                schema,
                {'offered_qos_profiles': _dump(qos), 'topic_type_hash': type_hash},
            )
        self._channels[topic] = _Channel(number, msgtype, type_hash, qos)

    def write(self, topic: str, msgtype: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append a message.

        Args:
            topic: absolute name.
            msgtype: such as `sensor_msgs/msg/CameraInfo`.
            data: CDR.
            log_time_ns: time of receipt; of outputs, of their publication.
            publish_time_ns: time at which the sender sent it.

        Raises:
            RecordingError: the disk is full or fails, or the bag is closed.
        """
        writer = self._open_writer
        self.announce(topic, msgtype)
        channel = self._channels[topic]
        with self._disk():
            writer.add_message(channel.number, log_time_ns, data, publish_time_ns)
        channel.messages += 1
        self._first_ns = log_time_ns if self._first_ns < 0 else min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)
        if self._chunk_ns < 0:
            self._chunk_ns = log_time_ns
        elif log_time_ns - self._chunk_ns >= self._config.chunk_seconds * NS:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system.

        Raises:
            RecordingError: the disk is full or fails.
        """
        self._chunk_ns = -1
        writer = self._open_writer
        with self._disk():
            writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Finish the bag; nothing happens the second time.

        Raises:
            RecordingError: the disk is full or fails.
        """
        if self._writer is None or self._stream is None:
            return
        information = self._information()
        with self._disk():
            self._writer.add_metadata('rosbag2', {'serialized_metadata': _dump(information)})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
            self._stream = self._writer = None
            unfinished = self.folder / 'metadata.yaml.tmp'
            content = _dump({'rosbag2_bagfile_information': information})
            unfinished.write_text(content, encoding='utf-8')
            unfinished.replace(self.folder / 'metadata.yaml')

    @property
    def _open_writer(self) -> Writer:
        if self._writer is None:
            raise RecordingError(f'{self.path}: the recording is closed')
        return self._writer

    @contextlib.contextmanager
    def _disk(self) -> Iterator[None]:
        """Give the recording up where the disk fails."""
        try:
            yield
        except OSError as error:
            self._abandon()
            where = error.filename or self.path
            raise RecordingError(f'{where}: {error.strerror or error}') from None

    def _abandon(self) -> None:
        """Let go of the file after a failure; what reached it stays readable."""
        stream, self._stream, self._writer = self._stream, None, None
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()

    def _information(self) -> dict[str, Any]:
        """The content of metadata.yaml."""
        total = sum(c.messages for c in self._channels.values())
        span = {
            'starting_time': {'nanoseconds_since_epoch': max(self._first_ns, 0)},
            'duration': {'nanoseconds': self._last_ns - self._first_ns},
            'message_count': total,
        }
        return {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic,
                        'type': channel.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': channel.qos,
                        'type_description_hash': channel.hash,
                    },
                    'message_count': channel.messages,
                }
                for topic, channel in self._channels.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self.path.name],
            'files': [{'path': self.path.name, **span}],
            'custom_data': None,
            'ros_distro': ROS_DISTRO,
        }


@cache
def _definition(msgtype: str) -> tuple[str, str]:
    """Full text of a message type with all it uses, and its hash."""
    store = typestore()
    if msgtype not in store.types:
        raise RecordingError(f'message type {msgtype} is not known and cannot be recorded')
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return text, store.hash_rihs01(msgtype)


def _qos(latched: bool) -> dict[str, Any]:
    return {
        'history': 'keep_last',
        'depth': 1 if latched else 10,
        'reliability': 'reliable',
        'durability': 'transient_local' if latched else 'volatile',
        'deadline': dict(UNLIMITED),
        'lifespan': dict(UNLIMITED),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(UNLIMITED),
        'avoid_ros_namespace_conventions': False,
    }


def _dump(content: Any) -> str:
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)


class _PlainDumper(yaml.SafeDumper):
    """No anchors and aliases, which other readers of metadata.yaml stumble over."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        """Always."""
        return True
