# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Process the messages of a live run: from a queue through the pipeline to the output topics and the recording.

Three threads share the work. That of the ROS executor puts each message into the queue as soon as it arrives, so
that its time of receipt is right and every message is counted while another one is being processed. The worker
thread processes the queue, and skips what the queue says (`input_queue.py`). The recorder's writes to the disk.
"""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from mocap_ros.bags.journal import Acceptance
from mocap_ros.bags.topics import PEOPLE_SOURCES, Source
from mocap_ros.config import Config
from mocap_ros.errors import RecordingError
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.ros.diagnostics import RunStatistics
from mocap_ros.ros.input_queue import MAX_WAITING, MAX_WAITING_BYTES, InputQueue, ReceivedMessage
from mocap_ros.ros.live_recording import FindOfferedQos, Recording
from mocap_ros.ros.message_types import MessageVersions
from mocap_ros.ros.throttled_log import Logger, ThrottledLog, TracebackLog
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from mocap_ros.runtime.run_memory import NOTHING, RunMemory

RECORDER_CHECK_SECONDS = 0.25  # s; between two looks at the recorder while no message arrives
# s; for which inputs wait while a recording is finished, which then goes on by itself; 50 of a topic can wait
MAX_PAUSE_SECONDS = 1.0
MAX_STOP_SECONDS = 0.3  # s; time to process waiting messages at a stop, so that the node ends within 1 s


class LiveRun:
    """Worker that feeds a pipeline from a queue, in a thread that lives from `start` to `stop`.

    `names` are the absolute names of all topics by relative name, and of the journal as `journal`. `publish` gets
    outputs in the installed versions of their types, from the worker thread and the caller's.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        input_types: Mapping[Source, str],
        names: Mapping[str, str],
        publish: Callable[[OutputMessage], None],
        logger: Logger,
        find_offered_qos: FindOfferedQos = lambda _: (),
        versions: MessageVersions | None = None,
    ) -> None:
        self._pipeline = pipeline
        self._types = input_types
        self._names = names
        self._publish = publish
        self._versions = versions or MessageVersions()
        self._find_offered_qos = find_offered_qos
        self._logger = logger
        self._throttled_log = ThrottledLog(logger)
        self._tracebacks = TracebackLog(logger)
        self.statistics = RunStatistics()
        self.queue = InputQueue()
        self._recording: Recording | None = None
        self._finisher = ThreadPoolExecutor(1, 'mocap recording')  # waits for the disk when a recording ends
        self._start_failure = ''  # why none could be started although recorder.enabled is set
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._pipeline_lock = threading.Lock()  # guards the pipeline and the recording
        self._stop_deadline = math.inf  # s, steady clock; set by `stop`
        self._has_accepted = self._has_published_people = self._has_warned_of_frame_id = False
        self._thread = threading.Thread(target=self._process_until_stopped, name='mocap pipeline')

    def start(self) -> None:
        """Start the worker thread, and a recording if `recorder.enabled` is set."""
        if self._pipeline.config.recorder.enabled:
            self.set_recording(True)
        self._thread.start()

    def stop(self) -> None:
        """Process waiting messages for at most `MAX_STOP_SECONDS`, delete the markers and finish the recording."""
        self._stop_deadline = time.monotonic() + MAX_STOP_SECONDS
        self.queue.close()
        if self._thread.ident is not None:
            self._thread.join()
        with self._pipeline_lock:
            try:
                self._report_removed()
                while popped := self.queue.pop(1):
                    self._publish_result(popped[0], self._pipeline.note_backlog())
                self._publish_and_record(self._reset_pipeline())
            except Exception:  # an internal error must not leave the recording open
                self._tracebacks.report(traceback.format_exc())
        with suppress(RecordingError):  # it has been logged
            self.finish_recording()
        self._finisher.shutdown()

    def enqueue(self, source: Source, raw: bytes, sent_ns: int, topic: str = '') -> None:
        """Put a message that has just been received into the queue.

        The wall-clock time of sending, `sent_ns`, is 0 if unknown; a source with several topics needs the absolute
        name of the `topic`.
        """
        now_ns = self._now_ns()
        if source in PEOPLE_SOURCES:
            self.statistics.record_receipt()
        times_ns = now_ns, sent_ns if sent_ns > 0 else now_ns
        self.queue.put(source, topic or self._names[source.value], raw, times_ns)

    def reset(self) -> str:
        """Discard all people; log that, and return it in words."""
        with self._pipeline_lock:
            if self._recording:
                self._recording.write_reset(self._now_ns())
            self._publish_and_record(self._reset_pipeline())
            self._logger.info(done := 'tracking was restarted by ~/reset')
        return done

    def check(self, config: Config) -> None:
        """Raise the error of `reconfigure` if these parameters cannot be used."""
        with self._pipeline_lock:
            self._pipeline.check(config)

    def reconfigure(self, config: Config) -> None:
        """Use other parameters from now on."""
        with self._pipeline_lock:
            if self._pipeline.reconfigure(config):
                self._logger.info('the tracker was restarted, because its parameters have changed')
            if self._recording:
                self._recording.write_parameters(config, self._now_ns())

    @property
    def recorder_state(self) -> str:
        """The state of the recorder in words, for diagnostics."""
        recording, failure = self._running, self._failure
        return recording.state if recording else f'not recording: {failure}' if failure else 'off'

    @property
    def recorder_fault(self) -> str:
        """What is wrong with the recorder, in words; empty if nothing is."""
        recording, failure = self._running, self._failure
        if recording:
            return recording.fault
        return f'recorder.enabled is set, but nothing is recorded: {failure}' if failure else ''

    @property
    def _running(self) -> Recording | None:
        recording = self._recording
        return recording if recording and not recording.failure else None

    @property
    def _failure(self) -> str:
        recording = self._recording
        return recording.failure if recording else self._start_failure

    def start_recording(self) -> Path:
        """Reset the tracker but for people's names, start a recording and return the folder of the bag."""
        with self._pipeline_lock:
            if self._running:
                raise RecordingError(f'a recording to {self._running.folder} is already running')
            now_ns = self._now_ns()
            first_ns = self.queue.find_first_receipt_ns()
            start_ns = now_ns if first_ns is None else min(now_ns, first_ns - 1)  # before all that waits
            try:
                self._recording = recording = Recording(
                    self._pipeline, start_ns, self._names, self._logger, self._find_offered_qos, self._versions
                )
            except RecordingError as error:
                self._start_failure = str(error) if self._pipeline.config.recorder.enabled else ''
                raise
            self._try_to_publish(self._reset_pipeline(self._pipeline.memory))
            self._logger.info(f'the recording to {recording.folder} has started')
            return recording.folder

    def finish_recording(self) -> Path | None:
        """Finish the recording and return its folder, or None if none is running; a failure is logged and raised.

        If the disk is slow, the recording is finished after the return, and its end is logged.
        """
        with self._pipeline_lock:
            recording = self._running
            self._recording = None
            self._start_failure = ''
        if recording is None:
            return None
        ending = self._finisher.submit(recording.finish)
        wait([ending], MAX_PAUSE_SECONDS)
        if ending.done():
            ending.result()
        else:
            self._logger.warning(
                f'the disk is slow; the recording to {recording.folder} will be finished when it has taken all'
            )
        return recording.folder

    def set_recording(self, is_wanted: bool) -> None:
        """Start or finish the recording if it is not yet in the wanted state; a failure is logged, not raised."""
        try:
            if not is_wanted:
                self.finish_recording()
            elif not self._running:
                self.start_recording()
        except RecordingError as error:
            if is_wanted:
                self._logger.error(
                    f'{error}; nothing is recorded: correct the cause, then set recorder.enabled again'
                )

    def _now_ns(self) -> int:
        """Return a wall-clock time that never jumps: it was read once and advances with the steady clock."""
        return time.monotonic_ns() + self._clock_offset_ns

    def _process_until_stopped(self) -> None:
        while self._wait_for_message():
            with self._pipeline_lock:
                for step in (self._check_recording, self._report_removed, self._process_next):
                    try:
                        step()
                    except Exception:  # noqa: PERF203, an internal error must not end the thread or keep a message
                        self._tracebacks.report(traceback.format_exc())

    def _wait_for_message(self) -> bool:
        """Wait for a message, for `RECORDER_CHECK_SECONDS` at most; return False when the run is to stop."""
        is_stopping = self.queue.wait(RECORDER_CHECK_SECONDS)
        return not is_stopping or (len(self.queue) > 0 and time.monotonic() <= self._stop_deadline)

    def _process_next(self) -> None:
        """Process or skip the next message, if one waits."""
        if popped := self.queue.pop(self._pipeline.config.node.queue):
            message, is_skipped = popped
            if is_skipped:
                self._publish_result(message, self._pipeline.note_backlog())
            else:
                self._process(message)

    def _check_recording(self) -> None:
        if self._recording:
            self._recording.check()

    def _report_removed(self) -> None:
        for topic, count in self.queue.pop_removed_counts().items():
            self.statistics.removed += count
            self._throttled_log.report(
                topic,
                self.queue.count_received(topic),
                f'{count} older messages were removed unseen, as {MAX_WAITING} messages of this topic or '
                f'{MAX_WAITING_BYTES // 1_000_000} MB were waiting; find out who publishes so much',
                is_error=False,
            )

    def _process(self, message: ReceivedMessage) -> None:
        start = time.monotonic()
        raw = self._versions.read(self._types[message.source], message.raw)
        result = self._pipeline.feed(message.source, raw, message.topic)
        outputs = tuple(map(self._versions.write_output, result.outputs))
        self._publish_result(message, replace(result, outputs=outputs))
        if message.source in PEOPLE_SOURCES:
            if outputs:  # of the messages of an image one alone has them
                self.statistics.solve_seconds.append(time.monotonic() - start)
            if error_traceback := self._pipeline.run_deferred_work():
                self._tracebacks.report(error_traceback)

    def _reset_pipeline(self, memory: RunMemory = NOTHING) -> list[OutputMessage]:
        """Discard all people; return the messages that delete them, in the installed versions of their types."""
        return [self._versions.write_output(output) for output in self._pipeline.reset(memory)]

    def _publish_result(self, message: ReceivedMessage, result: ProcessingResult) -> None:
        self._try_to_publish(result.outputs)
        published_ns = self._now_ns()
        topic, number = message.topic, message.number
        if result.error_traceback:
            self._tracebacks.report(result.error_traceback)
        if result.reason:
            is_error = result.acceptance is Acceptance.INVALID or bool(result.error_traceback)
            self._throttled_log.report(topic, number, result.reason, is_error=is_error)
            if result.acceptance in (
                Acceptance.INVALID,
                Acceptance.DROPPED,
            ):  # the number of skipped ones says why
                self.statistics.reason = f'{topic}: {result.reason}'
        if result.acceptance is Acceptance.ACCEPTED and message.source in PEOPLE_SOURCES and result.outputs:
            self._note_accepted(topic)
        recording = self._recording
        if recording and not recording.write_input(message, self._types[message.source], result, published_ns):
            reason = 'the message was processed but not recorded, as the disk is too slow; record to a faster disk'
            self._throttled_log.report(topic, number, reason)

    def _publish_and_record(self, outputs: Iterable[OutputMessage]) -> None:
        for output in outputs:
            self._try_to_publish([output])
            if self._recording:
                self._recording.write_output(output, self._now_ns())

    def _try_to_publish(self, outputs: Iterable[OutputMessage]) -> None:
        for output in outputs:
            try:
                self._publish(output)
            except Exception:  # noqa: PERF203, rclpy raises many types; the other outputs and the recording go on
                self._tracebacks.report(f'{output.topic}: {traceback.format_exc()}')

    def _note_accepted(self, topic: str) -> None:
        """Log the first accepted message, the first people, and once that header.frame_id is empty."""
        if self._pipeline.people and not self._has_published_people:
            before = '' if self._has_accepted else 'the first message was accepted, and '
            self._logger.info(f'{topic}: {before}people are being published')
            self._has_published_people = True
        elif not self._has_accepted:
            self._logger.info(f'{topic}: the first message was accepted, and no person in it can be tracked')
        self._has_accepted = True
        if not self._pipeline.output_header.frame_id and not self._has_warned_of_frame_id:
            self._logger.warning(
                f'{topic}: header.frame_id is empty, so viewers cannot place the people; '
                "set it to the camera's optical frame where the keypoints are published"
            )
            self._has_warned_of_frame_id = True
