# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The correction of a part by what one frame tells of it.

It is the rotation d and the displacement t (m) of the whole part that minimise, in two steps of Gauss and Newton,

    d^T P_k^-1 d + |t|^2 / s^2 + g_l sum_i |C_i^(-1/2) (p_i - c_k - o_i)|^2 / N
                               + g_r sum_i rho(|z (pi(p_i + t) - r_i)| / n_i)

with p_i (`parts.py`) at the turned R_k = exp(d) R_k. o_i is the offset of point i from c_k in the lifted pose, C_i
its covariance, and N the number of points of the part, whose errors in the lifted pose are one and the same. r_i
is the ray of a point that was seen, that of c_k included, pi the projection, z the depth, n_i the image noise (m
at the body) by its score, and rho Cauchy's loss. The errors of the lifter and of the detector last for some time
T, so a frame counts g = min(1, h / T). The displacement is forgotten, so that bones keep their lengths: it is the
error of c_k and of the detector's idea of the joints.

The information i and the gradient j of b_k, d and t eliminated, are added to sums, from which `following.py`
learns the sizes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, INPUT_1D, INPUT_2D, INT, kernel
from mocap_ros.geometry.rotations import write_rotation_from_vector
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.body_segments import PART_SEGMENTS, write_product
from mocap_ros.solvers.extremities.parts import PART_OF, POINT_COUNTS, TEMPLATE
from mocap_ros.solvers.extremities.small_matrices import MIN_ANGLE, write_inverse

Array = NDArray[np.float64]

LIFTED_MEMORY_S = 0.1  # s; T of the lifter's errors; more would leave turning heads and stepping feet behind
IMAGE_MEMORY_S = 1.0  # s; T of the detector's errors, most of which last for a whole sequence
SHIFT_STD_M = 0.05  # m; s: standard deviation of a core joint's error and of a detector's idea of it
RAY_STD_M = 0.03  # m at the body; error of a seen point besides the image noise: detectors' offsets
ROBUST_STDS = 2.5  # standard deviations from which an image point counts less
STEPS = 2  # of Gauss and Newton; a third changes directions by less than 0.1 degrees
MAX_STEP_RAD = 0.5  # rad; a longer step would leave the range in which the linearisation holds
MIN_DEPTH_M = 0.1  # m; a nearer point has no image


@kernel(void(FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_1D, INPUT_1D, FLOAT, FLOAT))
def _add_lifted(
    hessian: Array, gradient: Array, slopes: Array, error: Array, sight: Array, across: float, along: float
) -> None:
    """Add the squared distance of a point from the lifted one.

    Args:
        hessian: (7, 7) second derivatives by d, t and b.
        gradient: (7,) first derivatives.
        slopes: (3, 7) derivatives of the point, whose columns of t are 0.
        error: (3,) m, the point less the lifted one.
        sight: (3,) direction of the line of sight.
        across: 1/m^2, information across it.
        along: 1/m^2, information along it.
    """
    depth_error = sight[0] * error[0] + sight[1] * error[1] + sight[2] * error[2]
    depth_slopes = np.empty(7)
    for a in range(7):
        depth_slopes[a] = sight[0] * slopes[0, a] + sight[1] * slopes[1, a] + sight[2] * slopes[2, a]
    for a in (0, 1, 2, 6):
        dot = slopes[0, a] * error[0] + slopes[1, a] * error[1] + slopes[2, a] * error[2]
        gradient[a] += across * dot + (along - across) * depth_slopes[a] * depth_error
        for b in (0, 1, 2, 6):
            dot = slopes[0, a] * slopes[0, b] + slopes[1, a] * slopes[1, b] + slopes[2, a] * slopes[2, b]
            hessian[a, b] += across * dot + (along - across) * depth_slopes[a] * depth_slopes[b]


