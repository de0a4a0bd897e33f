"""The live node over real DDS: latency, people it keeps up with, CPU, memory, and how it starts and ends.

The node has one core for itself, this process another: it sends keypoints at 30 Hz and receives the skeletons. All
outputs are published and recorded.
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
from mocap_ros.messages.cdr import NS, Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS

HZ = 30
CORE = min(os.sched_getaffinity(0))
CROWD = 60
SIZE = 3840, 2160
PATIENCE = 20.0
LIFECYCLE = {
    'unconfigured': {1: 'inactive'},
    'inactive': {2: 'unconfigured', 3: 'active'},
    'active': {4: 'inactive'},
}
TARGETS = {
    'people_at_30hz': '10 or more',
    'latency_ms_p50_1': '8 or less',
    'latency_ms_p99_1': '25 or less',
    'lifecycle_unclean': '0',
    'sigterm_unclean': '0',
    'sigterm_slowest_s': '1 or less',
}


def frames(people: int) -> list[tuple[Person2D, ...]]:
    """The demo recording with so many people, side by side."""
    recording = make_recording()
    sequence = recording.sequence()
    shifts = [np.array([300.0 * (n % 12), 400.0 * (n // 12)]) for n in range(people)]
    crowd = []
    for frame in range(len(sequence.stamps_ns)):
        one = sequence.person(frame)
        crowd.append(tuple(Person2D(f'p{n}', one.joints, one.points + s, one.score) for n, s in enumerate(shifts)))
    return crowd


class Peer:
    """Sends and receives."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile
        from rclpy.signals import SignalHandlerOptions

        from mocap_ros.ros.message_types import interface_class

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('benchmark', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.arrived: dict[int, float] = {}
        self.skeletons = self.node.create_subscription(
            interface_class(SKELETONS), 'skeletons', self._take, QoSProfile(depth=1000), raw=True
        )
        self.keypoints = self.node.create_publisher(interface_class(KEYPOINTS), 'keypoints', 10)
        self._stamps = count(1)

    def _take(self, raw: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', raw, 4)
        self.arrived[seconds * NS + nanoseconds] = time.perf_counter()

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def spin_until(self, end: float) -> None:
        while (left := end - time.perf_counter()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def wait(self, what: Any) -> None:
        end = time.perf_counter() + PATIENCE
        while not what():
            if time.perf_counter() > end:
                raise TimeoutError
            self.executor.spin_once(timeout_sec=0.02)

    def wait_for_node(self) -> None:
        self.wait(lambda: self.keypoints.get_subscription_count() and self.skeletons.get_publisher_count())

    def call(self, kind: Any, name: str, **request: object) -> Any:
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    def stream(self, people: int, seconds: float, warm_up: float = 2.0) -> tuple[list[float], int]:
        """Latencies in ms of the frames answered behind the warm-up, and how many were not."""
        crowd = frames(people)
        sent: dict[int, float] = {}
        due = time.perf_counter()
        first = next(self._stamps) * 1000 * NS  # time leaps: everybody is new
        for number in range(round((warm_up + seconds) * HZ)):
            stamp = first + number * NS // HZ
            raw = encode_keypoints(Header(stamp, 'camera'), SIZE, crowd[number % len(crowd)])
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
def node(env: dict[str, str], folder: Path, *parameters: str) -> Iterator[subprocess.Popen[bytes]]:
    """The node on its core, recording."""
    given = ('recorder.enabled:=true', f'recorder.folder:={folder}', f'node.max_people:={CROWD}', *parameters)
    options = [word for p in given for word in ('-p', p)]
    command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', '--log-level', 'error', *options]
    process = subprocess.Popen(command, env=env, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    os.sched_setaffinity(process.pid, {CORE})
    try:
        yield process
    finally:
        process.terminate()  # killed, it would seem alive to discovery for long
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()


def used(process: subprocess.Popen[bytes]) -> tuple[float, float]:
    """CPU seconds, and peak memory in MB."""
    fields = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    status = Path(f'/proc/{process.pid}/status').read_text()
    peak = re.search(r'VmHWM:\s+(\d+)', status)
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf('SC_CLK_TCK'), int(peak[1]) / 1e3 if peak else float('nan')


def resident_mb(process: subprocess.Popen[bytes]) -> float:
    found = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{process.pid}/status').read_text())
    return int(found[1]) / 1e3 if found else float('nan')


def load(peer: Peer, env: dict[str, str], root: Path, quick: bool) -> dict[str, float]:
    """Latency by people, how many are kept up with, CPU and memory."""
    results: dict[str, float] = {}
    kept, failed = 0, CROWD + 1
    with node(env, root / 'load') as process:
        peer.wait_for_node()
        for people in (1, 5, 10, 20):
            cpu, begun = used(process)[0], time.perf_counter()
            latency, missing = peer.stream(people, (4.0 if people == 1 else 1.5) if quick else 20.0)
            share = (used(process)[0] - cpu) / (time.perf_counter() - begun)
            results[f'latency_ms_p50_{people}'] = float(np.percentile(latency, 50)) if latency else float('nan')
            results[f'latency_ms_p99_{people}'] = float(np.percentile(latency, 99)) if latency else float('nan')
            results[f'dropped_percent_{people}'] = 100 * missing / (len(latency) + missing)
            results[f'cpu_percent_{people}'] = 100 * share
            kept, failed = (people, failed) if not missing else (kept, min(failed, people))
        for _ in range(1 if quick else 6):
            people = (kept + failed) // 2 if failed <= CROWD else min(2 * kept, CROWD)
            if people in (kept, failed):
                break
            _, missing = peer.stream(people, 1.5 if quick else 60.0)
            kept, failed = (people, failed) if not missing else (kept, people)
        results['people_at_30hz'] = kept
        results['sustained_s'] = 1.5 if quick else 60.0
        if not quick:
            results |= memory_over_time(peer, process)
        results['peak_mb'] = used(process)[1]
    return results


def memory_over_time(peer: Peer, process: subprocess.Popen[bytes], minutes: int = 10) -> dict[str, float]:
    levels = []
    for _ in range(minutes):
        peer.stream(2, 59.0)
        levels.append(resident_mb(process))
    return {'memory_growth_mb': levels[-1] - levels[1], 'memory_minutes': minutes}


def lifecycles(peer: Peer, env: dict[str, str], root: Path, sequences: int) -> dict[str, float]:
    """Random transitions with keypoints among them."""
    from lifecycle_msgs.srv import ChangeState, GetState

    rng = random.Random(0)
    unclean, state = 0, 'active'
    crowd = frames(1)
    with node(env, root / 'lifecycles', 'tracker.model:=walk') as process:
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
                    peer.keypoints.publish(encode_keypoints(Header(number * NS, 'camera'), SIZE, crowd[0]))
                if peer.call(GetState, 'mocap_node/get_state').current_state.label != state:
                    raise AssertionError
            except (AssertionError, TimeoutError):
                unclean += 1
            status = Path(f'/proc/{process.pid}/status').read_text()
            found = re.search(r'Threads:\s+(\d+)', status)
            threads.append(int(found[1]) if found else 0)
        grown = max(threads[len(threads) // 2 :]) - max(threads[: len(threads) // 2 + 1])
    unclean += unfinished(root / 'lifecycles')
    return {'lifecycle_sequences': sequences, 'lifecycle_unclean': unclean, 'lifecycle_threads_grown': grown}


def unfinished(folder: Path) -> int:
    """Bags that cannot be read."""
    return sum(not readable(bag) for bag in folder.iterdir()) if folder.is_dir() else 0


def readable(bag: Path) -> bool:
    try:
        with Bag(bag) as opened:
            return opened.count(opened.topics) >= 0
    except MocapError:
        return False


def endings(peer: Peer, env: dict[str, str], root: Path, trials: int) -> dict[str, float]:
    """SIGTERM at random moments while keypoints come."""
    rng = random.Random(1)
    unclean, slowest = 0, 0.0
    crowd = frames(3)
    for trial in common.progress(range(trials), 'SIGTERM', trials):
        folder = root / f'ending{trial}'
        with node(env, folder) as process:
            peer.wait(peer.keypoints.get_subscription_count)
            end = time.perf_counter() + rng.uniform(0.0, 1.0)
            for number in count():
                raw = encode_keypoints(Header(number * NS // HZ, 'camera'), SIZE, crowd[number % len(crowd)])
                peer.keypoints.publish(raw)
                peer.spin_until(time.perf_counter() + 1 / HZ)
                if time.perf_counter() > end:
                    break
            process.send_signal(signal.SIGTERM)
            asked = time.perf_counter()
            try:
                code = process.wait(5.0)
            except subprocess.TimeoutExpired:
                code = -1
            slowest = max(slowest, time.perf_counter() - asked)
        unclean += code != 0 or bool(unfinished(folder))
        peer.wait(lambda: not peer.keypoints.get_subscription_count())
    return {'sigterm_trials': trials, 'sigterm_unclean': unclean, 'sigterm_slowest_s': slowest}


def rows(results: dict[str, float]) -> Sequence[tuple[object, ...]]:
    return [(key, f'{value:.3g}', TARGETS.get(key)) for key, value in results.items()]


def main() -> None:
    args = common.arguments(__doc__ or '')
    domain = random.SystemRandom().randrange(1, 100)
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    env = dict(os.environ)
    print(f'# The live node\n\n{common.machine()}\n')
    peer = Peer(domain)
    try:
        with tempfile.TemporaryDirectory() as name:
            root = Path(name)
            results = {
                **load(peer, env, root, args.quick),
                **lifecycles(peer, env, root, 3 if args.quick else 100),
                **endings(peer, env, root, 2 if args.quick else 100),
            }
    finally:
        peer.close()
    print(common.table(['what', 'measured', 'target'], rows(results)))
    common.write_json(args.json, {'machine': common.machine(), **results})


if __name__ == '__main__':
    main()
