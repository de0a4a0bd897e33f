# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Image points of face, feet and hands: `skeleton.BODY26` has the J_c joints of `CMU15`, then these J_e."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.left_right import BodySides, exchange_sides
from mocap_ros.keypoints.rays import convert_to_rays
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT

_BODY_SIDES = BodySides.of(BODY26)

# 1; feet and hands are nearer to the ankle or wrist, and the points of a face nearer to the middle of the
# shoulders, than these shares of the diagonal of the core's points, also where only the trunk or a leg is seen.
MAX_LIMB_REACH, MAX_FACE_REACH = 0.35, 0.7
_LIMB_ENDS = {'toe': 'ankle', 'heel': 'ankle', 'hand': 'wrist'}  # joints on which feet and hands hang


def _find_anchors() -> tuple[NDArray[np.intp], Array]:
    anchors, reach = [], []
    for name in BODY26.joints[CORE_COUNT:]:
        end = _LIMB_ENDS.get(name[1:])
        anchors.append((name[0] + end,) * 2 if end else ('lshoulder', 'rshoulder'))
        reach.append(MAX_LIMB_REACH if end else MAX_FACE_REACH)
    return np.array([[BODY26.index(joint) for joint in pair] for pair in anchors]), np.array(reach)


_ANCHORS, _REACH = _find_anchors()


class Extremities(NamedTuple):
    """Face, feet and hands: rays (..., J_e, 2) and confidence scores (..., J_e), both 0 where not seen."""

    rays: Array
    weight: Array

    def select_frames(self, frames: NDArray[np.intp] | slice | int) -> Extremities:
        """Return those of some of the frames, or of a single one."""
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
    """Convert keypoints to rays and scores of the core, and to the extremities, as `rays.convert_to_rays` does."""
    rays, weight = convert_to_rays(points, score, names, intrinsics, min_score, BODY26)
    # One that is somewhere else would spoil the whole lifted pose.
    engine.drop_far_points(
        rays.reshape(-1, *rays.shape[-2:]), weight.reshape(-1, weight.shape[-1]), _ANCHORS, _REACH
    )
    return split_body(rays, weight)


def split_body(rays: Array, weight: Array) -> tuple[Array, Array, Extremities]:
    """Split points (..., J, 2) and weights (..., J) of a body: the core's, and the extremities."""
    core = np.ascontiguousarray(rays[..., :CORE_COUNT, :]), np.ascontiguousarray(weight[..., :CORE_COUNT])
    return *core, Extremities(
        np.ascontiguousarray(rays[..., CORE_COUNT:, :]), np.ascontiguousarray(weight[..., CORE_COUNT:])
    )


def join_body(rays: Array, weight: Array, extremities: Extremities | None) -> tuple[Array, Array]:
    """Return points (..., J, 2) and weights (..., J) of a body; extremities that are None are not seen."""
    if extremities is None:
        unseen = np.zeros((*weight.shape[:-1], EXTREMITY_COUNT))
        extremities = Extremities(np.zeros((*unseen.shape, 2)), unseen)
    return (
        np.concatenate([rays, extremities.rays], axis=-2),
        np.concatenate([weight, extremities.weight], axis=-1),
    )


def exchange_body_sides(
    rays: Array, weight: Array, extremities: Extremities, is_swapped: NDArray[np.bool_]
) -> tuple[Array, Array, Extremities]:
    """Exchange left and right of parts (F, 3) of bodies in F frames as `left_right.exchange_sides` does."""
    if not np.count_nonzero(is_swapped):
        return rays, weight, extremities
    return split_body(*exchange_sides(*join_body(rays, weight, extremities), is_swapped, _BODY_SIDES))
