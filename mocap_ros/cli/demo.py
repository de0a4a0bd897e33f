# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros demo`: run the live node on the embedded recording over ROS 2 topics, and draw the result."""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.reader import Bag
from mocap_ros.cli.compile import compile_all
from mocap_ros.cli.lines import print_result
from mocap_ros.cli.options import parse_positive
from mocap_ros.config import Config
from mocap_ros.demo.scene import motion_name_at
from mocap_ros.errors import MocapError
from mocap_ros.evaluation import metrics
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.formats.text_files import replace_output
from mocap_ros.messages.cdr import decode, read_stamp
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.load_keypoints import load_sequence_file
from mocap_ros.runtime.load_scene import SceneOptions, load_scene, select_true_joints
from mocap_ros.skeleton import BODY26, skeleton_from_joints
from mocap_ros.viewing import plots
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene

Array = NDArray[np.float64]

# s, times of the poses in the picture: at least one of every motion of the recording, and one with a hidden arm
PICTURE_TIMES_S = (1.0, 2.6, 4.0, 5.2, 6.6, 7.9, 8.7, 10.6, 12.2)
DOMAINS = range(1, 102)  # ROS domains that are safe on every operating system, without 0, which is everybody's
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250  # network ports of the domains, as the specification of DDS sets them
START_TIMEOUT_S = 60.0  # s; far above what the node takes to start where everything is compiled
STOP_TIMEOUT_S = 10.0  # s; guards against a node that does not stop after an interrupt, which takes it under 1 s


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Starts the node in a process of its own, plays the embedded synthetic recording to it over '
        'ROS 2 topics at the recorded pace, records the outputs in a bag, and draws the result beside the input '
        'and the truth, as a picture and as a page that any browser opens.'
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        default=Path('demo_output'),
        metavar='FOLDER',
        help='folder for the bag, the picture and the page',
    )
    parser.add_argument(
        '--rate',
        type=parse_positive,
        default=1.0,
        metavar='FACTOR',
        help='pace as a multiple of the recorded pace',
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Play the recording to the node, and draw and print the result."""
    if find_spec('rclpy') is None:
        raise MocapError('the demo needs ROS 2 (rclpy): run `make demo`, or source a ROS 2 workspace first')
    recording = Path(str(files('mocap_ros') / 'demo' / 'demo.npz'))
    args.output.mkdir(parents=True, exist_ok=True)
    compile_all()  # the node does not listen while it compiles
    old_bags = set(_list_bags(args.output))
    with reserve_domain() as domain, _run_node(args.output, environment := {**os.environ, **domain}) as node:
        duration_s = _measure_duration(recording)
        print_result(f'Playing {recording.name} (synthetic, {duration_s:.0f} s) to the node ...', flush=True)
        player_command = [
            sys.executable,
            '-m',
            'mocap_ros.cli.main',
            'play',
            str(recording),
            '--rate',
            str(args.rate),
            '--wait',
            str(START_TIMEOUT_S),
        ]
        player = subprocess.run(player_command, env=environment, check=False)
        if node.poll() is not None:
            raise MocapError(f'the node stopped during the playback (exit code {node.returncode})')
        if player.returncode:
            raise MocapError('the player failed')
    new_bags = sorted(set(_list_bags(args.output)) - old_bags)
    if not new_bags:
        raise MocapError(f'{args.output}: the node recorded nothing')
    sequence = load_sequence_file(recording)
    joints, inferred = read_first_person(new_bags[-1], sequence)
    picture = args.output / 'demo.png'
    with replace_output(picture) as unfinished:
        _draw_picture(sequence, joints, inferred, unfinished)
    page = args.output / 'demo.html'
    with replace_output(page) as unfinished:
        unfinished.write_text(build_page(load_demo_scene(new_bags[-1], sequence)), encoding='utf-8')
    print_result(f'Bag:     {new_bags[-1]}')
    print_result(f'Picture: {picture}')
    print_result(f'Page:    {page} (opens in any browser)')
    _print_report(sequence, joints, new_bags[-1])
    return 0


def _list_bags(folder: Path) -> list[Path]:
    """Return the folders of the bags in a folder."""
    return [path.parent for path in folder.glob('*/metadata.yaml')]


def _measure_duration(recording: Path) -> float:
    """Return the duration of a sequence file in s."""
    return float(np.ptp(load_sequence_file(recording).timestamps))


@contextlib.contextmanager
def reserve_domain() -> Iterator[dict[str, str]]:
    """Keep a ROS domain to one user on this host, and yield the environment variables that choose it.

    A domain is taken as long as the TCP port with the number of its first UDP port is bound.

    Raises:
        MocapError: all domains are taken.
    """
    for domain in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        with socket.socket() as lock:
            try:
                lock.bind(('127.0.0.1', FIRST_PORT + PORTS_PER_DOMAIN * domain))
            except OSError:
                continue
            yield {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
            return
    raise MocapError('all ROS domains of this host are taken: wait until other demos have ended')


@contextlib.contextmanager
def _run_node(folder: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the live node as a process that records into the folder and is interrupted at the end."""
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', '--log-level', 'warn']
    command += ['-p', 'recorder.enabled:=true', '-p', f'recorder.folder:={folder.resolve()}']
    command += ['-p', 'qos_overrides./keypoints.subscription.reliability:=reliable']
    node = subprocess.Popen(command, env=environment)
    try:
        yield node
    finally:
        node.send_signal(signal.SIGINT)
        try:
            node.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            node.kill()
            node.wait()


def read_first_person(bag: Path, sequence: KeypointSequence) -> tuple[Array, NDArray[np.bool_]]:
    """Read the poses of the first person of every skeleton message in a bag.

    Args:
        bag: bag that the node recorded.
        sequence: sequence that was played to the node; its stamps assign the messages to its F frames.

    Returns:
        The joints (F, 26, 3) in m in the camera's optical frame, NaN in frames without a person, and whether each
        joint (F, 26) was inferred by the model because it was not seen.
    """
    frame_of = {stamp: frame for frame, stamp in enumerate(sequence.stamps_ns)}
    joints = np.full((len(sequence), len(BODY26.joints), 3), np.nan)
    inferred = np.ones(joints.shape[:2], bool)
    with Bag(bag) as reader:
        for message in reader.messages(reader.topics_of_type([SKELETONS])):
            array = decode(message.raw, SKELETONS)
            frame = frame_of.get(read_stamp(array.header.stamp))
            if frame is not None and array.people:
                person = array.people[0]
                joints[frame] = [(joint.x, joint.y, joint.z) for joint in person.joints]
                inferred[frame] = person.inferred
    return joints, inferred


def _draw_picture(sequence: KeypointSequence, joints: Array, inferred: NDArray[np.bool_], picture: Path) -> None:
    """Draw the input, the result and the truth at `PICTURE_TIMES_S`."""
    truth, true_joints = sequence.truth, None
    if truth is not None:
        true_joints = select_true_joints(truth.joints, truth.joint_names, BODY26)
    result = plots.PlotData(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=skeleton_from_joints(sequence.joint_names),
        joints=joints,
        seen=~inferred,
        skeleton=BODY26,
        truth=true_joints if true_joints is None else true_joints.astype(np.float64),
    )
    frames = np.searchsorted(sequence.timestamps, PICTURE_TIMES_S).tolist()
    labels = [f'{motion_name_at(t)}, {t:.1f} s' for t in PICTURE_TIMES_S]
    title = 'Live 3D reconstruction of the synthetic demo'
    plots.save_figure(plots.draw_poses_figure(result, frames, title, labels), picture)


def load_demo_scene(bag: Path, sequence: KeypointSequence) -> Scene:
    """Return what the page shows of a bag that the node recorded, with the truth of the sequence played to it."""
    scene, _ = load_scene(bag, SceneOptions(Config(), models={}))
    truth = np.full((len(scene.stamps_ns), len(scene.skeleton.joints), 3), np.nan, np.float32)
    if sequence.truth is not None:
        true_joints = select_true_joints(sequence.truth.joints, sequence.truth.joint_names, scene.skeleton)
        frame_of = {stamp: frame for frame, stamp in enumerate(scene.stamps_ns)}
        for frame, stamp in enumerate(sequence.stamps_ns):
            if true_joints is not None and stamp in frame_of:
                truth[frame_of[stamp]] = true_joints[frame]
    return replace(scene, title='Live 3D reconstruction of the synthetic demo', truth=truth)


def _print_report(sequence: KeypointSequence, joints: Array, bag: Path) -> None:
    """Print the error of the joints.

    Raises:
        MocapError: the bag has no skeletons.
    """
    if sequence.truth is None:
        return
    common = [BODY26.index(name) for name in sequence.truth.joint_names]
    errors = metrics.compute_errors(joints[:, common], sequence.truth.joints, fps=30.0)
    if 'mpjpe_mm' not in errors:
        raise MocapError(f'{bag}: contains no skeletons')
    empty_frames = int((~(sequence.keypoints[..., 2] > 0).any(axis=1)).sum())
    reconstructed_frames = errors['frames'] - errors['failed_frames']
    print_result(
        f'Mean 3D error: {errors["mpjpe_mm"]:.0f} mm (MPJPE, one scale for the sequence), '
        f'{errors["pa_mpjpe_mm"]:.0f} mm after one similarity transform per frame; '
        f'{reconstructed_frames:.0f} of {errors["frames"]:.0f} frames have a skeleton, '
        f'{empty_frames} frames had no keypoints'
    )
