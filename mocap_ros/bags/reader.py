# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of bags of ROS 2 (MCAP or SQLite3; a folder or a bare file) and ROS 1.

Messages are read one at a time. Damage is always reported as an error; no message is omitted silently.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat, Qos, QosDurability
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys.store import Typestore

from mocap_ros.bags.mcap_scan import MAGIC, PARSE_ERRORS, read_summary
from mocap_ros.bags.reader_limits import describe_error
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.errors import InputError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.recorded_types import load_recorded_types
from mocap_ros.messages.versions import Convert, convert_or_keep, make_converter
from mocap_ros.units import NS_PER_S

if TYPE_CHECKING:
    from typing_extensions import Self

ROS2_SUFFIXES = ('.mcap', '.db3')  # of the files of ROS 2 bags
ROS1_SUFFIX = '.bag'  # of ROS 1 bags
# bytes of a metadata.yaml; one of this size takes half a minute to parse, and 100 topics need 100 kB
MAX_METADATA_BYTES = 1 << 20


class BagMessage(NamedTuple):
    """A message of a bag.

    Attributes:
        topic: Absolute name of the topic.
        type: Message type.
        time_ns: Log time, in ns.
        raw: The message as CDR.
    """

    topic: str
    type: str
    time_ns: int
    raw: bytes


