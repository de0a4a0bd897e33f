"""QoS profiles of rclpy and as bags keep them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

DEPTH = 1000


def recorded_profile(profile: QoSProfile) -> dict[str, Any]:
    """A profile by rosbag2's names."""
    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _seconds(profile.deadline),
        'lifespan': _seconds(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _seconds(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def playing_profile(recorded: Sequence[Qos]) -> QoSProfile:
    """What to offer in the place of recorded publishers: reliability and durability, where they agree on them.

    Otherwise, and where nothing is recorded, reliable and volatile, which suits every subscriber but latched ones.
    """
    reliability = {q.reliability.name for q in recorded}
    durability = {q.durability.name for q in recorded}
    latched = durability == {DurabilityPolicy.TRANSIENT_LOCAL.name}
    best_effort = reliability == {ReliabilityPolicy.BEST_EFFORT.name}
    return QoSProfile(
        depth=max(1, *(q.depth for q in recorded)) if latched else DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _seconds(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {'sec': seconds, 'nsec': nanoseconds}
