# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Compressed bytes are unpacked whole and up to a limit, or refused."""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.reader_limits import unpack
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import make_keypoints


def pack_without_size(data: bytes) -> bytes:
    """Return bytes of Zstandard that do not state how many bytes they unpack to, as a stream writes them."""
    compressor = zstandard.ZstdCompressor().compressobj()
    return compressor.compress(data) + compressor.flush()


PACK: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    'zstd': ('zstd', zstandard.ZstdCompressor().compress),
    'zstd without size': ('zstd', pack_without_size),
    'lz4': ('lz4', lz4.frame.compress),
    'bz2': ('bz2', bz2.compress),
}


@pytest.mark.parametrize('form', PACK)
@given(data=st.binary(min_size=1, max_size=300), share=st.floats(0, 1, exclude_max=True))
def test_bytes_are_unpacked_whole_or_refused(form: str, data: bytes, share: float) -> None:
    compression, pack = PACK[form]
    packed = pack(data)
    assert unpack(packed, compression) == data
    assert unpack(packed, compression, len(data)) == data
    with pytest.raises(ValueError, match=f'unpack to more than {len(data) - 1} bytes'):
        unpack(packed, compression, len(data) - 1)
    with pytest.raises((ValueError, zstandard.ZstdError, OSError, RuntimeError)):
        unpack(packed[: int(share * len(packed))], compression)


def test_a_compressed_message_that_is_cut_off_is_damage(tmp_path: Path) -> None:
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i in range(3):
            writer.write(connection, i, make_keypoints(i))
    with sqlite3.connect(tmp_path / 'bag' / 'bag.db3') as database:
        (packed,) = database.execute('SELECT data FROM messages WHERE id = 2').fetchone()
        database.execute('UPDATE messages SET data = ? WHERE id = 2', (packed[:-20],))
    with Bag(tmp_path / 'bag') as bag, pytest.raises(InputError, match=r'bag: .*\d+ bytes of zstd are cut off'):
        list(bag.messages(['/keypoints']))
