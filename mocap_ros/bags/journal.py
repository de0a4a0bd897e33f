"""What happened in a run, kept in its bag, so that a replay can do the same again.

A recorded run holds every input as it came, every output, and on the topic `<node>/journal` one
diagnostic_msgs/DiagnosticStatus for each input and for whatever else changed the tracker:

    name         message              level                         values
    input        reason, or empty     OK, WARN, ERROR or STALE      input: number of the input
    reset        empty                OK                            input: number of the last input before it
    parameters   empty                OK                            the same, and every parameter as JSON
    lost         empty                OK                            the same; lost: inputs not recorded here

Inputs are counted from 1 over all input topics, in the order of their log times. Inputs are lost where the disk is
too slow; they went to the tracker all the same.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Record
from mocap_ros.config import Value
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import decode, encode, new

JOURNAL = 'diagnostic_msgs/msg/DiagnosticStatus'
KEY_VALUE = 'diagnostic_msgs/msg/KeyValue'

INPUT, RESET, PARAMETERS, LOST = 'input', 'reset', 'parameters', 'lost'


class Verdict(IntEnum):
    """What became of an input; the values are the levels of DiagnosticStatus."""

    ACCEPTED = 0
    DROPPED = 1
    INVALID = 2
    BACKLOG = 3


@dataclass(frozen=True)
class Entry:
    """One line of the journal.

    Attributes:
        kind: `input`, `reset`, `parameters` or `lost`.
        number: of the input, or of the last input before.
        verdict: on the input.
        reason: why it was not accepted.
        parameters: values by name; of `lost`, how many.
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
        int(values.get(LOST, 0))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        raise InputError('not a line of a journal') from None
    return Entry(message.name, number, verdict, message.message, message.hardware_id, values)


class Journal:
    """What to record of a run.

    Args:
        topic: absolute name of the journal.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._inputs = self._lost = self._told = 0

    def input(
        self,
        topic: str,
        msgtype: str,
        raw: bytes,
        times_ns: tuple[int, int],
        verdict: Verdict,
        reason: str = '',
    ) -> list[Record]:
        """An input and what became of it.

        Args:
            topic: absolute name.
            msgtype: of the input.
            raw: as it came.
            times_ns: of receipt, and at which the sender sent it.
            verdict: what became of it.
            reason: why it was not accepted.
        """
        lost = Entry(LOST, self._inputs, parameters={LOST: self._lost})
        before = [self._record(lost, times_ns[0])] if self._lost else []
        self._told, self._lost = self._lost, 0
        self._inputs += 1
        entry = Entry(INPUT, self._inputs, verdict, reason, topic)
        return [*before, Record(topic, msgtype, raw, *times_ns), self._record(entry, times_ns[0])]

    def take_back(self) -> None:
        """The last input could not be recorded; the next one says so."""
        self._inputs -= 1
        self._lost = self._told + 1

    def reset(self, log_time_ns: int) -> Record:
        """The tracker was reset."""
        return self._record(Entry(RESET, self._inputs), log_time_ns)

    def parameters(self, values: Mapping[str, Value], log_time_ns: int) -> Record:
        """The parameters from here on; they are repeated in each file of the bag."""
        entry = Entry(PARAMETERS, self._inputs, parameters=values)
        return self._record(entry, log_time_ns)._replace(repeat=PARAMETERS)

    def _record(self, entry: Entry, log_time_ns: int) -> Record:
        return Record(self._topic, JOURNAL, encode_entry(entry), log_time_ns, log_time_ns)


class Run(NamedTuple):
    """What the journal of a recorded run says; inputs are numbered from 1 as they are in the bag.

    Attributes:
        parameters: at the beginning, by name; empty where there is no journal.
        unseen: numbers of the inputs that never reached the tracker.
        events: resets and changes of parameters, by the number of the input before them.
        lost: how many inputs the tracker saw that are not in the bag.
    """

    parameters: dict[str, Value]
    unseen: set[int]
    events: dict[int, list[Entry]]
    lost: int


def read_run(bag: Bag) -> Run:
    """What happened in the run that this bag recorded; an empty run where it has no journal.

    Raises:
        InputError: the bag is broken, or what looks like a journal is none.
    """
    topics = [t for t in bag.of_type([JOURNAL]) if t.endswith('/journal')]
    run = Run({}, set(), {}, 0)
    before = -1  # inputs in earlier files, where this is a later file of a bag that was split
    waiting: list[Entry] = []
    for message in bag.messages(topics):
        try:
            entry = decode_entry(message.raw)
        except InputError as error:
            raise InputError(f'{bag.path}: {message.topic}: {error}') from None
        if entry.kind == LOST:
            run = run._replace(lost=run.lost + int(entry.parameters.get(LOST, 0)))
        elif entry.kind == INPUT:
            if before < 0:
                before = entry.number - 1
            if entry.verdict is Verdict.BACKLOG:
                run.unseen.add(entry.number - before)
        else:
            waiting.append(entry)
    for entry in waiting:
        number = max(entry.number - max(before, 0), 0)
        if entry.kind == PARAMETERS and not number and not run.parameters:
            run.parameters.update(entry.parameters)
        else:
            run.events.setdefault(number, []).append(entry)
    return run