@kernel(void(FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_1D, INPUT_1D, FLOAT, FLOAT))
def _add_ray(
    hessian: Array, gradient: Array, slopes: Array, point: Array, ray: Array, variance: float, share: float
) -> None:
    """Add the robust distance of a point's image from a ray.

    Args:
        hessian: (7, 7) second derivatives by d, t and b.
        gradient: (7,) first derivatives.
        slopes: (3, 7) derivatives of the point.
        point: (3,) m, the displaced point.
        ray: (2,) where it was seen.
        variance: m^2 at the body.
        share: g.
    """
    u, v = point[0] / point[2], point[1] / point[2]
    error_x, error_y = (u - ray[0]) * point[2], (v - ray[1]) * point[2]
    squared = (error_x**2 + error_y**2) / variance
    information = share / (variance * (1 + squared / ROBUST_STDS**2))
    x, y = np.empty(7), np.empty(7)
    for a in range(7):
        x[a], y[a] = slopes[0, a] - u * slopes[2, a], slopes[1, a] - v * slopes[2, a]
    for a in range(7):
        gradient[a] += information * (x[a] * error_x + y[a] * error_y)
        for b in range(7):
            hessian[a, b] += information * (x[a] * x[b] + y[a] * y[b])


@kernel(void(FLOATS_1D, FLOATS_2D, INPUT_1D, INPUT_2D, FLOAT))
def _write_arm(arm: Array, slopes: Array, template: Array, turn: Array, size: float) -> None:
    """Write the offset (3,) m of a point from its anchor, and its derivatives (3, 7) by d, t and b.

    The derivatives by t are 0: the offset itself is not displaced.
    """
    for i in range(3):
        arm[i] = size * (turn[i, 0] * template[0] + turn[i, 1] * template[1] + turn[i, 2] * template[2])
    slopes[:] = 0.0
    slopes[0, 1], slopes[0, 2] = arm[2], -arm[1]
    slopes[1, 0], slopes[1, 2] = -arm[2], arm[0]
    slopes[2, 0], slopes[2, 1] = arm[1], -arm[0]
    slopes[:, 6] = arm


@kernel(void(FLOATS_2D, FLOATS_1D, FLOATS_2D, FLOATS_1D, INPUT_1D, INPUT_1D, INPUT_1D, FLOAT, FLOAT, FLOAT))
def _add_image_point(
    hessian: Array,
    gradient: Array,
    slopes: Array,
    point: Array,
    origin: Array,
    shift: Array,
    ray: Array,
    weight: float,
    noise: float,
    share: float,
) -> None:
    """Add what the image tells of a displaced point, if it was seen and is in front of the camera.

    Args:
        hessian: (7, 7) second derivatives by d, t and b.
        gradient: (7,) first derivatives.
        slopes: (3, 7) derivatives of the point, to which those by t are added.
        point: (3,) m, offset of the point from its anchor, overwritten.
        origin: (3,) m, the anchor.
        shift: (3,) m, t.
        ray: (2,) where the point was seen.
        weight: confidence score; 0 where it was not seen.
        noise: m, image noise.
        share: g.
    """
    for i in range(3):
        point[i] += origin[i] + shift[i]
        slopes[i, 3 + i] = 1.0
    if weight > 0 and point[2] > MIN_DEPTH_M:
        _add_ray(hessian, gradient, slopes, point, ray, (noise**2 + RAY_STD_M**2) / weight, share)


@kernel(void(FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_1D, INPUT_1D))
def _write_prior(hessian: Array, gradient: Array, information: Array, turned: Array, shift: Array) -> None:
    """Write the derivatives of d^T P^-1 d + |t|^2 / s^2.

    Args:
        hessian: (7, 7) second derivatives by d, t and b, overwritten.
        gradient: (7,) first derivatives, overwritten.
        information: (3, 3) P^-1.
        turned: (3,) rad, d.
        shift: (3,) m, t.
    """
    hessian[:] = 0.0
    gradient[:] = 0.0
    for i in range(3):
        for j in range(3):
            hessian[i, j] = information[i, j]
            gradient[i] += information[i, j] * turned[j]
        hessian[3 + i, 3 + i] = 1 / SHIFT_STD_M**2
        gradient[3 + i] = shift[i] / SHIFT_STD_M**2


