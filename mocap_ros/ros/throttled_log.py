# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Log what is wrong with the messages of a topic without flooding the log."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Protocol

from mocap_ros.bags.topics import BODY_SUFFIX
from mocap_ros.errors import make_printable_line
from mocap_ros.findings import find_kind

MAX_KINDS = 30  # kinds of lines; guards log and memory against senders of ever new kinds of errors
MAX_REASONS = 5  # reasons of a kind that are logged at once; whoever mends one number after another sees each
MAX_LOGGED_TRACEBACKS = 30  # tracebacks; guards the log against internal errors with ever new texts
MAX_LINE_LENGTH = 400  # characters; guards the log against long texts in messages; the node's own reasons fit


class Logger(Protocol):
    """Logger of a run; rclpy's loggers are such loggers."""

    def info(self, message: str) -> object:
        """Log a normal event."""

    def warning(self, message: str) -> object:
        """Log a problem that the run copes with."""

    def error(self, message: str) -> object:
        """Log a failure."""


class ThrottledLog:
    """Log of what is wrong with messages, in which no kind fills many lines.

    Two reasons on an input are of one kind if they differ only in numbers and quoted names. The first
    `MAX_REASONS` different reasons of a kind are logged at once, and then its 10th, 100th, ... message. The kinds
    after the first `MAX_KINDS` of an input count as one kind. An input is a topic, or with ROS4HRI the topics of
    all bodies: their ids never end.
    """

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._counts_by_input: defaultdict[str, Counter[str]] = defaultdict(Counter)  # of each kind
        self._reasons: defaultdict[tuple[str, str], set[str]] = defaultdict(set)  # the first, by input and kind

    def report(self, topic: str, number: int, reason: str, *, is_error: bool = True) -> None:
        """Log what is wrong with a message, the `number`th of its topic, unless its kind is being held back."""
        name = BODY_SUFFIX if topic.endswith(BODY_SUFFIX) else topic
        counts = self._counts_by_input[name]
        kind = find_kind(reason)
        if kind not in counts and len(counts) >= MAX_KINDS:
            kind = ''
        counts[kind] += 1
        first = self._reasons[name, kind]
        if reason not in first and len(first) < MAX_REASONS:
            first.add(reason)
        elif str(counts[kind]).strip('0') != '1':  # no power of ten
            return
        line = make_printable_line(f'{topic}: message {number}: {reason}', MAX_LINE_LENGTH)
        if not kind:
            line += ' (further kinds of errors on this topic are not listed one by one)'
        if counts[kind] > 1:
            line += f' (this kind of message has been seen {counts[kind]} times)'
        if is_error:  # each severity in a line of its own: rclpy refuses another one from the same line
            self._logger.error(line)
        else:
            self._logger.warning(line)


class TracebackLog:
    """Log of tracebacks of internal errors, each of which appears once, and `MAX_LOGGED_TRACEBACKS` at most."""

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._logged: set[str] = set()

    def report(self, error_traceback: str) -> None:
        """Log the traceback of an error after which the node continues, unless it has been logged before."""
        if error_traceback not in self._logged and len(self._logged) < MAX_LOGGED_TRACEBACKS:
            self._logged.add(error_traceback)
            self._logger.error(
                f'an internal error occurred, and the node continues; please report it:\n{error_traceback}'
            )
