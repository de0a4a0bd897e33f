"""Key poses remembered by how they look, to start again from after a loss.

Pure and immutable: remembering gives a new memory, so that a copy of the reference is a snapshot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

FEWEST_COMMON = 6
SMALLEST = 1e-9


@dataclass(frozen=True, eq=False)
class Remembered:
    """One pose: its image (J, 2) in torso lengths, which joints were seen (J,), and the pose (J, 3) m, centred."""

    image: Array
    seen: NDArray[np.bool_]
    pose: Array


@dataclass(frozen=True, eq=False)
class Recalled:
    """A remembered pose that looks like what is seen.

    Attributes:
        pose: (J, 3) m, camera's axes, centred.
        scale: px/m, translation: (2,) px: where it lies in the image.
        distance: torso lengths, of the image from the remembered one.
    """

    pose: Array
    scale: float
    translation: Array
    distance: float


@dataclass(frozen=True)
class KeyPoseMemory:
    """At most `capacity` poses that look different from each other, the one used longest ago first.

    Attributes:
        beta: torso lengths, images nearer than this are of the same pose.
        capacity: poses kept.
        poses: what is remembered.
    """

    beta: float = 0.2
    capacity: int = 64
    poses: tuple[Remembered, ...] = ()

    def remember(self, points: Array, weight: Array, pose: Array) -> KeyPoseMemory:
        """With one pose more; it takes the place of one that looks the same, or of the one used longest ago.

        Args:
            points: (J, 2) px, joints of `CMU15`; anything where the weight is 0.
            weight: (J,), 0 where not seen.
            pose: (J, 3) m, camera's axes.

        Raises:
            InputError: shapes that do not fit.
        """
        if points.shape != (*weight.shape, 2) or pose.shape != (*weight.shape, 3):
            raise InputError(f'points {points.shape}, weight {weight.shape} and pose {pose.shape} do not fit')
        seen = weight > 0
        if seen.sum() < FEWEST_COMMON:
            return self
        body = pose - pose.mean(axis=0)
        scale, _ = _placed(body[seen, :2], points[seen])
        torso = float(np.linalg.norm(body[CMU15.index('neck')] - body[CMU15.index('pelvis')]))
        if scale * torso < SMALLEST:
            return self
        new = Remembered(np.where(seen[:, None], points, 0.0) / (scale * torso), seen, body)
        nearest = self._nearest(points, seen)
        kept = [p for i, p in enumerate(self.poses) if nearest is None or i != nearest[0]]
        return replace(self, poses=(*kept[-(self.capacity - 1) :], new) if self.capacity > 1 else (new,))

    def recall(self, points: Array, weight: Array) -> Recalled | None:
        """The remembered pose that looks most like this one, or None where none is nearer than `beta`.

        Args:
            points: (J, 2) px, as of `remember`.
            weight: (J,) as there.
        """
        seen = weight > 0
        nearest = self._nearest(points, seen)
        if nearest is None:
            return None
        index, distance = nearest
        pose = self.poses[index].pose
        scale, translation = _placed(pose[seen, :2], points[seen])
        return Recalled(pose, scale, translation, distance)

    def _nearest(self, points: Array, seen: NDArray[np.bool_]) -> tuple[int, float] | None:
        """Index and distance of the nearest pose, if it is nearer than `beta`."""
        best = None
        for index, known in enumerate(self.poses):
            both = seen & known.seen
            if both.sum() < FEWEST_COMMON:
                continue
            scale, translation = _placed(known.image[both], points[both])
            if scale < SMALLEST:
                continue
            error = (points[both] - translation) / scale - known.image[both]
            common = both.sum() / (seen | known.seen).sum()
            distance = float(np.linalg.norm(error, axis=-1).mean() * common + (1 - common))
            if distance < self.beta and (best is None or distance < best[1]):
                best = index, distance
        return best


def _placed(flat: Array, image: Array) -> tuple[float, Array]:
    """Scale and translation that bring points (N, 2) closest to an image (N, 2); no rotation."""
    a, b = flat - flat.mean(axis=0), image - image.mean(axis=0)
    scale = max(float((a * b).sum() / max(float((a * a).sum()), SMALLEST)), 0.0)
    return scale, image.mean(axis=0) - scale * flat.mean(axis=0)
