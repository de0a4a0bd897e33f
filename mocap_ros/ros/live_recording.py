# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A recording of a live run: its inputs, its outputs and the journal from which a replay repeats the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mocap_ros.bags.background import start_recorder
from mocap_ros.bags.journal import Acceptance, Journal
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


class Recording:
    """One recording of a run, which a thread of its own writes. If it fails, this is logged, and the run goes on.

    The parameters of the pipeline say where and how; what it knows already is recorded first. Messages are written
    and defined in the installed versions of their types. `failure` says why the recording has ended by itself; it
    is empty while it runs.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        start_ns: int,
        names: Mapping[str, str],
        logger: Logger,
        find_offered_qos: FindOfferedQos,
        versions: MessageVersions,
    ) -> None:
        self._names = names
        self._logger = logger
        self._versions = versions
        self._find_offered_qos = find_offered_qos
        self._journal = Journal(names['journal'])
        self._declared = {names[topic] for topic in LATCHED_OUTPUTS}  # topics that are in the bag
        self._stalled_s = 0.0  # of the stall that has been logged
        attachments = provenance_attachments(pipeline.config, pipeline.models)
        first_records = self._make_first_records(pipeline, start_ns)
        self._recorder = start_recorder(start_ns, pipeline.config.recorder, attachments, versions.definitions)
        self.folder = self._recorder.folder
        self.failure = ''
        self._put(first_records)

    @property
    def state(self) -> str:
        """The state in words, for diagnostics."""
        missing = self._recorder.refused_count
        return f'recording to {self.folder}' + (f'; {missing} inputs missing' if missing else '')

    @property
    def fault(self) -> str:
        """Why the disk does not keep up, in words; empty if it does."""
        stalled_s = self._recorder.stalled_s
        return f'the disk has taken nothing of the recording for {stalled_s:.1f} s' * (stalled_s >= MAX_STALL_S)

    def check(self) -> None:
        """Log a failure, that the disk takes nothing, and that it works again, each once."""
        self._put([])
        stalled_s = self._recorder.stalled_s
        if stalled_s > MAX_STALL_S and not self.failure:
            if not self._stalled_s:
                self._logger.error(
                    f'the disk has taken nothing of the recording to {self.folder} for {stalled_s:.1f} s; '
                    'some inputs wait for it, and further ones will not be recorded'
                )
            self._stalled_s = stalled_s
        elif self._stalled_s:
            self._logger.info(f'the disk takes the recording again, after {self._stalled_s:.1f} s')
            self._stalled_s = 0.0

    def finish(self) -> None:
        """Finish the recording, which waits for the disk, and log how it ends, also before an error."""
        self._put(self._journal.make_lost_records())
        if self.failure:
            raise RecordingError(self.failure)
        try:
            self._recorder.close()
        except RecordingError as error:
            self._logger.error(f'{error}; the recording has ended')
            raise
        line = f'the recording to {self.folder} is finished'
        missing = self._recorder.refused_count
        if missing:
            line += f', but {missing} inputs are missing in it, as the disk was too slow; record to a faster disk'
        self._logger.info(line)

    def write_input(
        self, message: ReceivedMessage, msgtype: str, result: ProcessingResult, published_ns: int
    ) -> bool:
        """Write an input, its journal entry and its outputs.

        Returns False if the disk is too slow to write them; the journal then notes that the input is missing.
        """
        content = self._versions.read(msgtype, message.raw)
        is_accepted = result.acceptance is Acceptance.ACCEPTED
        repeat_keys = make_repeat_keys(message.source, content, is_accepted=is_accepted)
        records: list[RecordedMessage | Topic] = [
            *self._declare_input(message.source, message.topic, msgtype),
            *self._journal.make_input_records(
                message.topic,
                msgtype,
                message.raw,
                message.times_ns,
                result.acceptance,
                result.reason,
                repeat_keys,
            ),
            *(self._make_output_record(output, published_ns) for output in result.outputs),
        ]
        is_unused = result.acceptance is Acceptance.BACKLOG or not result.was_decoded
        if self._put(records, even_if_full=False, share=UNUSED_SHARE if is_unused else 1.0):
            return True
        self._journal.mark_last_input_lost()
        self._declared.difference_update(r.name for r in records if isinstance(r, Topic))
        return False

    def write_output(self, output: OutputMessage, published_ns: int) -> None:
        """Write an output that no input caused."""
        self._put([self._make_output_record(output, published_ns)])

    def write_reset(self, now_ns: int) -> None:
        """Write that the tracker is reset."""
        self._put([self._journal.make_reset_record(now_ns)])

    def write_parameters(self, config: Config, now_ns: int) -> None:
        """Write the parameters that hold from now on, and use those of the recorder."""
        self._recorder.reconfigure(config.recorder)
        self._put([self._journal.make_parameters_record(values(config), now_ns)])

    def _make_first_records(self, pipeline: Pipeline, start_ns: int) -> list[RecordedMessage | Topic]:
        definition = self._versions.write_output(build_skeleton_definition(pipeline.config.tracker.skeleton))
        records: list[RecordedMessage | Topic] = [
            *(self._make_topic(self._names[t], msgtype, latched=True) for t, msgtype in LATCHED_OUTPUTS.items()),
            self._journal.make_parameters_record(values(pipeline.config), start_ns),
            self._make_output_record(definition, start_ns),
        ]
        if kept := pipeline.memory.encode():
            records.append(self._journal.make_reset_record(start_ns, kept))
        static, dynamic = pipeline.transforms.encode_all()
        prefix = pipeline.config.node.frame_prefix  # a replay takes what is of people only as an output
        known = {
            Source.CAMERA_INFO: [] if pipeline.camera_info is None else [pipeline.camera_info],
            Source.STATIC_TRANSFORMS: static,
            Source.TRANSFORMS: [raw for raw in dynamic if not is_of_people_only(raw, prefix)],
        }
        for source, messages in known.items():
            msgtype = CAMERA_INFO if source is Source.CAMERA_INFO else TRANSFORMS
            for content in messages:
                topic = self._names[source.value]
                times_ns = (start_ns, start_ns)
                raw = self._versions.write(msgtype, content)
                keys = make_repeat_keys(source, content)
                records += self._declare_input(source, topic, msgtype)
                records += self._journal.make_input_records(
                    topic, msgtype, raw, times_ns, Acceptance.ACCEPTED, repeat_keys=keys
                )
        return records

    def _declare_input(self, source: Source, topic: str, msgtype: str) -> list[Topic]:
        """Return the topic of an input, with the QoS that its publishers offer, before its first message."""
        if topic in self._declared:
            return []
        self._declared.add(topic)
        is_latched = source is Source.STATIC_TRANSFORMS  # also when its publisher has gone
        return [self._make_topic(topic, msgtype, latched=is_latched, qos=self._find_offered_qos(topic))]

    def _make_topic(
        self, name: str, msgtype: str, *, latched: bool, qos: Sequence[Mapping[str, Any]] = ()
    ) -> Topic:
        definition = self._versions.definitions.get(msgtype)
        return make_topic(name, msgtype, latched=latched, qos=qos, definition=definition)

    def _make_output_record(self, output: OutputMessage, published_ns: int) -> RecordedMessage:
        name = self._names.get(output.topic, output.topic)
        return RecordedMessage(name, output.type, output.data, published_ns, published_ns, may_begin_file=False)

    def _put(
        self, records: Iterable[RecordedMessage | Topic], *, even_if_full: bool = True, share: float = 1.0
    ) -> bool:
        """Hand records to the recorder; return False if the disk is too slow to take them."""
        if self.failure:
            return True
        try:
            return self._recorder.put(records, even_if_full=even_if_full, share=share)
        except RecordingError as error:
            self._logger.error(
                f'{error}; the recording has ended, and the node continues without it: set recorder.enabled '
                'again to start another recording'
            )
            self.failure = str(error)
            return True
