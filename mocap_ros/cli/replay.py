"""`mocap-ros replay`: run the live pipeline over bags, as fast as the machine allows."""

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
from mocap_ros.bags.topics import find_people_topics
from mocap_ros.cli.options import add_config_options, load_config
from mocap_ros.cli.progress import show_progress
from mocap_ros.errors import InputError, MocapError, RecordingError
from mocap_ros.runtime.cpu_setup import configure_process
from mocap_ros.runtime.input_kind import BAG_FORMATS, InputKind, require_kind
from mocap_ros.runtime.replay import ProgressWrapper, ReplayOptions, ReplayResult, remove_partial, replay

PROGRESS_INTERVAL_S = 0.3  # s between updates of the progress bar; often enough to look continuous


class _Job(NamedTuple):
    """One bag to replay.

    Attributes:
        bag: the bag to replay.
        out: folder of the new bag.
        options: parameters and topics of the replay.
    """

    bag: Path
    out: Path
    options: ReplayOptions


class _FinishedReplay(NamedTuple):
    """The result of a replay and the time that the replay took, in s."""

    result: ReplayResult
    seconds: float


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Runs the keypoints of a bag through the pipeline of the live node, as fast as the machine '
        'allows, and writes a new bag with the keypoints and the outputs. A bag that the node recorded is '
        'replayed with the parameters of the recording, unless --config or --set is given, and gives the same '
        'skeletons. A new bag is called NAME.partial until it is complete.'
    )
    parser.add_argument(
        'bags', type=Path, nargs='+', metavar='BAG', help='bag to replay: folder, .mcap, .db3, or .bag of ROS 1'
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        required=True,
        metavar='OUT',
        help='folder of the new bag, which must not exist; for several bags, the folder for all new bags',
    )
    parser.add_argument(
        '--topic', metavar='NAME', help='topic of the keypoints (default: the only one in the bag)'
    )
    parser.add_argument(
        '--camera-info',
        metavar='NAME',
        help='topic of the CameraInfo (default: the topic camera_info beside the keypoints, if it exists)',
    )
    parser.add_argument(
        '--jobs',
        type=_parse_count,
        default=1,
        metavar='N',
        help='number of bags to replay at a time, each in a process',
    )
    parser.add_argument(
        '--resume',
        action='store_true',
        help='skip the bags that have been replayed, and start interrupted replays again (default: fail if a new '
        'bag exists)',
    )
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay the bags, and print the number of messages by verdict."""
    config = load_config(args) if args.config is not None or args.set else None
    options = ReplayOptions(config, args.topic, args.camera_info)
    jobs = [_Job(bag, out, options) for bag, out in _choose_outputs(args.bags, args.output)]
    if args.resume:
        jobs = [job for job in jobs if _prepare_to_resume(job)]
    for job in jobs:
        if job.out.exists():
            raise RecordingError(f'{job.out}: exists already; choose another -o, or --resume')
    if len(jobs) == 1:
        finished = _replay_one(jobs[0], lambda messages, total: show_progress(messages, 'replay', total))
        _print_summary(jobs[0], finished)
        return 0
    return _replay_in_processes(jobs, min(args.jobs, len(jobs)))


def _choose_outputs(bags: list[Path], output: Path) -> list[tuple[Path, Path]]:
    """Return every bag with the folder of its new bag.

    Raises:
        InputError: two new bags would have the same name.
    """
    if len(bags) == 1:
        return [(bags[0], output)]
    names = [bag.resolve().stem for bag in bags]
    if len(set(names)) < len(names):
        repeated = max(names, key=names.count)
        raise InputError(
            f'two bags are called {repeated}, so their new bags would have one name; replay them apart'
        )
    return [(bag, output / name) for bag, name in zip(bags, names, strict=True)]


def _prepare_to_resume(job: _Job) -> bool:
    """Return whether a bag still has to be replayed, and remove what an interrupted replay of it left.

    An interrupted replay starts again from the beginning, since the same bag gives the same results.
    """
    if job.out.exists():
        print(f'{job.out}: already replayed')
        return False
    remove_partial(job.out)
    return True


def _replay_one(job: _Job, progress: ProgressWrapper) -> _FinishedReplay:
    """Replay one bag in this process."""
    start = time.monotonic()
    require_kind(job.bag, [InputKind.BAG], BAG_FORMATS)
    with Bag(job.bag) as bag:
        result = replay(bag, job.out, job.options, progress)
    return _FinishedReplay(result, time.monotonic() - start)


def _print_summary(job: _Job, finished: _FinishedReplay) -> None:
    """Print the counters of a replay on stdout, and its faults and losses on stderr."""
    result, counts = finished.result, finished.result.counters
    for traceback in result.tracebacks:
        print(traceback, file=sys.stderr)
    if result.first_rejection:
        print(f'first message that was not accepted: {result.first_rejection}', file=sys.stderr)
    if result.unrecorded_inputs:
        print(
            f'{job.bag}: {result.unrecorded_inputs} inputs are missing because the disk was too slow for the '
            'recorder; the results after the first missing input differ from the live ones',
            file=sys.stderr,
        )
    print(
        f'{job.out}: {counts.accepted} frames accepted, {counts.dropped.total()} dropped, '
        f'{counts.invalid} invalid, {finished.seconds:.1f} s'
    )


def _replay_in_processes(jobs: list[_Job], processes: int) -> int:
    """Replay several bags at a time, and return the exit code; a failure does not stop the other replays."""
    context = get_context('spawn')
    message_count, must_stop = context.Value('q', 0), context.Value('b', 0)
    failures = 0
    with (
        ProcessPoolExecutor(max(processes, 1), context, _initialise_worker, (message_count, must_stop)) as pool,
        tqdm(desc='replay', total=_count_messages(jobs), disable=not sys.stderr.isatty(), leave=False) as bar,
    ):
        job_of_future = {pool.submit(_replay_in_worker, job): job for job in jobs}
        try:
            while job_of_future:
                finished, _ = wait(job_of_future, PROGRESS_INTERVAL_S, FIRST_COMPLETED)
                bar.update(message_count.value - bar.n)
                failures += sum(not _report_outcome(future, job_of_future.pop(future)) for future in finished)
        except KeyboardInterrupt:
            must_stop.value = 1
            pool.shutdown(cancel_futures=True)
            raise
    return 1 if failures else 0


def _report_outcome(future: Future[_FinishedReplay], job: _Job) -> bool:
    """Print the summary or the error of a replay, and return whether it succeeded."""
    error = future.exception()
    if error is None:
        _print_summary(job, future.result())
        return True
    message = str(error) if isinstance(error, MocapError) else f'{job.bag}: {error!r}'
    print(f'mocap-ros: {" ".join(message.split())}', file=sys.stderr)
    return False


def _count_messages(jobs: Iterable[_Job]) -> int:
    """Return the number of messages of keypoints in all bags; bags that cannot be read count as empty."""
    total = 0
    for job in jobs:
        with suppress(MocapError), Bag(job.bag) as bag:  # the replay of such a bag reports the error
            total += bag.count(find_people_topics(bag, job.options.topic))
    return total


# In a worker process: the shared number of processed messages, and the shared flag that stops all workers.
_worker_state: tuple[Any, Any]


def _initialise_worker(message_count: Any, must_stop: Any) -> None:
    """Set up a worker process, which leaves interrupts to its parent."""
    global _worker_state  # noqa: PLW0603
    configure_process()
    _worker_state = message_count, must_stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _replay_in_worker(job: _Job) -> _FinishedReplay:
    """Replay one bag in a worker process."""
    return _replay_one(job, _count_processed)


def _count_processed(messages: Iterable[BagMessage], _: int) -> Iterator[BagMessage]:
    """Yield the messages, count them for the progress bar, and stop when the parent process was interrupted."""
    message_count, must_stop = _worker_state
    for message in messages:
        if must_stop.value:
            raise KeyboardInterrupt
        with message_count.get_lock():
            message_count.value += 1
        yield message


def _parse_count(text: str) -> int:
    """Parse a positive integer for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f'{text!r} is not a positive whole number')
    return int(text)
