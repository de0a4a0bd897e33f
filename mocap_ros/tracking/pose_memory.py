# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Memory of key poses by their appearance, for the initialisation of a person who appears again after a loss.

The idea of a few 3D key poses that stand for all frames that look alike is that of Loy et al. (ECCV 2004). A pose
is recalled if its image y, in torso lengths, is near the image x of a person. The scale s and the translation t
bring y closest to x in the least-squares sense over the joints that both images show. The distance is that of
matrix C in section 4.2 of the paper, C = A B + (1 - A) max B, with max B = 1 torso length:

    A = (joints seen in both images) / (joints seen in either)
    B = mean_j |(x_j - t) / s - y_j|      over the joints seen in both, torso lengths
    distance = B A + (1 - A)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

MIN_COMMON_JOINTS = 6  # joints, the default of `tracker.min_joints`; fewer can be fitted to too many poses
MIN_SCALE = 1e-9  # px or px per torso length; guards divisions by the size of an image that is a single point


class KeyPose(NamedTuple):
    """A pose (J, 3) m, camera axes, about its mean; its image (J, 2) in torso lengths, and where it was seen."""

    image: Array
    seen: NDArray[np.bool_]
    pose: Array


class RecalledPose(NamedTuple):
    """A remembered pose that looks like a person in the current image.

    Attributes:
        pose: (J, 3) m, camera axes, centred on the mean of the joints.
        scale: px/m, scale of the pose in the current image.
        translation: (2,) px, position of the pose's origin in the current image.
        distance: torso lengths, distance of the current image from the remembered one.
    """

    pose: Array
    scale: float
    translation: Array
    distance: float


class KeyPoseMemory:
    """A limited number of key poses that look different from each other.

    Args:
        beta: torso lengths; images nearer to each other than this show the same pose (beta of Loy et al.).
        capacity: maximum number of poses.

    Attributes:
        poses: the remembered poses, the one that was remembered longest ago first.
    """

    def __init__(self, beta: float = 0.2, capacity: int = 64) -> None:
        self.beta, self._capacity = beta, capacity
        self.poses: list[KeyPose] = []

    def remember(self, points: Array, weight: Array, pose: Array) -> None:
        """Remember a pose, unless too few of its joints were seen.

        The pose replaces one that looks the same. If there is none and the memory is full, it replaces the one
        that was remembered longest ago.

        Args:
            points: (J, 2) px, joints of `CMU15`; any value for a joint of weight 0.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
            pose: (J, 3) m, camera axes.
        """
        seen = weight > 0
        if seen.sum() < MIN_COMMON_JOINTS:
            return
        centred = pose - pose.mean(axis=0)
        scale, _ = _fit_scale_translation(centred[seen, :2], points[seen])
        torso = float(np.linalg.norm(centred[CMU15.index('neck')] - centred[CMU15.index('pelvis')]))
        if scale * torso < MIN_SCALE:
            return
        nearest = self._find_nearest(points, seen)
        if nearest is not None:
            del self.poses[nearest[0]]
        self.poses.append(KeyPose(np.where(seen[:, None], points, 0.0) / (scale * torso), seen, centred))
        del self.poses[: -self._capacity]

    def recall(self, points: Array, weight: Array) -> RecalledPose | None:
        """Return the remembered pose that looks most like an image; None if none is nearer than `beta`.

        Args:
            points: (J, 2) px, joints of `CMU15`; any value for a joint of weight 0.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
        """
        seen = weight > 0
        nearest = self._find_nearest(points, seen)
        if nearest is None:
            return None
        index, distance = nearest
        pose = self.poses[index].pose
        scale, translation = _fit_scale_translation(pose[seen, :2], points[seen])
        return RecalledPose(pose, scale, translation, distance)

    def _find_nearest(self, points: Array, seen: NDArray[np.bool_]) -> tuple[int, float] | None:
        """Return the index and the distance of the nearest pose; None if none is nearer than `beta`."""
        nearest = None
        for index, key_pose in enumerate(self.poses):
            common = seen & key_pose.seen
            if common.sum() < MIN_COMMON_JOINTS:
                continue
            scale, translation = _fit_scale_translation(key_pose.image[common], points[common])
            if scale < MIN_SCALE:
                continue
            error = (points[common] - translation) / scale - key_pose.image[common]
            common_share = common.sum() / (seen | key_pose.seen).sum()
            distance = float(np.linalg.norm(error, axis=-1).mean() * common_share + (1 - common_share))
            if distance < self.beta and (nearest is None or distance < nearest[1]):
                nearest = index, distance
        return nearest


def _fit_scale_translation(source: Array, target: Array) -> tuple[float, Array]:
    """Return the scale and translation (2,) from points (N, 2) to others (N, 2), fitted by least squares."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    scale = max(float((a * b).sum() / max(float((a * a).sum()), MIN_SCALE)), 0.0)
    return scale, target.mean(axis=0) - scale * source.mean(axis=0)
