# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The size of an image comes from the first source that knows it."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size

STATED, CAMERA, CONFIGURED = (1920, 1080), (640, 480), (1280, 720)


def make_keypoints(*points: tuple[float, float]) -> np.ndarray:
    """Return seen keypoints (1, J, 3) at these places, and one far outside that is not seen."""
    return np.array([[*((x, y, 0.9) for x, y in points), (9000.0, 9000.0, 0.0)]])


def test_the_order_is_message_camera_user_and_then_the_keypoints() -> None:
    keypoints = make_keypoints((2000, 100))
    order = {'stated': STATED, 'camera': CAMERA, 'configured': CONFIGURED}
    for name, size in order.items():
        known = {n: s for n, s in order.items() if list(order).index(n) >= list(order).index(name)}
        assert resolve_image_size(**known, keypoints=keypoints) == size
    assert resolve_image_size(keypoints=keypoints) == (2560, 1440)
    assert resolve_image_size() == UNKNOWN_SIZE


@pytest.mark.parametrize('unknown', [None, (0, 0), (640, 0), (0, 480)])
def test_a_size_without_both_sides_is_unknown(unknown: tuple[int, int] | None) -> None:
    assert resolve_image_size(stated=unknown, camera=unknown, configured=CONFIGURED) == CONFIGURED
    assert resolve_image_size(stated=unknown, camera=unknown, configured=unknown) == UNKNOWN_SIZE


@pytest.mark.parametrize(
    ('point', 'size'),
    [
        ((640, 480), (640, 480)),
        ((641, 10), (1280, 720)),
        ((10, 481), (1280, 720)),
        ((1920, 1080), (1920, 1080)),
        ((8000, 10), (7680, 4320)),
    ],
)
def test_the_smallest_common_size_that_holds_the_seen_keypoints_is_assumed(
    point: tuple[float, float], size: tuple[int, int]
) -> None:
    assert resolve_image_size(keypoints=make_keypoints(point)) == size
