# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Queue of the messages that a live run has received and not processed yet; its length and size are limited.

The thread of the ROS executor puts messages into it, and the worker thread of the run takes them out in the order
of their receipt. Two rules keep a node that is too slow from falling behind for ever:

* When too many images of people wait, and from then on until none waits, all but the newest are to be skipped. An
  image is one message, or with ROS4HRI one on the topic of each body, all with one stamp, so as many images wait
  as messages of the topic that has the most. The run counts and records those that it skips, so that a replay can
  process them.
* No more than `MAX_WAITING` messages of a topic wait, and no more than `MAX_WAITING_BYTES` of all. What is beyond
  is removed, the oldest message first of the topic that has the most bytes waiting, and is only counted: recording
  it would take longer than a publisher that sends without a pause takes to send the next one.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from dataclasses import dataclass

from mocap_ros.bags.topics import PEOPLE_SOURCES, Source
from mocap_ros.messages.cdr import read_stamp_ns
from mocap_ros.units import NS_PER_S

MAX_WAITING = 1000  # messages of a topic; one second of the busiest /tf, and 33 s of a camera
# Bytes of all waiting messages; guards the memory, and the time until people have their turn: 8 MB of transforms
# take 5 s. An image of 60 people with 133 keypoints each takes 0.3 MB.
MAX_WAITING_BYTES = 8_000_000
RESTART_NS = NS_PER_S  # bodies of one image, and images in disorder, are less apart


@dataclass(frozen=True)
class ReceivedMessage:
    """A message in the queue.

    Attributes:
        source: Kind of the message.
        topic: Absolute name of its topic.
        number: Number of the message on its topic, from 1.
        raw: The message as CDR.
        times_ns: Wall-clock times of receipt and of sending.
    """

    source: Source
    topic: str
    number: int
    raw: bytes
    times_ns: tuple[int, int]


