# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Faults of recordings: recorders that are killed, power cuts, and disks that fail at every step.

Every bag is recovered; each message that is found must be the one that was written, and none before the newest may
be missing. The loss is the time from the newest message that was recovered to the kill, or to the end of the
recording if it was being closed; after a power cut, from the first message that is missing. Sections of `--only`:

    kills  a recorder writes three topics at 30 Hz and is killed at a random moment: while it records, near the
           moment at which the bag continues in a further file, while it closes it, and `recover` as well; and the
           whole node
    cuts   the same on a file system that forgets (`disks.py`): when the power is cut, it holds what was synced,
           and of everything else random sectors, names and sizes
    steps  each of the recorder's steps on the disk fails in each way, and the clock jumps at each frame
"""

import common

# isort: split
import importlib.util
import mmap
import os
import signal
import struct
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from disks import CUT, Disk, FaultyPath, ForgetfulDisk, mount
from node import Peer, run_node
from report import Report, group, run

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, MocapError, RecordingError
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.outputs import OUTPUTS

HZ, STEP_NS = 30, 33_333_333  # Hz, rate of the messages on each topic, and its period in ns
START_NS = 1_700_000_000_000_000_000  # ns, log time of the first message where no clock runs
TOPICS = {'/keypoints': KEYPOINTS, '/skeletons': OUTPUTS['skeletons'], '/markers': OUTPUTS['markers']}
BYTES = {'/keypoints': 400, '/skeletons': 2900, '/markers': 3500}  # of a message, those of one person
NOISE = np.random.default_rng(0).bytes(1 << 14)  # of which messages consist; it compresses as badly as floats
NUMBER = struct.Struct('<Q')  # number of the frame, at the start of each message
STATE = struct.Struct('<qqqq')  # phase, frames put, times of the first and last frame in ns; of the recorder
RECORDING, CLOSING, CLOSED = 1, 2, 3  # phases of a recorder
SPLIT_SECONDS = 0.2  # s, time of each file while splitting
NEAR_SPLIT_S = -0.01, 0.04  # s, from a split to the kill
WORKERS = 4  # recorders at a time, so that a thousand kills take minutes; they sleep most of the time
MAX_UNREADABLE_AGE_S = 0.3  # s; a recorder that is killed earlier may not have written anything yet
KILLS = {'recording': 500, 'splitting': 150, 'closing': 150, 'recovering': 150}  # how many of each kind
NODE_KILLS = 50
CUTS, CUTS_PER_RECORDER = 1000, 10  # the recorder does not notice a cut: what the disk would hold is copied
SYNC_S = 0.0, 0.03, 0.1, 0.25  # s, which the disk takes for a sync, by recorder
FRAMES = 24  # of a recording whose steps fail
CLOCK_JUMPS_S = {'an hour forward': 3600.0, 'an hour back': -3600.0, 'to 1970': -1.7e9}
FAULTS = {
    'kill': 'process killed in the middle of the step',
    'full': 'disk full from the step on',
    'full once': 'disk full at the step alone',
    'read-only': 'disk read-only from the step on',
    'removed': 'folder removed before the step',
    'slow': 'every step takes 20 ms',
}
NO_JUMP = (-1, 0.0)


@dataclass(frozen=True)
class Kill:
    """What a kill or a cut has cost.

    Attributes:
        kind: of the row in the table.
        loss_s: s, as of the module.
        recovery_s: s, time that the recovery took; 0 where the bag was complete.
        fault: what is wrong with the recovered bag; empty if nothing is.
    """

    kind: str
    loss_s: float
    recovery_s: float
    fault: str = ''


def make_batch(frame: int, time_ns: int) -> list[RecordedMessage]:
    return [RecordedMessage(t, kind, make_message(t, frame), time_ns, time_ns) for t, kind in TOPICS.items()]


def make_message(topic: str, frame: int) -> bytes:
    """Return a message of which every byte is known."""
    start = frame * 97 % (len(NOISE) - BYTES[topic])
    return NUMBER.pack(frame) + NOISE[start : start + BYTES[topic] - NUMBER.size]


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


def read_frames(path: Path) -> tuple[dict[str, list[int]], dict[int, int]]:
    """Return the frames of each topic in a bag, and their log times in ns.

    Raises:
        ValueError: a message is not the one that was written.
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
    return frames, times_ns


def find_gap(frames: dict[str, list[int]]) -> str:
    """Describe a frame that is missing before the newest of its topic; an empty string where there is none."""
    for topic, numbers in frames.items():
        if sorted(numbers) != list(range(len(numbers))):
            return f'{topic}: {len(numbers)} messages up to frame {max(numbers)}'
    return ''


