# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scan of the messages of damaged SQLite3 bags: every row that can still be read."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mocap_ros.bags.write_ahead_log import find_log

MAX_ROWS_PER_QUERY = 1000  # bounds memory; a range with an unreadable row is halved down to that row, ten times
MAX_EMPTY_RANGES = 100  # in a row; ends the scan where a damaged file claims row numbers far beyond its last row
MIN_ROW_BYTES = 8  # below any row of a message (SQLite needs 9 for its headers alone); bounds the rows of a file

# What SQLite and its Python module raise for damaged files. A damaged length may look like a lack of memory.
SQLITE_ERRORS = (sqlite3.Error, ValueError, TypeError, MemoryError)


def has_log(file: Path) -> bool:
    """Return whether a database has a write-ahead log that is not empty."""
    log = find_log(file)
    return log.is_file() and log.stat().st_size > 0


def open_database(file: Path) -> sqlite3.Connection:
    """Open a database that is read only, with its write-ahead log where it has one.

    SQLite writes an index of the log beside the database (-shm). Nothing is written where there is no log.

    Raises:
        sqlite3.Error: The file cannot be opened.
    """
    options = 'mode=ro' if has_log(file) else 'mode=ro&immutable=1'
    return sqlite3.connect(f'{file.resolve().as_uri()}?{options}', uri=True)


class MessageRows:
    """An iterable of the rows (number, topic id, log time in ns, data) of the messages of a database, by number.

    Rows that cannot be read are left out. Damaged parts may look empty or be missing, so neither the greatest row
    number nor the number of rows can be trusted.

    Args:
        database: Database to scan.
        size: Size of the database in bytes.

    Attributes:
        last: Greatest row number that may exist.
        unreadable_count: Number of unreadable rows that were found so far.
        has_count: Whether the database states in any way how many rows it should have.
    """

    def __init__(self, database: sqlite3.Connection, size: int) -> None:
        self._database = database
        self._max_rows = size // MIN_ROW_BYTES
        self._read_count = 0
        self.unreadable_count = 0
        self._stated_count = self._query_number('SELECT count(*) FROM messages')
        greatest = self._query_number('SELECT max(id) FROM messages')
        self.has_count = max(self._stated_count, greatest) > 0
        self.last = max(self._stated_count, greatest) if self.has_count else self._max_rows

    @property
    def lost_count(self) -> int:
        """Estimated number of messages that cannot be read; valid at the end of the scan."""
        return max(self.unreadable_count, self._stated_count - self._read_count)

    def _query_number(self, query: str) -> int:
        """Return the result of a query; 0 where the query fails or has no result."""
        try:
            (number,) = self._database.execute(query).fetchone()
        except SQLITE_ERRORS:
            return 0
        return int(number or 0)

    def __iter__(self) -> Iterator[tuple[int, Any, Any, Any]]:
        start = number = empty_ranges = 0
        while start <= self.last and empty_ranges < MAX_EMPTY_RANGES and self._read_count < self._max_rows:
            end = min(start + MAX_ROWS_PER_QUERY, self.last + 1)
            empty_ranges += 1
            for row in self._read_range(start, end):
                if row[0] > number:  # a damaged tree may contain a cycle
                    number = row[0]
                    empty_ranges = 0
                    self._read_count += 1
                    yield row
            start = self._find_next_number(end)

    def _find_next_number(self, start: int) -> int:
        """Return the first row number from `start` on; `start` itself where the query fails."""
        try:
            (number,) = self._database.execute('SELECT min(id) FROM messages WHERE id >= ?', (start,)).fetchone()
        except SQLITE_ERRORS:
            return start
        return self.last + 1 if number is None else int(number)

    def _read_range(self, start: int, end: int) -> Iterator[tuple[int, Any, Any, Any]]:
        """Yield the readable rows from `start` to before `end`; halve the range where it cannot be read."""
        query = 'SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? AND id < ? ORDER BY id'
        try:
            rows = self._database.execute(query, (start, end)).fetchall()
        except SQLITE_ERRORS:
            if end - start == 1:
                self.unreadable_count += 1
                return
            middle = (start + end) // 2
            yield from self._read_range(start, middle)
            yield from self._read_range(middle, end)
        else:
            yield from rows
