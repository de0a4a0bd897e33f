"""`mocap-ros replay`: the live pipeline over a bag, as fast as it goes."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import add_config_options, config_from, progress
from mocap_ros.errors import RecordingError
from mocap_ros.io.bags import Bag
from mocap_ros.replay import replay


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'replay',
        help='the live pipeline over a bag',
        description='Runs the keypoints of a bag through the pipeline of the live node, as fast as it goes, '
        'and writes a bag with them and the outputs. A bag that the node recorded is replayed with the '
        'parameters it was recorded with, unless --config or --set is given, and gives the same skeletons.',
    )
    p.add_argument('bag', type=Path, metavar='BAG', help='folder, .mcap or .db3')
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        required=True,
        metavar='OUTBAG',
        help='folder of the new bag, which must not exist',
    )
    p.add_argument('--topic', metavar='NAME', help='of the keypoints (default: the only one there is)')
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay, and say what became of the messages."""
    config = config_from(args) if args.config is not None or args.set else None
    if args.output.exists():
        raise RecordingError(f'{args.output}: exists already; choose another -o')
    start = time.monotonic()
    with Bag(args.bag) as bag:
        result = replay(
            bag,
            args.output,
            config,
            args.topic,
            lambda messages, total: progress(messages, 'replay', total),
        )
    seconds = time.monotonic() - start
    counts = result.counters
    dropped = sum(counts.dropped.values())
    if result.first_reason:
        print(f'first message not accepted: {result.first_reason}', file=sys.stderr)
    print(
        f'{args.output}: {counts.accepted} frames accepted, {dropped} dropped, {counts.invalid} invalid, '
        f'{seconds:.1f} s'
    )
    return 0
