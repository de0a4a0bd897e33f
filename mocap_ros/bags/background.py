# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A recorder with its own thread, so that its caller waits for the disk at the start and at the end only."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.recorder import RECOVERY_HINT, RecordedMessage, Recorder, choose_bag_folder
from mocap_ros.bags.rosbag2 import Topic, TypeDefinition
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import FolderTaken, RecordingError

CHUNK_PERIOD_S = 0.1  # s, after which a chunk is closed and the disk is checked; a killed process loses no more
SYNC_PERIOD_S = 0.2  # s; a power cut loses the sum of both periods and the time of a sync, to be below 1 s
# s; for which the end of a recording waits for a disk that takes nothing: launch kills a node 10 s after Ctrl-C
MAX_END_STALL_S = 8.0
MAX_WAITING_BYTES = 256_000_000  # bytes of waiting messages; far above 1000 messages of people; guards the memory


def start_recorder(
    time_ns: int,
    config: RecorderConfig,
    attachments: Sequence[Attachment] = (),
    definitions: Mapping[str, TypeDefinition] = MappingProxyType({}),
) -> BackgroundRecorder:
    """Start a `BackgroundRecorder` with a new folder in `recorder.folder`, named by the time in ns."""
    while True:
        with suppress(FolderTaken):  # by another recorder since it was chosen
            folder = choose_bag_folder(Path(config.folder), time_ns)
            return BackgroundRecorder(folder, config, attachments, definitions)


class BackgroundRecorder:
    """A `Recorder` that receives messages in batches, closes chunks every 0.1 s, and syncs the disk every 0.2 s.

    `definitions` are those of message types that differ from this package's; `refused_count` is the number of the
    batches that `put` has refused.
    """

    def __init__(
        self,
        folder: Path,
        config: RecorderConfig,
        attachments: Sequence[Attachment] = (),
        definitions: Mapping[str, TypeDefinition] = MappingProxyType({}),
    ) -> None:
        self.folder = folder
        self.refused_count = 0
        self._recorder = Recorder(folder, config, attachments, definitions=definitions, start=_start_thread)
        self._config = config
        self._batches: deque[tuple[RecordedMessage | Topic, ...]] = deque()
        self._waiting_bytes = 0
        self._wake = threading.Condition()
        self._closing = False
        self._error: RecordingError | None = None
        self._busy_since_s: float | None = None  # steady clock; when the present step began; None: nothing to do
        self._thread = threading.Thread(target=self._run, name='mocap recorder', daemon=True)
        self._thread.start()

    @property
    def stalled_s(self) -> float:
        """Seconds for which the disk has not taken what the recorder writes; 0 while nothing is being written."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    def put(
        self, records: Iterable[RecordedMessage | Topic], *, even_if_full: bool = False, share: float = 1.0
    ) -> bool:
        """Queue messages, and topics before their first message, all or none; return False if the queue is full.

        It counts as full as soon as `share` of it is in use, and never with `even_if_full`.
        """
        self.check()
        batch = tuple(records)
        with self._wake:
            is_full = (
                len(self._batches) >= share * self._config.backlog
                or self._waiting_bytes >= share * MAX_WAITING_BYTES
            )
            if is_full and not even_if_full:
                self.refused_count += bool(batch)
                return False
            if batch:
                self._batches.append(batch)
                self._waiting_bytes += _count_bytes(batch)
                self._wake.notify()
        return True

    def reconfigure(self, config: RecorderConfig) -> None:
        """Use other limits from now on; the folder, the compression and the size of chunks stay in this file."""
        self._config = config
        self._recorder.reconfigure(config)

    def check(self) -> None:
        """Raise the RecordingError that ended the recording, if there is one, once."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """Write the waiting batches and finish the bag.

        RecordingError where the disk takes nothing for `MAX_END_STALL_S`. The bag is still finished if the disk
        works again before the process ends, which does not wait for it.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        begin_s = time.monotonic()
        while self._thread.is_alive():
            self._thread.join(CHUNK_PERIOD_S)
            if min(self.stalled_s, time.monotonic() - begin_s) > MAX_END_STALL_S:
                advice = f'{RECOVERY_HINT} {self.folder}` restores what was written'
                raise RecordingError(f'{self.folder}: the disk takes nothing{advice}')
        self.check()

    def _run(self) -> None:
        try:
            self._write_until_closed()
            self._busy_since_s = time.monotonic()
            self._recorder.close()
        except RecordingError as error:
            self._error = error
        except Exception:  # a fault of the program must not end the node
            self._error = RecordingError(f'{self.folder}: {traceback.format_exc()}')
        finally:
            with suppress(Exception):  # the first error is reported; without one the bag is closed already
                self._recorder.close()
            self._busy_since_s = None

    def _write_until_closed(self) -> None:
        """Write batches as they arrive; close chunks, check the disk and sync when it is time."""
        recorder = self._recorder
        flush_due_s = sync_due_s = 0.0  # on the steady clock
        while True:
            with self._wake:
                if not self._batches and not self._closing:
                    self._busy_since_s = None
                timeout_s = max(flush_due_s - time.monotonic(), 0.0)
                self._wake.wait_for(lambda: self._batches or self._closing, timeout_s)
                batch = self._batches.popleft() if self._batches else ()
                self._waiting_bytes -= _count_bytes(batch)
                is_finished = not batch and self._closing  # while the lock is held: another may come later
            now_s = self._busy_since_s = time.monotonic()
            recorder.write_all(batch)
            if now_s >= flush_due_s:
                recorder.flush()
                flush_due_s = now_s + CHUNK_PERIOD_S
                if now_s >= sync_due_s:
                    recorder.start_sync()
                    sync_due_s = now_s + SYNC_PERIOD_S
            if is_finished:
                return


def _start_thread(call: Callable[[], None]) -> Future[None]:
    """Call a function in a thread of its own, for which the end of the process does not wait."""
    future = Future[None]()

    def run() -> None:
        try:
            call()
            future.set_result(None)
        except Exception as error:
            future.set_exception(error)

    threading.Thread(target=run, name='mocap recorder sync', daemon=True).start()
    return future


def _count_bytes(batch: Iterable[RecordedMessage | Topic]) -> int:
    return sum(len(record.data) for record in batch if isinstance(record, RecordedMessage))
