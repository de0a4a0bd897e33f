# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scan of MCAP files that were cut off or damaged: everything that can still be read, their log included.

Records are parsed by the classes of the `mcap` package. The readers of that package stop at the first fault; this
scan reports the fault and continues behind it.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    Message,
    Metadata,
    Schema,
    Statistics,
)

from mocap_ros.bags.file_bytes import FileBytes
from mocap_ros.bags.mcap_layout import (
    CHUNK_HEADER,
    CHUNK_PATTERN,
    CRC_BYTES,
    DATA_END_BYTES,
    DATA_END_PREFIX,
    FOOTER,
    MAGIC,
    MAX_CHUNK_BYTES,
    MAX_CHUNK_PATTERN_BYTES,
    MAX_COMPRESSION_NAME_BYTES,
    MESSAGE_INDEX_ENTRY_BYTES,
    MESSAGE_INDEX_HEADER_BYTES,
    MIN_CHUNK_BYTES,
    PARSE_ERRORS,
    RECORD_PREFIX,
    RecordLocation,
    compute_chunk_length,
    decompress_records,
    iterate_records,
    open_content,
)
from mocap_ros.bags.write_ahead_log import OpenChunk, read_log

MAX_OVERLAPS = 100  # records of wrong length in which a chunk is searched for; bounds the time for a crafted file


class ScannedMessage(NamedTuple):
    """A message with its channel and schema; the schema is None where it is missing."""

    schema: Schema | None
    channel: Channel
    message: Message


