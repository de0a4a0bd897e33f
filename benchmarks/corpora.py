# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Many recordings by `mocap-ros batch`: what Dask adds to the work, and killed workers.

Times are CPU seconds with one BLAS thread, so that they mean the same on a machine that does other work. The bags
are of the demo recording. Sections of `--only`:

    overhead  whole commands: `replay` of every bag beside `batch` with one worker
    kills     a worker is killed again and again; nothing may be lost, and no result may differ
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT
from report import Report, run

import mocap_ros
from mocap_ros.bags.reader import Bag
from mocap_ros.batch.cluster import connect, run_jobs
from mocap_ros.batch.job import Job, Outcome, Settings, Status
from mocap_ros.batch.recordings import Work, find_recordings

KILL_SECONDS = 10  # s between two kills


def write_bags(root: Path, count: int, seconds: float) -> list[Path]:
    """Write bags of one person at 30 Hz, each of which begins elsewhere in the demo recording."""
    root.mkdir(parents=True)
    with np.load(ROOT / 'mocap_ros' / 'demo' / 'demo.npz') as archive:
        demo = dict(archive)
    frames, paths = round(seconds * 30), []
    for number in range(count):
        at = (np.arange(frames) + 17 * number) % len(demo['timestamps'])
        part = {k: v[at] if k in ('keypoints', 'joints3d') else v for k, v in demo.items()}
        np.savez(root / 'part.npz', **{**part, 'timestamps': np.arange(frames) / 30})
        paths.append(root / f'bag{number:03d}.mcap')
        mocap_ros.write(str(paths[-1]), mocap_ros.reconstruct(mocap_ros.read(str(root / 'part.npz'))))
    (root / 'part.npz').unlink()
    return paths


def run_command(*arguments: object) -> float:
    """Run `mocap-ros` in a process; return the CPU seconds that it used, with the processes that it started."""

    def total() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = total()
    command = [sys.executable, '-c', 'import sys; from mocap_ros.cli.main import main; sys.exit(main())']
    done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return total() - before


def read_bag(path: Path) -> list[Any]:
    """Return all messages of a bag."""
    with Bag(path) as bag:
        return list(bag.messages(bag.topics))


def report_overhead(report: Report) -> None:
    bags, seconds = (2, 4.0) if report.quick else (report.args.bags, 60.0)
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        paths, short = write_bags(root / 'in', bags, seconds), write_bags(root / 'short', bags, 1.0)

        def measure(some: Sequence[Path], label: str) -> list[float]:
            plain = run_command('replay', *some, '-o', root / f'plain_{label}')
            return [plain, run_command('batch', some[0].parent, '-o', root / label, '--workers', 1)]

        fixed, whole = measure(short, 'short'), measure(paths, 'long')
        each = [(w - f) / bags for w, f in zip(whole, fixed, strict=True)]
        recording_s = seconds - 1.0
        hour_s = each[0] * 3600 / recording_s
    shown = '{:.1f} and {:.1f} s'.format(*fixed)
    rows = [
        ['work on an hour of recording', f'{hour_s:.0f} core s', ''],
        ['a run beside its recordings: `replay`, and `batch` with one worker', shown, ''],
        ['a recording: Dask with one worker over a plain process', f'{each[1] / each[0]:.3f}', 'under 1.03'],
    ]
    report.results['rows'] = rows


def report_kills(report: Report) -> None:
    bags, seconds = (2, 4.0) if report.quick else (report.args.bags, 60.0)
    outcomes: list[Outcome] = []
    kills, finished = [0], threading.Event()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        paths = write_bags(root / 'in', bags, seconds)
        run_command('replay', *paths, '-o', root / 'plain')
        settings = Settings(Work.REPLAY, str(root / 'killed')).seal()
        jobs = [Job(found, settings) for found in find_recordings(str(root / 'in'), Work.REPLAY)]
        begun_s = time.monotonic()
        with connect(None, workers=2) as client:

            def kill() -> None:
                while kills[0] < bags and not finished.wait(KILL_SECONDS):
                    pids = list(client.run(os.getpid, on_error='ignore').values())
                    if pids:
                        os.kill(random.choice(pids), signal.SIGKILL)
                        kills[0] += 1

            killer = threading.Thread(target=kill)
            killer.start()
            run_jobs(client, jobs, outcomes.append)
            finished.set()
            killer.join()
        done = [o.job.recording.name for o in outcomes if o.status is Status.DONE]
        results = root / 'killed' / 'results'
        different = [n for n in done if read_bag(root / 'plain' / n) != read_bag(results / n)]
    taken_s = time.monotonic() - begun_s
    run_of = f'{bags} recordings of {seconds:.0f} s, run of {taken_s:.0f} s, {kills[0]} kills'
    lost = f'{bags - len(done)} lost, {len(different)} different'
    row = [f'a worker killed every {KILL_SECONDS} s: {run_of}', lost, '0 lost']
    both = [*report.results.get('rows', []), row]
    report.table(['quantity', 'measured', 'target'], both, page='corpora.cost')


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--bags', type=int, default=10, metavar='N', help='recordings of a minute')


if __name__ == '__main__':
    run(__doc__, {'overhead': report_overhead, 'kills': report_kills}, add_options)
