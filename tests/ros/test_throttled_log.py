# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The throttled log: each kind of remark the 1st, 10th, 100th, ... time, and not too many kinds."""

from __future__ import annotations

from mocap_ros.ros.throttled_log import MAX_KINDS, MAX_LINE_LENGTH, ThrottledLog
from tests.support.line_log import LineLog


def test_remarks_that_differ_in_numbers_and_names_are_of_one_kind() -> None:
    log = LineLog()
    throttled = ThrottledLog(log)
    for i in range(1000):
        remark = f"people[0].skeleton: unknown keypoint layout 'x{chr(500 + i)}'; known: a"
        throttled.report('/keypoints', i, remark)
    assert len(log.lines) == 4
    assert log.lines[-1].endswith('(this kind of message has been seen 1000 times)')


def test_ever_new_kinds_of_remarks_do_not_flood_the_log() -> None:
    log = LineLog()
    throttled = ThrottledLog(log)
    for i in range(1000):
        throttled.report('/keypoints', i, f'a kind of its own: {chr(500 + i)}')
    assert len(log.lines) == MAX_KINDS + 3  # and of all further kinds the 1st, 10th and 100th
    assert 'further kinds of errors on this topic are not listed' in log.lines[-1]
    throttled.report('/camera_info', 1, 'another topic')
    assert log.lines[-1] == 'error /camera_info: message 1: another topic'


def test_ever_new_bodies_do_not_flood_the_log() -> None:
    log = LineLog()
    throttled = ThrottledLog(log)
    for i in range(1000):
        throttled.report(f'/humans/bodies/b{i}/skeleton2d', 1, 'the same of every body')
    assert len(log.lines) == 4
    assert log.lines[-1].startswith('error /humans/bodies/b999/skeleton2d: message 1: the same of every body')


def test_a_line_is_printable_and_of_limited_length() -> None:
    log = LineLog()
    ThrottledLog(log).report('/keypoints', 1, 'two\nlines and\x1b[2J ' + 'x ' * 1000, is_error=False)
    (line,) = log.lines
    assert line.startswith('warning /keypoints: message 1: two lines and [2J x')
    assert line.isprintable()
    assert len(line) <= len('warning ') + MAX_LINE_LENGTH
