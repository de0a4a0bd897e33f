# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A writer of one MCAP file of a bag."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from mocap_ros.bags.mcap_ending import ChannelStatistics, write_missing_end
from mocap_ros.bags.rosbag2 import ROSBAG2, MessageStatistics, Topic, encode_yaml
from mocap_ros.bags.write_ahead_log import WriteAheadLog
from mocap_ros.config import RecorderConfig

# The compression of chunks by the values of `recorder.compression`.
COMPRESSION = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}

RECORD_BYTES = 31  # that a message takes in a chunk besides its data

# A function that describes a file as metadata.yaml does.
DescribeFile = Callable[['McapFile'], dict[str, Any]]


class Attachment(NamedTuple):
    """A file that is attached to each file of a bag.

    Attributes:
        name: Name of the file.
        media_type: Media type (MIME).
        data: Content.
        create_time_ns: Time at which the file was created, in ns; by default, that at which it is attached.
    """

    name: str
    media_type: str
    data: bytes
    create_time_ns: int | None = None


class McapFile:
    """An MCAP file that is being written.

    Messages are collected in chunks. A chunk is closed when it reaches the configured size, or by `flush`.
    Every method may raise OSError where the disk is full or fails.

    Args:
        path: Path of the new file.
        config: Compression and size of the chunks.
        has_log: Whether the messages of the open chunk are written to a write-ahead log by `write_ahead`.

    Attributes:
        path: Path of the file.
        statistics: Number and times of the messages written so far.

    Raises:
        OSError: The file exists or cannot be written.
    """

    def __init__(self, path: Path, config: RecorderConfig, *, has_log: bool = False) -> None:
        self.path = path
        self.statistics = MessageStatistics()
        self._channels: dict[str, Channel] = {}  # by topic
        self._schemas: dict[str, Schema] = {}  # by message type
        self._max_chunk_bytes = config.chunk_bytes
        self._chunk_count = self._open_bytes = 0
        self._log: WriteAheadLog | None = None
        self._stream: BinaryIO = path.open('xb')
        try:
            self._writer = Writer(
                self._stream,
                chunk_size=sys.maxsize,  # `write` closes the chunks
                compression=COMPRESSION[config.compression],
            )
            self._writer.start('ros2', 'mocap_ros')
            self._stream.flush()  # so that a recovery knows the file as an MCAP file
            self._log = WriteAheadLog(path) if has_log else None
        except OSError:
            with suppress(OSError):
                self._stream.close()
            with suppress(OSError):
                path.unlink()
            raise

    @property
    def written_bytes(self) -> int:
        """Number of bytes written, without the open chunk."""
        return self._stream.tell()

    @property
    def is_in_place(self) -> bool:
        """Whether the file still exists under its path, and neither it nor its folder was removed or moved."""
        try:
            return os.path.samestat(os.fstat(self._stream.fileno()), self.path.stat())
        except FileNotFoundError:
            return False

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; its messages can be written from now on."""
        schema = self._schemas.get(topic.type)
        if schema is None:
            definition = topic.definition.encode()
            schema_id = self._writer.register_schema(topic.type, topic.encoding, definition)
            schema = self._schemas[topic.type] = Schema(schema_id, definition, topic.encoding, topic.type)
            if self._log is not None:
                self._log.add_description(schema)
        metadata = topic.channel_metadata
        channel_id = self._writer.register_channel(topic.name, 'cdr', schema.id, metadata)
        channel = self._channels[topic.name] = Channel(channel_id, topic.name, 'cdr', metadata, schema.id)
        if self._log is not None:
            self._log.add_description(channel)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append a message of a topic that has been added."""
        channel_id = self._channels[topic].id
        self._writer.add_message(channel_id, log_time_ns, data, publish_time_ns)
        if self._log is not None:
            self._log.add_message(channel_id, data, log_time_ns, publish_time_ns)
        self.statistics.add_message(topic, log_time_ns)
        self._open_bytes += len(data) + RECORD_BYTES
        if self._open_bytes >= self._max_chunk_bytes:
            self.flush()

    def add_attachments(self, attachments: Iterable[Attachment], time_ns: int) -> None:
        """Add attachments with a log time in ns."""
        for name, media_type, data, create_time_ns in attachments:
            created_ns = time_ns if create_time_ns is None else create_time_ns
            self._writer.add_attachment(created_ns, time_ns, name, media_type, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Close the chunk and hand the written data to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        if not self._open_bytes:
            return
        self._open_bytes = 0
        self._chunk_count += 1
        if self._log is not None:
            self._log.start_chunk(self._chunk_count)

    def write_ahead(self) -> None:
        """Hand the messages of the open chunk to the operating system, in the write-ahead log."""
        self._stream.flush()  # attachments
        if self._log is not None:
            self._log.write()

    def finish(self, describe: DescribeFile) -> None:
        """Write the description for rosbag2, the summary and the footer, and close the file."""
        self.add_metadata(ROSBAG2, {'serialized_metadata': encode_yaml(describe(self))})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()
        if self._log is not None:
            self._log.close(remove=True)

    def finish_after_failure(self, describe: DescribeFile) -> None:
        """Make a complete file of the data that reached the disk, and of the open chunk of a file with a log.

        If this fails as well, the write-ahead log stays, so that a recovery finds the messages of the open chunk.
        """
        with suppress(OSError):
            self._stream.close()
        open_chunk = None
        if self._log is not None:
            open_chunk = self._log.open_chunk
            self._log.close(remove=False)
        topics = {c.id: c.topic for c in self._channels.values()}

        def make_metadata(written: ChannelStatistics) -> Metadata:
            self.statistics = MessageStatistics(first_ns=written.first_ns, last_ns=written.last_ns)
            self.statistics.counts.update({topics[channel]: count for channel, count in written.counts.items()})
            return Metadata(ROSBAG2, {'serialized_metadata': encode_yaml(describe(self))})

        write_missing_end(self.path, self._schemas.values(), self._channels.values(), make_metadata, open_chunk)
        if self._log is not None:
            self._log.close(remove=True)
