# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""QoS profiles of the nodes' topics, and their conversion to and from those in bags."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

from mocap_ros.messages.transforms import TRANSFORMS

# Messages of an input that may wait in the middleware while the thread that takes them has no turn: 0.25 s at
# 200 Hz, the greatest delay that this adds. The node takes all at once, and counts those that did not fit.
INPUT_QUEUE_DEPTH = 50
TF_QUEUE_DEPTH = 100  # messages; the depth that tf2_ros uses on /tf
PLAYBACK_QUEUE_DEPTH = 1000  # messages; lets a slow reliable subscriber catch up when a bag is played fast
RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED = DurabilityPolicy.TRANSIENT_LOCAL

# The policies that `qos_overrides` parameters of a subscription set: those that rclpy chooses by default, and the
# durability, in which publishers of transforms differ.
OVERRIDABLE_POLICIES = tuple(QoSPolicyKind[name] for name in ('HISTORY', 'DEPTH', 'RELIABILITY', 'DURABILITY'))

# Best available is reliable where all publishers are, else best effort, as `ros2 topic echo` and rosbag2 have it.
# Reliable outputs are compatible with both kinds of subscribers.
BEST_AVAILABLE = ReliabilityPolicy.BEST_AVAILABLE
INPUT_QOS = QoSProfile(depth=INPUT_QUEUE_DEPTH, reliability=BEST_AVAILABLE)
# The newest message only: a detector that is slower than the camera must not fall behind.
NEWEST_QOS = QoSProfile(depth=1, reliability=BEST_AVAILABLE)
OUTPUT_QOS = QoSProfile(depth=10, reliability=RELIABLE)  # the default of ROS 2
TF_QOS = QoSProfile(depth=TF_QUEUE_DEPTH, reliability=RELIABLE)
# Late subscribers get the last messages: of /tf_static those of each publisher, as tf2_ros subscribes to it.
STATIC_TF_QOS = QoSProfile(depth=TF_QUEUE_DEPTH, reliability=RELIABLE, durability=LATCHED)
LATCHED_QOS = QoSProfile(depth=1, reliability=RELIABLE, durability=LATCHED)


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
    """Return a profile for publishing messages of a bag whose publishers offered the recorded profiles.

    It has their reliability and durability if these agree. Otherwise, and if nothing is recorded, it is reliable
    and volatile, which every subscriber accepts that does not ask for transient-local durability. Static
    transforms are all kept for late subscribers, as they came from several publishers, each of which kept its own.
    """
    durability = {q.durability.name for q in recorded}
    is_transform = msgtype == TRANSFORMS
    is_latched = durability == {LATCHED.name} or (is_transform and LATCHED.name in durability)
    is_best_effort = {q.reliability.name for q in recorded} == {BEST_EFFORT.name}
    keeps_all = is_transform or not is_latched
    return QoSProfile(
        depth=PLAYBACK_QUEUE_DEPTH if keeps_all else max(1, *(q.depth for q in recorded)),
        reliability=BEST_EFFORT if is_best_effort else RELIABLE,
        durability=LATCHED if is_latched else DurabilityPolicy.VOLATILE,
    )