class McapScan:
    """An iterable of everything that can be read of an MCAP file, in the order of the file.

    Args:
        path: Path of the file.

    Attributes:
        losses: Sentences about what could not be read, as far as the scan has advanced.
        scanned_bytes: Bytes scanned so far.
        size: Size of the file in bytes.

    Raises:
        OSError: The file cannot be opened. To iterate raises it where the disk is gone altogether.
    """

    def __init__(self, path: Path) -> None:
        self.losses: list[str] = []
        self.scanned_bytes = 0
        self._reached_data_end = False
        self._chunk_count = 0
        self._search_start = 0  # byte from which on a chunk is searched for where the next record is damaged
        self._overlap_count = 0  # records of wrong length that contained the start of a chunk
        self._log: OpenChunk | None = read_log(path)
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._messages_without_channel: Counter[int] = Counter()  # by channel id
        with path.open('rb') as file:
            self._data = FileBytes(file.fileno(), keep_going=True)
        self.size = len(self._data)

    @property
    def is_mcap(self) -> bool:
        """Whether the file starts or ends as an MCAP file does, or has a log or a complete chunk."""
        has_mark = self._has_intact_start or self.is_finished or self._log is not None
        return has_mark or self._find_next_chunk(0) is not None

    @property
    def _has_intact_start(self) -> bool:
        """Whether the file starts as an MCAP file does."""
        return self._data[: len(MAGIC)] == MAGIC

    @property
    def is_finished(self) -> bool:
        """Whether the file ends as an MCAP file does."""
        return self.size > 2 * len(MAGIC) and self._data[-len(MAGIC) :] == MAGIC

    def __iter__(self) -> Iterator[ScannedMessage | Attachment | Metadata]:
        if not self._has_intact_start:
            self.losses.append(f'its first {len(MAGIC)} bytes are not those of an MCAP file')
        expected = self._read_summary()
        message_count = 0
        for item in self._scan_data():
            message_count += isinstance(item, ScannedMessage)
            yield item
        for item in self._read_log():
            message_count += 1
            yield item
        for channel, lost in self._messages_without_channel.items():
            self.losses.append(
                f'{lost} messages are lost, because the description of their channel {channel} is lost'
            )
        for start, end, error in self._data.unreadable:
            self.losses.append(f'{end - start} bytes from byte {start} on cannot be read: {error}')
        if expected is not None and message_count < expected:
            self.losses.append(f'{expected - message_count} of {expected} messages are missing')

    def _scan_data(self) -> Iterator[ScannedMessage | Attachment | Metadata]:
        """Yield the items of the data section; continue behind damage at the next complete chunk."""
        resume_at: int | None = len(MAGIC)
        while resume_at is not None:
            self.scanned_bytes = resume_at
            yield from self._read_intact_records()
            if self._reached_data_end:
                return
            saved = list(self._read_cut_chunk(self.scanned_bytes))
            yield from saved
            resume_at = self._find_next_chunk(self._search_start)
            gap_start, gap_end = self.scanned_bytes, self.size if resume_at is None else resume_at
            if gap_end < gap_start:
                self._overlap_count += 1
                gap_start = max(self._search_start - 1, 0)
            self._report_gap(gap_start, gap_end, len(saved), is_last=resume_at is None)

    def _read_intact_records(self) -> Iterator[ScannedMessage | Attachment | Metadata]:
        """Yield the messages, attachments and metadata from byte `scanned_bytes` on, and advance `scanned_bytes`.

        Stop at the end of the data section, or at the first record that is incomplete or whose length is wrong. A
        record before it whose checksum does not match, or that has none, may have a wrong length as well and
        contain the start of a chunk.
        """
        for record in iterate_records(self._data, self.scanned_bytes):
            content = self._data[record.content_start : record.end]
            if not self._data.is_readable(record.start, record.end):
                self._search_start = record.start + 1
                return
            self._reached_data_end = record.opcode == Opcode.DATA_END
            if self._reached_data_end or (
                record.opcode == Opcode.CHUNK and compute_chunk_length(content) != len(content)
            ):
                return
            is_length_certain = self._overlap_count >= MAX_OVERLAPS
            if record.opcode == Opcode.CHUNK:
                self._chunk_count += 1
                is_length_certain |= yield from self._read_chunk(content, record.start)
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                is_length_certain |= yield from self._read_attachment_or_metadata(record, content)
            elif record.opcode != Opcode.MESSAGE or not self._chunk_count:
                yield from self._read_message(record.opcode, content)
            self.scanned_bytes = record.end
            self._search_start = record.end if is_length_certain else record.start + 1

    def _read_log(self) -> Iterator[ScannedMessage]:
        """Yield the messages of the open chunk of a file that was not finished, unless the file holds them."""
        if self._reached_data_end or self._log is None or not self._is_log_needed:
            return
        records, end = self._log.records, 0
        for record in iterate_records(records, 0):
            yield from self._read_message(record.opcode, records[record.content_start : record.end])
            end = record.end
        if end < len(records):
            self.losses.append(
                f'the last {len(records) - end} bytes of its write-ahead log are no complete record'
            )
        if missing := self._log.chunks_before - self._chunk_count:
            self.losses.append(
                f'chunks before its write-ahead log that the file does not hold completely: {missing}'
            )

    @property
    def _is_log_needed(self) -> bool:
        """Whether the file lacks the chunk whose messages the log holds."""
        return self._log is not None and self._chunk_count <= self._log.chunks_before

    @property
    def _has_log_of_end(self) -> bool:
        """Whether the log holds what comes next in the file, whose earlier chunks are all there."""
        return self._log is not None and self._chunk_count == self._log.chunks_before

    def _report_gap(self, start: int, end: int, saved_count: int, *, is_last: bool) -> None:
        """Add a loss for the bytes from `start` to `end`, which are no complete record."""
        if start == end or (is_last and self._has_log_of_end and not self.is_finished):
            if is_last:
                told = 'every message that was written to it was recovered'
                if self._log is None:
                    told = 'messages of its last chunk may be missing without its write-ahead log (-wal)'
                self.losses.append(f'the file was not closed; {told}')
            return
        fault = 'cut off' if is_last and not self.is_finished else 'damaged'
        saved = f'; {saved_count} complete messages in them were saved' if saved_count else ''
        self.losses.append(
            f'the file is {fault} at byte {start}: {end - start} bytes are no complete record{saved}'
        )

    def _read_summary(self) -> int | None:
        """Read schemas and channels from the summary section; return the number of messages that it states."""
        footer = self.size - len(MAGIC) - FOOTER.size - RECORD_PREFIX.size
        if not self.is_finished or footer < 0 or self._data[footer : footer + 1] != bytes([Opcode.FOOTER]):
            return None
        start = self._find_summary(footer)
        if start is None:
            return None
        expected = None
        for record in iterate_records(self._data, start, footer):
            content = self._data[record.content_start : record.end]
            if record.opcode == Opcode.STATISTICS:
                with suppress(*PARSE_ERRORS):
                    expected = Statistics.read(open_content(content)).message_count
            else:
                list(self._read_message(record.opcode, content))
        return expected

    def _find_summary(self, footer: int) -> int | None:
        """Return the start of the summary section before the footer; None where there is none or it is damaged.

        It is where the footer states, unless bytes before it were removed or added; it always follows DataEnd.
        """
        stated, _, crc = FOOTER.unpack(self._data[footer + RECORD_PREFIX.size : self.size - len(MAGIC)])
        if not stated or self._is_summary(stated, footer, crc):
            return stated or None
        found = self._data.find_last(DATA_END_PREFIX, footer) + DATA_END_BYTES
        if found >= DATA_END_BYTES and self._is_summary(found, footer, crc):
            return found
        self.losses.append('the summary at the end of the file is damaged and was not used')
        return None

    def _is_summary(self, start: int, footer: int, crc: int) -> bool:
        """Return whether the records of the summary reach from `start` to the footer, by their checksum if any."""
        if crc:
            return zlib.crc32(self._data[start : self.size - len(MAGIC) - CRC_BYTES]) == crc
        end = 0
        for record in iterate_records(self._data, start, footer):
            end = record.end
        return end == footer

    def _read_message(self, opcode: int, content: bytes) -> Iterator[ScannedMessage]:
        """Yield the message of a message record; remember a schema or channel; ignore all other records."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(open_content(content))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(open_content(content))
                self._channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                message = Message.read(open_content(content), len(content))
                described = self._channels.get(message.channel_id)
                if described is None:
                    self._messages_without_channel[message.channel_id] += 1
                else:
                    yield ScannedMessage(self._schemas.get(described.schema_id), described, message)
        except PARSE_ERRORS:
            self.losses.append(f'a {Opcode(opcode).name.lower()} record is invalid')

    def _read_chunk(self, content: bytes, start: int) -> Generator[ScannedMessage, None, bool]:
        """Yield the messages of a chunk whose checksum matches; return whether it does."""
        where = f'chunk at byte {start}'
        try:
            chunk = Chunk.read(open_content(content))
        except PARSE_ERRORS:
            lost = self._describe_indexed_messages(start, content)
            self.losses.append(f'{where} ({lost}): its header is damaged')
            return False
        if chunk.uncompressed_size > MAX_CHUNK_BYTES:
            lost = self._describe_indexed_messages(start, content)
            limit = f'the limit of {MAX_CHUNK_BYTES >> 20} MiB'
            self.losses.append(f'{where} ({lost}): it holds {chunk.uncompressed_size} bytes, more than {limit}')
            return False
        payload = decompress_records(chunk.data, chunk.compression, chunk.uncompressed_size)
        crc = chunk.uncompressed_crc
        if payload is None or len(payload) != chunk.uncompressed_size or (crc and zlib.crc32(payload) != crc):
            lost = self._describe_indexed_messages(start, content)
            reason = 'its checksum does not match' if payload else 'it cannot be decompressed'
            self.losses.append(f'{where} ({lost}): {reason}')
            return False
        end = 0
        for record in iterate_records(payload, 0):
            yield from self._read_message(record.opcode, payload[record.content_start : record.end])
            end = record.end
        if end < len(payload):
            self.losses.append(f'{where}: its last {len(payload) - end} bytes are no complete record')
        return True

    def _describe_indexed_messages(self, start: int, content: bytes) -> str:
        """Return in words how many messages the message indexes behind a chunk list."""
        number = 0
        for record in iterate_records(self._data, start + RECORD_PREFIX.size + len(content)):
            if record.opcode != Opcode.MESSAGE_INDEX:
                break
            index_bytes = record.end - record.content_start
            number += (index_bytes - MESSAGE_INDEX_HEADER_BYTES) // MESSAGE_INDEX_ENTRY_BYTES
        return f'{number} messages' if number else 'an unknown number of messages'

    def _read_cut_chunk(self, start: int) -> Iterator[ScannedMessage]:
        """Yield the complete messages of a chunk that the end of the file cuts off."""
        header_end = start + RECORD_PREFIX.size + MIN_CHUNK_BYTES + MAX_COMPRESSION_NAME_BYTES
        if not CHUNK_PATTERN.match(self._data[start:header_end]) or self.is_finished or self._has_log_of_end:
            return
        content = self._data[start + RECORD_PREFIX.size : start + MAX_CHUNK_BYTES]
        *_, size, _, name_length = CHUNK_HEADER.unpack_from(content)
        if not self._data.is_readable(start, start + MAX_CHUNK_BYTES):
            return
        is_cut = MIN_CHUNK_BYTES + name_length <= len(content) < compute_chunk_length(content)
        if not is_cut or size > MAX_CHUNK_BYTES:
            return
        compression = content[CHUNK_HEADER.size : CHUNK_HEADER.size + name_length].decode()
        payload = decompress_records(content[MIN_CHUNK_BYTES + name_length :], compression, size) or b''
        for record in iterate_records(payload, 0):
            yield from self._read_message(record.opcode, payload[record.content_start : record.end])

    def _find_next_chunk(self, start: int) -> int | None:
        """Return the offset of the next complete chunk, or None where there is none."""
        for chunk_start in self._data.find_all(CHUNK_PATTERN, MAX_CHUNK_PATTERN_BYTES, start):
            content_start = chunk_start + RECORD_PREFIX.size
            _, length = RECORD_PREFIX.unpack(self._data[chunk_start:content_start])
            header = self._data[content_start : content_start + MIN_CHUNK_BYTES + MAX_COMPRESSION_NAME_BYTES]
            if content_start + length <= self.size and compute_chunk_length(header) == length:
                return chunk_start
        return None

    def _read_attachment_or_metadata(
        self, record: RecordLocation, content: bytes
    ) -> Generator[Attachment | Metadata, None, bool]:
        """Yield an attachment whose checksum matches, or metadata; return whether a checksum matches."""
        try:
            if record.opcode == Opcode.METADATA:
                yield Metadata.read(open_content(content))
                return False
            if zlib.crc32(content[:-CRC_BYTES]) != int.from_bytes(content[-CRC_BYTES:], 'little'):
                raise ValueError
            yield Attachment.read(open_content(content))
        except PARSE_ERRORS:
            kind = Opcode(record.opcode).name.lower()
            self.losses.append(f'the {kind} record at byte {record.start} is damaged')
            return False
        return True
