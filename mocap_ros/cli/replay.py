"""`mocap-ros replay`: the live pipeline over bags, as fast as it goes."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.topics import people_topics
from mocap_ros.cli.options import add_config_options, config_from, progress
from mocap_ros.errors import InputError, MocapError, RecordingError
from mocap_ros.runtime.cpu_setup import prepare
from mocap_ros.runtime.replay import ReplayOptions, ReplayResult, Watch, remove_partial, replay

REFRESH_SECONDS = 0.3


class _Job(NamedTuple):
    """A bag to replay, where to, and how."""

    bag: Path
    out: Path
    options: ReplayOptions


class _Done(NamedTuple):
    result: ReplayResult
    seconds: float


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'replay',
        help='the live pipeline over bags',
        description='Runs the keypoints of a bag through the pipeline of the live node, as fast as it goes, '
        'and writes a bag with them and the outputs. A bag that the node recorded is replayed with the '
        'parameters it was recorded with, unless --config or --set is given, and gives the same skeletons. '
        'Until it is complete, a new bag is called NAME.partial.',
    )
    p.add_argument('bags', type=Path, nargs='+', metavar='BAG', help='folder, .mcap, .db3, or .bag of ROS 1')
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        required=True,
        metavar='OUT',
        help='folder of the new bag, which must not exist; of several bags, folder to put the new ones into',
    )
    p.add_argument('--topic', metavar='NAME', help='of the keypoints (default: the only one there is)')
    p.add_argument(
        '--camera-info',
        metavar='NAME',
        help='topic of the CameraInfo (default: the one beside the keypoints, if any)',
    )
    p.add_argument('--jobs', type=_count, default=1, metavar='N', help='bags at a time, each in a process')
    p.add_argument(
        '--resume',
        action='store_true',
        help='skip bags that were replayed already; replay again those that were interrupted (default: refuse)',
    )
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay, and say what became of the messages."""
    config = config_from(args) if args.config is not None or args.set else None
    options = ReplayOptions(config, args.topic, args.camera_info)
    jobs = [_Job(bag, out, options) for bag, out in _outputs(args.bags, args.output)]
    if args.resume:
        jobs = [job for job in jobs if _is_left(job)]
    for job in jobs:
        if job.out.exists():
            raise RecordingError(f'{job.out}: exists already; choose another -o, or --resume')
    if len(jobs) == 1:
        _tell(jobs[0], _replayed(jobs[0], lambda messages, total: progress(messages, 'replay', total)))
        return 0
    return _all(jobs, min(args.jobs, len(jobs)))


def _outputs(bags: list[Path], output: Path) -> list[tuple[Path, Path]]:
    if len(bags) == 1:
        return [(bags[0], output)]
    names = [bag.resolve().stem for bag in bags]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise InputError(f'two bags are called {twice}: the new ones would have one name; replay them apart')
    return [(bag, output / name) for bag, name in zip(bags, names, strict=True)]


def _is_left(job: _Job) -> bool:
    """Whether a bag is still to be replayed, from the beginning: the same bag gives the same results."""
    if job.out.exists():
        print(f'{job.out}: done already')
        return False
    remove_partial(job.out)
    return True


def _replayed(job: _Job, watch: Watch) -> _Done:
    start = time.monotonic()
    with Bag(job.bag) as bag:
        result = replay(bag, job.out, job.options, watch)
    return _Done(result, time.monotonic() - start)


def _tell(job: _Job, done: _Done) -> None:
    result, counts = done.result, done.result.counters
    for fault in result.faults:
        print(fault, file=sys.stderr)
    if result.first_reason:
        print(f'first message not accepted: {result.first_reason}', file=sys.stderr)
    if result.lost:
        print(
            f'{job.bag}: {result.lost} inputs are missing in it, as its disk was too slow; behind them results '
            'differ from the live ones',
            file=sys.stderr,
        )
    print(
        f'{job.out}: {counts.accepted} frames accepted, {counts.dropped.total()} dropped, '
        f'{counts.invalid} invalid, {done.seconds:.1f} s'
    )


def _all(jobs: list[_Job], processes: int) -> int:
    """Several bags at a time; one that fails does not stop the others."""
    context = get_context('spawn')
    read, stop = context.Value('q', 0), context.Value('b', 0)
    failed = 0
    with (
        ProcessPoolExecutor(max(processes, 1), context, _begin_process, (read, stop)) as pool,
        tqdm(desc='replay', total=_total(jobs), disable=not sys.stderr.isatty(), leave=False) as bar,
    ):
        waiting = {pool.submit(_replayed_elsewhere, job): job for job in jobs}
        try:
            while waiting:
                done, _ = wait(waiting, REFRESH_SECONDS, FIRST_COMPLETED)
                bar.update(read.value - bar.n)
                failed += sum(not _succeeded(future, waiting.pop(future)) for future in done)
        except KeyboardInterrupt:
            stop.value = 1
            pool.shutdown(cancel_futures=True)
            raise
    return 1 if failed else 0


def _succeeded(future: Future[_Done], job: _Job) -> bool:
    error = future.exception()
    if error is None:
        _tell(job, future.result())
        return True
    said = str(error) if isinstance(error, MocapError) else f'{job.bag}: {error!r}'
    print(f'mocap-ros: {" ".join(said.split())}', file=sys.stderr)
    return False


def _total(jobs: Iterable[_Job]) -> int:
    total = 0
    for job in jobs:
        with suppress(MocapError), Bag(job.bag) as bag:  # what is wrong with it comes out later
            total += bag.count(people_topics(bag, job.options.topic))
    return total


_shared: tuple[Any, Any]


def _begin_process(read: Any, stop: Any) -> None:
    global _shared  # noqa: PLW0603
    prepare()
    _shared = read, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _replayed_elsewhere(job: _Job) -> _Done:
    return _replayed(job, _counted)


def _counted(messages: Iterable[BagMessage], _: int) -> Iterator[BagMessage]:
    read, stop = _shared
    for message in messages:
        if stop.value:
            raise KeyboardInterrupt
        with read.get_lock():
            read.value += 1
        yield message


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'{text} is not positive')
    return value
