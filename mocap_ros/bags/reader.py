# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of bags of ROS 2 (MCAP or SQLite3; a folder or a bare file) and ROS 1.

Messages are read one at a time. Damage is always reported as an error; no message is omitted silently.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice, takewhile
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat, Qos, QosDurability

from mocap_ros.bags.mcap_scan import MAGIC, PARSE_ERRORS, begins_with, read_summary
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.bags.storages import READ_ERRORS, FolderReader, Messages, Ros1Reader, choose_storage, describe_error
from mocap_ros.errors import InputError, describe_parse_error, name_errors
from mocap_ros.messages.camera_info import CAMERA_INFO, may_be_one_camera
from mocap_ros.messages.cdr import read_frame_id, typestore
from mocap_ros.messages.foreign_types import INPUT_DEFINITIONS, find_current_type
from mocap_ros.messages.versions import (
    MAX_DEFINITION_CHARACTERS,
    Convert,
    convert_or_keep,
    load_recorded_types,
    make_converter,
)
from mocap_ros.units import NS_PER_S

if TYPE_CHECKING:
    from typing_extensions import Self

ROS2_SUFFIXES = ('.mcap', '.db3')  # of the files of ROS 2 bags
ROS1_SUFFIX = '.bag'  # of ROS 1 bags
MAX_HEADERS = 100  # messages of a topic in which a `frame_id` is searched; few detectors leave only some empty


class BagMessage(NamedTuple):
    """A message of a bag: absolute name of the topic, message type, log time in ns, and the message as CDR."""

    topic: str
    type: str
    time_ns: int
    raw: bytes


class Bag:
    """A bag that is open for reading; a context manager that closes it.

    Messages of types that this package defines are returned as CDR of that definition. If the bag holds another
    version of the type, or is a ROS 1 bag, the messages are converted field by field. Bytes that are no message of
    their type are returned as they are; whoever decodes them reports them.

    The path is a folder with a metadata.yaml, or a .mcap, .db3 or .bag file. Bags in MCAP may be on another file
    system, as an object with the methods of a path (`upath.UPath`). `duration_s` is the time between the first and
    the last message.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path) if isinstance(path, str) else path
        self._is_ros1 = self.path.suffix == ROS1_SUFFIX
        self._reader: Any = None
        if self.path.exists() and not (self.path.is_dir() or self.path.is_file()):
            raise InputError(f'{self.path}: neither a file nor a folder')
        try:
            with self._reading():
                if fault := _find_fault(self.path):
                    raise InputError(self._advise(fault))
                self._reader = self._choose_reader()
                self._reader.open()
                self._connections: list[Connection] = [*self._reader.connections]
                self.duration_s = float(self._reader.duration / NS_PER_S)
        except InputError:
            self.close()
            raise
        self._types = {c.id: _find_known_type(c) for c in self._connections}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        with suppress(Exception):  # of a reader that is closed, or was never opened
            self._reader.close()

    @property
    def topics(self) -> dict[str, str]:
        """Message types by topic; those of packages that have been renamed have their new names."""
        return {c.topic: self._types[c.id] for c in self._connections}

    @property
    def qos(self) -> dict[str, list[Qos]]:
        """QoS profiles that the recorded publishers offered, by topic; empty where the bag does not hold them."""
        return {c.topic: getattr(c.ext, 'offered_qos_profiles', []) for c in self._connections}

    @property
    def latched_topics(self) -> set[str]:
        """Topics of which a late subscriber receives the last message (durability transient local)."""
        latched = QosDurability.TRANSIENT_LOCAL
        return {topic for topic, profiles in self.qos.items() if latched in {q.durability for q in profiles}}

    def count(self, topics: Collection[str]) -> int:
        """Return the number of messages on the topics."""
        return sum(c.msgcount for c in self._connections if c.topic in topics)

    def topics_of_type(self, types: Collection[str]) -> list[str]:
        """Return the topics that have one of the message types and hold messages."""
        return list(dict.fromkeys(c.topic for c in self._connections if self._types[c.id] in types and c.msgcount))

    def find_frame_id(self, topics: Collection[str]) -> str:
        """Return the first `header.frame_id` on the topics that is not empty, if it is in the first messages."""
        names = (read_frame_id(m.raw) for m in islice(self.messages(topics), MAX_HEADERS))
        return next(filter(None, names), '')

    def find_camera_info_topic(self, keypoints_topics: Sequence[str], name: str | None = None) -> str | None:
        """Return the CameraInfo topic of the camera of the keypoints, or that of this `name`.

        Of several it is one of their `frame_id`, and of these that which shares most of the namespace of the first
        topic. It is None where the bag has no CameraInfo.
        """
        candidates = self.topics_of_type([CAMERA_INFO])
        if name is not None:
            if name not in candidates:
                present = ', '.join(candidates) or 'none'
                raise InputError(f'{self.path}: there is no CameraInfo on {name}; there is {present}')
            return name
        if len(candidates) > 1:
            frame_id = self.find_frame_id(keypoints_topics)
            own = [t for t in candidates if may_be_one_camera(frame_id, self.find_frame_id([t]))]
            candidates = own or candidates[:1]  # of another camera none is used
        shared = {topic: _count_shared_namespaces(topic, keypoints_topics[0]) for topic in candidates}
        best = [topic for topic in candidates if shared[topic] == max(shared.values())]
        if len(best) > 1:
            raise InputError(
                f'{self.path}: the bag has several CameraInfo topics, choose one with --camera-info: '
                f'{", ".join(best)}'
            )
        return best[0] if best else None

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of the topics in the order of log times, from `start_ns` to before `stop_ns`."""
        connections = [c for c in self._connections if c.topic in topics]
        if not connections:
            return
        converters = {c.id: self._make_converter(c) for c in connections}
        message_count = 0
        for connection, time_ns, raw in self._read(connections, start_ns, stop_ns):
            message_count += 1
            data = converters[connection.id](raw)
            yield BagMessage(connection.topic, self._types[connection.id], time_ns, data)
        expected = self.count(topics)
        if start_ns is None and stop_ns is None and message_count < expected:
            names = ', '.join(topics)
            raise InputError(self._advise(f'only {message_count} of {expected} messages on {names} could be read'))

    def _read(self, connections: Collection[Connection], start_ns: int | None, stop_ns: int | None) -> Messages:
        with self._reading():
            yield from self._reader.messages(connections, start_ns, stop_ns)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Raise InputError for what the reader raises in the block where the bag is damaged."""
        errors = (Exception,) if self._is_ros1 else READ_ERRORS
        try:
            yield
        except InputError:
            raise
        except errors as error:
            raise self._make_read_error(error) from None

    def _choose_reader(self) -> Any:
        if self._is_ros1:
            return Ros1Reader(self.path)
        if self.path.is_dir():
            return FolderReader(self.path)
        if not self.path.exists() or self.path.suffix not in ROS2_SUFFIXES:
            fault = 'it is no file of a bag' if self.path.exists() else 'it does not exist'
            raise InputError(f'{self.path}: {fault}')
        return choose_storage(self.path)

    def _make_converter(self, connection: Connection) -> Convert:
        """Return the converter of a topic's messages; types unknown to this package stay as they are."""
        recorded_type = connection.msgtype
        definition = connection.msgdef
        is_ros1 = self._is_ros1
        msgtype = self._types[connection.id]
        own_hash = typestore().hash_rihs01(msgtype) if msgtype in typestore().types else ''
        if not is_ros1 and (not own_hash or connection.digest == own_hash):
            return bytes
        if not is_ros1 and not (connection.digest or definition.data):
            return bytes
        fault = f'{self.path}: {connection.topic} holds another version of {msgtype}'
        if not definition.data:
            raise InputError(f'{fault}, and the bag does not define it')
        is_idl = definition.format != MessageDefinitionFormat.MSG
        try:
            store = load_recorded_types(definition.data, recorded_type, is_idl=is_idl)
            store.generate_msgdef(recorded_type)
            recorded_hash = store.hash_rihs01(recorded_type)
        except Exception as error:  # the parser may raise anything for damaged text
            reason = describe_parse_error(error)
            raise InputError(f'{fault}, and its definition cannot be parsed: {reason}') from None
        if not is_ros1 and recorded_hash == own_hash:
            return bytes
        convert = make_converter(store, typestore(), recorded_type, msgtype, is_ros1=is_ros1)
        if not is_ros1:
            return convert_or_keep(convert)

        def convert_ros1(raw: bytes) -> bytes:
            with name_errors(f'{self.path}: {connection.topic}'):
                return convert(raw)

        return convert_ros1

    def _make_read_error(self, error: Exception) -> InputError:
        if isinstance(error, OSError) and error.strerror:
            return InputError(f'{self.path}: {error.strerror}')
        fault = f'the bag cannot be read: {describe_error(error)}'
        files = [f for f in list_bag_files(self.path) or [self.path] if f.is_file()]
        is_repairable = self._is_ros1 or any(f.suffix == '.db3' or begins_with(f, MAGIC) for f in files)
        return InputError(self._advise(fault) if files and is_repairable else f'{self.path}: {fault}')

    def _advise(self, fault: str) -> str:
        repair = f'`mocap-ros recover {self.path}` saves the messages that can be read'
        return f'{self.path}: {fault}; {"`rosbag reindex` may repair it" if self._is_ros1 else repair}'


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


