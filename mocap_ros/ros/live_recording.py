# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Record a live run: its inputs, its outputs and the journal from which a replay repeats the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mocap_ros.bags.background import BackgroundRecorder, start_recorder
from mocap_ros.bags.journal import Journal, Verdict
from mocap_ros.bags.recorder import RecordedMessage
from mocap_ros.bags.rosbag2 import Topic, make_topic
from mocap_ros.bags.topics import Source, make_repeat_keys
from mocap_ros.config import Config, values
from mocap_ros.errors import RecordingError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.input_queue import ReceivedMessage
from mocap_ros.ros.message_types import MessageVersions
from mocap_ros.ros.throttled_log import Logger
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, build_skeleton_definition
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from mocap_ros.runtime.provenance import provenance_attachments

# Share of the recorder's queue that inputs may fill which did not reach the tracker. The rest is kept for those
# that did, so that a flood of others does not make a replay differ from the run.
UNUSED_SHARE = 0.5
MAX_STALL_S = 0.5  # s; after which a recorder whose disk takes nothing is reported; far above a busy disk's pauses

# A function that returns the QoS profiles, by rosbag2's names, that the publishers of a topic offer.
FindOfferedQos = Callable[[str], Sequence[Mapping[str, Any]]]


class LiveRecording:
    """Recorder of a live run; it writes in its own thread and can be started and finished at any time.

    While no recording is running, the methods that write do nothing. A recording that fails is logged and ends;
    the run continues without it.

    Args:
        names: Absolute name of each topic by its relative name; the key of the journal's topic is `journal`.
        logger: Logger of the run.
        find_offered_qos: Function that returns the QoS profiles that the publishers of a topic offer.
        versions: Installed versions of the message types, in which messages are written and defined.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        logger: Logger,
        find_offered_qos: FindOfferedQos,
        versions: MessageVersions,
    ) -> None:
        self._versions = versions
        self._names = names
        self._logger = logger
        self._find_offered_qos = find_offered_qos
        self._recorder: BackgroundRecorder | None = None
        self._failure = ''  # why no recording runs although recorder.enabled is set
        self._journal = Journal(names['journal'])
        self._declared_topics: set[str] = set()  # those that need more than a name and a type
        self._stalled_s = 0.0  # of the stall that has been logged
        self._finishing: list[BackgroundRecorder] = []  # of recordings that have ended, but are not finished yet

    @property
    def is_running(self) -> bool:
        """Whether a recording is running."""
        return self._recorder is not None

    @property
    def state(self) -> str:
        """The state of the recorder in words, for diagnostics."""
        recorder = self._recorder
        if recorder is None:
            return f'not recording: {self._failure}' if self._failure else 'off'
        missing = f'; {recorder.refused_count} inputs missing' if recorder.refused_count else ''
        return f'recording to {recorder.folder}{missing}'

    @property
    def fault(self) -> str:
        """What is wrong with the recorder, in words; empty if nothing is."""
        recorder = self._recorder
        if recorder is None:
            return f'recorder.enabled is set, but nothing is recorded: {self._failure}' if self._failure else ''
        if recorder.stalled_s < MAX_STALL_S:
            return ''
        return f'the disk has taken nothing of the recording for {recorder.stalled_s:.1f} s'

    def start(self, pipeline: Pipeline, start_ns: int) -> Path:
        """Start a recording with the latched messages and the parameters, and return the folder of the bag.

        Args:
            pipeline: Pipeline of the run; its parameters say where and how to record.
            start_ns: Wall-clock time of the first records.

        Raises:
            RecordingError: A recording is already running, or the folder cannot be written.
        """
        if self._recorder is not None:
            raise RecordingError(f'a recording to {self._recorder.folder} is already running')
        config = pipeline.config.recorder
        self._declared_topics = {self._names[topic] for topic in LATCHED_OUTPUTS}
        self._journal = Journal(self._names['journal'])
        self._stalled_s, self._failure = 0.0, ''
        try:
            attachments = provenance_attachments(pipeline.config, pipeline.models)
            first_records = self._make_first_records(pipeline, start_ns)
            recorder = start_recorder(start_ns, config, attachments, self._versions.definitions)
            try:
                recorder.put(first_records, even_if_full=True)
            except RecordingError:
                with suppress(RecordingError):  # the same one
                    recorder.close()
                raise
        except RecordingError as error:
            self._failure = str(error) if config.enabled else ''
            raise
        self._recorder = recorder
        return recorder.folder

    def detach(self) -> BackgroundRecorder | None:
        """End the recording and return its recorder, which is to be passed to `finish`; None if there is none."""
        self._put(self._journal.make_lost_records())
        recorder, self._recorder = self._recorder, None
        self._failure = ''
        return recorder

    def finish(self, recorder: BackgroundRecorder | None, timeout_s: float | None = None) -> Path | None:
        """Finish a recording that has been detached and return its folder, or None if there was none.

        Args:
            recorder: Recorder of the recording.
            timeout_s: How long to wait for the disk; if that is not enough, `check` logs the end of the recording.

        Raises:
            RecordingError: The recording could not be finished; this has been logged.
        """
        if recorder is None:
            return None
        try:
            is_finished = recorder.close(timeout_s)
        except RecordingError as error:
            self._logger.error(f'{error}; the recording has ended')
            raise
        if not is_finished:
            self._finishing.append(recorder)
            self._logger.warning(
                f'the disk is slow; {recorder.waiting_count} inputs wait for it, and the recording to '
                f'{recorder.folder} will be finished when it has taken them'
            )
        elif recorder.refused_count:
            self._logger.info(
                f'the recording to {recorder.folder} is finished, but {recorder.refused_count} inputs are missing '
                'in it, as the disk was too slow; record to a faster disk'
            )
        else:
            self._logger.info(f'the recording to {recorder.folder} is finished')
        return recorder.folder

    def close(self, timeout_s: float) -> None:
        """End the recording, and wait for it and for those before it to be finished; log how each of them ends.

        Args:
            timeout_s: Time after which the log says that the disk is slow; the waiting goes on.
        """
        with suppress(RecordingError):  # it has been logged
            self.finish(self.detach(), timeout_s)
        while self._finishing:
            with suppress(RecordingError):  # likewise
                self.finish(self._finishing.pop(0))

    def check(self) -> None:
        """Log what has become of the recording, and of those being finished, since the last call."""
        self._put([])
        self._log_stall()
        for recorder in [r for r in self._finishing if r.is_closed]:
            self._finishing.remove(recorder)
            with suppress(RecordingError):  # it has been logged
                self.finish(recorder)

    def _log_stall(self) -> None:
        """Log that the disk takes nothing, once, and that it works again."""
        recorder = self._recorder
        if recorder is None:
            return
        stalled_s = recorder.stalled_s
        if stalled_s > MAX_STALL_S:
            if not self._stalled_s:
                self._logger.error(
                    f'the disk has taken nothing of the recording to {recorder.folder} for {stalled_s:.1f} s; '
                    'some inputs wait for it, and further ones will not be recorded'
                )
            self._stalled_s = stalled_s
        elif self._stalled_s:
            self._logger.info(f'the disk takes the recording again, after {self._stalled_s:.1f} s')
            self._stalled_s = 0.0

    def write_input(
        self, message: ReceivedMessage, msgtype: str, result: ProcessingResult, published_ns: int
    ) -> bool:
        """Write an input, its journal entry and its outputs.

        Args:
            message: The input.
            msgtype: Type of the message.
            result: Result of the input.
            published_ns: Wall-clock time at which the outputs were published.

        Returns:
            False if the disk is too slow to write them; the journal then notes that the input is missing.
        """
        if self._recorder is None:
            return True
        content, is_accepted = self._versions.read(msgtype, message.raw), result.verdict is Verdict.ACCEPTED
        repeat_keys = make_repeat_keys(message.source, content, is_accepted=is_accepted)
        records: list[RecordedMessage | Topic] = [
            *self._declare_input(message.source, message.topic, msgtype),
            *self._journal.make_input_records(
                message.topic, msgtype, message.raw, message.times_ns, result.verdict, result.reason, repeat_keys
            ),
            *(self._make_output_record(output, published_ns) for output in result.outputs),
        ]
        is_unused = result.verdict is Verdict.BACKLOG or not result.was_decoded
        if self._put(records, even_if_full=False, share=UNUSED_SHARE if is_unused else 1.0):
            return True
        self._journal.mark_last_input_lost()
        self._declared_topics.difference_update(r.name for r in records if isinstance(r, Topic))
        return False

    def write_output(self, output: OutputMessage, published_ns: int) -> None:
        """Write an output that no input caused."""
        self._put([self._make_output_record(output, published_ns)])

    def write_reset(self, now_ns: int) -> None:
        """Write that the tracker is reset."""
        self._put([self._journal.make_reset_record(now_ns)])

    def write_parameters(self, config: Config, now_ns: int) -> None:
        """Write the parameters that hold from now on, and use those of the recorder."""
        if self._recorder is not None:
            self._recorder.reconfigure(config.recorder)
        self._put([self._journal.make_parameters_record(values(config), now_ns)])

    def _make_first_records(self, pipeline: Pipeline, start_ns: int) -> list[RecordedMessage | Topic]:
        """Make the records of what the pipeline knows already, from which a replay begins."""
        definition = self._versions.write_output(build_skeleton_definition(pipeline.config.tracker.skeleton))
        records: list[RecordedMessage | Topic] = [
            *(self._make_topic(self._names[t], msgtype, latched=True) for t, msgtype in LATCHED_OUTPUTS.items()),
            self._journal.make_parameters_record(values(pipeline.config), start_ns),
            self._make_output_record(definition, start_ns),
        ]
        known: list[tuple[Source, str, bytes]] = []
        if pipeline.camera_info is not None:
            known.append((Source.CAMERA_INFO, CAMERA_INFO, pipeline.camera_info))
        if not pipeline.transforms.is_empty:
            static, dynamic = pipeline.transforms.encode_all()
            known += [(Source.STATIC_TRANSFORMS, TRANSFORMS, raw) for raw in static]
            prefix = pipeline.config.node.frame_prefix  # a replay takes what is of people only as an output
            known += [
                (Source.TRANSFORMS, TRANSFORMS, raw) for raw in dynamic if not is_of_people_only(raw, prefix)
            ]
        for source, msgtype, content in known:
            topic, times_ns = self._names[source.value], (start_ns, start_ns)
            records += self._declare_input(source, topic, msgtype)
            raw, repeat_keys = self._versions.write(msgtype, content), make_repeat_keys(source, content)
            records += self._journal.make_input_records(
                topic, msgtype, raw, times_ns, Verdict.ACCEPTED, repeat_keys=repeat_keys
            )
        return records

    def _declare_input(self, source: Source, topic: str, msgtype: str) -> list[Topic]:
        """Return the topic of an input, with the QoS that its publishers offer, before its first message."""
        if topic in self._declared_topics:
            return []
        self._declared_topics.add(topic)
        is_latched = source is Source.STATIC_TRANSFORMS  # also when its publisher has gone
        return [self._make_topic(topic, msgtype, latched=is_latched, qos=self._find_offered_qos(topic))]

    def _make_topic(
        self, name: str, msgtype: str, *, latched: bool, qos: Sequence[Mapping[str, Any]] = ()
    ) -> Topic:
        definition = self._versions.definitions.get(msgtype)  # of the installed version of the type
        return make_topic(name, msgtype, latched=latched, qos=qos, definition=definition)

    def _make_output_record(self, output: OutputMessage, published_ns: int) -> RecordedMessage:
        name = self._names.get(output.topic, output.topic)
        return RecordedMessage(name, output.type, output.data, published_ns, published_ns, may_begin_file=False)

    def _put(
        self, records: Iterable[RecordedMessage | Topic], *, even_if_full: bool = True, share: float = 1.0
    ) -> bool:
        """Hand records to the recorder; return False if the disk is too slow to take them.

        If the recording has failed, this is logged, and the recording ends.
        """
        if self._recorder is None:
            return True
        try:
            return self._recorder.put(records, even_if_full=even_if_full, share=share)
        except RecordingError as error:
            self._logger.error(
                f'{error}; the recording has ended, and the node continues without it: set recorder.enabled '
                'again to start another recording'
            )
            self._failure = str(error)
            self._recorder = None
            return True