def find_first_missing(numbers: Sequence[int]) -> int:
    present = set(numbers)
    return next(n for n in range(len(present) + 1) if n not in present)


def recover_bag(bag: Path, out: Path) -> float:
    """Recover a bag, or find that it is complete; return the seconds that the recovery took."""
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
    before = {f.name: f.read_bytes() for f in bag.iterdir()}
    pid = fork(recover, bag, out)
    time.sleep(after_s)
    kill(pid)
    if out.exists():  # it was faster
        out.rename(out.with_name('first'))
    now = {f.name: f.read_bytes() for f in bag.iterdir()}
    return '' if now == before else 'a recovery that was killed changed the bag'


def kill_once(job: tuple[str, int, Path]) -> Kill:
    """Record, kill, recover and compare."""
    kind, seed, root = job
    rng = np.random.default_rng([seed, *kind.encode()])
    folder, state = root / f'{kind}_{seed}', mmap.mmap(-1, STATE.size)
    folder.mkdir()
    bag, whole = folder / 'bag', folder / 'whole'
    is_closing = kind == 'closing'
    config = RecorderConfig(split_seconds=SPLIT_SECONDS if kind == 'splitting' else 0.0)
    pid = fork(record, bag, config, state, rng.uniform(0.03, 0.4) if is_closing else 60.0)
    while STATE.unpack_from(state)[0] < (CLOSING if is_closing else RECORDING):
        time.sleep(0.0005)
    if is_closing:
        time.sleep(rng.uniform(0.0, 0.02))
    elif kind == 'splitting':
        time.sleep(rng.integers(1, 6) * SPLIT_SECONDS + rng.uniform(*NEAR_SPLIT_S))
    else:
        time.sleep(rng.uniform(0.0, 1.5))
    killed_ns = kill(pid)
    phase, _, first_ns, last_ns = STATE.unpack_from(state)
    fault = kill_recovery(bag, whole, rng.uniform(0.0, 0.06)) if kind == 'recovering' else ''
    recovery_s, newest_ns = 0.0, first_ns
    try:
        recovery_s = recover_bag(bag, whole)
        frames, times_ns = read_frames(whole)
        newest_ns = max(times_ns.values(), default=0)
        fault = fault or find_gap(frames)
    except (MocapError, ValueError) as error:
        if killed_ns - first_ns > MAX_UNREADABLE_AGE_S * 1e9:
            fault = str(error)
    end_ns = last_ns if phase >= CLOSING else killed_ns
    return Kill(kind, (end_ns - newest_ns) / 1e9, recovery_s, fault)


def kill_node(seed: int, root: Path) -> Kill:
    """Kill a node that tracks and records a person, and recover its recording."""
    folder, fault, newest_ns, recovery_s = root / f'node_{seed}', '', 0, 0.0
    with Peer() as peer, run_node(folder) as process:
        peer.wait_for_node()
        peer.stream(1, float(np.random.default_rng(seed).uniform(0.5, 2.0)), 0.0)
        process.kill()
        killed_ns = time.time_ns()
    (bag,) = folder.iterdir()
    try:
        start_s = time.perf_counter()
        recover(bag, folder / 'whole')
        recovery_s = time.perf_counter() - start_s
        with Bag(folder / 'whole') as whole:
            newest_ns = max(m.time_ns for m in whole.messages(whole.topics))
    except (MocapError, ValueError) as error:
        fault = str(error)
    return Kill('node', (killed_ns - newest_ns) / 1e9, recovery_s, fault)


def cut_power(job: tuple[int, Path]) -> list[Kill]:
    """Record on a disk that forgets, cut the power at random moments, recover and compare."""
    seed, root = job
    rng = np.random.default_rng(seed)
    folder, state, sync_s = root / f'cut_{seed}', mmap.mmap(-1, STATE.size), SYNC_S[seed % len(SYNC_S)]
    for place in ('images', 'disk'):
        (folder / place).mkdir(parents=True)
    seconds, states = rng.uniform(0.5, 6.0), []
    moments_s = np.sort(rng.uniform(0.0, seconds + 0.5, CUTS_PER_RECORDER))
    with mount(ForgetfulDisk(folder / 'images', sync_s, seed), folder / 'disk'):
        config = RecorderConfig(split_seconds=rng.choice([0.0, 1.5]))
        pid = fork(record, folder / 'disk' / 'bag', config, state, seconds)
        start_s = time.monotonic()
        for number, moment_s in enumerate(moments_s):
            time.sleep(max(start_s + moment_s - time.monotonic(), 0.0))
            states.append((STATE.unpack_from(state), time.time_ns()))
            (folder / 'disk' / f'{CUT[1:]}{number}').mkdir()
        os.waitpid(pid, 0)
    kind = f'power cut, {1e3 * sync_s:.0f} ms a sync'
    return [compare_after_cut(kind, folder / 'images' / str(n), *given) for n, given in enumerate(states)]