class InputQueue:
    """Messages that wait, in the order of their receipt. Any thread may call any method.

    Attributes:
        is_behind: Whether too many images were waiting and some message still is.
    """

    def __init__(self) -> None:
        self.is_behind = False
        self._changed = threading.Condition()
        self._is_closed = False
        self._waiting: OrderedDict[tuple[str, int], ReceivedMessage] = OrderedDict()  # by topic and number
        self._waiting_bytes: Counter[str] = Counter()  # by topic, of those whose messages wait
        self._all_waiting_bytes = 0
        self._waiting_people: Counter[str] = Counter()  # messages of people, by topic of those whose messages wait
        self._received: Counter[str] = Counter()  # messages so far, by topic
        self._first_waiting: dict[
            str, int
        ] = {}  # by topic: number of the oldest message that has not left the queue
        self._first_unskipped: dict[str, int] = {}  # by topic: messages of people with smaller numbers are skipped
        self._newest_body_ns = 0  # stamp of the newest image of which a body was received
        self._first_unskipped_ns = 0  # of the bodies received so far, those with smaller stamps are skipped
        self._leaving: set[str] = set()  # topics that have no subscription any more, and of which messages wait
        self._removed: Counter[str] = Counter()  # messages since the last `pop_removed_counts`, by topic

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, source: Source, topic: str, raw: bytes, times_ns: tuple[int, int]) -> None:
        """Add a message that has just been received, and remove the oldest ones if too many wait.

        Args:
            source: Kind of the message.
            topic: Absolute name of its topic.
            raw: The message as CDR.
            times_ns: Wall-clock times of receipt and of sending.
        """
        with self._changed:
            self._leaving.discard(topic)
            self._received[topic] += 1
            number = self._received[topic]
            self._waiting[topic, number] = ReceivedMessage(source, topic, number, raw, times_ns)
            self._waiting_bytes[topic] += len(raw)
            self._all_waiting_bytes += len(raw)
            if source in PEOPLE_SOURCES:
                self._waiting_people[topic] += 1
            if source is Source.BODY:
                self._note_body(read_stamp_ns(raw))
            self._first_waiting.setdefault(topic, number)
            if number - self._first_waiting[topic] >= MAX_WAITING:
                self._remove_oldest(topic)
            while self._all_waiting_bytes > MAX_WAITING_BYTES:
                largest = max(self._waiting_bytes, key=self._waiting_bytes.__getitem__)
                if self._first_waiting[largest] == self._received[largest]:  # its newest message stays
                    break
                self._remove_oldest(largest)
            self._changed.notify()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a message, for the end of the time or for `close`; return whether the queue is closed.

        Args:
            timeout_s: How long to wait.
        """
        with self._changed:
            if not self._waiting:
                self.is_behind = False
            self._changed.wait_for(lambda: self._waiting or self._is_closed, timeout_s)
            return self._is_closed

    def close(self) -> None:
        """Let `wait` return at once from now on. Messages that wait can still be taken."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def pop(self, limit: int) -> tuple[ReceivedMessage, bool] | None:
        """Take the oldest message; return it and whether it is to be skipped, or None if none waits.

        Args:
            limit: Number of waiting images from which on all but the newest messages of people are skipped.
        """
        with self._changed:
            if not self._waiting:
                return None
            _, message = self._waiting.popitem(last=False)
            self._note_gone(message)
            self.is_behind = self.is_behind or max(self._waiting_people.values(), default=0) >= limit
            if self.is_behind:
                self._first_unskipped, self._first_unskipped_ns = dict(self._received), self._newest_body_ns
            newest = self._first_unskipped.get(message.topic, 0)
            if message.source is Source.BODY:
                return message, message.number <= newest and read_stamp_ns(message.raw) < self._first_unskipped_ns
            return message, message.number < newest and message.source in PEOPLE_SOURCES

    def count_received(self, topic: str) -> int:
        """Return the number of messages of a topic so far, which is that of its newest one."""
        return self._received[topic]

    def forget(self, topic: str) -> None:
        """Number the messages of a topic from 1 again, as it has no subscription any more.

        One of which messages wait is forgotten at a later call, unless it has a subscription again by then.
        """
        with self._changed:
            self._leaving.add(topic)
            for gone in self._leaving - self._waiting_bytes.keys():
                self._leaving.remove(gone)
                for numbers in (self._received, self._first_waiting, self._first_unskipped):
                    numbers.pop(gone, None)

    def pop_removed_counts(self) -> Counter[str]:
        """Return how many messages of each topic have been removed since the last call."""
        if not self._removed:
            return Counter()
        with self._changed:
            removed, self._removed = self._removed, Counter()
            return removed

    def find_first_receipt_ns(self) -> int | None:
        """Return the wall-clock time of receipt of the oldest waiting message, or None if none waits."""
        with self._changed:
            return min((m.times_ns[0] for m in self._waiting.values()), default=None)

    def _note_body(self, stamp_ns: int) -> None:
        """Note the stamp of a body; one that is far older begins a new sequence, as time itself has gone back."""
        if stamp_ns > self._newest_body_ns or stamp_ns < self._newest_body_ns - RESTART_NS:
            self._newest_body_ns = stamp_ns

    def _remove_oldest(self, topic: str) -> None:
        """Remove the oldest waiting message of a topic, and count it."""
        self._note_gone(self._waiting.pop((topic, self._first_waiting[topic])))
        self._removed[topic] += 1

    def _note_gone(self, message: ReceivedMessage) -> None:
        """Account for a message that has left the queue, the oldest of its topic."""
        self._first_waiting[message.topic] = message.number + 1
        self._all_waiting_bytes -= len(message.raw)
        self._waiting_bytes[message.topic] -= len(message.raw)
        if not self._waiting_bytes[message.topic]:
            del self._waiting_bytes[message.topic]
        if message.source in PEOPLE_SOURCES:
            self._waiting_people[message.topic] -= 1
            if not self._waiting_people[message.topic]:
                del self._waiting_people[message.topic]
