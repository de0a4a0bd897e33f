# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recovery of bags whose recorder was killed, whose disk was full, or that were damaged."""

from __future__ import annotations

import errno
import sqlite3
import stat
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import zstandard
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord
from rosbags.rosbag2.metadata import dump_qos_v9

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import McapScan, ScannedMessage
from mocap_ros.bags.reader import MAX_METADATA_BYTES, ROS2_SUFFIXES, find_number_and_name, list_bag_files
from mocap_ros.bags.reader_limits import PIECE_BYTES, LimitedFile, describe_error, parse_qos, unpack
from mocap_ros.bags.recorder import Recorder, choose_partial_path, remove_partial
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA, ROSBAG2, Topic, make_topic
from mocap_ros.bags.sqlite_scan import SQLITE_ERRORS, MessageRows, has_log, open_database
from mocap_ros.bags.sqlite_schema import describe_unusual_tables
from mocap_ros.bags.write_ahead_log import find_log, write_all
from mocap_ros.config import RecorderConfig, load_yaml
from mocap_ros.errors import ConfigError, InputError, RecordingError
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.recorded_types import load_recorded_types

DEFINITION_ENCODINGS = ('ros2msg', 'ros2idl', 'omgidl')  # of message definitions that can be parsed
PACKED_SUFFIX = '.zstd'  # that rosbag2 adds to the name of a file that it has compressed as a whole
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # first bytes of a compressed message; a message as CDR begins with 0
NO_LIMITS = RecorderConfig(min_free_mb=0, split_seconds=0.0, split_mb=0)  # the new bag has the files of the other

# A function that receives the number of processed bytes and of all bytes.
ReportProgress = Callable[[int, int], None]


@dataclass
class RecoveryReport:
    """The result of a recovery.

    Attributes:
        messages: Number of recovered messages by topic.
        losses: Descriptions of what could not be read, one line each, with the name of the file.
    """

    messages: Counter[str] = field(default_factory=Counter)
    losses: list[str] = field(default_factory=list)


def recover(path: Path, out: Path, report_progress: ReportProgress = lambda *_: None) -> RecoveryReport:
    """Write a new bag with everything that can be read of another bag, and nothing else.

    Each file of the other bag with a readable message, attachment or metadata becomes a file of the new bag; one
    that cannot be opened is a loss. The new bag names the distribution that the other bag names, or none where
    that is lost. It is written as `<out>.partial` and renamed when it is complete. If the recovery fails or is
    interrupted, the new bag is deleted; what a killed recovery left there is deleted by the next one.

    Args:
        path: Bag folder, or a .mcap or .db3 file; it is not changed.
        out: Folder of the new bag.
        report_progress: Called repeatedly with the number of processed bytes and of all bytes.

    Raises:
        InputError: There is no file of a bag, or no message could be read.
        RecordingError: The new bag cannot be written.
    """
    files = list_recoverable_files(path)
    if not files:
        raise InputError(f'{path}: no bag folder, .mcap or .db3 file (ROS 1: `rosbag reindex` repairs a .bag)')
    if path.is_dir() and out.parent.resolve() == path.resolve():
        raise RecordingError(f'{out}: {path} is a bag; write beside it, not into it')
    report = RecoveryReport()
    sizes: dict[Path, int] = {}  # of the files that can be read, in bytes
    for file in files:
        with _note_unreadable(file, report):
            sizes[file] = _get_size(file)
    remove_partial(out)
    partial = choose_partial_path(out)
    with Recorder(partial, NO_LIMITS, name=out.name) as recorder:
        try:
            recorder.ros_distro = _read_ros_distro(path / METADATA)
            bytes_before, all_bytes = 0, sum(sizes.values())
            for file, size in sizes.items():
                with closing(_recover_file(file, out.parent, recorder, report)) as steps:
                    for processed_bytes in steps:
                        report_progress(bytes_before + min(processed_bytes, size), all_bytes)
                bytes_before += size
            if not report.messages:
                reasons = '; '.join(report.losses) or f'{path}: the bag has no messages'
                raise InputError(f'nothing can be recovered: {reasons}')
            recorder.close()
            partial.rename(out)
        except BaseException as error:
            recorder.remove()
            if isinstance(error, OSError):
                raise RecordingError(f'{out}: {error.strerror}') from None
            raise
    return report


