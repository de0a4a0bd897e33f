# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros replay`: run the live pipeline over bags, as fast as the machine allows."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import remove_partial
from mocap_ros.cli.interrupts import interrupt_between_items
from mocap_ros.cli.keypoint_input import add_camera_info_option
from mocap_ros.cli.lines import print_remark, print_result
from mocap_ros.cli.options import add_config_options, load_config_file, name_bag, parse_changes
from mocap_ros.cli.progress import show_progress
from mocap_ros.errors import InputError, MocapError, RecordingError, make_printable_line
from mocap_ros.runtime.input_kind import BAG_FORMATS, InputKind, require_kind
from mocap_ros.runtime.replay import ReplayOptions, ReplayResult, replay


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


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Runs the keypoints of a bag through the pipeline of the live node, as fast as the machine '
        'allows, and writes a new bag with the keypoints and the outputs. A bag that the node recorded is '
        'replayed with the parameters of the recording and gives the same skeletons: --set changes single ones of '
        'them, and --config replaces all. A new bag is called NAME.partial until it is complete.'
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
    add_camera_info_option(parser)
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
    options = ReplayOptions(load_config_file(args), args.topic, args.camera_info, changes=parse_changes(args))
    jobs = [_Job(bag, out, options) for bag, out in _choose_outputs(args.bags, args.output)]
    if args.resume:
        jobs = [job for job in jobs if _prepare_to_resume(job)]
    for job in jobs:
        if job.out.exists():
            raise RecordingError(f'{job.out}: exists already; choose another -o, or --resume')
    if len(jobs) == 1:
        _replay_one(jobs[0])
        return 0
    return 0 if all([_try_replay(job) for job in jobs]) else 1  # noqa: C419 # a failure does not stop the others


def _choose_outputs(bags: list[Path], output: Path) -> list[tuple[Path, Path]]:
    """Return every bag with the folder of its new bag.

    Raises:
        InputError: two new bags would have the same name.
    """
    if len(bags) == 1:
        return [(bags[0], output)]
    names = [name_bag(bag) for bag in bags]
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
        print_result(f'{job.out}: already replayed')
        return False
    remove_partial(job.out)
    return True


def _try_replay(job: _Job) -> bool:
    """Replay one of several bags; print its error, if there is one, and return whether it succeeded."""
    try:
        _replay_one(job)
    except MocapError as error:
        print_remark(error)
        return False
    return True


def _replay_one(job: _Job) -> None:
    """Replay a bag, and print the summary."""
    start = time.monotonic()
    require_kind(job.bag, [InputKind.BAG], BAG_FORMATS)
    with Bag(job.bag) as bag, interrupt_between_items() as stop_at_interrupt:

        def show(messages: Iterable[BagMessage], total: int) -> Iterable[BagMessage]:
            return show_progress(stop_at_interrupt(messages), job.bag.name, total)

        result = replay(bag, job.out, job.options, show)
    _print_summary(job, result, time.monotonic() - start)


def _print_summary(job: _Job, result: ReplayResult, seconds: float) -> None:
    """Print the counters of a replay that took some seconds on stdout, and its faults and losses on stderr."""
    counts = result.counters
    for traceback in result.tracebacks:
        print(*map(make_printable_line, traceback.splitlines()), sep='\n', file=sys.stderr)
    if result.first_rejection:
        line = f'first message that was not accepted: {result.first_rejection}'
        print_remark(line)
    for remark in result.remarks:
        print_remark(remark)
    if result.unrecorded_inputs:
        print_remark(
            f'{job.bag}: {result.unrecorded_inputs} inputs are missing because the disk was too slow for the '
            'recorder; the results after the first missing input differ from the live ones'
        )
    print_result(
        f'{job.out}: {counts.accepted} messages of people accepted, {counts.dropped.total()} dropped, '
        f'{counts.invalid} invalid, {seconds:.1f} s'
    )
