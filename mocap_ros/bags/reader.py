"""Reading bags of ROS 2 (MCAP, SQLite3; a folder or a bare file) and ROS 1, one message at a time.

Whatever cannot be read is an error that says so; nothing is left out silently.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from itertools import takewhile
from os import SEEK_END
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.convert.converter import migrate_bytes
from rosbags.interfaces import Connection, MessageDefinitionFormat, Qos
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.bags.mcap_scan import MAGIC
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.errors import InputError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import WORD, typestore

if TYPE_CHECKING:
    from typing_extensions import Self

ENDINGS = ('.mcap', '.db3')
ROS1_ENDING = '.bag'
IDL_HEADING = re.compile(r'^={80}\nIDL: .*\n', re.MULTILINE)
FOOTER = struct.Struct('<QQI')

Convert = Callable[[bytes], bytes]


class BagMessage(NamedTuple):
    """A message as it was recorded; `time_ns` is its log time."""

    topic: str
    type: str
    time_ns: int
    raw: bytes


class Bag:
    """A bag open for reading; a context manager.

    Messages of types that we know come as CDR of our definition of them: where the bag has another version, or is
    of ROS 1, they are converted field by field.

    Args:
        path: folder with a metadata.yaml, or a .mcap, .db3 or .bag file.

    Raises:
        InputError: no bag, or one that cannot be read; names it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._ros1 = self.path.suffix == ROS1_ENDING
        if self.path.exists() and not (self.path.is_dir() or self.path.is_file()):
            raise InputError(f'{self.path}: neither a file nor a folder')
        self._damaged(_unfinished(self.path))
        try:
            self._reader: Any = Ros1Reader(self.path) if self._ros1 else Ros2Reader(self.path)
            self._reader.open()
        except Exception as error:  # the reader of a broken file may raise anything
            raise self._unreadable(error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the files."""
        with suppress(Exception):
            self._reader.close()

    @property
    def topics(self) -> dict[str, str]:
        """Types by topic."""
        return {c.topic: c.msgtype for c in self._connections()}

    @property
    def qos(self) -> dict[str, list[Qos]]:
        """Profiles that the recorded publishers offered, by topic; empty where the bag does not say."""
        return {c.topic: getattr(c.ext, 'offered_qos_profiles', []) for c in self._connections()}

    def count(self, topics: Collection[str]) -> int:
        """Messages on these topics."""
        return sum(c.msgcount for c in self._connections() if c.topic in topics)

    def of_type(self, types: Collection[str]) -> list[str]:
        """Topics of any of these types that hold messages."""
        return list(dict.fromkeys(c.topic for c in self._connections() if c.msgtype in types and c.msgcount))

    def camera_info_topic(self, keypoints: str, name: str | None = None) -> str | None:
        """The CameraInfo that goes with a keypoint topic, or None where the bag has none.

        Args:
            keypoints: the topic; of several cameras the one whose name shares most with it is taken.
            name: of the wanted topic.

        Raises:
            InputError: there is none of that name, or several fit equally well.
        """
        found = self.of_type([CAMERA_INFO])
        if name is not None:
            if name not in found:
                raise InputError(f'{self.path}: no CameraInfo on {name}; there is {", ".join(found) or "none"}')
            return name
        shared = {t: _shared_namespace(t, keypoints) for t in found}
        best = [t for t in found if shared[t] == max(shared.values())]
        if len(best) > 1:
            raise InputError(f'{self.path}: several CameraInfo topics, choose one: {", ".join(best)}')
        return best[0] if best else None

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages of these topics in the order of their log times.

        Raises:
            InputError: the bag is broken, holds a message type that cannot be converted into ours, or at the end
                fewer messages than it says.
        """
        connections = [c for c in self._connections() if c.topic in topics]
        if not connections:
            return
        convert = {c.id: self._converter(c) for c in connections}
        number = 0
        try:
            for connection, time_ns, raw in self._reader.messages(connections):
                number += 1
                data = convert[connection.id](raw)
                yield BagMessage(connection.topic, connection.msgtype, time_ns, data)
        except InputError:
            raise
        except Exception as error:  # as above
            raise self._unreadable(error) from None
        if number < self.count(topics):
            self._damaged(f'only {number} of {self.count(topics)} messages on {", ".join(topics)} could be read')

    def _connections(self) -> list[Connection]:
        connections: list[Connection] = self._reader.connections
        return connections

    def _converter(self, connection: Connection) -> Convert:
        """From the bytes in the bag to CDR of our version of the type; bytes as they are for types not ours."""
        kind = connection.msgtype
        if kind not in typestore().types and not self._ros1:
            return bytes
        ours = typestore().hash_rihs01(kind) if kind in typestore().types else ''
        said, definition = connection.digest, connection.msgdef.data
        if not self._ros1 and (said == ours or not (said or definition)):
            return bytes
        there = self._types_of(connection)
        if not self._ros1 and there.hash_rihs01(kind) == ours:
            return bytes
        cache: dict[str, object] = {}

        def convert(raw: bytes) -> bytes:
            try:
                data = bytes(
                    migrate_bytes(there, typestore(), kind, kind, cache, raw, src_is2=not self._ros1, dst_is2=True)
                )
            except Exception as error:  # as above
                raise InputError(f'{self.path}: {connection.topic}: not a {kind} ({error})') from None
            return data + bytes(-len(data) % WORD)

        return convert

    def _types_of(self, connection: Connection) -> Typestore:
        """The types as the bag defines them.

        Raises:
            InputError: it does not, or in a way that cannot be read.
        """
        what = f'{self.path}: {connection.topic} holds another version of {connection.msgtype}'
        definition = connection.msgdef
        store = get_typestore(Stores.EMPTY)
        try:
            if definition.format == MessageDefinitionFormat.MSG:
                store.register(get_types_from_msg(definition.data, connection.msgtype))
            else:
                for text in IDL_HEADING.split(definition.data):
                    store.register(get_types_from_idl(text) if text.strip() else {})
            if definition.data:
                store.generate_msgdef(connection.msgtype)  # fails where a part is missing
        except Exception as error:  # as above
            reason = ' '.join(str(error).split())
            raise InputError(f'{what}, and its definition cannot be read: {reason}') from None
        if connection.msgtype not in store.types:
            raise InputError(f'{what}, and no definition of it')
        return store

    def _unreadable(self, error: Exception) -> InputError:
        if isinstance(error, OSError) and error.strerror:
            return InputError(f'{self.path}: {error.strerror}')
        reason = ' '.join(str(error).split()).rstrip('.') or type(error).__name__
        advice = f'; {_advice(self.path)}' if _may_be_mended(self.path) else ''
        return InputError(f'{self.path}: not a bag that can be read: {reason}{advice}')

    def _damaged(self, what: str) -> None:
        if what:
            raise InputError(f'{self.path}: {what}; {_advice(self.path)}')


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag, readable or not."""
    return path.suffix in (*ENDINGS, ROS1_ENDING) or (path / METADATA).is_file() or bool(files_in(path))


def files_in(folder: Path) -> list[Path]:
    """Files of a bag, in the order of their numbers."""

    def number(path: Path) -> tuple[int, str]:
        found = re.search(r'(\d+)$', path.stem)
        return int(found[1]) if found else -1, path.name

    if not folder.is_dir():
        return []
    found = [f for f in folder.iterdir() if f.suffix in ENDINGS and (f.is_file() or f.is_symlink())]
    return sorted(found, key=number)


def _shared_namespace(one: str, other: str) -> int:
    parts = zip(PurePosixPath(one).parent.parts, PurePosixPath(other).parent.parts, strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], parts)))


def _advice(path: Path) -> str:
    if path.suffix == ROS1_ENDING:
        return '`rosbag reindex` may mend it'
    return f'`mocap-ros recover {path}` saves what is left'


def _may_be_mended(path: Path) -> bool:
    """Whether there are files that can be mended."""
    if path.suffix == ROS1_ENDING:
        return path.is_file()
    for file in files_in(path) or [path]:
        with suppress(OSError), file.open('rb') as stream:
            if stream.read(len(MAGIC)) == MAGIC or (file.suffix == '.db3' and file.stat().st_size):
                return True
    return False


def _unfinished(path: Path) -> str:
    """What is wrong with a bag whose recorder was killed; empty where nothing is, or something else."""
    files = files_in(path)
    for file in files or [path]:
        with suppress(OSError):
            if file.suffix == '.mcap' and (wrong := _mcap_fault(file)):
                return f'{wrong} ({file.name})'
            journal = file.with_name(f'{file.name}-wal')
            if file.suffix == '.db3' and journal.is_file() and journal.stat().st_size:
                return f'the recording was cut off: {journal.name} holds messages that are not in {file.name} yet'
    if files and not (path / METADATA).exists():
        return f'the recording was not finished: no {METADATA}'
    return ''


def _mcap_fault(file: Path) -> str:
    with file.open('rb') as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return ''
        size = stream.seek(0, SEEK_END)
        stream.seek(-min(len(MAGIC) + FOOTER.size, size), SEEK_END)
        end = stream.read()
        if not end.endswith(MAGIC) or len(end) < len(MAGIC) + FOOTER.size:
            return 'the recording was cut off'
        start, _, crc = FOOTER.unpack_from(end)
        checked = size - start - len(MAGIC) - 4
        if start and crc:
            stream.seek(min(start, size))
            if checked < 0 or zlib.crc32(stream.read(checked)) != crc:
                return 'the index is damaged'
    return ''
