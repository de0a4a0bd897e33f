"""Initial values from lifted poses: the base-pose weights and the camera that fit each lifted pose best.

    min over theta, s, R of  sum_j |R P_j - y_j / s|^2 / v_j + sum_l (theta_l / sigma_l)^2,
    P = Q_0 + sum_l theta_l Q_l

with y the lifted pose of a frame, v_j the mean variance of the joint's coordinates y / s and sigma_l the standard
deviation of weight l over the training poses. Camera and weights are found in turn, `ALTERNATIONS` times: rotation
R and scale s by Procrustes' analysis of the unweighted joints, weights by least squares in the body frame.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.blas import (
    add_product,
    add_transposed_product,
    factorise_cholesky,
    solve_lower,
    solve_lower_transposed,
)
from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.geometry.rotations import write_best_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.joint.lifted_pose import MIN_STD_M
from mocap_ros.solvers.window import InitialValues

Array = NDArray[np.float64]

ALTERNATIONS = 6  # rounds of cameras and weights; later ones move the initial values by under a millimetre
MIN_SCALE = 1e-9  # px/m; guards against a scale of zero where a pose is degenerate


def fit_initial_values(lifted: LiftedPoses, times: Array, model: BasePoses) -> InitialValues | None:
    """Fit base-pose weights and cameras to lifted poses, frame by frame.

    A frame that was not lifted takes the values of the nearest one that was.

    Args:
        lifted: (F, J, 3) poses in px.
        times: (F,) s.
        model: base poses, metric.

    Returns:
        None where no frame was lifted.
    """
    good = np.flatnonzero(np.isfinite(lifted.joints).all(axis=(1, 2)))
    if not len(good):
        return None
    fitted = _fit(lifted.joints[good], lifted.std[good], model.flat_components, model.mean, model.std)
    nearest = np.abs(times[:, None] - times[good]).argmin(axis=1)
    theta, scale, rotation = (values[nearest] for values in fitted)
    return InitialValues(theta, WeakPerspectiveCameras(scale, rotation))


@kernel(FLOATS_1D(INPUT_2D, INPUT_2D, FLOAT, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_1D))
def _fit_weights(
    joints: Array, std: Array, scale: float, rotation: Array, basis: Array, mean: Array, sigma: Array
) -> Array:
    """Return the weights (K,) of one lifted pose under a camera; 0 where they cannot be computed."""
    rows, k = basis.shape
    misfit, weighted = np.empty((rows, 1)), np.empty((rows, k))  # misfit of the mean pose, body frame
    for j in range(len(joints)):
        variance = 0.0
        for a in range(3):
            variance += max((std[j, a] / scale) ** 2, MIN_STD_M**2) / 3
        for b in range(3):
            row = 3 * j + b
            misfit[row, 0] = -mean[j, b]
            for a in range(3):
                misfit[row, 0] += joints[j, a] / scale * rotation[a, b]
            for i in range(k):
                weighted[row, i] = basis[row, i] / variance
    matrix, right = np.zeros((k, k)), np.zeros((k, 1))
    add_transposed_product(1.0, weighted, basis, matrix)
    add_transposed_product(1.0, weighted, misfit, right)
    for i in range(k):
        matrix[i, i] += 1 / (sigma[i] * sigma[i])
    if not factorise_cholesky(matrix):
        return np.zeros(k)
    solve_lower(matrix, right)
    solve_lower_transposed(matrix, right)
    return right[:, 0].copy()


@kernel(types.Tuple((FLOATS_2D, FLOATS_1D, FLOATS_3D))(INPUT_3D, INPUT_3D, INPUT_2D, INPUT_2D, INPUT_1D))
def _fit(joints: Array, std: Array, basis: Array, mean: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Return the weights (F, K), scales (F,) and rotations (F, 3, 3) of lifted poses.

    Args:
        joints: (F, J, 3) px, lifted poses, all known.
        std: (F, J, 3) px, their standard deviations.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        mean: (J, 3) m, mean pose.
        sigma: (K,) m, standard deviations of the weights.
    """
    frames, count, _ = joints.shape
    k = basis.shape[1]
    theta, scale, rotation = np.zeros((frames, k)), np.empty(frames), np.empty((frames, 3, 3))
    pose, products = np.empty((3 * count, 1)), np.empty((3, 3))
    for t in range(frames):
        for _ in range(ALTERNATIONS):
            pose[:] = mean.copy().reshape((3 * count, 1))
            add_product(1.0, basis, theta[t].reshape((k, 1)), pose)
            products[:] = 0.0
            for j in range(count):
                for a in range(3):
                    for b in range(3):
                        products[a, b] += joints[t, j, a] * pose[3 * j + b, 0]
            write_best_rotation(products, rotation[t])
            scale[t] = max((rotation[t] * products).sum() / (pose * pose).sum(), MIN_SCALE)
            theta[t] = _fit_weights(joints[t], std[t], scale[t], rotation[t], basis, mean, sigma)
    return theta, scale, rotation
