"""An ending for an MCAP file whose writer failed, so that every reader takes it."""

from __future__ import annotations

import mmap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

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

from mocap_ros.bags.mcap_scan import MAGIC, Data, Record, decompressed, records, stream_of


class Ending(NamedTuple):
    """What a file holds that was given an ending: messages by channel, log times of the first and the last."""

    counts: Mapping[int, int]
    first_ns: int
    last_ns: int


def finish_in_place(
    path: Path,
    schemas: Iterable[Schema],
    channels: Iterable[Channel],
    metadata: Callable[[Ending], Metadata],
) -> Ending:
    """Drop the record at the end that is not complete and write the missing end of a file.

    Args:
        path: of a file whose writer failed.
        schemas: all that its channels have.
        channels: all that it has.
        metadata: to add, if there is room for it.

    Raises:
        OSError: not even that can be written; the file then ends with its last complete record.
    """
    with path.open('r+b') as file:
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            index = _Index(data)
        s = index.statistics
        ending = Ending(s.channel_message_counts, s.message_start_time, s.message_end_time)
        for extra in ([metadata(ending)], []):
            file.truncate(index.end)
            file.seek(index.end)
            try:
                file.write(index.ending(list(schemas), list(channels), extra) + MAGIC)
                file.flush()
            except OSError:
                if not extra:
                    file.truncate(index.end)
                    raise
            else:
                break
    return ending


class _Index:
    """What complete chunks and attachments a file has, and where the last complete record ends."""

    def __init__(self, data: Data) -> None:
        self.statistics = Statistics(0, 0, Counter(), 0, 0, 0, 0, 0, 0)
        self.end = len(MAGIC)
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        last = None
        for record in records(data):
            content = data[record.content : record.end]
            if record.opcode == Opcode.CHUNK:
                last = Chunk.read(stream_of(content))
                self._add_chunk(last, record)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._add_message_index(MessageIndex.read(stream_of(content)), record.start, record.end)
            elif record.opcode == Opcode.ATTACHMENT:
                self._attachments.append(_attachment_index(Attachment.read(stream_of(content)), record))
            elif record.opcode != Opcode.HEADER:
                break
            self.end = record.end
        rebuilt = RecordBuilder()
        if last is not None:
            known = set(self._chunks[-1].message_index_offsets)
            for index in _message_indexes(last):
                if index.channel_id not in known:
                    begin = self.end + rebuilt.count
                    index.write(rebuilt)
                    self._add_message_index(index, begin, self.end + rebuilt.count)
        self._behind_chunks = bytes(rebuilt.end())  # type: ignore[no-untyped-call]

    def ending(self, schemas: list[Schema], channels: list[Channel], metadata: Iterable[Metadata]) -> bytes:
        """What to write behind the last complete record, up to the footer."""
        data = RecordBuilder()
        start = self.end + len(self._behind_chunks)
        metadata_indexes = []
        for one in metadata:
            begin = data.count
            one.write(data)
            metadata_indexes.append(MetadataIndex(start + begin, data.count - begin, one.name))
        DataEnd(0).write(data)
        summary_start = start + data.count
        s = self.statistics
        s.message_count = sum(s.channel_message_counts.values())
        s.schema_count, s.channel_count = len(schemas), len(channels)
        s.chunk_count, s.attachment_count = len(self._chunks), len(self._attachments)
        s.metadata_count = len(metadata_indexes)
        for record in (*schemas, *channels, s, *self._chunks, *self._attachments, *metadata_indexes):
            record.write(data)
        Footer(summary_start, 0, 0).write(data)
        return self._behind_chunks + bytes(data.end())  # type: ignore[no-untyped-call]

    def _add_chunk(self, chunk: Chunk, record: Record) -> None:
        s = self.statistics
        first = s.message_start_time if self._chunks else chunk.message_start_time
        s.message_start_time = min(first, chunk.message_start_time)
        s.message_end_time = max(s.message_end_time, chunk.message_end_time)
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


def _message_indexes(chunk: Chunk) -> Iterable[MessageIndex]:
    """What should stand behind a chunk."""
    payload = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size) or b''
    found: dict[int, MessageIndex] = {}
    for record in records(payload, 0):
        if record.opcode == Opcode.MESSAGE:
            message = Message.read(stream_of(payload[record.content : record.end]), record.end - record.content)
            index = found.setdefault(message.channel_id, MessageIndex(message.channel_id, []))
            index.records.append((message.log_time, record.start))
    return found.values()


def _attachment_index(attachment: Attachment, record: Record) -> AttachmentIndex:
    return AttachmentIndex(
        offset=record.start,
        length=record.end - record.start,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
