"""The two halves of the body, which have keyframes of their own, and poses as their distances see them.

Every bone belongs to one half: the trunk, the arms and the head to the upper one, the legs to the lower one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.filters import bridged, low_pass
from mocap_ros.skeleton import CMU15, Skeleton

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

FEWEST_SEEN = 4
SMOOTHING = 0.05
TORSO_STEP, TORSO_TIME = 0.5, 1.5
TORSO_PERCENTILE = 75
SMALLEST = 1e-9


@dataclass(frozen=True)
class Half:
    """Joints of one half of the body.

    Attributes:
        name: `upper` or `lower`.
        joints: indices into the skeleton.
        bones: (parent, child) of the skeleton, each in one half only.
    """

    name: str
    joints: tuple[int, ...]
    bones: tuple[tuple[int, int], ...]


def halves(skeleton: Skeleton = CMU15) -> tuple[Half, Half]:
    """The upper and the lower half of a skeleton; the pelvis is in both."""
    legs = [skeleton.index(side + joint) for joint in ('hip', 'knee', 'ankle') for side in 'lr']
    lower = tuple(b for b in skeleton.bones if b[1] in legs)
    upper = tuple(b for b in skeleton.bones if b[1] not in legs)
    return (
        Half('upper', tuple(sorted({j for bone in upper for j in bone})), upper),
        Half('lower', tuple(sorted({j for bone in lower for j in bone})), lower),
    )


@dataclass(frozen=True, eq=False)
class HalfPoses:
    """2D poses of one half in frames in which enough of it is seen.

    Attributes:
        frames: (N,) their indices in the sequence, increasing.
        times: (N,) s.
        points: (N, J, 2) torso lengths, any translation; anything where not seen.
        seen: (N, J).
    """

    frames: NDArray[np.intp]
    times: Array
    points: Array32
    seen: Mask

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def take(self, which: NDArray[np.intp] | slice) -> HalfPoses:
        """Some of the frames."""
        return HalfPoses(self.frames[which], self.times[which], self.points[which], self.seen[which])


def half_poses(points: Array, weight: Array, times: Array, half: Half, bridge: float) -> HalfPoses:
    """The poses of one half in a sequence.

    Args:
        points: (F, J, 2) px, joints of `CMU15`; anything where the weight is 0.
        weight: (F, J).
        times: (F,) s, increasing.
        half: of the body.
        bridge: s; a joint not seen for less is interpolated.
    """
    in_torsos = points / torso_lengths(points, weight, times)[:, None, None]
    joints = list(half.joints)
    low = low_pass(times, SMOOTHING)
    trust = weight > 0
    in_torsos = np.stack(
        [(low @ (in_torsos[..., d] * trust)) / np.maximum(low @ trust, 1e-6) for d in (0, 1)], axis=-1
    )
    own, seen = bridged(in_torsos[:, joints], weight[:, joints] > 0, times, bridge)
    frames = np.flatnonzero(seen.sum(axis=1) >= FEWEST_SEEN)
    return HalfPoses(frames, times[frames], own[frames].astype(np.float32), seen[frames])


def torso_lengths(points: Array, weight: Array, times: Array) -> Array:
    """(F,) px, length of the torso (pelvis to neck) in the image were it not foreshortened.

    It is the upper quartile over some seconds: foreshortening only shortens, and a joint in a wrong place now and
    then does not matter. Arguments as of `half_poses`.
    """
    neck, pelvis = CMU15.index('neck'), CMU15.index('pelvis')
    both = np.flatnonzero((weight[:, [neck, pelvis]] > 0).all(axis=1))
    if not len(both):
        return np.full(len(times), _body_size(points, weight))
    length = np.linalg.norm(points[both, neck] - points[both, pelvis], axis=-1)
    knots = np.arange(times[0], times[-1] + TORSO_STEP, TORSO_STEP)
    first = np.searchsorted(times[both], knots - TORSO_TIME)
    last = np.searchsorted(times[both], knots + TORSO_TIME, side='right')
    known = np.flatnonzero(last > first)
    at_knots = [np.percentile(length[first[k] : last[k]], TORSO_PERCENTILE) for k in known]
    return np.maximum(np.interp(times, knots[known], at_knots), SMALLEST)


def _body_size(points: Array, weight: Array) -> float:
    seen = points[weight > 0]
    return max(float(np.sqrt(seen.var(axis=0).sum())), SMALLEST) if len(seen) else 1.0
