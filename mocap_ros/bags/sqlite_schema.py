# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Check that the tables of an SQLite3 bag are tables of data: a query of anything else runs what a stranger wrote.

A view or a generated column is a program, which may never end; reading a virtual table runs an extension.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from mocap_ros.bags.sqlite_scan import SQLITE_ERRORS

TABLES = ('schema', 'metadata', 'topics', 'messages', 'message_definitions')  # the tables of a bag


def find_unusual_tables(file: Path) -> str:
    """Return what `describe_unusual_tables` returns for a file; an empty string where it cannot be opened."""
    try:
        uri = f'{file.resolve().as_uri()}?mode=ro&immutable=1'
        with closing(sqlite3.connect(uri, uri=True)) as database:
            return describe_unusual_tables(database)
    except SQLITE_ERRORS:  # the reader reports it
        return ''


def describe_unusual_tables(database: sqlite3.Connection) -> str:
    """Describe the first table of a bag that is no table of data; return an empty string where all are.

    Args:
        database: the database, of which nothing but the schema is read; texts that are not UTF-8 are read too.

    Raises:
        Exception: the database is damaged; one of `SQLITE_ERRORS`.
    """
    database.text_factory = lambda text: text.decode(errors='replace')
    query = 'SELECT name, type, sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?, ?, ?)'
    for name, kind, sql in database.execute(query, TABLES):
        is_virtual = str(sql or '').lower().split()[:2] == ['create', 'virtual']
        if kind != 'table' or is_virtual:
            return f'{name!r} is no table of data'
        # the last column of a row is 0 for a column of data, and greater for hidden and generated ones
        if any(row[-1] for row in database.execute(f'PRAGMA table_xinfo({str(name).lower()})')):
            return f'{name!r} has generated columns'
    return ''
