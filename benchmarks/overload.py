# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Overload: more people, images and cameras than a node can take, and a subscriber that does not read.

A node that records runs over DDS beside a sender. What is measured is the age of an image when its skeletons
arrive, whether skeletons come in the order of the images, and whether every image that was sent is accounted for:
answered, or counted as dropped in the diagnostics.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import numpy as np
from experiments.node import IMAGE_SIZE, Peer, choose_domain, make_crowd
from report import Report, run
from soak import run_recording_node

from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import encode_keypoints
from mocap_ros.ros.diagnostics import DIAGNOSTICS
from mocap_ros.units import NS_PER_S

SECONDS, QUICK_SECONDS = 15.0, 3.0  # s of each load
WARM_UP_S = 1.0  # s at the start of each load, which do not count
GAP_NS = 100 * NS_PER_S  # between the stamps of two loads, so that nobody is continued
TEMPLATES = 60  # messages that are encoded before a load; encoding 50 people takes too long for 200 Hz
STAMP, STAMP_OFFSET = struct.Struct('<iI'), 4  # s and ns of the stamp in a message, and the byte where they are
SETTLE_S = 15.0  # s after a load, in which the last answers and a status come
# Reads nothing that it has subscribed to, reliably and with a long history.
SLEEPER = """
import sys, rclpy
from rclpy.qos import HistoryPolicy, QoSProfile
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.outputs import OUTPUTS
rclpy.init()
node = rclpy.create_node('sleeper')
qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
for topic, msgtype in OUTPUTS.items():
    node.create_subscription(load_interface_class(msgtype), topic, print, qos, raw=True)
print('ready', flush=True)
sys.stdin.read()  # until the benchmark ends
"""
# Sends two calibrations of a camera in turn, without a pause.
FLOOD = """
import sys, threading, rclpy
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.ros.message_types import load_interface_class
rclpy.init()
node = rclpy.create_node('flood')
publisher = node.create_publisher(load_interface_class(CAMERA_INFO), 'camera_info', 10)
while not publisher.get_subscription_count():
    pass
print('ready', flush=True)
is_ending = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), is_ending.set())).start()
cameras = [CameraInfo((3840, 2160), Intrinsics(f, (1920.0, 1080.0), True)) for f in (3000.0, 3300.0)]
messages = [encode_camera_info(Header(0, 'camera0'), camera) for camera in cameras]
while not is_ending.is_set():
    for raw in messages:
        publisher.publish(raw)
"""
OF_ALL_TOPICS = 'dropped: queue full'  # the one number in the diagnostics that is not of images alone
TARGETS = {'unaccounted': '0', 'older_first': '0'}


@dataclass(frozen=True)
class Load:
    """What is sent to the node.

    Attributes:
        name: As the table names it.
        people: People in each image.
        hz: Images per second of each camera.
        cameras: Number of cameras that send to the same topic.
        is_read: Whether all subscribers read; otherwise there is one more, which does not.
        is_flooded: Whether another publisher sends calibrations of the camera without a pause.
    """

    name: str
    people: int
    hz: float
    cameras: int = 1
    is_read: bool = True
    is_flooded: bool = False


LOADS = (
    Load('3 people, 30 Hz', 3, 30.0),
    Load('the same, and a subscriber that does not read', 3, 30.0, is_read=False),
    Load('the same, from two cameras', 3, 30.0, cameras=2),
    Load('the same, and calibrations of the camera without a pause', 3, 30.0, is_flooded=True),
    Load('1 person, 200 Hz', 1, 200.0),
    Load('50 people, 30 Hz', 50, 30.0),
    Load('50 people, 200 Hz', 50, 200.0),
    Load(
        '50 people, 200 Hz, two cameras, and a subscriber that does not read', 50, 200.0, cameras=2, is_read=False
    ),
)


@dataclass(frozen=True)
class Outcome:
    """What became of the images of a load.

    Attributes:
        load: What was sent.
        ages_ms: Age of each answered image when its skeletons arrived, after the warm-up.
        counts: Images that were sent, answered, dropped and refused; dropped ones by reason.
        older_first: Answered images that were sent before an image that had been answered already.
        hz: Images of a camera per second that the sender achieved.
    """

    load: Load
    ages_ms: Sequence[float]
    counts: dict[str, int]
    older_first: int
    hz: float


