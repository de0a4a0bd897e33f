# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recovery of bags whose recorder was killed, whose disk was full or lost its power, or that were damaged."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import Item, McapScan
from mocap_ros.bags.reader import (
    ROS2_SUFFIXES,
    find_database_log,
    find_number_and_name,
    list_bag_files,
)
from mocap_ros.bags.recorder import RecordedMessage, Recorder, choose_partial_path, remove_partial
from mocap_ros.bags.rosbag2 import ROSBAG2, Topic, make_topic
from mocap_ros.bags.storages import READ_ERRORS, SqliteStorage, describe_error
from mocap_ros.bags.unpacking import PIECE_BYTES, ZSTD_MAGIC, read_unpacked, unpack
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import MALFORMED, InputError, RecordingError
from mocap_ros.messages.cdr import typestore

ENCODINGS = {MessageDefinitionFormat.MSG: 'ros2msg', MessageDefinitionFormat.IDL: 'ros2idl'}
PACKED_SUFFIX = '.zstd'  # that rosbag2 adds to the name of a file that it has compressed as a whole
NO_LIMITS = RecorderConfig(min_free_mb=0, split_seconds=0.0, split_mb=0)  # the new bag has the files of the other

# A function that receives the number of processed bytes and of all bytes.
ReportProgress = Callable[[int, int], None]
T = TypeVar('T')


@dataclass
class RecoveryReport:
    """The result of a recovery."""

    messages: Counter[str] = field(default_factory=Counter)  # number of recovered messages by topic
    # Descriptions of what could not be read, one line each, with the name of the file
    losses: list[str] = field(default_factory=list)


def recover(path: Path, out: Path, report_progress: ReportProgress = lambda *_: None) -> RecoveryReport:
    """Write a new bag with everything that can be read of another bag, and nothing else.

    Each file of the other bag with a readable message, attachment or metadata becomes a file of the new bag; one
    that cannot be opened is a loss. The new bag is written as `<out>.partial` and renamed when it is complete. If
    the recovery fails or is interrupted, the new bag is deleted, and so is what a killed recovery left there.
    """
    files = list_recoverable_files(path)
    if not files:
        raise InputError(f'{path}: no bag folder, .mcap or .db3 file (ROS 1: `rosbag reindex` repairs a .bag)')
    if path.is_dir() and out.parent.resolve() == path.resolve():
        raise RecordingError(f'{out}: {path} is a bag; write beside it, not into it')
    remove_partial(out)
    partial_bag = choose_partial_path(out)
    report = RecoveryReport()
    sizes = {file: file.stat().st_size if file.is_file() else 0 for file in files}
    with Recorder(partial_bag, NO_LIMITS, name=out.name) as recorder:
        try:
            recorder.ros_distro = ''  # that of the other bag is not known
            bytes_before = 0
            for file, size in sizes.items():
                copy = _FileCopy(file, recorder, report)
                for done_bytes in copy.run(out.parent, size):
                    report_progress(bytes_before + min(done_bytes, size), sum(sizes.values()))
                bytes_before += size
            if not report.messages:
                reasons = '; '.join(report.losses) or f'{path}: the bag has no messages'
                raise InputError(f'nothing can be recovered: {reasons}')
            recorder.close()
            partial_bag.rename(out)
        except BaseException as error:
            recorder.remove()
            if isinstance(error, OSError):
                raise RecordingError(f'{out}: {error.strerror}') from None
            raise
    return report


