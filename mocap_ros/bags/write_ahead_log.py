# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The write-ahead log of an MCAP file: the messages of its open chunk, which are not in the file yet.

A chunk is compressed and written as a whole, so without the log a killed recorder would lose all messages since
the last chunk. The log is called `<file>-wal` and exists only while the file is being written. All integers are
little-endian.

    log      number of the chunks before the open chunk uint64, records
    record   as in a chunk of the MCAP specification (https://mcap.dev/spec): Schema, Channel or Message

When a chunk has been written, the log is emptied. If the file holds more chunks than the log states, the recorder
was killed in between, and the messages of the log are in the file already.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

SUFFIX = '-wal'  # after the name of the file, as SQLite names its write-ahead log
CHUNK_COUNT = struct.Struct('<Q')  # number of the chunks before the open chunk
# Opcode, length of the content in bytes, channel, sequence number, log time and publish time in ns.
MESSAGE_HEADER = struct.Struct('<BQHIQQ')
MAX_LOG_BYTES = 1 << 28  # that are read; guards the memory, and is far above a recorder's largest chunk, 16 MiB
MESSAGE_FIELD_BYTES = 22  # of the content of a message record before the data


class OpenChunk(NamedTuple):
    """The content of a write-ahead log.

    Attributes:
        chunks_before: Number of the chunks of the file before the open chunk.
        records: Records of the open chunk; the last one may be incomplete.
    """

    chunks_before: int
    records: bytes


def find_log(file: Path) -> Path:
    """Return the path of the write-ahead log of a file."""
    return file.with_name(file.name + SUFFIX)


def read_log(file: Path) -> OpenChunk | None:
    """Read the write-ahead log of a file; return None where there is none or it is empty."""
    try:
        with find_log(file).open('rb') as stream:
            content = stream.read(MAX_LOG_BYTES)
    except OSError:
        return None
    if len(content) <= CHUNK_COUNT.size:
        return None
    (chunks_before,) = CHUNK_COUNT.unpack_from(content)
    return OpenChunk(chunks_before, content[CHUNK_COUNT.size :])


def write_all(file: FileIO, data: bytes) -> None:
    """Write data to an unbuffered file, of which a disk that is nearly full takes only a part at first."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


class WriteAheadLog:
    """The write-ahead log of a file that is being written.

    Args:
        file: Path of the file.

    Raises:
        OSError: The log exists or cannot be written. Every other method may raise it as well.
    """

    def __init__(self, file: Path) -> None:
        self._path = find_log(file)
        self._stream = self._path.open('xb', buffering=0)
        self._chunks_before = 0
        self._written: list[bytes] = []  # records in the log
        self._waiting: list[bytes] = []  # records that are not in the log yet

    @property
    def open_chunk(self) -> OpenChunk:
        """All records of the open chunk, those that are not in the log yet included."""
        return OpenChunk(self._chunks_before, b''.join((*self._written, *self._waiting)))

    def add_description(self, record: Schema | Channel) -> None:
        """Add the description of a message type or of a topic."""
        builder = RecordBuilder()
        record.write(builder)
        self._waiting.append(bytes(builder.end()))  # type: ignore[no-untyped-call]

    def add_message(self, channel_id: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Add a message."""
        length = MESSAGE_FIELD_BYTES + len(data)
        header = MESSAGE_HEADER.pack(Opcode.MESSAGE, length, channel_id, 0, log_time_ns, publish_time_ns)
        self._waiting += (header, data)

    def write(self) -> None:
        """Hand the added records to the operating system."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        start = [] if self._written else [CHUNK_COUNT.pack(self._chunks_before)]
        self._written += waiting
        write_all(self._stream, b''.join((*start, *waiting)))

    def start_chunk(self, chunks_before: int) -> None:
        """Empty the log, because all its messages are in the file.

        Args:
            chunks_before: Number of the chunks that the file holds now.
        """
        self._chunks_before = chunks_before
        has_content, self._written, self._waiting = bool(self._written), [], []
        if has_content:
            self._stream.seek(0)
            self._stream.truncate()

    def close(self, *, remove: bool) -> None:
        """Close the log, and remove it if the file needs it no longer."""
        with suppress(OSError):
            self._stream.close()
        if remove:
            self._path.unlink(missing_ok=True)
