"""A whole bag out of one whose recorder was killed, whose disk was full or that was damaged."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import Content, Salvage
from mocap_ros.bags.reader import ENDINGS, files_in
from mocap_ros.bags.recorder import Recorder, partial_of
from mocap_ros.bags.rosbag2 import ROSBAG2, Topic, known_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.messages.cdr import typestore

ROWS = 1000
BARREN = 100  # ranges of so many rows without any, after which no more are looked for
LEAST_ROW = 8  # bytes
UNREADABLE = (sqlite3.Error, ValueError, TypeError)

Watch = Callable[[int, int], None]


@dataclass
class Recovered:
    """What a recovery found.

    Attributes:
        messages: written, by topic.
        losses: what could not be read, one line each, naming the file.
    """

    messages: Counter[str] = field(default_factory=Counter)
    losses: list[str] = field(default_factory=list)


def recover(path: Path, out: Path, watch: Watch = lambda *_: None) -> Recovered:
    """Write a new bag with everything that can be read of another.

    The new bag is called `<out>.partial` until it is complete; what fails or is interrupted leaves nothing.

    Args:
        path: bag folder, or a .mcap or .db3 file; it stays as it is.
        out: folder of the new bag.
        watch: told now and then how many bytes of how many are done.

    Raises:
        InputError: there is no file of a bag, or none holds anything that could be read.
        RecordingError: the new bag cannot be written.
    """
    files = files_in(path) if path.is_dir() else [path]
    if not files or not all(f.suffix in ENDINGS for f in files):
        raise InputError(f'{path}: no bag folder, .mcap or .db3 file (ROS 1: `rosbag reindex` mends a .bag)')
    found = Recovered()
    sizes = [_size(f) for f in files]
    partial = partial_of(out)
    with Recorder(partial, RecorderConfig(min_free_mb=0), name=out.name) as recorder:
        try:
            for number, file in enumerate(files):
                copy = _Copy(file, recorder, found)
                before = sum(sizes[:number])
                for done in copy.mcap() if file.suffix == '.mcap' else copy.sqlite():
                    watch(before + done, sum(sizes))
            if not found.messages:
                reasons = '; '.join(found.losses) or 'no messages in it'
                raise InputError(f'nothing to recover: {reasons}')
            recorder.close()
            partial.rename(out)
        except BaseException as error:
            recorder.remove()
            if isinstance(error, OSError):
                raise RecordingError(f'{out}: {error.strerror}') from None
            raise
    return found


def _size(file: Path) -> int:
    try:
        size = file.stat().st_size
    except OSError as error:
        raise InputError(f'{file}: {error.strerror}') from None
    if not file.is_file():
        raise InputError(f'{file}: not a file')
    return size


class _Copy:
    """Copies one file; what it yields is how far it has got."""

    def __init__(self, file: Path, recorder: Recorder, found: Recovered) -> None:
        self._file = file
        self._recorder = recorder
        self._found = found
        self._refused: Counter[str] = Counter()

    def mcap(self) -> Iterator[int]:
        """An MCAP file."""
        salvage = Salvage(self._file)
        if not salvage.is_mcap:
            self._lose('no MCAP file')
            return
        attachments = set()
        for one in salvage:
            if isinstance(one, AttachmentRecord):
                if one.name not in attachments:
                    attachments.add(one.name)
                    self._recorder.attach(Attachment(one.name, one.media_type, one.data), one.log_time)
            elif isinstance(one, MetadataRecord):
                if one.name != ROSBAG2:
                    self._recorder.note(one.name, one.metadata)
            elif _is_ros2(one):
                m, channel = one.message, one.channel
                if self._topic(channel.topic, _type(one), lambda: _topic(one)):  # noqa: B023
                    self._write(channel.topic, _type(one), m.data, m.log_time, m.publish_time)
            else:
                self._refused[f'{one.channel.topic}: {one.channel.message_encoding}, not a message of ROS 2'] += 1
            yield salvage.done
        self._tell_refused()
        self._found.losses += [f'{self._file}: {loss}' for loss in salvage.losses]

    def sqlite(self) -> Iterator[int]:
        """A SQLite3 file, with what its journal still holds."""
        size = _size(self._file)
        try:
            with closing(sqlite3.connect(f'{self._file.resolve().as_uri()}?mode=ro', uri=True)) as base:
                base.execute('PRAGMA writable_schema=ON')  # else SQLite opens no file that was cut off
                topics = self._sqlite_topics(base)
                rows = _Rows(base, size // LEAST_ROW)
                for number, topic, time_ns, data in rows:
                    if not (isinstance(data, bytes) and isinstance(time_ns, int) and time_ns >= 0):
                        rows.unreadable += 1
                    elif topic in topics:
                        self._write(topics[topic].name, topics[topic].type, data, time_ns, time_ns)
                    else:
                        self._refused[f'topic number {topic}, whose description is lost'] += 1
                    yield size * number // max(rows.last, 1)
                if rows.lost:
                    many = f'about {rows.lost}' if rows.counted else 'an unknown number of'
                    self._lose(f'{many} messages cannot be read (damaged database)')
        except UNREADABLE as error:
            self._lose(f'no database that can be read: {error}')
        self._tell_refused()

    def _sqlite_topics(self, base: sqlite3.Connection) -> dict[int, Topic]:
        base.text_factory = lambda text: text.decode(errors='replace')
        columns = {row[1] for row in base.execute('PRAGMA table_info(topics)')}
        wanted = [c if c in columns else "''" for c in ('offered_qos_profiles', 'type_description_hash')]
        definitions = {}
        if base.execute('PRAGMA table_info(message_definitions)').fetchall():
            query = 'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            try:
                definitions = {
                    kind: (encoding, text)
                    for kind, encoding, text in base.execute(query)
                    if isinstance(encoding, str) and isinstance(text, str)
                }
            except UNREADABLE:
                self._lose('the definitions of the message types cannot be read')
        topics = {}
        query = f'SELECT id, name, type, {", ".join(wanted)} FROM topics'  # noqa: S608
        for number, *described in base.execute(query):
            name, kind, qos, type_hash = (one if isinstance(one, str) else '' for one in described)
            encoding, text = definitions.get(kind, ('ros2msg', ''))
            topic = _sound(Topic(name, kind, text, encoding, type_hash, _qos(qos)))
            if not (name and kind):
                self._lose(f'topic {number} has no name or no type')
            elif self._topic(name, kind, lambda: topic):  # noqa: B023
                topics[number] = topic
        return topics

    def _topic(self, name: str, kind: str, make: Callable[[], Topic]) -> bool:
        """Make a topic known; False where it has another type already."""
        known = self._recorder.topics.get(name)
        if known is None:
            self._recorder.add(make())
        elif known.type != kind:
            self._refused[f'{name}: {kind}, though the topic is {known.type}'] += 1
            return False
        return True

    def _write(self, topic: str, kind: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        self._recorder.write(topic, kind, data, log_time_ns, publish_time_ns)
        self._found.messages[topic] += 1

    def _tell_refused(self) -> None:
        for why, number in self._refused.items():
            self._lose(f'{number} messages of {why}')

    def _lose(self, what: str) -> None:
        self._found.losses.append(f'{self._file}: {what}')


class _Rows:
    """Number, topic, time and data of the messages of a database, leaving out what cannot be read.

    Damaged parts may look empty, or be missing: neither the greatest number nor the count can be trusted.

    Attributes:
        last: the greatest number there may be.
        unreadable: rows found so far that cannot be read.
        counted: whether anything says how many there should be.
    """

    def __init__(self, base: sqlite3.Connection, most: int) -> None:
        self._base = base
        self._most = most
        self._found = 0
        self.unreadable = 0
        self._count = self._number('SELECT count(*) FROM messages')
        greatest = self._number('SELECT max(id) FROM messages')
        self.counted = max(self._count, greatest) > 0
        self.last = max(self._count, greatest) if self.counted else most

    @property
    def lost(self) -> int:
        """Messages that cannot be had, when all is read; about."""
        return max(self.unreadable, self._count - self._found)

    def _number(self, query: str) -> int:
        """What the query says; 0 where it fails or says nothing."""
        try:
            (number,) = self._base.execute(query).fetchone()
        except UNREADABLE:
            return 0
        return int(number or 0)

    def __iter__(self) -> Iterator[tuple[int, Any, Any, Any]]:
        start = number = barren = 0
        while start <= self.last and barren < BARREN and self._found < self._most:
            end = min(start + ROWS, self.last + 1)
            barren += 1
            for row in self._between(start, end):
                if row[0] > number:  # a damaged tree may lead round in circles
                    number, barren = row[0], 0
                    self._found += 1
                    yield row
            start = self._next(end)

    def _next(self, start: int) -> int:
        """The next number there is, or the given one where that cannot be found out."""
        try:
            (number,) = self._base.execute('SELECT min(id) FROM messages WHERE id >= ?', (start,)).fetchone()
        except UNREADABLE:
            return start
        return self.last + 1 if number is None else int(number)

    def _between(self, start: int, end: int) -> Iterator[tuple[int, Any, Any, Any]]:
        query = 'SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? AND id < ? ORDER BY id'
        try:
            rows = self._base.execute(query, (start, end)).fetchall()
        except UNREADABLE:
            if end - start == 1:
                self.unreadable += 1
                return
            middle = (start + end) // 2
            yield from self._between(start, middle)
            yield from self._between(middle, end)
        else:
            yield from rows


def _is_ros2(one: Content) -> bool:
    return one.schema is not None and one.channel.message_encoding == 'cdr'


def _type(one: Content) -> str:
    return one.schema.name if one.schema else ''


def _topic(one: Content) -> Topic:
    assert one.schema is not None  # noqa: S101
    said = one.channel.metadata
    return _sound(
        Topic(
            one.channel.topic,
            one.schema.name,
            one.schema.data.decode(errors='replace'),
            one.schema.encoding,
            said.get('topic_type_hash', ''),
            _qos(said.get('offered_qos_profiles', '')),
        )
    )


def _sound(topic: Topic) -> Topic:
    """The topic with our definition of its type where its own is missing or damaged, and we have one."""
    if topic.type not in typestore().types or topic.encoding == 'ros2idl' or _is_definition(topic):
        return topic
    return known_topic(topic.name, topic.type, qos=topic.qos)


def _is_definition(topic: Topic) -> bool:
    if not topic.definition or topic.encoding != 'ros2msg':
        return False
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(topic.definition, topic.type))
        store.generate_msgdef(topic.type)  # fails where a part is missing
    except Exception:  # text of a stranger
        return False
    return True


def _qos(text: str) -> tuple[dict[str, Any], ...]:
    """QoS of any version of rosbag2 by the names of version 9; none where it says nothing that can be read."""
    try:
        profiles: list[dict[str, Any]] = dump_qos_v9(parse_qos(text))  # type: ignore[assignment]
    except Exception:  # text of a stranger
        return ()
    return tuple(profiles)
