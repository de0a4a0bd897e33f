# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recording and replay: CPU time, speed and memory; `faults.py` measures what a kill loses.

All bags are real files in a temporary folder. The recorder is compared with the bare writer of the `mcap` package,
and replay with the bare pipeline, in the same run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import common
import numpy as np
from mcap.writer import CompressionType, Writer
from report import Report, run

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.journal import Journal, Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header as MessageHeader
from mocap_ros.messages.cdr import create_header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.markers import MARKERS
from mocap_ros.people import Person3D, PredictedPerson
from mocap_ros.ros.live import LiveRun
from mocap_ros.runtime import replay as replaying
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import replay
from mocap_ros.runtime.sequence_messages import EncodedFrame, encode_sequence
from mocap_ros.tracking.tracker import Tracker

HZ = 30  # Hz, rate of the keypoints
FRAME_PERIOD_NS = 33_333_333  # ns, 1 / HZ
START_NS = 1_700_000_000_000_000_000  # ns, log time of the first message, in the year 2023
# Targets of the measured values, as printed.
TARGETS = {
    'recorder_messages_s': '20000 or more',
    'recorder_cpu_percent': 'under 5',
    'replay_x_realtime': '15 or more',
    'replay_peak_mb': 'under 300',
}
# Full name of each topic of the node.
TOPIC_NAMES = {t: f'/{t}' for t in (*(s.value for s in Source), *OUTPUTS, *LATCHED_OUTPUTS)} | {
    'journal': '/node/journal'
}


class SilentLogger:
    """A logger that discards all messages."""

    def info(self, message: str) -> None: ...

    warning = error = info


class ConstantTracker:
    """A tracker that takes no time: it always returns the first person that the real tracker found."""

    backward_jump_s = 0.0
    output_stamp_ns = 0
    swapped_frames = 0
    unusable_people = 0
    vertical = None
    person: Person3D | None = None

    def __init__(self, *_: object) -> None:
        pass

    def update(self, stamp_ns: int, *_: object) -> tuple[Person3D, ...]:
        self.output_stamp_ns = stamp_ns
        return () if self.person is None else (self.person,)

    def predict(self, times_s: Sequence[float]) -> list[list[PredictedPerson]]:
        return [[] for _ in times_s]

    def run_deferred_work(self) -> None: ...

    def reset(self) -> None: ...


def load_frames() -> list[EncodedFrame]:
    """Return the messages of the demo recording, one person at 30 Hz."""
    return list(encode_sequence(make_recording().sequence()))


def record_until_killed(folder: Path, frames: Sequence[EncodedFrame]) -> None:
    """Record a live run at 30 Hz until the process is killed."""
    config = with_values(Config(), {'recorder.enabled': True, 'recorder.folder': str(folder)})
    types = {Source.KEYPOINTS: KEYPOINTS, Source.CAMERA_INFO: CAMERA_INFO}
    run = LiveRun(Pipeline(config), types, TOPIC_NAMES, lambda _: None, SilentLogger())
    run.start()
    due = time.monotonic()
    for frame in cycle(frames):
        run.enqueue(Source.KEYPOINTS, frame.raw, 0)
        due += 1 / HZ
        time.sleep(max(due - time.monotonic(), 0))


def make_payloads() -> list[bytes]:
    """Return messages of 1 kB; half of each is noise, which compresses as badly as floats."""
    rng = np.random.default_rng(0)
    return [rng.bytes(512) + bytes(512) for _ in range(100)]


def measure_recorder(root: Path, data: Sequence[bytes], count: int) -> float:
    """Return the messages per second that a recorder writes."""
    with Recorder(root, RecorderConfig()) as recorder:
        start = time.perf_counter()
        for n in range(count):
            recorder.write('/x', MARKERS, data[n % len(data)], START_NS + n * 50_000, START_NS)
        recorder.flush()
        return count / (time.perf_counter() - start)


