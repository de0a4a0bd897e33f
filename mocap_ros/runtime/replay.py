# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the inputs of a recorded bag through the pipeline of the live node and record the outputs in a new bag.

A replay processes the inputs that the recorded run processed, in the same order, and so gives the same outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2.metadata import dump_qos_v9

from mocap_ros.bags.journal import PARAMETERS, RESET, Acceptance, Journal, read_run
from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import Recorder, choose_partial_path
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.bags.topics import (
    PEOPLE_SOURCES,
    Source,
    find_inputs,
    find_robot_topics,
    make_repeat_keys,
)
from mocap_ros.config import Config, Value, settings, values, with_values
from mocap_ros.errors import ConfigError, InputError, RecordingError, name_errors
from mocap_ros.findings import find_kind
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.models.model_file import AUTO, PRIORS, list_shipped_base_poses
from mocap_ros.runtime.appearances import Appearance, AppearanceLog
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, build_skeleton_definition
from mocap_ros.runtime.pipeline import Counters, Pipeline, ProcessingResult
from mocap_ros.runtime.provenance import provenance_attachments
from mocap_ros.runtime.run_memory import RunMemory
from mocap_ros.summary import Summary

JOURNAL_TOPIC = '/mocap_replay/journal'  # ends as the journal of a live run, so that a replay can be replayed
INPUT_TYPE_PARAMETER = 'node.input_type'  # set to the type of the bag's keypoints, whatever the parameters say
WAIT_PARAMETER = 'node.camera_info_wait'  # 0 where the recorded run did not know it, or no CameraInfo can come
PREFIX_PARAMETER = 'node.frame_prefix'  # by which the people of the recorded run are known on /tf