class StatusReader:
    """Reads the numbers of inputs from the node's diagnostics."""

    def __init__(self, peer: Peer) -> None:
        from mocap_ros.ros.message_types import load_interface_class

        self._values: dict[str, str] = {}
        peer.node.create_subscription(load_interface_class(DIAGNOSTICS), '/diagnostics', self._read, 10, raw=True)

    def _read(self, raw: bytes) -> None:
        (status,) = decode(raw, DIAGNOSTICS).status
        self._values = {v.key: v.value for v in status.values}

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of images so far: accepted, invalid, dropped and lost, by reason."""
        kinds = ('accepted', 'invalid', 'dropped', 'lost')
        return {k: int(v) for k, v in self._values.items() if k.startswith(kinds) and k != OF_ALL_TOPICS}


@contextmanager
def run_beside(program: str) -> Iterator[None]:
    """Run a Python program that prints a line when it is ready, and ends when its standard input does."""
    command = [sys.executable, '-c', program]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline(), 'the program has ended'
        yield
    finally:
        process.communicate(timeout=20.0)


def send_load(peer: Peer, status: StatusReader, load: Load, seconds: float, first_ns: int) -> Outcome:
    """Send a load, and account for its images."""
    templates = [encode_templates(load.people, f'camera{n}') for n in range(load.cameras)]
    before = status.counts
    peer.arrived.clear()
    sent: dict[int, float] = {}
    start_s = due_s = time.perf_counter()
    for number in count():
        now_s = time.perf_counter()
        if now_s - start_s > WARM_UP_S + seconds:
            break
        peer.spin_until(due_s)
        peer.executor.spin_once(timeout_sec=0.0)
        for camera in range(load.cameras):
            stamp = first_ns + round((number + camera / load.cameras) / load.hz * NS_PER_S)
            raw = templates[camera][number % TEMPLATES]
            STAMP.pack_into(raw, STAMP_OFFSET, *divmod(stamp, NS_PER_S))
            sent[stamp] = time.perf_counter()
            peer.keypoints.publish(bytes(raw))
        due_s += 1 / load.hz
    elapsed_s = time.perf_counter() - start_s
    counts: dict[str, int] = {}
    settled_s = time.perf_counter() + SETTLE_S
    while time.perf_counter() < settled_s and sum(counts.values()) < len(sent):
        peer.spin_until(time.perf_counter() + 0.5)
        counts = {k: v - before.get(k, 0) for k, v in status.counts.items()}
    order = [stamp for stamp in peer.arrived if stamp in sent]
    counted = [s for s in order if sent[s] - start_s > WARM_UP_S]
    return Outcome(
        load,
        [(peer.arrived[s] - sent[s]) * 1e3 for s in counted],
        {'sent': len(sent), **{k: v for k, v in counts.items() if v}},
        sum(later < earlier for earlier, later in pairwise(order)),
        len(sent) / load.cameras / elapsed_s,
    )


def encode_templates(people: int, camera: str) -> list[bytearray]:
    """Return messages of consecutive images, into which stamps are written later."""
    crowd = make_crowd(people)[:TEMPLATES]
    return [bytearray(encode_keypoints(Header(1, camera), IMAGE_SIZE, frame)) for frame in crowd]


def run_loads(seconds: float) -> list[Outcome]:
    """Send all loads to one node, one after the other."""
    domain = int(os.environ.get('ROS_DOMAIN_ID') or choose_domain())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    outcomes = []
    with (
        tempfile.TemporaryDirectory() as name,
        run_recording_node(Path(name, 'bags'), Path(name, 'log.txt')) as process,
    ):
        peer = Peer(domain)
        peer.subscribe_to_all_outputs()
        status = StatusReader(peer)
        peer.wait(lambda: peer.keypoints.get_subscription_count() and status.counts, 120.0)
        for number, load in enumerate(common.show_progress(LOADS, 'loads', len(LOADS)), 1):
            with ExitStack() as beside:
                for program in [SLEEPER] * (not load.is_read) + [FLOOD] * load.is_flooded:
                    beside.enter_context(run_beside(program))
                outcomes.append(send_load(peer, status, load, seconds, number * GAP_NS))
        assert process.poll() is None
        peer.close()
    return outcomes


def count_unaccounted(outcome: Outcome) -> int:
    """Return how many images were neither accepted nor counted as dropped, refused or lost."""
    return outcome.counts['sent'] - sum(v for k, v in outcome.counts.items() if k != 'sent')


def measure(args: argparse.Namespace, report: Report) -> None:
    outcomes = run_loads(QUICK_SECONDS if args.quick else SECONDS)
    rows: list[list[object]] = []
    for one in outcomes:
        ages = [f'{np.percentile(one.ages_ms, p):.0f}' if one.ages_ms else '-' for p in (50, 99, 100)]
        dropped = sum(v for k, v in one.counts.items() if k.startswith('dropped'))
        lost = sum(v for k, v in one.counts.items() if k.startswith('lost'))
        refused = one.counts.get('invalid', 0)
        accepted = one.counts.get('accepted', 0)
        counts = [one.counts['sent'], accepted, dropped, refused, lost, count_unaccounted(one)]
        rows.append([one.load.name, f'{one.hz:.0f}', *counts, *ages])
    header = [
        'load',
        'Hz achieved',
        'images sent',
        'answered',
        'dropped',
        'refused',
        'lost before the node',
        'unaccounted',
    ]
    header += ['age: median, ms', '99 %', 'worst']
    report.table(header, rows, page='overload.loads')
    results = {
        'unaccounted': sum(abs(count_unaccounted(one)) for one in outcomes),
        'older_first': sum(one.older_first for one in outcomes),
        'worst_age_ms': max(max(one.ages_ms) for one in outcomes if one.ages_ms),
    }
    report.quantities(results, TARGETS, page='')


def main() -> None:
    run(__doc__, 'Overload', measure, one_core=False)


if __name__ == '__main__':
    main()
