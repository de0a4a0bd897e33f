# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recorder of bags: MCAP files that rosbag2 and every MCAP reader accept.

A bag is a folder that holds `<name>_0.mcap`, further numbered files where the bag is split, and `metadata.yaml`.

Messages are collected in chunks. A chunk is closed when it holds `chunk_bytes`, or by `flush`, which `write` calls
when the log time has advanced by `chunk_seconds`. `flush` also hands the written data to the operating system, so
a crash of the process loses only the messages since the last flush. A power cut loses what was flushed since the
last `start_sync`; finished files and the names of all files are on the disk.

Free disk space is checked before a recording starts and at every flush. If less than `recorder.min_free_mb` is
left, the bag is finished and the recording ends with an error. If writing fails, it is tried once more, to finish
the bag; if that fails as well, the file ends with its last complete record.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from functools import partial
from itertools import chain, count
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from mocap_ros.bags.mcap_file import Attachment, McapFile, sync_folder
from mocap_ros.bags.reader import ROS2_SUFFIXES
from mocap_ros.bags.rosbag2 import (
    BAG_INFORMATION,
    METADATA,
    MessageStatistics,
    Topic,
    TypeDefinition,
    describe_bag,
    encode_yaml,
    find_ros_distro,
    make_topic,
)
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import DiskFull, FolderTaken, RecordingError
from mocap_ros.units import NS_PER_S

if TYPE_CHECKING:
    from typing_extensions import Self

MB = 1_000_000  # bytes; the unit of the parameters `recorder.split_mb` and `recorder.min_free_mb`
ONE_FILE = RecorderConfig(min_free_mb=0, split_seconds=0.0)  # of a bag that is written as a single file
RECOVERY_HINT = '; `mocap-ros recover'  # begins what an error says of a bag that could not be finished
# Messages of a topic that a further file repeats, the newest; guards memory and files against ever new keys. There
# may be as many coordinate frames.
MAX_REPEATED = 1000
MAX_SYNCS = 3  # at a time, so that a slow one, or those between two files, do not delay the next
_REMOVED = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)  # `OSError.errno` where the folder has become something else
_ERRORS = {errno.ENOSPC: DiskFull, errno.EDQUOT: DiskFull, errno.EEXIST: FolderTaken}  # by `OSError.errno`


class RecordedMessage(NamedTuple):
    """A message to record; the fields are the arguments of `Recorder.write`."""

    topic: str
    type: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    repeat_keys: frozenset[str] | None = frozenset()
    may_begin_file: bool = True