@kernel(void(FLOATS_2D, FLOATS_1D, FLOATS_1D, FLOATS_2D, INPUT_2D, INPUT_1D))
def _take_step(turn: Array, turned: Array, shift: Array, inverse: Array, hessian: Array, gradient: Array) -> None:
    """Take a step of Gauss and Newton.

    Args:
        turn: (3, 3) R, overwritten.
        turned: (3,) rad, d, overwritten.
        shift: (3,) m, t, overwritten.
        inverse: (6, 6) covariance of d and t, overwritten.
        hessian: (7, 7) second derivatives by d, t and b.
        gradient: (7,) first derivatives.
    """
    factor, step, vector = np.empty((6, 6)), np.zeros(6), np.empty(3)
    rotation, new = np.empty((3, 3)), np.empty((3, 3))
    for i in range(6):
        for j in range(6):
            factor[i, j] = hessian[i, j]
    write_inverse(inverse, factor)
    for i in range(6):
        for j in range(6):
            step[i] -= inverse[i, j] * gradient[j]
    length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    for i in range(3):
        vector[i] = step[i] * min(1.0, MAX_STEP_RAD / max(length, MIN_ANGLE))
        turned[i] += vector[i]
        shift[i] += step[3 + i]
    write_rotation_from_vector(vector, rotation)
    write_product(new, rotation, turn)
    turn[:] = new


@kernel(void(FLOATS_1D, FLOATS_2D, INPUT_2D, INPUT_2D, INPUT_1D))
def _write_estimate(size_sums: Array, covariance: Array, inverse: Array, hessian: Array, gradient: Array) -> None:
    """Write the covariance (3, 3) of d, and add the information and minus the gradient of b to the sums (2,).

    Args:
        size_sums: sums of i and of -j.
        covariance: P, overwritten.
        inverse: (6, 6) covariance of d and t.
        hessian: (7, 7) second derivatives by d, t and b.
        gradient: (7,) first derivatives.
    """
    information, slope = hessian[6, 6], gradient[6]
    for i in range(6):
        for j in range(6):
            information -= hessian[6, i] * inverse[i, j] * hessian[j, 6]
            slope -= hessian[6, i] * inverse[i, j] * gradient[j]
    for i in range(3):
        for j in range(3):
            covariance[i, j] = inverse[i, j]
    size_sums[0] += information
    size_sums[1] -= slope


@kernel(
    void(
        INT, FLOATS_2D, FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_1D, FLOAT, FLOAT, FLOAT
    )
)
def correct_part(
    part: int,
    turn: Array,
    covariance: Array,
    size_sums: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    size: float,
    noise: float,
    step_s: float,
) -> None:
    """Correct the rotation of a part by what a frame tells.

    Args:
        part: index of the part, k.
        turn: (3, 3) R, overwritten.
        covariance: (3, 3) P, overwritten.
        size_sums: (2,) sums of i and of -j, to which those of this part are added.
        core: with the following, those of `ExtremityEvidence`.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        size: m, e^b H.
        noise: m, image noise.
        step_s: s, time since the frame before.
    """
    anchor = PART_SEGMENTS[part]
    origin, sight, error = core[anchor], np.empty(3), np.empty(3)
    has_lifted = math.isfinite(lifted[anchor, 0])
    distance = math.sqrt(origin[0] ** 2 + origin[1] ** 2 + origin[2] ** 2)
    sight[:] = origin / max(distance, MIN_DEPTH_M)
    information, work = np.empty((3, 3)), covariance.copy()
    write_inverse(information, work)
    hessian, gradient, slopes, inverse = np.empty((7, 7)), np.empty(7), np.empty((3, 7)), np.empty((6, 6))
    turned, shift, arm = np.zeros(3), np.zeros(3), np.empty(3)
    lifted_share = min(1.0, step_s / LIFTED_MEMORY_S) / POINT_COUNTS[part]
    image_share = min(1.0, step_s / IMAGE_MEMORY_S)
    for _ in range(STEPS):
        _write_prior(hessian, gradient, information, turned, shift)
        for p in range(len(PART_OF)):
            joint = CORE_COUNT + p
            if PART_OF[p] != part:
                continue
            _write_arm(arm, slopes, TEMPLATE[p], turn, size)
            if has_lifted:
                error[:] = arm - lifted[joint] + lifted[anchor]
                across, along = lifted_share / lifted_std[joint, 0] ** 2, lifted_share / lifted_std[joint, 2] ** 2
                _add_lifted(hessian, gradient, slopes, error, sight, across, along)
            _add_image_point(
                hessian, gradient, slopes, arm, origin, shift, rays[joint], weight[joint], noise, image_share
            )
        slopes[:] = 0.0
        arm[:] = 0.0  # the anchor itself was seen, too
        _add_image_point(
            hessian, gradient, slopes, arm, origin, shift, rays[anchor], weight[anchor], noise, image_share
        )
        _take_step(turn, turned, shift, inverse, hessian, gradient)
    _write_estimate(size_sums, covariance, inverse, hessian, gradient)
