# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""QoS profiles: overrides by parameters, and the profiles with which bags are played."""

from __future__ import annotations

from typing import Any, cast

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

from rosbags.rosbag2.metadata import parse_qos

from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.config import Config
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.message_types import MessageVersions
from tests.support.ros_node import Peer


@pytest.mark.parametrize(('msgtype', 'kept'), [(KEYPOINTS, 3), (TRANSFORMS, 1000)])
def test_late_subscribers_get_as_many_messages_of_a_bag_as_of_its_publishers(msgtype: str, kept: int) -> None:
    """Each of the publishers of static transforms kept one."""
    from rclpy.qos import DurabilityPolicy

    from mocap_ros.ros.qos import choose_playback_profile

    latched: Any = {**make_topic('/topic', msgtype, latched=True).qos[0], 'depth': 3}
    profile = choose_playback_profile(parse_qos([latched]), msgtype)
    assert (profile.depth, profile.durability) == (kept, DurabilityPolicy.TRANSIENT_LOCAL)


def test_static_transforms_reach_late_subscribers_if_one_of_their_publishers_kept_them() -> None:
    """Subscribers to static transforms ask for transient local, which a volatile publisher does not serve."""
    from rclpy.qos import DurabilityPolicy

    from mocap_ros.ros.qos import choose_playback_profile

    both: Any = [make_topic('/topic', TRANSFORMS, latched=latched).qos[0] for latched in (False, True)]
    assert choose_playback_profile(parse_qos(both), TRANSFORMS).durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert choose_playback_profile(parse_qos(both), KEYPOINTS).durability == DurabilityPolicy.VOLATILE


@pytest.mark.ros
def test_an_override_holds_for_its_topic_alone(peer: Peer) -> None:
    import rclpy
    from rclpy.parameter import Parameter
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from mocap_ros.ros.subscriptions import InputSubscriptions

    overrides = {
        'keypoints.subscription.reliability': 'reliable',
        'camera_info.subscription.durability': 'transient_local',
    }
    node = rclpy.create_node(
        'listener',
        context=peer.context,
        parameter_overrides=[Parameter(f'qos_overrides./{name}', value=v) for name, v in overrides.items()],
    )
    inputs = InputSubscriptions(node, KEYPOINTS, MessageVersions(), lambda: Config().node)
    inputs.subscribe(cast(Any, None))

    def find_profiles() -> dict[str, tuple[Any, Any]]:
        found = {topic: peer.node.get_subscriptions_info_by_topic(topic) for topic in inputs.topics}
        profiles = {t: s.qos_profile for t, infos in found.items() for s in infos if s.node_name == 'listener'}
        return {topic: (p.reliability, p.durability) for topic, p in profiles.items()}

    peer.wait_until(lambda: len(find_profiles()) == 2)
    assert find_profiles() == {
        '/keypoints': (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        '/camera_info': (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL),
    }
    node.destroy_node()
