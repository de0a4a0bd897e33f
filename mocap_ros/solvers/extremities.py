"""Face, feet and hands of a person: rigid parts that hang on the core joints, followed over time.

The head, the feet and the hands are rigid parts k. Each hangs on a core joint c_k (`head`, ankles, wrists) and
turns by R_k, from its own axes (x forward, y left, z up; `body_segments.py`) to the camera's optical frame. Its
points are

    p_i = c_k + e^(b_k) H R_k T_i

with the template T_i of an average person (1 of the stature), the stature H (m) and the person's logarithmic size
b_k of face, feet or hands. Without evidence a part is as the core has it, A_k (the segments of
`body_segments.py`). From frame to frame, h seconds apart, it returns there with the time constant tau and the
spread S_k of training data:

    R_k <- A_k exp(a log(A_k'^T R_k')),    P_k <- a^2 P_k + (1 - a^2) S_k,    a = e^(-h / tau)

where the prime marks the frame before and P_k (rad^2) is the covariance of the rotation. The frame then corrects
it by the rotation d and the displacement t (m) of the whole part that minimise, in two steps of Gauss and Newton,

    d^T P_k^-1 d + |t|^2 / s^2 + g_l sum_i |C_i^(-1/2) (p_i - c_k - o_i)|^2 / N
                               + g_r sum_i rho(|z (pi(p_i + t) - r_i)| / n_i)

with p_i at the turned R_k = exp(d) R_k. o_i is the offset of point i from c_k in the lifted pose, C_i its
covariance, and N the number of points of the part, whose errors in the lifted pose are one and the same. r_i is
the ray of a point that was seen, that of c_k included, pi the projection, z the depth, n_i the image noise (m at
the body) by its score, and rho Cauchy's loss. The errors of the lifter and of the detector last for some time T,
so a frame counts g = min(1, h / T). The displacement is forgotten, so that bones keep their lengths: it is the
error of c_k and of the detector's idea of the joints.

The sizes follow from the same sums: with the information i and the gradient j of b_k, d and t eliminated,
b_k <- b_k - j / (I + i + 1 / s_b^2), where I is the sum of earlier i and s_b the spread of people.

A whole sequence is followed forwards (f) and backwards (b, before its correction), with the sizes that were learnt
from all frames, and smoothed: with the rotation vectors d_b = log(R_b R_f^T) and d_A = log(A R_f^T),

    P^-1 = P_f^-1 + P_b^-1 - S^-1,    R = exp(P (P_b^-1 d_b - S^-1 d_A)) R_f
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOL,
    BOOLS_1D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    FLOATS_4D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_4D,
    INT,
    kernel,
)
from mocap_ros.geometry.rotations import write_rotation_from_vector
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers.body_segments import (
    PART_SEGMENTS,
    SEGMENT_COUNT,
    rotation_about,
    write_core_segments,
    write_orientations,
    write_product,
    write_quaternions,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

EXTREMITIES = BODY26.joints[CORE_COUNT:]
PARTS = ('head', 'lfoot', 'rfoot', 'lhand', 'rhand')
PART_COUNT = len(PARTS)
HEAD = 0  # index of the part

# Points (m per m of stature) in the axes of their part: the mean of the people of the training data. The line from
# the ears to the nose is 19.6 degrees below the horizontal in people who walk.
_FACE_PITCH = rotation_about(1, 19.6)
_TEMPLATES = {
    'toe': (0.115, 0.0, -0.0314),
    'heel': (-0.0307, 0.0, -0.0314),
    'hand': (0.0, 0.0, -0.0433),
    'nose': tuple(_FACE_PITCH @ (0.0710, 0.0, -0.0283)),
    'leye': tuple(_FACE_PITCH @ (0.0583, 0.0188, -0.0098)),
    'reye': tuple(_FACE_PITCH @ (0.0583, -0.0188, -0.0098)),
    'lear': tuple(_FACE_PITCH @ (0.0110, 0.0441, -0.0283)),
    'rear': tuple(_FACE_PITCH @ (0.0110, -0.0441, -0.0283)),
}
TEMPLATE = np.array([_TEMPLATES.get(name, _TEMPLATES.get(name[1:])) for name in EXTREMITIES])
# index of the part of each point
PART_OF = np.array(
    [
        HEAD
        if n == 'nose' or n[1:] in ('eye', 'ear')
        else PARTS.index(n[0] + ('hand' if n[1:] == 'hand' else 'foot'))
        for n in EXTREMITIES
    ]
)
POINT_COUNTS = np.bincount(PART_OF)  # N
ANCHORS = PART_SEGMENTS[PART_OF]  # (11,) index of the core joint on which each point hangs
SEGMENT_OF = np.concatenate(
    [np.arange(CORE_COUNT), ANCHORS]
)  # (26,) segment that turns about each joint or holds it
SIZE_OF = np.array([0, 1, 1, 2, 2])  # parts of one size: face, feet, hands
SIZE_COUNT = 3
# rad; S, standard deviations of head, feet and hands about x, y, z from where the core has them, in the training
# data; those of feet are a quarter wider, as solved shanks are worse than true ones. The turn of a hand about its
# own axis, which nothing measures, is chosen by judgement.
REST_STD = np.radians(
    [[8.0, 14.0, 22.0], [10.0, 18.0, 26.0], [10.0, 18.0, 26.0], [20.0, 20.0, 30.0], [20.0, 20.0, 30.0]]
)
REST_MEMORY_S = np.array([0.7, 0.4, 0.4, 0.4, 0.4])  # s; tau: half a step for feet, a look for heads
# s_b; of face, feet and hands of people in the training data, with what detectors take for toe and hand
SIZE_STD = np.array([0.06, 0.12, 0.15])
SIZE_MEMORY_S = 60.0  # s; a person's size does not change, but the detector may
LIFTED_MEMORY_S = 0.1  # s; T of the lifter's errors; more would leave turning heads and stepping feet behind
IMAGE_MEMORY_S = 1.0  # s; T of the detector's errors, most of which last for a whole sequence
SHIFT_STD_M = 0.05  # m; s, error of a core joint and of a detector's idea of it
RAY_STD_M = 0.03  # m at the body; error of a seen point besides the image noise: detectors' offsets
ROBUST_STDS = 2.5  # standard deviations from which an image point counts less
STEPS = 2  # of Gauss and Newton; a third changes directions by less than 0.1 degrees
MAX_STEP_RAD = 0.5  # rad; a longer step would leave the range in which the linearisation holds
MIN_DEPTH_M = 0.1  # m; a nearer point has no image
MIN_ANGLE = 1e-9  # rad; below it a rotation vector is its sine
MIN_PIVOT = 1e-12  # guards the square roots of a Cholesky factorisation against rounding
TURN_TOLD_RAD = math.radians(25)  # rad; a part whose turn about its axis is known no better is flagged
ANGULAR_SPEED_STD = 1.5  # rad/s; of heads, feet and hands about their anchors, for the deviation of velocities
VELOCITY_MEMORY_S = 0.1  # s; over which the velocity of a point about its anchor is averaged


@kernel(void(FLOATS_1D, INPUT_2D))
def _write_vector(out: Array, rotation: Array) -> None:
    """Write the rotation vector (3,) rad of a rotation (3, 3) by less than pi."""
    out[0] = (rotation[2, 1] - rotation[1, 2]) / 2
    out[1] = (rotation[0, 2] - rotation[2, 0]) / 2
    out[2] = (rotation[1, 0] - rotation[0, 1]) / 2
    sine = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if sine > MIN_ANGLE:
        out *= math.atan2(sine, (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1) / 2) / sine


@kernel(void(FLOATS_2D, FLOATS_2D))
def _write_inverse(out: Array, matrix: Array) -> None:
    """Write the inverse of a positive definite matrix (n, n), which is overwritten, by Cholesky's method."""
    n = len(matrix)
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(rest, MIN_PIVOT)) if i == j else rest / matrix[j, j]
    for c in range(n):
        for i in range(n):
            rest = 1.0 if i == c else 0.0
            for k in range(i):
                rest -= matrix[i, k] * out[k, c]
            out[i, c] = rest / matrix[i, i]
        for i in range(n - 1, -1, -1):
            rest = out[i, c]
            for k in range(i + 1, n):
                rest -= matrix[k, i] * out[k, c]
            out[i, c] = rest / matrix[i, i]


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
    _write_inverse(inverse, factor)
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
def _correct_part(
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
    _write_inverse(information, work)
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


@kernel(void(FLOATS_2D, FLOATS_2D, INPUT_2D, INPUT_2D, INPUT_1D, FLOAT))
def _predict_part(
    turn: Array, covariance: Array, rest: Array, old_rest: Array, rest_std: Array, kept: float
) -> None:
    """Move the rotation of a part to the next frame.

    Args:
        turn: (3, 3) R, overwritten.
        covariance: (3, 3) rad^2, P, overwritten.
        rest: (3, 3) A.
        old_rest: (3, 3) A of the frame before.
        rest_std: (3,) rad, standard deviations of S about the axes of the part.
        kept: a.
    """
    relative, moved, product = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    vector = np.empty(3)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += old_rest[k, i] * turn[k, j]
                moved[i, j] += rest[i, k] * old_rest[j, k]
    _write_vector(vector, relative)
    vector *= kept
    write_rotation_from_vector(vector, relative)
    write_product(turn, rest, relative)
    write_product(product, moved, covariance)
    for i in range(3):
        for j in range(3):
            old = new = 0.0
            for k in range(3):
                old += product[i, k] * moved[j, k]
                new += rest[i, k] * rest_std[k] ** 2 * rest[j, k]
            covariance[i, j] = kept**2 * old + (1 - kept**2) * new


@kernel(
    void(
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_3D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
        FLOAT,
        FLOAT,
        BOOL,
    )
)
def _advance(
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    sizes: Array,
    predicted_turns: Array,
    predicted_covariances: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    step_s: float,
    is_learning: bool,
) -> None:
    """Advance the state of a person's extremities by a frame.

    Args:
        segments: with the following four, attributes of `ExtremityState`, overwritten.
        twist: as above.
        turns: as above.
        covariances: as above.
        sizes: as above.
        predicted_turns: (5, 3, 3) R before the correction, overwritten.
        predicted_covariances: (5, 3, 3) rad^2, P before the correction, overwritten.
        core: with the following, those of `ExtremityEvidence`.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as above.
        stature: m.
        step_s: s, time since the frame before; infinite for the first frame.
        is_learning: whether the sizes are learnt.
    """
    old = segments.copy()
    write_core_segments(segments, twist, core, step_s)
    sums = np.zeros((SIZE_COUNT, 2))
    for part in range(PART_COUNT):
        anchor, kind, turn, covariance = PART_SEGMENTS[part], SIZE_OF[part], turns[part], covariances[part]
        kept = math.exp(-step_s / REST_MEMORY_S[part])
        _predict_part(turn, covariance, segments[anchor], old[anchor], REST_STD[part], kept)
        predicted_turns[part], predicted_covariances[part] = turn, covariance
        size = stature * math.exp(sizes[kind, 0])
        _correct_part(
            part, turn, covariance, sums[kind], core, lifted, lifted_std, rays, weight, size, noise, step_s
        )
    if is_learning:
        for kind in range(SIZE_COUNT):
            earlier = sizes[kind, 1] * math.exp(-min(step_s, SIZE_MEMORY_S) / SIZE_MEMORY_S)
            sizes[kind, 1] = earlier + sums[kind, 0]
            sizes[kind, 0] += sums[kind, 1] / (sizes[kind, 1] + 1 / SIZE_STD[kind] ** 2)


@kernel(
    void(
        FLOATS_4D,
        FLOATS_3D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        FLOAT,
        FLOAT,
        INPUT_1D,
        BOOL,
    )
)
def _follow(
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    predicted_turns: Array,
    predicted_covariances: Array,
    sizes: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    steps: Array,
    is_learning: bool,
) -> None:
    """Advance through F frames; arguments as of `_advance`, with F frames each, but for `sizes`.

    Args:
        segments: overwritten, as the next five.
        twist: as above.
        turns: as above.
        covariances: as above.
        predicted_turns: as above.
        predicted_covariances: as above.
        sizes: (3, 2), those before the first frame; overwritten.
        core: as of `_advance`, as the next four.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as of `_advance`.
        stature: as of `_advance`.
        steps: (F,) s, time since the frame before; infinite for the first.
        is_learning: as of `_advance`.
    """
    for f in range(len(core)):
        if f > 0:
            segments[f], twist[f], turns[f], covariances[f] = (
                segments[f - 1],
                twist[f - 1],
                turns[f - 1],
                covariances[f - 1],
            )
        else:
            segments[f], twist[f], turns[f], covariances[f] = np.eye(3), 0.0, np.eye(3), np.eye(3)
        _advance(
            segments[f],
            twist[f],
            turns[f],
            covariances[f],
            sizes,
            predicted_turns[f],
            predicted_covariances[f],
            core[f],
            lifted[f],
            lifted_std[f],
            rays[f],
            weight[f],
            noise,
            stature,
            steps[f],
            is_learning,
        )


@kernel(void(FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_2D, INPUT_2D, FLOAT))
def _add_estimate(information: Array, pull: Array, own: Array, other: Array, added: Array, sign: float) -> None:
    """Add another estimate of a rotation to what is known, or take it away.

    Args:
        information: (3, 3) 1/rad^2, to which that of the estimate is added.
        pull: (3,) 1/rad, to which this times the rotation vector from `own` to the estimate is added.
        own: (3, 3) rotation about which everything is linearised.
        other: (3, 3) rotation of the estimate.
        added: (3, 3) 1/rad^2, its information.
        sign: 1 to add, -1 to take away.
    """
    relative, vector = np.zeros((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += other[i, k] * own[j, k]
    _write_vector(vector, relative)
    for i in range(3):
        for j in range(3):
            information[i, j] += sign * added[i, j]
            pull[i] += sign * added[i, j] * vector[j]


@kernel(void(FLOATS_2D, FLOATS_2D, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_1D))
def _smooth_part(
    turn: Array,
    covariance: Array,
    rest: Array,
    backward_turn: Array,
    backward_covariance: Array,
    rest_std: Array,
) -> None:
    """Smooth the rotation of a part in a frame (last formula at the head of this module).

    Args:
        turn: (3, 3) R_f, overwritten by R.
        covariance: (3, 3) P_f, overwritten by P.
        rest: (3, 3) A.
        backward_turn: (3, 3) R_b.
        backward_covariance: (3, 3) P_b.
        rest_std: (3,) rad, standard deviations of S about the axes of the part.
    """
    work, information, added = covariance.copy(), np.empty((3, 3)), np.empty((3, 3))
    pull, vector = np.zeros(3), np.zeros(3)
    rotation, new = np.empty((3, 3)), np.empty((3, 3))
    _write_inverse(information, work)
    work[:] = backward_covariance
    _write_inverse(added, work)
    _add_estimate(information, pull, turn, backward_turn, added, 1.0)
    for i in range(3):
        for j in range(3):
            added[i, j] = 0.0
            for k in range(3):
                added[i, j] += rest[i, k] / rest_std[k] ** 2 * rest[j, k]
    _add_estimate(information, pull, turn, rest, added, -1.0)
    _write_inverse(covariance, information)
    for i in range(3):
        for j in range(3):
            vector[i] += covariance[i, j] * pull[j]
    write_rotation_from_vector(vector, rotation)
    write_product(new, rotation, turn)
    turn[:] = new


@kernel(void(FLOATS_4D, FLOATS_4D, INPUT_4D, INPUT_4D, INPUT_4D))
def _smooth(
    turns: Array, covariances: Array, segments: Array, backward_turns: Array, backward_covariances: Array
) -> None:
    """Smooth the rotations of F frames; the arguments have F frames and 5 parts of those of `_smooth_part`.

    Args:
        turns: (F, 5, 3, 3) R_f, overwritten by R.
        covariances: (F, 5, 3, 3) P_f, overwritten by P.
        segments: (F, 15, 3, 3) segments as the core tells them.
        backward_turns: (F, 5, 3, 3) R_b.
        backward_covariances: (F, 5, 3, 3) P_b.
    """
    for f in range(len(turns)):
        for part in range(PART_COUNT):
            _smooth_part(
                turns[f, part],
                covariances[f, part],
                segments[f, PART_SEGMENTS[part]],
                backward_turns[f, part],
                backward_covariances[f, part],
                REST_STD[part],
            )


@kernel(
    void(
        FLOATS_2D,
        FLOATS_1D,
        FLOATS_2D,
        BOOLS_1D,
        INPUT_3D,
        INPUT_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
    )
)
def _write_result(
    offsets: Array,
    offset_std: Array,
    quaternions: Array,
    is_turn_told: Bools,
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    sizes: Array,
    weight: Array,
    stature: float,
) -> None:
    """Write what the state of a frame means for its points and orientations; shapes as in `ExtremityState`.

    Args:
        offsets: overwritten, as the next three.
        offset_std: as above.
        quaternions: those of the frame before, or zeros.
        is_turn_told: as above.
        segments: the state, as the next four.
        twist: as above.
        turns: as above.
        covariances: as above.
        sizes: as above.
        weight: (26,) confidence scores of all joints.
        stature: m.
    """
    is_part_told, seen = np.zeros(PART_COUNT, np.bool_), np.zeros(SEGMENT_COUNT, np.bool_)
    for joint in range(SEGMENT_COUNT):
        seen[joint] = weight[joint] > 0
    for p in range(len(PART_OF)):
        part = PART_OF[p]
        turn, covariance, kind = turns[part], covariances[part], SIZE_OF[part]
        size = stature * math.exp(sizes[kind, 0])
        squared, trace, quadratic = 0.0, 0.0, 0.0
        for i in range(3):
            offsets[p, i] = 0.0
            for j in range(3):
                offsets[p, i] += size * turn[i, j] * TEMPLATE[p, j]
            squared += offsets[p, i] ** 2
            trace += covariance[i, i]
        turn_variance = 0.0
        for i in range(3):
            for j in range(3):
                quadratic += offsets[p, i] * covariance[i, j] * offsets[p, j]
                turn_variance += turn[i, 2] * covariance[i, j] * turn[j, 2]
        size_variance = 1 / (sizes[kind, 1] + 1 / SIZE_STD[kind] ** 2)
        offset_std[p] = math.sqrt(max(trace * squared - quadratic, 0.0) + size_variance * squared)
        is_seen = weight[CORE_COUNT + p] > 0
        is_part_told[part] = is_part_told[part] or (
            is_seen and POINT_COUNTS[part] > 1 and turn_variance < TURN_TOLD_RAD**2
        )
    rotations = np.empty((SEGMENT_COUNT, 3, 3))
    write_orientations(rotations, is_turn_told, segments, twist, turns, is_part_told, seen)
    write_quaternions(quaternions, rotations)


@kernel(
    types.Tuple(
        (
            FLOATS_3D,
            FLOATS_2D,
            FLOATS_3D,
            FLOATS_3D,
            FLOATS_2D,
            FLOATS_2D,
            FLOATS_1D,
            FLOATS_2D,
            FLOATS_2D,
            BOOLS_1D,
        )
    )(
        INPUT_3D,
        INPUT_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
        FLOAT,
        FLOAT,
    )
)
def _follow_frame(
    old_segments: Array,
    old_twist: Array,
    old_turns: Array,
    old_covariances: Array,
    old_sizes: Array,
    old_offsets: Array,
    old_velocity: Array,
    old_quaternions: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    step_s: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Bools]:
    """Return the attributes of `ExtremityState` in a frame, from those of the frame before and the evidence.

    Args:
        old_segments: with the following seven, attributes of the state before.
        old_twist: as above.
        old_turns: as above.
        old_covariances: as above.
        old_sizes: as above.
        old_offsets: as above.
        old_velocity: as above.
        old_quaternions: as above.
        core: with the following five, those of `ExtremityEvidence`.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as above.
        stature: m.
        step_s: s, time since the frame before; infinite for the first frame.
    """
    segments, twist, sizes = old_segments.copy(), old_twist.copy(), old_sizes.copy()
    turns, covariances, quaternions = old_turns.copy(), old_covariances.copy(), old_quaternions.copy()
    predicted, unused = np.empty(turns.shape), np.empty(turns.shape)
    _advance(
        segments,
        twist,
        turns,
        covariances,
        sizes,
        predicted,
        unused,
        core,
        lifted,
        lifted_std,
        rays,
        weight,
        noise,
        stature,
        step_s,
        True,
    )
    offsets, std, told = np.empty(old_offsets.shape), np.empty(len(old_offsets)), np.empty(SEGMENT_COUNT, np.bool_)
    _write_result(offsets, std, quaternions, told, segments, twist, turns, covariances, sizes, weight, stature)
    velocity = np.zeros(offsets.shape)
    if math.isfinite(step_s):
        share = 1 - math.exp(-step_s / VELOCITY_MEMORY_S)
        for p in range(len(offsets)):
            for i in range(3):
                moved = (offsets[p, i] - old_offsets[p, i]) / step_s
                velocity[p, i] = old_velocity[p, i] + share * (moved - old_velocity[p, i])
    return segments, twist, turns, covariances, sizes, offsets, std, velocity, quaternions, told


class ExtremityEvidence(NamedTuple):
    """What tells of the extremities in one frame; all in the camera's optical frame.

    Attributes:
        core: (15, 3) m, solved core joints.
        lifted: (26, 3) m, lifted joints about any origin; NaN without a lifter.
        lifted_std: (26, 3) m, their standard deviations across (twice) and along the line of sight.
        rays: (26, 2) rays of all joints.
        weight: (26,) confidence scores of all joints; 0 where not seen.
        noise: m, image noise at the body.
    """

    core: Array
    lifted: Array
    lifted_std: Array
    rays: Array
    weight: Array
    noise: float

    def make_contiguous(self) -> ExtremityEvidence:
        """Return the same with arrays that kernels take."""
        core, lifted, lifted_std, rays, weight = (np.ascontiguousarray(a, np.float64) for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, float(self.noise))

    def reverse(self) -> ExtremityEvidence:
        """Return that of a sequence in the reverse order of time."""
        core, lifted, lifted_std, rays, weight = (np.ascontiguousarray(a[::-1]) for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, self.noise)

    def select_frame(self, frame: int) -> ExtremityEvidence:
        """Return that of one frame of a sequence."""
        core, lifted, lifted_std, rays, weight = (a[frame] for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, self.noise)

    @staticmethod
    def without_image(core: Array) -> ExtremityEvidence:
        """Return that nothing but the core (15, 3) m is known."""
        joints = CORE_COUNT + EXTREMITY_COUNT
        unknown = np.full((joints, 3), np.nan)
        return ExtremityEvidence(core, unknown, unknown, np.zeros((joints, 2)), np.zeros(joints), 0.0)


@dataclass(frozen=True, eq=False)
class ExtremityState:
    """The extremities of a person in one frame; immutable, `advance` returns those of the next.

    Attributes:
        segments: (15, 3, 3) rotations of the segments as the core tells them (`body_segments.py`).
        twist: (4, 3) turns of the limbs, likewise.
        turns: (5, 3, 3) R, rotations of the `PARTS`.
        covariances: (5, 3, 3) rad^2, P.
        sizes: (3, 2) b and I of face, feet and hands.
        offsets: (11, 3) m, points less the core joints on which they hang.
        offset_std: (11,) m, standard deviation of each of them.
        velocity: (11, 3) m/s, velocity of the offsets.
        quaternions: (15, 4) x, y, z, w, orientations of the segments.
        is_turn_told: (15,) whether the image tells the turn of a segment about its own axis.
    """

    segments: Array
    twist: Array
    turns: Array
    covariances: Array
    sizes: Array
    offsets: Array
    offset_std: Array
    velocity: Array
    quaternions: Array
    is_turn_told: Bools

    @staticmethod
    def begin(evidence: ExtremityEvidence, stature: float) -> ExtremityState:
        """Return the extremities of a person who is seen for the first time; `stature` in m."""
        unknown = np.tile(np.eye(3), (PART_COUNT, 1, 1))
        start = ExtremityState(
            np.tile(np.eye(3), (SEGMENT_COUNT, 1, 1)),
            np.zeros((4, 3)),
            unknown,
            unknown,
            np.zeros((SIZE_COUNT, 2)),
            np.zeros((EXTREMITY_COUNT, 3)),
            np.zeros(EXTREMITY_COUNT),
            np.zeros((EXTREMITY_COUNT, 3)),
            np.zeros((SEGMENT_COUNT, 4)),
            np.zeros(SEGMENT_COUNT, bool),
        )
        return start.advance(math.inf, evidence, stature)

    def advance(self, step_s: float, evidence: ExtremityEvidence, stature: float) -> ExtremityState:
        """Return the extremities in the next frame.

        Args:
            step_s: s, time since this frame, positive.
            evidence: what tells of them.
            stature: m, stature of the person.
        """
        old = self.segments, self.twist, self.turns, self.covariances, self.sizes
        shown = self.offsets, self.velocity, self.quaternions
        seen = evidence.make_contiguous()
        return ExtremityState(*_follow_frame(*old, *shown, *seen[:5], seen.noise, stature, step_s))


class ExtremitySequence(NamedTuple):
    """The extremities of a person over F frames, smoothed.

    Attributes:
        offsets: (F, 11, 3) m, points less the core joints on which they hang.
        offset_std: (F, 11) m, standard deviation of each of them.
        quaternions: (F, 15, 4) x, y, z, w, orientations of the segments, continuous.
        is_turn_told: (F, 15) whether the image tells the turn of a segment about its own axis.
    """

    offsets: Array
    offset_std: Array
    quaternions: Array
    is_turn_told: Bools


def attach(core: Array, offsets: Array) -> Array:
    """Return all joints (..., 26, 3) m of core joints (..., 15, 3) and offsets (..., 11, 3) of extremities."""
    return np.concatenate([core, core[..., ANCHORS, :] + offsets], axis=-2)


def smooth_extremities(times: Array, evidence: ExtremityEvidence, stature: float) -> ExtremitySequence:
    """Estimate the extremities of a person over a whole sequence (last formulas at the head of this module).

    Args:
        times: (F,) s, increasing.
        evidence: that of F frames, each array with a first dimension F; the image noise is one for all.
        stature: m, stature of the person.
    """
    frames = len(times)
    evidence = evidence.make_contiguous()
    steps, reverse_steps = (np.append(np.inf, np.diff(t)) for t in (times, -times[::-1]))
    sizes = np.zeros((SIZE_COUNT, 2))
    forward, backward = _Passes.empty(frames), _Passes.empty(frames)
    _follow(*forward, sizes, *evidence, stature, steps, True)
    _follow(*forward, sizes, *evidence, stature, steps, False)
    _follow(*backward, sizes, *evidence.reverse(), stature, reverse_steps, False)
    turns, covariances = forward.turns, forward.covariances
    _smooth(
        turns,
        covariances,
        forward.segments,
        backward.predicted_turns[::-1].copy(),
        backward.predicted_covariances[::-1].copy(),
    )
    offsets, std = np.empty((frames, EXTREMITY_COUNT, 3)), np.empty((frames, EXTREMITY_COUNT))
    quaternions, told = np.zeros((frames, SEGMENT_COUNT, 4)), np.zeros((frames, SEGMENT_COUNT), bool)
    for f in range(frames):
        if f:
            quaternions[f] = quaternions[f - 1]
        _write_result(
            offsets[f],
            std[f],
            quaternions[f],
            told[f],
            forward.segments[f],
            forward.twist[f],
            turns[f],
            covariances[f],
            sizes,
            evidence.weight[f],
            stature,
        )
    return ExtremitySequence(offsets, std, quaternions, told)


class _Passes(NamedTuple):
    """What `_follow` writes for F frames: attributes of `ExtremityState`, and the predictions of turns."""

    segments: Array
    twist: Array
    turns: Array
    covariances: Array
    predicted_turns: Array
    predicted_covariances: Array

    @staticmethod
    def empty(frames: int) -> _Passes:
        """Return arrays for these frames."""
        parts = (frames, PART_COUNT, 3, 3)
        return _Passes(
            np.empty((frames, SEGMENT_COUNT, 3, 3)),
            np.empty((frames, 4, 3)),
            *(np.empty(parts) for _ in range(4)),
        )
