# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readers of bags in the form of those of `rosbags`, which unpack no more than fits in the memory.

They also read what rosbag2 writes and `rosbags` refuses: no name of the storage, and the language `unknown` where
rosbag2 finds no definition of a type. Each method of a storage may raise `READ_ERRORS` where its file is damaged.
"""

from __future__ import annotations

import heapq
import sqlite3
from collections import Counter, deque
from collections.abc import Collection, Generator, Iterator
from functools import lru_cache, partial
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO

from mcap.records import Channel, ChunkIndex, Header, Schema, Statistics
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Chunk, decompressors
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.reader import DirectoryReader

from mocap_ros.bags.mcap_scan import (
    MAGIC,
    PARSE_ERRORS,
    McapScan,
    ScannedMessage,
    begins_with,
    parse_record,
    parse_summary,
    read_chunk,
    read_record,
)
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.bags.unpacking import ZSTD_MAGIC, read_unpacked, unpack
from mocap_ros.errors import MALFORMED, describe_parse_error

READ_ERRORS = (OSError, MemoryError, sqlite3.Error, *PARSE_ERRORS)
MAX_HELD_BYTES = 2**28  # of messages in chunks that overlap in time; two of the largest, dozens of usual ones
MAX_QOS_TEXTS = 256  # different QoS profiles that are remembered: a text takes 2 ms, and most topics have the same
FORMATS = {
    'ros2msg': MessageDefinitionFormat.MSG,
    'ros2idl': MessageDefinitionFormat.IDL,
    'omgidl': MessageDefinitionFormat.IDL,
}
NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, '')

Messages = Generator[tuple[Connection, int, bytes], None, None]


def choose_storage(path: Any) -> McapStorage | SqliteStorage:
    """Return the reader of a file of a bag, by the file: the metadata may name no storage."""
    return SqliteStorage(path) if path.suffix == '.db3' and not begins_with(path, MAGIC) else McapStorage(path)


class McapStorage:
    """An MCAP file of a bag, whose messages come in the order of log times."""

    def __init__(self, path: Any) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.duration = 0  # ns
        self._file: BinaryIO = BytesIO()
        self._chunks: list[ChunkIndex] = []  # none where the file has no complete index
        self._held_bytes = 0  # of messages in memory

    def open(self) -> None:
        """Read the index, or else the whole file."""
        self._file = self.path.open('rb')
        if self._file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f'its first {len(MAGIC)} bytes are not those of an MCAP file')
        first = read_record(self._file, len(MAGIC))
        header = parse_record(first) if first else None
        if not isinstance(header, Header) or header.profile != 'ros2':
            raise ValueError('it is no recording of ROS 2')
        records = [*parse_summary(self._file)]
        schemas = {r.id: r for r in records if isinstance(r, Schema)}
        channels = {r.id: (r, schemas.get(r.schema_id)) for r in records if isinstance(r, Channel)}
        chunks = [r for r in records if isinstance(r, ChunkIndex)]
        found = next((r for r in records if isinstance(r, Statistics)), None)
        if found and found.chunk_count == len(chunks) and channels.keys() >= found.channel_message_counts.keys():
            self._chunks = chunks
            counts = found.channel_message_counts
            times_ns = [found.message_start_time, found.message_end_time] * bool(found.message_count)
        else:
            counts = Counter()
            times_ns = []
            for schema, channel, message in self._scan():
                channels[channel.id] = channel, schema
                counts[channel.id] += 1
                times_ns = [min([*times_ns, message.log_time]), max([*times_ns, message.log_time])]
        self.duration = times_ns[1] - times_ns[0] + 1 if times_ns else 0
        for channel, schema in channels.values():
            qos = _parse_qos(channel.metadata.get('offered_qos_profiles', ''))
            connection = Connection(
                id=channel.id,
                topic=channel.topic,
                msgtype=schema.name if schema else '',
                msgdef=_define(schema.encoding, schema.data.decode()) if schema else NO_DEFINITION,
                digest='',
                msgcount=counts.get(channel.id, 0),
                ext=ConnectionExtRosbag2(channel.message_encoding, qos),
                owner=self,
            )
            self.connections.append(connection)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Messages:
        """Yield connection, log time in ns and data of messages, from `start` to before `stop` in ns."""
        wanted = {c.id: c for c in connections}
        first = start or 0
        end = 2**64 if stop is None else stop
        chunks = [
            self._read_chunk(chunk, wanted, first, end)
            for chunk in self._chunks
            if first <= chunk.message_end_time and chunk.message_start_time < end
            if not chunk.message_index_offsets or wanted.keys() & chunk.message_index_offsets
        ]
        for time_ns, connection, data in heapq.merge(*chunks, key=itemgetter(0)):
            if connection is not None:
                yield connection, time_ns, data
        last_ns = 0
        for _, channel, message in () if self._chunks else self._scan():
            if channel.id in wanted and first <= message.log_time < end:
                if message.log_time < last_ns:
                    raise ValueError('it has no index, and its messages are not in the order of their times')
                last_ns = message.log_time
                yield wanted[channel.id], last_ns, message.data

    def _read_chunk(
        self, chunk: ChunkIndex, wanted: dict[int, Connection], first: int, end: int
    ) -> Iterator[tuple[int, Connection | None, bytes]]:
        yield chunk.message_start_time, None, b''  # it is unpacked when its first message is the next one
        found = read_chunk(self._file, chunk.chunk_start_offset, wanted)
        messages = [message for message in found if first <= message[0] < end]
        size = sum(len(data) for *_, data in messages)
        self._held_bytes += size
        try:
            if self._held_bytes > MAX_HELD_BYTES:
                limit = f'more than {MAX_HELD_BYTES >> 20} MiB unpacked'
                raise ValueError(f'chunks that overlap at {chunk.message_start_time} ns are {limit}')
            for time_ns, channel, data in sorted(messages, key=itemgetter(0)):
                yield time_ns, wanted[channel], data
        finally:
            self._held_bytes -= size

    def _scan(self) -> Iterator[ScannedMessage]:
        scan = McapScan(self.path)
        for item in scan:
            if scan.losses:
                break
            if isinstance(item, ScannedMessage):
                yield item
        if scan.losses:
            raise ValueError(scan.losses[0])


class SqliteStorage:
    """An SQLite3 file of a bag, whose messages come in the order of log times."""

    def __init__(self, path: Any) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.duration = 0  # ns
        self.message_count = 0  # also of those that `messages` leaves out, without a topic, a time or data
        self._database: Any = None

    def open(self) -> None:
        """Read the topics."""
        address = f'{Path(self.path).absolute().as_uri()}?mode=ro&immutable=1'
        database = self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
        database.row_factory = sqlite3.Row
        tables = {name for (name,) in database.execute('SELECT name FROM sqlite_master')}
        defined = {}
        if 'message_definitions' in tables:  # of Iron and later
            query = 'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            defined = {str(name): _define(*map(str, found)) for name, *found in database.execute(query)}
        counts = dict(map(tuple, database.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')))
        for row in database.execute('SELECT id, name, type, serialization_format, * FROM topics ORDER BY id'):
            topic = {name.lower(): str(row[name]) for name in row.keys()}  # noqa: SIM118
            qos = _parse_qos(topic.get('offered_qos_profiles', ''))  # since Foxy
            connection = Connection(
                id=row['id'],
                topic=topic['name'],
                msgtype=topic['type'],
                msgdef=defined.get(topic['type'], NO_DEFINITION),
                digest=topic.get('type_description_hash', ''),  # since Iron
                msgcount=counts.get(row['id'], 0),
                ext=ConnectionExtRosbag2(topic['serialization_format'], qos),
                owner=self,
            )
            self.connections.append(connection)
        columns = 'CAST(max(timestamp) AS INTEGER) - CAST(min(timestamp) AS INTEGER) + 1, count(*)'
        ((duration, self.message_count),) = database.execute(f'SELECT {columns} FROM messages')  # noqa: S608
        self.duration = duration or 0

    def close(self) -> None:
        """Close the database."""
        if self._database is not None:
            self._database.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Messages:
        """Yield connection, log time in ns and data of messages, from `start` to before `stop` in ns."""
        wanted = {c.id: c for c in connections}
        topics = ', '.join('?' * len(wanted))
        query = (
            f'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({topics}) '  # noqa: S608
            "AND timestamp >= ? AND timestamp < ? AND typeof(data) = 'blob' ORDER BY timestamp"
        )
        end = 2**63 - 1 if stop is None else stop
        for topic_id, time_ns, data in self._database.execute(query, (*wanted, start or 0, end)):
            yield wanted[topic_id], time_ns, data


class _UnopenedFile:
    connections = ()

    def __init__(self, path: Any) -> None:
        self.path = path

    def open(self) -> None: ...

    def close(self) -> None: ...


class FolderReader(DirectoryReader):
    """A bag folder, whose files `choose_storage` reads."""

    STORAGE_PLUGINS: Any = dict.fromkeys(('mcap', 'sqlite3', '', None), _UnopenedFile)
    path: Any
    stack: Any
    storages: list[Any]

    def open(self) -> None:
        """Read metadata.yaml and open the files."""
        for file in self.path.iterdir():
            if file.is_file() and begins_with(file, ZSTD_MAGIC):  # `rosbags` unpacks it, whatever its size
                deque(read_unpacked(file), maxlen=0)
        try:
            super().open()
            self.duration = int(self.metadata.duration)
            for c in self.connections:
                if not (isinstance(c.topic, str) and isinstance(c.msgtype, str) and isinstance(c.msgcount, int)):
                    raise TypeError
        except OSError:
            raise
        except Exception as error:  # `rosbags` may raise anything where metadata.yaml is malformed
            is_malformed = isinstance(error.__cause__ or error, MALFORMED)
            form = f'{METADATA} does not have the form of rosbag2'
            raise ValueError(form if is_malformed else describe_error(error)) from None
        self.storages = [choose_storage(file.path) for file in self.storages]
        for storage in self.storages:
            self.stack.callback(storage.close)
            storage.open()
        known = {c.msgtype: c.msgdef for s in self.storages for c in s.connections if c.msgdef.data}
        self.connections = [c._replace(msgdef=known.get(c.msgtype, c.msgdef)) for c in self.connections]
        self._is_packed = self.metadata.compression_mode == 'message'
        self.metadata = self.metadata._replace(compression_mode=None)  # `messages` unpacks them

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Messages:
        """Yield connection, log time in ns and data of messages, from `start` to before `stop` in ns."""
        for connection, time_ns, data in super().messages(connections, start, stop):
            yield connection, time_ns, unpack(data, 'zstd') if self._is_packed else data


class Ros1Reader(Reader):
    """A bag of ROS 1; its methods may raise anything where it is damaged."""

    def read_connection(self) -> Connection:
        """Read a topic; all have absolute names, as in ROS 2."""
        connection = super().read_connection()
        return connection._replace(topic=f'/{connection.topic.removeprefix("/")}')

    def read_chunk(self) -> Chunk:
        """Read the header of a chunk, which is unpacked later."""
        chunk = super().read_chunk()
        (compression,) = (name for name, function in decompressors.items() if function is chunk.decompressor)
        return chunk._replace(decompressor=partial(unpack, compression=compression))


def describe_error(error: Exception) -> str:
    """Return in one line why a file cannot be read.

    A reader that believes a damaged length may ask for more memory than there is; its MemoryError has no text.
    """
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return 'a length in it is damaged, or there is too little memory'
    if isinstance(error, UnicodeDecodeError):
        return f'not UTF-8 at byte {error.start} of a text in it'
    return describe_parse_error(error).rstrip('.') or type(error).__name__


def _define(encoding: str, text: str) -> MessageDefinition:
    """Return the definition of a type; none where rosbag2 has found none and states the language `unknown`."""
    return MessageDefinition(FORMATS[encoding], text) if encoding in FORMATS else NO_DEFINITION


@lru_cache(MAX_QOS_TEXTS)
def _parse_qos(profiles: str) -> list[Qos]:
    try:
        return parse_qos(profiles)
    except Exception:  # `rosbags` may raise anything for other content
        raise ValueError('the QoS profiles of a topic are damaged') from None
