# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Report the state of a live run as diagnostic_msgs/DiagnosticArray on /diagnostics."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping
from enum import IntEnum

import numpy as np

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
from mocap_ros.ros.throttled_log import make_printable
from mocap_ros.runtime.pipeline import Counters, Pipeline
from mocap_ros.units import NS_PER_S

DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'  # message type
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'  # message type
KEY_VALUE = 'diagnostic_msgs/msg/KeyValue'  # message type
MAX_REMEMBERED_FRAMES = 300  # frames; 10 s at 30 Hz, enough for a 99th percentile
RATE_WINDOW_S = 2.0  # s; long enough for a steady figure, short enough to show a change soon
UNUSABLE_DETECTIONS = (
    'detections were no person in the last second: their scores are below tracker.min_score, '
    'or fewer than six joints are seen'
)


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class RunStatistics:
    """Times of receipt and processing times of the last `MAX_REMEMBERED_FRAMES` messages of people.

    Attributes:
        received: Number of messages of people so far that arrived.
        lost: Number of messages so far that were sent but did not arrive.
        removed: Number of messages so far, of all topics, that left the queue unseen because too many waited.
    """

    def __init__(self) -> None:
        self.received = self.lost = self.removed = 0
        self._reason = ''  # newest one since `take_reason`
        self._received: deque[float] = deque(maxlen=MAX_REMEMBERED_FRAMES)  # s, steady clock
        self._solve_seconds: deque[float] = deque(maxlen=MAX_REMEMBERED_FRAMES)

    def record_receipt(self) -> None:
        """Record that a message has just been received."""
        self.received += 1
        self._received.append(time.monotonic())

    def record_lost(self, count: int) -> None:
        """Record that messages did not arrive."""
        self.lost += count

    def record_removed(self, count: int) -> None:
        """Record that messages were removed from the queue because too many waited."""
        self.removed += count

    def record_reason(self, topic: str, reason: str) -> None:
        """Record why a message of a topic was not accepted."""
        self._reason = make_printable(f'{topic}: {reason}')

    def take_reason(self) -> str:
        """Return the newest reason why a message was not accepted; empty if there is none since the last call."""
        reason, self._reason = self._reason, ''
        return reason

    def record_solve(self, seconds: float) -> None:
        """Record how many seconds the processing of a message took."""
        self._solve_seconds.append(seconds)

    def compute_input_rate(self) -> float:
        """Return the mean number of messages per second over the last `RATE_WINDOW_S` seconds.

        At most the last `MAX_REMEMBERED_FRAMES` messages are counted, which limits the rate that can be returned.
        """
        since = time.monotonic() - RATE_WINDOW_S
        return sum(t > since for t in tuple(self._received)) / RATE_WINDOW_S

    def seconds_since_input(self) -> float:
        """Return the seconds since the last message; infinity before the first."""
        return time.monotonic() - self._received[-1] if self._received else math.inf

    def compute_solve_percentile_ms(self, percent: float) -> float:
        """Return a percentile of the processing times in ms; NaN before the first message.

        Args:
            percent: Percentile to return, 0 to 100.
        """
        solve_seconds = tuple(self._solve_seconds)
        return float(np.percentile(solve_seconds, percent)) * 1e3 if solve_seconds else math.nan


