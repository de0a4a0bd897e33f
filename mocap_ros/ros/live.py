"""A live run: messages in from one thread, through the pipeline in another, out to topics and bag.

A thread of its own takes the messages from the middleware as soon as they come, so that their time of receipt is
right and none is lost unnoticed while a frame is being solved. The oldest are passed over when too many wait.
"""

from __future__ import annotations

import re
import textwrap
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mocap_ros.config import Config, values
from mocap_ros.errors import RecordingError
from mocap_ros.io.journal import Journal, Verdict
from mocap_ros.io.messages import CAMERA_INFO, OutputMessage
from mocap_ros.io.recorder import Recorder, new_bag_folder
from mocap_ros.pipeline import LATCHED_OUTPUTS, Outcome, Pipeline, Source, skeleton_definition

KINDS_REMEMBERED = 200
LONGEST_LINE = 400
LAST_SECONDS = 0.3


class Logger(Protocol):
    """Where a run says what it does."""

    def info(self, message: str) -> object:
        """Something worth knowing."""

    def warning(self, message: str) -> object:
        """Something to look after."""

    def error(self, message: str) -> object:
        """Something that failed."""


class SteadyWallClock:
    """Wall time that never jumps: read once, then advanced by the steady clock."""

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""
        return time.monotonic_ns() + self._offset


class Complaints:
    """Logs what goes wrong with a topic: the same thing the 1st, 10th, 100th, ... time only."""

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._times: dict[str, int] = {}

    def add(self, where: str, number: int, reason: str, *, error: bool = True) -> None:
        """Complain about message `number` of a topic."""
        kind = where + re.sub(r'\d+', '#', reason)
        if len(self._times) > KINDS_REMEMBERED:
            self._times.clear()
        times = self._times[kind] = self._times.get(kind, 0) + 1
        if str(times).strip('0') == '1':
            again = f' (for the {times}th time)' if times > 1 else ''
            line = _one_line(f'{where}: message {number}: {reason}') + again
            if error:
                self._logger.error(line)
            else:
                self._logger.warning(line)


def _one_line(text: str) -> str:
    """What strangers may have had a hand in, printable and of bounded length."""
    printable = ''.join(c if c.isprintable() else ' ' for c in text)
    return textwrap.shorten(printable, LONGEST_LINE, placeholder=' ...')


@dataclass(frozen=True)
class Input:
    """A message as it was received.

    Attributes:
        source: what it is.
        number: of the message on its topic, from 1.
        raw: CDR.
        times_ns: of receipt, and at which the sender sent it; wall clock.
    """

    source: Source
    number: int
    raw: bytes
    times_ns: tuple[int, int]


