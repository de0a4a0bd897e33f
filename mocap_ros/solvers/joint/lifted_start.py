# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Initial values from lifted poses: the base-pose weights and the camera that fit each lifted pose best.

    min over theta, s, R of  sum_j |R P_j - y_j / s|^2 / v + sum_l (theta_l / sigma_l)^2,
    P = Q_0 + sum_l theta_l Q_l

with y the lifted pose of a frame, v the mean variance of the coordinates of y / s, and sigma_l the standard
deviation of weight l over the training poses. Camera and weights are found in turn, `ALTERNATIONS` times: rotation
R and scale s by Procrustes' analysis, and the weights, since the base poses Q_l are orthonormal, one by one:

    theta_l = <Q_l, R^T y / s - Q_0> / (1 + v / sigma_l^2)

Variances of each coordinate give the same results after the solver's steps, but need equations to be solved here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.blas import add_product, add_transposed_product
from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.geometry.interpolation import find_nearest
from mocap_ros.geometry.rotations import write_best_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses, arrange_model
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.window import InitialValues

Array = NDArray[np.float64]

ALTERNATIONS = 4  # rounds of cameras and weights; two give the same results, six no better ones (training persons)
MIN_SCALE = 1e-9  # px/m; guards against a scale of zero where a pose is degenerate


class FittedPoses(NamedTuple):
    """Weights and cameras that fit lifted poses.

    Attributes:
        theta: (F, K) m, weights of the base poses.
        scale: (F,) px/m, or the unit of the lifted poses per m.
        rotation: (F, 3, 3) from the body to the camera.
    """

    theta: Array
    scale: Array
    rotation: Array


def fit_lifted_poses(lifted: LiftedPoses, model: BasePoses) -> FittedPoses:
    """Fit base-pose weights and cameras to lifted poses, all of them known, frame by frame.

    Args:
        lifted: (F, J, 3) poses in any unit.
        model: base poses, metric.
    """
    return FittedPoses(*_fit(lifted.joints, lifted.std, arrange_model(model).components, model.mean, model.std))


def fit_initial_values(lifted: LiftedPoses, times: Array, model: BasePoses) -> InitialValues | None:
    """Return initial values that fit lifted poses.

    A frame that was not lifted takes the values of the nearest one that was.

    Args:
        lifted: (F, J, 3) poses in px.
        times: (F,) s.
        model: base poses, metric.

    Returns:
        None where no frame was lifted.
    """
    known = np.flatnonzero(np.isfinite(lifted.joints).all(axis=(1, 2)))
    if not len(known):
        return None
    fitted = fit_lifted_poses(lifted.select_frames(known), model)
    nearest = find_nearest(times, times[known])
    cameras = WeakPerspectiveCameras(fitted.scale[nearest], fitted.rotation[nearest])
    return InitialValues(fitted.theta[nearest], cameras)


@kernel(types.Tuple((FLOATS_2D, FLOATS_1D, FLOATS_3D))(INPUT_3D, INPUT_3D, INPUT_2D, INPUT_2D, INPUT_1D))
def _fit(joints: Array, std: Array, basis: Array, mean: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Return the weights (F, K), scales (F,) and rotations (F, 3, 3) of lifted poses.

    Args:
        joints: (F, J, 3) lifted poses, all known.
        std: (F, J, 3) their standard deviations.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        mean: (J, 3) m, mean pose.
        sigma: (K,) m, standard deviations of the weights.
    """
    frames, count, _ = joints.shape
    k = basis.shape[1]
    theta, scale, rotation = np.zeros((frames, k)), np.empty(frames), np.empty((frames, 3, 3))
    pose, misfit = np.empty((3 * count, 1)), np.empty((3 * count, 1))  # body frame
    for t in range(frames):
        variance = (std[t] * std[t]).mean()
        for _ in range(ALTERNATIONS):
            pose[:] = mean.copy().reshape((3 * count, 1))
            add_product(1.0, basis, theta[t].reshape((k, 1)), pose)
            products = np.zeros((3, 3))
            for j in range(count):
                for a in range(3):
                    for b in range(3):
                        products[a, b] += joints[t, j, a] * pose[3 * j + b, 0]
            write_best_rotation(products, rotation[t])
            scale[t] = max((rotation[t] * products).sum() / (pose * pose).sum(), MIN_SCALE)
            turned = np.zeros((count, 3))
            add_product(1 / scale[t], joints[t].copy(), rotation[t], turned)
            misfit[:] = (turned - mean).reshape((3 * count, 1))
            weights = np.zeros((k, 1))
            add_transposed_product(1.0, basis, misfit, weights)
            for i in range(k):
                theta[t, i] = weights[i, 0] / (1 + variance / (scale[t] * sigma[i]) ** 2)
    return theta, scale, rotation
