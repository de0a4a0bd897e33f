# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The arrays of a base-pose model in the forms that the solvers' kernels take."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.base_poses import BasePoses

Array = NDArray[np.float64]

MAX_MODELS = 16  # models whose arrays are kept: the shipped ones, some of them truncated


class ModelArrays(NamedTuple):
    """Arrays of a model with J joints, B bones and K base poses.

    Attributes:
        components: (3 J, K) base poses, a coordinate of a joint in each row.
        bones: (3 B, K) change of the vectors along the bones with the weights, a coordinate of a bone in each row.
        parents: (B,) index of each bone's inner joint.
        children: (B,) index of each bone's outer joint.
        mean_bone_lengths: (B,) m, bone lengths of the mean pose.
    """

    components: Array
    bones: Array
    parents: NDArray[np.int64]
    children: NDArray[np.int64]
    mean_bone_lengths: Array


@lru_cache(maxsize=MAX_MODELS)
def arrange_model(model: BasePoses) -> ModelArrays:
    """Return the arrays of a model; those of the same object are made once."""
    parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
    bones = model.components[:, children] - model.components[:, parents]
    return ModelArrays(
        np.ascontiguousarray(model.components.reshape(len(model.components), -1).T),
        np.ascontiguousarray(bones.reshape(len(bones), -1).T),
        parents,
        children,
        model.skeleton.bone_lengths(model.mean),
    )
