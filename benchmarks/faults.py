# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Faults: a recorder that is killed, and disks that are full, read-only, slow or removed, at every step.

A recorder writes three topics at 30 Hz in a process of its own, which is killed with SIGKILL at a random moment:
while it records, while it splits the bag, while it closes it, and once more while `recover` works. Then each of
the recorder's steps on the disk fails in each way, and the clock jumps at each frame. Every bag is recovered; each
message that is found must be the one that was written, and none before the newest may be missing.

Recorders also write to a file system that forgets (`experiments/forgetful_disk.py`, which needs the extra `fuse`):
whenever the power is cut, it holds what was synced, and some sectors of the rest.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import hashlib
import mmap
import os
import signal
import struct
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from experiments.faulty_disk import Disk, FaultyPath
from experiments.forgetful_disk import CUT, ForgetfulDisk, mount
from panels import JUMP, PERIODIC, RUN, WALK, label_axes, make_panels
from recording import TOPIC_NAMES, SilentLogger, load_frames, record_until_killed
from report import Report, run

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.errors import InputError, MocapError, RecordingError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.live import LiveRun
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.runtime.pipeline import Pipeline

HZ = 30  # Hz, rate of the messages on each topic
STEP_NS = 33_333_333  # ns, 1 / HZ
START_NS = 1_700_000_000_000_000_000  # ns, log time of the first message where no clock runs
TOPICS = {'/keypoints': KEYPOINTS, '/skeletons': OUTPUTS['skeletons'], '/markers': OUTPUTS['markers']}
BYTES = {'/keypoints': 400, '/skeletons': 2900, '/markers': 3500}  # of a message, those of one person
NOISE = np.random.default_rng(0).bytes(1 << 14)  # of which messages consist; it compresses as badly as floats
NUMBER = struct.Struct('<Q')  # number of the frame, at the start of each message
STATE = struct.Struct(
    '<qqqq'
)  # phase, frames put, times of the first and last frame in ns; shared with the recorder
RECORDING, CLOSING, CLOSED = 1, 2, 3  # phases of a recorder
SPLIT_SECONDS = 0.2  # s, time of each file while splitting
NEAR_SPLIT_S = -0.01, 0.04  # s, from a split to the kill
WORKERS = 4  # recorders at a time, so that a thousand kills take minutes; they sleep most of the time
MAX_UNREADABLE_AGE_S = 0.3  # s; a recorder that is killed earlier may not have written anything yet
CLOCK_JUMPS_S = {'an hour forward': 3600.0, 'an hour back': -3600.0, 'to 1970': -1.7e9}
FRAMES = 24  # of a recording whose steps fail
FAULTS = ('kill', 'full', 'full once', 'read-only', 'removed', 'slow')
STALL_S = 2.0  # s, for which the disk of a live run takes nothing
CUTS, QUICK_CUTS = 1000, 40  # of the power; ten of each disk at least
CUTS_PER_RECORDER = 10  # the recorder does not notice a cut: what the disk would hold is copied
SYNC_S = 0.0, 0.03, 0.1, 0.25  # s, which the disk takes for a sync, by recorder
SLOW_SYNC_S = 1.0  # s, of a disk that is too slow for the bound of 1 s
SYNC_FRAMES = 150  # that are recorded on each disk
TARGETS = {
    'unreadable': '0',
    'cut_unreadable': '0',
    'cut_worst_loss_s': '1 or less',
    'worst_loss_s': '0.3 or less',
    'median_loss_s': '0.1 or less',
    'stall_noticed_s': '1 or less',
    'wrong_after_fault': '0',
}
# How many kills of each kind; the live run has a tracker, the others are recorders alone.
KILLS = {'recording': 500, 'splitting': 150, 'closing': 150, 'recovering': 150, 'live run': 50}
QUICK_KILLS = {'recording': 4, 'splitting': 4, 'closing': 4, 'recovering': 4}
COLOURS = dict(zip(KILLS, (WALK, RUN, JUMP, PERIODIC, '#444444'), strict=True))


@dataclass(frozen=True)
class Kill:
    """What a kill has cost.

    Attributes:
        kind: Of `KILLS`.
        loss_s: Time from the newest recovered message to the kill, or to the end of the recording if that was
            earlier.
        recovery_s: Time that the recovery took; 0 where the bag was complete.
        megabytes: Size of the bag.
        fault: What is wrong with the recovered bag; empty if nothing is.
    """

    kind: str
    loss_s: float
    recovery_s: float
    megabytes: float
    fault: str = ''


