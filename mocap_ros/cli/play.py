"""`mocap-ros play`: publish recorded keypoints at their own pace."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import positive, progress
from mocap_ros.errors import MocapError
from mocap_ros.runtime.playback import Playback

CLOCK_HZ = 40.0


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'play',
        help='publish recorded keypoints at their own pace',
        description='Publishes the Keypoints2DArray messages of a bag, or the frames of a sequence file, '
        'on the topic `keypoints`, and the CameraInfo of a bag on `camera_info`, with the QoS they were recorded '
        'with. Stamps stay as they are. Needs ROS 2.',
    )
    p.add_argument('input', type=Path, metavar='IN', help='bag (folder, .mcap, .db3, .bag) or .npz')
    p.add_argument('--rate', type=positive, default=1.0, metavar='FACTOR', help='times the recorded pace')
    p.add_argument('--topic', metavar='NAME', help='of the keypoints in the bag (default: the only one there is)')
    p.add_argument('--to', default='keypoints', metavar='NAME', help='topic to publish the keypoints on')
    p.add_argument(
        '--all',
        action='store_true',
        help='publish every topic of the bag, each on its own name (default: keypoints and CameraInfo)',
    )
    p.add_argument('--loop', action='store_true', help='begin again at the end, until interrupted (default: once)')
    p.add_argument(
        '--clock',
        type=positive,
        nargs='?',
        const=CLOCK_HZ,
        metavar='HZ',
        help=f'publish recorded time on /clock at this rate, {CLOCK_HZ:g} where HZ is not given (default: not)',
    )
    p.add_argument('--wait', type=positive, default=10.0, metavar='S', help='s to wait for a subscriber')
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Play the input and say how much it was."""
    try:
        from mocap_ros.ros.player import Pace, Player
    except ImportError as error:
        raise MocapError(
            f'play needs ROS 2, and there is none for this Python ({error}); `make setup` gets it'
        ) from None
    playback = Playback(args.input, args.topic, args.to, args.all)
    player = Player(playback, Pace(args.rate, args.wait, args.loop, args.clock or 0.0))
    with suppress(*([KeyboardInterrupt] if args.loop else [])):  # the only way to end a loop
        player.play(lambda messages, total: progress(messages, 'play', total))
    for reason in player.skipped:
        print(f'not played: {reason}', file=sys.stderr)
    print(f'{args.input}: {player.played} messages published on {", ".join(t.name for t in playback.topics)}')
    return 0
