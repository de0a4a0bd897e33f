"""A live run: messages in from one thread, through the pipeline in another, out to topics and bag.

A thread of its own takes the messages from the middleware as soon as they come, so that their time of receipt is
right and none is lost unnoticed while a frame is being solved. The oldest are passed over when too many wait.
Another thread writes to the disk.
"""

from __future__ import annotations

import re
import textwrap
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.journal import Journal, Verdict
from mocap_ros.bags.recorder import Record, new_bag_folder
from mocap_ros.bags.rosbag2 import Topic, known_topic
from mocap_ros.bags.topics import PEOPLE_SOURCES, Source
from mocap_ros.config import Config, values
from mocap_ros.errors import RecordingError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.ros.diagnostics import Pulse
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, Outcome, Pipeline, skeleton_definition
from mocap_ros.runtime.provenance import attachments

KINDS_OF_A_TOPIC = 30
STRANGE = re.compile(r"0x\w+|\d+|'.*'|\".*\"", re.DOTALL)
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
    """Logs what goes wrong with a topic: the same kind of thing the 1st, 10th, 100th, ... time only.

    What a kind is does not depend on numbers and names in a message, and a topic has `KINDS_OF_A_TOPIC` at most:
    strangers cannot flood the log.
    """

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._times: dict[str, Counter[str]] = {}

    def add(self, where: str, number: int, reason: str, *, error: bool = True) -> None:
        """Complain about message `number` of a topic."""
        times = self._times.setdefault(where, Counter())
        kind = STRANGE.sub('#', reason)
        if kind not in times and len(times) >= KINDS_OF_A_TOPIC:
            kind = ''
        times[kind] += 1
        if str(times[kind]).strip('0') == '1':
            again = f' (for the {times[kind]}th time)' if times[kind] > 1 else ''
            also = '' if kind else ' (much else is wrong with this topic too)'
            line = _one_line(f'{where}: message {number}: {reason}') + also + again
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
        topic: absolute name.
        number: of the message on its topic, from 1.
        raw: CDR.
        times_ns: of receipt, and at which the sender sent it; wall clock.
    """

    source: Source
    topic: str
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
        offered_qos: profiles that the publishers of a topic offer, by rosbag2's names.

    Attributes:
        pulse: how it is doing.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        input_types: Mapping[Source, str],
        names: Mapping[str, str],
        publish: Callable[[OutputMessage], None],
        logger: Logger,
        offered_qos: Callable[[str], Sequence[Mapping[str, Any]]] = lambda _: (),
    ) -> None:
        self._pipeline = pipeline
        self._types = input_types
        self._names = names
        self._publish = publish
        self._logger = logger
        self._offered_qos = offered_qos
        self._known_inputs: set[str] = set()
        self._complaints = Complaints(logger)
        self._clock = SteadyWallClock()
        self.pulse = Pulse()
        self._waiting: deque[Input] = deque()
        self._wake = threading.Condition()
        self._busy = threading.Lock()
        self._end: float | None = None
        self._heard = self._frame_id_missed = False
        self._recorder: BackgroundRecorder | None = None
        self._journal = Journal(names['journal'])
        self._not_recorded = 0
        self._faults: set[str] = set()
        self._received: Counter[str] = Counter()
        self._keep_from: dict[str, int] = {}
        self._thread = threading.Thread(target=self._work, name='mocap pipeline')

    def start(self) -> None:
        """Start the thread, and the recording if the configuration wants one."""
        if self._pipeline.config.recorder.enabled:
            self.want_recording(True)
        self._thread.start()

    def stop(self) -> None:
        """Do what still waits, for `LAST_SECONDS` at most; delete the markers and finish the recording."""
        with self._wake:
            self._end = time.monotonic() + LAST_SECONDS
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join()
        with self._busy:
            while self._waiting:
                self._finish(self._waiting.popleft(), self._pipeline.note_backlog())
            self._emit(self._pipeline.reset())
            with suppress(RecordingError):  # which has been logged
                self._end_recording()

    @property
    def recorder_state(self) -> str:
        """What the recorder is doing, in words."""
        recorder = self._recorder
        if recorder is None:
            return 'off'
        missing = f'; {self._not_recorded} inputs missing' if self._not_recorded else ''
        return f'recording to {recorder.folder}{missing}'

    def put(self, source: Source, raw: bytes, sent_ns: int, topic: str = '') -> None:
        """Take a message that was just received.

        Args:
            source: what it is.
            raw: CDR.
            sent_ns: the sender's wall clock, 0 if unknown.
            topic: absolute name, where the source has several.
        """
        now = self._clock.now_ns()
        topic = topic or self._names[source.value]
        self._received[topic] += 1
        item = Input(source, topic, self._received[topic], raw, (now, sent_ns if sent_ns > 0 else now))
        if source in PEOPLE_SOURCES:
            self.pulse.receive()
        with self._wake:
            self._waiting.append(item)
            self._wake.notify()

    def reset(self) -> None:
        """Forget everybody."""
        with self._busy:
            self._save([self._journal.reset(self._clock.now_ns())])
            self._emit(self._pipeline.reset())

    def reconfigure(self, config: Config) -> None:
        """Go on with other parameters."""
        with self._busy:
            if self._pipeline.reconfigure(config):
                self._logger.info('the tracker starts anew with the changed parameters')
            self._save([self._journal.parameters(values(config), self._clock.now_ns())])

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
            folder = new_bag_folder(Path(config.recorder.folder), now)
            made_with = attachments(config, self._pipeline.models)
            self._recorder = BackgroundRecorder(folder, config.recorder, made_with)
            self._known_inputs = set()
            self._journal = Journal(self._names['journal'])
            self._not_recorded = 0
            self._publish(self._pipeline.reset())
            self._save(self._beginning(now))
            self._logger.info(f'recording to {folder}')
            return folder

    def end_recording(self) -> Path | None:
        """Finish the recording; returns its folder, or None where there is none.

        Raises:
            RecordingError: it could not be finished.
        """
        with self._busy:
            return self._end_recording()

    def want_recording(self, wanted: bool) -> None:
        """Begin or finish the recording, where that is not so already; what goes wrong is logged."""
        try:
            if wanted and self._recorder is None:
                self.record()
            elif not wanted:
                self.end_recording()
        except RecordingError as error:
            if wanted:
                self._logger.error(f'{error}; nothing is recorded')

    def _before_waiting(self) -> int:
        """Now, or just before the oldest input that still waits."""
        with self._wake:
            now = self._clock.now_ns()
            return min([now, *(i.times_ns[0] - 1 for i in self._waiting)])

    def _beginning(self, now: int) -> list[Record | Topic]:
        """What every recording begins with."""
        definition = skeleton_definition()
        records: list[Record | Topic] = [
            *(known_topic(self._names[t], kind, latched=True) for t, kind in LATCHED_OUTPUTS.items()),
            self._journal.parameters(values(self._pipeline.config), now),
            Record(self._names[definition.topic], definition.type, definition.data, now, now),
        ]
        if self._pipeline.camera_info is not None:
            topic, raw = self._names[Source.CAMERA_INFO.value], self._pipeline.camera_info
            records += self._known(topic, CAMERA_INFO)
            records += self._journal.input(topic, CAMERA_INFO, raw, (now, now), Verdict.ACCEPTED)
        return records

    def _known(self, topic: str, kind: str) -> list[Topic]:
        """The topic of an input before its first message, with what its publishers offer."""
        if topic in self._known_inputs:
            return []
        self._known_inputs.add(topic)
        return [known_topic(topic, kind, qos=self._offered_qos(topic))]

    def _end_recording(self) -> Path | None:
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return None
        try:
            recorder.close()
        except RecordingError as error:
            self._logger.error(f'{error}; the recording could not be finished')
            raise
        lost = (
            f'; {self._not_recorded} inputs are missing in it: the disk was too slow' if self._not_recorded else ''
        )
        self._logger.info(f'recorded {recorder.folder}{lost}')
        return recorder.folder

    def _work(self) -> None:
        while self._guarded_step():
            pass

    def _guarded_step(self) -> bool:
        try:
            return self._step()
        except Exception:  # a fault of ours must not silence the node
            self._tell_fault(traceback.format_exc())
            return True

    def _step(self) -> bool:
        """Do what comes next; returns False at the end."""
        config = self._pipeline.config
        with self._wake:
            self._wake.wait_for(lambda: self._waiting or self._end is not None, config.recorder.chunk_seconds)
            if self._end is not None and (not self._waiting or time.monotonic() > self._end):
                return False
        with self._busy:
            self._save([])
            if not self._waiting:
                return True
            item = self._waiting.popleft()
            if len(self._waiting) >= config.node.queue:
                self._keep_from = dict(self._received)
            if item.source in PEOPLE_SOURCES and item.number < self._keep_from.get(item.topic, 0):
                self._finish(item, self._pipeline.note_backlog())
            else:
                begun = time.monotonic()
                self._finish(item, self._pipeline.feed(item.source, item.raw, item.topic))
                if item.source in PEOPLE_SOURCES:
                    self.pulse.solve(time.monotonic() - begun)
                    if fault := self._pipeline.idle():
                        self._tell_fault(fault)
        return True

    def _tell_fault(self, fault: str) -> None:
        """Log a traceback, the same one once."""
        if fault not in self._faults and len(self._faults) < KINDS_OF_A_TOPIC:
            self._faults.add(fault)
            self._logger.error(fault)

    def _finish(self, item: Input, outcome: Outcome) -> None:
        """Publish and record what came of an input."""
        for output in outcome.outputs:
            self._publish(output)
        published_ns = self._clock.now_ns()
        topic = item.topic
        if outcome.fault:
            self._tell_fault(outcome.fault)
        if outcome.reason:
            wrong = outcome.verdict is Verdict.INVALID or bool(outcome.fault)
            self._complaints.add(topic, item.number, outcome.reason, error=wrong)
        if outcome.verdict is Verdict.ACCEPTED and item.source in PEOPLE_SOURCES and outcome.outputs:
            self._note_accepted(topic)
        if self._recorder is None:
            return
        kind, verdict, reason = self._types[item.source], outcome.verdict, outcome.reason
        records: list[Record | Topic] = [*self._known(topic, kind)]
        records += self._journal.input(topic, kind, item.raw, item.times_ns, verdict, reason)
        records += [self._record_of(output, published_ns) for output in outcome.outputs]
        if not self._save(records, always=False):
            self._journal.take_back()
            self._known_inputs.discard(topic)
            self._not_recorded += 1
            self._complaints.add(topic, item.number, 'not recorded: the disk is too slow')

    def _emit(self, output: OutputMessage) -> None:
        """Publish and record an output that no input caused."""
        self._publish(output)
        self._save([self._record_of(output, self._clock.now_ns())])

    def _record_of(self, output: OutputMessage, published_ns: int) -> Record:
        return Record(self._names[output.topic], output.type, output.data, published_ns, published_ns)

    def _save(self, records: Iterable[Record | Topic], *, always: bool = True) -> bool:
        """Have them recorded, if there is a recording; where it has failed, say so and go on without.

        Returns:
            False where the disk is too slow to take them.
        """
        if self._recorder is None:
            return True
        try:
            return self._recorder.put(records, always=always)
        except RecordingError as error:
            self._logger.error(f'{error}; recording ends here')
            self._recorder = None
            return True

    def _note_accepted(self, topic: str) -> None:
        """Say that keypoints are coming, and once that they name no frame."""
        if not self._heard:
            self._logger.info(f'{topic}: first message accepted')
        self._heard = True
        if not self._pipeline.header.frame_id and not self._frame_id_missed:
            self._logger.warning(f'{topic}: header.frame_id is empty: viewers cannot place the people')
            self._frame_id_missed = True