def _find_known_type(connection: Connection) -> str:
    """Return the type of a topic, by its name of today where a package has been renamed.

    A type of an unknown package that has the name and the definition of a type of keypoints is that type.
    """
    msgtype = find_current_type(connection.msgtype)
    text = connection.msgdef.data
    package, _, name = msgtype.partition('/')
    if msgtype in typestore().types or not text or len(text) > MAX_DEFINITION_CHARACTERS:
        return msgtype
    for known in INPUT_DEFINITIONS:
        known_package, _, known_name = known.partition('/')
        if name == known_name:
            renamed = re.sub(rf'\b{re.escape(package)}\b', known_package, text)
            is_idl = connection.msgdef.format != MessageDefinitionFormat.MSG
            with suppress(Exception):  # the parser may raise anything for damaged text
                recorded = load_recorded_types(renamed, known, is_idl=is_idl)
                if recorded.hash_rihs01(known) == typestore().hash_rihs01(known):
                    return known
    return msgtype


def _count_shared_namespaces(topic: str, reference: str) -> int:
    parts = zip(PurePosixPath(topic).parent.parts, PurePosixPath(reference).parent.parts, strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], parts)))


def _find_fault(path: Path) -> str:
    """Describe the fault of a bag whose recorder was killed; return an empty string where none is found."""
    files = list_bag_files(path)
    for file in files or [path]:
        if file.suffix == '.mcap' and file.is_file() and begins_with(file, MAGIC):
            with file.open('rb') as stream:
                try:
                    read_summary(stream)
                except EOFError:
                    return f'the recording was cut off ({file.name})'
                except PARSE_ERRORS:
                    return f'the index is damaged ({file.name})'
        log = find_database_log(file)
        if file.suffix == '.db3' and log.is_file() and log.stat().st_size:
            return f'the recording was cut off: {log.name} holds messages that are not in {file.name} yet'
    if files and not (path / METADATA).exists():
        return f'the recording was not finished: {METADATA} is missing'
    return ''
