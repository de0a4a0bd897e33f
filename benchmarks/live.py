"""The live node over real DDS: latency, number of people at 30 Hz, CPU, memory, transitions and termination.

The node runs on one core. This process runs on another core, sends keypoints at 30 Hz and receives the skeletons.
The node publishes and records all outputs.
"""

from __future__ import annotations

import common  # isort: skip

import os
import random
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.bags.reader import Bag
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import MocapError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.units import NS_PER_S

HZ = 30  # Hz, rate of the keypoints
NODE_CORE = min(os.sched_getaffinity(0))  # the core that the node runs on
MAX_PEOPLE = 60  # largest crowd that is tried
IMAGE_SIZE = 3840, 2160  # px, large enough for the crowd side by side
TIMEOUT_S = 20.0  # s; guards against a node that never answers
# States of the node, and the state after each transition (by its number in lifecycle_msgs) that they allow.
LIFECYCLE = {
    'unconfigured': {1: 'inactive'},
    'inactive': {2: 'unconfigured', 3: 'active'},
    'active': {4: 'inactive'},
}
# Targets of the measured values, as printed.
TARGETS = {
    'people_at_30hz': '10 or more',
    'latency_ms_p50_1': '8 or less',
    'latency_ms_p99_1': '25 or less',
    'lifecycle_unclean': '0',
    'sigterm_unclean': '0',
    'sigterm_slowest_s': '1 or less',
}


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


