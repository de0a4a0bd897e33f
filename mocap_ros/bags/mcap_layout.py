# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The byte layout of MCAP files, as far as damaged files are read without the `mcap` package's readers.

The layout is that of the MCAP specification (https://mcap.dev/spec, sections "Format Description" and "Records").
All integers are little-endian; a string is preceded by its length in bytes as uint32.

    file     magic, Header, data section, DataEnd, summary section, Footer, magic
    record   opcode uint8, content length in bytes uint64, content
    Chunk    message_start_time uint64 ns, message_end_time uint64 ns, uncompressed_size uint64 bytes,
             uncompressed_crc uint32, compression string, length of the compressed records in bytes uint64,
             compressed records
    Footer   summary_start uint64, summary_offset_start uint64, summary_crc uint32
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from mocap_ros.bags.file_bytes import FileBytes

MAGIC = b'\x89MCAP0\r\n'  # first and last 8 bytes of every file
RECORD_PREFIX = struct.Struct('<BQ')  # opcode; length of the content in bytes
CHUNK_HEADER = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the compression's name
LENGTH_BYTES = 8  # of the uint64 that precedes the compressed records of a chunk
MIN_CHUNK_BYTES = CHUNK_HEADER.size + LENGTH_BYTES  # content of a chunk without records and name of compression
MAX_COMPRESSION_NAME_BYTES = 4  # "zstd"; the specification also knows "lz4" and the empty name
MAX_CHUNK_BYTES = 2**27  # guards the memory, also against bombs; the largest messages, images of 4K, have 25 MB
FOOTER = struct.Struct('<QQI')  # start of the summary, start of the summary offsets, checksum of the summary
CRC_BYTES = 4  # of a CRC-32
FIXED_RECORD_BYTES = {Opcode.DATA_END: CRC_BYTES, Opcode.FOOTER: FOOTER.size}  # content; another length is damage
DATA_END_PREFIX = RECORD_PREFIX.pack(Opcode.DATA_END, CRC_BYTES)  # of the record before the summary section
DATA_END_BYTES = RECORD_PREFIX.size + CRC_BYTES  # of that record
FIRST_PRIVATE_OPCODE = 0x80  # opcodes from here on are left to applications
MESSAGE_INDEX_HEADER_BYTES = 6  # channel id uint16, length of the entries uint32
MESSAGE_INDEX_ENTRY_BYTES = 16  # log time uint64, offset uint64

# The start of a chunk: opcode 6, a content length below 2**40, 28 further bytes, the name of the compression.
MAX_CHUNK_PATTERN_BYTES = 45  # with the name `zstd`
CHUNK_PATTERN = re.compile(rb'\x06.{5}\0{3}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)', re.DOTALL)

# What the record classes of `mcap` and the decompressors raise for damaged data.
PARSE_ERRORS = (struct.error, ValueError, KeyError, EOFError, RuntimeError, McapError, zstandard.ZstdError)

# A file, or the content of one of its records.
Data = bytes | FileBytes


class RecordLocation(NamedTuple):
    """The opcode of a record and its position in a file or chunk.

    Attributes:
        opcode: Opcode of the record.
        start: Offset of the record, in bytes.
        content_start: Offset of the content, in bytes.
        end: Offset of the next record, in bytes.
    """

    opcode: int
    start: int
    content_start: int
    end: int


def iterate_records(data: Data, start: int = len(MAGIC), end: int | None = None) -> Iterator[RecordLocation]:
    """Locate consecutive records up to the first one that is incomplete or invalid."""
    end = len(data) if end is None else end
    while start + RECORD_PREFIX.size <= end:
        content_start = start + RECORD_PREFIX.size
        opcode, length = RECORD_PREFIX.unpack(data[start:content_start])
        if not 0 < opcode <= Opcode.DATA_END and opcode < FIRST_PRIVATE_OPCODE:
            return
        if content_start + length > end or length != FIXED_RECORD_BYTES.get(opcode, length):
            return
        yield RecordLocation(opcode, start, content_start, content_start + length)
        start = content_start + length


def open_content(content: bytes) -> ReadDataStream:
    """Return a stream from which the record classes of the `mcap` package read the content of a record."""
    return ReadDataStream(BytesIO(content))


def compute_chunk_length(content: bytes) -> int:
    """Return the length in bytes that the header of a chunk implies for its content; -1 for an invalid header.

    Args:
        content: Content of the chunk, of which only the header is used.
    """
    if len(content) < MIN_CHUNK_BYTES:
        return -1
    *_, name_length = CHUNK_HEADER.unpack_from(content)
    if name_length > MAX_COMPRESSION_NAME_BYTES or len(content) < MIN_CHUNK_BYTES + name_length:
        return -1
    (compressed,) = struct.unpack_from('<Q', content, CHUNK_HEADER.size + name_length)
    return int(MIN_CHUNK_BYTES + name_length + compressed)


def decompress_records(data: bytes, compression: str, size: int) -> bytes | None:
    """Decompress the records of a chunk.

    Args:
        data: Compressed records, possibly cut off.
        compression: `zstd`, `lz4` or empty.
        size: Number of bytes before compression.

    Returns:
        At most `size` bytes, fewer where the data were cut off; None where nothing can be decompressed.
    """
    try:
        if compression == 'zstd':
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
        if compression == 'lz4':
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    except PARSE_ERRORS:
        return None
    return data if not compression else None
