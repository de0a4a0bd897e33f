# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recorder of bags: MCAP files that rosbag2 and every MCAP reader accept.

A bag is a folder that holds `<name>_0.mcap`, further numbered files where the bag is split, and `metadata.yaml`.
The last of `MAX_FILES` files is not split.

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
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


class RecordedMessage(NamedTuple):
    """A message to record; the fields are the arguments of `Recorder.write`."""

    topic: str
    type: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    repeat_keys: frozenset[str] | None = frozenset()
    may_begin_file: bool = True


RECOVERY_HINT = '; `mocap-ros recover'  # begins what an error says of a bag that could not be finished
# Messages of a topic that a further file repeats, the newest; guards memory and files against ever new keys. There
# may be as many coordinate frames.
MAX_REPEATED = 1000
MAX_SYNCS = 3  # at a time, so that a slow one, or those between two files, do not delay the next
MAX_FILES = 2000  # of a bag; with as many, metadata.yaml is 0.4 MB, and readers take 1 MiB (`MAX_METADATA_BYTES`)
_REMOVED = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)  # `OSError.errno` where the folder has become something else
_ERRORS = {errno.ENOSPC: DiskFull, errno.EDQUOT: DiskFull, errno.EEXIST: FolderTaken}  # by `OSError.errno`


