# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Decompression of what a bag holds, up to a limit: a thousand bytes may unpack to hundreds of millions."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_UNPACKED_BYTES = 2**27  # of a chunk or a message, which are in memory; the largest messages, of 4K, have 25 MB
UNPACKED_PER_BYTE = 100  # bytes of a file, on the disk, for a packed one; images and keypoints have 2 to 50
PIECE_BYTES = 1 << 17  # that are unpacked at a time
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # first bytes of what zstd has packed; a message as CDR begins with 0

_OPEN: dict[str, Callable[[BinaryIO], Any]] = {
    'zstd': zstd.ZstdFile,
    'lz4': lz4.frame.LZ4FrameFile,
    'bz2': bz2.BZ2File,
}


def unpack(data: bytes, compression: str) -> bytes:
    """Return the content of a chunk or a message, whose compression has the name that bags give it.

    ValueError where it is damaged, cut off or larger than `MAX_UNPACKED_BYTES`.
    """
    if compression in ('', 'none'):
        return data
    if compression not in _OPEN:
        raise ValueError(f'the compression {compression!r} is not known')
    return b''.join(_unpack_stream(BytesIO(data), compression, MAX_UNPACKED_BYTES))


def read_unpacked(file: Path) -> Iterator[bytes]:
    """Yield the content of a file that is compressed with zstd, in pieces.

    ValueError behind what can be read where it is damaged or cut off, or larger than `UNPACKED_PER_BYTE` times the
    file and `MAX_UNPACKED_BYTES`.
    """
    with file.open('rb') as packed:
        limit_bytes = max(MAX_UNPACKED_BYTES, UNPACKED_PER_BYTE * file.stat().st_size)
        yield from _unpack_stream(packed, 'zstd', limit_bytes)


def _unpack_stream(packed: BinaryIO, compression: str, limit_bytes: int) -> Iterator[bytes]:
    unpacked = _OPEN[compression](packed)
    rest_bytes = limit_bytes
    while True:
        try:
            piece = unpacked.read1(PIECE_BYTES)
        except (EOFError, OSError, RuntimeError, zstd.ZstdError) as error:
            raise ValueError(f'compressed data is damaged or cut off: {error}') from None
        if not piece:
            return
        rest_bytes -= len(piece)
        if rest_bytes < 0:
            raise ValueError(f'more than {limit_bytes >> 20} MiB unpacked')
        yield piece
