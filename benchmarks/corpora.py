# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Batch runs: what Dask adds to the work, how two workers share it, killed workers, and 256 workers by simulation.

Times are CPU seconds with one BLAS thread, so that they mean the same on a machine that does other work. Plain
replays and Dask's workers take turns, a bag at a time, and the median of the ratios counts. The bags are those of
the demo recording, in a circle.

The simulation takes as many tasks as there are recordings, each of which sleeps for as long as a recording was
worked on, in random order of the measured times. Its scheduler and client are those of a real run; its workers are
Dask's, many in a process. Nothing else is simulated.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import random
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import dask
import numpy as np
import psutil
import recording
from distributed import Client, SpecCluster, as_completed
from distributed.scheduler import Scheduler
from report import Report, add_sections, run

from mocap_ros.bags.reader import Bag
from mocap_ros.batch.cluster import LOCAL_SETTINGS, connect, run_jobs
from mocap_ros.batch.job import Job, Outcome, Settings, Status
from mocap_ros.batch.recordings import Work, find_recordings
from mocap_ros.runtime.cpu_setup import configure_process
from mocap_ros.runtime.replay import replay

SHORT_RUNS = 3  # whole commands, of which the median counts
CORPUS_BAGS = 200  # recordings of a minute, for which the target of the overhead is
KILL_SECONDS = 10  # s between two kills
WORKERS, TASKS = 256, 20_000  # of the simulation
PROCESSES = 4  # that the workers of the simulation share
TARGETS = {
    'overhead_percent_200_bags': 'under 3',
    'two_workers_over_two_processes': '0.95 or more',
    'kills_lost_bags': '0',
    'kills_different_bags': '0',
    'simulated_efficiency': '0.9 or more',
}
# Settings of workers that share a machine: what each of them would do beside its tasks on a machine of its own.
QUIET = {
    'distributed.admin.tick.interval': '10s',
    'distributed.admin.system-monitor.interval': '60s',
    'distributed.admin.system-monitor.disk': False,
    'distributed.worker.profile.enabled': False,
    'distributed.worker.memory.monitor-interval': '60s',
}
SECTIONS = ('overhead', 'kills', 'simulation')


def write_bags(root: Path, count: int, seconds: float) -> list[Path]:
    """Write bags of one person, each of which begins elsewhere in the demo recording."""
    frames, paths = recording.load_frames(), [root / f'bag{number:03d}' for number in range(count)]
    for number, path in enumerate(paths):
        recording.write_keypoints(path, frames, round(seconds * recording.HZ), 17 * number)
    return paths


def read_cpu(processes: Sequence[psutil.Process]) -> float:
    """Return the CPU seconds that running processes have used."""
    times = [process.cpu_times() for process in processes]
    return sum(t.user + t.system for t in times)


