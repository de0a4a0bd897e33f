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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.units import NS_PER_S

if TYPE_CHECKING:
    from typing_extensions import Self

HZ = 30  # Hz, rate of the keypoints
MAX_PEOPLE = 100  # largest crowd that the node accepts
IMAGE_SIZE = 3840, 2160  # px, large enough for a crowd side by side
TIMEOUT_S = 180.0  # s; far above the slowest start, with an empty cache on a busy machine
# ns; each stream begins so much later than the one before, so that no person of that one is continued
STREAM_GAP_NS = 1000 * NS_PER_S


def make_crowd(people: int) -> list[tuple[Person2D, ...]]:
    """Return the frames of the demo recording with this number of people side by side."""
    sequence = make_recording().sequence()
    shifts = [np.array([300.0 * (n % 12), 400.0 * (n // 12)]) for n in range(people)]
    crowd = []
    for frame in range(len(sequence.stamps_ns)):
        one = sequence.person(frame)
        crowd.append(tuple(Person2D(f'p{n}', one.joints, one.points + s, one.score) for n, s in enumerate(shifts)))
    return crowd


class Usage(NamedTuple):
    """CPU time in s, peak and present memory in MB, threads and open files of a process."""

    cpu_s: float
    peak_mb: float
    memory_mb: float
    threads: int
    open_files: int


def measure_usage(pid: int) -> Usage:
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    status = dict(re.findall(r'(\w+):\s+(\d+)', Path(f'/proc/{pid}/status').read_text()))
    cpu_s = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    peak_mb, memory_mb = (int(status[key]) / 1e3 for key in ('VmHWM', 'VmRSS'))
    open_files = len(list(Path(f'/proc/{pid}/fd').iterdir()))
    return Usage(cpu_s, peak_mb, memory_mb, int(status['Threads']), open_files)


@contextmanager
def run_node(
    folder: Path,
    log: Path | None = None,
    *arguments: str,
    environment: Mapping[str, str] | None = None,
    root: Path | None = None,
) -> Iterator[subprocess.Popen[bytes]]:
    """Run the node of a checkout, with parameters such as `node.queue:=20`, that records into a folder."""
    given = ('recorder.enabled:=true', f'recorder.folder:={folder}', f'node.max_people:={MAX_PEOPLE}', *arguments)
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args']
    command += [word for parameter in given for word in ('-p', parameter)]
    with (log or Path(os.devnull)).open('wb') as file:
        environment = {**os.environ, **(environment or {})}
        process = subprocess.Popen(command, env=environment, cwd=root, stdout=file, stderr=file)
    try:
        yield process
    finally:
        process.terminate()  # after a kill, discovery would list the node for a long time
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()


class Peer:
    """A ROS node that sends keypoints and receives all outputs; it notes the arrival of the skeletons.

    Unless `ROS_DOMAIN_ID` is set, all nodes of this process and its children use a random domain; they talk on
    this host alone.
    """

    def __init__(self) -> None:
        os.environ.setdefault('ROS_DOMAIN_ID', str(random.SystemRandom().randrange(1, 100)))
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile
        from rclpy.signals import SignalHandlerOptions

        from mocap_ros.ros.message_types import load_interface_class

        self.context = rclpy.Context()
        domain = int(os.environ['ROS_DOMAIN_ID'])
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('benchmark', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.arrived: dict[int, float] = {}
        self.skeletons = self.node.create_subscription(
            load_interface_class(SKELETONS), 'skeletons', self._note_arrival, QoSProfile(depth=1000), raw=True
        )
        for topic, msgtype in OUTPUTS.items():  # so that publishing them costs what it costs with a viewer
            if topic != 'skeletons':
                self.node.create_subscription(load_interface_class(msgtype), topic, lambda _: None, 10, raw=True)
        self.advertise()
        self._next_stamp_ns = STREAM_GAP_NS

    def _note_arrival(self, raw: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', raw, 4)
        self.arrived[seconds * NS_PER_S + nanoseconds] = time.perf_counter()

    def advertise(self) -> None:
        """Create the publisher of keypoints."""
        from mocap_ros.ros.message_types import load_interface_class

        self.keypoints = self.node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', 10)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def spin_until(self, end: float) -> None:
        while (left := end - time.perf_counter()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def wait(self, condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> bool:
        """Wait for a condition; return whether it came in time."""
        end = time.perf_counter() + timeout_s
        while not condition():
            if time.perf_counter() > end:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def wait_for_node(self) -> None:
        if not self.wait(lambda: self.keypoints.get_subscription_count() and self.skeletons.get_publisher_count()):
            raise TimeoutError('the node did not start')

    def encode_stream(self, people: int) -> Iterator[tuple[int, bytes]]:
        """Yield the stamps in ns and the messages of new people, without end, at `HZ`."""
        crowd, first = make_crowd(people), self._next_stamp_ns
        self._next_stamp_ns += STREAM_GAP_NS
        for number in count():
            stamp = first + number * NS_PER_S // HZ
            yield stamp, encode_keypoints(Header(stamp, 'camera'), IMAGE_SIZE, crowd[number % len(crowd)])

    def stream(self, people: int, seconds: float, warm_up: float = 2.0) -> tuple[list[float], int]:
        """Stream people at `HZ`; return the latencies in ms after the warm-up, and how many had no answer."""
        sent: dict[int, float] = {}
        messages = self.encode_stream(people)
        stamp, raw = next(messages)
        due = time.perf_counter()
        for _ in range(round((warm_up + seconds) * HZ)):
            self.spin_until(due)
            sent[stamp] = time.perf_counter()
            self.keypoints.publish(raw)
            due += 1 / HZ
            last, (stamp, raw) = stamp, next(messages)
        self.wait(lambda: last in self.arrived, 2.0)
        counted = list(sent)[round(warm_up * HZ) :]
        answered = [(self.arrived[s] - sent[s]) * 1e3 for s in counted if s in self.arrived]
        return answered, len(counted) - len(answered)