class LiveRun:
    """Feeds a pipeline from a queue, in a thread that lives from `start` to `stop`.

    Args:
        pipeline: with a tracker that has seen nothing.
        input_types: message type of each source.
        names: absolute names of all topics, by relative name, `journal` too.
        publish: called with every output.
        logger: for bad input and failing recordings.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        input_types: Mapping[Source, str],
        names: Mapping[str, str],
        publish: Callable[[OutputMessage], None],
        logger: Logger,
    ) -> None:
        self._pipeline = pipeline
        self._types = input_types
        self._names = names
        self._publish = publish
        self._logger = logger
        self._complaints = Complaints(logger)
        self._clock = SteadyWallClock()
        self._waiting: deque[Input] = deque()
        self._wake = threading.Condition()
        self._busy = threading.Lock()
        self._end: float | None = None
        self._heard = self._frame_id_missed = False
        self._recorder: Recorder | None = None
        self._journal: Journal | None = None
        self._received = dict.fromkeys(Source, 0)
        self._thread = threading.Thread(target=self._work, name='mocap pipeline')

    def start(self) -> None:
        """Start the thread, and the recording if the configuration wants one."""
        if self._pipeline.config.recorder.enabled:
            try:
                self.record()
            except RecordingError as error:
                self._logger.error(f'{error}; nothing is recorded')
        self._thread.start()

    def stop(self) -> None:
        """Do what still waits, for `LAST_SECONDS` at most; delete the markers and finish the recording."""
        with self._wake:
            self._end = time.monotonic() + LAST_SECONDS
            self._wake.notify()
        self._thread.join()
        with self._busy:
            while self._waiting:
                self._finish(self._waiting.popleft(), self._pipeline.note_overtaken())
            self._emit(self._pipeline.reset())
            self._end_recording()

    def put(self, source: Source, raw: bytes, sent_ns: int) -> None:
        """Take a message that was just received; `sent_ns` is the sender's wall clock, 0 if unknown."""
        now = self._clock.now_ns()
        self._received[source] += 1
        item = Input(source, self._received[source], raw, (now, sent_ns if sent_ns > 0 else now))
        with self._wake:
            self._waiting.append(item)
            self._wake.notify()

    def reset(self) -> None:
        """Forget everybody."""
        with self._busy:
            if self._journal is not None:
                self._recorded(self._journal.reset, self._clock.now_ns())
            self._emit(self._pipeline.reset())

    def reconfigure(self, config: Config) -> None:
        """Go on with other parameters."""
        with self._busy:
            if self._pipeline.reconfigure(config):
                self._logger.info('the tracker starts anew with the changed parameters')
            if self._journal is not None:
                self._recorded(self._journal.parameters, values(config), self._clock.now_ns())

    def record(self) -> Path:
        """Begin a recording, with a tracker that starts anew; returns the folder of the bag.

        Raises:
            RecordingError: one is going on already, or the folder cannot be written.
        """
        with self._busy:
            if self._recorder is not None:
                raise RecordingError(f'recording to {self._recorder.folder} already')
            config = self._pipeline.config
            now = self._before_waiting()
            recorder = Recorder(new_bag_folder(Path(config.recorder.folder), now), config.recorder)
            self._publish(self._pipeline.reset())
            self._recorder, self._journal = recorder, Journal(recorder, self._names['journal'])
            self._recorded(self._begin_recording, recorder, self._journal, now)
            self._logger.info(f'recording to {recorder.folder}')
            return recorder.folder

    def end_recording(self) -> Path | None:
        """Finish the recording; returns its folder, or None where there is none."""
        with self._busy:
            return self._end_recording()

    def _before_waiting(self) -> int:
        """Now, or just before the oldest input that still waits."""
        with self._wake:
            now = self._clock.now_ns()
            return min([now, *(i.times_ns[0] - 1 for i in self._waiting)])

    def _begin_recording(self, recorder: Recorder, journal: Journal, now: int) -> None:
        journal.parameters(values(self._pipeline.config), now)
        definition = skeleton_definition()
        for topic, msgtype in LATCHED_OUTPUTS.items():
            recorder.announce(self._names[topic], msgtype, latched=True)
        recorder.write(self._names[definition.topic], definition.type, definition.data, now, now)
        if self._pipeline.camera_info is not None:
            topic, raw = self._names[Source.CAMERA_INFO.value], self._pipeline.camera_info
            journal.input(topic, CAMERA_INFO, raw, (now, now), Verdict.ACCEPTED)

    def _end_recording(self) -> Path | None:
        recorder = self._recorder
        if recorder is None:
            return None
        self._recorded(recorder.close)
        self._recorder = self._journal = None
        self._logger.info(f'recorded {recorder.folder}')
        return recorder.folder

    def _work(self) -> None:
        while True:
            config = self._pipeline.config
            with self._wake:
                idle = not self._wake.wait_for(
                    lambda: self._waiting or self._end is not None, config.recorder.chunk_seconds
                )
                if self._end is not None and (not self._waiting or time.monotonic() > self._end):
                    return
            with self._busy:
                if idle:
                    if self._recorder is not None:
                        self._recorded(self._recorder.flush)
                    continue
                item = self._waiting.popleft()
                late = len(self._waiting) >= config.node.queue
                if late and item.source is Source.KEYPOINTS:
                    self._finish(item, self._pipeline.note_overtaken())
                else:
                    self._finish(item, self._fed(item))

    def _fed(self, item: Input) -> Outcome:
        try:
            return self._pipeline.feed(item.source, item.raw)
        except Exception as error:  # a fault of ours must not silence the node
            self._logger.error(traceback.format_exc())
            return Outcome(Verdict.INVALID, f'internal error: {error!r}')

    def _finish(self, item: Input, outcome: Outcome) -> None:
        """Publish and record what came of an input."""
        for output in outcome.outputs:
            self._publish(output)
        published_ns = self._clock.now_ns()
        topic = self._names[item.source.value]
        if outcome.reason:
            invalid = outcome.verdict is Verdict.INVALID
            self._complaints.add(topic, item.number, outcome.reason, error=invalid)
        if outcome.verdict is Verdict.ACCEPTED and item.source is Source.KEYPOINTS:
            self._note_accepted(topic)
        if self._journal is not None:
            kind = self._types[item.source]
            verdict, reason = outcome.verdict, outcome.reason
            self._recorded(self._journal.input, topic, kind, item.raw, item.times_ns, verdict, reason)
        for output in outcome.outputs:
            self._record(output, published_ns)

    def _emit(self, output: OutputMessage) -> None:
        """Publish and record an output that no input caused."""
        self._publish(output)
        self._record(output, self._clock.now_ns())

    def _record(self, output: OutputMessage, published_ns: int) -> None:
        if self._recorder is not None:
            topic, times = self._names[output.topic], (published_ns, published_ns)
            self._recorded(self._recorder.write, topic, output.type, output.data, *times)

    def _note_accepted(self, topic: str) -> None:
        """Say that keypoints are coming, and once that they name no frame."""
        if not self._heard:
            self._logger.info(f'{topic}: first message accepted')
        self._heard = True
        if not self._pipeline.header.frame_id and not self._frame_id_missed:
            self._logger.warning(f'{topic}: header.frame_id is empty: viewers cannot place the people')
            self._frame_id_missed = True

    def _recorded(self, action: Callable[..., None], *arguments: object) -> None:
        """Do something with the bag; where that fails, say so once and go on without."""
        try:
            action(*arguments)
        except RecordingError as error:
            self._logger.error(f'{error}; recording ends here')
            recorder, self._recorder, self._journal = self._recorder, None, None
            if recorder is not None:
                with suppress(RecordingError):
                    recorder.close()
