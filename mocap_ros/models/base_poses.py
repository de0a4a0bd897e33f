# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Base poses: P = Q_0 + sum_l theta_l Q_l, the mean pose and the directions of variation (TPAMI 2016, eq. 1).

The body frame is in metres, x forward, y left, z up, with the mean of the joints as origin. Training poses are
centred and aligned, because the camera already accounts for translation and rotation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.skeleton import Skeleton

ALL_MOTIONS = 'all'  # name of the model that is trained on all motion categories together
MAX_MODELS = 16  # models whose arrays are kept: the shipped ones, some of them truncated


@dataclass(frozen=True, eq=False)
class PoseModel:
    """A trained linear pose model with J joints and K base poses."""

    name: str  # motion category that the model was trained for (`walk`, `run`, `jump`, ... or `all`)
    skeleton: Skeleton  # names and bones of the joints, in the order of the arrays
    mean: Array  # (J, 3) m, mean pose Q_0
    # (K, J, 3) base poses Q_l, orthonormal, in order of decreasing variance; the entry of largest magnitude of
    # each is positive
    components: Array
    std: Array  # (K,) m, standard deviation of each weight theta_l over the training poses
    explained: Array  # (K,) cumulative share of the variance
    stature: float  # m, mean stature of the people in the training data
    provenance: Mapping[str, object]  # origin of the training data and settings of the training

    def __post_init__(self) -> None:
        for name in ('mean', 'components', 'std', 'explained'):  # as the engine takes them
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), float))

    @property
    def aligned_by_heading(self) -> bool:
        """Whether training poses were turned about z only, so that z is vertical in every pose."""
        return self.provenance.get('alignment') == 'heading'

    def poses(self, theta: Array) -> Array:
        """Return the poses (..., J, 3) m, body frame, of weights theta (..., k) m of the first base poses."""
        k = theta.shape[-1]
        flat = theta @ self.components[:k].reshape(k, -1)
        return flat.reshape(*theta.shape[:-1], *self.mean.shape) + self.mean

    def weights(self, poses: Array) -> Array:
        """Return the least-squares weights theta (..., K) in m of centred, aligned poses (..., J, 3) in m."""
        flat = (poses - self.mean).reshape(*poses.shape[:-2], -1)
        return flat @ self.components.reshape(len(self.components), -1).T

    def truncate(self, k: int) -> PoseModel:
        """Return the model with its first `k` base poses, or itself if it has no more."""
        if k >= len(self.components):
            return self
        return replace(self, components=self.components[:k], std=self.std[:k], explained=self.explained[:k])

    def rescale(self, factor: float) -> PoseModel:
        """Return the model of a body that is `factor` times as large."""
        return replace(self, mean=self.mean * factor, std=self.std * factor, stature=self.stature * factor)


def mirror_poses(poses: Array, skeleton: Skeleton) -> Array:
    """Mirror poses (..., J, 3) of the body frame: negate y and exchange left and right joints."""
    return np.asarray(poses[..., list(skeleton.mirror), :] * [1.0, -1.0, 1.0])


class ModelArrays(NamedTuple):
    """Arrays of a model with J joints, B bones and K base poses, as the engine takes them."""

    components: Array  # (3 J, K) base poses, a coordinate of a joint in each row
    # (3 B, K) change of the vectors along the bones with the weights, a coordinate of a bone in each row
    bones: Array
    parents: NDArray[np.int64]  # (B,) index of each bone's inner joint
    children: NDArray[np.int64]  # (B,) index of each bone's outer joint


@lru_cache(maxsize=MAX_MODELS)
def arrange_model(model: PoseModel) -> ModelArrays:
    """Return the arrays of a model; those of the same object are made once."""
    parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
    bones = model.components[:, children] - model.components[:, parents]
    return ModelArrays(
        np.ascontiguousarray(model.components.reshape(len(model.components), -1).T),
        np.ascontiguousarray(bones.reshape(len(bones), -1).T),
        parents,
        children,
    )
