# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that were sent but did not arrive are counted, by the numbers that the middleware gives them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from mocap_ros.ros.subscriptions import MAX_PUBLISHERS, LostMessages


def describe(publisher: int, number: int) -> dict[str, object]:
    return {'publication_sequence_number': number, 'publisher_gid': {'data': bytes([publisher])}}


@given(arrivals=st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60))
def test_what_is_missing_between_messages_of_a_publisher_is_lost(arrivals: list[tuple[int, bool]]) -> None:
    """Of three publishers that send in turn, some messages arrive."""
    counter, numbers, lost, counted = LostMessages(), [5, 900, 1], 0, 0
    missing, has_arrived = [0] * 3, [False] * 3
    for publisher, arrives in arrivals:
        numbers[publisher] += 1
        if not arrives:
            missing[publisher] += has_arrived[publisher]  # before the first arrival nobody knows
            continue
        counted += counter.count(describe(publisher, numbers[publisher]))
        lost, missing[publisher], has_arrived[publisher] = lost + missing[publisher], 0, True
        assert counted == lost


def test_publishers_that_come_and_go_take_no_memory_and_numbers_may_be_absent() -> None:
    counter = LostMessages()
    for publisher in range(5 * MAX_PUBLISHERS):
        assert counter.count(describe(publisher, 7)) == 0
        assert len(counter._last_numbers) <= MAX_PUBLISHERS
    assert counter.count({'publication_sequence_number': None}) == counter.count({}) == 0
    assert counter.count({'publication_sequence_number': 4}) == 0
    assert counter.count({'publication_sequence_number': 6}) == 1
