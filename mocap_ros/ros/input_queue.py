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
from typing import NamedTuple

from mocap_ros.bags.topics import PEOPLE_SOURCES, Source
from mocap_ros.messages.cdr import read_stamp_ns
from mocap_ros.units import NS_PER_S

MAX_WAITING = 1000  # messages of a topic; one second of the busiest /tf, and 33 s of a camera
# Bytes of all waiting messages; guards the memory, and the time until people have their turn: 8 MB of transforms
# take 5 s. An image of 60 people with 133 keypoints each takes 0.3 MB.
MAX_WAITING_BYTES = 8_000_000
RESTART_NS = NS_PER_S  # bodies of one image, and images in disorder, are less apart


class ReceivedMessage(NamedTuple):
    """A message in the queue."""

    source: Source
    topic: str  # absolute name
    number: int  # on its topic, from 1
    raw: bytes  # CDR
    times_ns: tuple[int, int]  # wall-clock times of receipt and of sending


@dataclass
class _Topic:
    source: Source
    received: int = 0  # messages so far
    left: int = 0  # messages that have left the queue, which are the oldest
    waiting_bytes: int = 0
    first_unskipped: int = 0  # messages of people with smaller numbers are skipped
    is_leaving: bool = False  # it has no subscription any more

    @property
    def waiting(self) -> int:
        return self.received - self.left


class InputQueue:
    """Messages that wait, in the order of their receipt. Any thread may call any method."""

    def __init__(self) -> None:
        self.is_behind = False  # whether too many images were waiting and some message still is
        self._changed = threading.Condition()
        self._is_closed = False
        self._waiting: OrderedDict[tuple[str, int], ReceivedMessage] = OrderedDict()  # by topic and number
        self._waiting_bytes = 0
        self._topics: dict[str, _Topic] = {}
        self._newest_body_ns = 0  # stamp of the newest image of which a body was received
        self._first_unskipped_ns = 0  # of the bodies received so far, those with smaller stamps are skipped
        self._removed: Counter[str] = Counter()  # messages since the last `pop_removed_counts`, by topic

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, source: Source, topic: str, raw: bytes, times_ns: tuple[int, int]) -> None:
        """Add a message that has just been received; remove the oldest ones if too many wait."""
        with self._changed:
            state = self._topics.setdefault(topic, _Topic(source))
            state.is_leaving = False
            state.received += 1
            self._waiting[topic, state.received] = ReceivedMessage(source, topic, state.received, raw, times_ns)
            state.waiting_bytes += len(raw)
            self._waiting_bytes += len(raw)
            if source is Source.BODY:
                stamp_ns = read_stamp_ns(raw)
                newest_ns = self._newest_body_ns
                if stamp_ns > newest_ns or stamp_ns < newest_ns - RESTART_NS:  # time itself has gone back
                    self._newest_body_ns = stamp_ns
            if state.waiting > MAX_WAITING:
                self._remove_oldest(topic)
            while self._waiting_bytes > MAX_WAITING_BYTES:
                largest = max(self._topics, key=lambda name: self._topics[name].waiting_bytes)
                if self._topics[largest].waiting == 1:  # the newest message of a topic stays
                    break
                self._remove_oldest(largest)
            self._changed.notify()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a message, for the end of the time or for `close`; return whether the queue is closed."""
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

        From `limit` waiting images on, all but the newest messages of people are skipped.
        """
        with self._changed:
            if not self._waiting:
                return None
            message = self._take(next(iter(self._waiting)))
            images = max((t.waiting for t in self._topics.values() if t.source in PEOPLE_SOURCES), default=0)
            self.is_behind = self.is_behind or images >= limit
            if self.is_behind:
                self._first_unskipped_ns = self._newest_body_ns
                for state in self._topics.values():
                    state.first_unskipped = state.received
            newest = self._topics[message.topic].first_unskipped
            if message.source is Source.BODY:
                return message, message.number <= newest and read_stamp_ns(message.raw) < self._first_unskipped_ns
            return message, message.number < newest and message.source in PEOPLE_SOURCES

    def count_received(self, topic: str) -> int:
        """Return the number of messages of a topic so far, which is that of its newest one."""
        with self._changed:
            return self._topics[topic].received if topic in self._topics else 0

    def forget(self, topic: str) -> None:
        """Number the messages of a topic from 1 again, as it has no subscription any more.

        One of which messages wait is forgotten at a later call, unless it has a subscription again by then.
        """
        with self._changed:
            if topic in self._topics:
                self._topics[topic].is_leaving = True
            self._topics = {n: t for n, t in self._topics.items() if t.waiting or not t.is_leaving}

    def pop_removed_counts(self) -> Counter[str]:
        """Return how many messages of each topic have been removed since the last call."""
        with self._changed:
            removed, self._removed = self._removed, Counter()
            return removed

    def find_first_receipt_ns(self) -> int | None:
        """Return the wall-clock time of receipt of the oldest waiting message, or None if none waits."""
        with self._changed:
            return min((m.times_ns[0] for m in self._waiting.values()), default=None)

    def _remove_oldest(self, topic: str) -> None:
        self._take((topic, self._topics[topic].left + 1))
        self._removed[topic] += 1

    def _take(self, key: tuple[str, int]) -> ReceivedMessage:
        message = self._waiting.pop(key)
        state = self._topics[key[0]]
        state.left += 1
        state.waiting_bytes -= len(message.raw)
        self._waiting_bytes -= len(message.raw)
        return message
