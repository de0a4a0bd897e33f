"""Image points of face, feet and hands, which go beside those of the core.

A body are the joints of `skeleton.BODY26`: its core, the J_c joints of `skeleton.CMU15`, which the solvers
reconstruct, and then its J_e extremities. The lifter sees both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.left_right import BodySides, exchange_sides
from mocap_ros.keypoints.rays import convert_to_rays
from mocap_ros.skeleton import BODY26, CORE_COUNT

Array = NDArray[np.float64]

EXTREMITY_COUNT = len(BODY26.joints) - CORE_COUNT  # joints
_BODY_SIDES = BodySides.of(BODY26)


class Extremities(NamedTuple):
    """Face, feet and hands in one frame or in F frames.

    Attributes:
        rays: (J_e, 2) or (F, J_e, 2) x / z and y / z in the camera; 0 for a joint that was not seen.
        weight: (J_e,) or (F, J_e) confidence scores in [0, 1]; 0 for a joint that was not seen.
    """

    rays: Array
    weight: Array

    def select_frames(self, frames: NDArray[np.intp] | slice) -> Extremities:
        """Return those of some of the frames."""
        return Extremities(self.rays[frames], self.weight[frames])

    def append_frame(self, newest: Extremities, dropped: int) -> Extremities:
        """Return those of F frames without the oldest `dropped` ones, and those of one more frame."""
        return Extremities(
            np.concatenate([self.rays[dropped:], newest.rays[None]]),
            np.concatenate([self.weight[dropped:], newest.weight[None]]),
        )


def convert_body_to_rays(
    points: Array, score: Array, names: tuple[str, ...], intrinsics: Intrinsics, min_score: float
) -> tuple[Array, Array, Extremities]:
    """Convert keypoints to rays (..., J_c, 2) and scores (..., J_c) of the core, and to the extremities.

    Arguments and errors are those of `rays.convert_to_rays`.
    """
    rays, weight = convert_to_rays(points, score, names, intrinsics, min_score, BODY26)
    return split_body(rays, weight)


def split_body(rays: Array, weight: Array) -> tuple[Array, Array, Extremities]:
    """Split points (..., J, 2) and weights (..., J) of a body: the core's, and the extremities."""
    core = np.ascontiguousarray(rays[..., :CORE_COUNT, :]), np.ascontiguousarray(weight[..., :CORE_COUNT])
    return *core, Extremities(
        np.ascontiguousarray(rays[..., CORE_COUNT:, :]), np.ascontiguousarray(weight[..., CORE_COUNT:])
    )


def join_body(rays: Array, weight: Array, extremities: Extremities | None) -> tuple[Array, Array]:
    """Return points (F, J, 2) and weights (F, J) of a body; extremities that are None are not seen."""
    if extremities is None:
        extremities = Extremities(
            np.zeros((len(rays), EXTREMITY_COUNT, 2)), np.zeros((len(rays), EXTREMITY_COUNT))
        )
    return np.concatenate([rays, extremities.rays], axis=1), np.concatenate([weight, extremities.weight], axis=1)


def exchange_body_sides(
    rays: Array, weight: Array, extremities: Extremities, is_swapped: NDArray[np.bool_]
) -> tuple[Array, Array, Extremities]:
    """Exchange left and right of parts of bodies as `left_right.exchange_sides` does.

    Args:
        rays: (F, J_c, 2) rays of the core.
        weight: (F, J_c) its confidence scores.
        extremities: those of the same frames.
        is_swapped: (F, 3) parts whose sides are exchanged in a frame.
    """
    if not np.count_nonzero(is_swapped):
        return rays, weight, extremities
    return split_body(*exchange_sides(*join_body(rays, weight, extremities), is_swapped, _BODY_SIDES))
