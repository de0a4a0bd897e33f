# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A detector's keypoints as rays of the camera to the model's joints, the first step of every reconstruction.

Face, feet and hands are the J_e joints that `skeleton.BODY26` has after the J_c of `CMU15`, the core.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import MAX_CACHED_MAPS, MIN_TARGET_JOINTS, build_joint_map
from mocap_ros.keypoints.left_right import BodySides, exchange_sides
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, EXTREMITY_COUNT, Skeleton, canonical_joint_names

_SIDES = BodySides.of(BODY26)
_EXTREMITY_SIDES = _SIDES._replace(mirror=_SIDES.mirror[CORE_COUNT:] - CORE_COUNT, part=_SIDES.part[CORE_COUNT:])

# 1; feet and hands are nearer to the ankle or wrist, and the points of a face nearer to the middle of the
# shoulders, than these shares of the diagonal of the core's points, also where only the trunk or a leg is seen.
# One that is somewhere else would spoil the whole lifted pose.
MAX_LIMB_REACH, MAX_FACE_REACH = 0.35, 0.7
_LIMB_ENDS = {'toe': 'ankle', 'heel': 'ankle', 'hand': 'wrist'}  # joints on which feet and hands hang


def _find_anchors() -> tuple[NDArray[np.int64], Array]:
    anchors, reach = [], []
    for name in BODY26.joints[CORE_COUNT:]:
        end = _LIMB_ENDS.get(name[1:])
        anchors.append((name[0] + end,) * 2 if end else ('lshoulder', 'rshoulder'))
        reach.append(MAX_LIMB_REACH if end else MAX_FACE_REACH)
    return np.array([[BODY26.index(joint) for joint in pair] for pair in anchors]), np.array(reach)


_HANGING = _find_anchors()
_NOT_HANGING = np.zeros((0, 2), np.int64), np.zeros(0)  # other skeletons have a core alone


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

    def exchange_sides(self, is_swapped: NDArray[np.bool_]) -> Extremities:
        """Return those with left and right of parts (F, 3) of the body exchanged."""
        return Extremities(*exchange_sides(self.rays, self.weight, is_swapped, _EXTREMITY_SIDES))


def convert_to_rays(
    points: Array,
    score: Array,
    names: tuple[str, ...],
    intrinsics: Intrinsics,
    min_score: float,
    skeleton: Skeleton = CMU15,
) -> tuple[Array, Array, NDArray[np.bool_], Extremities]:
    """Map keypoints to the joints of the model and undo the distortion of the lens.

    Points (F, Js, 2) px and scores (F, Js) are NaN or 0 where not seen, and scores below `min_score` count as 0.
    Returns rays (F, J_c, 2), x / z and y / z, and scores (F, J_c) in [0, 1] of the joints of `skeleton`, both 0
    where not seen and for those farther from the optical axis than any camera shows; which of them are evidence
    (F, J_c); and the extremities, of which other skeletons than `CMU15` have none.

    Evidence are joints that were seen themselves, not derived from others of the body. A head by points of the
    face was. Neck and pelvis midway between shoulders and hips were not, by whatever program: in the model they
    are elsewhere, by up to a fifth of the trunk. Where fewer than `MIN_TARGET_JOINTS` were seen, all count.

    Raises:
        SkeletonError: A name repeats, or the names cover too few of the model's joints.
    """
    is_core = skeleton == CMU15
    joints = build_joint_map(names, BODY26 if is_core else skeleton)
    rays, weight, is_evidence, *others = engine.convert_to_rays(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(score, float),
        joints.weights,
        joints.score_factor,
        min_score,
        intrinsics.focal_lengths,
        intrinsics.center_array,
        intrinsics.distortion.parameters,
        joints.shows,
        joints.midway,
        MIN_TARGET_JOINTS,
        *(_HANGING if is_core else _NOT_HANGING),
    )
    return rays, weight, is_evidence, Extremities(*others)


@lru_cache(maxsize=MAX_CACHED_MAPS)
def _find_core_keypoints(names: tuple[str, ...]) -> NDArray[np.intp]:
    keypoints = canonical_joint_names(names)
    found = [(j, keypoints.index(name)) for j, name in enumerate(CMU15.joints) if name in keypoints]
    return np.array(found, np.intp).reshape(-1, 2).T


def select_core_depth(depth: Array | None, names: tuple[str, ...], weight: Array) -> Array | None:
    """Return the depths (..., J_c) m of core joints that are keypoints themselves and were seen; NaN of others.

    `depth` (..., Js) m of the surfaces at keypoints, NaN where unknown; None if all are, as is the result;
    `weight` (..., J_c) the scores of `convert_to_rays`.
    """
    if depth is None:
        return None
    core, source = _find_core_keypoints(names)
    out = np.full(weight.shape, np.nan)
    out[..., core] = np.where(weight[..., core] > 0, depth[..., source], np.nan)
    return out


def join_body(rays: Array, weight: Array, extremities: Extremities | None) -> tuple[Array, Array]:
    """Return points (..., J, 2) and weights (..., J) of a body; extremities that are None are not seen."""
    if extremities is None:
        unseen = np.zeros((*weight.shape[:-1], EXTREMITY_COUNT))
        extremities = Extremities(np.zeros((*unseen.shape, 2)), unseen)
    return (
        np.concatenate([rays, extremities.rays], axis=-2),
        np.concatenate([weight, extremities.weight], axis=-1),
    )
