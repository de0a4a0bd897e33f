"""What recording and replay lose, cost and need: kill -9 at random, speed of the recorder, replay, memory.

Everything goes through real files in a temporary folder. Speed is given beside that of the bare writer of the
`mcap` package, and of the bare pipeline, in the same run.
"""

from __future__ import annotations

import common

# isort: split
import os
import resource
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle, islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.journal import Journal, Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Record, Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import MocapError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header as MessageHeader
from mocap_ros.messages.cdr import decode, encode, new_header
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.markers import MARKERS
from mocap_ros.people import Person3D
from mocap_ros.ros.live import LiveRun
from mocap_ros.runtime import replay as replaying
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, OUTPUTS, Pipeline, Source
from mocap_ros.runtime.replay import replay
from mocap_ros.runtime.sequence_messages import Sample, sequence_samples
from mocap_ros.tracking.tracker import Tracker

HZ = 30
STEP_NS = 33_333_333
START_NS = 1_700_000_000_000_000_000
TARGETS = {
    'kill9_worst_loss_s': '0.5 or less',
    'kill9_unreadable': '0',
    'recorder_messages_s': '20000 or more',
    'recorder_cpu_percent': 'under 5',
    'replay_x_realtime': '15 or more',
    'replay_peak_mb': 'under 300',
}
NAMES = {t: f'/{t}' for t in (*(s.value for s in Source), *OUTPUTS, *LATCHED_OUTPUTS)} | {
    'journal': '/node/journal'
}


class Quiet:
    """A logger that keeps nothing."""

    def info(self, message: str) -> None: ...

    warning = error = info


class Standing:
    """A tracker that takes no time: it gives what the real one gave at first, again and again."""

    went_back = 0.0
    output_ns = 0
    person: Person3D | None = None

    def __init__(self, *_: object) -> None:
        pass

    def update(self, stamp_ns: int, *_: object) -> tuple[Person3D, ...]:
        self.output_ns = stamp_ns
        return () if self.person is None else (self.person,)

    def examine(self) -> None: ...

    def reset(self) -> None: ...


def samples() -> list[Sample]:
    """The demo recording, one person at 30 Hz."""
    return list(sequence_samples(make_recording().sequence()))


def elsewhere(action: Callable[..., object], *arguments: object) -> Any:
    """The result of an action in a process of its own, and its peak memory in MB."""
    context = get_context('fork')
    receiving, sending = context.Pipe(duplex=False)

    def work() -> None:
        result = action(*arguments)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        sending.send((result, peak))

    process = context.Process(target=work)
    process.start()
    result = receiving.recv()
    process.join()
    return result


def live_recording(folder: Path, frames: Sequence[Sample]) -> None:
    """Record a live run at 30 Hz until killed."""
    config = with_values(Config(), {'recorder.enabled': True, 'recorder.folder': str(folder)})
    types = {Source.KEYPOINTS: KEYPOINTS, Source.CAMERA_INFO: CAMERA_INFO}
    run = LiveRun(Pipeline(config), types, NAMES, lambda _: None, Quiet())
    run.start()
    due = time.monotonic()
    for frame in cycle(frames):
        run.put(Source.KEYPOINTS, frame.raw, 0)
        due += 1 / HZ
        time.sleep(max(due - time.monotonic(), 0))


def kill(folder: Path, frames: Sequence[Sample], after: float) -> float | None:
    """Kill a recording so many s after its first frame; s lost, None where nothing can be read."""
    process = get_context('fork').Process(target=live_recording, args=(folder, frames))
    process.start()
    while not list(folder.glob('*/*.mcap')):
        time.sleep(0.01)
    time.sleep(after)
    os.kill(process.pid or 0, signal.SIGKILL)
    killed_ns = time.time_ns()
    process.join()
    (bag,) = folder.iterdir()
    try:
        recover(bag, folder / 'whole')
        with Bag(folder / 'whole') as whole:
            newest = max(m.time_ns for m in whole.messages(whole.topics))
    except (MocapError, ValueError):
        return None
    return (killed_ns - newest) / 1e9


def kills(root: Path, count: int) -> dict[str, float]:
    rng = np.random.default_rng(0)
    frames = samples()
    losses = [
        kill(root / f'kill{n}', frames, after)
        for n, after in enumerate(common.progress(rng.uniform(0.4, 1.4, count), 'kill -9', count))
    ]
    read = [loss for loss in losses if loss is not None]
    return {
        'kill9_times': count,
        'kill9_worst_loss_s': max(read),
        'kill9_mean_loss_s': float(np.mean(read)),
        'kill9_unreadable': losses.count(None),
    }


def payloads() -> list[bytes]:
    """Messages of 1 kB, half of them noise, as floats are."""
    rng = np.random.default_rng(0)
    return [rng.bytes(512) + bytes(512) for _ in range(100)]


def write_all(root: Path, data: Sequence[bytes], count: int) -> float:
    """Messages a second through a recorder."""
    with Recorder(root, RecorderConfig()) as recorder:
        begun = time.perf_counter()
        for n in range(count):
            recorder.write('/x', MARKERS, data[n % len(data)], START_NS + n * 50_000, START_NS)
        recorder.flush()
        return count / (time.perf_counter() - begun)


