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

from mocap_ros.cli.options import Options, option
from mocap_ros.cli.terminal import print_result, show_progress
from mocap_ros.demo.scene import motion_name_at
from mocap_ros.errors import MocapError
from mocap_ros.formats.text_files import replace_output
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.recordings.build_scene import build_scene, select_true_joints
from mocap_ros.recordings.load_keypoints import load_sequence_file
from mocap_ros.recordings.load_results import load_recording
from mocap_ros.recordings.playback import Playback
from mocap_ros.skeleton import CMU15, estimate_stature
from mocap_ros.verdict import accuracy
from mocap_ros.viewing import plots
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene

TITLE = 'Live 3D reconstruction of the synthetic demo'
# s, times of the poses in the picture: at least one of every motion of the recording, and one with a hidden arm
PICTURE_TIMES_S = (1.0, 2.6, 4.0, 5.2, 6.6, 7.9, 8.7, 10.6, 12.2)
DOMAINS = range(1, 102)  # ROS domains that are safe on every operating system, without 0, which is everybody's
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250  # network ports of the domains, as the specification of DDS sets them
START_TIMEOUT_S = 60.0  # s; far above what the node takes to start
STOP_TIMEOUT_S = 10.0  # s; guards against a node that does not stop after an interrupt, which takes it under 1 s

DESCRIPTION = (
    'Starts the node in a process of its own, plays the embedded synthetic recording to it over ROS 2 topics at '
    'the recorded pace, records the outputs in a bag, and draws the result beside the input and the truth, as a '
    'picture and as a page that any browser opens. The node is told how tall the person is.'
)
OPTIONS: Options = {
    '-o --output FOLDER': option('folder for the bag, the picture and the page', default=Path('demo_output')),
    '--rate FACTOR': option('pace as a multiple of the recorded pace', default=1.0),
}


def run(args: argparse.Namespace) -> int:
    """Play the recording to the node, and draw and print the result."""
    if find_spec('rclpy') is None:
        raise MocapError('the demo needs ROS 2 (rclpy): run `make demo`, or source a ROS 2 workspace first')
    from mocap_ros.ros.player import Player

    recording = Path(str(files('mocap_ros') / 'demo' / 'demo.npz'))
    sequence = load_sequence_file(recording)
    args.output.mkdir(parents=True, exist_ok=True)
    old_bags = set(args.output.glob('*/metadata.yaml'))
    duration_s = np.ptp(sequence.timestamps) / args.rate
    print_result(
        f'Step 1 of 3: start the node (3 s), play {recording.name} to it ({duration_s:.0f} s)', flush=True
    )
    height = 0.0 if sequence.truth is None else estimate_stature(sequence.truth.joints, CMU15)
    with reserve_domain() as domain, _use_environment(domain), _run_node(args.output, height) as node:
        player = Player(Playback(recording), args.rate, START_TIMEOUT_S)
        player.play(lambda messages, total: show_progress(messages, 'play', total))
        if node.poll() is not None:
            raise MocapError(f'the node stopped during the playback (exit code {node.returncode})')
    print_result('Step 2 of 3: read what the node has recorded (1 s)', flush=True)
    new_bags = sorted(path.parent for path in set(args.output.glob('*/metadata.yaml')) - old_bags)
    if not new_bags:
        raise MocapError(f'{args.output}: the node recorded nothing')
    scene = load_demo_scene(new_bags[-1], sequence)
    print_result('Step 3 of 3: draw it (3 s)', flush=True)
    picture, page = args.output / 'demo.png', args.output / 'demo.html'
    frames = np.searchsorted(scene.times, PICTURE_TIMES_S).clip(max=len(scene.times) - 1).tolist()
    labels = [f'{motion_name_at(t)}, {t:.1f} s' for t in PICTURE_TIMES_S]
    with replace_output(picture) as unfinished:
        plots.save_figure(plots.draw_poses_figure(scene.to_plot_data(), frames, TITLE, labels), unfinished)
    with replace_output(page) as unfinished:
        unfinished.write_text(build_page(scene), encoding='utf-8')
    print_result(f'Bag:     {new_bags[-1]}')
    print_result(f'Picture: {picture}')
    print_result(f'Page:    {page} (opens in any browser)')
    if sequence.truth is not None:
        print_result(describe_errors(scene, sequence, sequence.truth))
    return 0


@contextlib.contextmanager
def reserve_domain() -> Iterator[dict[str, str]]:
    """Keep a ROS domain to one user on this host, and yield the environment variables that choose it.

    A domain is taken as long as the TCP port with the number of its first UDP port is bound.
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
def _use_environment(variables: dict[str, str]) -> Iterator[None]:
    before = {**os.environ}
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextlib.contextmanager
def _run_node(folder: Path, height_m: float) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', '--log-level', 'warn']
    command += ['-p', 'recorder.enabled:=true', '-p', f'recorder.folder:={folder.resolve()}']
    command += ['-p', f'tracker.body_height:={height_m:.2f}'] if height_m else []
    command += ['-p', 'qos_overrides./keypoints.subscription.reliability:=reliable']
    node = subprocess.Popen(command, start_new_session=True)  # an interrupt of this process does not reach it
    try:
        yield node
    finally:
        node.send_signal(signal.SIGINT)
        try:
            node.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            node.kill()
            node.wait()


def load_demo_scene(bag: Path, sequence: KeypointSequence) -> Scene:
    """Return what is drawn of a bag that the node recorded, with the truth of the sequence played to it."""
    scene = build_scene(TITLE, load_recording(bag))
    if sequence.truth is None:
        return scene
    truth = select_true_joints(sequence.truth.joints, sequence.truth.joint_names, scene.skeleton)
    frames = np.searchsorted(sequence.stamps_ns, scene.stamps_ns)
    return replace(scene, truth=None if truth is None else truth[frames])


def describe_errors(scene: Scene, sequence: KeypointSequence, truth: GroundTruth) -> str:
    """Return a line about the errors of the joints in the frames of the sequence."""
    joints = np.full((len(sequence), len(scene.skeleton.joints), 3), np.nan)
    joints[np.searchsorted(sequence.stamps_ns, scene.stamps_ns)] = scene.to_plot_data().joints
    common = [scene.skeleton.index(name) for name in truth.joint_names]
    errors = accuracy.compute_errors(joints[:, common], truth.joints, fps=30.0)
    empty_frames = int((~(sequence.keypoints[..., 2] > 0).any(axis=1)).sum())
    reconstructed_frames = errors['frames'] - errors['failed_frames']
    return (
        f'Mean 3D error: {errors["mpjpe_mm"]:.0f} mm (MPJPE, one scale for the sequence), '
        f'{errors["pa_mpjpe_mm"]:.0f} mm after one similarity transform per frame; '
        f'{reconstructed_frames:.0f} of {errors["frames"]:.0f} frames have a skeleton, '
        f'{empty_frames} frames had no keypoints'
    )
