# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Memory of key poses by their appearance, for the initialisation of a person who appears again after a loss.

The idea is that of Loy et al. (ECCV 2004). A pose is recalled if its image y, in torso lengths, is near the image
x of a person, with the scale s and the translation t that fit best, by the distance of section 4.2 with max B = 1:

    distance = B A + (1 - A),    A = (joints seen in both images) / (joints seen in either)
    B = mean_j |(x_j - t) / s - y_j|      over the joints seen in both, torso lengths
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
    """A remembered pose that looks like a person in the current image."""

    pose: Array  # (J, 3) m, camera axes, centred on the mean of the joints
    scale: float  # px/m, scale of the pose in the current image
    translation: Array  # (2,) px, position of the pose's origin in the current image
    distance: float  # torso lengths, distance of the current image from the remembered one


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
        """Remember a pose (J, 3) m in the camera's axes, unless too few of its joints were seen.

        It replaces one that looks the same or, if the memory is full, the one that was remembered longest ago.
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
        """Return the pose that looks most like an image (J, 2) px; None if none is nearer than `beta`."""
        seen = weight > 0
        nearest = self._find_nearest(points, seen)
        if nearest is None:
            return None
        index, distance = nearest
        pose = self.poses[index].pose
        scale, translation = _fit_scale_translation(pose[seen, :2], points[seen])
        return RecalledPose(pose, scale, translation, distance)

    def _find_nearest(self, points: Array, seen: NDArray[np.bool_]) -> tuple[int, float] | None:
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
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    scale = max(float((a * b).sum() / max(float((a * a).sum()), MIN_SCALE)), 0.0)
    return scale, target.mean(axis=0) - scale * source.mean(axis=0)