def make_message(topic: str, frame: int) -> bytes:
    """Return a message of a frame, of which every byte is known."""
    start = frame * 97 % (len(NOISE) - BYTES[topic])
    return NUMBER.pack(frame) + NOISE[start : start + BYTES[topic] - NUMBER.size]


def make_batch(frame: int, time_ns: int) -> list[RecordedMessage]:
    """Return the messages of a frame."""
    return [RecordedMessage(t, kind, make_message(t, frame), time_ns, time_ns) for t, kind in TOPICS.items()]


def record(folder: Path, config: RecorderConfig, state: mmap.mmap, seconds: float) -> None:
    """Record for so many seconds, and finish the bag."""
    recorder = BackgroundRecorder(folder, config)
    first_ns, frame, due_s = 0, 0, time.monotonic()
    end_s = due_s + seconds
    while time.monotonic() < end_s:
        now_ns = time.time_ns()
        first_ns = first_ns or now_ns
        recorder.put(make_batch(frame, now_ns))
        frame += 1
        STATE.pack_into(state, 0, RECORDING, frame, first_ns, now_ns)
        due_s += 1 / HZ
        time.sleep(max(due_s - time.monotonic(), 0.0))
    struct.pack_into('<q', state, 0, CLOSING)
    recorder.close()
    struct.pack_into('<q', state, 0, CLOSED)


def fork(action: Callable[..., object], *arguments: object) -> int:
    """Do something in a process of its own, and return its number."""
    pid = os.fork()
    if pid == 0:
        try:
            action(*arguments)
        finally:
            os._exit(0)
    return pid


def kill(pid: int) -> int:
    """Kill a process, and return the time in ns at which it was killed."""
    os.kill(pid, signal.SIGKILL)
    killed_ns = time.time_ns()
    os.waitpid(pid, 0)
    return killed_ns


def read_frames(path: Path) -> tuple[dict[str, list[int]], int, dict[int, int]]:
    """Return the frames of each topic in a bag, the newest log time and those by frame, in ns.

    Raises:
        ValueError: A message is not the one that was written.
    """
    frames: dict[str, list[int]] = {topic: [] for topic in TOPICS}
    times_ns: dict[int, int] = {}
    with Bag(path) as bag:
        for message in bag.messages(list(TOPICS)):
            (frame,) = NUMBER.unpack_from(message.raw)
            if message.raw != make_message(message.topic, frame):
                raise ValueError(f'frame {frame} of {message.topic} is not what was written')
            frames[message.topic].append(frame)
            times_ns[frame] = message.time_ns
    return frames, max(times_ns.values(), default=0), times_ns


def find_gap(frames: dict[str, list[int]]) -> str:
    """Describe a frame that is missing before the newest of its topic; an empty string where there is none."""
    for topic, numbers in frames.items():
        if sorted(numbers) != list(range(len(numbers))):
            return f'{topic}: {len(numbers)} messages up to frame {max(numbers)}'
    return ''


def hash_folder(folder: Path) -> dict[str, str]:
    """Return the checksum of every file of a folder."""
    return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in sorted(folder.iterdir())}


def recover_bag(bag: Path, out: Path) -> float:
    """Recover a bag, or find that it is complete; return the seconds that the recovery took.

    Raises:
        MocapError: Nothing could be read.
    """
    try:
        with Bag(bag) as complete:
            complete.count(list(TOPICS))
        bag.rename(out)
    except InputError:
        start_s = time.perf_counter()
        recover(bag, out)
        return time.perf_counter() - start_s
    return 0.0


def kill_recovery(bag: Path, out: Path, after_s: float) -> str:
    """Kill a recovery; return what is wrong with the damaged bag afterwards, an empty string where nothing is."""
    before = hash_folder(bag)
    pid = fork(recover, bag, out)
    time.sleep(after_s)
    kill(pid)
    if out.exists():  # it was faster
        out.rename(out.with_name('first'))
    return '' if hash_folder(bag) == before else 'a recovery that was killed changed the bag'


