# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Repair of an MCAP file whose writer failed: the missing end is written, so that every reader accepts the file.

The end consists of the open chunk, the message indexes of the last chunk, a metadata record, DataEnd, the summary
section, Footer and the magic bytes (MCAP specification, https://mcap.dev/spec). The summary is rebuilt from the
complete records.
"""

from __future__ import annotations

import errno
import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from mocap_ros.bags.file_bytes import FileBytes
from mocap_ros.bags.mcap_layout import (
    MAGIC,
    Data,
    RecordLocation,
    decompress_records,
    iterate_records,
    open_content,
)
from mocap_ros.bags.write_ahead_log import OpenChunk, write_all


class ChannelStatistics(NamedTuple):
    """Number and times of the messages that a repaired file holds.

    Attributes:
        counts: Number of messages by channel id.
        first_ns: Log time of the first message, in ns; -1 where there is no message.
        last_ns: Log time of the last message, in ns; -1 where there is no message.
    """

    counts: Mapping[int, int]
    first_ns: int
    last_ns: int


def write_missing_end(
    path: Path,
    schemas: Iterable[Schema],
    channels: Iterable[Channel],
    make_metadata: Callable[[ChannelStatistics], Metadata],
    open_chunk: OpenChunk | None = None,
) -> ChannelStatistics:
    """Remove the incomplete record at the end of a file and write the missing end of the file.

    Args:
        path: Path of a file whose writer failed.
        schemas: All schemas of the file.
        channels: All channels of the file.
        make_metadata: Makes the metadata record to add; the record is omitted if the disk has no space for it.
        open_chunk: Messages to add, unless they are in the file already.

    Returns:
        Number and times of the messages in the file.

    Raises:
        OSError: The disk has no space for the end, or not even the start of the file was written; the file then
            ends with its last complete record.
    """
    with path.open('r+b', buffering=0) as file:
        index = _read_index(file)
        if open_chunk is not None and index.chunk_count <= open_chunk.chunks_before:
            _append_chunk(file, index.data_end, open_chunk.records)
            index = _read_index(file)
        totals = index.statistics
        counts = totals.channel_message_counts
        times_ns = (totals.message_start_time, totals.message_end_time) if any(counts.values()) else (-1, -1)
        statistics = ChannelStatistics(counts, *times_ns)
        for metadata in ([make_metadata(statistics)], []):
            file.truncate(index.data_end)
            file.seek(index.data_end)
            try:
                write_all(file, index.encode_end(list(schemas), list(channels), metadata) + MAGIC)
            except OSError:
                if not metadata:
                    file.truncate(index.data_end)
                    raise
            else:
                break
    return statistics


def _read_index(file: FileIO) -> _RebuiltIndex:
    """Return the index of what a file holds; raise OSError where it cannot be read or starts as no MCAP file."""
    if os.fstat(file.fileno()).st_size > len(MAGIC):
        index = _RebuiltIndex(FileBytes(file.fileno()))
        if index.data_end > len(MAGIC):
            return index
    raise OSError(errno.EIO, 'not even the start of the file was written')


def _append_chunk(file: FileIO, start: int, records: bytes) -> None:
    """Write a chunk at `start`, the end of the last complete record; if that fails, the file ends there."""
    times_ns, end = [], 0
    for record in iterate_records(records, 0):
        content = records[record.content_start : record.end]
        if record.opcode == Opcode.MESSAGE:
            times_ns.append(Message.read(open_content(content), len(content)).log_time)
        end = record.end
    if not times_ns:
        return
    complete, builder = records[:end], RecordBuilder()
    compressed = zstandard.compress(complete)
    Chunk('zstd', compressed, max(times_ns), min(times_ns), zlib.crc32(complete), len(complete)).write(builder)
    file.truncate(start)
    file.seek(start)
    try:
        write_all(file, builder.end())  # type: ignore[no-untyped-call]
    except OSError:
        file.truncate(start)
        raise


class _RebuiltIndex:
    """The index of the complete chunks and attachments of a file.

    Attributes:
        statistics: Number and times of the messages.
        data_end: Offset at which the last complete record ends, in bytes.
    """

    def __init__(self, data: Data) -> None:
        self.statistics = Statistics(0, 0, Counter(), 0, 0, 0, 0, 0, 0)
        self.data_end = len(MAGIC)
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        last_chunk = None
        for record in iterate_records(data):
            content = data[record.content_start : record.end]
            if record.opcode == Opcode.CHUNK:
                last_chunk = Chunk.read(open_content(content))
                self._add_chunk(last_chunk, record)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._add_message_index(MessageIndex.read(open_content(content)), record.start, record.end)
            elif record.opcode == Opcode.ATTACHMENT:
                self._attachments.append(_index_attachment(Attachment.read(open_content(content)), record))
            elif record.opcode != Opcode.HEADER:
                break
            self.data_end = record.end
        rebuilt = RecordBuilder()
        if last_chunk is not None:
            indexed_channels = set(self._chunks[-1].message_index_offsets)
            for index in _rebuild_message_indexes(last_chunk):
                if index.channel_id not in indexed_channels:
                    start = self.data_end + rebuilt.count
                    index.write(rebuilt)
                    self._add_message_index(index, start, self.data_end + rebuilt.count)
        self._missing_message_indexes = bytes(rebuilt.end())  # type: ignore[no-untyped-call]

    @property
    def chunk_count(self) -> int:
        """Number of the complete chunks."""
        return len(self._chunks)

    def encode_end(self, schemas: list[Schema], channels: list[Channel], metadata: Iterable[Metadata]) -> bytes:
        """Return the bytes from the last complete record to the end of the footer."""
        data = RecordBuilder()
        start = self.data_end + len(self._missing_message_indexes)
        metadata_indexes = []
        for record in metadata:
            record_start = data.count
            record.write(data)
            metadata_indexes.append(MetadataIndex(start + record_start, data.count - record_start, record.name))
        DataEnd(0).write(data)
        summary_start = start + data.count
        totals = self.statistics
        totals.message_count = sum(totals.channel_message_counts.values())
        totals.schema_count = len(schemas)
        totals.channel_count = len(channels)
        totals.chunk_count = len(self._chunks)
        totals.attachment_count = len(self._attachments)
        totals.metadata_count = len(metadata_indexes)
        for entry in (*schemas, *channels, totals, *self._chunks, *self._attachments, *metadata_indexes):
            entry.write(data)
        Footer(summary_start, 0, 0).write(data)
        return self._missing_message_indexes + bytes(data.end())  # type: ignore[no-untyped-call]

    def _add_chunk(self, chunk: Chunk, record: RecordLocation) -> None:
        totals = self.statistics
        first_ns = totals.message_start_time if self._chunks else chunk.message_start_time
        totals.message_start_time = min(first_ns, chunk.message_start_time)
        totals.message_end_time = max(totals.message_end_time, chunk.message_end_time)
        self._chunks.append(
            ChunkIndex(
                chunk_length=record.end - record.start,
                chunk_start_offset=record.start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _add_message_index(self, index: MessageIndex, start: int, end: int) -> None:
        self.statistics.channel_message_counts[index.channel_id] += len(index.records)
        self._chunks[-1].message_index_offsets[index.channel_id] = start
        self._chunks[-1].message_index_length += end - start


def _rebuild_message_indexes(chunk: Chunk) -> Iterable[MessageIndex]:
    """Return the message indexes that belong behind a chunk, one for each channel."""
    payload = decompress_records(chunk.data, chunk.compression, chunk.uncompressed_size) or b''
    indexes: dict[int, MessageIndex] = {}
    for record in iterate_records(payload, 0):
        if record.opcode == Opcode.MESSAGE:
            content = payload[record.content_start : record.end]
            message = Message.read(open_content(content), len(content))
            index = indexes.setdefault(message.channel_id, MessageIndex(message.channel_id, []))
            index.records.append((message.log_time, record.start))
    return indexes.values()


def _index_attachment(attachment: Attachment, record: RecordLocation) -> AttachmentIndex:
    return AttachmentIndex(
        offset=record.start,
        length=record.end - record.start,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