class DiagnosticsReporter:
    """Encoder of the periodic diagnostic status of a run.

    Args:
        name: Name of the node.
        pipeline: Pipeline of the run.
    """

    def __init__(self, name: str, pipeline: Pipeline) -> None:
        self._name = name
        self._pipeline = pipeline
        self._previous_counters = copy_counters(pipeline.counters)  # an earlier run may have counted, too
        self._previous_unusable = pipeline.unusable_people
        self._previous_received = self._previous_removed = 0

    def encode_status(
        self, statistics: RunStatistics, recorder: str, now_ns: int, recorder_fault: str = ''
    ) -> bytes:
        """Encode the current status as a DiagnosticArray; its level depends on what happened since the last call.

        Args:
            statistics: Statistics of the run.
            recorder: State of the recorder in words.
            now_ns: ROS time in ns.
            recorder_fault: What is wrong with the recorder, in words; empty if nothing is.
        """
        pipeline = self._pipeline
        counters, previous = copy_counters(pipeline.counters), self._previous_counters
        received, self._previous_received = statistics.received - self._previous_received, statistics.received
        removed, self._previous_removed = statistics.removed - self._previous_removed, statistics.removed
        unusable_so_far = pipeline.unusable_people
        unusable, self._previous_unusable = unusable_so_far - self._previous_unusable, unusable_so_far
        self._previous_counters = counters
        new_counters = subtract_counters(counters, previous)
        reason = statistics.take_reason()
        people = pipeline.people if new_counters.accepted else ()  # else they are of an earlier second
        residuals = [p.residual for p in people if math.isfinite(p.residual)]
        newest_ns = pipeline.header.stamp_ns  # 0 before the first frame, and after a reset
        age_s = (now_ns - newest_ns) / NS_PER_S if newest_ns else math.nan
        values = {
            'input rate (Hz)': f'{statistics.compute_input_rate():.1f}',
            'age of newest frame (s)': f'{age_s:.3f}',
            'solve time p50 (ms)': f'{statistics.compute_solve_percentile_ms(50):.1f}',
            'solve time p99 (ms)': f'{statistics.compute_solve_percentile_ms(99):.1f}',
            'accepted': counters.accepted,
            'invalid': counters.invalid,
            **{f'dropped: {reason}': n for reason, n in sorted(counters.dropped.items())},
            'dropped: queue full': statistics.removed,
            'lost before the node': statistics.lost,
            'people': len(people),
            'residual (px)': f'{np.mean(residuals):.2f}' if residuals else 'nan',
            'category': ', '.join(sorted({p.motion.category for p in people})),
            'swapped frames': pipeline.swapped_frames,
            'detections that were no person': unusable_so_far,
            'camera': 'from CameraInfo' if pipeline.camera_info is not None else 'nominal focal length',
            'frame of people': make_printable(pipeline.output_header.frame_id),
            'recorder': recorder,
        }
        problems: list[tuple[Level, str]] = []
        if statistics.seconds_since_input() > pipeline.config.node.silence_warning:
            problems.append((Level.STALE, 'no input'))
        else:
            problems += find_refusals(new_counters, received, removed, reason)
        if unusable > 0 and not people:
            problems.append((Level.WARN, f'{unusable} {UNUSABLE_DETECTIONS}'))
        if new_counters.accepted:
            faults = (describe_frame_fault(pipeline), *map(make_printable, pipeline.checks.warnings))
            problems += [(Level.WARN, fault) for fault in faults if fault]
        if recorder_fault:
            problems.append((Level.WARN, recorder_fault))
        level = max((level for level, _ in problems), default=Level.OK)
        message = '; '.join(message for _, message in problems) or f'{len(people)} people'
        return encode_diagnostics(Header(now_ns, ''), self._name, (level, message), values)


def copy_counters(counters: Counters) -> Counters:
    """Return the counters as they are now."""
    return Counters(counters.accepted, counters.invalid, counters.dropped.copy())


def subtract_counters(counters: Counters, previous: Counters) -> Counters:
    """Return what was counted since previous counters."""
    return Counters(
        counters.accepted - previous.accepted,
        counters.invalid - previous.invalid,
        counters.dropped - previous.dropped,
    )


def find_refusals(counters: Counters, received: int, removed: int, reason: str) -> list[tuple[Level, str]]:
    """Return the level and the description of messages that were not accepted; an empty list if all were.

    Args:
        counters: Counters of the messages of the last second.
        received: Number of messages of people that arrived.
        removed: Number of messages that left the queue unseen because too many waited.
        reason: Why the newest of them was not accepted; empty if unknown.
    """
    errors = counters.dropped['internal error']
    counts = {
        'internal errors': errors,
        'invalid': counters.invalid,
        'dropped for their stamps': counters.dropped['stamp'],
        'skipped because of a backlog': counters.dropped['backlog'],
        'removed from a full queue': removed,
    }
    refused = ', '.join(f'{count} {cause}' for cause, count in counts.items() if count)
    if not refused:
        return []
    level, message = Level.WARN, f'{refused} in the last second'
    if errors:
        level, message = Level.ERROR, f'{message}; see the log'
    if reason:
        message = f'{message}; {reason}'
    if received and not counters.accepted:
        level, message = Level.ERROR, f'no message was accepted: {message}'
    return [(level, message)]


def describe_frame_fault(pipeline: Pipeline) -> str:
    """Return that people are not published in `node.output_frame`; empty if they are or nobody was yet."""
    wanted, used = pipeline.config.node.output_frame, pipeline.output_header.frame_id
    if not wanted or used == wanted or not pipeline.header.stamp_ns:
        return ''
    return (
        f'people are published in the frame of the camera, {make_printable(used)!r}, as the transform to '
        f'node.output_frame, {wanted!r}, is unknown; see the log'
    )


def encode_diagnostics(
    header: Header, name: str, level_and_message: tuple[Level, str], values: Mapping[str, object]
) -> bytes:
    """Encode a DiagnosticArray with a single status."""
    level, message = level_and_message
    status = create_message(
        STATUS,
        level=int(level),
        name=name,
        message=message,
        hardware_id='',
        values=list(_create_key_values(values)),
    )
    return encode(create_message(DIAGNOSTICS, header=create_header(header), status=[status]), DIAGNOSTICS)


def _create_key_values(values: Mapping[str, object]) -> Iterable[object]:
    return (create_message(KEY_VALUE, key=key, value=str(value)) for key, value in values.items())