def kill_once(kind: str, seed: int, root: Path) -> Kill:
    """Record, kill, recover and compare."""
    rng = np.random.default_rng([seed, *kind.encode()])
    folder = root / f'{kind} {seed}'.replace(' ', '_')
    folder.mkdir()
    state = mmap.mmap(-1, STATE.size)
    bag = folder / 'bag'
    is_splitting, is_closing = kind == 'splitting', kind == 'closing'
    config = RecorderConfig(split_seconds=SPLIT_SECONDS if is_splitting else 0.0)
    pid = fork(record, bag, config, state, rng.uniform(0.03, 0.4) if is_closing else 60.0)
    while STATE.unpack_from(state)[0] < (CLOSING if is_closing else RECORDING):
        time.sleep(0.0005)
    if is_closing:
        time.sleep(rng.uniform(0.0, 0.02))
    elif is_splitting:
        time.sleep(rng.integers(1, 6) * SPLIT_SECONDS + rng.uniform(*NEAR_SPLIT_S))
    else:
        time.sleep(rng.uniform(0.0, 1.5))
    killed_ns = kill(pid)
    phase, _, first_ns, last_ns = STATE.unpack_from(state)
    size = sum(f.stat().st_size for f in bag.iterdir()) / 1e6
    fault = kill_recovery(bag, folder / 'whole', rng.uniform(0.0, 0.06)) if kind == 'recovering' else ''
    recovery_s, newest_ns = 0.0, first_ns
    try:
        recovery_s = recover_bag(bag, folder / 'whole')
        frames, newest_ns, _ = read_frames(folder / 'whole')
        fault = fault or find_gap(frames)
    except (MocapError, ValueError) as error:
        if killed_ns - first_ns > MAX_UNREADABLE_AGE_S * 1e9:
            fault = str(error)
    end_ns = last_ns if phase >= CLOSING else killed_ns
    return Kill(kind, (end_ns - newest_ns) / 1e9, recovery_s, size, fault)


def kill_live_run(seed: int, root: Path) -> Kill:
    """Kill a live run with its tracker, and recover its recording."""
    folder = root / f'live_{seed}'
    pid = fork(record_until_killed, folder, load_stream())
    while not list(folder.glob('*/*.mcap')):
        time.sleep(0.01)
    time.sleep(np.random.default_rng(seed).uniform(0.5, 2.0))
    killed_ns = kill(pid)
    (bag,) = folder.iterdir()
    size = sum(f.stat().st_size for f in bag.iterdir()) / 1e6
    try:
        start_s = time.perf_counter()
        recover(bag, folder / 'whole')
        recovery_s = time.perf_counter() - start_s
        with Bag(folder / 'whole') as whole:
            newest_ns = max(m.time_ns for m in whole.messages(whole.topics))
    except (MocapError, ValueError) as error:
        return Kill('live run', float('nan'), 0.0, size, str(error))
    return Kill('live run', (killed_ns - newest_ns) / 1e9, recovery_s, size)


def cut_power(job: tuple[int, Path]) -> list[Kill]:
    """Record on a disk that forgets, cut the power at random moments, recover and compare."""
    seed, root = job
    rng = np.random.default_rng(seed)
    folder, state = root / f'cut_{seed}', mmap.mmap(-1, STATE.size)
    sync_s = SYNC_S[seed % len(SYNC_S)]
    disk = ForgetfulDisk(folder / 'images', sync_s, seed)
    for place in ('images', 'disk'):
        (folder / place).mkdir(parents=True)
    seconds = rng.uniform(0.5, 6.0)
    moments_s = np.sort(rng.uniform(0.0, seconds + 0.5, CUTS_PER_RECORDER))
    states = []
    with mount(disk, folder / 'disk'):
        config = RecorderConfig(split_seconds=rng.choice([0.0, 1.5]))
        pid = fork(record, folder / 'disk' / 'bag', config, state, seconds)
        start_s = time.monotonic()
        for number, moment_s in enumerate(moments_s):
            time.sleep(max(start_s + moment_s - time.monotonic(), 0.0))
            before = STATE.unpack_from(state)
            cut_ns = time.time_ns()
            (folder / 'disk' / f'{CUT[1:]}{number}').mkdir()
            states.append((before, cut_ns))
        os.waitpid(pid, 0)
    return [
        compare_after_cut(name_sync(sync_s), folder / 'images' / str(number), before, cut_ns)
        for number, (before, cut_ns) in enumerate(states)
    ]