def choose_bag_folder(root: Path, time_ns: int) -> Path:
    """Return a path in `root` that does not exist yet, named by the UTC time in ns since the epoch."""
    name = datetime.fromtimestamp(time_ns // NS_PER_S, timezone.utc).strftime('mocap_%Y%m%dT%H%M%SZ')
    candidates = (root / (name + (f'_{n}' if n else '')) for n in count())
    try:
        return next(path for path in candidates if not (path.exists() or path.is_symlink()))
    except OSError as error:
        raise RecordingError(f'{root}: {error.strerror}') from None


def remove_partial(out: Path) -> None:
    """Remove the incomplete bag that was to become `out` and that an interrupted command has left, if any."""
    partial = choose_partial_path(out)
    try:
        files = list(partial.iterdir()) if partial.exists() else []
        if any(f.suffix not in ROS2_SUFFIXES and not f.name.startswith(METADATA) for f in files):
            raise RecordingError(f'{partial}: not removed, because it holds other files than those of a bag')
        if partial.exists():
            shutil.rmtree(partial)
    except OSError as error:
        raise RecordingError(f'{partial}: {error.strerror}') from None


def choose_partial_path(out: Path) -> Path:
    """Return the path under which a bag is written until it can be renamed to `out`, which must not exist yet."""
    if out.exists() or out.is_symlink():
        raise RecordingError(f'{out}: exists already')
    if (out.parent / METADATA).is_file():
        raise RecordingError(f'{out}: {out.parent} is a bag; write beside it, not into it')
    return out.with_name(f'{out.name}.partial')


class Recorder:
    """Writes one bag; a context manager that closes it.

    Every method raises RecordingError if the disk is full or fails, or if the bag is closed. Names of files begin
    with `name`, by default that of the folder. `definitions` are those of message types that differ from this
    package's. `start` begins what waits for the disk, in another thread; by default, the methods wait themselves.
    `ros_distro` is the distribution of ROS 2 that the bag names, by default the one on which this program runs.
    """

    def __init__(
        self,
        folder: Path,
        config: RecorderConfig,
        attachments: Sequence[Attachment] = (),
        name: str = '',
        definitions: Mapping[str, TypeDefinition] = MappingProxyType({}),
        start: Callable[[Callable[[], None]], Future[None]] | None = None,
    ) -> None:
        self.folder = folder
        self.ros_distro = find_ros_distro()
        self.topics: dict[str, Topic] = {}
        self._start = start
        self._syncs: list[Future[None]] = []  # that have not been found to be done
        self._definitions = definitions
        # bytes of a name that are no UTF-8 are replaced, because the description of a bag cannot hold them
        self._name = (name or folder.name).encode('utf-8', 'surrogateescape').decode('utf-8', 'replace')
        self._config = config
        self._attachments = attachments
        self._messages_to_repeat: dict[str, list[RecordedMessage]] = {}  # by topic, the oldest first
        self._finished_files: dict[str, MessageStatistics] = {}  # by file name
        self._chunk_start_ns = -1  # log time of the first message since the last flush; -1 where there is none
        self._begun_bytes = 0  # bytes at the beginning of the current file that repeat what earlier files hold
        self._file: McapFile | None = None
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:  # of another folder than the bag's
            raise RecordingError(f'{error.filename}: is no folder, or a link to one that is missing') from None
        except OSError as error:
            raise _ERRORS.get(error.errno or 0, RecordingError)(f'{folder.parent}: {error.strerror}') from None
        with self._finish_on_disk_error():
            folder.mkdir()
            sync_folder(folder.parent)
            try:
                self._check_space()
                self._file = self._create_file()
            except (OSError, RecordingError):
                with suppress(OSError):
                    folder.rmdir()
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def declare_topic(self, topic: str, msgtype: str, *, latched: bool = False) -> None:
        """Add a topic of a known type before its first message; only latched topics need this."""
        definition = self._definitions.get(msgtype)
        self.add_topic(make_topic(topic, msgtype, latched=latched, definition=definition))

    def add_topic(self, topic: Topic) -> None:
        """Add a topic of any message type, unless the bag has it: readers accept one description of a topic only.

        The last messages of a latched topic are repeated at the start of each further file.
        """
        declared = self.topics.get(topic.name, topic)
        if declared.type != topic.type:
            raise RecordingError(
                f'{self.folder}: topic {topic.name} has the type {declared.type}, not {topic.type}'
            )
        if topic.name not in self.topics:
            with self.writing() as file:
                file.add_topic(topic)
            self.topics[topic.name] = topic

    def reconfigure(self, config: RecorderConfig) -> None:
        """Use other limits of files and disk space from now on, and of chunks from the next file on."""
        self._config = config

    def begin_file(self) -> None:
        """Continue the bag in a further file, which repeats no messages, where the current one holds messages."""
        with self.writing() as file:
            if file.statistics.first_ns >= 0:
                self._begin_next_file(file)

    def write_all(self, records: Iterable[RecordedMessage | Topic]) -> None:
        """Write messages, and describe topics."""
        for record in records:
            if isinstance(record, Topic):
                self.add_topic(record)
            else:
                self.write(*record)

    def write(
        self,
        topic: str,
        msgtype: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int,
        repeat_keys: frozenset[str] | None = frozenset(),
        may_begin_file: bool = True,
    ) -> None:
        """Append a message; flush when `chunk_seconds` of log time have passed since the last flush.

        - `log_time_ns`: Time of receipt, in ns; for an output, the time of its publication.
        - `publish_time_ns`: Time at which the publisher sent the message, in ns.
        - `repeat_keys`: What the message is about, such as the names of coordinate frames. A further file begins
          with the messages of latched topics and those with keys, but for those whose keys are all among the
          keys of a later message of the topic. A message with None is not repeated and replaces none.
        - `may_begin_file`: Whether the bag may continue in a further file with this message. What that file
          repeats gets the log time of this message.
        """
        if topic not in self.topics or self.topics[topic].type != msgtype:
            self.declare_topic(topic, msgtype)
        with self.writing() as file:
            file = self._select_file(file, log_time_ns, may_begin=may_begin_file)  # noqa: PLW2901
            file.write(topic, data, log_time_ns, publish_time_ns)
        if repeat_keys or (repeat_keys is not None and self.topics[topic].is_latched):
            message = RecordedMessage(topic, msgtype, data, log_time_ns, publish_time_ns, repeat_keys)
            before = self._messages_to_repeat.get(topic, [])
            kept = [m for m in before if m.repeat_keys is not None and not m.repeat_keys <= repeat_keys]
            self._messages_to_repeat[topic] = [*kept, message][-MAX_REPEATED:]
        if self._chunk_start_ns < 0:
            self._chunk_start_ns = log_time_ns
        elif abs(log_time_ns - self._chunk_start_ns) >= self._config.chunk_seconds * NS_PER_S:
            self.flush()

    def flush(self) -> None:
        """Close the chunk, hand the data to the operating system, and check the file and the free disk space."""
        self._chunk_start_ns = -1
        with self.writing() as file:
            file.check_place()
            file.flush()
            self._check_space()

    def start_sync(self) -> None:
        """Begin to make the disk hold what was flushed; do nothing while `MAX_SYNCS` are going on."""
        with self.writing() as file:
            done = [sync for sync in self._syncs if sync.done()]
            self._syncs = [sync for sync in self._syncs if sync not in done]
            for sync in done:
                sync.result()
            if len(self._syncs) < MAX_SYNCS:
                self._sync(file.prepare_sync())

    def close(self) -> None:
        """Finish the bag; further calls do nothing."""
        if self._file is None:
            return
        with self._finish_on_disk_error():
            self._file.check_place()
            self._finish()

    def remove(self) -> None:
        """Close the bag and delete its folder."""
        with suppress(RecordingError):
            self.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _create_file(self) -> McapFile:
        path = self.folder / f'{self._name}_{len(self._finished_files)}.mcap'
        file = McapFile(path, self._config)
        self._sync(partial(sync_folder, self.folder))
        return file

    def _sync(self, sync: Callable[[], None]) -> None:
        """Call a function that waits for the disk, in another thread if there is a way to start one."""
        if self._start is None:
            sync()
        else:
            self._syncs.append(self._start(sync))

    def _select_file(self, file: McapFile, log_time_ns: int, *, may_begin: bool) -> McapFile:
        """Return the current file, or the next one where that may begin and the current file has reached a limit.

        What a new file begins with does not count towards its limit, which it alone might reach.
        """
        config = self._config
        if file.statistics.first_ns < 0:
            file.add_attachments(self._attachments, log_time_ns)
            return file
        seconds = (log_time_ns - file.statistics.first_ns) / NS_PER_S
        is_large = config.split_mb and file.written_bytes - self._begun_bytes >= config.split_mb * MB
        if may_begin and (is_large or 0 < config.split_seconds <= seconds):
            file = self._begin_next_file(file)
            file.add_attachments(self._attachments, log_time_ns)
            for message in chain.from_iterable(self._messages_to_repeat.values()):
                file.write(message.topic, message.data, log_time_ns, message.publish_time_ns)
            file.flush()
            self._begun_bytes = file.written_bytes
        return file

    def _begin_next_file(self, file: McapFile) -> McapFile:
        """Finish the current file; create the next one with all topics, make it the current one and return it."""
        file.check_place()
        self._finish_file(file)
        file = self._file = self._create_file()
        self._begun_bytes = 0
        for topic in self.topics.values():
            file.add_topic(topic)
        return file

    def _finish_file(self, file: McapFile) -> None:
        sync = file.finish(
            lambda: describe_bag(self.topics.values(), {file.path.name: file.statistics}, self.ros_distro)
        )
        self._finished_files[file.path.name] = file.statistics
        self._file = None
        self._sync(sync)

    def _finish(self) -> None:
        """Finish the current file, wait for the disk, and write metadata.yaml.

        The latter is renamed when it is complete.
        """
        if self._file is not None:
            self._finish_file(self._file)
        while self._syncs:
            self._syncs.pop(0).result()
        if not self._finished_files:
            return
        description = describe_bag(self.topics.values(), self._finished_files, self.ros_distro)
        temporary = self.folder / f'{METADATA}.tmp'
        with temporary.open('w', encoding='utf-8') as stream:
            stream.write(encode_yaml({BAG_INFORMATION: description}))
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(self.folder / METADATA)
        sync_folder(self.folder)

    def _check_space(self) -> None:
        free_bytes = shutil.disk_usage(self.folder).free
        if free_bytes < self._config.min_free_mb * MB:
            self.close()
            raise DiskFull(
                f'{self.folder}: the disk has {free_bytes // MB} MB left, '
                f'less than recorder.min_free_mb ({self._config.min_free_mb})'
            )

    @contextmanager
    def writing(self) -> Iterator[McapFile]:
        """Provide the current file; finish the bag and raise RecordingError when the block raises OSError."""
        if self._file is None:
            raise RecordingError(f'{self.folder}: the recording is closed')
        with self._finish_on_disk_error():
            yield self._file

    @contextmanager
    def _finish_on_disk_error(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            has_begun = self._file is not None or bool(self._finished_files)
            was_removed = has_begun and error.errno in _REMOVED
            reason: Any = error.strerror or error
            if was_removed:
                reason = 'the file was removed or moved while it was written'
            try:
                self._finish()  # with what could not be written
            except OSError:
                self._file = None
                if has_begun and not was_removed:
                    reason = f'{reason}{RECOVERY_HINT} {self.folder}` restores what was written'
            kind = _ERRORS.get(error.errno or 0, RecordingError)
            raise kind(f'{error.filename or self.folder}: {reason}') from None