def list_recoverable_files(path: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers, each one as it is or else compressed.

    Args:
        path: Bag folder, or a file of a bag; there are no files if it is anything else.
    """
    if not path.is_dir():
        return [path] if path.suffix in (*ROS2_SUFFIXES, PACKED_SUFFIX) else []
    packed = [f for f in path.iterdir() if f.suffix == PACKED_SUFFIX and f.with_suffix('').suffix in ROS2_SUFFIXES]
    file_by_name = {f.with_suffix('').name: f for f in packed} | {f.name: f for f in list_bag_files(path)}
    return [file_by_name[name] for name in sorted(file_by_name, key=find_number_and_name)]


@contextmanager
def _note_unreadable(file: Path, report: RecoveryReport) -> Iterator[None]:
    """Add to the losses that a file cannot be read, where the block raises OSError."""
    try:
        yield
    except OSError as error:
        report.losses.append(f'{file}: {error.strerror or error}')


@contextmanager
def _name_folder(folder: Path) -> Iterator[None]:
    """Raise RecordingError where the block cannot write into a folder."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f'{folder}: {error.strerror or error}') from None


def _recover_file(
    file: Path, folder: Path, recorder: Recorder, report: RecoveryReport
) -> Generator[int, None, None]:
    """Copy everything that can be read of one file into the new bag; yield the number of bytes read so far.

    Args:
        file: File to read.
        folder: Folder for temporary files.
        recorder: Recorder of the new bag.
        report: Report to which recovered messages and losses are added.

    Raises:
        RecordingError: The new bag or a temporary file cannot be written.
    """
    with _note_unreadable(file, report), _provide_readable(file, folder, report) as readable:
        recovery = _FileRecovery(readable, recorder, report, name=file)
        yield from recovery.recover_mcap() if readable.suffix == '.mcap' else recovery.recover_sqlite()


@contextmanager
def _provide_readable(file: Path, folder: Path, report: RecoveryReport) -> Iterator[Path]:
    """Provide a file of a bag in a form that can be read without changing the folder of the bag.

    A file that is compressed as a whole is unpacked into a temporary folder in `folder`. A database with a
    write-ahead log is copied there with its log, because SQLite writes an index beside them.
    """
    is_packed = file.suffix == PACKED_SUFFIX
    if not is_packed and not (file.suffix == '.db3' and has_log(file)):
        yield file
        return
    with _name_folder(folder):
        temporary = TemporaryDirectory(dir=folder, prefix='.mocap_ros_')
    with temporary as place:
        readable = Path(place) / (file.stem if is_packed else file.name)
        if is_packed:
            _unpack_file(file, readable, report)
        else:
            _copy_file(file, readable)
            _copy_file(find_log(file), find_log(readable))
        yield readable


def _copy_file(file: Path, copy: Path) -> None:
    with file.open('rb') as source:
        _write_pieces(source.read, copy)


def _unpack_file(file: Path, unpacked: Path, report: RecoveryReport) -> None:
    """Unpack a file as far as it can be read and unpacked."""
    with _note_unreadable(file, report), file.open('rb') as packed:
        try:
            _write_pieces(LimitedFile(packed).read, unpacked)
        except (ValueError, zstandard.ZstdError) as error:
            report.losses.append(f'{file}: the compressed file is damaged or too large: {error}')


def _write_pieces(read: Callable[[int], bytes], path: Path) -> None:
    """Write a new file of what a function reads piece by piece; it is complete up to where the function fails."""
    with _name_folder(path.parent):
        stream = path.open('xb', buffering=0)
    with stream:
        while piece := read(PIECE_BYTES):
            with _name_folder(path.parent):
                write_all(stream, piece)


def _read_ros_distro(metadata: Path) -> str:
    """Return the distribution that a metadata.yaml names; an empty string where it cannot be read."""
    try:
        if metadata.stat().st_size > MAX_METADATA_BYTES:
            return ''
        return _parse_ros_distro(metadata.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError):
        return ''


def _parse_ros_distro(description: str) -> str:
    """Return the distribution that the description (YAML) of a bag names; an empty string where it names none."""
    try:
        content = load_yaml(description, METADATA)
    except ConfigError:
        return ''
    if isinstance(content, dict):
        content = content.get(BAG_INFORMATION, content)
    ros_distro = content.get('ros_distro') if isinstance(content, dict) else None
    return ros_distro if isinstance(ros_distro, str) else ''


def _get_size(file: Path) -> int:
    """Return the size of a file in bytes.

    Raises:
        OSError: The path does not exist or is not a regular file.
    """
    status = file.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, 'not a file')
    return status.st_size


