# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Initial values from lifted poses: the base-pose weights and the camera that fit each lifted pose best.

    min over theta, s, R of  sum_j |R P_j - y_j / s|^2 / v + sum_l (theta_l / sigma_l)^2,
    P = Q_0 + sum_l theta_l Q_l,    theta_l = <Q_l, R^T y / s - Q_0> / (1 + v / sigma_l^2)

with y the lifted pose of a frame and v the mean variance of the coordinates of y / s. Camera (Procrustes) and
weights are found in turn, `ALTERNATIONS` times.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import lifted_start as engine
from mocap_ros.geometry.interpolation import find_nearest
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import MAX_MODELS, PoseModel, arrange_model
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.window import InitialValues

ALTERNATIONS = 4  # rounds of cameras and weights; two give the same results, six no better ones (training persons)


def fit_lifted_poses(lifted: LiftedPoses, times: Array, model: PoseModel) -> InitialValues | None:
    """Return initial values that fit lifted poses (F, J, 3) px at times (F,) s; None where no frame was lifted.

    A frame that was not lifted takes the values of the nearest one that was.
    """
    known = np.flatnonzero(np.isfinite(lifted.joints).all(axis=(1, 2)))
    if not len(known):
        return None
    joints, variances = np.ascontiguousarray(lifted.joints[known]), (lifted.std[known] ** 2).mean(axis=(1, 2))
    theta, *cameras = prepare_fit(model).fit_all(joints, variances)
    nearest = find_nearest(times, times[known])
    return InitialValues(theta[nearest], WeakPerspectiveCameras(*(values[nearest] for values in cameras)))


@lru_cache(maxsize=MAX_MODELS)
def prepare_fit(model: PoseModel) -> engine.PoseFit:
    """Return what fits lifted poses by base poses."""
    return engine.PoseFit(model, arrange_model(model), ALTERNATIONS)