# A function that shows progress while the messages it is given are iterated; its second argument is their number.
ProgressWrapper = Callable[[Iterable[BagMessage], int], Iterable[BagMessage]]


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay."""

    # Parameters; None for the parameters of the recorded run, or the defaults where the bag has none
    config: Config | None = None
    # Topic of the keypoints, or for ROS4HRI of the tracked bodies; needed only for a bag with several
    topic: str | None = None
    camera_info: str | None = None  # topic of the CameraInfo; needed only for a bag with several
    # Values of single parameters by name, which replace those of `config` or of the recorded run
    changes: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class ReplayResult:
    """Summary of a replay."""

    counters: Counters  # numbers of keypoint messages by what became of them
    summary: Summary  # what the people rest on
    # Place of the first message that was not accepted, and the reason; empty if there is none
    first_rejection: str
    # Number of inputs that the recorded run processed but that the bag lacks; the outputs after the first of these
    # may differ from those of the recorded run
    unrecorded_inputs: int = 0
    tracebacks: tuple[str, ...] = ()  # tracebacks of internal errors, without repetitions
    config: Config = field(default_factory=Config)  # parameters at the end
    appearances: tuple[Appearance, ...] = ()  # who was seen, from when to when; tentative people are left out
    swapped_frames: int = 0  # number of detections whose left and right were swapped back
    # What is to be said of accepted messages, in order of occurrence; of lines that differ in their numbers alone
    # the first
    notes: tuple[str, ...] = ()


def replay(
    bag: Bag,
    out: Path,
    options: ReplayOptions | None = None,
    progress: ProgressWrapper = lambda messages, _: messages,
) -> ReplayResult:
    """Run a bag's inputs through a new pipeline and record the inputs and the outputs in another bag.

    Inputs keep their log times. An output has the log time of the input that caused it. If the bag holds the
    journal of a recorded run, the replay repeats its resets and parameter changes after the same inputs, but for
    the parameters that the options give, and it does not process the inputs that the run skipped. The same bag and
    parameters always give the same outputs. The new bag is called `<out>.partial` until it is complete.
    """
    partial = choose_partial_path(out)
    if partial.exists():
        raise RecordingError(
            f'{partial}: an interrupted replay left this bag; --resume replays it again, or remove it'
        )
    result = _Replay(bag, options or ReplayOptions()).run(partial, out.name, progress)
    try:
        partial.rename(out)
    except OSError as error:
        raise RecordingError(f'{out}: {error.strerror}') from None
    return result


class _Replay:
    def __init__(self, bag: Bag, options: ReplayOptions) -> None:
        self._bag = bag
        self._changes = options.changes
        found = find_inputs(bag, options.topic, options.camera_info)
        self._inputs = dict(found.people)
        if found.camera_info is not None:
            self._inputs[found.camera_info] = Source.CAMERA_INFO
        self._run = read_run(bag)
        self._notes: dict[str, str] = {}  # by kind
        self._repeats_parameters = options.config is None
        config = with_values(options.config or Config(), options.changes)
        self._recorder_config = config.recorder  # never that of the recorded run, whose disk was another
        if self._repeats_parameters:
            config = self._apply_recorded(config, self._run.parameters)
        config = with_values(config, {INPUT_TYPE_PARAMETER: found.keypoints_type})
        repeated = self._run.parameters if self._repeats_parameters else {}
        if WAIT_PARAMETER not in repeated if repeated else found.camera_info is None:
            config = with_values(config, {WAIT_PARAMETER: 0.0})
        self._inputs |= find_robot_topics(bag, config.node, self._run.input_topics)
        # that of the outputs in the bag, whatever the parameters of the replay say
        self._frame_prefix = str(self._run.parameters.get(PREFIX_PARAMETER, config.node.frame_prefix))
        self._pipeline = Pipeline(config)
        self._journal = Journal(JOURNAL_TOPIC)
        self._appearances = AppearanceLog(config.tracker.forget_all_after, config.tracker.forget_after)
        self._first_rejection = ''
        self._tracebacks: dict[str, str] = {}  # by what identifies the error, in order of occurrence

    def run(self, folder: Path, name: str, progress: ProgressWrapper) -> ReplayResult:
        bag, pipeline = self._bag, self._pipeline
        attachments = provenance_attachments(pipeline.config, pipeline.models)
        with Recorder(folder, self._recorder_config, attachments, name) as self._recorder:
            messages = progress(bag.messages(self._inputs), bag.count(self._inputs))
            inputs = filter(self._is_input, self._run.leave_out_repeated(messages))
            for number, message in enumerate(inputs, 1):
                if number == 1:
                    self._write_start(message.time_ns)
                self._repeat_events(number - 1, message.time_ns)
                source, is_skipped = self._inputs[message.topic], number in self._run.skipped_inputs
                result = (
                    pipeline.note_backlog() if is_skipped else pipeline.feed(source, message.raw, message.topic)
                )
                self._write_input(message, result)
                self._report(number, message, result)
                if is_skipped or source not in PEOPLE_SOURCES:  # as live
                    continue
                if error_traceback := pipeline.run_deferred_work():
                    self._tracebacks.setdefault(error_traceback, error_traceback)
        return ReplayResult(
            pipeline.counters,
            pipeline.summary.summarise(),
            self._first_rejection,
            self._run.lost_count,
            tuple(self._tracebacks.values()),
            pipeline.config,
            self._appearances.list_all(),
            pipeline.swapped_frames,
            tuple(self._notes.values()),
        )

    def _is_input(self, message: BagMessage) -> bool:
        """Return whether a message on the topic of an input is one, and no output of the recorded run on /tf."""
        is_tf = self._inputs[message.topic] is Source.TRANSFORMS
        return not (is_tf and is_of_people_only(message.raw, self._frame_prefix))

    def _write_start(self, now_ns: int) -> None:
        for topic, msgtype in LATCHED_OUTPUTS.items():
            self._recorder.declare_topic('/' + topic, msgtype, latched=True)
        self._recorder.write(*self._journal.make_parameters_record(values(self._pipeline.config), now_ns))
        self._write(build_skeleton_definition(self._pipeline.config.tracker.skeleton), now_ns)

    def _repeat_events(self, number: int, now_ns: int) -> None:
        for entry in self._run.events.get(number, ()):
            if entry.kind == RESET:
                with name_errors(f'{self._bag.path}: reset after input {number}'):
                    memory = RunMemory.decode(entry.parameters)
                self._recorder.write(*self._journal.make_reset_record(now_ns, memory.encode()))
                for output in self._pipeline.reset(memory):
                    self._write(output, now_ns)
            elif self._repeats_parameters:
                if entry.kind != PARAMETERS:
                    raise InputError(
                        f'{self._bag.path}: the run was recorded by another version (event {entry.kind!r}); '
                        'give all parameters by --config'
                    )
                self._pipeline.reconfigure(self._apply_recorded(self._pipeline.config, entry.parameters))
                self._recorder.write(*self._journal.make_parameters_record(values(self._pipeline.config), now_ns))

    def _apply_recorded(self, config: Config, recorded: Mapping[str, Value]) -> Config:
        """Return the parameters of a recorded run that this version has, but for those that the options give.

        Model and prior of the run must be shipped ones, so that a bag cannot make the replay read a file of its
        choice; the user, who gives the options, may choose any.
        """
        known, constants, path = values(config), settings(config), self._bag.path
        changed = [
            f'{name} = {value}'
            for name, value in sorted(recorded.items())
            if name not in known and constants.get(name, False) != value
        ]
        if changed:
            line = f'{path}: recorded by another version; without effect in this one: {", ".join(changed)}'
            self._notes.setdefault('constants', line)
        kept = {name: v for name, v in recorded.items() if name in known and name not in self._changes}
        shipped = {'tracker.model': (AUTO, *list_shipped_base_poses()), 'solver.prior': PRIORS}
        for name in shipped.keys() & kept.keys():
            if kept[name] not in shipped[name]:
                raise InputError(
                    f'{path}: the run was recorded with {name} {kept[name]!r}, which does not come with the '
                    f'package; give another by --set {name}=VALUE, or all parameters by --config'
                )
        try:
            return with_values(config, kept)
        except ConfigError as error:
            raise InputError(
                f'{path}: the run was recorded by another version ({error}); give all parameters by --config'
            ) from None

    def _write_input(self, message: BagMessage, result: ProcessingResult) -> None:
        topic, source, now_ns = message.topic, self._inputs[message.topic], message.time_ns
        if topic not in self._recorder.topics:  # with its QoS, so that it is played to the same subscribers
            qos: Any = dump_qos_v9(self._bag.qos[topic])
            is_static = source is Source.STATIC_TRANSFORMS
            self._recorder.add_topic(make_topic(topic, message.type, latched=is_static, qos=qos))
        keys = make_repeat_keys(source, message.raw, is_accepted=result.acceptance is Acceptance.ACCEPTED)
        stored = topic, message.type, message.raw, (now_ns, now_ns)
        for record in self._journal.make_input_records(*stored, result.acceptance, result.reason, keys):
            self._recorder.write(*record)
        for output in result.outputs:
            self._write(output, now_ns)

    def _write(self, output: OutputMessage, now_ns: int) -> None:
        self._recorder.write('/' + output.topic.lstrip('/'), output.type, output.data, now_ns, now_ns)

    def _report(self, number: int, message: BagMessage, result: ProcessingResult) -> None:
        if result.outputs:
            self._appearances.add(result.outputs[-1].stamp_ns, self._pipeline.people)
        line = f'{self._bag.path}: {message.topic}: input {number} of the bag: {result.reason}'
        if result.acceptance is not Acceptance.ACCEPTED:
            self._first_rejection = self._first_rejection or line
        elif result.reason:
            self._notes.setdefault(find_kind(result.reason), line)
        if result.error_traceback:
            self._tracebacks.setdefault(result.reason, result.error_traceback)