def compare_after_cut(kind: str, image: Path, state: tuple[int, ...], cut_ns: int) -> Kill:
    """Recover the image of what a disk holds after a power cut, before which the recorder was in a `STATE`."""
    phase, count, first_ns, last_ns = state
    end_ns = last_ns if phase >= CLOSING else cut_ns
    fault, recovery_s, whole_until_ns = '', 0.0, first_ns
    try:
        recovery_s = recover_bag(image / 'bag', image / 'whole')
        frames, times_ns = read_frames(image / 'whole')
        whole = min(find_first_missing(numbers) for numbers in frames.values())
        whole_until_ns = times_ns[whole - 1] if whole else first_ns
        if phase == CLOSED and (recovery_s or whole < count):
            fault = f'the finished bag has {whole} of {count} frames'
    except (MocapError, ValueError) as error:
        fault = str(error) if count and cut_ns - first_ns > 1e9 else ''
    return Kill(kind, (end_ns - whole_until_ns) / 1e9 if count else 0.0, recovery_s, fault)


def do_all(action: Callable[[Any], Any], jobs: Sequence[Any], root: Path, name: str) -> list[Any]:
    """Do something with each job in forked processes, in which the message types are known."""
    with Recorder(root / f'first_{name}', RecorderConfig()) as recorder:
        for message in make_batch(0, START_NS):
            recorder.write(*message)
    with ProcessPoolExecutor(WORKERS, get_context('fork')) as pool:
        return list(common.show_progress(pool.map(action, jobs), name, len(jobs)))


def show_kills(report: Report, kills: Sequence[Kill], what: str, goal_s: float) -> dict[str, Any]:
    """Show a row for each kind, and targets for all of them."""
    rows = report.results.get('kill_rows', [])
    for (kind,), mine in group([asdict(k) for k in kills], 'kind').items():
        lost = [k['loss_s'] for k in mine if not k['fault']]
        took = [k['recovery_s'] for k in mine if k['recovery_s']] or [0.0]
        shown = [f'{v:.3f}' for v in (np.median(lost), np.percentile(lost, 99), max(lost))]
        rows.append([kind, len(mine), len(mine) - len(lost), *shown, f'{np.median(took):.2f}', f'{max(took):.2f}'])
    for one in [k for k in kills if k.fault][:20]:
        report.text(f'not readable: {one}')
    header = ['killed while', 'times', 'unreadable', 'loss: median, s', '99 %', 'worst']
    report.table([*header, 'recovery: median, s', 'worst'], rows, page='faults.kills')
    lost = [k.loss_s for k in kills if not k.fault]
    claim = f'bags that `recover` could not read, or with a gap, of {len(kills)} {what}'
    show_targets(
        report,
        [claim, len(kills) - len(lost), '0'],
        [f'loss, median of the {what}', f'{np.median(lost):.3f} s', None],
        [f'loss, worst of the {what}', f'{max(lost):.3f} s', f'{goal_s:g} s'],
    )
    return {'kill_rows': rows}


def show_targets(report: Report, *rows: list[object]) -> None:
    """Show the table of targets, with what has been measured so far."""
    report.results['targets'] = [*report.results.get('targets', []), *rows]
    report.table(['quantity', 'measured', 'target'], report.results['targets'], page='faults.targets')


def report_kills(report: Report) -> dict[str, Any]:
    counts = {kind: 4 if report.quick else count for kind, count in KILLS.items()}
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        jobs = [(kind, seed, root) for kind, count in counts.items() for seed in range(count)]
        kills = do_all(kill_once, jobs, root, 'kills')
        kills += [kill_node(seed, root) for seed in range(1 if report.quick else NODE_KILLS)]
    return show_kills(report, kills, 'kills', 0.3)


def report_cuts(report: Report) -> dict[str, Any]:
    if importlib.util.find_spec('fuse') is None or not Path('/dev/fuse').exists():
        report.text('No power is cut: that needs fusepy and /dev/fuse.')
        return {}
    count = len(SYNC_S) if report.quick else CUTS // CUTS_PER_RECORDER
    with tempfile.TemporaryDirectory() as name:
        done = do_all(cut_power, [(seed, Path(name)) for seed in range(count)], Path(name), 'cuts')
    return show_kills(report, [one for cuts in done for one in cuts], 'power cuts', 1.0)


