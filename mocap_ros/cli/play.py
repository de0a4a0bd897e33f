# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros play`: publish recorded keypoints, or send the motion of a result, at the recorded pace."""

from __future__ import annotations

import argparse
from contextlib import suppress

from mocap_ros.cli.inputs import TOPIC_OPTIONS
from mocap_ros.cli.options import Options, option
from mocap_ros.cli.terminal import print_note, print_result, show_progress
from mocap_ros.errors import ConfigError, MocapError, tell_installation
from mocap_ros.recordings.input_kind import BAG_FORMATS, InputKind, require_kind
from mocap_ros.recordings.load_results import load_result
from mocap_ros.recordings.playback import Playback
from mocap_ros.recordings.send_vmc import VmcMotion, VmcSender

CLOCK_HZ = 40.0  # Hz, the default rate of /clock, that of `ros2 bag play --clock`

DESCRIPTION = (
    'Publishes the keypoints of a bag, of any type that the node takes, or the frames of a sequence file, on the '
    'topic `keypoints`, and the CameraInfo beside them on `camera_info`. The messages keep their stamps and '
    'the QoS with which they were recorded. Needs ROS 2. With --vmc, it sends the motion of a result of '
    '`reconstruct` to programs for avatars instead, without ROS.'
)
OPTIONS: Options = {
    'input IN': 'bag (folder, .mcap, .db3 or .bag) or sequence file (.npz); for --vmc a result (.npz)',
    '--rate FACTOR': option('pace as a multiple of the recorded pace', default=1.0),
    **TOPIC_OPTIONS,
    '--to NAME': option(
        'topic to publish the keypoints on; the topics of ROS4HRI keep their names', default='keypoints'
    ),
    '--all': 'publish every topic of the bag under its own name (default: only the keypoints and CameraInfo)',
    '--loop': 'start again at the end, until interrupted (default: play once)',
    '--clock HZ': option(
        f'publish the recorded time on /clock at this rate, {CLOCK_HZ:g} Hz if HZ is omitted (default: '
        'publish no clock)',
        nargs='?',
        const=CLOCK_HZ,
    ),
    '--vmc ADDRESS': 'send the motion of a result as VMC (OSC over UDP) to HOST:PORT, such as 127.0.0.1:39539; '
    f'needs python-osc: {tell_installation("vmc")} (default: publish keypoints)',
    '--wait S': option('s, maximum time to wait for a subscriber', default=10.0),
}


def run(args: argparse.Namespace) -> int:
    """Play the input and print how many messages were published."""
    if args.vmc is not None:
        return _send_vmc(args)
    try:
        from mocap_ros.ros.player import Player, find_name_fault
    except ImportError as error:
        raise MocapError(
            f'play needs ROS 2, which this Python does not have ({error}); `make setup` installs it'
        ) from None
    if fault := find_name_fault(args.to):
        raise ConfigError(f'--to {args.to!r}: {fault}')
    kinds = [InputKind.BAG, InputKind.SEQUENCE]
    kind = require_kind(args.input, kinds, f'{BAG_FORMATS} or a sequence file (.npz)')
    if args.topic and kind is InputKind.SEQUENCE:
        raise MocapError(f'--topic: a sequence file has no topics; --to {args.topic} publishes on this one')
    playback = Playback(args.input, args.topic, args.to, args.all, args.camera_info)
    player = Player(playback, args.rate, args.wait, args.clock or 0.0, loop=args.loop)
    with suppress(*([KeyboardInterrupt] if args.loop else [])):  # an interrupt is the only way to end a loop
        player.play(
            lambda messages, total: show_progress(messages, 'play', total),
            lambda line: print_result(f'{args.input}: {line}', flush=True),
        )
    for reason in player.skipped_topics:
        print_note(f'not played: {reason}')
    print_result(
        f'{args.input}: {player.published_count} messages published on {", ".join(player.published_topics)}'
    )
    return 0


def _send_vmc(args: argparse.Namespace) -> int:
    require_kind(args.input, [InputKind.RESULT], 'a result of reconstruct (.npz), for --vmc')
    for name in ('topic', 'camera_info', 'all', 'clock'):
        if getattr(args, name):
            raise ConfigError(f'--{name.replace("_", "-")} does not apply to --vmc')
    sender, motion, sent = VmcSender(args.vmc), VmcMotion.convert(load_result(args.input)), 0
    with suppress(*([KeyboardInterrupt] if args.loop else [])):
        while not sent or args.loop:
            for _ in show_progress(motion.play(sender, args.rate), 'play', len(motion.poses)):
                sent += 1
    print_result(f'{args.input}: {sent} frames sent to {args.vmc}')
    return 0
