"""How a live run is doing, as /diagnostics tells it."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping
from enum import IntEnum

import numpy as np

from mocap_ros.messages.cdr import NS, Header, encode, new, new_header
from mocap_ros.runtime.pipeline import Counters, Pipeline

DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
KEY_VALUE = 'diagnostic_msgs/msg/KeyValue'
REMEMBERED = 300


class Level(IntEnum):
    """As in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Pulse:
    """Counts and times of the recent past; `REMEMBERED` frames of it."""

    def __init__(self) -> None:
        self._received: deque[float] = deque(maxlen=REMEMBERED)
        self._solved: deque[float] = deque(maxlen=REMEMBERED)

    def receive(self) -> None:
        """A message of people has come."""
        self._received.append(time.monotonic())

    def solve(self, seconds: float) -> None:
        """A message has been dealt with, in so many s."""
        self._solved.append(seconds)

    def rate(self, over: float = 2.0) -> float:
        """Messages a second, in the last `over` s."""
        since = time.monotonic() - over
        return sum(t > since for t in tuple(self._received)) / over

    def silence(self) -> float:
        """Seconds since the last message; infinite before the first."""
        return time.monotonic() - self._received[-1] if self._received else math.inf

    def solve_ms(self, percent: float) -> float:
        """This percentile of the time a message took, ms; NaN before the first."""
        solved = tuple(self._solved)
        return float(np.percentile(solved, percent)) * 1e3 if solved else math.nan


class Doctor:
    """Makes a status of a run once in a while.

    Args:
        name: of the node.
        silence: s without input that are too long.
    """

    def __init__(self, name: str, silence: float) -> None:
        self._name = name
        self._silence = silence
        self._before = Counters()

    def examine(self, pipeline: Pipeline, pulse: Pulse, recorder: str, now_ns: int) -> bytes:
        """A DiagnosticArray.

        Args:
            pipeline: of the run.
            pulse: of the run.
            recorder: what it is doing, in words.
            now_ns: ROS time.
        """
        counters, before = pipeline.counters, self._before
        lost = counters.dropped['backlog'] - before.dropped['backlog']
        wrong = counters.invalid - before.invalid
        faults = counters.dropped['internal error'] - before.dropped['internal error']
        self._before = Counters(counters.accepted, counters.invalid, counters.dropped.copy())
        people = pipeline.people
        residuals = [p.residual for p in people if math.isfinite(p.residual)]
        age = (now_ns - pipeline.header.stamp_ns) / NS if counters.accepted else math.nan
        said = {
            'input rate (Hz)': f'{pulse.rate():.1f}',
            'age of newest frame (s)': f'{age:.3f}',
            'solve time p50 (ms)': f'{pulse.solve_ms(50):.1f}',
            'solve time p99 (ms)': f'{pulse.solve_ms(99):.1f}',
            'accepted': counters.accepted,
            'invalid': counters.invalid,
            **{f'dropped: {reason}': n for reason, n in sorted(counters.dropped.items())},
            'people': len(people),
            'residual (px)': f'{np.mean(residuals):.2f}' if residuals else 'nan',
            'category': ', '.join(sorted({p.motion.category for p in people})),
            'swapped frames': pipeline.swapped_frames,
            'people of whom too little was seen': pipeline.unusable_people,
            'camera': 'from CameraInfo' if pipeline.camera_info is not None else 'nominal focal length',
            'recorder': recorder,
        }
        level, message = Level.OK, f'{len(people)} people'
        if pulse.silence() > self._silence:
            level, message = Level.STALE, 'no input'
        elif faults:
            level, message = Level.ERROR, f'{faults} internal errors, see the log'
        elif lost or wrong:
            level = Level.WARN
            message = f'{lost} messages passed over, {wrong} invalid in the last second'
        return encode_diagnostics(Header(now_ns, ''), self._name, (level, message), said)


def encode_diagnostics(
    header: Header, name: str, status: tuple[Level, str], values: Mapping[str, object]
) -> bytes:
    """A DiagnosticArray with one status."""
    one = new(
        STATUS,
        level=int(status[0]),
        name=name,
        message=status[1],
        hardware_id='',
        values=list(_pairs(values.items())),
    )
    return encode(new(DIAGNOSTICS, header=new_header(header), status=[one]), DIAGNOSTICS)


def _pairs(items: Iterable[tuple[str, object]]) -> Iterable[object]:
    return (new(KEY_VALUE, key=key, value=str(value)) for key, value in items)
