# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Subscriptions: QoS, silence, topics of single bodies, and messages that do not arrive."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2.metadata import parse_qos

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.config import Config, with_settings
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.ros.qos import choose_playback_profile
from mocap_ros.ros.subscriptions import MAX_PUBLISHERS, InputSubscriptions, LostMessages
from mocap_ros.ros.topics import SilenceMonitor
from tests.support.ros_node import Peer

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('msgtype', 'latched', 'depth', 'durability'),
    [
        (KEYPOINTS, [True], 3, 'TRANSIENT_LOCAL'),
        (TRANSFORMS, [True], 1000, 'TRANSIENT_LOCAL'),  # each of their publishers kept one
        (TRANSFORMS, [False, True], 1000, 'TRANSIENT_LOCAL'),  # what their subscribers ask for
        (KEYPOINTS, [False, True], 1000, 'VOLATILE'),
    ],
)
def test_late_subscribers_are_served(msgtype: str, latched: list[bool], depth: int, durability: str) -> None:
    offered: Any = [{**make_topic('/topic', msgtype, latched=kept).qos[0], 'depth': 3} for kept in latched]
    profile = choose_playback_profile(parse_qos(offered), msgtype)
    assert profile.durability.name == durability
    assert profile.depth == depth


@pytest.fixture
def listener(peer: Peer) -> Iterator[Any]:
    import rclpy

    node = rclpy.create_node('listener', context=peer.context)
    yield node
    node.destroy_node()


def test_silence_is_explained_by_other_nodes(peer: Peer, listener: Any, capfd: pytest.CaptureFixture[str]) -> None:
    from std_msgs.msg import String

    def read_warning(expected_type: str = KEYPOINTS) -> str:
        capfd.readouterr()
        monitor = SilenceMonitor(listener, 'keypoints', expected_type)
        for _ in range(2):
            monitor.check(0.0)
        (line,) = capfd.readouterr().err.splitlines()
        return line.partition('no message has arrived on /keypoints for 0 s: ')[2]

    assert read_warning('yolo_msgs/msg/DetectionArray').endswith(f'-p node.input_type:={KEYPOINTS}')
    assert 'its QoS is incompatible' in read_warning()
    peer.node.destroy_publisher(peer.keypoints)
    peer.wait_until(lambda: not listener.get_publishers_info_by_topic('/keypoints'))
    peer.node.create_subscription(load_interface_class(KEYPOINTS), '/other/keypoints', print, 1)
    peer.wait_until(lambda: listener.count_subscribers('/other/keypoints') == 1)
    assert 'no publisher; start the detector' in read_warning(), 'the other topic has none either'
    for topic in ('left', 'right'):
        peer.node.create_publisher(load_interface_class(KEYPOINTS), f'/{topic}/keypoints', 1)
    peer.wait_until(lambda: len(listener.get_publishers_info_by_topic('/right/keypoints')) == 1)
    assert 'remap keypoints to /left/keypoints or /right/keypoints?' in read_warning()
    peer.node.create_publisher(String, 'keypoints', 1)
    peer.wait_until(lambda: listener.get_publishers_info_by_topic('/keypoints'))
    assert read_warning() == f'its publisher sends std_msgs/msg/String, expected {KEYPOINTS}'


# Ids that cannot be part of a topic's name: ROS raises an exception for them.
NO_NAMES = ['7', 'a b', 'a/b', 'a__b', '', '~', 'é', 'b1\n', 'b' * 222]


def test_bodies_are_followed_unless_their_ids_are_no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.subscriptions.load_interface_class', lambda _: object)
    monkeypatch.setattr('mocap_ros.ros.topics.load_interface_class', lambda _: object)
    topics: list[str] = []

    def subscribe(_: object, topic: str, *__: object, **___: object) -> str:
        topics.append(topic)
        return topic

    node: Any = SimpleNamespace(
        resolve_topic_name=str, create_subscription=subscribe, destroy_subscription=topics.remove
    )
    same_versions: Any = SimpleNamespace(add_input=lambda _: None, read=lambda _, raw: raw)
    limits = with_settings(Config(), {'node.max_text': 1000}).node
    inputs = InputSubscriptions(node, HRI_SKELETON, same_versions, lambda: limits)

    def follow(ids: list[str]) -> None:
        inputs._follow_bodies(encode_plain((Header(1, 'camera'), ids), HRI_IDS))

    for ids in (['b1', *NO_NAMES], ['b1', 'b' * 221], ['b1', 'B_2'], ['B_2', 'B_2'], NO_NAMES):
        follow(ids)
        assert sorted(topics) == sorted({f'/humans/bodies/{i}/skeleton2d' for i in ids if i not in NO_NAMES})
    follow(['b1', 'b2'])
    forgotten: list[str] = []
    inputs._run = cast(Any, SimpleNamespace(queue=SimpleNamespace(forget=forgotten.append)))
    follow(['b1'])
    assert forgotten == ['/humans/bodies/b2/skeleton2d']
    inputs._follow_bodies(b'no message')
    assert topics
    inputs.unsubscribe()
    assert not topics


def describe(publisher: int, number: int) -> dict[str, object]:
    return {'publication_sequence_number': number, 'publisher_gid': {'data': bytes([publisher])}}


@given(arrivals=st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60))
def test_what_is_missing_between_messages_of_a_publisher_is_lost(arrivals: list[tuple[int, bool]]) -> None:
    counter, numbers, lost, counted = LostMessages(), [5, 900, 1], 0, 0
    assert counter.count({'publication_sequence_number': None}) == counter.count({}) == 0
    missing, has_arrived = [0] * 3, [False] * 3
    for publisher, arrives in arrivals:
        numbers[publisher] += 1
        if not arrives:
            missing[publisher] += has_arrived[publisher]  # before the first arrival it is not known
            continue
        counted += counter.count(describe(publisher, numbers[publisher]))
        lost, missing[publisher], has_arrived[publisher] = lost + missing[publisher], 0, True
        assert counted == lost


def test_publishers_that_come_and_go_take_no_memory() -> None:
    counter = LostMessages()
    for publisher in range(5 * MAX_PUBLISHERS):
        assert counter.count(describe(publisher, 7)) == 0
    assert len(counter._last_numbers) <= MAX_PUBLISHERS