def record_steps(
    folder: Path, jump: tuple[int, float] = NO_JUMP, note_frame: Callable[[], None] = lambda: None
) -> int:
    """Record `FRAMES` frames with all that a recorder does: chunks, a further file, and the end.

    From a frame on the clock may jump by so many seconds; `note_frame` is called when the disk has taken a frame.
    Return how many frames were written before the recording failed.
    """
    config, frame = RecorderConfig(chunk_seconds=0.2, split_seconds=0.5, min_free_mb=0), 0
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


def do_steps(folder: Path, fault: str, at: int, written: mmap.mmap, jump: tuple[int, float]) -> None:
    """Record with a fault; leave in `written` the frames that were written, -1 after an error of another kind."""
    FaultyPath.disk = Disk(fault, at, folder)
    struct.pack_into('<q', written, 0, -1)
    frames = record_steps(FaultyPath(folder), jump)
    struct.pack_into('<q', written, 0, frames)


def try_fault(job: tuple[str, int, Path, tuple[int, float]]) -> dict[str, Any]:
    """Let one step fail; return what became of the bag."""
    fault, at, root, jump = job
    folder = root / f'{fault} {at} {jump[1]}'.replace(' ', '_')
    whole, written = folder.with_name(f'{folder.name}_whole'), mmap.mmap(-1, 8)
    os.waitpid(fork(do_steps, folder, fault, at, written, jump), 0)
    found, outcome = 0, 'complete'
    try:
        is_complete = recover_bag(folder, whole) == 0
        frames, _ = read_frames(whole)
        found = min(len(numbers) for numbers in frames.values())
        outcome = find_gap(frames) or ('complete' if is_complete else 'recovered')
    except (MocapError, ValueError) as error:
        outcome = 'nothing recorded' if isinstance(error, MocapError) else str(error)
    is_error = fault != 'kill' and struct.unpack('<q', written[:8])[0] == -1
    return {'fault': fault, 'at': at, 'is_error': is_error, 'found': found, 'outcome': outcome}


def is_right(case: dict[str, Any], frames_before: Sequence[int]) -> bool:
    """Return whether a recording with a fault has come out as it should.

    No error but RecordingError is raised, and what was handed to the disk before the fault is there, except where
    the folder was removed.
    """
    if case['is_error'] or case['outcome'] not in ('complete', 'recovered', 'nothing recorded'):
        return False
    if case['fault'] == 'slow' or case['fault'] in CLOCK_JUMPS_S:
        return bool(case['found'] == FRAMES)
    return case['fault'] == 'removed' or bool(case['found'] >= frames_before[case['at']])


def measure_steps(root: Path, report: Report, every: int = 1) -> dict[str, int]:
    """Let each `every`-th step of the recorder fail in every way; return how many outcomes were wrong."""
    FaultyPath.disk = Disk()
    steps, steps_done = FaultyPath.disk.steps, list[int]()
    record_steps(FaultyPath(root / 'dry'), note_frame=lambda: steps_done.append(len(steps)))
    frames_before = [sum(done <= at for done in steps_done) for at in range(len(steps))]
    jobs = [(f, at, root, NO_JUMP) for f in FAULTS for at in range(0, 1 if f == 'slow' else len(steps), every)]
    jobs += [(f, at, root, (at, by)) for f, by in CLOCK_JUMPS_S.items() for at in range(1, FRAMES, every)]
    cases = do_all(try_fault, jobs, root, 'steps')
    rows, wrong = [], 0
    for fault in (*FAULTS, *CLOCK_JUMPS_S):
        chosen = [c for c in cases if c['fault'] == fault]
        outcomes = Counter(c['outcome'] for c in chosen)
        bad = [c for c in chosen if not is_right(c, frames_before)]
        wrong += len(bad)
        shown = (outcomes[o] for o in ('complete', 'recovered', 'nothing recorded'))
        rows.append([FAULTS.get(fault, f'clock jumps {fault}'), len(chosen), *shown, len(bad)])
        for case in bad[:5]:
            report.text(f'wrong: {case}, step {steps[case["at"]] if case["at"] < len(steps) else ""}')
    header = ['fault', 'steps', 'bag complete', 'after `recover`', 'nothing recorded', 'wrong']
    report.table(header, rows, page='faults.steps')
    return {'steps': len(steps), 'tried': len(jobs), 'wrong': wrong}


def report_steps(report: Report) -> None:
    with tempfile.TemporaryDirectory() as name:
        found = measure_steps(Path(name), report, every=6 if report.quick else 1)
    claim = f'faults at a step of the recorder that came out wrong, of {found["tried"]}'
    show_targets(report, [claim, found['wrong'], '0'])


if __name__ == '__main__':
    run(__doc__, {'kills': report_kills, 'cuts': report_cuts, 'steps': report_steps})
