# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Speed and memory: the tracker alone, a replay, and the node over real DDS.

With `--reference FOLDER`, another checkout is measured in turn with this one, and the table shows the ratios;
other programs on the machine then hardly matter. Times of the tracker are CPU times of one core and one BLAS
thread. Sections of `--only`:

    tracker  ms a person and frame, for 1, 10 and 30 people
    replay   a recording of one person, times real time
    node     latency from keypoints to skeleton, and memory of the node with ten people
    start    CPU time and time from the start of the node's process to its first answer
    crowd    the largest number of people that the node tracks at 30 Hz for a minute with recording
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import common
import numpy as np
from node import HZ, MAX_PEOPLE, TIMEOUT_S, Peer, measure_usage, run_node
from report import Report, run

Found = dict[str, float]

# What is to be reached where the reference, commit 12d0d11, takes 1.27 ms a frame of one person.
TARGETS: Mapping[str, float] = {
    'ms a person and frame, 1 person': 0.60,
    'ms a person and frame, 10 people': 0.45,
    'ms a person and frame, 30 people': 0.40,
    'longest deferred piece, ms': 3,
    'people at 30 Hz for 60 s, with recording': 50,
    'replay of one person, times real time': 18,
    'latency of one person, median, ms': 4,
    'latency of one person, 99 %, ms': 4,
    'latency of ten people, 99 %, ms': 20,
    'memory of the node, ten people, MB': 150,
    'start of the node, s': 2,
    'start of the node, CPU s': 1.5,
}
DEMO = Path('mocap_ros', 'demo', 'demo.npz')  # in a checkout
CROWD_S = 60.0  # s for which a crowd must be tracked without a dropped frame
WARM_UP_FRAMES = 75  # of the tracker, that do not count
# Tracks people side by side, by the public tracker; what it defers is done after each frame, as the node does it.
TRACK = """
import json, sys, time
from mocap_ros.runtime import cpu_setup
cpu_setup.configure_process()
import numpy as np, mocap_ros
sequence, people, frames = mocap_ros.read(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
tracker = mocap_ros.Tracker(sequence.joint_names, image_size=(3840, 2160))
run_deferred_work = getattr(tracker._tracker, 'run_deferred_work', lambda: None)
shifts = np.array([[300.0 * (n % 12), 400.0 * (n // 12), 0.0] for n in range(people)])
updates, pieces = [], []
for frame in range(frames):
    seen = sequence.keypoints[frame % len(sequence)] + shifts[:, None]
    start = time.thread_time()
    tracker.update((frame + 1) / 30, seen, ids=[f'p{n}' for n in range(people)])
    between = time.thread_time()
    run_deferred_work()
    updates.append(between - start)
    pieces.append(time.thread_time() - between)
print(json.dumps([updates, pieces]))
"""


def make_environment(root: Path) -> dict[str, str]:
    """Return the environment of a process that runs the package of a checkout."""
    return {**os.environ, 'PYTHONPATH': f'{root}{os.pathsep}{os.environ.get("PYTHONPATH", "")}'}


def measure_tracker(root: Path, quick: bool) -> Found:
    out, longest = Found(), 0.0
    for people in (1, 10) if quick else (1, 10, 30):
        command = [sys.executable, '-c', TRACK, str(root / DEMO), str(people), '120' if quick else '300']
        done = subprocess.run(
            command, env=make_environment(root), cwd=root, capture_output=True, text=True, check=True
        )
        updates, pieces = np.array(json.loads(done.stdout))[:, WARM_UP_FRAMES:] * 1e3
        out[f'ms a person and frame, {people} {"person" if people == 1 else "people"}'] = float(
            np.median(updates) / people
        )
        longest = max(longest, float(pieces.max()))
    return {**out, 'longest deferred piece, ms': longest}


def measure_replay(root: Path, _quick: bool) -> Found:
    with tempfile.TemporaryDirectory() as name:
        folder, environment = Path(name), make_environment(root)
        program = [sys.executable, '-c', 'import sys; from mocap_ros.cli.main import main; sys.exit(main())']

        def replay(bag: Path, out: str) -> float:
            start_s = time.perf_counter()
            command = [*program, 'replay', str(bag), '-o', str(folder / out)]
            subprocess.run(command, env=environment, cwd=root, check=True, stdout=subprocess.DEVNULL)
            return time.perf_counter() - start_s

        bags, seconds = [folder / 'short.mcap', folder / 'long.mcap'], []
        with np.load(root / DEMO) as archive:
            whole = dict(archive)
        for bag, frames in zip(bags, (30, len(whole['timestamps'])), strict=True):
            timed = ('keypoints', 'timestamps', 'joints3d')
            np.savez(folder / 'part.npz', **{k: v[:frames] if k in timed else v for k, v in whole.items()})
            command = [*program, 'reconstruct', str(folder / 'part.npz'), '-o', str(bag)]
            subprocess.run(command, env=environment, cwd=root, check=True, stdout=subprocess.DEVNULL)
            seconds.append(replay(bag, bag.stem))
    # the start of the process is in both
    stream_s = (len(whole['timestamps']) - 30) / HZ
    return {'replay of one person, times real time': stream_s / (seconds[1] - seconds[0])}