def run_command(*arguments: object) -> float:
    """Run `mocap-ros` in a process; return the CPU seconds that it used, with the processes that it started."""

    def total() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = total()
    command = [sys.executable, '-m', 'mocap_ros.cli.main', *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return total() - before


class PlainReplays:
    """Processes that replay bags side by side as `mocap-ros replay` does, whenever they are told to."""

    def __init__(self, count: int) -> None:
        self._started = [
            subprocess.Popen(
                [sys.executable, __file__, '--replay'], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            for _ in range(count)
        ]
        self.processes = [psutil.Process(p.pid) for p in self._started]

    def replay(self, bags: Sequence[Path], folder: Path) -> None:
        """Replay as many bags as there are processes into a folder, and wait for them."""
        for process, bag in zip(self._started, bags, strict=True):
            assert process.stdin is not None
            process.stdin.write(json.dumps([str(bag), str(folder / bag.name)]) + '\n')
            process.stdin.flush()
        for process, bag in zip(self._started, bags, strict=True):
            assert process.stdout is not None
            if not process.stdout.readline():
                raise RuntimeError(f'{bag}: the plain replay ended')

    def close(self) -> None:
        for process in self._started:
            process.communicate()


def replay_on_request() -> None:
    """Replay the bags that standard input names, each into the folder beside it, until it ends."""
    configure_process()
    for line in sys.stdin:
        bag, out = json.loads(line)
        with Bag(Path(bag)) as opened:
            replay(opened, Path(out))
        print(out, flush=True)


def take_turns(root: Path, paths: Sequence[Path], count: int) -> tuple[list[float], list[float], int]:
    """Let plain processes and Dask's workers replay the same bags in turn, a bag for each of them at a time.

    All processes of Dask count as long as its turn takes: client, scheduler, nannies and workers. The first turn,
    in which modules are loaded, does not count.

    Args:
        root: folder for the results.
        paths: the bags.
        count: number of the plain processes, and of the workers.

    Returns:
        CPU seconds of each turn of the plain processes and of Dask, and how many results differ.
    """
    seconds: dict[str, list[float]] = {'plain': [], 'batch': []}
    settings = Settings(Work.REPLAY, str(root / 'batch')).seal()
    jobs = {
        j.recording.name: j for j in (Job(f, settings) for f in find_recordings(str(paths[0].parent), Work.REPLAY))
    }
    plain = PlainReplays(count)
    with closing(plain), connect(None, workers=count) as client:
        own = psutil.Process()
        dask_processes = [own, *(c for c in own.children(recursive=True) if c not in plain.processes)]
        outcomes: list[Outcome] = []
        for number in range(0, len(paths) - count + 1, count):
            bags = paths[number : number + count]
            for name in sorted(seconds, reverse=bool(number // count % 2)):
                processes = plain.processes if name == 'plain' else dask_processes
                before = read_cpu(processes)
                if name == 'plain':
                    plain.replay(bags, root / 'plain')
                else:
                    run_jobs(client, [jobs[b.name] for b in bags], outcomes.append)
                seconds[name].append(read_cpu(processes) - before)
            print(*(f'{n}: {s[-1]:.2f} CPU s' for n, s in seconds.items()), sep=', ', file=sys.stderr, flush=True)
    done = [o.job.recording.name for o in outcomes if o.status is Status.DONE]
    different = sum(read_bag(root / 'plain' / n) != read_bag(root / 'batch' / 'results' / n) for n in done)
    return seconds['plain'][1:], seconds['batch'][1:], different + len(paths) // count * count - len(done)


def measure_run(root: Path, name: str, paths: Sequence[Path]) -> tuple[float, float]:
    """Return the CPU seconds of whole commands: `replay` of each bag, and `batch` with a worker for each."""
    listed = root / f'{name}.txt'
    listed.write_text('\n'.join(map(str, paths)))
    plain = sum(run_command('replay', path, '-o', root / name / path.name) for path in paths)
    return plain, run_command('batch', listed, '-o', root / f'{name}_batch', '--workers', len(paths))


def measure_overhead(root: Path, bags: int, seconds: float) -> dict[str, float]:
    """Compare batch runs with plain replays of the same bags: one worker with one process, two with two.

    What a bag costs is measured in turns, and what a run costs beside its bags, such as the start of its
    processes, by whole commands on bags of a second.
    """
    results: dict[str, float] = {'bags': bags, 'seconds_of_a_bag': seconds, 'different_bags': 0}
    for count, name in ((1, 'one'), (2, 'two')):
        folder = root / name
        plain, batch, different = take_turns(folder, write_bags(folder / 'in', (bags + 1) * count, seconds), count)
        runs = [
            measure_run(folder, f'short{n}', write_bags(folder / f'short_in{n}', count, 1.0))
            for n in range(SHORT_RUNS)
        ]
        ratios = np.array(batch) / np.array(plain)
        each, ratio = statistics.median(plain) / count, float(np.median(ratios))
        fixed = [statistics.median(run[k] for run in runs) for k in range(2)]
        full = [fixed[0] + CORPUS_BAGS * each, fixed[1] + CORPUS_BAGS * each * ratio]
        results |= {
            f'{name}_plain_cpu_s_each_bag': each,
            f'{name}_batch_over_plain_each_bag': ratio,
            f'{name}_batch_over_plain_standard_error': float(ratios.std() / np.sqrt(len(ratios))),
            f'{name}_plain_cpu_s_of_a_run': fixed[0],
            f'{name}_batch_cpu_s_of_a_run': fixed[1],
            f'{name}_batch_over_plain_200_bags': full[1] / full[0],
        }
        results['different_bags'] += different
    each = results['one_plain_cpu_s_each_bag'] * results['one_batch_over_plain_each_bag']
    return {
        **results,
        'overhead_percent_200_bags': 100 * (results['one_batch_over_plain_200_bags'] - 1),
        'two_workers_over_two_processes': 1 / results['two_batch_over_plain_200_bags'],
        'core_s_for_an_hour': each * 3600 / seconds,
        'core_hours_for_1000_hours': each * 3600 / seconds * 1000 / 3600,
    }


def read_bag(path: Path) -> list[Any]:
    """Return all messages of a bag."""
    with Bag(path) as bag:
        return list(bag.messages(bag.topics))


def measure_kills(root: Path, bags: int, seconds: float) -> dict[str, float]:
    """Kill a worker every `KILL_SECONDS`, as often as there are bags: a slow machine would else never be done."""
    paths = write_bags(root / 'killed_in', bags, seconds)
    run_command('replay', *paths, '-o', root / 'unkilled')
    outcomes: list[Outcome] = []
    kills, finished = [0], threading.Event()
    settings = Settings(Work.REPLAY, str(root / 'killed')).seal()
    jobs = [Job(found, settings) for found in find_recordings(str(root / 'killed_in'), Work.REPLAY)]
    with connect(None, workers=2) as client:

        def kill() -> None:
            while kills[0] < bags and not finished.wait(KILL_SECONDS):
                pids = list(client.run(os.getpid, on_error='ignore').values())
                if pids:
                    os.kill(random.choice(pids), signal.SIGKILL)
                    kills[0] += 1

        killer = threading.Thread(target=kill)
        killer.start()
        start = time.monotonic()
        run_jobs(client, jobs, outcomes.append)
        taken = time.monotonic() - start
        finished.set()
        killer.join()
    done = [o.job.recording.name for o in outcomes if o.status is Status.DONE]
    different = [n for n in done if read_bag(root / 'unkilled' / n) != read_bag(root / 'killed' / 'results' / n)]
    return {
        'kills': kills[0],
        'kills_bags': bags,
        'kills_run_s': taken,
        'kills_lost_bags': bags - len(done),
        'kills_different_bags': len(different),
    }


async def sleep(seconds: float) -> float:
    """Stand for the work on a recording."""
    await asyncio.sleep(seconds)
    return seconds


def simulate(workers: int, tasks: int, times: Sequence[float]) -> dict[str, float]:
    """Run tasks that sleep as long as recordings took, longest first, on many workers of Dask in few processes."""
    rng = np.random.default_rng(0)
    durations = sorted(rng.choice(times, tasks).tolist(), reverse=True)
    settings = {**LOCAL_SETTINGS, **QUIET}
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        cluster = stack.enter_context(
            SpecCluster({}, {'cls': Scheduler, 'options': {'dashboard_address': ':0'}}, silence_logs=50)
        )
        starts = [
            subprocess.Popen(
                [sys.executable, __file__, '--serve', cluster.scheduler_address, str(workers // PROCESSES)],
            )
            for _ in range(PROCESSES)
        ]
        for process in starts:
            stack.callback(process.wait)
            stack.callback(process.terminate)
        client = stack.enter_context(Client(cluster))
        client.wait_for_workers(workers, timeout=300)
        start, used = time.monotonic(), time.process_time()
        futures = client.map(sleep, durations, key=[('sleep', n) for n in range(tasks)], pure=False)
        for future in as_completed(futures):
            future.release()
        taken, used = time.monotonic() - start, time.process_time() - used
    return {
        'simulated_workers': workers,
        'simulated_tasks': tasks,
        'simulated_mean_task_s': float(np.mean(durations)),
        'simulated_run_s': taken,
        'simulated_efficiency': sum(durations) / workers / taken,
        'scheduler_and_client_cpu_ms_a_task': 1e3 * used / tasks,
    }


def serve(address: str, count: int) -> None:
    """Be some workers of a scheduler, until this process is ended."""
    from distributed import Worker

    async def run() -> None:
        logging.getLogger('distributed').setLevel(logging.ERROR)
        dask.config.set(QUIET)
        options = {'nthreads': 1, 'memory_limit': 0, 'dashboard': False}
        started = await asyncio.gather(*(Worker(address, **options) for _ in range(count)))
        await asyncio.gather(*(worker.finished() for worker in started))

    asyncio.run(run())


def describe(found: Mapping[str, float]) -> list[list[str]]:
    """Return the rows of the page's table from the results of all sections."""
    hours = found['core_hours_for_1000_hours']
    ratio, error = (found[f'one_batch_over_plain_{k}'] for k in ('each_bag', 'standard_error'))
    batch_s, replay_s = (found[f'one_{way}_cpu_s_of_a_run'] for way in ('batch', 'plain'))
    compared = 3 * (found['bags'] + 1)  # of a process, and of two
    kills = (
        f'a worker killed every {KILL_SECONDS} s: {found["kills_bags"]:.0f} recordings of a minute, '
        f'run of {found["kills_run_s"]:.0f} s, {found["kills"]:.0f} kills'
    )
    simulation = (
        f'simulation of {found["simulated_workers"]:.0f} workers, {found["simulated_tasks"]:,.0f} recordings of '
        f'{found["simulated_mean_task_s"]:.0f} s, longest first'
    )
    whole = f'{hours:.0f} core hours; {60 * hours / WORKERS:.0f} minutes of {WORKERS} cores'
    beside = 'a run beside its recordings: `batch` with one worker, and `replay`'
    overhead = f'hence, for {CORPUS_BAGS} recordings: overhead against a plain replay'
    two = f'two workers over two plain processes, for {CORPUS_BAGS} recordings'
    lost = f'{found["kills_lost_bags"]:.0f} lost, {found["kills_different_bags"]:.0f} different'
    each_ms = found['scheduler_and_client_cpu_ms_a_task']
    different = f'{found["different_bags"]:.0f} of {compared:.0f}'
    return [
        ['work on an hour of recording', f'{found["core_s_for_an_hour"]:.0f} core s', ''],
        ['a thousand hours, extrapolated', whole, ''],
        ['a recording of a minute: Dask with one worker over a plain process', f'{ratio:.3f} ± {error:.3f}', ''],
        [beside, f'{batch_s:.1f} and {replay_s:.1f} s', ''],
        [overhead, f'{found["overhead_percent_200_bags"]:.1f} %', 'under 3 %'],
        [two, f'{found["two_workers_over_two_processes"]:.3f}', '0.95'],
        ['scheduler and client, for each recording', f'{each_ms:.1f} ms', ''],
        ['results that differ from those of the plain process', different, '0'],
        [kills, lost, '0 lost'],
        [simulation, f'{found["simulated_efficiency"]:.3f} of the ideal', '0.9'],
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    add_sections(parser, SECTIONS)
    parser.add_argument(
        '--bags', type=int, default=12, help='turns, in each of which each process replays a minute'
    )
    parser.add_argument(
        '--task-seconds', type=float, nargs='+', help='times of work to simulate with (default: those measured)'
    )


def measure(args: argparse.Namespace, report: Report) -> None:
    bags, seconds = (4, 4.0) if args.quick else (args.bags, 60.0)
    sections = args.only or SECTIONS
    results: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        if 'overhead' in sections:
            results |= measure_overhead(root, bags, seconds)
        if 'kills' in sections:
            results |= measure_kills(root, bags, seconds)
    if 'simulation' in sections:
        times = args.task_seconds or [results.get('one_plain_cpu_s_each_bag', 5.0)]
        workers, tasks = (32, 320) if args.quick else (WORKERS, TASKS)
        results |= simulate(workers, tasks, [min(t, 1.0) for t in times] if args.quick else times)
    report.quantities(results, TARGETS, page='', digits=4)
    if set(sections) == set(SECTIONS):
        report.keep('corpora.cost', ['quantity', 'measured', 'target'], describe(results))


def main() -> None:
    if sys.argv[1:2] == ['--replay']:
        replay_on_request()
    elif sys.argv[1:2] == ['--serve']:
        serve(sys.argv[2], int(sys.argv[3]))
    else:
        run(__doc__, 'Corpora', measure, add_options, one_core=False)


if __name__ == '__main__':
    main()
