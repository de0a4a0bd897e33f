# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros recover`: write a readable bag from one that was cut off or damaged."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from mocap_ros.bags.recovery import list_recoverable_files, recover
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.cli.options import Options, derive_output_stem
from mocap_ros.cli.terminal import ShareBar, print_note, print_result
from mocap_ros.recordings.input_kind import InputKind, require_kind

PARTLY_RECOVERED = 3  # exit code: there is a new bag, which lacks something

DESCRIPTION = (
    'Writes a new bag with every message that can still be read from a damaged bag, and lists what could not be '
    'read. A bag is damaged if, for example, its recorder was killed or its disk was full. The command reads '
    'rosbag2 bags of any recorder, in MCAP or SQLite3, and does not change the damaged bag. It ends with 0 if all '
    f'could be read, {PARTLY_RECOVERED} if something was lost, and 1 if nothing could be recovered.'
)
OPTIONS: Options = {
    'bag BAG': 'damaged bag: folder, .mcap or .db3',
    '-o --output OUTBAG': 'folder of the new bag, which must not exist (default: BAG_recovered, beside the bag)',
}


def run(args: argparse.Namespace) -> int:
    """Recover a bag, and print what was recovered and what was not."""
    if not (args.bag.exists() and list_recoverable_files(args.bag)):
        require_kind(args.bag, [InputKind.BAG], 'a bag of ROS 2 (folder, .mcap or .db3)')
    out = args.output or _choose_output(args.bag)
    with ShareBar('recover') as report:
        found = recover(args.bag, out, lambda done, size: report(done / max(size, 1)))
    for loss in found.losses:
        print_note(loss)
    print_result(f'{out}: {found.messages.total()} messages on {len(found.messages)} topics')
    return PARTLY_RECOVERED if found.losses else 0


def _choose_output(bag: Path) -> Path:
    """Return the default path of the new bag: beside the damaged bag, also where only a file of it is given."""
    folder = bag.absolute().parent
    is_in_bag = (folder / METADATA).is_file() or re.match(rf'{re.escape(folder.name)}_\d+\.', bag.name)
    source = bag.parent if is_in_bag and not bag.is_dir() else bag
    if source.name in ('', '..'):  # the present folder is `.`
        source = source.resolve()
    return source.with_name(f'{derive_output_stem(bag)}_recovered')
