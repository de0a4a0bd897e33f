# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person in one image: the keypoints that a detector gives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.validation import find_border_points

# Classes of COCO and of pose models for animals, hands, faces and vehicles, whose detections may have keypoints.
OTHER_CLASSES = frozenset((
    'animal', 'bear', 'bicycle', 'bird', 'bus', 'car', 'cat', 'chimpanzee', 'cow', 'deer', 'dog', 'elephant',
    'face', 'fish', 'giraffe', 'hand', 'horse', 'monkey', 'motorcycle', 'mouse', 'panda', 'pig', 'rabbit', 'rat',
    'sheep', 'tiger', 'truck', 'vehicle', 'zebra',
))  # fmt: skip


@dataclass(eq=False)
class Person2D:
    """Keypoints of one person in one image."""

    id: str  # name that the detector gives the person; empty if it gives none
    joints: tuple[str, ...]  # (J,) joint names that `keypoints.joint_map` knows
    points: Array  # (J, 2) px, x to the right and y down; NaN for a joint that was not seen
    score: Array  # (J,) confidence scores in [0, 1]; 0 for a joint that was not seen
    # (J,) m along the optical axis of the surfaces that are seen there; NaN where unknown, None if all are
    depth: Array | None = None

    def hide_border(self, image_size: ImageSize) -> Person2D:
        """Return the person without points on the border of an image (`validation.find_border_points`)."""
        is_on = find_border_points(self.points, image_size)
        if not is_on.any():
            return self
        return replace(self, points=np.where(is_on[:, None], np.nan, self.points), score=self.score * ~is_on)


def is_person_class(name: object) -> bool:
    """Return whether detections of a class of this name may be people; models name them variously."""
    return not isinstance(name, str) or name.strip().lower() not in OTHER_CLASSES


def choose_depth(is_own: NDArray[np.bool_], own: Array | None, other: Array | None) -> Array | None:
    """Return depths (J,) in m of a person joined from two detections: `own` where `is_own`; None if both are."""
    if own is None and other is None:
        return None
    return np.where(is_own, np.nan if own is None else own, np.nan if other is None else other)
