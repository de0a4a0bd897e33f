"""The live pipeline over a bag: the inputs that the tracker saw, in their order, give the same outputs again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mocap_ros.base_poses import shipped_models
from mocap_ros.config import Config, Value, values, with_values
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.io.bags import Bag, BagMessage, read_run
from mocap_ros.io.journal import RESET, Journal, Verdict
from mocap_ros.io.messages import CAMERA_INFO, OutputMessage
from mocap_ros.io.recorder import Recorder
from mocap_ros.pipeline import (
    LATCHED_OUTPUTS,
    Counters,
    Pipeline,
    Source,
    skeleton_definition,
)

JOURNAL_TOPIC = '/mocap_replay/journal'

Watch = Callable[[Iterable[BagMessage], int], Iterable[BagMessage]]


@dataclass(frozen=True)
class ReplayResult:
    """What a replay did.

    Attributes:
        counters: what became of the keypoint messages.
        first_reason: why the first message that was not accepted was not; empty where all were.
    """

    counters: Counters
    first_reason: str


def replay(
    bag: Bag,
    out: Path,
    config: Config | None = None,
    topic: str | None = None,
    watch: Watch = lambda messages, _: messages,
) -> ReplayResult:
    """Run a bag's inputs through a new pipeline and record them and the outputs in another bag.

    Inputs keep their log times, and outputs have those of the inputs that caused them. Where the bag records
    a run of ours, its resets and changes of parameters are made again at the same places, and inputs that
    never reached the tracker are left out.

    Args:
        bag: rosbag2.
        out: folder of the new bag.
        config: parameters; by default those of the recorded run.
        topic: of the keypoints, where the bag has several.
        watch: wrapped around the messages, of which there are as many as its second argument says.

    Raises:
        InputError: the bag cannot be used.
        RecordingError: the new bag cannot be written.
    """
    inputs = {bag.keypoints_topic(topic): Source.KEYPOINTS}
    cameras = bag.of_type([CAMERA_INFO])
    if len(cameras) > 1:
        raise InputError(f'{bag.path}: several CameraInfo topics: {", ".join(cameras)}')
    inputs.update(dict.fromkeys(cameras, Source.CAMERA_INFO))

    run = read_run(bag)
    kept = config is not None
    config = _parameters(Config(), run.parameters, bag) if config is None else config
    pipeline = Pipeline(config)
    first_reason = ''
    with Recorder(out, config.recorder) as recorder:
        journal = Journal(recorder, JOURNAL_TOPIC)
        for number, message in enumerate(watch(bag.messages(inputs), bag.count(inputs)), 1):
            now = message.time_ns
            if number == 1:
                _begin(recorder, journal, config, now)
            for entry in run.events.get(number - 1, ()):
                if entry.kind == RESET:
                    journal.reset(now)
                    _write(recorder, pipeline.reset(), now)
                elif not kept:
                    pipeline.reconfigure(_parameters(pipeline.config, entry.parameters, bag))
                    journal.parameters(values(pipeline.config), now)
            if number in run.unseen:
                outcome = pipeline.note_overtaken()
            else:
                outcome = pipeline.feed(inputs[message.topic], message.raw)
            journal.input(message.topic, message.type, message.raw, (now, now), outcome.verdict, outcome.reason)
            for output in outcome.outputs:
                _write(recorder, output, now)
            if outcome.verdict is not Verdict.ACCEPTED and not first_reason:
                first_reason = f'{bag.path}: {message.topic}: message {number}: {outcome.reason}'
    return ReplayResult(pipeline.counters, first_reason)


def _begin(recorder: Recorder, journal: Journal, config: Config, now: int) -> None:
    journal.parameters(values(config), now)
    for topic, msgtype in LATCHED_OUTPUTS.items():
        recorder.announce('/' + topic, msgtype, latched=True)
    _write(recorder, skeleton_definition(), now)


def _write(recorder: Recorder, output: OutputMessage, now: int) -> None:
    recorder.write('/' + output.topic, output.type, output.data, now, now)


def _parameters(config: Config, recorded: Mapping[str, Value], bag: Bag) -> Config:
    """The parameters of a recorded run. A bag may name no file: its model must be one of ours."""
    model = recorded.get('tracker.model', config.tracker.model)
    if model not in shipped_models():
        raise InputError(
            f'{bag.path}: recorded with the model {model!r}, which does not come with the package; '
            'give the parameters by --config or --set'
        )
    try:
        return with_values(config, recorded)
    except ConfigError as error:
        raise InputError(f'{bag.path}: recorded parameters: {error}') from None
