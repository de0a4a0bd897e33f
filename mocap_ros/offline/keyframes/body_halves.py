# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The upper and the lower half of the body, which have separate keyframes (Loy et al. 2004, section 4.3).

Every bone belongs to one half: trunk, arms and head to the upper half, legs to the lower half. The 2D poses of a
half are measured in torso lengths, so that distances between poses do not depend on the person's distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.filters import build_low_pass_matrix, interpolate_gaps
from mocap_ros.skeleton import CMU15, Skeleton

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

MIN_SEEN_JOINTS = 4  # joints; a half with fewer seen joints fits almost any pose once it is translated
LOW_PASS_S = 0.05  # s, standard deviation; removes the detector's jitter, which would add to every distance
TORSO_STEP_S = 0.5  # s between estimates of the torso length, which changes slowly with the person's distance
TORSO_HALF_WINDOW_S = 1.5  # s; half of the 3 s whose frames take part in one estimate of the torso length
TORSO_PERCENTILE = 75  # %; above the median since foreshortening only shortens, below the highest for outliers
MIN_TORSO_PX = 1e-9  # px; guards the division by the torso length when all joints are in one place
MIN_FILTER_WEIGHT = 1e-6  # guards the division below where no frame near in time sees the joint


@dataclass(frozen=True)
class BodyHalf:
    """The joints and bones of one half of the body.

    Attributes:
        name: `upper` or `lower`.
        joints: indices into the skeleton's joints, increasing; the pelvis is in both halves.
        bones: (parent, child) joint indices; each bone of the skeleton is in one half only.
    """

    name: str
    joints: tuple[int, ...]
    bones: tuple[tuple[int, int], ...]


def split_into_halves(skeleton: Skeleton = CMU15) -> tuple[BodyHalf, BodyHalf]:
    """Return the upper and the lower half of a skeleton."""
    legs = [skeleton.index(side + joint) for joint in ('hip', 'knee', 'ankle') for side in 'lr']
    lower = tuple(b for b in skeleton.bones if b[1] in legs)
    upper = tuple(b for b in skeleton.bones if b[1] not in legs)
    return (
        BodyHalf('upper', tuple(sorted({j for bone in upper for j in bone})), upper),
        BodyHalf('lower', tuple(sorted({j for bone in lower for j in bone})), lower),
    )


@dataclass(frozen=True, eq=False)
class HalfPoses:
    """The 2D poses of one half of the body, in the frames that show enough joints of that half.

    Attributes:
        frames: (N,) indices of these frames in the sequence, increasing.
        times: (N,) s.
        points: (N, J, 2) torso lengths, up to a translation; arbitrary where not seen.
        seen: (N, J) True where a joint is seen or interpolated.
    """

    frames: NDArray[np.intp]
    times: Array
    points: Array32
    seen: Mask

    def __len__(self) -> int:
        return len(self.frames)

    def subset(self, index: NDArray[np.intp] | slice) -> HalfPoses:
        """Return the poses of the frames at the given positions."""
        return HalfPoses(self.frames[index], self.times[index], self.points[index], self.seen[index])


def extract_half_poses(points: Array, weight: Array, times: Array, half: BodyHalf, max_gap: float) -> HalfPoses:
    """Return the low-passed 2D poses of one half of the body, in torso lengths.

    Args:
        points: (F, J, 2) px, joints of `CMU15`; arbitrary where the weight is 0.
        weight: (F, J) confidence scores, 0 where not seen.
        times: (F,) s, increasing.
        half: half of the body.
        max_gap: s; a joint that is not seen for at most this long is interpolated.
    """
    in_torsos = points / estimate_torso_lengths(points, weight, times)[:, None, None]
    joints = list(half.joints)
    low_pass = build_low_pass_matrix(times, LOW_PASS_S)
    seen = weight > 0
    filter_weight = np.maximum(low_pass @ seen, MIN_FILTER_WEIGHT)
    in_torsos = np.stack([(low_pass @ (in_torsos[..., d] * seen)) / filter_weight for d in (0, 1)], axis=-1)
    half_points, known = interpolate_gaps(in_torsos[:, joints], weight[:, joints] > 0, times, max_gap)
    frames = np.flatnonzero(known.sum(axis=1) >= MIN_SEEN_JOINTS)
    return HalfPoses(frames, times[frames], half_points[frames].astype(np.float32), known[frames])


def estimate_torso_lengths(points: Array, weight: Array, times: Array) -> Array:
    """Estimate the lengths (F,) that the torso (pelvis to neck) would have in the image without foreshortening.

    It is the upper quartile of the lengths seen within 3 s: foreshortening only shortens a length, and the
    quartile tolerates some outliers. If neck and pelvis are never seen together, one size of the body's image
    stands for all frames. Arguments are those of `extract_half_poses`; the unit is that of the points.
    """
    neck, pelvis = CMU15.index('neck'), CMU15.index('pelvis')
    torso_frames = np.flatnonzero((weight[:, [neck, pelvis]] > 0).all(axis=1))
    if not len(torso_frames):
        return np.full(len(times), _estimate_image_size(points, weight))
    length = np.linalg.norm(points[torso_frames, neck] - points[torso_frames, pelvis], axis=-1)
    knots = np.arange(times[0], times[-1] + TORSO_STEP_S, TORSO_STEP_S)
    first = np.searchsorted(times[torso_frames], knots - TORSO_HALF_WINDOW_S)
    last = np.searchsorted(times[torso_frames], knots + TORSO_HALF_WINDOW_S, side='right')
    known = np.flatnonzero(last > first)
    at_knots = [np.percentile(length[first[k] : last[k]], TORSO_PERCENTILE) for k in known]
    return np.maximum(np.interp(times, knots[known], at_knots), MIN_TORSO_PX)


def _estimate_image_size(points: Array, weight: Array) -> float:
    """Return the root mean square distance (px) of all seen points from their mean, or 1 px if none is seen."""
    seen = points[weight > 0]
    return max(float(np.sqrt(seen.var(axis=0).sum())), MIN_TORSO_PX) if len(seen) else 1.0
