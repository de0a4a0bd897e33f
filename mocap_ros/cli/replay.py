# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros replay`: run the live pipeline over bags, as fast as the machine allows."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import remove_partial
from mocap_ros.cli.inputs import LENS_OPTIONS, TOPIC_OPTIONS, read_lens_parameters
from mocap_ros.cli.options import (
    CONFIG_OPTIONS,
    STRICT_OPTIONS,
    Options,
    derive_output_stem,
    load_config_file,
    option,
    parse_changes,
)
from mocap_ros.cli.terminal import finish, interrupt_between_items, print_note, print_result, show_progress
from mocap_ros.errors import InputError, MocapError, RecordingError, make_printable_line
from mocap_ros.recordings.input_kind import BAG_FORMATS, InputKind, require_kind
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.runtime.skeleton_merging import holds_merged_run, replay_merging

DESCRIPTION = (
    'Runs the keypoints of a bag through the pipeline of the live node, as fast as the machine allows, and writes '
    'a new bag with the keypoints and the outputs. A bag that the node recorded is replayed with the parameters '
    'of the recording and gives the same skeletons: --set changes single ones of them, and --config replaces all. '
    'One that mocap_merge recorded is merged again. '
    'A new bag is called NAME.partial until it is complete.'
)
OPTIONS: Options = {
    'bags BAG': option('bag to replay: folder, .mcap, .db3, or .bag of ROS 1', nargs='+'),
    '-o --output OUT': option(
        'folder of the new bag, which must not exist; for several bags, the folder for all new bags', required=True
    ),
    **TOPIC_OPTIONS,
    **LENS_OPTIONS,
    '--resume': 'skip the bags that have been replayed, and start interrupted replays again (default: fail if a '
    'new bag exists)',
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Replay the bags, and print the number of messages by what became of them."""
    changes = parse_changes(args) | read_lens_parameters(args)
    options = ReplayOptions(load_config_file(args), args.topic, args.camera_info, changes=changes)
    jobs = _choose_outputs(args.bags, args.output)
    for bag, out in list(jobs.items()):
        if args.resume and out.exists():
            print_result(f'{out}: already replayed')
            del jobs[bag]
        elif args.resume:  # an interrupted replay starts again, since the same bag gives the same results
            remove_partial(out)
        elif out.exists():
            raise RecordingError(f'{out}: exists already; choose another -o, or --resume')
    has_failed = False
    for bag, out in jobs.items():
        try:
            has_failed |= bool(_replay_one(bag, out, options, is_strict=args.strict))
        except MocapError as error:  # noqa: PERF203 # a failure does not stop the others
            if len(jobs) == 1:
                raise
            print_note(error)
            has_failed = True
    return int(has_failed)


def _choose_outputs(bags: list[Path], output: Path) -> dict[Path, Path]:
    if len(bags) == 1:
        return {bags[0]: output}
    names = [derive_output_stem(bag) for bag in bags]
    if len(set(names)) < len(names):
        repeated = max(names, key=names.count)
        raise InputError(
            f'two bags are called {repeated}, so their new bags would have one name; replay them apart'
        )
    return {bag: output / name for bag, name in zip(bags, names, strict=True)}


def _replay_one(path: Path, out: Path, options: ReplayOptions, *, is_strict: bool) -> int:
    """Replay a bag; print counters and summary on stdout, faults and losses on stderr; return the exit code."""
    start = time.monotonic()
    require_kind(path, [InputKind.BAG], BAG_FORMATS)
    with Bag(path) as bag, interrupt_between_items() as stop_at_interrupt:

        def show(messages: Iterable[BagMessage], total: int) -> Iterable[BagMessage]:
            return show_progress(stop_at_interrupt(messages), path.name, total)

        if holds_merged_run(bag):
            if options != ReplayOptions():
                raise InputError(f'{path}: recorded by mocap_merge; it is replayed without options')
            print_result(f'{out}: {replay_merging(bag, out, show)} messages of skeletons merged')
            return 0
        result = replay(bag, out, options, show)
    for traceback in result.tracebacks:
        print(*map(make_printable_line, traceback.splitlines()), sep='\n', file=sys.stderr)
    if result.first_rejection:
        print_note(f'first message that was not accepted: {result.first_rejection}')
    for note in result.notes:
        print_note(note)
    if result.unrecorded_inputs:
        print_note(
            f'{path}: {result.unrecorded_inputs} inputs are missing because the disk was too slow for the '
            'recorder; the results after the first missing input differ from the live ones'
        )
    counts = result.counters
    seconds = time.monotonic() - start
    print_result(
        f'{out}: {counts.accepted} messages of people accepted, {counts.dropped.total()} dropped, '
        f'{counts.invalid} invalid, {seconds:.1f} s'
    )
    return finish(path, result.summary, result.summary.is_wrong, is_strict=is_strict)