def list_recoverable_files(path: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers, each one as it is or else compressed."""
    if not path.is_dir():
        return [path] if path.suffix in (*ROS2_SUFFIXES, PACKED_SUFFIX) else []
    packed = [f for f in path.iterdir() if f.suffix == PACKED_SUFFIX and f.with_suffix('').suffix in ROS2_SUFFIXES]
    file_by_name = {f.with_suffix('').name: f for f in packed} | {f.name: f for f in list_bag_files(path)}
    return [file_by_name[name] for name in sorted(file_by_name, key=find_number_and_name)]


class _FileCopy:
    def __init__(self, name: Path, recorder: Recorder, report: RecoveryReport) -> None:
        self._name = name
        self._recorder = recorder
        self._report = report
        self._rejected: Counter[tuple[str, str]] = Counter()  # messages by topic and reason for the rejection
        self._has_begun = False  # whether anything of the file is in the new bag

    def run(self, folder: Path, size: int) -> Iterator[int]:
        """Copy what can be read; yield the number of bytes read so far, of a size."""
        if self._name.exists() and not self._name.is_file():
            self._report_loss('not a file')
            return
        with self._provide_readable(folder) as file:
            yield from self._copy_mcap(file) if file.suffix == '.mcap' else self._copy_sqlite(file, size)
        for (topic, reason), number in self._rejected.items():
            self._report_loss(f'{number} messages of {topic} are lost: {reason}')

    @contextmanager
    def _reading(self, place: str = '', advice: str = '') -> Iterator[None]:
        """Make a loss of an error of reading; what was read before is copied."""
        try:
            yield
        except READ_ERRORS as error:
            self._report_loss(f'{place}{describe_error(error)}{advice}')

    def _read(self, items: Iterable[T]) -> Iterator[T]:
        with self._reading():
            yield from items

    @contextmanager
    def _provide_readable(self, folder: Path) -> Iterator[Path]:
        """Provide the file in a form that can be read without changing the folder of the bag.

        A file that is compressed as a whole is unpacked into a temporary folder in `folder`, as far as possible. A
        database with a write-ahead log is copied there, where SQLite adds the log to it.
        """
        file = self._name
        log = find_database_log(self._name)
        has_log = file.suffix == '.db3' and log.is_file() and log.stat().st_size > 0
        if file.suffix != PACKED_SUFFIX and not has_log:
            yield file
            return
        with TemporaryDirectory(dir=folder, prefix='.mocap_ros_') as place:
            readable = Path(place) / file.name.removesuffix(PACKED_SUFFIX)
            if has_log:
                self._copy(_read_pieces(file), readable)
                self._copy(_read_pieces(log), find_database_log(readable))
                with self._reading(), closing(sqlite3.connect(readable)) as database:
                    database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
            else:
                self._copy(read_unpacked(file), readable)
            yield readable

    def _copy(self, pieces: Iterator[bytes], copy: Path) -> None:
        with copy.open('wb') as stream:
            for piece in self._read(pieces):
                stream.write(piece)

    def _copy_mcap(self, file: Path) -> Iterator[int]:
        scan = McapScan(file)
        for item in self._read(scan):
            self._copy_item(item)
            yield scan.position
        for loss in scan.losses:
            self._report_loss(loss)

    def _copy_item(self, item: Item) -> None:
        """Copy a message of ROS 2, an attachment, or metadata other than those of rosbag2."""
        if isinstance(item, AttachmentRecord):
            self._begin_file()
            attachment = Attachment(item.name, item.media_type, item.data, item.create_time)
            with self._recorder.writing() as file:
                file.add_attachments([attachment], item.log_time)
        elif isinstance(item, MetadataRecord):
            if item.name != ROSBAG2:
                self._begin_file()
                with self._recorder.writing() as file:
                    file.add_metadata(item.name, item.metadata)
        elif item.schema is None or item.channel.message_encoding != 'cdr':
            self._rejected[item.channel.topic, 'no messages of ROS 2'] += 1
        else:
            schema, channel, message = item.schema, item.channel, item.message

            def describe() -> Topic:
                qos = channel.metadata.get('offered_qos_profiles', '')
                type_hash = channel.metadata.get('topic_type_hash', '')
                text = schema.data.decode(errors='replace')
                return Topic(channel.topic, schema.name, text, schema.encoding, type_hash, _convert_qos(qos))

            record = RecordedMessage(
                channel.topic, schema.name, message.data, message.log_time, message.publish_time, repeat_keys=None
            )
            self._write(record, describe)

    def _copy_sqlite(self, file: Path, size: int) -> Iterator[int]:
        with closing(SqliteStorage(file)) as storage:
            for number, (connection, time_ns, data) in self._read_database(storage):
                message = RecordedMessage(
                    connection.topic, connection.msgtype, data, time_ns, time_ns, repeat_keys=None
                )
                self._write(message, partial(_describe_connection, connection))
                yield size * number // max(storage.message_count, number)

    def _read_database(self, storage: SqliteStorage) -> Iterator[tuple[int, tuple[Connection, int, bytes]]]:
        """Yield the messages with their numbers, from 1 on."""
        with self._reading('SQLite cannot read it: ', f'; `sqlite3 {self._name} .recover` may save more'):
            storage.open()
            number = 0
            for number, message in enumerate(storage.messages(storage.connections), 1):
                yield number, message
            if number < storage.message_count:
                missing = f'{storage.message_count - number} of {storage.message_count} messages'
                self._report_loss(f'{missing} have no topic, no time or no data')

    def _write(self, message: RecordedMessage, describe: Callable[[], Topic]) -> None:
        """Write a message; add its topic, which `describe` returns, before the first one."""
        topic, msgtype, data, *_ = message
        declared = self._recorder.topics.get(topic)
        if declared is None:
            self._recorder.add_topic(_repair_definition(describe()))
        elif declared.type != msgtype:
            self._rejected[topic, f'of the type {msgtype}, but the topic has the type {declared.type}'] += 1
            return
        if data.startswith(ZSTD_MAGIC):
            try:
                data = unpack(data, 'zstd')
            except ValueError as error:
                self._rejected[topic, str(error)] += 1
                return
        self._begin_file()
        self._recorder.write(*message._replace(data=data))
        self._report.messages[topic] += 1

    def _begin_file(self) -> None:
        """Begin a file of the new bag with the first of what can be read."""
        if not self._has_begun:
            self._recorder.begin_file()
            self._has_begun = True

    def _report_loss(self, loss: str) -> None:
        self._report.losses.append(f'{self._name}: {loss}')


def _read_pieces(file: Path) -> Iterator[bytes]:
    with file.open('rb') as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


def _describe_connection(connection: Connection) -> Topic:
    definition = connection.msgdef.data
    encoding = ENCODINGS.get(connection.msgdef.format, '')
    qos = _convert_qos(getattr(connection.ext, 'offered_qos_profiles', []))
    return Topic(connection.topic, connection.msgtype, definition, encoding, connection.digest, qos)


def _repair_definition(topic: Topic) -> Topic:
    """Replace a definition in no known language, as rosbag2 writes where it finds none, by this package's or none.

    Readers refuse bags that state an unknown language.
    """
    if topic.definition and topic.encoding in ('ros2msg', 'ros2idl', 'omgidl'):
        return topic
    if topic.type in typestore().types:
        return make_topic(topic.name, topic.type, qos=topic.qos)
    return Topic(topic.name, topic.type, '', '', topic.type_hash, topic.qos)


def _convert_qos(profiles: Any) -> tuple[dict[str, Any], ...]:
    """Convert QoS profiles of any version of rosbag2 to those of version 9; return none where they are invalid."""
    try:
        return tuple(dump_qos_v9(parse_qos(profiles) if isinstance(profiles, str) else profiles))  # type: ignore[arg-type]
    except (*MALFORMED, ReaderError):
        return ()
