# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of bags of ROS 2 (MCAP or SQLite3; a folder or a bare file) and ROS 1.

Messages are read one at a time. Damage is always reported as an error; no message is omitted silently.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import islice, takewhile
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import apsw
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Qos, QosDurability
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import storage_mcap, storage_sqlite3
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import get_msgdef

from mocap_ros.bags.mcap_scan import MAGIC, PARSE_ERRORS, read_summary
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.errors import MALFORMED, InputError, describe_parse_error, name_errors
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
MAX_QOS_TEXTS = 256  # different QoS profiles that are remembered


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
            if fault := _find_fault(self.path):
                raise InputError(self._advise(fault))
            self._reader = Ros1Reader(self.path) if self._is_ros1 else Ros2Reader(self.path)
            self._reader.open()
            self._connections: list[Connection] = [*self._reader.connections]
            self._types = {c.id: _find_known_type(c) for c in self._connections}
            self.duration_s = float(self._reader.duration / NS_PER_S)
            self.count(self.topics)  # what a damaged metadata.yaml states may be no number
        except InputError:
            raise
        except Exception as error:  # the reader of a damaged file may raise anything
            self.close()
            raise self._make_read_error(error) from None

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
        try:
            for connection, time_ns, raw in self._reader.messages(connections, start_ns, stop_ns):
                message_count += 1
                data = converters[connection.id](raw)
                yield BagMessage(connection.topic, self._types[connection.id], time_ns, data)
        except InputError:
            raise
        except Exception as error:  # the reader of a damaged file may raise anything
            raise self._make_read_error(error) from None
        expected = self.count(topics)
        if start_ns is None and stop_ns is None and message_count < expected:
            names = ', '.join(topics)
            raise InputError(self._advise(f'only {message_count} of {expected} messages on {names} could be read'))

    def _make_converter(self, connection: Connection) -> Convert:
        """Return the converter of a topic's messages; types unknown to this package stay as they are."""
        recorded_type, definition, is_ros1 = connection.msgtype, connection.msgdef, self._is_ros1
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
        reason = describe_error(error)
        if self.path.is_dir() and isinstance(error.__cause__ or error, MALFORMED):
            reason = f'{METADATA} does not have the form of rosbag2'
        fault = f'the bag cannot be read: {reason}'
        files = [f for f in list_bag_files(self.path) or [self.path] if f.is_file()]
        is_repairable = self._is_ros1 or any(f.suffix == '.db3' or _is_mcap(f) for f in files)
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
    msgtype, text = find_current_type(connection.msgtype), connection.msgdef.data
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


def _is_mcap(file: Path) -> bool:
    with suppress(OSError), file.open('rb') as stream:
        return stream.read(len(MAGIC)) == MAGIC
    return False


def _find_fault(path: Path) -> str:
    """Describe the fault of a bag whose recorder was killed; return an empty string where none is found."""
    files = list_bag_files(path)
    for file in files or [path]:
        if file.suffix == '.mcap' and file.is_file() and _is_mcap(file):
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


def describe_error(error: Exception) -> str:
    """Return in one line why a file cannot be read.

    A reader that believes a damaged length may ask for more memory than there is; its MemoryError has no text.
    """
    if isinstance(error, MemoryError):
        return 'a length in it is damaged, or there is too little memory'
    if isinstance(error, UnicodeDecodeError):
        return f'not UTF-8 at byte {error.start} of a text in it'
    return describe_parse_error(error).rstrip('.') or type(error).__name__


def _get_definition(schema: Any) -> MessageDefinition:
    """Return the definition of a schema; none where rosbag2 has found none and states the language `unknown`."""
    try:
        return get_msgdef(schema)
    except KeyError:
        return MessageDefinition(MessageDefinitionFormat.NONE, '')


class _Database(apsw.Connection):
    """A database of a bag, without the definitions of message types in languages that rosbags does not know."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        # SQLite looks for a name among what is temporary first, also in a database that is read only.
        self.execute(
            'CREATE TEMP VIEW message_definitions AS SELECT * FROM main.message_definitions '
            "WHERE encoding IN ('ros2msg', 'ros2idl')"
        )


def _open_storage(path: Any) -> Any:
    """Return the reader of a file of a bag, by the file: the metadata may name no storage."""
    is_database = path.suffix == '.db3' and not _is_mcap(path)
    return storage_sqlite3.Sqlite3Reader(path) if is_database else storage_mcap.McapReader(path)


def _adapt_rosbags() -> None:
    """Replace what rosbags does otherwise, as it is no parameter of its readers.

    They refuse an empty name of the storage and unknown definitions, and parse the QoS profiles of every topic
    anew, which takes 4 ms; most topics have the same.
    """
    mcap, sqlite3 = cast(Any, storage_mcap), cast(Any, storage_sqlite3)
    DirectoryReader.STORAGE_PLUGINS = cast(Any, dict.fromkeys(('mcap', 'sqlite3', '', None), _open_storage))
    mcap.get_msgdef = _get_definition
    sqlite3.apsw = SimpleNamespace(**{**vars(apsw), 'Connection': _Database})
    mcap.parse_qos = sqlite3.parse_qos = lru_cache(MAX_QOS_TEXTS)(parse_qos)


_adapt_rosbags()
