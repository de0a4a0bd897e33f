"""The image points that keyframes are made from: of a virtual camera that looks at the person."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import View, solver_focal
from mocap_ros.keypoints.left_right import swapped_frames
from mocap_ros.offline.keyframes.body_halves import torso_lengths
from mocap_ros.offline.keyframes.filters import median
from mocap_ros.offline.whole_sequence import FACING
from mocap_ros.skeleton import CMU15, model_joints

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SECTION, MARGIN = 60.0, 6.0
ENOUGH_FOR_A_POSE = 4
CUT, LONGEST_ABSENCE = 0.5, 0.5


@dataclass(frozen=True, eq=False)
class Observed:
    """One person's joints in the images of virtual cameras.

    Attributes:
        times: (F,) s, increasing.
        pixels: (F, J, 2) px in the image, joints of `CMU15`, sides as they should be; 0 where the weight is.
        points: (F, J, 2) px from the virtual camera's axis.
        weight: (F, J) detector scores, 0 where not seen.
        view: the virtual cameras, one a frame.
        focal: px; infinite where projection is taken for weak perspective.
    """

    times: Array
    pixels: Array
    points: Array
    weight: Array
    view: View
    focal: float

    def without(self, wrong: Mask) -> Observed:
        """The same with some points (F, J) counted as not seen."""
        weight = np.where(wrong, 0.0, self.weight)
        known = weight[..., None] > 0
        return replace(
            self,
            weight=weight,
            points=np.where(known, self.points, 0.0),
            pixels=np.where(known, self.pixels, 0.0),
        )


def sections(times: Array, seconds: float, margin: float) -> list[tuple[slice, slice]]:
    """Frames in parts of about equal length: the part with its margin on both sides, and the part alone.

    Args:
        times: (F,) s, increasing.
        seconds: length of a part at most.
        margin: s on either side.
    """
    count = max(int(np.ceil((times[-1] - times[0]) / seconds)), 1)
    edges = np.searchsorted(times, np.linspace(times[0], times[-1], count + 1)[1:-1]).tolist()
    bounds = sorted({0, *edges, len(times)})
    out = []
    for first, last in pairwise(bounds):
        wide = np.searchsorted(times, [times[first] - margin, times[last - 1] + margin], side='left')
        out.append((slice(int(wide[0]), max(int(wide[1]), last)), slice(first, last)))
    return out


def observe(
    keypoints: Array, joint_names: tuple[str, ...], times: Array, intrinsics: Intrinsics, config: TrackerConfig
) -> Observed:
    """The joints of the model in a virtual camera, as `offline.reconstruct_sequence` sees them.

    Args:
        keypoints: (F, J, 3) x, y in px and score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `skeleton.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: of the camera.
        config: `min_score`, `undo_swaps` and `perspective` apply.

    Raises:
        SkeletonError: too few of the model's joints can be had from these names.
        InputError: no frame has four seen joints.
    """
    pixels, weight = model_joints(keypoints[..., :2], keypoints[..., 2], joint_names, config.min_score)
    if not ((weight > 0).sum(axis=1) >= ENOUGH_FOR_A_POSE).any():
        raise InputError('no frame has four seen joints: nothing to reconstruct')
    points, turns = np.empty_like(pixels), np.empty((len(times), 3, 3))
    if config.undo_swaps:
        pixels, weight = _relabelled(pixels, weight, times)
    for wide, own in sections(times, SECTION, MARGIN):
        inner = slice(own.start - wide.start, own.stop - wide.start)
        rays = intrinsics.rays(pixels[wide])
        view = View.of(rays, weight[wide], times[wide], FACING, intrinsics)
        points[own] = view.image(rays)[inner]
        turns[own] = view.turn[inner]
    points = np.where(weight[..., None] > 0, points, 0.0)
    view = View(turns, intrinsics)
    return Observed(times, pixels, points, weight, view, solver_focal(intrinsics, config.perspective))


def _relabelled(points: Array, weight: Array, times: Array) -> tuple[Array, Array]:
    """Points and weights with left and right as they should be, each shot of the video by itself."""
    mirror = np.array(CMU15.mirror)
    points, weight = points.copy(), weight.copy()
    for shot in shots(points, weight, times):
        at = np.flatnonzero(swapped_frames(times[shot], points[shot], weight[shot], mirror)) + shot.start
        points[at], weight[at] = points[at][:, mirror], weight[at][:, mirror]
    return points, weight


def shots(points: Array, weight: Array, times: Array) -> list[slice]:
    """Frames between cuts: where most joints jump far at once, or nothing is seen for long. At most `SECTION` s.

    Args:
        points: (F, J, 2) px.
        weight: (F, J), 0 where not seen.
        times: (F,) s, increasing.
    """
    some = np.flatnonzero((weight > 0).sum(axis=1) >= ENOUGH_FOR_A_POSE)
    torso = torso_lengths(points, weight, times)[some[1:]]
    mirror = np.array(CMU15.mirror)
    before, after = some[:-1], some[1:]
    ways = []
    for order in (np.arange(len(mirror)), mirror):  # sides that are swapped are no cut
        both = (weight[after] > 0) & (weight[before][:, order] > 0)
        moved = np.linalg.norm(points[after] - points[before][:, order], axis=-1)
        ways.append(np.nan_to_num(median(np.where(both, moved, np.nan), axis=1)))
    typical = np.minimum(*ways)
    far = (typical > CUT * torso) | (np.diff(times[some]) > LONGEST_ABSENCE)
    cuts = set(some[1:][far].tolist()) | {own.start for _, own in sections(times, SECTION, 0.0)}
    bounds = sorted({0, *cuts, len(times)})
    return [slice(a, b) for a, b in pairwise(bounds)]
