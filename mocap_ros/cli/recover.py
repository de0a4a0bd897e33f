"""`mocap-ros recover`: a whole bag out of one that was cut off or damaged."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

from mocap_ros.bags.recovery import recover


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'recover',
        help='a whole bag out of one that was cut off or damaged',
        description='Writes a new bag with every message that can still be read of a bag whose recorder was '
        'killed, whose disk was full, or that was damaged, and says what could not be read. Any rosbag2 bag, '
        'MCAP or SQLite3, whatever recorded it. The damaged bag stays as it is.',
    )
    p.add_argument('bag', type=Path, metavar='BAG', help='folder, .mcap or .db3')
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUTBAG',
        help='folder of the new bag, which must not exist (default: BAG_recovered)',
    )
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Recover, and say what was had and what was not."""
    out = args.output or args.bag.with_name(f'{args.bag.resolve().stem}_recovered')
    with tqdm(desc='recover', unit='B', unit_scale=True, disable=not sys.stderr.isatty(), leave=False) as bar:

        def watch(done: int, size: int) -> None:
            bar.total = size
            bar.update(done - bar.n)

        found = recover(args.bag, out, watch)
    for loss in found.losses:
        print(f'not recovered: {loss}', file=sys.stderr)
    print(f'{out}: {found.messages.total()} messages on {len(found.messages)} topics')
    return 0