def measure_mcap_writer(path: Path, data: Sequence[bytes], count: int) -> float:
    """Return the messages per second that the writer of the `mcap` package writes."""
    with path.open('wb') as file:
        writer = Writer(file, chunk_size=RecorderConfig().chunk_bytes, compression=CompressionType.ZSTD)
        writer.start('ros2', 'bare')
        channel = writer.register_channel('/x', 'cdr', writer.register_schema('x', 'ros2msg', b''))
        start = time.perf_counter()
        for n in range(count):
            writer.add_message(channel, START_NS + n * 50_000, data[n % len(data)], START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
        return count / (time.perf_counter() - start)


def measure_recorder_cpu(root: Path, frames: Sequence[EncodedFrame], seconds: float) -> float:
    """Return the share of a core, in %, for recording one person at 30 Hz with the journal, without the solver."""
    pipeline, journal = Pipeline(Config()), Journal(TOPIC_NAMES['journal'])
    batches: list[list[RecordedMessage]] = []
    for n, frame in enumerate(islice(frames, round(seconds * HZ))):
        outcome, now = pipeline.feed(Source.KEYPOINTS, frame.raw), START_NS + n * FRAME_PERIOD_NS
        batches.append([RecordedMessage(TOPIC_NAMES[o.topic], o.type, o.data, now, now) for o in outcome.outputs])
    background = BackgroundRecorder(root, RecorderConfig())
    start, used = time.monotonic(), time.process_time()
    for n, (frame, outputs) in enumerate(zip(frames, batches, strict=False)):
        now = START_NS + n * FRAME_PERIOD_NS
        inputs = journal.make_input_records('/keypoints', KEYPOINTS, frame.raw, (now, now), Verdict.ACCEPTED)
        background.put([*inputs, *outputs])
        time.sleep(max(start + (n + 1) / HZ - time.monotonic(), 0))
    used, taken = time.process_time() - used, time.monotonic() - start
    background.close()
    return 100 * used / taken


def write_keypoints(folder: Path, frames: Sequence[EncodedFrame], count: int, first: int = 0) -> None:
    """Write a bag of `count` frames at 30 Hz: the recording in a loop from a frame on, with increasing stamps."""
    with Recorder(folder, RecorderConfig()) as recorder:
        for n, frame in enumerate(islice(cycle(frames), first, first + count)):
            message = decode(frame.raw, KEYPOINTS)
            message.header = create_header(MessageHeader(n * FRAME_PERIOD_NS, 'camera'))
            raw = encode(message, KEYPOINTS)
            recorder.write('/keypoints', KEYPOINTS, raw, START_NS + n * FRAME_PERIOD_NS, START_NS)


def replay_bag(path: Path, out: Path) -> float:
    """Replay a bag, and return the duration in s."""
    start = time.perf_counter()
    with Bag(path) as bag:
        replay(bag, out)
    return time.perf_counter() - start


def measure_pipeline(frames: Sequence[EncodedFrame]) -> float:
    """Feed all frames to a pipeline, and return the duration in s."""
    pipeline = Pipeline(Config())
    start = time.perf_counter()
    for frame in frames:
        pipeline.feed(Source.KEYPOINTS, frame.raw)
    return time.perf_counter() - start


def replay_with_constant_tracker(path: Path, out: Path, person: Person3D) -> float:
    """Replay a bag with the tracker that takes no time, and return the duration in s."""
    ConstantTracker.person = person
    replaying.Pipeline = partial(Pipeline, make_tracker=ConstantTracker)  # type: ignore[attr-defined, assignment]
    return replay_bag(path, out)


def track_first_person(frames: Sequence[EncodedFrame]) -> Person3D:
    found: list[Person3D] = []

    class ObservedTracker(Tracker):
        def update(self, *arguments: Any) -> tuple[Person3D, ...]:
            people = super().update(*arguments)
            found.extend(people)
            return people

    pipeline = Pipeline(Config(), make_tracker=ObservedTracker)
    for frame in frames:
        pipeline.feed(Source.KEYPOINTS, frame.raw)
        if found:
            return found[0]
    raise AssertionError('nobody was found')


def measure_replay(root: Path) -> tuple[float, float]:
    """Replay the demo recording in a process of its own; return the duration in s and the peak memory in MB."""
    frames = load_frames()
    if not (root / 'demo').is_dir():
        write_keypoints(root / 'demo', frames, len(frames))
    taken, peak = common.run_in_process(replay_bag, root / 'demo', Path(tempfile.mkdtemp(dir=root)) / 'out')
    return taken, peak


def measure_replays(root: Path, minutes: int) -> dict[str, float]:
    frames = load_frames()
    seconds = len(frames) / HZ
    taken, peak = measure_replay(root)
    alone, _ = common.run_in_process(measure_pipeline, frames)
    count = minutes * 60 * HZ
    write_keypoints(root / 'long', frames, count)
    standing, standing_peak = common.run_in_process(
        replay_with_constant_tracker, root / 'long', root / 'long_out', track_first_person(frames)
    )
    return {
        'replay_x_realtime': seconds / taken,
        'pipeline_x_realtime': seconds / alone,
        'replay_over_pipeline': taken / alone,
        'replay_x_realtime_without_solver': count / HZ / standing,
        'replay_minutes': minutes,
        'replay_peak_mb': max(peak, standing_peak),
    }


def measure_recorders(root: Path, count: int, seconds: float) -> dict[str, float]:
    data = make_payloads()
    ours = measure_recorder(root / 'ours', data, count)
    bare = measure_mcap_writer(root / 'bare.mcap', data, count)
    return {
        'recorder_messages_s': ours,
        'mcap_writer_messages_s': bare,
        'recorder_over_mcap_writer': ours / bare,
        'recorder_cpu_percent': measure_recorder_cpu(root / 'cpu', load_frames(), seconds),
    }


def measure(args: argparse.Namespace, report: Report) -> None:
    quick = args.quick
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        results = {
            **measure_recorders(root, 40_000 if quick else 200_000, 4 if quick else 12),
            **measure_replays(root, 2 if quick else 60),
        }
    report.quantities(results, TARGETS, page='recording.targets')


if __name__ == '__main__':
    run(__doc__, 'Recording and replay', measure)