class Bag:
    """A bag that is open for reading; a context manager that closes it.

    Messages of types that this package defines are returned as CDR of that definition. If the bag holds another
    version of the type, or is a ROS 1 bag, the messages are converted field by field. Bytes that are no message of
    their type are returned as they are; whoever decodes them reports them.

    Args:
        path: Folder with a metadata.yaml, or a .mcap, .db3 or .bag file. Bags in MCAP may be on another file
            system, as an object with the methods of a path (`upath.UPath`).

    Attributes:
        path: Path of the bag.

    Raises:
        InputError: There is no bag at the path, or the bag cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path) if isinstance(path, str) else path
        self._is_ros1 = self.path.suffix == ROS1_SUFFIX
        if self.path.exists() and not (self.path.is_dir() or self.path.is_file()):
            raise InputError(f'{self.path}: neither a file nor a folder')
        self._raise_fault(_find_fault(self.path))
        try:
            _check_metadata_text(self.path / METADATA)
            self._reader: Any = Ros1Reader(self.path) if self._is_ros1 else Ros2Reader(self.path)
            self._reader.open()
        except InputError:
            raise
        except Exception as error:  # the reader of a damaged file may raise anything
            raise self._make_read_error(error) from None
        self._refuse_hidden_messages()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        with suppress(Exception):
            self._reader.close()

    @property
    def topics(self) -> dict[str, str]:
        """Message types by topic."""
        return {c.topic: c.msgtype for c in self._connections()}

    @property
    def qos(self) -> dict[str, list[Qos]]:
        """QoS profiles that the recorded publishers offered, by topic; empty where the bag does not hold them."""
        return {c.topic: getattr(c.ext, 'offered_qos_profiles', []) for c in self._connections()}

    @property
    def latched_topics(self) -> set[str]:
        """Topics of which a late subscriber receives the last message (durability transient local)."""
        return {
            topic
            for topic, profiles in self.qos.items()
            if QosDurability.TRANSIENT_LOCAL in {q.durability for q in profiles}
        }

    def count(self, topics: Collection[str]) -> int:
        """Return the number of messages on the topics."""
        return sum(c.msgcount for c in self._connections() if c.topic in topics)

    def topics_of_type(self, types: Collection[str]) -> list[str]:
        """Return the topics that have one of the message types and hold messages."""
        return list(dict.fromkeys(c.topic for c in self._connections() if c.msgtype in types and c.msgcount))

    def find_camera_info_topic(self, keypoints_topic: str, name: str | None = None) -> str | None:
        """Return the CameraInfo topic that belongs to a keypoint topic, or None where the bag has none.

        Args:
            keypoints_topic: Keypoint topic; the CameraInfo with the longest common namespace is chosen.
            name: CameraInfo topic to choose instead.

        Raises:
            InputError: The topic `name` does not exist, or several topics share equally much of the namespace.
        """
        candidates = self.topics_of_type([CAMERA_INFO])
        if name is not None:
            if name not in candidates:
                present = ', '.join(candidates) or 'none'
                raise InputError(f'{self.path}: there is no CameraInfo on {name}; there is {present}')
            return name
        shared = {topic: _count_shared_namespaces(topic, keypoints_topic) for topic in candidates}
        best = [topic for topic in candidates if shared[topic] == max(shared.values())]
        if len(best) > 1:
            raise InputError(
                f'{self.path}: the bag has several CameraInfo topics, choose one with --camera-info: '
                f'{", ".join(best)}'
            )
        return best[0] if best else None

    @property
    def duration_s(self) -> float:
        """Time in s between the first and the last message."""
        return float(self._reader.duration / NS_PER_S)

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of the topics in the order of their log times.

        Args:
            topics: The topics.
            start_ns: Log time before which messages are left out, in ns; None to begin with the first.
            stop_ns: Log time from which on messages are left out, in ns; None to end with the last.

        Raises:
            InputError: The bag is damaged, holds a message type that cannot be converted, or holds fewer messages
                than it states; the last error is raised after all messages, and only if the whole bag is read.
        """
        connections = [c for c in self._connections() if c.topic in topics]
        if not connections:
            return
        converters = {c.id: self._make_converter(c) for c in connections}
        message_count = 0
        try:
            for connection, time_ns, raw in self._reader.messages(connections, start_ns, stop_ns):
                message_count += 1
                data = converters[connection.id](raw)
                yield BagMessage(connection.topic, connection.msgtype, time_ns, data)
        except InputError:
            raise
        except Exception as error:  # the reader of a damaged file may raise anything
            raise self._make_read_error(error) from None
        expected = self.count(topics)
        is_whole = start_ns is None and stop_ns is None
        if is_whole and message_count < expected:
            self._raise_fault(f'only {message_count} of {expected} messages on {", ".join(topics)} could be read')

    def _refuse_hidden_messages(self) -> None:
        """Raise InputError if the files of a bag folder hold messages on a topic that has none by its metadata.

        Readers would take the topic for empty.
        """
        described = {(c.topic, c.msgtype) for c in self._connections() if c.msgcount}
        for storage in () if self._is_ros1 else getattr(self._reader.storage, 'storages', ()):
            for c in storage.connections:
                if c.msgcount and (c.topic, c.msgtype) not in described:
                    self.close()
                    self._raise_fault(
                        f'{METADATA} has no messages of {c.msgtype} on {c.topic}, of which a file has {c.msgcount}'
                    )

    def _connections(self) -> list[Connection]:
        connections: list[Connection] = self._reader.connections
        return connections

    def _make_converter(self, connection: Connection) -> Convert:
        """Return the converter of a topic's messages; types unknown to this package stay as they are."""
        msgtype = connection.msgtype
        is_defined = msgtype in typestore().types
        if not is_defined and not self._is_ros1:
            return bytes
        own_hash = typestore().hash_rihs01(msgtype) if is_defined else ''
        recorded_hash, definition = connection.digest, connection.msgdef.data
        if not self._is_ros1 and (recorded_hash == own_hash or not (recorded_hash or definition)):
            return bytes
        recorded_types = self._load_types(connection)
        if not self._is_ros1 and recorded_types.hash_rihs01(msgtype) == own_hash:
            return bytes
        convert = make_converter(recorded_types, typestore(), msgtype, is_ros1=self._is_ros1)
        if not self._is_ros1:
            return convert_or_keep(convert)

        def convert_ros1(raw: bytes) -> bytes:
            try:
                return convert(raw)
            except InputError as error:
                raise InputError(f'{self.path}: {connection.topic}: {error}') from None

        return convert_ros1

    def _load_types(self, connection: Connection) -> Typestore:
        """Return the message types as the bag defines them.

        Raises:
            InputError: The bag does not define the type of the connection, or the definition cannot be parsed.
        """
        fault = f'{self.path}: {connection.topic} holds another version of {connection.msgtype}'
        definition = connection.msgdef
        if not definition.data:
            raise InputError(f'{fault}, and the bag does not define it')
        is_idl = definition.format != MessageDefinitionFormat.MSG
        try:
            store = load_recorded_types(definition.data, connection.msgtype, is_idl=is_idl)
            store.generate_msgdef(connection.msgtype)
        except Exception as error:  # the parser may raise anything for damaged text
            reason = ' '.join(str(error).split())
            raise InputError(f'{fault}, and its definition cannot be parsed: {reason}') from None
        return store

    def _make_read_error(self, error: Exception) -> InputError:
        """Return the error that reports why the bag cannot be read."""
        if isinstance(error, OSError) and error.strerror:
            return InputError(f'{self.path}: {error.strerror}')
        reason = describe_error(error)
        advice = f'; {_recommend_repair(self.path)}' if _is_repairable(self.path) else ''
        return InputError(f'{self.path}: the bag cannot be read: {reason}{advice}')

    def _raise_fault(self, fault: str) -> None:
        """Raise InputError unless the description of the fault is empty."""
        if fault:
            raise InputError(f'{self.path}: {fault}; {_recommend_repair(self.path)}')


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag, even if the bag cannot be read."""
    has_suffix = path.suffix in (*ROS2_SUFFIXES, ROS1_SUFFIX)
    return has_suffix or (path / METADATA).is_file() or bool(list_bag_files(path))


def list_bag_files(folder: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers; none where the path is not a folder."""
    if not folder.is_dir():
        return []
    files = [f for f in folder.iterdir() if f.suffix in ROS2_SUFFIXES and (f.is_file() or f.is_symlink())]
    return sorted(files, key=lambda file: find_number_and_name(file.name))


