# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Topics of single bodies come and go with the bodies, whatever their ids are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip('rclpy')


from mocap_ros.config import Config, with_settings
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.plain import encode_plain
from mocap_ros.ros.subscriptions import InputSubscriptions

HEADER = Header(1, 'camera')
# Ids that cannot be part of a topic's name: ROS raises an exception for them.
NO_NAMES = ['7', 'a b', 'a/b', 'a__b', '', '~', 'é', 'b1\n', 'b' * 222]


class NodeWithTopics:
    """A node that keeps the names of its subscriptions."""

    def __init__(self) -> None:
        self.topics: set[str] = set()

    def resolve_topic_name(self, name: str) -> str:
        return name

    def create_subscription(self, _: object, topic: str, *__: object, **___: object) -> Topic:
        return Topic(self, topic)

    def destroy_subscription(self, topic: Topic) -> None:
        self.topics.remove(topic.name)


class Topic:
    """A subscription."""

    def __init__(self, node: NodeWithTopics, name: str) -> None:
        assert name not in node.topics
        node.topics.add(name)
        self.name = name


class SameVersions:
    """Message types of which the installed versions are this package's, and which need not be installed."""

    def add_input(self, _: str) -> None: ...

    def read(self, _: str, raw: bytes) -> bytes:
        return raw


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr('mocap_ros.ros.subscriptions.load_interface_class', lambda _: object)
    monkeypatch.setattr('mocap_ros.ros.topics.load_interface_class', lambda _: object)
    return NodeWithTopics()


def test_bodies_are_followed_unless_their_ids_are_no_names(node: Any) -> None:
    versions, limits = cast(Any, SameVersions()), with_settings(Config(), {'node.max_text': 1000}).node
    inputs = InputSubscriptions(node, HRI_SKELETON, versions, lambda: limits)
    for ids in (['b1', *NO_NAMES], ['b1', 'b' * 221], ['b1', 'B_2'], ['B_2', 'B_2'], NO_NAMES):
        inputs._follow_bodies(encode_plain((HEADER, ids), HRI_IDS))
        assert node.topics == {f'/humans/bodies/{i}/skeleton2d' for i in ids if i not in NO_NAMES}
    inputs._follow_bodies(encode_plain((HEADER, ['b1', 'b2']), HRI_IDS))
    forgotten: list[str] = []
    inputs._run = cast(Any, SimpleNamespace(queue=SimpleNamespace(forget=forgotten.append)))
    inputs._follow_bodies(encode_plain((HEADER, ['b1']), HRI_IDS))
    assert forgotten == ['/humans/bodies/b2/skeleton2d']
    inputs._follow_bodies(b'no message')
    assert node.topics
    inputs.unsubscribe()
    assert not node.topics
