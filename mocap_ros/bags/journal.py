# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The journal of a run: a topic of the bag that records what became of every input, so that a replay is exact.

A recorded run holds every input as it was received, every output, and on the topic `<node>/journal` one
diagnostic_msgs/DiagnosticStatus for each input and for each further event that changes the state of the tracker:

    name         message              level                         values
    input        reason, or empty     OK, WARN, ERROR or STALE      input: number of the input
    reset        empty                OK                            input: number of the last input before it, and
                                                                    what is kept (`runtime/run_memory.py`)
    parameters   empty                OK                            input, and every parameter as JSON
    lost         empty                OK                            input, and lost: number of lost inputs

Inputs of all topics are counted together from 1, in the order of their log times. An input is lost when the disk
is too slow to record it; the tracker received it nevertheless.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import RecordedMessage
from mocap_ros.bags.topics import find_latched_inputs
from mocap_ros.config import Value
from mocap_ros.errors import InputError, name_errors
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.plain import encode_plain

JOURNAL = 'diagnostic_msgs/msg/DiagnosticStatus'  # message type of the journal

# Kinds of journal entries, as in the field `name` of the table above.
INPUT = 'input'
RESET = 'reset'
PARAMETERS = 'parameters'
LOST = 'lost'


class Acceptance(IntEnum):
    """What became of an input; the values are the levels of DiagnosticStatus."""

    ACCEPTED = 0  # the tracker used the input
    DROPPED = 1  # the input was valid but could not be used
    INVALID = 2  # the input could not be decoded or failed a check
    BACKLOG = 3  # the input was dropped because newer messages were waiting; it did not reach the tracker


@dataclass(frozen=True)
class Entry:
    """An entry of the journal; the table above says what it holds."""

    kind: str
    number: int  # number of the input; for other kinds, number of the last input before the event
    acceptance: Acceptance = Acceptance.ACCEPTED
    reason: str = ''  # why the input was not accepted, or what is to be said of an accepted one; usually empty
    topic: str = ''  # of the input; empty for other kinds
    # Values by name: of the parameters, or what is kept at a reset; for `lost`, the number of lost inputs
    parameters: Mapping[str, Any] = field(default_factory=dict)


def encode_entry(entry: Entry) -> bytes:
    """Encode a journal entry as CDR of DiagnosticStatus."""
    values = {'input': entry.number, **entry.parameters}
    texts = [(key, json.dumps(value)) for key, value in values.items()]
    return encode_plain((int(entry.acceptance), entry.kind, entry.reason, entry.topic, texts), JOURNAL)


def decode_entry(raw: bytes) -> Entry:
    """Decode a journal entry from CDR of DiagnosticStatus; raise InputError if the message is none."""
    message = decode(raw, JOURNAL)
    try:
        values = {v.key: json.loads(v.value) for v in message.values}
        number = int(values.pop('input'))
        acceptance = Acceptance(message.level)
        int(values.get(LOST, 0))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        raise InputError('the message is not a journal entry') from None
    return Entry(message.name, number, acceptance, message.message, message.hardware_id, values)


