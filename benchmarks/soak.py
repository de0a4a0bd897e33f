# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Soak: the node and its recorder for many hours' worth of stream, over DDS, as fast as the node takes it.

Three people are sent at the stamps of a camera of 30 Hz; the next image follows when the skeletons of the one
before have come. People come and go, the detector restarts, time loops, parameters change, and recordings end,
are counted and removed. Memory, threads and open files of the node, the latency, and images without an answer are
drawn over the time of the stream. A fixed calculation is timed beside the stream, so that a machine that becomes
slower is told from a node that does: growth of times is also given in units of that calculation.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from experiments.node import Peer, choose_domain
from panels import NEUTRAL, RUN, WALK, label_axes, make_panels
from report import Report, run

from mocap_ros.bags.reader import Bag
from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.units import NS_PER_S

HZ = 30  # Hz, rate of the stamps
PEOPLE = 3  # people at once, at most
IMAGE_SIZE = 1280, 720  # px
START_NS = 1000 * NS_PER_S  # stamp of the first image
PRESENT_S = 20.0, 90.0  # s, shortest and longest stay of a person
ABSENT_S = 0.0, 8.0  # s, shortest and longest time without a person in that place
DETECTOR_RESTART_S = 290.0  # s of stream between two restarts of the detector
DETECTOR_GAP_S = 3.0  # s without images while it restarts
LOOP_S = 1310.0  # s of stream after which time starts again
PARAMETERS_S = 430.0  # s of stream between two changes of parameters
RECORDING_S = 1790.0  # s of stream of a recording
SAMPLE_S = 20.0  # s of stream between two looks at the node's memory
REFERENCE_ROUNDS = 60  # of the fixed calculation: about 3 ms
REFERENCE_SAMPLES = 15  # samples whose median is the speed of the machine: 300 s of stream
BIN_S = 300.0  # s of stream over which latencies are summed up
ANSWER_S = 2.0  # s, after which an image is taken as lost
SETTLED_S = 600.0  # s of stream after which memory should not grow
HOUR_S = 3600.0  # s
# Parameters that are set in turn; the last ones restore the first.
CHANGES: tuple[tuple[str, Any], ...] = (
    ('tracker.iterations', 3),
    ('node.queue', 20),
    ('tracker.iterations', 2),
    ('node.queue', 10),
)
EVENTS = ('events: detector restarts', 'events: time loops', 'events: parameters')  # names of the results
TARGETS = {
    'memory_growth_percent': '2 or less',
    'p99_growth_percent': '10 or less',
    'p99_growth_percent_in_units': '10 or less',
    'lost_images': '0',
    'threads_growth': '0',
    'open_files_growth': '0',
}


@dataclass
class Samples:
    """What was measured, with the time of the stream in s.

    Attributes:
        node: rows of time, memory in MB, threads, open files, and CPU time in s.
        reference: time in ms of the fixed calculation, for each row of `node`.
        latencies: rows of time and latency in ms, of every answered image.
        lost: times of the images without an answer.
        bags: number of the recordings that were counted, and the messages that were missing in them.
        events: number of events by name.
    """

    node: list[tuple[float, float, int, int, float]] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    latencies: list[tuple[float, float]] = field(default_factory=list)
    lost: list[float] = field(default_factory=list)
    bags: int = 0
    missing_in_bags: int = 0
    events: dict[str, int] = field(default_factory=dict)

    def note(self, event: str) -> None:
        """Count an event."""
        self.events[event] = self.events.get(event, 0) + 1


class Crowd:
    """People in `PEOPLE` places who come and go; each is somebody new."""

    def __init__(self) -> None:
        recording = make_recording()
        sequence = recording.sequence()
        self._frames = [sequence.person(n) for n in range(len(sequence.stamps_ns))]
        self._random = random.Random(0)
        self._ids = 0
        # of each place: id, first frame of the recording, and times in s of coming and going
        self._places: list[tuple[str, int, float, float]] = [self._invite(0.0) for _ in range(PEOPLE)]

    def restart(self, now_s: float) -> None:
        """Give everybody an id that has been used before, as a detector that restarts does."""
        self._ids = 0
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


