"""One MCAP file of a bag, being written."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from mocap_ros.bags.mcap_ending import Ending, finish_in_place
from mocap_ros.bags.rosbag2 import ROSBAG2, Span, Topic, dump
from mocap_ros.config import RecorderConfig

COMPRESSION = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}

Describe = Callable[['McapFile'], dict[str, Any]]


class Attachment(NamedTuple):
    """A file inside each file of a bag."""

    name: str
    media_type: str
    data: bytes


class McapFile:
    """Messages go into chunks, which are closed by size, and by `flush`.

    Args:
        path: of the new file.
        config: compression and size of chunks.

    Attributes:
        span: what has been written.

    Raises:
        OSError: of this and of every method: the disk is full or fails.
    """

    def __init__(self, path: Path, config: RecorderConfig) -> None:
        self.path = path
        self.span = Span()
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Schema] = {}
        self._stream: BinaryIO = path.open('xb')
        self._writer = Writer(
            self._stream,
            chunk_size=config.chunk_bytes,
            compression=COMPRESSION[config.compression],
        )
        self._writer.start('ros2', 'mocap_ros')

    @property
    def size(self) -> int:
        """Bytes written, without the open chunk."""
        return self._stream.tell()

    @property
    def in_place(self) -> bool:
        """Whether the file is still where it was made; no longer where it or its folder was removed or moved."""
        try:
            return os.path.samestat(os.fstat(self._stream.fileno()), self.path.stat())
        except FileNotFoundError:
            return False

    def add(self, topic: Topic) -> None:
        """Make a topic known."""
        schema = self._schemas.get(topic.type)
        if schema is None:
            definition = topic.definition.encode()
            number = self._writer.register_schema(topic.type, topic.encoding, definition)
            schema = self._schemas[topic.type] = Schema(number, definition, topic.encoding, topic.type)
        metadata = topic.channel_metadata
        number = self._writer.register_channel(topic.name, 'cdr', schema.id, metadata)
        self._channels[topic.name] = Channel(number, topic.name, 'cdr', metadata, schema.id)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append a message of a known topic."""
        self._writer.add_message(self._channels[topic].id, log_time_ns, data, publish_time_ns)
        self.span.add(topic, log_time_ns)

    def attach(self, attachments: Iterable[Attachment], time_ns: int) -> None:
        """Add files."""
        for name, media_type, data in attachments:
            self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self, describe: Describe) -> None:
        """Write index and ending; `describe` says what rosbag2 wants to know of this file."""
        self.note(ROSBAG2, {'serialized_metadata': dump(describe(self))})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()

    def rescue(self, describe: Describe) -> None:
        """Give the file an ending after any of the above failed; what was not written yet is lost."""
        with suppress(OSError):
            self._stream.close()
        names = {c.id: c.topic for c in self._channels.values()}

        def metadata(ending: Ending) -> Metadata:
            self.span = Span(first_ns=ending.first_ns, last_ns=ending.last_ns)
            self.span.counts.update({names[number]: count for number, count in ending.counts.items()})
            return Metadata(ROSBAG2, {'serialized_metadata': dump(describe(self))})

        finish_in_place(self.path, self._schemas.values(), self._channels.values(), metadata)
