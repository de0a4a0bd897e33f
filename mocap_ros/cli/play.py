"""`mocap-ros play`: publish recorded keypoints at their own pace."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import progress
from mocap_ros.errors import MocapError
from mocap_ros.io.samples import samples_of


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'play',
        help='publish recorded keypoints at their own pace',
        description='Publishes the Keypoints2DArray messages of a bag, or the frames of a sequence file, '
        'on the topic `keypoints`. Stamps stay as they are. Needs ROS 2.',
    )
    p.add_argument('input', type=Path, metavar='IN', help='bag (folder, .mcap, .db3) or .npz')
    p.add_argument('--rate', type=_positive, default=1.0, metavar='FACTOR', help='times the recorded pace')
    p.add_argument('--topic', metavar='NAME', help='of the keypoints in the bag (default: the only one there is)')
    p.add_argument('--to', default='keypoints', metavar='NAME', help='topic to publish on')
    p.add_argument('--wait', type=_positive, default=10.0, metavar='S', help='s to wait for a subscriber')
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Play the input and say how much it was."""
    try:
        from mocap_ros.ros.player import play
    except ImportError as error:
        raise MocapError(
            f'play needs ROS 2, and there is none for this Python ({error}); `make setup` gets it'
        ) from None
    samples = samples_of(args.input, args.topic, lambda found, total: progress(found, 'play', total))
    played = play(samples, args.to, args.rate, args.wait)
    print(f'{args.input}: {played} messages published on {args.to}')
    return 0


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f'{text} is not positive')
    return value