class Journal:
    """Numbers the inputs of a run and makes the messages that record them on the journal's topic."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._input_count = 0
        self._input_ns = 0  # log time of the last input
        self._lost_count = 0  # inputs lost since the last recorded one
        self._reported_lost_count = 0  # lost inputs that the records of the last input report

    def make_input_records(
        self,
        topic: str,
        msgtype: str,
        raw: bytes,
        times_ns: tuple[int, int],
        acceptance: Acceptance,
        reason: str = '',
        repeat_keys: frozenset[str] | None = frozenset(),
    ) -> list[RecordedMessage]:
        """Return the messages that record an input and what became of it.

        These are a `lost` entry where inputs were lost before, the input itself, and its journal entry. The first
        alone may begin a further file: what that repeats then has the time of receipt of the first input in it.
        Outputs and events have later times than inputs that waited meanwhile and follow them.

        Times are those of receipt and of sending, and `repeat_keys` those that `make_repeat_keys` gives.
        """
        received_ns, sent_ns = times_ns
        self._input_ns = received_ns
        before = self.make_lost_records()
        self._input_count += 1
        entry = Entry(INPUT, self._input_count, acceptance, reason, topic)
        message = RecordedMessage(
            topic, msgtype, raw, received_ns, sent_ns, repeat_keys, may_begin_file=not before
        )
        return [*(r._replace(may_begin_file=True) for r in before), message, self._make_record(entry, received_ns)]

    def make_lost_records(self) -> list[RecordedMessage]:
        """Return the message that says how many inputs were lost since the last recorded one, if any were."""
        lost = Entry(LOST, self._input_count, parameters={LOST: self._lost_count})
        records = [self._make_record(lost, self._input_ns)] if self._lost_count else []
        self._reported_lost_count, self._lost_count = self._lost_count, 0
        return records

    def mark_last_input_lost(self) -> None:
        """Count the last input as lost because its records were not written; the next input reports the loss."""
        self._input_count -= 1
        self._lost_count = self._reported_lost_count + 1

    def make_reset_record(
        self, log_time_ns: int, kept: Mapping[str, Any] = MappingProxyType({})
    ) -> RecordedMessage:
        """Return the message that records a reset of the tracker."""
        return self._make_record(Entry(RESET, self._input_count, parameters=kept), log_time_ns)

    def make_parameters_record(self, values: Mapping[str, Value], log_time_ns: int) -> RecordedMessage:
        """Return the message that records the parameters used from now on; each file of the bag repeats it."""
        entry = Entry(PARAMETERS, self._input_count, parameters=values)
        return self._make_record(entry, log_time_ns)._replace(repeat_keys=frozenset({PARAMETERS}))

    def _make_record(self, entry: Entry, log_time_ns: int) -> RecordedMessage:
        entry_raw = encode_entry(entry)
        return RecordedMessage(self._topic, JOURNAL, entry_raw, log_time_ns, log_time_ns, may_begin_file=False)


class RecordedRun(NamedTuple):
    """The content of the journal of a recorded run; inputs are numbered from 1 as they are in the bag."""

    parameters: dict[str, Value]  # parameters at the start by name; empty where there is no journal
    skipped_inputs: set[int]  # numbers of the inputs that never reached the tracker
    events: dict[int, list[Entry]]  # resets and changes of parameters, by the number of the input before them
    lost_count: int  # number of inputs that were processed or refused but are not in the bag
    input_topics: AbstractSet[str] = frozenset()  # topics of the inputs; empty where there is no journal
    # How many messages at a topic and log time in ns were not received, because a further file of a split bag
    # repeats them; they have no number
    repeated_inputs: Mapping[tuple[str, int], int] = MappingProxyType({})

    def leave_out_repeated(self, inputs: Iterable[BagMessage]) -> Iterator[BagMessage]:
        """Yield the inputs that have a number, in their order."""
        repeated = Counter(self.repeated_inputs)
        for message in inputs:
            place = message.topic, message.time_ns
            if repeated[place]:
                repeated[place] -= 1
            else:
                yield message


def read_run(bag: Bag) -> RecordedRun:
    """Read the journal of a bag; return an empty run where the bag has no journal.

    A further file of a split bag begins with the last messages of every latched topic and the parameters. Where it
    is read with the files before it, these messages are left out; where it is read alone, they come before its
    first input.
    """
    topics = [t for t in bag.topics_of_type([JOURNAL]) if t.endswith('/journal')]
    latched = find_latched_inputs(bag) if topics else set()
    messages: Counter[tuple[str, int]] = Counter()  # on latched topics, by topic and log time
    entries: Counter[tuple[str, int]] = Counter()  # of inputs, likewise; an entry has the log time of its input
    first_ns: dict[str, int] = {}  # log times of the first messages of latched topics
    inputs: list[tuple[Entry, int]] = []  # the first entry of an input, and its log time
    skipped: list[int] = []
    events: list[Entry] = []
    lost_count = 0
    parameters: Entry | None = None  # the last ones
    for message in bag.messages({*topics, *latched}):
        if message.topic in latched:
            messages[message.topic, message.time_ns] += 1
            first_ns.setdefault(message.topic, message.time_ns)
            continue
        with name_errors(f'{bag.path}: {message.topic}'):
            entry = decode_entry(message.raw)
        if entry.kind == LOST:
            lost_count += int(entry.parameters.get(LOST, 0))
        elif entry.kind == INPUT:
            inputs = inputs or [(entry, message.time_ns)]
            entries[entry.topic, message.time_ns] += 1
            if entry.acceptance is Acceptance.BACKLOG:
                skipped.append(entry.number)
        elif entry != parameters:
            events.append(entry)
            parameters = entry if entry.kind == PARAMETERS else parameters
    repeated = messages - entries  # a message that a further file repeats has no entry
    inputs_before = first_count = 0  # inputs in earlier files, and the repeated messages that stand for them
    for entry, time_ns in inputs:
        first_count = sum(repeated.pop(place, 0) for place in first_ns.items() if place[1] <= time_ns)
        has_input = entry.number == 1 or any(bag.messages([entry.topic], time_ns, time_ns + 1))
        inputs_before = entry.number - has_input
    run = RecordedRun({}, set(), {}, lost_count, {topic for topic, _ in entries}, repeated)
    run.skipped_inputs.update(n - inputs_before + first_count for n in skipped if n > inputs_before)
    for entry in events:
        number = max(entry.number - inputs_before, 0)
        if entry.kind == PARAMETERS and not number and not run.parameters:
            run.parameters.update(entry.parameters)
        else:
            run.events.setdefault(number + first_count, []).append(entry)
    return run