def choose_bag_folder(root: Path, time_ns: int) -> Path:
    """Return a path in `root` that does not exist yet, named by the UTC time in ns since the epoch."""
    name = datetime.fromtimestamp(time_ns // NS_PER_S, timezone.utc).strftime('mocap_%Y%m%dT%H%M%SZ')
    candidates = (root / (name + (f'_{n}' if n else '')) for n in count())
    try:
        return next(path for path in candidates if not (path.exists() or path.is_symlink()))
    except OSError as error:
        raise RecordingError(f'{root}: {error.strerror}') from None


def _make_parent(folder: Path) -> None:
    """Create the folders above that of a bag; where one is a file or a link to nothing, it is no `FolderTaken`."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise RecordingError(f'{error.filename}: is no folder, or a link to one that is missing') from None
    except OSError as error:
        raise _ERRORS.get(error.errno or 0, RecordingError)(f'{folder.parent}: {error.strerror}') from None


def remove_partial(out: Path) -> None:
    """Remove the incomplete bag that was to become `out` and that an interrupted command has left, if any."""
    partial = choose_partial_path(out)
    if not partial.exists():
        return
    unexpected = [
        f.name for f in partial.iterdir() if f.suffix not in ROS2_SUFFIXES and not f.name.startswith(METADATA)
    ]
    if unexpected:
        raise RecordingError(f"{partial}: not removed, because the file {unexpected[0]} in it is not a bag's")
    try:
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

    Every method raises RecordingError if the disk is full or fails, or if the bag is closed.

    Args:
        folder: Folder of the new bag; missing parent folders are created.
        config: Compression, limits of chunks and files, and the disk space to leave free.
        attachments: Files to attach to each file of the bag.
        name: Beginning of the file names; by default the name of the folder. Bytes that are no UTF-8, which
            the description of a bag cannot hold, are replaced.
        definitions: Definitions of message types, by name, that differ from this package's.
        executor: Runs what waits for the disk; by default, the methods wait themselves.

    Attributes:
        folder: Folder of the bag.
        ros_distro: Distribution of ROS 2 that the bag names; by default the one on which this program runs.

    Raises:
        FolderTaken: The folder exists.
        RecordingError: The folder cannot be written, or too little disk space is left.
    """

    def __init__(
        self,
        folder: Path,
        config: RecorderConfig,
        attachments: Sequence[Attachment] = (),
        name: str = '',
        definitions: Mapping[str, TypeDefinition] = MappingProxyType({}),
        executor: Executor | None = None,
    ) -> None:
        self.folder = folder
        self._executor = executor
        self._syncs: list[Future[None]] = []  # that have not been found to be done
        self.ros_distro = find_ros_distro()
        self._definitions = definitions
        self._name = _make_utf8(name or folder.name)
        self._config = config
        self._attachments = attachments
        self._topics: dict[str, Topic] = {}
        self._messages_to_repeat: dict[str, list[RecordedMessage]] = {}  # by topic, the oldest first
        self._finished_files: dict[str, MessageStatistics] = {}  # by file name
        self._chunk_start_ns = -1  # log time of the first message since the last flush; -1 where there is none
        self._begun_bytes = 0  # bytes at the beginning of the current file that repeat what earlier files hold
        self._file: McapFile | None = None
        _make_parent(folder)
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

        Raises:
            RecordingError: The bag has the topic with another type.
        """
        file = self._open_file
        declared = self._topics.get(topic.name)
        if declared is not None:
            if declared.type != topic.type:
                raise RecordingError(
                    f'{self.folder}: topic {topic.name} has the type {declared.type}, not {topic.type}'
                )
            return
        with self._finish_on_disk_error():
            file.add_topic(topic)
        self._topics[topic.name] = topic

    def reconfigure(self, config: RecorderConfig) -> None:
        """Use other limits of files and disk space from now on, and of chunks from the next file on."""
        self._config = config

    def begin_file(self) -> None:
        """Continue the bag in a further file, which repeats no messages.

        Does nothing while the current file holds no message, or where the bag has as many files as it may have.
        """
        file = self._open_file
        if file.statistics.first_ns >= 0 and self._has_room_for_file:
            with self._finish_on_disk_error():
                self._begin_next_file(file)

    def add_attachment(self, attachment: Attachment, time_ns: int) -> None:
        """Attach a file to the current file of the bag."""
        file = self._open_file
        with self._finish_on_disk_error():
            file.add_attachments([attachment], time_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to the current file of the bag."""
        file = self._open_file
        with self._finish_on_disk_error():
            file.add_metadata(name, values)

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

        Args:
            topic: Absolute name of the topic.
            msgtype: Message type, such as `sensor_msgs/msg/CameraInfo`.
            data: The message as CDR.
            log_time_ns: Time of receipt, in ns; for an output, the time of its publication.
            publish_time_ns: Time at which the publisher sent the message, in ns.
            repeat_keys: What the message tells of, such as the names of coordinate frames. A further file begins
                with the messages of latched topics and those with keys, but for those whose keys are all among the
                keys of a later message of the topic. A message with None is not repeated and replaces none.
            may_begin_file: Whether the bag may continue in a further file with this message. What that file
                repeats gets the log time of this message.
        """
        if topic not in self._topics or self._topics[topic].type != msgtype:
            self.declare_topic(topic, msgtype)
        with self._finish_on_disk_error():
            file = self._select_file(log_time_ns, may_begin=may_begin_file)
            file.write(topic, data, log_time_ns, publish_time_ns)
        if repeat_keys or (repeat_keys is not None and self._topics[topic].is_latched):
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
        file = self._open_file
        with self._finish_on_disk_error():
            self._check_place(file)
            file.flush()
            self._check_space()

    def start_sync(self) -> None:
        """Begin to make the disk hold what was flushed; do nothing while `MAX_SYNCS` are going on."""
        file = self._open_file
        with self._finish_on_disk_error():
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
            self._finish_file(self._file)
            self._wait_for_syncs()
            self._write_metadata()

    def remove(self) -> None:
        """Close the bag and delete its folder."""
        with suppress(RecordingError):
            self.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topics that have been added, by name."""
        return self._topics

    @property
    def _open_file(self) -> McapFile:
        """The current file; raises RecordingError where the bag is closed."""
        if self._file is None:
            raise RecordingError(f'{self.folder}: the recording is closed')
        return self._file

    @property
    def _has_room_for_file(self) -> bool:
        """Whether the bag may have another file after the current one."""
        return len(self._finished_files) < MAX_FILES - 1

    def _create_file(self) -> McapFile:
        path = self.folder / f'{self._name}_{len(self._finished_files)}.mcap'
        file = McapFile(path, self._config)
        self._sync(partial(sync_folder, self.folder))
        return file

    def _sync(self, sync: Callable[[], None]) -> None:
        """Call a function that waits for the disk, in another thread if there is an executor."""
        if self._executor is None:
            sync()
        else:
            self._syncs.append(self._executor.submit(sync))

    def _wait_for_syncs(self) -> None:
        while self._syncs:
            self._syncs.pop(0).result()

    def _select_file(self, log_time_ns: int, *, may_begin: bool) -> McapFile:
        """Return the current file, or the next one where that may begin and the current file has reached a limit.

        What a new file begins with does not count towards its limit, which it alone might reach.
        """
        file, config = self._open_file, self._config
        if file.statistics.first_ns < 0:
            file.add_attachments(self._attachments, log_time_ns)
            return file
        seconds = (log_time_ns - file.statistics.first_ns) / NS_PER_S
        is_large = config.split_mb and file.written_bytes - self._begun_bytes >= config.split_mb * MB
        is_due = is_large or 0 < config.split_seconds <= seconds
        if may_begin and is_due and self._has_room_for_file:
            file = self._begin_next_file(file)
            file.add_attachments(self._attachments, log_time_ns)
            for message in chain.from_iterable(self._messages_to_repeat.values()):
                file.write(message.topic, message.data, log_time_ns, message.publish_time_ns)
            file.flush()
            self._begun_bytes = file.written_bytes
        return file

    def _begin_next_file(self, file: McapFile) -> McapFile:
        """Finish the current file; create the next one with all topics, make it the current one and return it."""
        self._finish_file(file)
        file = self._file = self._create_file()
        self._begun_bytes = 0
        for topic in self._topics.values():
            file.add_topic(topic)
        return file

    def _finish_file(self, file: McapFile) -> None:
        self._check_place(file)
        sync = file.finish(self._describe_file)
        self._finished_files[file.path.name] = file.statistics
        self._file = None
        self._sync(sync)

    def _describe_file(self, file: McapFile) -> dict[str, Any]:
        return describe_bag(self._topics.values(), {file.path.name: file.statistics}, self.ros_distro)

    def _write_metadata(self) -> None:
        """Write metadata.yaml under a temporary name and rename it, so that it is never incomplete."""
        description = describe_bag(self._topics.values(), self._finished_files, self.ros_distro)
        content = {BAG_INFORMATION: description}
        temporary = self.folder / f'{METADATA}.tmp'
        with temporary.open('w', encoding='utf-8') as stream:
            stream.write(encode_yaml(content))
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(self.folder / METADATA)
        sync_folder(self.folder)

    def _check_place(self, file: McapFile) -> None:
        """Raise FileNotFoundError where the file was removed or moved."""
        if not file.is_in_place:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), file.path)

    def _check_space(self) -> None:
        free_bytes = shutil.disk_usage(self.folder).free
        if free_bytes < self._config.min_free_mb * MB:
            self.close()
            raise DiskFull(
                f'{self.folder}: the disk has {free_bytes // MB} MB left, '
                f'less than recorder.min_free_mb ({self._config.min_free_mb})'
            )

    @contextmanager
    def _finish_on_disk_error(self) -> Iterator[None]:
        """Finish the bag and raise RecordingError when the block raises OSError."""
        try:
            yield
        except OSError as error:
            has_begun = self._file is not None or bool(self._finished_files)
            was_removed = has_begun and error.errno in _REMOVED
            reason = (
                'the file was removed or moved while it was written' if was_removed else error.strerror or error
            )
            is_finished = self._finish_after_failure()
            if has_begun and not (is_finished or was_removed):
                reason = f'{reason}{RECOVERY_HINT} {self.folder}` restores what was written'
            raise _ERRORS.get(error.errno or 0, RecordingError)(
                f'{error.filename or self.folder}: {reason}'
            ) from None

    def _finish_after_failure(self) -> bool:
        """Finish the bag with what could not be written; return False where the disk fails again."""
        file, self._file = self._file, None
        try:
            if file is not None:
                sync = file.finish(self._describe_file)
                self._finished_files[file.path.name] = file.statistics
                self._sync(sync)
            self._wait_for_syncs()
            if self._finished_files:
                self._write_metadata()
        except OSError:
            return False
        return True


def _make_utf8(name: str) -> str:
    """Return the name of a file with the replacement character in the place of bytes that are no UTF-8."""
    return name.encode('utf-8', 'surrogateescape').decode('utf-8', 'replace')
