"""Base poses: the mean human pose and the directions in which poses vary (TPAMI 2016, section 3.1).

A pose is `P = Q0 + sum_l theta_l Q_l` (eq. 1). Body frame: metres, x forward, y left, z up, origin at the
mean of the joints. Poses are centred and aligned before the principal component analysis, since the camera
absorbs translation and rotation and a basis that had to explain them as well would waste its components.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]


ALL_MOTIONS = 'all'


@dataclass(frozen=True, eq=False)
class BasePoses:
    """A trained linear pose model.

    Attributes:
        name: motion category it was trained for (`walk`, ..., or `all`).
        skeleton: joints, in the order of the arrays.
        mean: (J, 3) m, mean pose Q0.
        components: (K, J, 3) base poses Q_l, orthonormal, by falling variance, largest entry positive.
        std: (K,) m, standard deviation of each weight theta_l over the training poses.
        explained: (K,) share of the variance, cumulative.
        stature: m, mean stature of the people in the training data.
        provenance: where the training data came from and how it was used.
    """

    name: str
    skeleton: Skeleton
    mean: Array
    components: Array
    std: Array
    explained: Array
    stature: float
    provenance: Mapping[str, object]

    @property
    def upright(self) -> bool:
        """True where poses were turned about the vertical only, so that the body frame's z is up in every pose."""
        return self.provenance.get('alignment') == 'heading'

    def poses(self, theta: Array) -> Array:
        """(..., K) weights in m -> (..., J, 3) poses in m, body frame (eq. 1)."""
        k = theta.shape[-1]
        flat = theta @ self.components[:k].reshape(k, -1)
        return flat.reshape(*theta.shape[:-1], *self.mean.shape) + self.mean

    def weights(self, poses: Array) -> Array:
        """(..., J, 3) centred, aligned poses in m -> (..., K) weights in m, the least-squares ones."""
        flat = (poses - self.mean).reshape(*poses.shape[:-2], -1)
        return flat @ self.components.reshape(len(self.components), -1).T

    def truncated(self, k: int) -> BasePoses:
        """The model with its first `k` base poses, or all if it has fewer."""
        return replace(self, components=self.components[:k], std=self.std[:k], explained=self.explained[:k])

    def rescaled(self, factor: float) -> BasePoses:
        """The model of a body `factor` times as large."""
        return replace(self, mean=self.mean * factor, std=self.std * factor, stature=self.stature * factor)


def mirrored(poses: Array, skeleton: Skeleton) -> Array:
    """Poses (..., J, 3) seen in a mirror: y negated, left and right joints exchanged."""
    return np.asarray(poses[..., list(skeleton.mirror), :] * [1.0, -1.0, 1.0])
