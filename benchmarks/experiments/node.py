# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The live node as a process of its own, and a peer that sends keypoints to it and receives its skeletons."""

from __future__ import annotations

import os
import random
import re
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np

from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.units import NS_PER_S

HZ = 30  # Hz, rate of the keypoints
NODE_CORE = min(os.sched_getaffinity(0))  # the core that the node runs on
MAX_PEOPLE = 60  # largest crowd that is tried
IMAGE_SIZE = 3840, 2160  # px, large enough for the crowd side by side
TIMEOUT_S = 20.0  # s; guards against a node that never answers
START_TIMEOUT_S = 180.0  # s; far above the slowest start, with an empty cache on a busy machine
# ns; each stream begins so much later than the one before, so that no person of that one is continued
STREAM_GAP_NS = 1000 * NS_PER_S


def make_crowd(people: int) -> list[tuple[Person2D, ...]]:
    """Return the frames of the demo recording with this number of people side by side."""
    recording = make_recording()
    sequence = recording.sequence()
    shifts = [np.array([300.0 * (n % 12), 400.0 * (n // 12)]) for n in range(people)]
    crowd = []
    for frame in range(len(sequence.stamps_ns)):
        one = sequence.person(frame)
        crowd.append(tuple(Person2D(f'p{n}', one.joints, one.points + s, one.score) for n, s in enumerate(shifts)))
    return crowd


def choose_domain() -> int:
    """Return a random ROS domain, and let all nodes of this process and its children talk on this host alone."""
    domain = random.SystemRandom().randrange(1, 100)
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    return domain


def list_node_parameters(recordings: Path) -> list[str]:
    """Return the ROS arguments of a node that records everything and accepts the largest crowd."""
    given = ('recorder.enabled:=true', f'recorder.folder:={recordings}', f'node.max_people:={MAX_PEOPLE}')
    return ['--log-level', 'error', *(word for p in given for word in ('-p', p))]


class Peer:
    """A ROS node that sends keypoints and receives all outputs; it notes the arrival of the skeletons."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile
        from rclpy.signals import SignalHandlerOptions

        from mocap_ros.ros.message_types import load_interface_class

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('benchmark', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.arrived: dict[int, float] = {}
        self.skeletons = self.node.create_subscription(
            load_interface_class(SKELETONS), 'skeletons', self._note_arrival, QoSProfile(depth=1000), raw=True
        )
        self.keypoints = self.node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', 10)
        self._next_stamp_ns = STREAM_GAP_NS

    def _note_arrival(self, raw: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', raw, 4)
        self.arrived[seconds * NS_PER_S + nanoseconds] = time.perf_counter()

    def subscribe_to_all_outputs(self) -> None:
        """Receive the other outputs as well, so that publishing them costs what it costs with a viewer."""
        from mocap_ros.ros.message_types import load_interface_class

        for topic, msgtype in OUTPUTS.items():
            if topic != 'skeletons':
                self.node.create_subscription(load_interface_class(msgtype), topic, lambda _: None, 10, raw=True)

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def spin_until(self, end: float) -> None:
        while (left := end - time.perf_counter()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def wait(self, condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> None:
        end = time.perf_counter() + timeout_s
        while not condition():
            if time.perf_counter() > end:
                raise TimeoutError
            self.executor.spin_once(timeout_sec=0.02)

    def wait_for_node(self) -> None:
        self.wait(
            lambda: self.keypoints.get_subscription_count() and self.skeletons.get_publisher_count(),
            START_TIMEOUT_S,
        )

    def encode_stream(self, people: int) -> Iterator[tuple[int, bytes]]:
        """Yield the stamps in ns and the messages of new people, without end, at `HZ`."""
        crowd = make_crowd(people)
        first = self._next_stamp_ns
        self._next_stamp_ns += STREAM_GAP_NS
        for number in count():
            stamp = first + number * NS_PER_S // HZ
            yield stamp, encode_keypoints(Header(stamp, 'camera'), IMAGE_SIZE, crowd[number % len(crowd)])

    def stream(self, people: int, seconds: float, warm_up: float = 2.0) -> tuple[list[float], int]:
        """Stream people at `HZ`.

        Returns:
            The latencies in ms of the frames after the warm-up, and the number of frames without an answer.
        """
        sent: dict[int, float] = {}
        messages = self.encode_stream(people)
        stamp, raw = next(messages)
        due = time.perf_counter()
        for _ in range(round((warm_up + seconds) * HZ)):
            self.spin_until(due)
            sent[stamp] = time.perf_counter()
            self.keypoints.publish(raw)
            due += 1 / HZ
            stamp, raw = next(messages)
        last = max(sent)
        end = time.perf_counter() + 2.0
        while last not in self.arrived and time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.02)
        counted = list(sent)[round(warm_up * HZ) :]
        answered = [(self.arrived[s] - sent[s]) * 1e3 for s in counted if s in self.arrived]
        return answered, len(counted) - len(answered)


@contextmanager
def run_node(folder: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run the node on its core, with recording.

    Args:
        folder: folder of the recordings.
        environment: variables of the node's environment beside those of this process.
    """
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', *list_node_parameters(folder)]
    process = subprocess.Popen(
        command, env={**os.environ, **environment}, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    os.sched_setaffinity(process.pid, {NODE_CORE})
    try:
        yield process
    finally:
        process.terminate()  # after a kill, discovery would list the node for a long time
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()


def measure_usage(process: subprocess.Popen[bytes]) -> tuple[float, float]:
    """Return the CPU time in s and the peak memory in MB of a process."""
    fields = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    status = Path(f'/proc/{process.pid}/status').read_text()
    peak = re.search(r'VmHWM:\s+(\d+)', status)
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf('SC_CLK_TCK'), int(peak[1]) / 1e3 if peak else float('nan')
