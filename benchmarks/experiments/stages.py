# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Time of one frame in the live node by stage, measured from outside: the functions of the stages are wrapped.

The node of the package runs in this process, in a thread of its own, with recording and with a subscriber of all
outputs. Frames are sent one after another, as fast as they are answered; the stamps are those of a 30 Hz stream. A
wrapper notes the CPU time of its thread at entry and exit. What a wrapped function spends in another wrapped one
counts for the other alone, so the stages add up to the frame.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from experiments.node import TIMEOUT_S, Peer, list_node_parameters

# The function that does all the work of one message in the node. What no stage has of it is 'other'.
FRAME = 'mocap_ros.ros.live:LiveRun._process'
# The functions of each stage, as `module:name`; a name that does not exist is an error.
STAGES: Mapping[str, tuple[str, ...]] = {
    'decode': ('mocap_ros.runtime.pipeline:Pipeline._decode_frames',),
    'associate': (
        'mocap_ros.tracking.tracker:Detection.from_person',
        'mocap_ros.tracking.tracker:match_detections',
    ),
    'swaps': (
        'mocap_ros.tracking.track:SwapFilter.update',
        'mocap_ros.tracking.track:exchange_body_sides',
    ),
    'lift': ('mocap_ros.tracking.tracker:Tracker._lift',),
    'window': ('mocap_ros.tracking.tracker:Track.add_frame', 'mocap_ros.tracking.tracker:build_refinement_window'),
    'solve': ('mocap_ros.tracking.tracker:solve',),
    'results': (
        'mocap_ros.tracking.tracker:Tracker._refine',
        'mocap_ros.tracking.tracker:Tracker._choose_shown',
        'mocap_ros.tracking.tracker:Tracker._filter',
        'mocap_ros.tracking.tracker:Tracker._predict_missing',
        'mocap_ros.tracking.tracker:make_whole_person',
    ),
    'questions': (
        'mocap_ros.tracking.tracker:Tracker._initialise',
        'mocap_ros.tracking.tracker:Tracker.run_deferred_work',
    ),
    'encode': ('mocap_ros.runtime.pipeline:OutputEncoder.encode',),
    'publish': ('mocap_ros.ros.topics:Publishers.publish',),
    'record': (
        'mocap_ros.ros.live_recording:LiveRecording.write_input',
        'mocap_ros.bags.background:Recorder.write',
        'mocap_ros.bags.background:Recorder.flush',
    ),
}
OTHER = 'other'
FIRST_ANSWER_S = 1.0  # s; longer than the first frame of a crowd takes, in which everybody is initialised


class StageTimer:
    """CPU time by stage, over all threads.

    Attributes:
        seconds: CPU time of each stage so far, s.
        finished: released once for each frame that is finished.
    """

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.finished = threading.Semaphore(0)
        self._thread = threading.local()

    def wrap(self, function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        """Return a function that does the same and counts its time for a stage."""

        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            if not hasattr(self._thread, 'stages'):
                self._thread.stages, self._thread.since_s = [], 0.0
            self._switch()
            self._thread.stages.append(stage)
            try:
                return function(*arguments, **named)
            finally:
                self._switch()
                self._thread.stages.pop()
                if stage == OTHER:
                    self.finished.release()

        return timed

    def _switch(self) -> None:
        now_s = time.thread_time()
        if self._thread.stages:
            self.seconds[self._thread.stages[-1]] += now_s - self._thread.since_s
        self._thread.since_s = now_s

    @contextmanager
    def attached(self, stages: Mapping[str, tuple[str, ...]]) -> Iterator[None]:
        """Wrap the functions of some stages, and that of the whole frame, until the end of the context.

        Raises:
            AttributeError: a name does not exist.
        """
        before: list[tuple[Any, str, Any]] = []
        try:
            for stage, names in {**stages, OTHER: (FRAME,)}.items():
                for name in names:
                    owner, attribute = _find_owner(name)
                    found = inspect.getattr_static(owner, attribute)
                    before.append((owner, attribute, found))
                    if isinstance(found, staticmethod):
                        setattr(owner, attribute, staticmethod(self.wrap(found.__func__, stage)))
                    else:
                        setattr(owner, attribute, self.wrap(found, stage))
            yield
        finally:
            for owner, attribute, found in reversed(before):
                setattr(owner, attribute, found)


def _find_owner(name: str) -> tuple[Any, str]:
    """Return the module or class that holds a function, and the function's name in it."""
    module, _, path = name.partition(':')
    *parents, attribute = path.split('.')
    owner = functools.reduce(getattr, parents, importlib.import_module(module))
    if not hasattr(owner, attribute):
        raise AttributeError(f'{name}: the table of stages names a function that does not exist')
    return owner, attribute


@contextmanager
def run_node_in_thread(domain: int, recordings: Path) -> Iterator[None]:
    """Run the node in a thread of this process, with recording."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.impl.logging_severity import LoggingSeverity
    from rclpy.logging import set_logger_level
    from rclpy.signals import SignalHandlerOptions

    from mocap_ros.ros.node import NODE_NAME, MocapNode

    set_logger_level(NODE_NAME, LoggingSeverity.ERROR)
    arguments = ['--ros-args', *list_node_parameters(recordings)]
    rclpy.init(args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = MocapNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.start()
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        node.close()
        node.destroy_node()
        rclpy.shutdown()


def measure_stages(
    domain: int, people: int, frames: int, warm_up: int, stages: Mapping[str, tuple[str, ...]] = STAGES
) -> dict[str, float]:
    """Return the mean CPU time of each stage, ms a frame.

    Args:
        domain: ROS domain.
        people: number of people; all of them appear in the first frame.
        frames: number of frames that count.
        warm_up: number of frames before these, which do not count.
        stages: table of the stages; empty to measure the whole frame alone, as `OTHER`.
    """
    timer = StageTimer()
    with tempfile.TemporaryDirectory() as folder, timer.attached(stages):
        peer = Peer(domain)
        try:
            with run_node_in_thread(domain, Path(folder)):
                peer.subscribe_to_all_outputs()
                peer.wait_for_node()
                messages = peer.encode_stream(people)
                _send_until_answered(peer, next(messages)[1], timer)
                for number in range(1, warm_up + frames):
                    if number == warm_up:
                        timer.seconds.clear()
                    peer.keypoints.publish(next(messages)[1])
                    peer.wait(lambda: timer.finished.acquire(blocking=False))
        finally:
            peer.close()
    return {stage: timer.seconds[stage] / frames * 1e3 for stage in (*stages, OTHER)}


def _send_until_answered(peer: Peer, raw: bytes, timer: StageTimer) -> None:
    """Send the first message until it is processed: a node that is known may not know its peer yet."""
    end = time.monotonic() + TIMEOUT_S
    while not timer.finished.acquire(blocking=False):
        if time.monotonic() > end:
            raise TimeoutError
        peer.keypoints.publish(raw)
        peer.spin_until(time.perf_counter() + FIRST_ANSWER_S)
    while timer.finished.acquire(timeout=FIRST_ANSWER_S):
        pass  # the same message, sent again, was dropped because its stamp repeats
