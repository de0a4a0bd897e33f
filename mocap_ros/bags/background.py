"""A recorder in a thread of its own: whoever records never waits for the disk."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.recorder import Record, Recorder
from mocap_ros.bags.rosbag2 import Topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError


class BackgroundRecorder:
    """A `Recorder` that is given messages by the batch and closes chunks by the clock, not by log time.

    Args:
        folder: as of a recorder, as the others.
        config: how much may wait, too.
        attachments: to put into each file.

    Raises:
        RecordingError: as a recorder.
    """

    def __init__(self, folder: Path, config: RecorderConfig, attachments: Sequence[Attachment] = ()) -> None:
        self.folder = folder
        self._recorder = Recorder(folder, replace(config, chunk_seconds=inf), attachments)
        self._config = config
        self._waiting: deque[tuple[Record | Topic, ...]] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._error: RecordingError | None = None
        self._thread = threading.Thread(target=self._work, name='mocap recorder')
        self._thread.start()

    def put(self, records: Iterable[Record | Topic], *, always: bool = False) -> bool:
        """Have records written, all or none; returns False where too much waits already.

        Args:
            records: messages to write, topics to make known before.
            always: however much waits.

        Raises:
            RecordingError: the recording has failed.
        """
        self.check()
        records = tuple(records)
        with self._wake:
            if len(self._waiting) >= self._config.backlog and not always:
                return False
            if records:
                self._waiting.append(records)
                self._wake.notify()
        return True

    def check(self) -> None:
        """See whether all is well.

        Raises:
            RecordingError: the recording has failed, which is said only once.
        """
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """Write what waits and finish the bag.

        Raises:
            RecordingError: the disk is full or fails.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        self.check()

    def _work(self) -> None:
        try:
            self._write_until_closed()
            self._recorder.close()
        except RecordingError as error:
            self._error = error
        except Exception:
            self._error = RecordingError(f'{self.folder}: {traceback.format_exc()}')

    def _write_until_closed(self) -> None:
        due = 0.0
        while True:
            with self._wake:
                left = max(due - time.monotonic(), 0.0)
                self._wake.wait_for(lambda: self._waiting or self._closing, left)
                records = self._waiting.popleft() if self._waiting else None
            for record in records or ():
                if isinstance(record, Topic):
                    self._recorder.add(record)
                else:
                    self._recorder.write(*record)
            if time.monotonic() >= due:
                self._recorder.flush()
                due = time.monotonic() + self._config.chunk_seconds
            if records is None and self._closing:
                return