def find_database_log(file: Path) -> Path:
    """Return the path of the write-ahead log that SQLite keeps beside a database."""
    return file.with_name(f'{file.name}-wal')


def find_number_and_name(name: str) -> tuple[int, str]:
    """Return the number at the end of the stem of a file's name, -1 where there is none, and the name."""
    number = re.search(r'(\d+)$', PurePosixPath(name).stem)
    return int(number[1]) if number else -1, name


def _check_metadata_text(path: Path) -> None:
    """Raise InputError if a metadata.yaml, where there is one, is too large or not UTF-8."""
    if not path.is_file():
        return
    if path.stat().st_size > MAX_METADATA_BYTES:
        raise InputError(
            f'{path}: larger than {MAX_METADATA_BYTES >> 20} MiB, as the bag has too many topics or files; its '
            'files can be read one by one'
        )
    try:
        path.read_text(encoding='utf-8')
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: not UTF-8 at byte {error.start}; {_recommend_repair(path.parent)}') from None


def _count_shared_namespaces(topic: str, reference: str) -> int:
    """Return how many leading parts of the namespaces of two topics are equal."""
    parts = zip(PurePosixPath(topic).parent.parts, PurePosixPath(reference).parent.parts, strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], parts)))


def _recommend_repair(path: Path) -> str:
    if path.suffix == ROS1_SUFFIX:
        return '`rosbag reindex` may repair it'
    return f'`mocap-ros recover {path}` saves the messages that can be read'


def _is_repairable(path: Path) -> bool:
    """Return whether the path is or holds a file from which messages might be recovered."""
    if path.suffix == ROS1_SUFFIX:
        return path.is_file()
    for file in list_bag_files(path) or [path]:
        with suppress(OSError), file.open('rb') as stream:
            if stream.read(len(MAGIC)) == MAGIC or (file.suffix == '.db3' and file.stat().st_size):
                return True
    return False


def _find_fault(path: Path) -> str:
    """Describe the fault of a bag whose recorder was killed; return an empty string where none is found."""
    files = list_bag_files(path)
    for file in files or [path]:
        with suppress(OSError):
            if file.suffix == '.mcap' and (fault := _find_mcap_fault(file)):
                return f'{fault} ({file.name})'
            log = find_database_log(file)
            if file.suffix == '.db3' and log.is_file() and log.stat().st_size:
                return f'the recording was cut off: {log.name} holds messages that are not in {file.name} yet'
    if files and not (path / METADATA).exists():
        return f'the recording was not finished: {METADATA} is missing'
    return ''


def _find_mcap_fault(file: Path) -> str:
    """Describe a missing end or a damaged index of an MCAP file; return an empty string where both are intact."""
    with file.open('rb') as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return ''
        try:
            read_summary(stream)
        except EOFError:
            return 'the recording was cut off'
        except PARSE_ERRORS:
            return 'the index is damaged'
    return ''