@contextmanager
def run_recording_node(folder: Path, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node that records, with its log in a file."""
    values = ('recorder.enabled:=true', f'recorder.folder:={folder}', 'recorder.split_seconds:=600.0')
    reliable = 'qos_overrides./keypoints.subscription.reliability:=reliable'
    words = [word for value in (*values, reliable) for word in ('-p', value)]
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', *words]
    with log.open('wb') as file:
        process = subprocess.Popen(command, stdout=file, stderr=file)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()


def measure_process(pid: int) -> tuple[float, int, int, float]:
    """Return the resident memory in MB, the threads, the open files and the CPU time in s of a process."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    cpu_s = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    status = Path(f'/proc/{pid}/status').read_text()

    def read(name: str) -> int:
        found = re.search(rf'{name}:\s+(\d+)', status)
        assert found is not None
        return int(found[1])

    return read('VmRSS') / 1e3, read('Threads'), len(list(Path(f'/proc/{pid}/fd').iterdir())), cpu_s


def time_reference() -> float:
    """Return the time in ms of a fixed calculation: small matrices and Python's own work, as in the node."""
    matrix = np.eye(45) + 1.0 / (1.0 + np.arange(45 * 45).reshape(45, 45))
    begun_s = time.perf_counter()
    for _ in range(REFERENCE_ROUNDS):
        np.linalg.solve(matrix, matrix[:, :3])
        sum(number * number for number in range(300))
    return (time.perf_counter() - begun_s) * 1e3


def call(peer: Peer, service_class: Any, name: str, **request: Any) -> Any:
    """Call a service of the node; return its answer, or None if there is none in time."""
    client: Any = peer.node.create_client(service_class, f'mocap_node/{name}')
    peer.wait(client.service_is_ready)
    future = client.call_async(service_class.Request(**request))
    peer.executor.spin_until_future_complete(future, timeout_sec=20.0)
    peer.node.destroy_client(client)
    return future.result() if future.done() else None


def set_parameter(peer: Peer, name: str, value: Any) -> bool:
    """Set a parameter of the node; return whether it took it."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    answer = call(
        peer, SetParameters, 'set_parameters', parameters=[Parameter(name, value=value).to_parameter_msg()]
    )
    return answer is not None and answer.results[0].successful


class Soak:
    """One run: the stream, its events and what was measured.

    Args:
        peer: Node that sends and receives.
        pid: Process of the node.
        recordings: Folder of the recordings.
    """

    def __init__(self, peer: Peer, pid: int, recordings: Path) -> None:
        self.samples = Samples()
        self._peer = peer
        self._pid = pid
        self._recordings = recordings
        self._crowd = Crowd()
        self._number = 0  # of the image
        self._sent_in_recording = 0
        self._shift_s = 0.0  # by which stamps differ from the time of the stream
        self._due = dict.fromkeys(('detector', 'loop', 'parameters', 'recording', 'sample'), 0.0)
        self._due |= {'detector': DETECTOR_RESTART_S, 'loop': LOOP_S}
        self._due |= {'parameters': PARAMETERS_S, 'recording': RECORDING_S}

    @property
    def stream_s(self) -> float:
        """Time of the stream in s."""
        return self._number / HZ

    def send_next(self) -> None:
        """Send the next image, wait for its skeletons, and let happen what is due."""
        now_s = self.stream_s
        self._let_happen(now_s)
        stamp = START_NS + round((now_s + self._shift_s) * NS_PER_S)
        raw = encode_keypoints(Header(stamp, 'camera'), IMAGE_SIZE, self._crowd.list_people(self._number, now_s))
        sent_s = time.perf_counter()
        self._peer.keypoints.publish(raw)
        self._sent_in_recording += 1
        end_s = sent_s + ANSWER_S
        arrived = self._peer.arrived
        while stamp not in arrived and time.perf_counter() < end_s:
            self._peer.executor.spin_once(timeout_sec=0.05)
        if stamp in arrived:
            self.samples.latencies.append((now_s, (arrived.pop(stamp) - sent_s) * 1e3))
        else:
            self.samples.lost.append(now_s)
        self._number += 1

    def _let_happen(self, now_s: float) -> None:
        if now_s >= self._due['sample']:
            self._due['sample'] += SAMPLE_S
            self.samples.node.append((now_s, *measure_process(self._pid)))
            self.samples.reference.append(min(time_reference() for _ in range(3)))
        if now_s >= self._due['detector']:
            self._due['detector'] += DETECTOR_RESTART_S
            self._restart_detector(now_s)
        if now_s >= self._due['loop']:
            self._due['loop'] += LOOP_S
            self._shift_s = -now_s
            self._peer.arrived.clear()
            self.samples.note('time loops')
        if now_s >= self._due['parameters']:
            self._due['parameters'] += PARAMETERS_S
            name, value = CHANGES[self.samples.events.get('parameters', 0) % len(CHANGES)]
            assert set_parameter(self._peer, name, value)
            self.samples.note('parameters')
        if now_s >= self._due['recording']:
            self._due['recording'] += RECORDING_S
            self.count_recording()
            assert set_parameter(self._peer, 'recorder.enabled', True)

    def _restart_detector(self, now_s: float) -> None:
        """Replace the publisher; ids begin anew, and the images of a few seconds are missing."""
        node = self._peer.node
        node.destroy_publisher(self._peer.keypoints)
        self._peer.keypoints = node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', 10)
        self._peer.wait_for_node()
        self._crowd.restart(now_s)
        self._shift_s += DETECTOR_GAP_S
        self.samples.note('detector restarts')

    def count_recording(self) -> None:
        """End the recording, count its messages and remove it."""
        from std_srvs.srv import SetBool

        answer = call(self._peer, SetBool, 'record', data=False)
        folder = Path(answer.message) if answer is not None and answer.success else None
        if folder is not None:
            self._peer.wait((folder / 'metadata.yaml').is_file)
            with Bag(folder) as bag:
                counts = (bag.count(['/keypoints']), bag.count(['/skeletons']))
            self.samples.missing_in_bags += 2 * self._sent_in_recording - sum(counts)
            self.samples.bags += 1
            shutil.rmtree(folder)
        else:
            self.samples.missing_in_bags += 2 * self._sent_in_recording
        self._sent_in_recording = 0


def soak(report: Report, stream_s: float, wall_s: float) -> Samples:
    """Run the node until so much stream has passed, or so much time."""
    domain = int(os.environ.get('ROS_DOMAIN_ID') or choose_domain())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name, 'bags'), Path(name, 'log.txt')
        with run_recording_node(folder, log) as process:
            peer = Peer(domain)
            peer.subscribe_to_all_outputs()
            peer.wait(
                lambda: peer.keypoints.get_subscription_count() and peer.skeletons.get_publisher_count(), 120.0
            )
            one = Soak(peer, process.pid, folder)
            end_s = time.monotonic() + wall_s
            reported_s = 0.0
            while one.stream_s < stream_s and time.monotonic() < end_s and process.poll() is None:
                one.send_next()
                if one.stream_s - reported_s >= 2 * BIN_S:
                    reported_s = one.stream_s
                    report.add(**summarise(one.samples, one.stream_s))
                    print(f'{one.stream_s / HOUR_S:.2f} h of stream', file=sys.stderr, flush=True)
            if process.poll() is None:
                one.count_recording()
            one.samples.events['node died'] = int(process.poll() is not None)
            peer.close()
        problems = [line for line in log.read_text(errors='replace').splitlines() if not line.startswith('[INFO]')]
        report.add(**summarise(one.samples, one.stream_s), log=problems[:20])
    return one.samples


def summarise(samples: Samples, stream_s: float) -> dict[str, Any]:
    """Return the figures of a run so far."""
    node, latencies = np.array(samples.node), np.array(samples.latencies)
    settled = node[node[:, 0] >= min(SETTLED_S, node[-1, 0])]
    early, last = settled[: max(1, len(settled) // 10)], settled[-max(1, len(settled) // 10) :]
    n = len(settled) // 3  # of the first and the last third
    memory_before, memory_after = np.median(early[:, 1]), np.median(last[:, 1])
    cpu_ms = compute_cpu_ms(settled)
    reference = smooth(np.array(samples.reference))
    cpu_in_units = cpu_ms / reference[-len(settled) :][1:]
    in_units = latencies[:, 1] / np.interp(latencies[:, 0], node[:, 0], reference)
    first, last_hour = latencies[:, 0] < HOUR_S, latencies[:, 0] >= max(latencies[-1, 0] - HOUR_S, 0.0)
    p99_first, p99_last = (np.percentile(latencies[hour, 1], 99) for hour in (first, last_hour))
    p99_first_in_units, p99_last_in_units = (np.percentile(in_units[hour], 99) for hour in (first, last_hour))
    return {
        'stream_hours': stream_s / HOUR_S,
        'images': len(samples.latencies) + len(samples.lost),
        'lost_images': len(samples.lost),
        'recordings': samples.bags,
        'missing_in_recordings': samples.missing_in_bags,
        'memory_mb': float(memory_before),
        'memory_growth_percent': float(100 * (memory_after / memory_before - 1)),
        'threads_growth': int(last[:, 2].max() - early[:, 2].max()),
        'open_files_growth': int(last[:, 3].max() - early[:, 3].max()),
        'cpu_ms_image': float(np.median(cpu_ms)) if len(cpu_ms) else float('nan'),
        'cpu_growth_percent': compute_growth(cpu_ms[:n], cpu_ms[-n:]) if n else 0.0,
        'cpu_growth_percent_in_units': compute_growth(cpu_in_units[:n], cpu_in_units[-n:]) if n else 0.0,
        'reference_growth_percent': compute_growth(reference[:n], reference[-n:]) if n else 0.0,
        'p50_ms': float(np.percentile(latencies[:, 1], 50)),
        'p99_first_hour_ms': float(p99_first),
        'p99_last_hour_ms': float(p99_last),
        'p99_growth_percent': float(100 * (p99_last / p99_first - 1)),
        'p99_growth_percent_in_units': float(100 * (p99_last_in_units / p99_first_in_units - 1)),
        **{f'events: {name}': count for name, count in samples.events.items()},
    }


def compute_growth(before: Any, after: Any) -> float:
    """Return by how many percent the median has grown."""
    return float(100 * (np.median(after) / np.median(before) - 1))


def smooth(times: Any) -> Any:
    """Return the running median of times over `REFERENCE_SAMPLES`, fewer at both ends."""
    half = REFERENCE_SAMPLES // 2
    return np.array([np.median(times[max(0, n - half) : n + half + 1]) for n in range(len(times))])


def compute_cpu_ms(node: Any) -> Any:
    """Return the CPU time of the node for each image, in ms, between the rows of `Samples.node`."""
    return np.diff(node[:, 4]) / (np.diff(node[:, 0]) * HZ) * 1e3


def describe(found: dict[str, float]) -> list[list[object]]:
    """Return the rows of the page's table."""
    return [
        ['stream', f'{found["stream_hours"]:.1f} h, {found["images"]:.0f} images', '8 h'],
        [
            'detector restarts, time loops, parameter changes, recordings',
            ', '.join(f'{found.get(e, 0):.0f}' for e in (*EVENTS, 'recordings')),
            None,
        ],
        ['images without an answer within 2 s', f'{found["lost_images"]:.0f}', '0'],
        ['messages missing in recordings', f'{found["missing_in_recordings"]:.0f}', '0'],
        [
            'growth of the memory after the first ten minutes',
            f'{found["memory_growth_percent"]:.1f} % of {found["memory_mb"]:.0f} MB',
            '2 %',
        ],
        ['growth of threads, and of open files', f'{found["threads_growth"]}, {found["open_files_growth"]}', '0'],
        [
            'CPU time of an image, and its growth from the first to the last third',
            f'{found["cpu_ms_image"]:.1f} ms, {found["cpu_growth_percent"]:+.1f} %',
            None,
        ],
        [
            'the same growth of a fixed calculation beside it, and of the ratio',
            f'{found["reference_growth_percent"]:+.1f} %, {found["cpu_growth_percent_in_units"]:+.1f} %',
            None,
        ],
        ['latency, median', f'{found["p50_ms"]:.1f} ms', None],
        [
            'latency, 99 %, and its growth from the first to the last hour',
            f'{found["p99_first_hour_ms"]:.0f} ms, {found["p99_growth_percent"]:+.0f} %',
            '10 %',
        ],
        [
            'the same growth in units of the fixed calculation',
            f'{found["p99_growth_percent_in_units"]:+.0f} %',
            '10 %',
        ],
    ]


def draw(samples: Samples) -> Any:
    """Draw what was measured over the hours of the stream."""
    figure, axes = make_panels(2, rows=2, height=4.6, sharex=True)
    node, latencies = np.array(samples.node), np.array(samples.latencies)
    hours = node[:, 0] / HOUR_S
    memory, handles, times, lost = axes.flat
    memory.plot(hours, node[:, 1], color=WALK)
    memory.set_ylim(0, 1.2 * node[:, 1].max())
    label_axes(memory, '', 'MB', 'resident memory of the node')
    handles.plot(hours, node[:, 2], color=WALK, label='threads')
    handles.plot(hours, node[:, 3], color=RUN, label='open files')
    handles.set_ylim(0, 1.5 * node[:, 2:4].max())
    handles.legend(loc='lower right')
    label_axes(handles, '', 'number', 'threads and open files')
    bins = (latencies[:, 0] // BIN_S).astype(int)
    middle = [(b + 0.5) * BIN_S / HOUR_S for b in np.unique(bins)]
    for percent, colour in ((50, WALK), (99, RUN)):
        values = [np.percentile(latencies[bins == b, 1], percent) for b in np.unique(bins)]
        times.plot(middle, values, color=colour, label=f'{percent} % of the images')
    times.plot(hours[1:], compute_cpu_ms(node), color=NEUTRAL, linewidth=0.8, label='CPU time for an image')
    times.plot(hours, smooth(np.array(samples.reference)), '--', color=NEUTRAL, label='a fixed calculation')
    times.set_ylim(0, 1.5 * times.dataLim.ymax)  # the legend stands above the curves
    times.legend(loc='upper left', ncols=2)
    label_axes(times, 'hours of the stream', 'ms', 'latency and CPU time, each five minutes of stream')
    total = np.array([sum(t <= h * HOUR_S for t in samples.lost) for h in hours])
    lost.plot(hours, total, color=NEUTRAL)
    lost.set_ylim(-0.5, max(5.0, 1.2 * total.max()))
    label_axes(lost, 'hours of the stream', 'images', 'images without an answer within 2 s, so far')
    return figure


def measure(args: argparse.Namespace, report: Report) -> None:
    stream_s = 60.0 if args.quick else args.hours * HOUR_S
    samples = soak(report, stream_s, 25.0 if args.quick else args.minutes * 60)
    results = {
        k: v for k, v in report.results.items() if isinstance(v, float | int) and k not in ('begun', 'quick')
    }
    report.quantities(results, TARGETS, page='')
    report.keep('soak.targets', ['quantity', 'measured', 'target'], describe(results))
    if not args.quick:
        report.picture(draw(samples), 'docs/img/reliability/soak.png')


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--hours', type=float, default=8.0, help='h of stream (default %(default)s)')
    parser.add_argument(
        '--minutes', type=float, default=600.0, help='time after which to stop (default: %(default)s)'
    )


def main() -> None:
    run(__doc__, 'Soak', measure, add_options, one_core=False)


if __name__ == '__main__':
    main()
