"""The live pipeline over a bag: the inputs that the tracker saw, in their order, give the same outputs again."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mocap_ros.bags.journal import RESET, Journal, Verdict, read_run
from mocap_ros.bags.reader import ENDINGS, Bag, BagMessage
from mocap_ros.bags.recorder import Recorder, partial_of
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.bags.topics import Source, people_topics, people_type
from mocap_ros.config import Config, RecorderConfig, Value, current_names, values, with_values
from mocap_ros.errors import ConfigError, InputError, RecordingError
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.models.model_file import AUTO, PRIORS, shipped_base_poses
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, Counters, Outcome, Pipeline, skeleton_definition
from mocap_ros.runtime.provenance import attachments

JOURNAL_TOPIC = '/mocap_replay/journal'
INPUT_TYPE = 'node.input_type'

Watch = Callable[[Iterable[BagMessage], int], Iterable[BagMessage]]


@dataclass(frozen=True)
class ReplayOptions:
    """How to replay.

    Attributes:
        config: parameters; None for those of the recorded run.
        topic: of the keypoints, where the bag has several; of ROS4HRI bodies, the one that says who is tracked.
        camera_info: topic of the CameraInfo, where the bag has several.
    """

    config: Config | None = None
    topic: str | None = None
    camera_info: str | None = None


@dataclass(frozen=True)
class ReplayResult:
    """What a replay did.

    Attributes:
        counters: what became of the keypoint messages.
        first_reason: why the first message that was not accepted was not; empty where all were.
        lost: inputs that the recorded run saw, but which were not recorded; results may differ behind them.
        faults: tracebacks of errors of ours, each once.
    """

    counters: Counters
    first_reason: str
    lost: int = 0
    faults: tuple[str, ...] = ()


def replay(
    bag: Bag,
    out: Path,
    options: ReplayOptions | None = None,
    watch: Watch = lambda messages, _: messages,
) -> ReplayResult:
    """Run a bag's inputs through a new pipeline and record them and the outputs in another bag.

    Inputs keep their log times, and outputs have those of the inputs that caused them. Where the bag records
    a run of ours, its resets and changes of parameters are made again at the same places, and inputs that
    never reached the tracker are left out. The same bag and parameters give the same outputs. The new bag
    is called `<out>.partial` until it is complete.

    Args:
        bag: of ROS 2 or ROS 1.
        out: folder of the new bag.
        options: parameters and topics.
        watch: wrapped around the messages, of which there are as many as its second argument says.

    Raises:
        InputError: the bag cannot be used.
        RecordingError: the new bag exists or cannot be written.
    """
    partial = partial_of(out)
    if partial.exists():
        raise RecordingError(f'{partial}: left by an interrupted replay; --resume does it again, or remove it')
    result = _Replay(bag, options or ReplayOptions()).run(partial, out.name, watch)
    try:
        partial.rename(out)
    except OSError as error:
        raise RecordingError(f'{out}: {error.strerror}') from None
    return result


def remove_partial(out: Path) -> None:
    """Remove what an interrupted replay to `out` has left.

    Raises:
        RecordingError: it is no bag, or cannot be removed.
    """
    partial = partial_of(out)
    if not partial.exists():
        return
    strange = [f.name for f in partial.iterdir() if f.suffix not in ENDINGS and not f.name.startswith(METADATA)]
    if strange:
        raise RecordingError(f'{partial}: not what a replay leaves: {strange[0]}')
    try:
        shutil.rmtree(partial)
    except OSError as error:
        raise RecordingError(f'{partial}: {error.strerror}') from None


class _Replay:
    """One replay."""

    def __init__(self, bag: Bag, options: ReplayOptions) -> None:
        self._bag = bag
        self._inputs = people_topics(bag, options.topic)
        kind = people_type(bag, self._inputs)
        first, *_ = self._inputs
        camera_info = bag.camera_info_topic(first, options.camera_info)
        if camera_info is not None:
            self._inputs[camera_info] = Source.CAMERA_INFO
        self._recorded_run = read_run(bag)
        self._follow = options.config is None
        config = options.config
        if config is None:
            config = _parameters(Config(), self._recorded_run.parameters, bag)
        config = with_values(config, {INPUT_TYPE: kind})
        self._recorder_config = RecorderConfig() if self._follow else config.recorder
        self._pipeline = Pipeline(config)
        self._journal = Journal(JOURNAL_TOPIC)
        self._first_reason = ''
        self._faults: dict[str, str] = {}

    def run(self, folder: Path, name: str, watch: Watch) -> ReplayResult:
        bag, pipeline = self._bag, self._pipeline
        made_with = attachments(pipeline.config, pipeline.models)
        with Recorder(folder, self._recorder_config, made_with, name) as self._recorder:
            for number, message in enumerate(watch(bag.messages(self._inputs), bag.count(self._inputs)), 1):
                if number == 1:
                    self._begin(message.time_ns)
                self._repeat_events(number - 1, message.time_ns)
                if number in self._recorded_run.unseen:
                    outcome = pipeline.note_backlog()
                else:
                    outcome = pipeline.feed(self._inputs[message.topic], message.raw, message.topic)
                self._finish(number, message, outcome)
                if fault := pipeline.idle():
                    self._faults.setdefault(fault, fault)
        lost = self._recorded_run.lost
        return ReplayResult(pipeline.counters, self._first_reason, lost, tuple(self._faults.values()))

    def _begin(self, now: int) -> None:
        for topic, msgtype in LATCHED_OUTPUTS.items():
            self._recorder.announce('/' + topic, msgtype, latched=True)
        self._recorder.write(*self._journal.parameters(values(self._pipeline.config), now))
        self._write(skeleton_definition(), now)

    def _repeat_events(self, number: int, now: int) -> None:
        """Do what was done in the recorded run behind this input."""
        for entry in self._recorded_run.events.get(number, ()):
            if entry.kind == RESET:
                self._recorder.write(*self._journal.reset(now))
                self._write(self._pipeline.reset(), now)
            elif self._follow:
                self._pipeline.reconfigure(_parameters(self._pipeline.config, entry.parameters, self._bag))
                self._recorder.write(*self._journal.parameters(values(self._pipeline.config), now))

    def _finish(self, number: int, message: BagMessage, outcome: Outcome) -> None:
        now, verdict, reason = message.time_ns, outcome.verdict, outcome.reason
        for record in self._journal.input(message.topic, message.type, message.raw, (now, now), verdict, reason):
            self._recorder.write(*record)
        for output in outcome.outputs:
            self._write(output, now)
        if outcome.verdict is not Verdict.ACCEPTED and not self._first_reason:
            self._first_reason = f'{self._bag.path}: {message.topic}: message {number}: {reason}'
        if outcome.fault:
            self._faults.setdefault(reason, outcome.fault)

    def _write(self, output: OutputMessage, now: int) -> None:
        self._recorder.write('/' + output.topic.lstrip('/'), output.type, output.data, now, now)


def _parameters(config: Config, recorded: Mapping[str, Value], bag: Bag) -> Config:
    """The parameters of a recorded run. A bag may name no file: its model and its prior must be ours."""
    ours = {
        'tracker.model': (config.tracker.model, (AUTO, *shipped_base_poses())),
        'solver.prior': (config.solver.prior, PRIORS),
    }
    for name, (default, known) in ours.items():
        value = recorded.get(name, default)
        if value not in known:
            raise InputError(
                f'{bag.path}: recorded with {name} {value!r}, which does not come with the package; '
                'give the parameters by --config or --set'
            )
    try:
        return with_values(config, current_names(recorded))
    except ConfigError as error:
        raise InputError(
            f'{bag.path}: recorded by another version ({error}); give the parameters by --config or --set'
        ) from None
