# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node and its recorder under many hours' worth of stream over DDS, as fast as the node takes it.

Three people come at the stamps of a camera of 30 Hz, and the next image follows when the skeletons of the one
before have come. People come and go, the detector restarts, time loops, parameters change, and recordings end, are
counted and removed.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from node import Peer, measure_usage, run_node
from report import Report, run

from mocap_ros.bags.reader import Bag
from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import encode_keypoints
from mocap_ros.units import NS_PER_S

HZ = 30  # Hz, rate of the stamps
PEOPLE = 3  # people at once, at most
SOAK_SIZE = 1280, 720  # px
START_NS = 1000 * NS_PER_S  # stamp of the first image
PRESENT_S = 20.0, 90.0  # s, shortest and longest stay of a person
ABSENT_S = 0.0, 8.0  # s, shortest and longest time without a person in that place
DETECTOR_GAP_S = 3.0  # s without images while the detector restarts
# s of stream between two events of each kind
EVENTS_S = {'detector': 290.0, 'loop': 1310.0, 'parameters': 430.0, 'recording': 1790.0, 'sample': 20.0}
ANSWER_S = 2.0  # s, after which an image is taken as lost
SETTLED_S = 600.0  # s of stream after which memory should not grow
HOUR_S = 3600.0  # s
# Parameters that are set in turn; the last ones restore the first.
CHANGES = (('tracker.iterations', 3), ('node.queue', 20), ('tracker.iterations', 2), ('node.queue', 10))
RELIABLE = 'qos_overrides./keypoints.subscription.reliability:=reliable'


class Crowd:
    """People in `PEOPLE` places who come and go; each is somebody new."""

    def __init__(self) -> None:
        sequence = make_recording().sequence()
        self._frames = [sequence.person(n) for n in range(len(sequence.stamps_ns))]
        self._random = random.Random(0)
        self.restart(0.0)

    def restart(self, now_s: float) -> None:
        """Give everybody an id that has been used before, as a detector that restarts does."""
        self._ids = 0
        # of each place: id, first frame of the recording, and times in s of coming and going
        self._places = [self._invite(now_s) for _ in range(PEOPLE)]

    def _invite(self, now_s: float) -> tuple[str, int, float, float]:
        self._ids += 1
        coming_s = now_s + self._random.uniform(*ABSENT_S)
        going_s = coming_s + self._random.uniform(*PRESENT_S)
        return f'p{self._ids}', self._random.randrange(len(self._frames)), coming_s, going_s

    def list_people(self, number: int, now_s: float) -> list[Person2D]:
        """Return the people of an image."""
        people = []
        for place, (name, first, coming_s, going_s) in enumerate(self._places):
            if now_s >= going_s:
                self._places[place] = self._invite(now_s)
            elif now_s >= coming_s:
                one = self._frames[(first + number) % len(self._frames)]
                shift = np.array([100.0 + 380.0 * place - 270.0, 60.0])
                people.append(Person2D(name, one.joints, one.points + shift, one.score))
        return people


def call(peer: Peer, service_class: Any, name: str, **request: Any) -> Any:
    """Call a service of the node; return its answer, or None if there is none in time."""
    client: Any = peer.node.create_client(service_class, f'mocap_node/{name}')
    peer.wait(client.service_is_ready)
    future = client.call_async(service_class.Request(**request))
    peer.executor.spin_until_future_complete(future, timeout_sec=20.0)
    peer.node.destroy_client(client)
    return future.result() if future.done() else None


def set_parameter(peer: Peer, name: str, value: Any) -> None:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    given = [Parameter(name, value=value).to_parameter_msg()]
    answer = call(peer, SetParameters, 'set_parameters', parameters=given)
    assert answer is not None and answer.results[0].successful, name  # noqa: PT018