class _FileRecovery:
    """Copies everything that can be read of one file into the new bag.

    Args:
        file: File to read.
        recorder: Recorder of the new bag.
        report: Report to which recovered messages and losses are added.
        name: Path of the file in the bag, for the report.
    """

    def __init__(self, file: Path, recorder: Recorder, report: RecoveryReport, name: Path) -> None:
        self._file = file
        self._name = name
        self._recorder = recorder
        self._report = report
        self._rejected: Counter[tuple[str, str]] = Counter()  # messages by topic and reason for the rejection
        self._attached: set[tuple[str, bytes]] = set()  # names of the attachments and checksums of their content
        self._has_begun = False  # whether anything of the file is in the new bag

    def recover_mcap(self) -> Iterator[int]:
        """Copy an MCAP file; yield the number of bytes read so far."""
        scan = McapScan(self._file)
        if not scan.is_mcap:
            self._report_loss('the file is no MCAP file')
            return
        try:
            for item in scan:
                self._copy_mcap_item(item)
                yield scan.scanned_bytes
        finally:  # also where the disk is gone half-way
            self._report_rejected()
            self._report.losses += [f'{self._name}: {loss}' for loss in scan.losses]

    def _copy_mcap_item(self, item: ScannedMessage | AttachmentRecord | MetadataRecord) -> None:
        """Copy a message, an attachment that is not there yet, or metadata other than those of rosbag2."""
        if isinstance(item, AttachmentRecord):
            key = item.name, sha256(item.data).digest()
            if key not in self._attached:
                self._attached.add(key)
                self._begin_file()
                attachment = Attachment(item.name, item.media_type, item.data, item.create_time)
                self._recorder.add_attachment(attachment, item.log_time)
        elif isinstance(item, MetadataRecord):
            if item.name != ROSBAG2:
                self._begin_file()
                self._recorder.add_metadata(item.name, item.metadata)
            elif ros_distro := _parse_ros_distro(item.metadata.get('serialized_metadata', '')):
                self._recorder.ros_distro = ros_distro
        else:
            self._copy_mcap_message(item)

    def _copy_mcap_message(self, item: ScannedMessage) -> None:
        """Copy a message, or count it as rejected where it is not a message of ROS 2."""
        schema, channel, message = item
        if schema is None or channel.message_encoding != 'cdr':
            reason = f'they are no messages of ROS 2 (encoding {channel.message_encoding})'
            self._rejected[channel.topic, 'they have no schema' if schema is None else reason] += 1
        elif self._declare_topic(channel.topic, schema.name, lambda: _convert_topic(item)):
            self._write(channel.topic, schema.name, message.data, message.log_time, message.publish_time)

    def recover_sqlite(self) -> Iterator[int]:
        """Copy an SQLite3 file and its write-ahead log; yield the number of bytes read so far."""
        size = _get_size(self._file)
        try:
            with closing(open_database(self._file)) as database:
                database.execute('PRAGMA writable_schema=ON')  # otherwise SQLite opens no file that was cut off
                if unusual := describe_unusual_tables(database):
                    self._report_loss(unusual)
                    return
                topics = self._read_sqlite_topics(database)
                rows = MessageRows(database, size)
                for number, topic_id, time_ns, data in rows:
                    if not (isinstance(data, bytes) and isinstance(time_ns, int) and time_ns >= 0):
                        rows.unreadable_count += 1
                    elif topic_id in topics:
                        topic = topics[topic_id]
                        self._write(topic.name, topic.type, data, time_ns, time_ns)
                    else:
                        self._rejected[f'topic {topic_id}', 'the description of the topic is lost'] += 1
                    yield size * number // max(rows.last, 1)
                if rows.lost_count:
                    number_lost = f'about {rows.lost_count}' if rows.has_count else 'an unknown number of'
                    self._report_loss(f'{number_lost} messages cannot be read, because the database is damaged')
        except SQLITE_ERRORS as error:
            self._report_loss(f'the database cannot be read: {describe_error(error)}')
        self._report_rejected()

    def _read_sqlite_topics(self, database: sqlite3.Connection) -> dict[int, Topic]:
        """Read the topics of a database and add them to the new bag; return them by their id."""
        columns = {row[1] for row in database.execute('PRAGMA table_info(topics)')}
        optional = [c if c in columns else "''" for c in ('offered_qos_profiles', 'type_description_hash')]
        definitions = self._read_sqlite_definitions(database)
        topics = {}
        query = f'SELECT id, name, type, {", ".join(optional)} FROM topics'  # noqa: S608
        for topic_id, *fields in database.execute(query):
            name, msgtype, qos, type_hash = (value if isinstance(value, str) else '' for value in fields)
            encoding, text = definitions.get(msgtype, ('ros2msg', ''))
            topic = _repair_definition(Topic(name, msgtype, text, encoding, type_hash, _parse_qos(qos)))
            if not (name and msgtype):
                self._report_loss(f'topic {topic_id} has no name or no type')
            elif self._declare_topic(name, msgtype, lambda: topic):  # noqa: B023
                topics[topic_id] = topic
        return topics

    def _read_sqlite_definitions(self, database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
        """Return encoding and text of the definitions by message type; none where the database holds none."""
        if not database.execute('PRAGMA table_info(message_definitions)').fetchall():
            return {}
        query = 'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
        try:
            return {
                msgtype: (encoding, text)
                for msgtype, encoding, text in database.execute(query)
                if isinstance(encoding, str) and isinstance(text, str)
            }
        except SQLITE_ERRORS:
            self._report_loss('the definitions of the message types cannot be read')
            return {}

    def _declare_topic(self, name: str, msgtype: str, make: Callable[[], Topic]) -> bool:
        """Add a topic to the new bag unless it exists; return False where it exists with another message type."""
        declared = self._recorder.topics.get(name)
        if declared is None:
            self._recorder.add_topic(make())
        elif declared.type != msgtype:
            self._rejected[name, f'their type is {msgtype}, but the topic has the type {declared.type}'] += 1
            return False
        return True

    def _write(self, topic: str, msgtype: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        if data.startswith(ZSTD_MAGIC):
            try:
                data = unpack(data, 'zstd')
            except (ValueError, zstandard.ZstdError):
                self._rejected[topic, 'they cannot be decompressed'] += 1
                return
        self._begin_file()
        self._recorder.write(topic, msgtype, data, log_time_ns, publish_time_ns, repeat_keys=None)
        self._report.messages[topic] += 1

    def _begin_file(self) -> None:
        """Begin a file of the new bag with the first of what can be read."""
        if not self._has_begun:
            self._recorder.begin_file()
            self._has_begun = True

    def _report_rejected(self) -> None:
        for (topic, reason), number in self._rejected.items():
            self._report_loss(f'{number} messages of {topic} are lost, because {reason}')

    def _report_loss(self, loss: str) -> None:
        self._report.losses.append(f'{self._name}: {loss}')


def _convert_topic(item: ScannedMessage) -> Topic:
    """Return the topic of a scanned message that has a schema."""
    assert item.schema is not None  # noqa: S101
    metadata = item.channel.metadata
    return _repair_definition(
        Topic(
            item.channel.topic,
            item.schema.name,
            item.schema.data.decode(errors='replace'),
            item.schema.encoding,
            metadata.get('topic_type_hash', ''),
            _parse_qos(metadata.get('offered_qos_profiles', '')),
        )
    )


def _repair_definition(topic: Topic) -> Topic:
    """Replace a missing or damaged definition by this package's own definition of the type, where it has one.

    Of other types, a definition in an unknown language is left out, because readers refuse bags that state one.
    """
    if topic.type in typestore().types:
        return topic if _has_valid_definition(topic) else make_topic(topic.name, topic.type, qos=topic.qos)
    return topic if topic.encoding in DEFINITION_ENCODINGS else replace(topic, definition='', encoding='')


def _has_valid_definition(topic: Topic) -> bool:
    """Return whether the definition of a topic's type can be parsed and is complete."""
    if not topic.definition or topic.encoding not in DEFINITION_ENCODINGS:
        return False
    try:
        is_idl = topic.encoding != 'ros2msg'
        load_recorded_types(topic.definition, topic.type, is_idl=is_idl).generate_msgdef(topic.type)
    except Exception:  # the parser may raise anything for damaged text
        return False
    return True


def _parse_qos(text: str) -> tuple[dict[str, Any], ...]:
    """Convert QoS profiles of any version of rosbag2 to those of version 9; return none where they are invalid."""
    try:
        profiles: list[dict[str, Any]] = dump_qos_v9(parse_qos(text))  # type: ignore[assignment]
    except Exception:  # the parser may raise anything for damaged text
        return ()
    return tuple(profiles)
