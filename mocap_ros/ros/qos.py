# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""QoS profiles of the node's topics, and their conversion to and from those in bags."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import Qos

from mocap_ros.messages.transforms import TRANSFORMS

QUEUE_DEPTH = 10  # messages; the default of ROS 2; waiting messages are queued in the node, not in the middleware
# Messages of an input that may wait in the middleware while the thread that takes them has no turn: 0.25 s at
# 200 Hz, the greatest delay that this adds. The node takes all at once, and counts those that did not fit.
INPUT_QUEUE_DEPTH = 50
TF_QUEUE_DEPTH = 100  # messages; the depth that tf2_ros uses on /tf
PLAYBACK_QUEUE_DEPTH = 1000  # messages; lets a slow reliable subscriber catch up when a bag is played fast

# The policies that `qos_overrides` parameters of a subscription set: those that rclpy chooses by default, and the
# durability, in which publishers of transforms differ.
OVERRIDABLE_POLICIES = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)

# Best effort is compatible with reliable and with best-effort publishers.
INPUT_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=INPUT_QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT
)
# Reliable is compatible with reliable and with best-effort subscribers.
OUTPUT_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
TF_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=TF_QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
# As tf2_ros subscribes to /tf_static, where each publisher keeps its transforms for late subscribers.
STATIC_TF_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=TF_QUEUE_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# Late subscribers receive the last message.
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def profile_to_rosbag2(profile: QoSProfile) -> dict[str, Any]:
    """Convert a profile to the keys and values that rosbag2 writes into a bag."""

    def split(duration: Duration) -> dict[str, int]:
        return dict(zip(('sec', 'nsec'), divmod(duration.nanoseconds, 10**9), strict=True))

    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': split(profile.deadline),
        'lifespan': split(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': split(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def choose_playback_profile(recorded: Sequence[Qos], msgtype: str = '') -> QoSProfile:
    """Return a profile for publishing recorded messages again.

    The profile has the reliability and the durability of the recorded publishers if these agree. Otherwise, and if
    nothing is recorded, it is reliable and volatile, which every subscriber accepts that does not ask for
    transient-local durability. Static transforms are all kept for late subscribers, as they came from several
    publishers, each of which kept its own.

    Args:
        recorded: Profiles that the publishers offered while the bag was recorded.
        msgtype: Type of the messages.
    """
    reliability = {q.reliability.name for q in recorded}
    durability = {q.durability.name for q in recorded}
    transient_local = DurabilityPolicy.TRANSIENT_LOCAL.name
    is_latched = durability == {transient_local} or (msgtype == TRANSFORMS and transient_local in durability)
    is_best_effort = reliability == {ReliabilityPolicy.BEST_EFFORT.name}
    return QoSProfile(
        depth=max(1, *(q.depth for q in recorded))
        if is_latched and msgtype != TRANSFORMS
        else PLAYBACK_QUEUE_DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if is_best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )
