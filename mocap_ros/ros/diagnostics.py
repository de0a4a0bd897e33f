# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Report the state of a live run as diagnostic_msgs/DiagnosticArray on /diagnostics."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from enum import IntEnum

import numpy as np

from mocap_ros.errors import make_printable_line
from mocap_ros.findings import UNUSABLE
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.plain import encode_plain
from mocap_ros.ros.throttled_log import MAX_LINE_LENGTH
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.units import NS_PER_S

DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'  # message type
DIAGNOSTICS_TOPIC = '/diagnostics'
MAX_REMEMBERED_FRAMES = 300  # frames; 10 s at 30 Hz, enough for a 99th percentile
RATE_WINDOW_S = 2.0  # s; long enough for a steady figure, short enough to show a change soon


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class RunStatistics:
    """What a run counts and measures besides the pipeline's counters."""

    def __init__(self) -> None:
        self.received = 0  # messages of people so far that arrived
        self.lost = 0  # messages so far that were sent but did not arrive
        self.removed = 0  # messages so far, of all topics, that left the queue unseen because too many waited
        self.reason = ''  # why the newest message was refused that was; empty once it has been reported
        self.solve_seconds: deque[float] = deque(maxlen=MAX_REMEMBERED_FRAMES)  # of the newest images
        self._received: deque[float] = deque(maxlen=MAX_REMEMBERED_FRAMES)  # s, steady clock

    def record_receipt(self) -> None:
        """Record that a message of people has just been received."""
        self.received += 1
        self._received.append(time.monotonic())

    def compute_input_rate(self) -> float:
        """Return the messages per second over `RATE_WINDOW_S`, of at most the last `MAX_REMEMBERED_FRAMES`."""
        since = time.monotonic() - RATE_WINDOW_S
        return sum(t > since for t in tuple(self._received)) / RATE_WINDOW_S

    def seconds_since_input(self) -> float:
        """Return the seconds since the last message; infinity before the first."""
        return time.monotonic() - self._received[-1] if self._received else math.inf


class DiagnosticsReporter:
    """Encoder of the periodic diagnostic status of the run of a node of this name."""

    def __init__(self, name: str, pipeline: Pipeline, statistics: RunStatistics) -> None:
        self._name = name
        self._pipeline = pipeline
        self._statistics = statistics
        self._previous = self._count()  # an earlier run may have counted, too

    def encode_status(self, recorder: str, now_ns: int, recorder_fault: str = '') -> bytes:
        """Encode the current status as a DiagnosticArray; its level depends on what happened since the last call.

        What the recorder does, and what is wrong with it if anything is, are in words.
        """
        pipeline, statistics = self._pipeline, self._statistics
        counts = self._count()
        # negative differences, after a reset, are left out
        new = counts - self._previous
        self._previous = counts
        reason = make_printable_line(statistics.reason, MAX_LINE_LENGTH)
        statistics.reason = ''
        people = pipeline.people if new['accepted'] else ()  # else they are of an earlier second
        residuals = [p.reprojection_residual for p in people if math.isfinite(p.reprojection_residual)]
        newest_ns = pipeline.header.stamp_ns  # 0 before the first frame, and after a reset
        age_s = (now_ns - newest_ns) / NS_PER_S if newest_ns else math.nan
        median_ms, slowest_ms = np.percentile(tuple(statistics.solve_seconds) or math.nan, (50, 99)) * 1e3
        values = {
            'input rate (Hz)': f'{statistics.compute_input_rate():.1f}',
            'age of newest frame (s)': f'{age_s:.3f}',
            'solve time p50 (ms)': f'{median_ms:.1f}',
            'solve time p99 (ms)': f'{slowest_ms:.1f}',
            'accepted': counts['accepted'],
            'invalid': counts['invalid'],
            **{f'dropped: {cause}': counts[cause] for cause in sorted(pipeline.counters.dropped.copy())},
            'dropped: queue full': counts['removed'],
            'lost before the node': statistics.lost,
            'people': len(people),
            'residual (px)': f'{np.mean(residuals):.2f}' if residuals else 'nan',
            'category': ', '.join(sorted({p.motion.category for p in people})),
            'swapped frames': pipeline.swapped_frames,
            'detections that were no person': counts['unusable'],
            'summary': str(pipeline.summary.summarise()),
            'focal length': pipeline.focal_source,
            'frame of people': make_printable_line(pipeline.output_header.frame_id),
            'recorder': recorder,
        }
        warnings = [recorder_fault]
        if new['unusable'] and not people:
            warnings.insert(0, f'{new["unusable"]} detections were no person in the last second: {UNUSABLE}')
        if new['accepted']:
            warnings += [_describe_frame_fault(pipeline), *map(make_printable_line, pipeline.checks.warnings)]
        problems = [(Level.WARN, warning) for warning in warnings if warning]
        if statistics.seconds_since_input() > pipeline.config.node.silence_warning:
            problems.insert(0, (Level.STALE, 'no input'))
        elif refusals := _describe_refusals(new, reason):
            problems.insert(0, refusals)
        status = {
            'level': max((level for level, _ in problems), default=Level.OK),
            'name': self._name,
            'message': '; '.join(message for _, message in problems) or f'{len(people)} people',
            'values': [(key, str(value)) for key, value in values.items()],
        }
        return encode_plain({'header': Header(now_ns, ''), 'status': [status]}, DIAGNOSTICS)

    def _count(self) -> Counter[str]:
        counters = self._pipeline.counters
        statistics = self._statistics
        own = {'received': statistics.received, 'removed': statistics.removed, 'accepted': counters.accepted}
        others = {'unusable': self._pipeline.unusable_people, 'invalid': counters.invalid}
        return Counter(own | others | counters.dropped)


def _describe_refusals(new: Counter[str], reason: str) -> tuple[Level, str] | None:
    counts = {
        'internal errors': new['internal error'],
        'invalid': new['invalid'],
        'dropped for their stamps': new['stamp'],
        'skipped because of a backlog': new['backlog'],
        'removed from a full queue': new['removed'],
    }
    refused = ', '.join(f'{count} {cause}' for cause, count in counts.items() if count)
    if not refused:
        return None
    level, message = Level.WARN, f'{refused} in the last second'
    if new['internal error']:
        level, message = Level.ERROR, f'{message}; see the log'
    if reason:
        message = f'{message}; {reason}'
    if new['received'] and not new['accepted']:
        level, message = Level.ERROR, f'no message was accepted: {message}'
    return level, message


def _describe_frame_fault(pipeline: Pipeline) -> str:
    """Return that people are not published in `node.output_frame`; empty if they are or there were none."""
    wanted, used = pipeline.config.node.output_frame, pipeline.output_header.frame_id
    if not wanted or used == wanted or not pipeline.header.stamp_ns:
        return ''
    return (
        f'people are published in the frame of the camera, {make_printable_line(used)!r}, as the transform to '
        f'node.output_frame, {wanted!r}, is unknown; see the log'
    )
