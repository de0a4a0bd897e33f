"""Writing bags: MCAP files that rosbag2 and every MCAP reader accept.

A bag is a folder holding `<name>_0.mcap`, further files where it is split, and `metadata.yaml`. Chunks are closed
by size and by time, so that a killed process loses no more than the last one.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mocap_ros.bags.mcap_file import Attachment, McapFile
from mocap_ros.bags.rosbag2 import METADATA, Span, Topic, dump, information, known_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError
from mocap_ros.messages.cdr import NS

if TYPE_CHECKING:
    from typing_extensions import Self

MB = 1_000_000


class Record(NamedTuple):
    """A message to write; the fields are the arguments of `Recorder.write`."""

    topic: str
    type: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    repeat: str = ''


def new_bag_folder(root: Path, time_ns: int) -> Path:
    """A path in `root` that does not exist yet, named by the UTC time.

    Args:
        root: the recording folder.
        time_ns: since the epoch.

    Raises:
        RecordingError: it cannot be looked at.
    """
    name = datetime.fromtimestamp(time_ns // NS, timezone.utc).strftime('mocap_%Y%m%dT%H%M%SZ')
    candidates = (root / (name + (f'_{n}' if n else '')) for n in count())
    try:
        return next(path for path in candidates if not path.exists())
    except OSError as error:
        raise RecordingError(f'{root}: {error.strerror}') from None


def partial_of(out: Path) -> Path:
    """What a bag that is made of another is called until it is complete.

    Raises:
        RecordingError: the bag is there already.
    """
    if out.exists() or out.is_symlink():
        raise RecordingError(f'{out}: exists already')
    return out.with_name(f'{out.name}.partial')


class Recorder:
    """Writes one bag.

    Args:
        folder: of the new bag; its parents are made where they are missing.
        config: compression, when a chunk is closed, when a new file is begun, how much of the disk is left free.
        attachments: to put into each file.
        name: what the names of the files begin with; by default the folder's.

    Raises:
        RecordingError: the folder exists or cannot be written, or too little disk space is left.
    """

    def __init__(
        self, folder: Path, config: RecorderConfig, attachments: Sequence[Attachment] = (), name: str = ''
    ) -> None:
        self.folder = folder
        self._name = name or folder.name
        self._config = config
        self._attachments = attachments
        self._topics: dict[str, Topic] = {}
        self._repeated: dict[tuple[str, str], Record] = {}
        self._finished: dict[str, Span] = {}
        self._chunk_ns = -1
        self._file: McapFile | None = None
        with self._disk():
            folder.mkdir(parents=True)
            try:
                self._check_space()
            except RecordingError:
                folder.rmdir()
                raise
            self._file = self._new_file()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, topic: str, msgtype: str, *, latched: bool = False) -> None:
        """Make a topic known before its first message; needed only for latched (transient local) ones.

        Raises:
            RecordingError: unknown message type, another type than before, or a failing disk.
        """
        known = self._topics.get(topic)
        if known is None:
            self.add(known_topic(topic, msgtype, latched=latched))
        elif known.type != msgtype:
            raise RecordingError(f'{self.folder}: topic {topic} is {known.type}, not {msgtype}')

    def add(self, topic: Topic) -> None:
        """Make a topic of any type known.

        The last message of a latched topic is repeated at the beginning of each further file.

        Raises:
            RecordingError: the disk is full or fails, or the bag is closed.
        """
        file = self._open_file
        with self._disk():
            file.add(topic)
        self._topics[topic.name] = topic

    def attach(self, attachment: Attachment, time_ns: int) -> None:
        """Add a file to the file that is being written.

        Raises:
            RecordingError: the disk is full or fails, or the bag is closed.
        """
        file = self._open_file
        with self._disk():
            file.attach([attachment], time_ns)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to the file that is being written.

        Raises:
            RecordingError: the disk is full or fails, or the bag is closed.
        """
        file = self._open_file
        with self._disk():
            file.note(name, values)

    def write(
        self, topic: str, msgtype: str, data: bytes, log_time_ns: int, publish_time_ns: int, repeat: str = ''
    ) -> None:
        """Append a message.

        Args:
            topic: absolute name.
            msgtype: such as `sensor_msgs/msg/CameraInfo`.
            data: CDR.
            log_time_ns: time of receipt; of outputs, of their publication.
            publish_time_ns: time at which the sender sent it.
            repeat: where not empty, the last message of this topic with this word is repeated at the beginning of
                each further file.

        Raises:
            RecordingError: the disk is full or fails, or the bag is closed.
        """
        if topic not in self._topics or self._topics[topic].type != msgtype:
            self.announce(topic, msgtype)
        with self._disk():
            file = self._file_for(log_time_ns)
            file.write(topic, data, log_time_ns, publish_time_ns)
        if repeat or self._topics[topic].latched:
            self._repeated[topic, repeat] = Record(topic, msgtype, data, log_time_ns, publish_time_ns, repeat)
        if self._chunk_ns < 0:
            self._chunk_ns = log_time_ns
        elif abs(log_time_ns - self._chunk_ns) >= self._config.chunk_seconds * NS:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system; see whether disk and folder are still there.

        Raises:
            RecordingError: the disk is full, or nearly, or fails, or the folder is gone; the recording is over.
        """
        self._chunk_ns = -1
        file = self._open_file
        with self._disk():
            if not file.in_place:
                raise FileNotFoundError(0, 'removed or moved while it was written', file.path)
            file.flush()
            self._check_space()

    def close(self) -> None:
        """Finish the bag; nothing happens the second time.

        Raises:
            RecordingError: the disk is full or fails.
        """
        if self._file is None:
            return
        with self._disk():
            self._finish_file(self._file)
            self._write_metadata()

    def remove(self) -> None:
        """Take the bag back."""
        with suppress(RecordingError):
            self.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Those known so far, by name."""
        return self._topics

    @property
    def _open_file(self) -> McapFile:
        if self._file is None:
            raise RecordingError(f'{self.folder}: the recording is closed')
        return self._file

    def _new_file(self) -> McapFile:
        return McapFile(self.folder / f'{self._name}_{len(self._finished)}.mcap', self._config)

    def _file_for(self, log_time_ns: int) -> McapFile:
        """The open file, or the next one where that is full; a new one begins with what is repeated."""
        file, config = self._open_file, self._config
        seconds = (log_time_ns - file.span.first_ns) / NS
        if file.span.first_ns < 0:
            file.attach(self._attachments, log_time_ns)
        elif (config.split_mb and file.size >= config.split_mb * MB) or 0 < config.split_seconds <= seconds:
            self._finish_file(file)
            file = self._file = self._new_file()
            for topic in self._topics.values():
                file.add(topic)
            file.attach(self._attachments, log_time_ns)
            for r in self._repeated.values():
                file.write(r.topic, r.data, log_time_ns, r.publish_time_ns)
        return file

    def _finish_file(self, file: McapFile) -> None:
        file.finish(self._describe)
        self._finished[file.path.name] = file.span
        self._file = None

    def _describe(self, file: McapFile) -> dict[str, Any]:
        return information(self._topics.values(), {file.path.name: file.span})

    def _write_metadata(self) -> None:
        content = {'rosbag2_bagfile_information': information(self._topics.values(), self._finished)}
        unfinished = self.folder / f'{METADATA}.tmp'
        unfinished.write_text(dump(content), encoding='utf-8')
        unfinished.replace(self.folder / METADATA)

    def _check_space(self) -> None:
        free = shutil.disk_usage(self.folder).free
        if free < self._config.min_free_mb * MB:
            self.close()
            raise RecordingError(
                f'{self.folder}: {free // MB} MB left on the disk, '
                f'less than recorder.min_free_mb ({self._config.min_free_mb})'
            )

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Give the recording up where the disk fails."""
        try:
            yield
        except OSError as error:
            self._rescue()
            where = error.filename or self.folder
            raise RecordingError(f'{where}: {error.strerror or error}') from None

    def _rescue(self) -> None:
        """Finish the bag with what has reached the disk, as far as the disk lets us."""
        file, self._file = self._file, None
        with suppress(OSError):
            if file is not None:
                file.rescue(self._describe)
                self._finished[file.path.name] = file.span
            if self._finished:
                self._write_metadata()