@contextmanager
def run_peer_and_node(root: Path, *, waits: bool = True) -> Iterator[tuple[Peer, int]]:
    """Run a node of a checkout with a peer; give the peer, and the process of the node, which is ready."""
    environment = make_environment(root)
    with (
        tempfile.TemporaryDirectory() as name,
        Peer() as peer,
        run_node(Path(name), environment=environment, root=root) as node,
    ):
        if waits:
            peer.wait_for_node()
        yield peer, node.pid


def measure_node(root: Path, quick: bool) -> Found:
    out, seconds = Found(), 3.0 if quick else 20.0
    with run_peer_and_node(root) as (peer, pid):
        for people, words in ((1, 'one person'), (10, 'ten people')):
            latency, _ = peer.stream(people, seconds)
            if people == 1:
                out[f'latency of {words}, median, ms'] = float(np.median(latency))
            out[f'latency of {words}, 99 %, ms'] = float(np.percentile(latency, 99))
        out['memory of the node, ten people, MB'] = measure_usage(pid).peak_mb
    return out


def measure_start(root: Path, _quick: bool) -> Found:
    with run_peer_and_node(root, waits=False) as (peer, pid):
        start_s, messages = time.perf_counter(), peer.encode_stream(1)
        while not peer.arrived:
            if time.perf_counter() - start_s > TIMEOUT_S:
                raise TimeoutError('the node did not answer')
            peer.keypoints.publish(next(messages)[1])
            peer.spin_until(time.perf_counter() + 1 / HZ)
        taken_s = min(peer.arrived.values()) - start_s
        return {'start of the node, s': taken_s, 'start of the node, CPU s': measure_usage(pid).cpu_s}


def measure_crowd(root: Path, quick: bool) -> Found:
    """Find the largest crowd whose frames are all answered for `CROWD_S`, by bisection."""
    if quick:
        return {}
    sustained, failed = 0, MAX_PEOPLE + 1
    with run_peer_and_node(root) as (peer, _):
        while failed - sustained > 1:
            people = (sustained + failed) // 2
            _, missing = peer.stream(people, CROWD_S, 0.0)
            sustained, failed = (sustained, people) if missing else (people, failed)
    return {'people at 30 Hz for 60 s, with recording': sustained}


SECTIONS: Mapping[str, Callable[[Path, bool], Found]] = {
    'tracker': measure_tracker,
    'replay': measure_replay,
    'node': measure_node,
    'start': measure_start,
    'crowd': measure_crowd,
}


def measure_section(report: Report, measure: Callable[[Path, bool], Found]) -> dict[str, Any]:
    """Measure this checkout and the reference in turn, and show the table so far: medians of the rounds."""
    folders = {'now': common.ROOT, **({'reference': report.args.reference} if report.args.reference else {})}
    rounds = 1 if report.quick or measure is measure_crowd else 3
    found = [{who: measure(folder, report.quick) for who, folder in folders.items()} for _ in range(rounds)]
    medians = {
        who: {key: float(np.median([f[who][key] for f in found])) for key in found[0][who]} for who in folders
    }
    everything = {who: {**report.results.get(who, {}), **medians[who]} for who in folders}
    header, rows = ['quantity', *folders, *(['ratio'] if len(folders) > 1 else []), 'target'], []
    for key, target in TARGETS.items():
        if key in everything['now']:
            now, *before = (f[key] for f in everything.values())
            shown = [f'{v:.3g}' for v in (now, *before)] + [f'{now / v:.2f}' for v in before]
            rows.append([key, *shown, f'{target:g}'])
    report.table(header, rows, page='engine.targets')
    return everything


def add_options(parser: argparse.ArgumentParser) -> None:
    help_text = 'another checkout, measured in turn with this one'
    parser.add_argument('--reference', type=lambda p: Path(p).resolve(), metavar='FOLDER', help=help_text)


if __name__ == '__main__':
    sections = {
        name: lambda report, measure=measure: measure_section(report, measure)
        for name, measure in SECTIONS.items()
    }
    run(__doc__, sections, add_options)
