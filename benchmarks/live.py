"""The live node over real DDS: growth of its memory, transitions and termination; `engine.py` measures its speed.

The node runs on one core. This process runs on another core, sends keypoints at 30 Hz and receives the skeletons.
The node publishes and records all outputs.
"""

from __future__ import annotations

import common  # isort: skip

import random
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from itertools import count
from pathlib import Path

from experiments.node import HZ, IMAGE_SIZE, Peer, choose_domain, make_crowd, run_node

from mocap_ros.bags.reader import Bag
from mocap_ros.errors import MocapError
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import encode_keypoints
from mocap_ros.units import NS_PER_S

# States of the node, and the state after each transition (by its number in lifecycle_msgs) that they allow.
LIFECYCLE = {
    'unconfigured': {1: 'inactive'},
    'inactive': {2: 'unconfigured', 3: 'active'},
    'active': {4: 'inactive'},
}
# Targets of the measured values, as printed.
TARGETS = {
    'lifecycle_unclean': '0',
    'sigterm_unclean': '0',
    'sigterm_slowest_s': '1 or less',
}


def resident_mb(process: subprocess.Popen[bytes]) -> float:
    found = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{process.pid}/status').read_text())
    return int(found[1]) / 1e3 if found else float('nan')


def measure_memory_growth(peer: Peer, root: Path, minutes: int) -> dict[str, float]:
    levels = []
    with run_node(root / 'memory') as process:
        peer.wait_for_node()
        for _ in range(minutes):
            peer.stream(2, 59.0)
            levels.append(resident_mb(process))
    return {'memory_growth_mb': levels[-1] - levels[1], 'memory_minutes': minutes}


def measure_lifecycles(peer: Peer, root: Path, sequences: int) -> dict[str, float]:
    """Send random transitions and keypoints, and count the sequences that go wrong."""
    from lifecycle_msgs.srv import ChangeState, GetState

    rng = random.Random(0)
    unclean, state = 0, 'active'
    crowd = make_crowd(1)
    with run_node(root / 'lifecycles', 'tracker.model:=walk') as process:
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


def measure_sigterm(peer: Peer, root: Path, trials: int) -> dict[str, float]:
    """Send SIGTERM at random times while keypoints arrive, and count the runs that end badly."""
    rng = random.Random(1)
    unclean, slowest = 0, 0.0
    crowd = make_crowd(3)
    for trial in common.show_progress(range(trials), 'SIGTERM', trials):
        folder = root / f'ending{trial}'
        with run_node(folder) as process:
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
    peer = Peer(choose_domain())
    print(f'# The live node\n\n{common.describe_machine()}\n')
    try:
        with tempfile.TemporaryDirectory() as name:
            root = Path(name)
            results = {
                **({} if args.quick else measure_memory_growth(peer, root, 10)),
                **measure_lifecycles(peer, root, 3 if args.quick else 100),
                **measure_sigterm(peer, root, 2 if args.quick else 100),
            }
    finally:
        peer.close()
    print(common.format_table(['quantity', 'measured', 'target'], make_rows(results)))
    common.write_json(args.json, {'machine': common.describe_machine(), **results})


if __name__ == '__main__':
    main()
