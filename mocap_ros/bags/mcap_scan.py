# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Everything that can be read of an MCAP file that was cut off or damaged.

Records are parsed by the reader of `mcap` up to the first fault; behind a fault, reading continues at the next
complete chunk. The layout is that of the MCAP specification (https://mcap.dev/spec).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from mocap_ros.bags.unpacking import MAX_UNPACKED_BYTES, unpack

MAGIC = b'\x89MCAP0\r\n'  # first and last 8 bytes of every file
FOOTER_BYTES = 29  # of the record before the last bytes
CRC_BYTES = 4  # of a CRC-32, the last ones of the footer and of an attachment
RECORD_PREFIX = struct.Struct('<BQ')  # opcode; length of the content in bytes
MESSAGE_START = struct.Struct('<BQHIQQ')  # the same, channel, number, log time and publish time in ns
CHUNK_HEADER = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the compression's name
# The start of a chunk: opcode 6, a content length below 2**40, 28 further bytes, the name of the compression. As a
# look-ahead, so that matches may overlap.
CHUNK_PATTERN = re.compile(rb'(?=\x06.{5}\0{3}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))', re.DOTALL)
CHUNK_START_BYTES = RECORD_PREFIX.size + CHUNK_HEADER.size + 4 + 8  # up to the compressed records
IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)  # all other records in a chunk are ignored
FIRST_PRIVATE_OPCODE = 0x80  # opcodes from here on are left to applications
PIECE_BYTES = 1 << 20  # that are searched for a chunk at a time

PARSE_ERRORS = (struct.error, ValueError, EOFError, OverflowError, McapError)  # of damaged data


class ScannedMessage(NamedTuple):
    """A message with its channel and schema; the schema is None where it is missing."""

    schema: Schema | None
    channel: Channel
    message: Message


Item = ScannedMessage | Attachment | Metadata


class McapScan:
    """An iterable of everything that can be read of an MCAP file, in the order of the file."""

    def __init__(self, path: Path) -> None:
        self.losses: list[str] = []  # sentences about what could not be read so far
        self.position = 0  # bytes scanned so far
        self._path = path
        self._size = 0  # bytes
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._lost_count = 0  # messages whose channel is not described
        self._message_count = 0

    def __iter__(self) -> Iterator[Item]:
        with self._path.open('rb') as file:
            self._size = file.seek(0, SEEK_END)
            expected_count = self._read_summary(file)
            yield from self._read_data(file)
        if self._lost_count:
            self.losses.append(
                f'{self._lost_count} messages are lost, because the description of their topic is lost'
            )
        if self._message_count < expected_count:
            lost = expected_count - self._message_count
            self.losses.append(f'{lost} of {expected_count} messages are missing')

    def _read_summary(self, file: BinaryIO) -> int:
        """Read schemas and channels of the summary; return the number of messages that it states, or 0."""
        records: list[McapRecord] = []
        try:
            records.extend(parse_summary(file))  # up to a fault
        except EOFError:
            pass
        except PARSE_ERRORS:
            self.losses.append('the summary at the end of the file is damaged and was not used')
        for record in records:
            if isinstance(record, Schema | Channel):
                list(self._read_record(record))
        return next((r.message_count for r in records if isinstance(r, Statistics)), 0)

    def _read_data(self, file: BinaryIO) -> Iterator[Item]:
        """Yield the items of the data section; behind a fault, go on at the next complete chunk."""
        file.seek(0)
        has_start = file.read(len(MAGIC)) == MAGIC
        start = len(MAGIC) if has_start else _find_chunk(file, 0, self._size)
        if not has_start:
            fault = f'its first {len(MAGIC)} bytes are not those of an MCAP file'
            self.losses.append('the file is no MCAP file' if start is None else fault)
        search_start = 0  # of the next chunk; within a record that no checksum protects, whose length may be wrong
        while start is not None:
            self.position = start
            data = read_record(file, start)
            if not data:
                start = _find_chunk(file, search_start, self._size)
                self._report_gap(self.position, start)
                continue
            search_start = start + 1
            end = start + len(data)
            try:
                record = parse_record(data)
                parts = _unpack(record, data)
            except PARSE_ERRORS as error:
                kind = Opcode(data[0]).name.lower().replace('_', ' ')
                reason = ' '.join(str(error).split()) or 'a length in it is damaged'
                self.losses.append(f'the {kind} record at byte {start} cannot be read: {reason}')
                record = None
                parts = []
            if isinstance(record, DataEnd):
                return
            for part in parts:
                yield from self._read_record(part)
            if isinstance(record, Attachment) or (isinstance(record, Chunk) and record.uncompressed_crc):
                search_start = end
            start = self.position = end

    def _read_record(self, record: McapRecord | None) -> Iterator[Item]:
        """Yield a message, an attachment or metadata; remember a schema or channel; ignore all other records."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        elif isinstance(record, Attachment | Metadata):
            yield record
        elif isinstance(record, Message):
            channel = self._channels.get(record.channel_id)
            if channel is None:
                self._lost_count += 1
            else:
                self._message_count += 1
                yield ScannedMessage(self._schemas.get(channel.schema_id), channel, record)

    def _report_gap(self, start: int, end: int | None) -> None:
        """Add a loss for the bytes from `start` to `end`, or the end of the file, which are no complete record."""
        if start == self._size:
            self.losses.append('the file was not closed; what was recorded last may be missing')
        else:
            fault = 'cut off' if end is None else 'damaged'
            size = max((self._size if end is None else end) - start, 0)
            self.losses.append(f'the file is {fault} at byte {start}: {size} bytes are no complete record')


def read_summary(file: BinaryIO) -> bytes:
    """Return the summary section of an MCAP file with the footer; empty where the file states none.

    EOFError where the file does not end as an MCAP file does, ValueError where the checksum does not match.
    """
    size = file.seek(0, SEEK_END)
    file.seek(-min(FOOTER_BYTES + len(MAGIC), size), SEEK_END)
    end = file.read()
    if not end.endswith(MAGIC) or len(end) < FOOTER_BYTES + len(MAGIC):
        raise EOFError
    footer = next(StreamReader(BytesIO(end), skip_magic=True).records, None)
    if not isinstance(footer, Footer):
        raise ValueError('there is no footer')
    if not footer.summary_start:
        return b''
    file.seek(min(footer.summary_start, size))
    summary = file.read()
    if footer.summary_crc and zlib.crc32(summary[: -len(MAGIC) - CRC_BYTES]) != footer.summary_crc:
        raise ValueError('its checksum does not match')
    return summary


def parse_summary(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of the summary section; raise EOFError as `read_summary` does, and `PARSE_ERRORS`."""
    if summary := read_summary(file):
        yield from StreamReader(BytesIO(summary), skip_magic=True).records


