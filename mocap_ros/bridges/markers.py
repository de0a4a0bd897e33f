# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray of shapes that come and go with people."""

from __future__ import annotations

from collections.abc import Sequence

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.markers import DELETE, Marker, encode_markers

LIFETIME_S = 0.5  # s; after which a viewer removes a marker by itself


def show_markers(header: Header, shown: Sequence[Marker], before: Sequence[Marker]) -> bytes:
    """Encode a MarkerArray of the markers, which deletes those of before that are not among them."""
    kept = {(marker.namespace, marker.number) for marker in shown}
    gone = [Marker(m.namespace, m.number, action=DELETE) for m in before if (m.namespace, m.number) not in kept]
    return encode_markers(header, [*gone, *shown], LIFETIME_S)
