# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of /tf and /tf_static."""

from __future__ import annotations

from typing import Any

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.transforms import StampedTransform, write_transforms

SECOND_NS = 1_000_000_000  # ns in a second


def make_transforms(*transforms: Any) -> bytes:
    """Return a TFMessage of (parent, child, stamp in ns, translation in m, and optionally a quaternion)."""
    return write_transforms([_list_fields(*t) for t in transforms])


def _list_fields(
    parent: str, child: str, stamp_ns: int, translation: Any, rotation: Any = (0, 0, 0, 1)
) -> StampedTransform:
    return Header(stamp_ns, parent), child, (*translation, *rotation)