def compare_after_cut(kind: str, image: Path, state: tuple[int, int, int, int], cut_ns: int) -> Kill:
    """Recover what a disk holds after a power cut; the loss is counted from the first message that is missing.

    Args:
        kind: Of the cut, by the disk.
        image: Folder with what the disk holds.
        state: State of the recorder before the cut, as in `STATE`.
        cut_ns: Time of the cut, in ns.
    """
    phase, count, first_ns, last_ns = state
    end_ns = last_ns if phase >= CLOSING else cut_ns
    fault, recovery_s, size, whole_until_ns = '', 0.0, 0.0, first_ns
    try:
        bag = image / 'bag'
        size = sum(f.stat().st_size for f in bag.iterdir()) / 1e6 if bag.exists() else 0.0
        recovery_s = recover_bag(bag, image / 'whole')
        frames, _, times_ns = read_frames(image / 'whole')
        whole = min(find_first_missing(numbers) for numbers in frames.values())
        whole_until_ns = times_ns[whole - 1] if whole else first_ns
        if phase == CLOSED and (recovery_s or whole < count):
            fault = f'the finished bag has {whole} of {count} frames'
    except (MocapError, ValueError) as error:
        fault = str(error) if count and cut_ns - first_ns > 1e9 else ''
    loss_s = (end_ns - whole_until_ns) / 1e9 if count else 0.0
    return Kill(kind, loss_s, recovery_s, size, fault)


def find_first_missing(numbers: Sequence[int]) -> int:
    """Return the lowest number from 0 on that is not among the numbers."""
    present = set(numbers)
    return next(n for n in range(len(present) + 1) if n not in present)


def name_sync(sync_s: float) -> str:
    """Return the name of a disk by its time for a sync."""
    return f'{1e3 * sync_s:.0f} ms a sync'


def measure_syncs(root: Path) -> tuple[list[str], list[list[object]]]:
    """Return the table of what a slow disk costs the one who records: header and rows."""
    rows: list[list[object]] = []
    for sync_s in (*SYNC_S, SLOW_SYNC_S):
        place = root / f'sync_{sync_s}'
        place.mkdir()
        with mount(ForgetfulDisk(root, sync_s, 0), place):
            start_s, cpu_s, waits_s = time.monotonic(), time.process_time(), []
            recorder = BackgroundRecorder(place / 'bag', RecorderConfig())
            start_took_s = time.monotonic() - start_s
            for frame in range(SYNC_FRAMES):
                put_s = time.monotonic()
                recorder.put(make_batch(frame, time.time_ns()))
                waits_s.append(time.monotonic() - put_s)
                time.sleep(1 / HZ)
            recorded_s = time.monotonic() - start_s - start_took_s
            cpu_percent = 100 * (time.process_time() - cpu_s) / recorded_s
            end_s = time.monotonic()
            recorder.close()
            closed_s = time.monotonic() - end_s
        cells = [f'{1e3 * max(waits_s):.1f}', recorder.refused_count, f'{cpu_percent:.1f}']
        rows.append([name_sync(sync_s), *cells, f'{start_took_s:.2f}', f'{closed_s:.2f}'])
    return ['disk', 'worst wait of the node, ms', 'refused', 'CPU, % of a core', 'start, s', 'end, s'], rows


