# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files that are read by parts: as bytes in memory, and errors where a disk fails or a file becomes shorter."""

from __future__ import annotations

import errno
import os
import random
import re
from pathlib import Path

import pytest

from mocap_ros.bags.file_bytes import MAX_PIECE_BYTES, PAGE_BYTES, FileBytes

PATTERN = re.compile(rb'aa|abba')  # matches overlap


def open_bytes(path: Path, content: bytes, *, keep_going: bool = False) -> FileBytes:
    path.write_bytes(content)
    with path.open('rb') as file:
        return FileBytes(file.fileno(), keep_going=keep_going)


def break_disk(monkeypatch: pytest.MonkeyPatch, *bad_bytes: int) -> None:
    """Let the system refuse every read that contains one of these bytes of a file."""
    read = os.pread

    def read_or_fail(descriptor: int, size: int, start: int) -> bytes:
        if any(start <= bad < start + size for bad in bad_bytes):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(descriptor, size, start)

    monkeypatch.setattr('os.pread', read_or_fail)


def test_parts_and_places_are_those_of_the_bytes(tmp_path: Path) -> None:
    rng = random.Random(0)
    content = bytearray(2 * MAX_PIECE_BYTES + 999)
    for place in (0, 4093, 4094, 4095, MAX_PIECE_BYTES - 2, MAX_PIECE_BYTES + 999 - 3, len(content) - 4):
        content[place : place + 4] = b'abba'
        content[place + 5 : place + 8] = b'aaa' if place < 4000 else content[place + 5 : place + 8]
    data = open_bytes(tmp_path / 'x', bytes(content))
    assert len(data) == len(content)
    for _ in range(50):
        start, end = rng.randrange(-len(content), len(content)), rng.randrange(len(content) + 10)
        assert data[start:end] == content[start:end]
    assert data[-8:] == content[-8:]
    for start in (0, 6, 4094):
        expected = [i for i in range(start, len(content)) if PATTERN.match(content, i)]
        assert list(data.find_all(PATTERN, 4, start)) == expected
    for end in (len(content), len(content) - 1, MAX_PIECE_BYTES, 3):
        assert data.find_last(b'abba', end) == content.rfind(b'abba', 0, end)


def test_a_failing_disk_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = open_bytes(tmp_path / 'x', bytes(3 * PAGE_BYTES))
    break_disk(monkeypatch, PAGE_BYTES + 5)
    assert data[:PAGE_BYTES] == bytes(PAGE_BYTES)
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        data[:]
    os.truncate(tmp_path / 'x', 10)
    with pytest.raises(OSError, match='the file was cut off while it was read'):
        data[5:11]


def test_unreadable_pages_are_zeros_and_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = random.Random(1).randbytes(10 * PAGE_BYTES + 7)
    data = open_bytes(tmp_path / 'x', content, keep_going=True)
    break_disk(monkeypatch, 2 * PAGE_BYTES, 4 * PAGE_BYTES - 1, len(content) - 1)
    start, end = 2 * PAGE_BYTES, 4 * PAGE_BYTES
    expected = content[:start] + bytes(end - start) + content[end : 10 * PAGE_BYTES] + bytes(7)
    assert data[:] == expected
    reason = os.strerror(errno.EIO)
    assert data.unreadable == [(start, end, reason), (10 * PAGE_BYTES, len(content), reason)]
    assert data.is_readable(0, start)
    assert not data.is_readable(0, start + 1)
    monkeypatch.setattr('mocap_ros.bags.file_bytes.MAX_UNREADABLE_PAGES', 3)
    break_disk(monkeypatch, 0)
    with pytest.raises(OSError, match=reason):
        data[:1]
