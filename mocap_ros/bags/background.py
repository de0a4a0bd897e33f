"""A recorder with its own thread, so that its caller never waits for the disk."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from types import MappingProxyType

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.bags.rosbag2 import Topic, TypeDefinition
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError


class BackgroundRecorder:
    """A `Recorder` that receives messages in batches and closes chunks by the clock instead of by log time.

    Args:
        folder: Folder of the new bag.
        config: Configuration of the recorder; `backlog` limits the number of waiting batches.
        attachments: Files to attach to each file of the bag.
        definitions: Definitions of message types, by name, that differ from this package's.

    Attributes:
        folder: Folder of the bag.

    Raises:
        RecordingError: The folder exists or cannot be written, or too little disk space is left.
    """

    def __init__(
        self,
        folder: Path,
        config: RecorderConfig,
        attachments: Sequence[Attachment] = (),
        definitions: Mapping[str, TypeDefinition] = MappingProxyType({}),
    ) -> None:
        self.folder = folder
        recorder_config = replace(config, chunk_seconds=inf)
        self._recorder = Recorder(folder, recorder_config, attachments, definitions=definitions)
        self._config = config
        self._batches: deque[tuple[RecordedMessage | Topic, ...]] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._error: RecordingError | None = None
        self._thread = threading.Thread(target=self._run, name='mocap recorder')
        self._thread.start()

    def put(self, records: Iterable[RecordedMessage | Topic], *, even_if_full: bool = False) -> bool:
        """Queue records to be written, all or none; return False where the queue is full.

        Args:
            records: Messages to write, and topics to add before their first message.
            even_if_full: Whether to queue the records even if `recorder.backlog` batches are waiting.

        Raises:
            RecordingError: The recording has failed.
        """
        self.check()
        batch = tuple(records)
        with self._wake:
            if len(self._batches) >= self._config.backlog and not even_if_full:
                return False
            if batch:
                self._batches.append(batch)
                self._wake.notify()
        return True

    def check(self) -> None:
        """Raise the error that ended the recording, if there is one; only the first call after it raises.

        Raises:
            RecordingError: The recording has failed.
        """
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """Write the waiting batches and finish the bag.

        Raises:
            RecordingError: The disk is full or fails.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        self.check()

    def _run(self) -> None:
        """Run the writing thread until the recorder is closed or fails."""
        try:
            self._write_until_closed()
            self._recorder.close()
        except RecordingError as error:
            self._error = error
        except Exception:
            self._error = RecordingError(f'{self.folder}: {traceback.format_exc()}')

    def _write_until_closed(self) -> None:
        """Write batches as they arrive and flush every `recorder.chunk_seconds`."""
        flush_due_s = 0.0  # on the monotonic clock
        while True:
            with self._wake:
                timeout_s = max(flush_due_s - time.monotonic(), 0.0)
                self._wake.wait_for(lambda: self._batches or self._closing, timeout_s)
                batch = self._batches.popleft() if self._batches else None
            for record in batch or ():
                if isinstance(record, Topic):
                    self._recorder.add_topic(record)
                else:
                    self._recorder.write(*record)
            if time.monotonic() >= flush_due_s:
                self._recorder.flush()
                flush_due_s = time.monotonic() + self._config.chunk_seconds
            if batch is None and self._closing:
                return