def measure_cuts(root: Path, count: int) -> list[Kill]:
    """Cut the power of recorders `count` times."""
    prepare_topics()
    jobs = [(seed, root) for seed in range(count // CUTS_PER_RECORDER)]
    with ProcessPoolExecutor(WORKERS, get_context('fork')) as pool:
        done = list(common.show_progress(pool.map(cut_power, jobs), 'power cuts', len(jobs)))
    return [one for cuts in done for one in cuts]


def do_kill(job: tuple[str, int, Path]) -> Kill:
    kind, seed, root = job
    return kill_live_run(seed, root) if kind == 'live run' else kill_once(kind, seed, root)


def prepare_topics() -> None:
    """Make the definitions of the message types, once for all processes that are forked."""
    for topic, msgtype in TOPICS.items():
        make_topic(topic, msgtype)


def measure_kills(root: Path, counts: dict[str, int]) -> list[Kill]:
    """Kill recorders of each kind."""
    jobs = [(kind, seed, root) for kind, count in counts.items() for seed in range(count)]
    prepare_topics()
    if 'live run' in counts:
        warm_up_pipeline()
    with ProcessPoolExecutor(WORKERS, get_context('fork')) as pool:
        return list(common.show_progress(pool.map(do_kill, jobs), 'kills', len(jobs)))


@cache
def load_stream() -> list[Any]:
    """Return the messages of the demo recording, which all processes share."""
    return load_frames()


def warm_up_pipeline() -> None:
    """Load what the tracker needs before processes are forked."""
    pipeline = Pipeline(Config())
    for frame in load_stream()[:40]:
        pipeline.feed(Source.KEYPOINTS, frame.raw)
        pipeline.run_deferred_work()


def record_steps(
    folder: Path, jump: tuple[int, float] = (-1, 0.0), note_frame: Callable[[], None] = lambda: None
) -> int:
    """Record `FRAMES` frames with all that a recorder does: chunks, a further file, and the end.

    Args:
        folder: Folder of the bag.
        jump: From which frame on the clock differs, and by how many seconds.
        note_frame: Called when the disk has taken a frame.

    Returns:
        Number of the frames that were written before the recording failed.
    """
    config = RecorderConfig(chunk_seconds=0.2, split_seconds=0.5, min_free_mb=0)
    frame = 0
    try:
        recorder = Recorder(folder, config)
        for frame in range(FRAMES):
            jump_ns = round(jump[1] * 1e9) if 0 <= jump[0] <= frame else 0
            for message in make_batch(frame, START_NS + frame * STEP_NS + jump_ns):
                recorder.write(*message)
            recorder.flush()
            note_frame()
        recorder.close()
    except RecordingError:
        return frame
    return FRAMES


def do_steps(folder: Path, fault: str, at: int, written: mmap.mmap, jump: tuple[int, float] = (-1, 0.0)) -> None:
    """Record with a fault; leave in `written` the frames that were written, -1 after an error of another kind."""
    FaultyPath.disk = Disk(fault, at, folder)
    struct.pack_into('<q', written, 0, -2)
    try:
        frames = record_steps(FaultyPath(folder), jump)
    except BaseException:
        struct.pack_into('<q', written, 0, -1)
        raise
    struct.pack_into('<q', written, 0, frames)


def try_fault(job: tuple[str, int, Path, tuple[int, float]]) -> dict[str, Any]:
    """Let one step fail; return what became of the bag."""
    fault, at, root, jump = job
    folder = root / f'{fault} {at} {jump[1]}'.replace(' ', '_')
    written = mmap.mmap(-1, 8)
    os.waitpid(fork(do_steps, folder, fault, at, written, jump), 0)
    (frames_written,) = struct.unpack('<q', written[:8])
    found, outcome = 0, 'complete'
    try:
        is_complete = recover_bag(folder, folder.with_name(f'{folder.name}_whole')) == 0
        frames, _, _ = read_frames(folder.with_name(f'{folder.name}_whole'))
        found = min(len(numbers) for numbers in frames.values())
        outcome = find_gap(frames) or ('complete' if is_complete else 'recovered')
    except (MocapError, ValueError) as error:
        outcome = 'nothing recorded' if isinstance(error, MocapError) else str(error)
    return {'fault': fault, 'at': at, 'written': frames_written, 'found': found, 'outcome': outcome}


def is_right(case: dict[str, Any], frames_before: Sequence[int]) -> bool:
    """Return whether a recording with a fault has come out as it should.

    No error but RecordingError is raised, and what was handed to the disk before the fault is there, except where
    the folder was removed.
    """
    if case['written'] == -1 or case['outcome'] not in ('complete', 'recovered', 'nothing recorded'):
        return False
    if case['fault'] == 'removed':
        return True
    if case['fault'] == 'slow' or case['fault'] in CLOCK_JUMPS_S:
        return bool(case['found'] == FRAMES)
    return bool(case['found'] >= frames_before[case['at']])


def measure_faults(root: Path, report: Report, every: int = 1) -> dict[str, float]:
    """Let each `every`-th step of the recorder fail in every way; return how many outcomes were wrong."""
    FaultyPath.disk = Disk()
    steps, steps_done = FaultyPath.disk.steps, list[int]()
    record_steps(FaultyPath(root / 'dry'), note_frame=lambda: steps_done.append(len(steps)))
    frames_before = [sum(done <= at for done in steps_done) for at in range(len(steps))]
    no_jump = (-1, 0.0)
    jobs = [(f, at, root, no_jump) for f in FAULTS for at in range(0, 1 if f == 'slow' else len(steps), every)]
    jobs += [(f, at, root, (at, by)) for f, by in CLOCK_JUMPS_S.items() for at in range(1, FRAMES, every)]
    with ProcessPoolExecutor(WORKERS, get_context('fork')) as pool:
        cases = list(common.show_progress(pool.map(try_fault, jobs), 'faults', len(jobs)))
    rows, wrong = [], 0
    for fault in dict.fromkeys(c['fault'] for c in cases):
        chosen = [c for c in cases if c['fault'] == fault]
        outcomes = Counter(c['outcome'] for c in chosen)
        bad = [c for c in chosen if not is_right(c, frames_before)]
        wrong += len(bad)
        lost = max((frames_before[c['at']] - c['found'] for c in chosen if c['fault'] in FAULTS[:4]), default=0)
        rows.append(
            [
                f'clock jumps {fault}' if fault in CLOCK_JUMPS_S else NAMES[fault],
                len(chosen),
                *(outcomes[o] for o in ('complete', 'recovered', 'nothing recorded')),
                max(lost, 0) if fault in FAULTS[:4] else None,
                len(bad),
            ]
        )
        for case in bad[:5]:
            report.text(f'wrong: {case}, step {steps[case["at"]] if case["at"] < len(steps) else ""}')
    header = ['fault', 'steps', 'bag complete', 'after `recover`', 'nothing recorded', 'frames lost', 'wrong']
    report.table(header, rows, page='faults.steps')
    return {'steps': len(steps), 'faults_tried': len(jobs), 'wrong_after_fault': wrong}


NAMES = {
    'kill': 'process killed in the middle of the step',
    'full': 'disk full from the step on',
    'full once': 'disk full at the step alone',
    'read-only': 'disk read-only from the step on',
    'removed': 'folder removed before the step',
    'slow': 'every step takes 20 ms',
}


class TimedLogger(SilentLogger):
    """A logger that notes when the first error came."""

    def __init__(self) -> None:
        self.error_s: float | None = None

    def error(self, message: str) -> None:  # noqa: ARG002
        if self.error_s is None:
            self.error_s = time.monotonic()


def measure_stall(root: Path) -> dict[str, float]:
    """Return how soon a live run says that its disk takes nothing, and how long an image takes meanwhile."""
    write, is_ready, stalled_s = Recorder.write, threading.Event(), [0.0]

    def wait_and_write(*arguments: Any) -> None:
        stalled_s[0] = stalled_s[0] or time.monotonic()
        is_ready.wait()
        write(*arguments)

    logger, published = TimedLogger(), dict[int, float]()
    config = with_values(Config(), {'recorder.enabled': True, 'recorder.folder': str(root / 'stall')})
    types = {Source.KEYPOINTS: KEYPOINTS, Source.CAMERA_INFO: CAMERA_INFO}
    counter = iter(range(1 << 30))

    def publish(output: Any) -> None:
        if output.topic == 'skeletons':
            published[next(counter)] = time.monotonic()

    live = LiveRun(Pipeline(config), types, TOPIC_NAMES, publish, logger)
    Recorder.write = wait_and_write  # type: ignore[assignment, method-assign]
    sent = []
    try:
        live.start()
        for frame in load_stream()[: round(STALL_S * HZ)]:
            sent.append(time.monotonic())
            live.enqueue(Source.KEYPOINTS, frame.raw, 0)
            time.sleep(1 / HZ)
        is_ready.set()
        live.stop()
    finally:
        Recorder.write = write  # type: ignore[method-assign]
    (bag,) = (root / 'stall').iterdir()
    with Bag(bag) as whole:
        recorded = whole.count(['/keypoints'])
    delays = [published[n] - s for n, s in enumerate(sent) if n in published]
    return {
        'stall_noticed_s': (logger.error_s or float('inf')) - stalled_s[0],
        'stall_latency_ms': 1e3 * float(np.median(delays)),
        'stall_unrecorded': len(sent) - recorded,
    }


def summarise(kills: Sequence[Kill]) -> dict[str, float]:
    """Return the figures of the kills."""
    losses = [k.loss_s for k in kills if not k.fault]
    recoveries = [k.recovery_s for k in kills if k.recovery_s]
    return {
        'kills': len(kills),
        'unreadable': sum(bool(k.fault) for k in kills),
        'worst_loss_s': max(losses),
        'median_loss_s': float(np.median(losses)),
        'p99_loss_s': float(np.percentile(losses, 99)),
        'median_recovery_s': float(np.median(recoveries)),
        'worst_recovery_s': max(recoveries),
    }


def tabulate(
    kills: Sequence[Kill], counts: Iterable[str], kind: str = 'killed while'
) -> tuple[list[str], list[list[object]]]:
    """Return header and rows of the table of kills."""
    header = [
        kind,
        'cuts' if kind == 'disk' else 'kills',
        'unreadable',
        'loss: median, s',
        '99 %',
        'worst',
        'recovery: median, s',
        'worst',
    ]
    rows: list[list[object]] = []
    for kind in counts:
        chosen = [k for k in kills if k.kind == kind]
        one = summarise(chosen)
        cells = [f'{one[k]:.3f}' for k in ('median_loss_s', 'p99_loss_s', 'worst_loss_s')]
        cells += [f'{one[k]:.2f}' for k in ('median_recovery_s', 'worst_recovery_s')]
        rows.append([kind, len(chosen), int(one['unreadable']), *cells])
    return header, rows


def describe(found: dict[str, float]) -> list[list[object]]:
    """Return the rows of the page's first table."""
    kills, faults = f'{found["kills"]:.0f}', f'{found["faults_tried"]:.0f}'
    losses = [f'{found[k]:.3f} s' for k in ('median_loss_s', 'worst_loss_s')]
    return [
        [f'bags that `recover` could not read, or with a gap, of {kills} kills', int(found['unreadable']), '0'],
        ['loss, median', losses[0], '0.1 s'],
        ['loss, worst', losses[1], '0.3 s'],
        [
            f'bags that `recover` could not read after {found["cut_kills"]:.0f} power cuts',
            int(found['cut_unreadable']),
            '0',
        ],
        ['loss by a power cut, worst', f'{found["cut_worst_loss_s"]:.3f} s', '1 s'],
        [
            f'faults at a step of the recorder that came out wrong, of {faults}',
            int(found['wrong_after_fault']),
            '0',
        ],
        ['time until the node says that its disk takes nothing', f'{found["stall_noticed_s"]:.2f} s', '1 s'],
        ['age of an image with skeletons meanwhile, median', f'{found["stall_latency_ms"]:.0f} ms', None],
    ]


def draw(kills: Sequence[Kill]) -> Any:
    """Draw the distributions of what was lost and of how long the recovery took."""
    figure, (lost, recovered) = make_panels(2)
    for kind, colour in COLOURS.items():
        chosen = [k for k in kills if k.kind == kind]
        losses = np.sort([k.loss_s * 1e3 for k in chosen])
        lost.step(losses, np.arange(1, len(losses) + 1) / len(losses) * 100, color=colour, label=kind)
        recovered.scatter([k.megabytes for k in chosen], [k.recovery_s for k in chosen], 6, colour, label=kind)
    lost.set_xlim(0)
    lost.legend(loc='lower right')
    label_axes(lost, 'lost before the kill, ms', '% of the kills', 'loss')
    recovered.set_ylim(0)
    recovered.set_xlim(0)
    label_axes(recovered, 'size of the bag, MB', 's', 'time to recover')
    return figure


def measure(args: argparse.Namespace, report: Report) -> None:
    counts = QUICK_KILLS if args.quick else KILLS
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        kills = measure_kills(root, counts)
        for one in [k for k in kills if k.fault][:20]:
            report.text(f'unreadable: {one}')
        report.table(*tabulate(kills, counts), page='faults.kills')
        report.add(**summarise(kills))
        cuts = measure_cuts(root, QUICK_CUTS if args.quick else CUTS)
        for one in [c for c in cuts if c.fault][:20]:
            report.text(f'unreadable: {one}')
        report.table(*tabulate(cuts, map(name_sync, SYNC_S), 'disk'), page='faults.cuts')
        report.table(*measure_syncs(root), page='faults.syncs')
        results = measure_faults(root, report, every=6 if args.quick else 1)
        cut_results = {f'cut_{name}': value for name, value in summarise(cuts).items()}
        found = {**summarise(kills), **cut_results, **results, **measure_stall(root)}
    report.quantities(found, TARGETS, page='')
    report.keep('faults.targets', ['quantity', 'measured', 'target'], describe(found))
    if not args.quick:
        report.picture(draw(kills), 'docs/img/reliability/kills.png')


def main() -> None:
    run(__doc__, 'Faults', measure, one_core=False)


if __name__ == '__main__':
    main()
