# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A writer of one MCAP file of a bag."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from mcap.writer import CompressionType, Writer

from mocap_ros.bags.rosbag2 import ROSBAG2, MessageStatistics, Topic, encode_yaml
from mocap_ros.config import RecorderConfig

# The compression of chunks by the values of `recorder.compression`.
COMPRESSION = {'zstd': CompressionType.ZSTD, 'lz4': CompressionType.LZ4, 'none': CompressionType.NONE}
RECORD_BYTES = 31  # that a message takes in a chunk besides its data


class Attachment(NamedTuple):
    """A file that is attached to each file of a bag; its time in ns is that at which it is attached, if None."""

    name: str
    media_type: str
    data: bytes
    create_time_ns: int | None = None


class _Output:
    """The stream of an `mcap` writer, whose `flush` writes everything to the file, or raises OSError.

    What could not be written stays in the memory, and the next `flush` writes it: the file always ends with a
    complete record, except while it is written.
    """

    def __init__(self, path: Path) -> None:
        self.file = path.open('xb', buffering=0)
        self.written_bytes = 0
        self._waiting = bytearray()

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self.written_bytes + len(self._waiting)

    def flush(self) -> None:
        self.file.seek(self.written_bytes)
        rest = memoryview(bytes(self._waiting))
        try:
            while rest:  # a disk that is nearly full takes only a part at first
                rest = rest[self.file.write(rest) :]
        except OSError:
            with suppress(OSError):
                self.file.truncate(self.written_bytes)
            raise
        self.written_bytes += len(self._waiting)
        self._waiting.clear()


class McapFile:
    """An MCAP file that is being written.

    Messages are collected in chunks. A chunk is closed when it reaches the configured size, or by `flush`.
    Every method may raise OSError where the disk is full or fails.
    """

    def __init__(self, path: Path, config: RecorderConfig) -> None:
        self.path = path
        self.statistics = MessageStatistics()  # of the messages written so far
        self._channels: dict[str, int] = {}  # ids by topic
        self._schemas: dict[str, int] = {}  # ids by message type
        self._max_chunk_bytes = config.chunk_bytes
        self._open_bytes = 0
        self._has_end = False
        self._output = _Output(path)
        # `write` closes the chunks
        self._writer = Writer(self._output, sys.maxsize, COMPRESSION[config.compression])  # type: ignore[arg-type]
        self._writer.start('ros2', 'mocap_ros')
        try:
            self._output.flush()  # so that a recovery knows the file as an MCAP file
        except OSError:
            with suppress(OSError):
                self._output.file.close()
                path.unlink()
            raise

    @property
    def written_bytes(self) -> int:
        """Number of bytes written, without the open chunk."""
        return self._output.tell()

    def check_place(self) -> None:
        """Raise OSError where the file, or its folder, was removed or moved."""
        if not os.path.samestat(os.fstat(self._output.file.fileno()), self.path.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.path)

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; its messages can be written from now on."""
        if topic.type not in self._schemas:
            text = topic.definition.encode()
            self._schemas[topic.type] = self._writer.register_schema(topic.type, topic.encoding, text)
        profiles = encode_yaml([dict(q) for q in topic.qos])
        metadata = {'offered_qos_profiles': profiles, 'topic_type_hash': topic.type_hash}
        channel = self._writer.register_channel(topic.name, 'cdr', self._schemas[topic.type], metadata)
        self._channels[topic.name] = channel

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append a message of a topic that has been added."""
        self._writer.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        self.statistics.add(topic, log_time_ns)
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
        self._open_bytes = 0
        self._writer.flush()  # type: ignore[no-untyped-call]

    def prepare_sync(self) -> Callable[[], None]:
        """Return a function that waits until the disk holds what was flushed; another thread may call it."""
        descriptor = os.dup(self._output.file.fileno())

        def sync() -> None:
            try:
                os.fdatasync(descriptor)
            finally:
                os.close(descriptor)

        return sync

    def finish(self, describe: Callable[[], dict[str, Any]]) -> Callable[[], None]:
        """Write the description for rosbag2, the summary and the footer, and close the file.

        If this fails, it may be tried again. Returns what `prepare_sync` returns.
        """
        if not self._has_end:
            self.add_metadata(ROSBAG2, {'serialized_metadata': encode_yaml(describe())})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._has_end = True
        self._output.flush()
        sync = self.prepare_sync()
        self._output.file.close()
        return sync


def sync_folder(folder: Path) -> None:
    """Wait until the disk holds the names in a folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # of file systems that sync no folders
            raise
    finally:
        os.close(descriptor)
