# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The bytes of a file, read where they are needed.

A file that is mapped into the memory (`mmap`) ends the process with a signal (SIGBUS) where the disk fails, or
where another program cuts off the file. Here both are an OSError, or bytes that are noted as unreadable.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from weakref import finalize

PAGE_BYTES = 4096  # bytes that are taken to be unreadable together: a sector of a disk, a page of the memory
FIRST_PIECE_BYTES = 1 << 12  # of a search; it often ends soon, and a crafted file may need many
MAX_PIECE_BYTES = 1 << 20  # of a search; the pieces double up to here, so that few calls are needed
MAX_UNREADABLE_PAGES = 10_000  # 40 MB; with more, the disk is gone, and to try every page of it may take days


class FileBytes:
    """A view of the bytes of a file, which is sliced like `bytes`.

    Args:
        descriptor: Descriptor of the open file, which may be closed afterwards.
        keep_going: Whether unreadable pages are read as zeros and noted, and not raised as OSError.

    Raises:
        OSError: The file cannot be examined. Slices and searches raise it where the disk fails or where the file
            has become shorter; with `keep_going`, only after `MAX_UNREADABLE_PAGES`.
    """

    def __init__(self, descriptor: int, *, keep_going: bool = False) -> None:
        self._descriptor = os.dup(descriptor)
        finalize(self, os.close, self._descriptor)
        self._size = os.fstat(descriptor).st_size
        self._keep_going = keep_going
        self._errors: dict[int, str] = {}  # by the number of the unreadable page

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        start, end, _ = part.indices(self._size)
        return self._read(start, end) if start < end else b''

    def is_readable(self, start: int, end: int) -> bool:
        """Return whether no unreadable page has been found from byte `start` to before byte `end`."""
        if not self._errors:
            return True
        return self._errors.keys().isdisjoint(range(start // PAGE_BYTES, (end - 1) // PAGE_BYTES + 1))

    @property
    def unreadable(self) -> list[tuple[int, int, str]]:
        """Start, end and error of the parts in which no page could be read."""
        parts: list[tuple[int, int, str]] = []
        for page, error in sorted(self._errors.items()):
            start, end = page * PAGE_BYTES, min((page + 1) * PAGE_BYTES, self._size)
            if parts and parts[-1][1:] == (start, error):
                start = parts.pop()[0]
            parts.append((start, end, error))
        return parts

    def find_all(self, pattern: re.Pattern[bytes], max_bytes: int, start: int) -> Iterator[int]:
        """Yield the offset of every match of a pattern from byte `start` on, overlapping ones included.

        Args:
            pattern: Pattern to search for.
            max_bytes: Length of the longest match.
            start: Offset of the first byte.
        """
        size = FIRST_PIECE_BYTES
        while start < self._size:
            piece, position = self[start : start + size + max_bytes - 1], 0
            while (match := pattern.search(piece, position)) and match.start() < size:
                yield start + match.start()
                position = match.start() + 1
            start, size = start + size, min(2 * size, MAX_PIECE_BYTES)

    def find_last(self, sought: bytes, end: int) -> int:
        """Return the offset of the last occurrence of bytes before byte `end`; -1 where there is none."""
        stop = end
        while stop > 0:
            start = max(stop - MAX_PIECE_BYTES, 0)
            found = self[start : min(stop + len(sought) - 1, end)].rfind(sought)
            if found >= 0:
                return start + found
            stop = start
        return -1

    def _read(self, start: int, end: int) -> bytes:
        """Read at least one byte; halve the range where it cannot be read, down to the unreadable pages."""
        first_page, last_page = start // PAGE_BYTES, (end - 1) // PAGE_BYTES
        if first_page == last_page and first_page in self._errors:
            return bytes(end - start)
        try:
            return self._read_whole(start, end)
        except OSError as error:
            if not self._keep_going or len(self._errors) >= MAX_UNREADABLE_PAGES:
                raise
            if first_page == last_page:
                self._errors[first_page] = error.strerror or str(error)
                return bytes(end - start)
        middle = (first_page + last_page + 1) // 2 * PAGE_BYTES
        return self._read(start, middle) + self._read(middle, end)

    def _read_whole(self, start: int, end: int) -> bytes:
        """Read bytes; more than one call is needed above 2 GiB."""
        content = os.pread(self._descriptor, end - start, start)
        while len(content) < end - start:
            piece = os.pread(self._descriptor, end - start - len(content), start + len(content))
            if not piece:
                raise OSError(errno.EIO, 'the file was cut off while it was read')
            content += piece
        return content
