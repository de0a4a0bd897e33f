"""`mocap-ros demo`: the live node on the embedded recording, over real topics, and a picture of what came out."""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.reader import Bag
from mocap_ros.cli.options import positive
from mocap_ros.demo.scene import act_at
from mocap_ros.errors import MocapError
from mocap_ros.evaluation import metrics
from mocap_ros.formats.sequence_file import Sequence, load_sequence
from mocap_ros.messages.cdr import NS, decode
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.skeleton import CMU15, skeleton_of
from mocap_ros.viewing import plots

Array = NDArray[np.float64]

SHOWN_SECONDS = (1.0, 2.6, 4.0, 5.2, 6.6, 7.9, 8.7, 10.6, 12.2)
STOP_SECONDS = 10.0


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'demo',
        help='run the live node on the embedded recording',
        description='Starts the node as its own process, plays the embedded synthetic recording to it over '
        'ROS 2 topics at its own pace, records, and draws the result beside the input and the truth.',
    )
    p.add_argument(
        '-o', '--output', type=Path, default=Path('demo_output'), metavar='FOLDER', help='for bag and picture'
    )
    p.add_argument('--rate', type=positive, default=1.0, metavar='FACTOR', help='times the recorded pace')
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Play, record, score and draw."""
    if find_spec('rclpy') is None:
        raise MocapError('the demo needs ROS 2 (rclpy): run it with `make demo`, or source a ROS 2')
    recording = Path(str(files('mocap_ros') / 'demo' / 'demo.npz'))
    args.output.mkdir(parents=True, exist_ok=True)
    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(random.SystemRandom().randrange(1, 100)),
    }
    before = set(_bags(args.output))
    with _node(args.output, environment) as node:
        print(f'Playing {recording.name} (synthetic, {_seconds(recording):.0f} s) to the node ...', flush=True)
        play = [sys.executable, '-m', 'mocap_ros.cli.main', 'play', str(recording), '--rate', str(args.rate)]
        if subprocess.run(play, env=environment, check=False).returncode:
            raise MocapError('the player failed')
        if node.poll() is not None:
            raise MocapError(f'the node ended by itself (exit {node.returncode})')
    new = sorted(set(_bags(args.output)) - before)
    if not new:
        raise MocapError(f'{args.output}: the node recorded nothing')
    sequence = load_sequence(recording)
    joints, inferred = read_first_person(new[-1], sequence)
    picture = args.output / 'demo.png'
    _draw(sequence, joints, inferred, picture)
    _report(sequence, joints, new[-1], picture)
    return 0


def _bags(folder: Path) -> list[Path]:
    return [p.parent for p in folder.glob('*/metadata.yaml')]


def _seconds(recording: Path) -> float:
    return float(np.ptp(load_sequence(recording).timestamps))


@contextlib.contextmanager
def _node(folder: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """The live node as a process of its own, recording; stopped by SIGINT as a user would."""
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', '--log-level', 'warn']
    command += ['-p', 'recorder.enabled:=true', '-p', f'recorder.folder:={folder.resolve()}']
    command += ['-p', 'qos_overrides./keypoints.subscription.reliability:=reliable']
    node = subprocess.Popen(command, env=environment)
    try:
        yield node
    finally:
        node.send_signal(signal.SIGINT)
        try:
            node.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            node.kill()
            node.wait()


def read_first_person(bag: Path, sequence: Sequence) -> tuple[Array, NDArray[np.bool_]]:
    """(F, 15, 3) m joints of the first person at each frame of the sequence, NaN where nobody was there."""
    frame_of = {stamp: frame for frame, stamp in enumerate(sequence.stamps_ns)}
    joints = np.full((len(sequence), len(CMU15.joints), 3), np.nan)
    inferred = np.ones(joints.shape[:2], bool)
    with Bag(bag) as opened:
        for message in opened.messages(opened.of_type([SKELETONS])):
            array = decode(message.raw, SKELETONS)
            frame = frame_of.get(array.header.stamp.sec * NS + array.header.stamp.nanosec)
            if frame is not None and array.people:
                person = array.people[0]
                joints[frame] = [(p.x, p.y, p.z) for p in person.joints]
                inferred[frame] = person.inferred
    return joints, inferred


def _draw(sequence: Sequence, joints: Array, inferred: NDArray[np.bool_], picture: Path) -> None:
    truth = sequence.truth
    result = plots.Result(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=skeleton_of(sequence.joint_names),
        joints=joints,
        seen=~inferred,
        skeleton=CMU15,
        truth=None if truth is None else truth.joints,
    )
    frames = np.searchsorted(sequence.timestamps, SHOWN_SECONDS).tolist()
    labels = [f'{act_at(t)}, {t:.1f} s' for t in SHOWN_SECONDS]
    title = 'Live 3D reconstruction of the synthetic demo'
    plots.save_figure(plots.poses_figure(result, frames, title, labels), picture)


def _report(sequence: Sequence, joints: Array, bag: Path, picture: Path) -> None:
    print(f'Bag:     {bag}')
    print(f'Picture: {picture}')
    if sequence.truth is None:
        return
    errors = metrics.errors(joints, sequence.truth.joints, fps=30.0)
    if 'mpjpe_mm' not in errors:
        raise MocapError(f'{bag}: no skeletons in it')
    empty = int((~(sequence.keypoints[..., 2] > 0).any(axis=1)).sum())
    done = errors['frames'] - errors['failed_frames']
    print(
        f'Mean 3D error: {errors["mpjpe_mm"]:.0f} mm (MPJPE, one scale for the sequence), '
        f'{errors["pa_mpjpe_mm"]:.0f} mm after a similarity a frame; '
        f'{done:.0f} of {errors["frames"]:.0f} frames with a skeleton, {empty} frames had no keypoints'
    )
