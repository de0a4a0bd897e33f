"""MCAP files that were cut off or damaged: what can still be read of them, and an ending for them.

Records are read with the classes of the `mcap` package; its readers give up at the first fault, this one goes on
behind it.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
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

MAGIC = b'\x89MCAP0\r\n'
PREFIX = struct.Struct('<BQ')
CHUNK_START = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the compression's name
CHUNK_FIXED = CHUNK_START.size + 8
CHUNK_PATTERN = re.compile(rb'\x06.{5}\0{3}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)', re.DOTALL)
LARGEST_CHUNK = 2**30
FIXED_LENGTHS = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
BROKEN = (struct.error, ValueError, KeyError, EOFError, RuntimeError, McapError, zstandard.ZstdError)

Data = bytes | mmap.mmap


class Record(NamedTuple):
    """A record of a file: its opcode, and where it, its content and the next one begin."""

    opcode: int
    start: int
    content: int
    end: int


class Content(NamedTuple):
    """A message with its channel and schema."""

    schema: Schema | None
    channel: Channel
    message: Message


def records(data: Data, start: int = len(MAGIC), end: int | None = None) -> Iterator[Record]:
    """Records one after another, up to the first that is cut off or none at all."""
    end = len(data) if end is None else end
    while start + PREFIX.size <= end:
        opcode, length = PREFIX.unpack_from(data, start)
        content = start + PREFIX.size
        if not 0 < opcode <= Opcode.DATA_END and opcode < 0x80:
            return
        if content + length > end or length != FIXED_LENGTHS.get(opcode, length):
            return
        yield Record(opcode, start, content, content + length)
        start = content + length


def stream_of(content: bytes) -> ReadDataStream:
    """For the record classes to read from."""
    return ReadDataStream(BytesIO(content))


class Salvage:
    """All that can be read of an MCAP file, in its order.

    Args:
        path: of the file.

    Attributes:
        losses: what could not be read, as far as the iteration has got.
        done: bytes passed so far, of `size`.

    Raises:
        OSError: the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.losses: list[str] = []
        self.done = 0
        self._ended = self._chunked = False
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._nameless: Counter[int] = Counter()
        self.size = path.stat().st_size
        with path.open('rb') as file:
            self._data: Data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if self.size else b''

    @property
    def is_mcap(self) -> bool:
        """Whether it begins as such a file does."""
        return self._data[: len(MAGIC)] == MAGIC

    @property
    def finished(self) -> bool:
        """Whether it ends as such a file does."""
        return self.size > 2 * len(MAGIC) and self._data[-len(MAGIC) :] == MAGIC

    def __iter__(self) -> Iterator[Content | Attachment | Metadata]:
        expected = self._summary()
        messages = 0
        for one in self._everything():
            messages += isinstance(one, Content)
            yield one
        for number, lost in self._nameless.items():
            self.losses.append(f'{lost} messages of channel {number}, whose description is lost')
        if expected is not None and messages < expected:
            self.losses.append(f'{expected - messages} of {expected} messages are missing')

    def _everything(self) -> Iterator[Content | Attachment | Metadata]:
        behind: int | None = len(MAGIC)
        while behind is not None:
            self.done = behind
            yield from self._intact()
            if self._ended:
                return
            saved = list(self._cut_chunk(self.done))
            yield from saved
            behind = self._next_chunk(self.done + 1)
            self._note_gap(self.done, self.size if behind is None else behind, len(saved), last=behind is None)

    def _intact(self) -> Iterator[Content | Attachment | Metadata]:
        """What is in the records from `done` to the first that is damaged."""
        for record in records(self._data, self.done):
            content = self._data[record.content : record.end]
            self._ended = record.opcode == Opcode.DATA_END
            if self._ended or (record.opcode == Opcode.CHUNK and _chunk_length(content) != len(content)):
                return
            if record.opcode == Opcode.CHUNK:
                self._chunked = True
                yield from self._chunk(content, record.start)
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                yield from self._extra(record.opcode, content, record.start)
            elif record.opcode != Opcode.MESSAGE or not self._chunked:
                yield from self._plain(record.opcode, content)
            self.done = record.end

    def _note_gap(self, start: int, end: int, saved: int, *, last: bool) -> None:
        if start == end:
            if last:
                self.losses.append('not finished: the end is missing, but nothing before it')
            return
        what = 'cut off' if last and not self.finished else 'damaged'
        also = f', of which {saved} messages could be saved' if saved else ''
        self.losses.append(f'{what} at byte {start}: {end - start} bytes are no complete record{also}')

    def _summary(self) -> int | None:
        """Learn schemas and channels from the end of the file; returns the number of messages it tells of."""
        footer = self.size - len(MAGIC) - 20 - PREFIX.size
        if not self.finished or footer < 0 or self._data[footer] != Opcode.FOOTER:
            return None
        start, _, crc = struct.unpack_from('<QQI', self._data, footer + PREFIX.size)
        if not 0 < start < footer:
            return None
        if crc and zlib.crc32(self._data[start : self.size - len(MAGIC) - 4]) != crc:
            self.losses.append('the summary at the end is damaged; it is not used')
            return None
        expected = None
        for record in records(self._data, start, footer):
            content = self._data[record.content : record.end]
            if record.opcode == Opcode.STATISTICS:
                with suppress(*BROKEN):
                    expected = Statistics.read(stream_of(content)).message_count
            else:
                list(self._plain(record.opcode, content))
        return expected

    def _plain(self, opcode: int, content: bytes) -> Iterator[Content]:
        """A schema, a channel or a message; nothing else."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream_of(content))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream_of(content))
                self._channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                message = Message.read(stream_of(content), len(content))
                known = self._channels.get(message.channel_id)
                if known is None:
                    self._nameless[message.channel_id] += 1
                else:
                    yield Content(self._schemas.get(known.schema_id), known, message)
        except BROKEN:
            self.losses.append(f'a {Opcode(opcode).name.lower()} record that is none')

    def _chunk(self, content: bytes, start: int) -> Iterator[Content]:
        try:
            chunk = Chunk.read(stream_of(content))
        except BROKEN:
            self.losses.append(f'chunk at byte {start} ({self._indexed(start, content)}): its header is damaged')
            return
        payload = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
        crc = chunk.uncompressed_crc
        if payload is None or len(payload) != chunk.uncompressed_size or (crc and zlib.crc32(payload) != crc):
            why = 'its checksum does not match' if payload else 'it cannot be decompressed'
            self.losses.append(f'chunk at byte {start} ({self._indexed(start, content)}): {why}')
            return
        end = 0
        for record in records(payload, 0):
            yield from self._plain(record.opcode, payload[record.content : record.end])
            end = record.end
        if end < len(payload):
            self.losses.append(
                f'chunk at byte {start}: its last {len(payload) - end} bytes are no complete record'
            )

    def _indexed(self, start: int, content: bytes) -> str:
        """How many messages the index behind a chunk tells of."""
        number = 0
        for record in records(self._data, start + PREFIX.size + len(content)):
            if record.opcode != Opcode.MESSAGE_INDEX:
                break
            number += (record.end - record.content - 6) // 16
        return f'{number} messages' if number else 'an unknown number of messages'

    def _cut_chunk(self, start: int) -> Iterator[Content]:
        """What is complete in a chunk that is not."""
        head = self._data[start : start + PREFIX.size + CHUNK_FIXED + 4]
        if not CHUNK_PATTERN.match(head) or self.finished:
            return
        content = self._data[start + PREFIX.size : start + LARGEST_CHUNK]
        name = CHUNK_START.unpack_from(content)[4]
        if len(content) < CHUNK_FIXED + name or len(content) >= _chunk_length(content):
            return
        compression = content[CHUNK_START.size : CHUNK_START.size + name].decode()
        size = CHUNK_START.unpack_from(content)[2]
        payload = decompressed(content[CHUNK_FIXED + name :], compression, size) or b''
        for record in records(payload, 0):
            yield from self._plain(record.opcode, payload[record.content : record.end])

    def _next_chunk(self, start: int) -> int | None:
        """Where the next complete chunk begins."""
        while match := CHUNK_PATTERN.search(self._data, start):
            begin = match.start()
            _, length = PREFIX.unpack_from(self._data, begin)
            content = begin + PREFIX.size
            if content + length <= self.size and _chunk_length(self._data[content : content + 64]) == length:
                return begin
            start = begin + 1
        return None

    def _extra(self, opcode: int, content: bytes, start: int) -> Iterator[Attachment | Metadata]:
        try:
            if opcode == Opcode.METADATA:
                yield Metadata.read(stream_of(content))
                return
            if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], 'little'):
                raise ValueError
            yield Attachment.read(stream_of(content))
        except BROKEN:
            self.losses.append(f'the {Opcode(opcode).name.lower()} at byte {start} is damaged')


def _chunk_length(content: bytes) -> int:
    """Length that a chunk's content should have by what it says itself; -1 where that makes no sense."""
    if len(content) < CHUNK_FIXED:
        return -1
    *_, size, _, name = CHUNK_START.unpack_from(content)
    if name > 4 or size > LARGEST_CHUNK or len(content) < CHUNK_FIXED + name:
        return -1
    (compressed,) = struct.unpack_from('<Q', content, CHUNK_START.size + name)
    return int(CHUNK_FIXED + name + compressed)


def decompressed(data: bytes, compression: str, size: int) -> bytes | None:
    """At most `size` bytes, fewer where the data were cut off; None where nothing can be had."""
    try:
        if compression == 'zstd':
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
        if compression == 'lz4':
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    except BROKEN:
        return None
    return data if not compression else None