@dataclass
class Soak:
    """One run: `node` has rows of time of the stream in s, memory in MB, threads, open files, and CPU time in s,
    `latencies` of time in s and latency in ms; `counts` are of events, lost images and messages not recorded.
    """

    peer: Peer
    pid: int
    node: list[tuple[float, ...]] = field(default_factory=list)
    latencies: list[tuple[float, float]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys((*EVENTS_S, 'lost', 'missing'), 0))

    def __post_init__(self) -> None:
        self._crowd = Crowd()
        self._number = 0  # of the image
        self._sent_in_recording = 0
        self._shift_s = 0.0  # by which stamps differ from the time of the stream
        self._due = {**EVENTS_S, 'sample': 0.0}

    @property
    def stream_s(self) -> float:
        return self._number / HZ

    def send_next(self) -> None:
        """Let happen what is due, send the next image, and wait for its skeletons."""
        now_s = self.stream_s
        happen: dict[str, Callable[[float], None]] = {
            'detector': self._restart_detector,
            'loop': self._loop,
            'parameters': lambda _: set_parameter(self.peer, *CHANGES[self.counts['parameters'] % len(CHANGES)]),
            'recording': self.count_recording,
            'sample': self._sample,
        }
        for event, every_s in EVENTS_S.items():
            if now_s >= self._due[event]:
                self._due[event] += every_s
                happen[event](now_s)
                self.counts[event] += 1
        stamp = START_NS + round((now_s + self._shift_s) * NS_PER_S)
        raw = encode_keypoints(Header(stamp, 'camera'), SOAK_SIZE, self._crowd.list_people(self._number, now_s))
        sent_s = time.perf_counter()
        self.peer.keypoints.publish(raw)
        self._sent_in_recording += 1
        if self.peer.wait(lambda: stamp in self.peer.arrived, ANSWER_S):
            self.latencies.append((now_s, (self.peer.arrived.pop(stamp) - sent_s) * 1e3))
        else:
            self.counts['lost'] += 1
        self._number += 1

    def _sample(self, now_s: float) -> None:
        usage = measure_usage(self.pid)
        self.node.append((now_s, usage.memory_mb, usage.threads, usage.open_files, usage.cpu_s))

    def _loop(self, now_s: float) -> None:
        self._shift_s = -now_s
        self.peer.arrived.clear()

    def _restart_detector(self, now_s: float) -> None:
        """Replace the publisher; ids begin anew, and the images of a few seconds are missing."""
        self.peer.node.destroy_publisher(self.peer.keypoints)
        self.peer.advertise()
        self.peer.wait_for_node()
        self._crowd.restart(now_s)
        self._shift_s += DETECTOR_GAP_S

    def count_recording(self, _now_s: float, *, is_last: bool = False) -> None:
        """End the recording, count its messages and remove it; begin the next."""
        from std_srvs.srv import SetBool

        answer = call(self.peer, SetBool, 'record', data=False)
        self.counts['missing'] += 2 * self._sent_in_recording
        if answer is not None and answer.success:
            folder = Path(answer.message)
            self.peer.wait((folder / 'metadata.yaml').is_file)
            with Bag(folder) as bag:
                self.counts['missing'] -= bag.count(['/keypoints']) + bag.count(['/skeletons'])
            shutil.rmtree(folder)
        self._sent_in_recording = 0
        if not is_last:
            set_parameter(self.peer, 'recorder.enabled', True)

    def describe(self) -> list[list[object]]:
        """Return the rows of the table."""
        node, latencies = np.array(self.node), np.array(self.latencies)
        settled = node[node[:, 0] >= min(SETTLED_S, node[-1, 0])]
        tenth = max(1, len(settled) // 10)
        early, last = settled[:tenth], settled[-tenth:]
        memory = [float(np.median(part[:, 1])) for part in (early, last)]
        grown = [f'{last[:, i].max() - early[:, i].max():.0f}' for i in (2, 3)]
        cpu_ms = np.diff(settled[:, 4]) / (np.diff(settled[:, 0]) * HZ) * 1e3
        hours = latencies[:, 0] < HOUR_S, latencies[:, 0] >= latencies[-1, 0] - HOUR_S
        p99 = [float(np.percentile(latencies[hour, 1], 99)) for hour in hours]
        count, events = len(self.latencies) + self.counts['lost'], list(EVENTS_S)[:4]
        names = 'detector restarts, time loops, parameter changes, recordings'
        memory_growth = f'{100 * (memory[1] / memory[0] - 1):.1f} % of {memory[0]:.0f} MB'
        late = f'{p99[0]:.0f} ms, {100 * (p99[1] / p99[0] - 1):+.0f} %'
        return [
            ['stream', f'{self.stream_s / HOUR_S:.1f} h, {count} images', '8 h'],
            [names, ', '.join(str(self.counts[e]) for e in events), None],
            ['images without an answer within 2 s', self.counts['lost'], '0'],
            ['messages missing in recordings', self.counts['missing'], '0'],
            ['growth of the memory after the first ten minutes', memory_growth, '2 %'],
            ['growth of threads, and of open files', ', '.join(grown), '0'],
            ['CPU time of an image', f'{np.median(cpu_ms) if len(cpu_ms) else float("nan"):.1f} ms', None],
            ['latency, median', f'{np.median(latencies[:, 1]):.1f} ms', None],
            ['latency, 99 %, and its growth from the first to the last hour', late, '10 %'],
        ]


@contextmanager
def run_recording_node() -> Iterator[tuple[Peer, subprocess.Popen[bytes]]]:
    """Run a node that records, and a peer that it is connected to."""
    with ExitStack() as stack:
        folder, peer = Path(stack.enter_context(tempfile.TemporaryDirectory())), stack.enter_context(Peer())
        given = 'recorder.split_seconds:=600.0', RELIABLE
        process = stack.enter_context(run_node(folder / 'bags', folder / 'log', *given))
        peer.wait_for_node()
        yield peer, process
        problems = (folder / 'log').read_text(errors='replace').splitlines()
        print(*[line for line in problems if not line.startswith('[INFO]')][:20], sep='\n')


def report_soak(report: Report) -> dict[str, Any]:
    stream_s = 60.0 if report.quick else report.args.hours * HOUR_S
    end_s = time.monotonic() + (25.0 if report.quick else 60.0 * report.args.minutes)
    with run_recording_node() as (peer, process):
        one = Soak(peer, process.pid)
        while one.stream_s < stream_s and time.monotonic() < end_s and process.poll() is None:
            one.send_next()
        if process.poll() is None:
            one.count_recording(one.stream_s, is_last=True)
            one.counts['recording'] += 1
    report.table(['quantity', 'measured', 'target'], one.describe(), page='soak.targets')
    return {'node': one.node, 'counts': one.counts}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--hours', type=float, default=8.0, help='h of stream of the soak (default: %(default)s)')
    parser.add_argument('--minutes', type=float, default=600.0, help='after which it ends (default: %(default)s)')


if __name__ == '__main__':
    run(__doc__, {'soak': report_soak}, add_options)
