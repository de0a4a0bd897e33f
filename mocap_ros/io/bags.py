"""Reading rosbag2 bags, MCAP or SQLite3: a folder or a bare file, one message at a time.

Only the raw bytes are read; the type definitions that a bag brings along are not used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from os import SEEK_END
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

from mcap.reader import NonSeekingReader
from rosbags.rosbag2 import Reader

from mocap_ros.config import Value
from mocap_ros.errors import InputError
from mocap_ros.io.journal import INPUT, JOURNAL, PARAMETERS, Entry, Verdict, decode_entry
from mocap_ros.io.messages import KEYPOINT_TYPES, typestore

if TYPE_CHECKING:
    from typing_extensions import Self


MAGIC = b'\x89MCAP0\r\n'
ENDINGS = ('.mcap', '.db3')
METADATA = 'metadata.yaml'


class BagMessage(NamedTuple):
    """A message as it was recorded; `time_ns` is its log time."""

    topic: str
    type: str
    time_ns: int
    raw: bytes


class Bag:
    """A bag open for reading; a context manager.

    Args:
        path: folder with a metadata.yaml, or a .mcap or .db3 file.

    Raises:
        InputError: no bag, or one that cannot be read; names it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._reader = Reader(self.path)
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
        return {c.topic: c.msgtype for c in self._reader.connections}

    def count(self, topics: Collection[str]) -> int:
        """Messages on these topics."""
        return sum(c.msgcount for c in self._reader.connections if c.topic in topics)

    def of_type(self, types: Collection[str]) -> list[str]:
        """Topics of any of these types that hold messages."""
        return [c.topic for c in self._reader.connections if c.msgtype in types and c.msgcount]

    def keypoints_topic(self, name: str | None = None) -> str:
        """The topic of 2D keypoints: the one of that name, or the only one there is.

        Raises:
            InputError: there is none, or more than one; lists the topics of the bag.
        """
        found = self.of_type(KEYPOINT_TYPES)
        if name is not None:
            found = [t for t in found if t == name]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f'{self.path}: several keypoint topics, choose one: {", ".join(found)}')
        wanted = f'topic {name}' if name else 'topic'
        there = ', '.join(f'{t} ({kind})' for t, kind in self.topics.items()) or 'nothing'
        raise InputError(f'{self.path}: no {wanted} of {" or ".join(KEYPOINT_TYPES)}; the bag has {there}')

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages of these topics in the order of their log times.

        Raises:
            InputError: the bag is broken, or holds another version of a message type.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        for c in connections:
            known = typestore().types
            if c.digest and c.msgtype in known and c.digest != typestore().hash_rihs01(c.msgtype):
                raise InputError(f'{self.path}: {c.topic} holds another version of {c.msgtype}')
        try:
            for connection, time_ns, raw in self._reader.messages(connections):
                yield BagMessage(connection.topic, connection.msgtype, time_ns, bytes(raw))
        except Exception as error:  # as above
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> InputError:
        if isinstance(error, OSError) and error.strerror:
            return InputError(f'{self.path}: {error.strerror}')
        reason = ' '.join(str(error).split()).rstrip('.') or type(error).__name__
        return InputError(f'{self.path}: {_unfinished(self.path) or f"not a bag that can be read: {reason}"}')


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag, readable or not."""
    return path.suffix in ENDINGS or (path / METADATA).is_file() or bool(_files_in(path))


def _files_in(folder: Path) -> list[Path]:
    return sorted(f for f in folder.iterdir() if f.suffix in ENDINGS) if folder.is_dir() else []


def _unfinished(path: Path) -> str:
    """What is left of a recording whose recorder was killed; empty where something else is wrong."""
    files = _files_in(path)
    for file in [path] if path.is_file() else files:
        with file.open('rb') as stream:
            start = stream.read(len(MAGIC))
            stream.seek(-min(len(MAGIC), file.stat().st_size), SEEK_END)
            if start == MAGIC and stream.read() != MAGIC:
                stream.seek(0)
                return (
                    f'the recording was cut off, {_readable_messages(stream)} messages are left; '
                    'not finished (`mcap recover` makes it whole)'
                )
    if files and not (path / METADATA).exists():
        return f'the recording was not finished: no {METADATA}; give {files[0].name} instead'
    return ''


def _readable_messages(stream: IO[bytes]) -> int:
    number = 0
    with suppress(Exception):  # the end is missing
        for _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
            number += 1
    return number


class Run(NamedTuple):
    """What the journal of a recorded run says.

    Attributes:
        parameters: at the beginning, by name; empty where there is no journal.
        unseen: numbers of the inputs that never reached the tracker.
        events: resets and changes of parameters, by the number of the input before them.
    """

    parameters: dict[str, Value]
    unseen: frozenset[int]
    events: dict[int, list[Entry]]


def read_run(bag: Bag) -> Run:
    """What happened in the run that this bag recorded; an empty run where it has no journal.

    Raises:
        InputError: the bag is broken.
    """
    topics = [t for t in bag.of_type([JOURNAL]) if t.endswith('/journal')]
    parameters: dict[str, Value] = {}
    unseen: set[int] = set()
    events: dict[int, list[Entry]] = {}
    for message in bag.messages(topics):
        entry = decode_entry(message.raw)
        if entry.kind == INPUT:
            if entry.verdict is Verdict.OVERTAKEN:
                unseen.add(entry.number)
        elif entry.kind == PARAMETERS and not entry.number and not parameters:
            parameters = dict(entry.parameters)
        else:
            events.setdefault(entry.number, []).append(entry)
    return Run(parameters, frozenset(unseen), events)