def begins_with(file: Path, start: bytes) -> bool:
    """Return whether a file can be read and has these first bytes."""
    with suppress(OSError), file.open('rb') as stream:
        return stream.read(len(start)) == start
    return False


def read_chunk(file: BinaryIO, start: int, channels: Collection[int]) -> list[tuple[int, int, bytes]]:
    """Return log time in ns, channel and data of the messages of channels in the chunk at `start`.

    `PARSE_ERRORS` where it is damaged or there is none.
    """
    data = read_record(file, start)
    chunk = parse_record(data) if data else None
    if not isinstance(chunk, Chunk):
        raise ValueError(f'there is no whole chunk at byte {start}')
    records = _unpack_chunk(chunk)
    messages = []
    for opcode, begin, end in _split_records(records):
        if opcode == Opcode.MESSAGE:
            _, _, channel, _, time_ns, _ = MESSAGE_START.unpack_from(records, begin)
            if channel in channels:
                messages.append((time_ns, channel, records[begin + MESSAGE_START.size : end]))
    return messages


def read_record(file: BinaryIO, start: int) -> bytes:
    """Return the bytes of the record at `start`; empty where it is incomplete, too large or none."""
    file.seek(start)
    prefix = file.read(RECORD_PREFIX.size)
    if len(prefix) < RECORD_PREFIX.size:
        return b''
    opcode, length = RECORD_PREFIX.unpack(prefix)
    is_known = 0 < opcode <= Opcode.DATA_END or opcode >= FIRST_PRIVATE_OPCODE
    if not is_known or length > MAX_UNPACKED_BYTES:
        return b''
    content = file.read(length)
    return prefix + content if len(content) == length else b''


def parse_record(data: bytes) -> McapRecord | None:
    """Return a record of its bytes, or None for one of an application; `PARSE_ERRORS` where it is damaged."""
    if data[0] >= FIRST_PRIVATE_OPCODE:
        return None
    return next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)


def _unpack(record: McapRecord | None, data: bytes) -> list[McapRecord | None]:
    """Return the records in a chunk, or else the record; `PARSE_ERRORS` where a checksum or length is wrong."""
    if isinstance(record, Chunk):
        records = _unpack_chunk(record)
        return [parse_record(records[i:end]) for opcode, i, end in _split_records(records) if opcode in IN_CHUNKS]
    content = data[RECORD_PREFIX.size :]
    if isinstance(record, Attachment) and zlib.crc32(content[:-CRC_BYTES]) != int.from_bytes(
        content[-CRC_BYTES:], 'little'
    ):
        raise ValueError('its checksum does not match')
    return [record]


def _unpack_chunk(chunk: Chunk) -> bytes:
    records = unpack(chunk.data, chunk.compression)
    if chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
        raise ValueError('its checksum does not match')
    return records


def _split_records(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record; `PARSE_ERRORS` where a length is wrong."""
    start = 0
    while start < len(records):
        opcode, length = RECORD_PREFIX.unpack_from(records, start)
        end = start + RECORD_PREFIX.size + length
        if end > len(records):
            raise ValueError('a length in it is damaged')
        yield opcode, start, end
        start = end


def _find_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    """Return the offset of the next chunk from `start` on whose stated lengths agree; None where there is none."""
    while start < size:
        file.seek(start)
        piece = file.read(PIECE_BYTES + CHUNK_START_BYTES)
        for match in CHUNK_PATTERN.finditer(piece):
            _, length = RECORD_PREFIX.unpack_from(piece, match.start())
            *_, name_bytes = CHUNK_HEADER.unpack_from(piece, match.start() + RECORD_PREFIX.size)
            packed_at = match.start() + RECORD_PREFIX.size + CHUNK_HEADER.size + name_bytes
            packed_bytes = int.from_bytes(piece[packed_at : packed_at + 8], 'little')
            found = start + match.start()
            is_whole = found + RECORD_PREFIX.size + length <= size and length <= MAX_UNPACKED_BYTES
            if is_whole and length == CHUNK_HEADER.size + name_bytes + 8 + packed_bytes:
                return found
        start += PIECE_BYTES
    return None
