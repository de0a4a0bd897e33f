"""Batch runs: what Dask adds to the work, how two workers share it, killed workers, and 256 workers by simulation.

Times are CPU seconds with one BLAS thread, so that they mean the same on a machine that does other work. Plain
replays and batch runs take turns. The bags are those of the demo recording, in a circle.

The simulation takes as many tasks as there are recordings, each of which sleeps for as long as a recording was
worked on, in random order of the measured times. Its scheduler and client are those of a real run; its workers are
Dask's, many in a process. Nothing else is simulated.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import dask
import numpy as np
import recording
from distributed import Client, SpecCluster, as_completed
from distributed.scheduler import Scheduler
from report import Report, add_sections, run

from mocap_ros.bags.reader import Bag
from mocap_ros.batch.cluster import LOCAL_SETTINGS, connect, run_jobs
from mocap_ros.batch.job import Job, Outcome, Settings, Status
from mocap_ros.batch.recordings import Work, find_recordings

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


def measure_cpu(action: Callable[[], object]) -> tuple[float, float]:
    """Return the CPU seconds of an action, with those of the processes that it starts, and the s that it took."""

    def total() -> float:
        usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(u.ru_utime + u.ru_stime for u in usages)

    start, used = time.monotonic(), total()
    action()
    return total() - used, time.monotonic() - start


def run_command(*arguments: object) -> None:
    """Run `mocap-ros` in a process."""
    command = [sys.executable, '-m', 'mocap_ros.cli.main', *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run_side_by_side(commands: Sequence[Sequence[object]]) -> None:
    threads = [threading.Thread(target=run_command, args=command) for command in commands]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def measure_overhead(root: Path, bags: int, seconds: float) -> dict[str, float]:
    """Compare batch runs with plain replays of the same bags: one worker with one process, two with two.

    What a run costs beside its bags, such as the start of its processes, is told from what a bag costs by runs of
    two sizes: cost = fixed + bags x each.
    """
    paths = write_bags(root / 'in', bags, seconds)
    few = root / 'few.txt'
    few.write_text('\n'.join(map(str, paths[: bags // 4])))
    half = bags // 2
    found: dict[str, tuple[float, float]] = {}
    for name, action in {
        'plain': lambda: run_command('replay', *paths, '-o', root / 'plain'),
        'batch': lambda: run_command('batch', root / 'in', '-o', root / 'batch', '--workers', 1),
        'plain_few': lambda: run_command('replay', *paths[: bags // 4], '-o', root / 'plain_few'),
        'batch_few': lambda: run_command('batch', few, '-o', root / 'batch_few', '--workers', 1),
        'two_processes': lambda: run_side_by_side(
            [
                ('replay', *paths[:half], '-o', root / 'plain_a'),
                ('replay', *paths[half:], '-o', root / 'plain_b'),
            ]
        ),
        'two_workers': lambda: run_command('batch', root / 'in', '-o', root / 'two', '--workers', 2),
    }.items():
        found[name] = measure_cpu(action)
        print(f'{name}: {found[name][0]:.1f} CPU s, {found[name][1]:.1f} s', file=sys.stderr, flush=True)
    different = sum(
        read_bag(root / 'plain' / path.name) != read_bag(root / out / 'results' / path.name)
        for path in paths
        for out in ('batch', 'two')
    )
    cpu = {name: used for name, (used, _) in found.items()}
    each = {n: (cpu[n] - cpu[f'{n}_few']) / (bags - bags // 4) for n in ('plain', 'batch')}
    fixed = {n: cpu[n] - bags * each[n] for n in ('plain', 'batch')}
    full = {n: fixed[n] + CORPUS_BAGS * each[n] for n in ('plain', 'batch')}
    # what two workers need beyond one is a process that starts
    two = {
        'processes': cpu['two_processes'] - bags * each['plain'],
        'workers': cpu['two_workers'] - bags * each['plain'],
    }
    full_two = {n: extra + CORPUS_BAGS * each['plain'] for n, extra in two.items()}
    return {
        'bags': bags,
        'seconds_of_a_bag': seconds,
        'plain_cpu_s_each_bag': each['plain'],
        'batch_cpu_s_each_bag': each['batch'],
        'plain_cpu_s_of_a_run': fixed['plain'],
        'batch_cpu_s_of_a_run': fixed['batch'],
        'overhead_percent_these_bags': 100 * (cpu['batch'] / cpu['plain'] - 1),
        'overhead_percent_200_bags': 100 * (full['batch'] / full['plain'] - 1),
        'two_workers_over_two_processes_these_bags': cpu['two_processes'] / cpu['two_workers'],
        'two_workers_over_two_processes': full_two['processes'] / full_two['workers'],
        'different_bags': different,
        'core_s_for_an_hour': each['batch'] * 3600 / seconds,
        'core_hours_for_1000_hours': each['batch'] * 3600 / seconds * 1000 / 3600,
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


def add_options(parser: argparse.ArgumentParser) -> None:
    add_sections(parser, SECTIONS)
    parser.add_argument('--bags', type=int, default=24, help='recordings of a minute that are replayed')
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
        times = args.task_seconds or [results.get('batch_cpu_s_each_bag', 5.0)]
        workers, tasks = (32, 320) if args.quick else (WORKERS, TASKS)
        results |= simulate(workers, tasks, [min(t, 1.0) for t in times] if args.quick else times)
    report.quantities(results, TARGETS, page='corpora.cost', digits=4)


def main() -> None:
    if sys.argv[1:2] == ['--serve']:
        serve(sys.argv[2], int(sys.argv[3]))
    else:
        run(__doc__, 'Corpora', measure, add_options, one_core=False)


if __name__ == '__main__':
    main()