class Peer:
    """A ROS node that sends keypoints and receives skeletons."""

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
        self._stamps = count(1)

    def _note_arrival(self, raw: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', raw, 4)
        self.arrived[seconds * NS_PER_S + nanoseconds] = time.perf_counter()

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def spin_until(self, end: float) -> None:
        while (left := end - time.perf_counter()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def wait(self, condition: Any) -> None:
        end = time.perf_counter() + TIMEOUT_S
        while not condition():
            if time.perf_counter() > end:
                raise TimeoutError
            self.executor.spin_once(timeout_sec=0.02)

    def wait_for_node(self) -> None:
        self.wait(lambda: self.keypoints.get_subscription_count() and self.skeletons.get_publisher_count())

    def call(self, kind: Any, name: str, **request: object) -> Any:
        client: Any = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    def stream(self, people: int, seconds: float, warm_up: float = 2.0) -> tuple[list[float], int]:
        """Stream people at 30 Hz.

        Returns:
            The latencies in ms of the frames after the warm-up, and the number of frames without an answer.
        """
        crowd = make_crowd(people)
        sent: dict[int, float] = {}
        due = time.perf_counter()
        first = (
            next(self._stamps) * 1000 * NS_PER_S
        )  # time jumps forward, so that no person of the last stream is continued
        for number in range(round((warm_up + seconds) * HZ)):
            stamp = first + number * NS_PER_S // HZ
            raw = encode_keypoints(Header(stamp, 'camera'), IMAGE_SIZE, crowd[number % len(crowd)])
            self.spin_until(due)
            sent[stamp] = time.perf_counter()
            self.keypoints.publish(raw)
            due += 1 / HZ
        last = max(sent)
        end = time.perf_counter() + 2.0
        while last not in self.arrived and time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.02)
        counted = list(sent)[round(warm_up * HZ) :]
        answered = [(self.arrived[s] - sent[s]) * 1e3 for s in counted if s in self.arrived]
        return answered, len(counted) - len(answered)


@contextmanager
def run_node(env: dict[str, str], folder: Path, *parameters: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run the node on its core, with recording."""
    given = ('recorder.enabled:=true', f'recorder.folder:={folder}', f'node.max_people:={MAX_PEOPLE}', *parameters)
    options = [word for p in given for word in ('-p', p)]
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', '--log-level', 'error', *options]
    process = subprocess.Popen(command, env=env, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
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


def resident_mb(process: subprocess.Popen[bytes]) -> float:
    found = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{process.pid}/status').read_text())
    return int(found[1]) / 1e3 if found else float('nan')


def measure_load(peer: Peer, env: dict[str, str], root: Path, quick: bool) -> dict[str, float]:
    """Measure latency by number of people, the largest number without dropped frames, CPU and memory."""
    results: dict[str, float] = {}
    sustained, failed = 0, MAX_PEOPLE + 1
    with run_node(env, root / 'load') as process:
        peer.wait_for_node()
        for people in (1, 5, 10, 20):
            cpu, start = measure_usage(process)[0], time.perf_counter()
            latency, missing = peer.stream(people, (4.0 if people == 1 else 1.5) if quick else 20.0)
            share = (measure_usage(process)[0] - cpu) / (time.perf_counter() - start)
            results[f'latency_ms_p50_{people}'] = float(np.percentile(latency, 50)) if latency else float('nan')
            results[f'latency_ms_p99_{people}'] = float(np.percentile(latency, 99)) if latency else float('nan')
            results[f'dropped_percent_{people}'] = 100 * missing / (len(latency) + missing)
            results[f'cpu_percent_{people}'] = 100 * share
            sustained, failed = (people, failed) if not missing else (sustained, min(failed, people))
        for _ in range(1 if quick else 6):
            people = (sustained + failed) // 2 if failed <= MAX_PEOPLE else min(2 * sustained, MAX_PEOPLE)
            if people in (sustained, failed):
                break
            _, missing = peer.stream(people, 1.5 if quick else 60.0)
            sustained, failed = (people, failed) if not missing else (sustained, people)
        results['people_at_30hz'] = sustained
        results['sustained_s'] = 1.5 if quick else 60.0
        if not quick:
            results |= measure_memory_growth(peer, process)
        results['peak_mb'] = measure_usage(process)[1]
    return results


def measure_memory_growth(peer: Peer, process: subprocess.Popen[bytes], minutes: int = 10) -> dict[str, float]:
    levels = []
    for _ in range(minutes):
        peer.stream(2, 59.0)
        levels.append(resident_mb(process))
    return {'memory_growth_mb': levels[-1] - levels[1], 'memory_minutes': minutes}


def measure_lifecycles(peer: Peer, env: dict[str, str], root: Path, sequences: int) -> dict[str, float]:
    """Send random transitions and keypoints, and count the sequences that go wrong."""
    from lifecycle_msgs.srv import ChangeState, GetState

    rng = random.Random(0)
    unclean, state = 0, 'active'
    crowd = make_crowd(1)
    with run_node(env, root / 'lifecycles', 'tracker.model:=walk') as process:
        peer.wait_for_node()
        threads = []
        for number in range(sequences):
            try:
                for _ in range(rng.randint(1, 6)):
                    transition, state = rng.choice(list(LIFECYCLE[state].items()))
                    request = ChangeState.Request()
                    request.transition.id = transition
                    done = peer.call(ChangeState, 'mocap_node/change_state', transition=request.transition)
                    if not done.success:
                        raise AssertionError
                    peer.keypoints.publish(
                        encode_keypoints(Header(number * NS_PER_S, 'camera'), IMAGE_SIZE, crowd[0])
                    )
                if peer.call(GetState, 'mocap_node/get_state').current_state.label != state:
                    raise AssertionError
            except (AssertionError, TimeoutError):
                unclean += 1
            status = Path(f'/proc/{process.pid}/status').read_text()
            found = re.search(r'Threads:\s+(\d+)', status)
            threads.append(int(found[1]) if found else 0)
        grown = max(threads[len(threads) // 2 :]) - max(threads[: len(threads) // 2 + 1])
    unclean += count_unreadable_bags(root / 'lifecycles')
    return {'lifecycle_sequences': sequences, 'lifecycle_unclean': unclean, 'lifecycle_threads_grown': grown}


def count_unreadable_bags(folder: Path) -> int:
    """Count the bags in a folder that cannot be read."""
    return sum(not is_readable(bag) for bag in folder.iterdir()) if folder.is_dir() else 0


def is_readable(bag: Path) -> bool:
    try:
        with Bag(bag) as opened:
            return opened.count(opened.topics) >= 0
    except MocapError:
        return False


def measure_sigterm(peer: Peer, env: dict[str, str], root: Path, trials: int) -> dict[str, float]:
    """Send SIGTERM at random times while keypoints arrive, and count the runs that end badly."""
    rng = random.Random(1)
    unclean, slowest = 0, 0.0
    crowd = make_crowd(3)
    for trial in common.show_progress(range(trials), 'SIGTERM', trials):
        folder = root / f'ending{trial}'
        with run_node(env, folder) as process:
            peer.wait(peer.keypoints.get_subscription_count)
            end = time.perf_counter() + rng.uniform(0.0, 1.0)
            for number in count():
                raw = encode_keypoints(
                    Header(number * NS_PER_S // HZ, 'camera'), IMAGE_SIZE, crowd[number % len(crowd)]
                )
                peer.keypoints.publish(raw)
                peer.spin_until(time.perf_counter() + 1 / HZ)
                if time.perf_counter() > end:
                    break
            process.send_signal(signal.SIGTERM)
            requested_at = time.perf_counter()
            try:
                code = process.wait(5.0)
            except subprocess.TimeoutExpired:
                code = -1
            slowest = max(slowest, time.perf_counter() - requested_at)
        unclean += code != 0 or bool(count_unreadable_bags(folder))
        peer.wait(lambda: not peer.keypoints.get_subscription_count())
    return {'sigterm_trials': trials, 'sigterm_unclean': unclean, 'sigterm_slowest_s': slowest}


def make_rows(results: dict[str, float]) -> Sequence[tuple[object, ...]]:
    return [(key, f'{value:.3g}', TARGETS.get(key)) for key, value in results.items()]


def main() -> None:
    args = common.parse_arguments(__doc__ or '')
    domain = random.SystemRandom().randrange(1, 100)
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    env = dict(os.environ)
    print(f'# The live node\n\n{common.describe_machine()}\n')
    peer = Peer(domain)
    try:
        with tempfile.TemporaryDirectory() as name:
            root = Path(name)
            results = {
                **measure_load(peer, env, root, args.quick),
                **measure_lifecycles(peer, env, root, 3 if args.quick else 100),
                **measure_sigterm(peer, env, root, 2 if args.quick else 100),
            }
    finally:
        peer.close()
    print(common.format_table(['quantity', 'measured', 'target'], make_rows(results)))
    common.write_json(args.json, {'machine': common.describe_machine(), **results})


if __name__ == '__main__':
    main()
