# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The queue of a live run: order, backlog, and limits for publishers that send without a pause."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.bags.topics import Source
from mocap_ros.messages.cdr import Header, read_stamp_ns
from mocap_ros.messages.foreign_types import HRI_IDS
from mocap_ros.messages.plain import encode_plain
from mocap_ros.ros import input_queue
from mocap_ros.ros.input_queue import InputQueue
from mocap_ros.units import NS_PER_S

BODIES = range(12)
SOURCES = {'/keypoints': Source.KEYPOINTS, '/camera_info': Source.CAMERA_INFO, '/tf': Source.TRANSFORMS}


def put(queue: InputQueue, topic: str, count: int = 1, size: int = 1) -> None:
    for _ in range(count):
        queue.put(SOURCES[topic], topic, bytes(size), (1, 1))


def take_all(queue: InputQueue, limit: int = 10**6) -> list[tuple[str, int, bool]]:
    """Return topic, number, and whether to skip it, of each waiting message."""
    taken = []
    while popped := queue.pop(limit):
        taken.append((popped[0].topic, popped[0].number, popped[1]))
    return taken


def put_image(queue: InputQueue, stamp_s: int, bodies: range = BODIES) -> None:
    for body in bodies:
        raw = encode_plain((Header(stamp_s * NS_PER_S, 'camera'), ()), HRI_IDS)
        queue.put(Source.BODY, f'/humans/bodies/b{body}/skeleton2d', raw, (1, 1))


def take_images(queue: InputQueue, limit: int) -> Counter[int]:
    """Return the numbers of bodies that are not skipped, by their stamps in s."""
    taken: Counter[int] = Counter()
    while popped := queue.pop(limit):
        taken[read_stamp_ns(popped[0].raw) // NS_PER_S] += not popped[1]
    queue.wait(0.0)
    return +taken


def test_images_of_single_bodies_are_skipped_as_a_whole() -> None:
    queue = InputQueue()
    for stamp_s in range(1, 6):
        put_image(queue, stamp_s)
    put_image(queue, 6, range(5))  # the others are still on their way
    assert take_images(queue, limit=3) == {6: 5}
    put_image(queue, 6, range(5, 12))
    put_image(queue, 7)
    assert take_images(queue, limit=3) == {6: 7, 7: 12}
    for stamp_s in (8, 9, 10, 2):  # time goes back
        put_image(queue, stamp_s)
    put_image(queue, 3)
    assert take_images(queue, limit=3) == {8: 12, 9: 12, 10: 12, 3: 12}
    put_image(queue, 2)
    assert take_images(queue, limit=3) == {2: 12}, 'what comes later is not skipped'


def test_from_as_many_images_as_the_limit_on_the_newest_alone_is_not_skipped() -> None:
    queue = InputQueue()
    put(queue, '/keypoints', 2)
    assert [skipped for *_, skipped in take_all(queue, limit=3)] == [False, False]
    put(queue, '/camera_info')
    put(queue, '/keypoints', 3)
    skipped = [(topic, skipped) for topic, _, skipped in take_all(queue, limit=3)]
    assert skipped == [('/camera_info', False), *(('/keypoints', s) for s in (True, True, False))]


@given(st.lists(st.tuples(st.sampled_from([*SOURCES, 'pop']), st.integers(0, 60))), st.integers(1, 5))
def test_every_message_is_taken_in_order_or_counted_as_removed(steps: list[tuple[str, int]], most: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(input_queue, 'MAX_WAITING', most)
        patch.setattr(input_queue, 'MAX_WAITING_BYTES', 100)
        queue, sent, taken = InputQueue(), dict.fromkeys(SOURCES, 0), dict.fromkeys(SOURCES, 0)
        numbers = dict.fromkeys(SOURCES, 0)

        def note(topic: str, number: int) -> None:
            assert number > numbers[topic]
            numbers[topic] = number
            taken[topic] += 1

        for step, size in steps:
            if step != 'pop':
                put(queue, step, size=size)
                sent[step] += 1
                assert queue.count_received(step) == sent[step]
            elif popped := queue.pop(2):
                note(popped[0].topic, popped[0].number)
            assert len(queue) <= most * len(SOURCES)
            waiting = queue._waiting.values()
            assert sum(len(m.raw) for m in waiting) <= 100 + 60 * len(SOURCES)
        for topic, number, _ in take_all(queue):
            note(topic, number)
        removed = queue.pop_removed_counts()
    assert {topic: taken[topic] + removed[topic] for topic in SOURCES} == sent
    assert all(numbers[topic] == sent[topic] for topic in SOURCES), 'the newest is never removed'
