# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Put the people of one image on the page of a live scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.people import CameraVertical, People
from mocap_ros.recordings.load_results import follow_person
from mocap_ros.skeleton import skeleton_from_joints
from mocap_ros.viewing.live_page import LiveScene


def show_people(
    scene: LiveScene,
    stamp_ns: int,
    people: People,
    detected: Sequence[Person2D],
    intrinsics: Intrinsics,
    image_size: ImageSize,
    vertical: CameraVertical | None,
    jpeg: bytes,
) -> None:
    """Show people and what was detected in their image, of a size in px; an unsure vertical is left out."""
    rows = range(len(people))
    is_certain = vertical is not None and vertical.std <= MAX_CERTAIN_STD
    scene.publish(
        stamp_ns,
        people.ids,
        follow_person('', rows, people, rows, intrinsics),  # rows as frames
        [(skeleton_from_joints(p.joints), np.where(p.score[:, None] > 0, p.points, np.nan)) for p in detected],
        image_size,
        vertical.direction if vertical is not None and is_certain else np.full(3, np.nan),
        people.skeleton,
        jpeg,
    )
