# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of /tf and /tf_static."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.messages.cdr import Header, create_message, encode
from mocap_ros.messages.transforms import TRANSFORMS
from tests.support.message_objects import create_transform

SECOND_NS = 1_000_000_000  # ns in a second


def make_transforms(*transforms: Any) -> bytes:
    """Return a TFMessage of (parent, child, stamp in ns, translation in m, and optionally a quaternion)."""
    return encode(create_message(TRANSFORMS, transforms=[_create(*t) for t in transforms]), TRANSFORMS)


def _create(parent: str, child: str, stamp_ns: int, translation: Any, rotation: Any = (0, 0, 0, 1)) -> Any:
    header, position = Header(stamp_ns, parent), np.array(translation, float)
    return create_transform(header, child, position, [*map(float, rotation)])
