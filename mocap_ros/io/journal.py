"""What happened in a run, kept in its bag, so that a replay can do the same again.

A recorded run holds every input as it came, every output, and on the topic `<node>/journal` one
diagnostic_msgs/DiagnosticStatus for each input and for whatever else changed the tracker:

    name         message              level                         values
    input        reason, or empty     OK, WARN, ERROR or STALE      input: number of the input
    reset        empty                OK                            input: number of the last input before it
    parameters   empty                OK                            the same, and every parameter as JSON

Inputs are counted from 1 over all input topics, in the order of their log times.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from mocap_ros.config import Value
from mocap_ros.errors import InputError
from mocap_ros.io.messages import decode, encode, new
from mocap_ros.io.recorder import Recorder

JOURNAL = 'diagnostic_msgs/msg/DiagnosticStatus'
KEY_VALUE = 'diagnostic_msgs/msg/KeyValue'

INPUT, RESET, PARAMETERS = 'input', 'reset', 'parameters'


class Verdict(IntEnum):
    """What became of an input; the values are the levels of DiagnosticStatus."""

    ACCEPTED = 0
    DROPPED = 1
    INVALID = 2
    OVERTAKEN = 3


@dataclass(frozen=True)
class Entry:
    """One line of the journal.

    Attributes:
        kind: `input`, `reset` or `parameters`.
        number: of the input, or of the last input before.
        verdict: on the input.
        reason: why it was not accepted.
        parameters: values by name.
        topic: of the input.
    """

    kind: str
    number: int
    verdict: Verdict = Verdict.ACCEPTED
    reason: str = ''
    topic: str = ''
    parameters: Mapping[str, Value] = field(default_factory=dict)


def encode_entry(entry: Entry) -> bytes:
    """As DiagnosticStatus."""
    values = {'input': entry.number, **entry.parameters}
    message = new(
        JOURNAL,
        level=int(entry.verdict),
        name=entry.kind,
        message=entry.reason,
        hardware_id=entry.topic,
        values=[new(KEY_VALUE, key=k, value=json.dumps(v)) for k, v in values.items()],
    )
    return encode(message, JOURNAL)


def decode_entry(raw: bytes) -> Entry:
    """From a DiagnosticStatus.

    Raises:
        InputError: it is no line of a journal.
    """
    message = decode(raw, JOURNAL)
    try:
        values = {v.key: json.loads(v.value) for v in message.values}
        number = int(values.pop('input'))
        verdict = Verdict(message.level)
    except (KeyError, TypeError, ValueError):
        raise InputError('not a line of a journal') from None
    return Entry(message.name, number, verdict, message.message, message.hardware_id, values)


class Journal:
    """Writes a run into a bag.

    Args:
        recorder: of the bag; closed by the owner of the journal.
        topic: absolute name of the journal.
    """

    def __init__(self, recorder: Recorder, topic: str) -> None:
        self._recorder = recorder
        self._topic = topic
        self._inputs = 0

    def input(
        self,
        topic: str,
        msgtype: str,
        raw: bytes,
        times_ns: tuple[int, int],
        verdict: Verdict,
        reason: str = '',
    ) -> None:
        """Record an input and what became of it.

        Args:
            topic: absolute name.
            msgtype: of the input.
            raw: as it came.
            times_ns: of receipt, and at which the sender sent it.
            verdict: what became of it.
            reason: why it was not accepted.

        Raises:
            RecordingError: the disk is full or fails.
        """
        self._inputs += 1
        self._recorder.write(topic, msgtype, raw, *times_ns)
        self._write(Entry(INPUT, self._inputs, verdict, reason, topic), times_ns[0])

    def reset(self, log_time_ns: int) -> None:
        """Record that the tracker was reset."""
        self._write(Entry(RESET, self._inputs), log_time_ns)

    def parameters(self, values: Mapping[str, Value], log_time_ns: int) -> None:
        """Record the parameters from here on."""
        self._write(Entry(PARAMETERS, self._inputs, parameters=values), log_time_ns)

    def _write(self, entry: Entry, log_time_ns: int) -> None:
        data = encode_entry(entry)
        self._recorder.write(self._topic, JOURNAL, data, log_time_ns, log_time_ns)
