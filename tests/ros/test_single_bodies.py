# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Topics of single bodies come and go with the bodies, whatever their ids are."""

from __future__ import annotations

from typing import Any, cast

import pytest

pytest.importorskip('rclpy')

from mocap_ros.config import Config, with_settings
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.foreign.definitions import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.robots.bodies import BODIES, JOINT_STATES, TRACKED, encode_tracked
from mocap_ros.ros.publications import OutputPublishers
from mocap_ros.ros.qos import OUTPUT_QOS
from mocap_ros.ros.subscriptions import InputSubscriptions

HEADER = Header(1, 'camera')
# Ids that cannot be part of a topic's name: ROS raises an exception for them.
NO_NAMES = ['7', 'a b', 'a/b', 'a__b', '', '~', 'é', 'b1\n', 'b' * 222]


class NodeWithTopics:
    """A node that keeps the names of its subscriptions and publishers."""

    def __init__(self) -> None:
        self.topics: set[str] = set()

    def resolve_topic_name(self, name: str) -> str:
        return name

    def create_subscription(self, _: object, topic: str, *__: object, **___: object) -> Topic:
        return Topic(self, topic)

    def create_lifecycle_publisher(self, _: object, topic: str, *__: object, **___: object) -> Topic:
        return Topic(self, topic)

    def destroy_subscription(self, topic: Topic) -> None:
        self.topics.remove(topic.name)

    destroy_lifecycle_publisher = destroy_subscription


class Topic:
    """A subscription or a publisher."""

    def __init__(self, node: NodeWithTopics, name: str) -> None:
        assert name not in node.topics
        node.topics.add(name)
        self.name = name

    def on_activate(self, _: object) -> None: ...

    def publish(self, _: object) -> None: ...


class SameVersions:
    """Message types of which the installed versions are this package's, and which need not be installed."""

    def add_input(self, _: str) -> None: ...

    def add_output(self, _: str) -> list[str]:
        return []

    def read(self, _: str, raw: bytes) -> bytes:
        return raw


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Any:
    for module in ('subscriptions', 'publications'):
        monkeypatch.setattr(f'mocap_ros.ros.{module}.load_interface_class', lambda _: object)
    return NodeWithTopics()


def test_bodies_are_followed_unless_their_ids_are_no_names(node: Any) -> None:
    versions, limits = cast(Any, SameVersions()), with_settings(Config(), {'node.max_text': 1000}).node
    inputs = InputSubscriptions(node, HRI_SKELETON, versions, lambda: limits, cast(Any, None))
    for ids in (['b1', *NO_NAMES], ['b1', 'b' * 221], ['b1', 'B_2'], ['B_2', 'B_2'], NO_NAMES):
        inputs._follow_bodies(encode_tracked(HEADER, ids))
        assert node.topics == {f'/humans/bodies/{i}/skeleton2d' for i in ids if i not in NO_NAMES}
    inputs._follow_bodies(encode_tracked(HEADER, ['b1', 'b2']))
    forgotten: list[str] = []
    inputs._forget_topic = forgotten.append
    inputs._follow_bodies(encode_tracked(HEADER, ['b1']))
    assert forgotten == ['/humans/bodies/b2/skeleton2d']
    inputs._follow_bodies(b'no message')
    assert node.topics
    inputs.unsubscribe()
    assert not node.topics


def test_publishers_of_bodies_who_have_left_are_destroyed(node: Any) -> None:
    publishers = OutputPublishers(node, cast(Any, None))
    publishers._versions = cast(Any, SameVersions())
    publishers._create_publisher(TRACKED, HRI_IDS, OUTPUT_QOS, publishers._versions)
    for ids in (['a'], ['a', 'b'], ['b'], []):
        publishers.publish(OutputMessage(TRACKED, HRI_IDS, 1, encode_tracked(HEADER, ids)))
        for body_id in ids * 2:
            publishers.publish(OutputMessage(f'{BODIES}{body_id}/joint_states', JOINT_STATES, 1, b''))
        assert node.topics == {TRACKED, *(f'{BODIES}{i}/joint_states' for i in ids)}
