# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""When the player publishes which message, and which topics it leaves out, without middleware."""

from __future__ import annotations

from math import inf
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip('rclpy')

from mocap_ros.errors import MocapError
from mocap_ros.messages.cdr import typestore
from mocap_ros.ros import player
from mocap_ros.ros.player import PlaybackOptions, Player
from mocap_ros.runtime.playback import PlaybackMessage, PlayedTopic

POINT = 'geometry_msgs/msg/Point'  # a type that is installed
START_NS = 5 * 10**9


class SteadyClock:
    """The module `time`, in which only sleeping takes time."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class NodeWithTopics:
    """A node whose publishers keep when they publish what."""

    def __init__(self, clock: SteadyClock) -> None:
        self.published: list[tuple[float, str]] = []
        self._clock = clock

    def create_publisher(self, _: object, topic: str, __: object) -> Any:
        return SimpleNamespace(publish=lambda _: self.published.append((self._clock.now_s - 100.0, topic)))


def make_player(options: PlaybackOptions, *types: str) -> Player:
    """Return a player of topics /topic0, /topic1 and so on, of these types."""
    topics = [PlayedTopic(f'/topic{i}', msgtype) for i, msgtype in enumerate(types)]
    return Player(cast(Any, SimpleNamespace(topics=topics, count=0)), options)


@pytest.mark.parametrize('rate', [0.5, 1.0, 4.0, inf])
def test_the_rate_divides_the_times_between_messages(monkeypatch: pytest.MonkeyPatch, rate: float) -> None:
    clock = SteadyClock()
    monkeypatch.setattr(player, 'time', clock)
    node = NodeWithTopics(clock)
    tested = make_player(PlaybackOptions(rate), POINT, 'nowhere/msg/Unknown', POINT)
    tested._create_publishers(node)
    raw = bytes(typestore().serialize_cdr(typestore().types[POINT](1.0, 2.0, 3.0), POINT))
    due = [(0.0, 2), (0.5, 0), (0.6, 1), (3.0, 2)]  # s and topic
    tested._publish_once(PlaybackMessage(START_NS + round(s * 1e9), raw, topic) for s, topic in due)
    assert [topic for _, topic in node.published] == ['/topic2', '/topic0', '/topic2']
    assert [s for s, _ in node.published] == pytest.approx([0.0, 0.5 / rate, 3.0 / rate])
    assert tested.published_count == 3
    assert tested.published_topics == ['/topic0', '/topic2']
    (skipped,) = tested.skipped_topics
    assert skipped.startswith('/topic1: type nowhere/msg/Unknown is not installed')


def test_a_bag_of_unknown_types_is_refused() -> None:
    tested = make_player(PlaybackOptions(), 'nowhere/msg/A', 'nowhere/msg/B')
    with pytest.raises(MocapError, match=r'^nothing to play: /topic0: type nowhere/msg/A is not installed'):
        tested._create_publishers(NodeWithTopics(SteadyClock()))