def write_all_barely(path: Path, data: Sequence[bytes], count: int) -> float:
    """The same with nothing but the `mcap` package."""
    with path.open('wb') as file:
        writer = Writer(file, chunk_size=RecorderConfig().chunk_bytes, compression=CompressionType.ZSTD)
        writer.start('ros2', 'bare')
        channel = writer.register_channel('/x', 'cdr', writer.register_schema('x', 'ros2msg', b''))
        begun = time.perf_counter()
        for n in range(count):
            writer.add_message(channel, START_NS + n * 50_000, data[n % len(data)], START_NS)
        writer.finish()
        return count / (time.perf_counter() - begun)


def recorder_cpu(root: Path, frames: Sequence[Sample], seconds: float) -> float:
    """Percent of a core that recording one person at 30 Hz takes, journal included, solver not."""
    pipeline, journal = Pipeline(Config()), Journal(NAMES['journal'])
    batches: list[list[Record]] = []
    for n, frame in enumerate(islice(frames, round(seconds * HZ))):
        outcome, now = pipeline.feed(Source.KEYPOINTS, frame.raw), START_NS + n * STEP_NS
        batches.append([Record(NAMES[o.topic], o.type, o.data, now, now) for o in outcome.outputs])
    background = BackgroundRecorder(root, RecorderConfig())
    begun, used = time.monotonic(), time.process_time()
    for n, (frame, outputs) in enumerate(zip(frames, batches, strict=False)):
        now = START_NS + n * STEP_NS
        inputs = journal.input('/keypoints', KEYPOINTS, frame.raw, (now, now), Verdict.ACCEPTED)
        background.put([*inputs, *outputs])
        time.sleep(max(begun + (n + 1) / HZ - time.monotonic(), 0))
    used, taken = time.process_time() - used, time.monotonic() - begun
    background.close()
    return 100 * used / taken


def write_keypoints(folder: Path, frames: Sequence[Sample], count: int) -> None:
    """A bag of so many frames at 30 Hz, the recording again and again with stamps that go on."""
    with Recorder(folder, RecorderConfig()) as recorder:
        for n, frame in enumerate(islice(cycle(frames), count)):
            raw = frame.raw
            if n >= len(frames):
                message = decode(raw, KEYPOINTS)
                message.header = new_header(MessageHeader(n * STEP_NS, 'camera'))
                raw = encode(message, KEYPOINTS)
            recorder.write('/keypoints', KEYPOINTS, raw, START_NS + n * STEP_NS, START_NS)


def replay_bag(path: Path, out: Path) -> float:
    """Replay; s."""
    begun = time.perf_counter()
    with Bag(path) as bag:
        replay(bag, out)
    return time.perf_counter() - begun


def feed_all(frames: Sequence[Sample]) -> float:
    """The pipeline alone; s."""
    pipeline = Pipeline(Config())
    begun = time.perf_counter()
    for frame in frames:
        pipeline.feed(Source.KEYPOINTS, frame.raw)
    return time.perf_counter() - begun


def replay_standing(path: Path, out: Path, person: Person3D) -> float:
    """Replay with the tracker that takes no time; s."""
    Standing.person = person
    replaying.Pipeline = partial(Pipeline, make_tracker=Standing)  # type: ignore[misc, assignment]
    return replay_bag(path, out)


def first_person(frames: Sequence[Sample]) -> Person3D:
    found: list[Person3D] = []

    class Watching(Tracker):
        def update(self, *arguments: Any) -> tuple[Person3D, ...]:
            people = super().update(*arguments)
            found.extend(people)
            return people

    pipeline = Pipeline(Config(), make_tracker=Watching)
    for frame in frames:
        pipeline.feed(Source.KEYPOINTS, frame.raw)
        if found:
            return found[0]
    raise AssertionError('nobody was found')


def replays(root: Path, minutes: int) -> dict[str, float]:
    frames = samples()
    seconds = len(frames) / HZ
    write_keypoints(root / 'demo', frames, len(frames))
    taken, peak = elsewhere(replay_bag, root / 'demo', root / 'demo_out')
    alone, _ = elsewhere(feed_all, frames)
    count = minutes * 60 * HZ
    write_keypoints(root / 'long', frames, count)
    standing, standing_peak = elsewhere(replay_standing, root / 'long', root / 'long_out', first_person(frames))
    return {
        'replay_x_realtime': seconds / taken,
        'pipeline_x_realtime': seconds / alone,
        'replay_over_pipeline': taken / alone,
        'replay_x_realtime_without_solver': count / HZ / standing,
        'replay_minutes': minutes,
        'replay_peak_mb': max(peak, standing_peak),
    }


def recorders(root: Path, count: int, seconds: float) -> dict[str, float]:
    data = payloads()
    ours = write_all(root / 'ours', data, count)
    bare = write_all_barely(root / 'bare.mcap', data, count)
    return {
        'recorder_messages_s': ours,
        'mcap_writer_messages_s': bare,
        'recorder_over_mcap_writer': ours / bare,
        'recorder_cpu_percent': recorder_cpu(root / 'cpu', samples(), seconds),
    }


def main() -> None:
    args = common.arguments(__doc__ or '')
    print(f'# Recording and replay\n\n{common.machine()}\n')
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        results = {
            **kills(root, 8 if args.quick else 50),
            **recorders(root, 40_000 if args.quick else 200_000, 4 if args.quick else 12),
            **replays(root, 2 if args.quick else 60),
        }
    rows = [
        (key, f'{value:.3g}' if value < 1000 else f'{value:.0f}', TARGETS.get(key))
        for key, value in results.items()
    ]
    print(common.table(['what', 'measured', 'target'], rows))
    common.write_json(args.json, {'machine': common.machine(), **results})


if __name__ == '__main__':
    main()
