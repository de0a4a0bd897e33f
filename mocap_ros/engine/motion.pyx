# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Where a person is from frame to frame: states of the solution, the filter of the motion, corrected velocities.

The formulas are in `tracking.solution`, `tracking.motion_filter` and `models.velocity_correction`. Sizes: J joints,
F frames, K base poses, T spans of time, I inputs and H hidden units of the network.
"""

from libc.math cimport M_PI, cos, exp, expf, fabs, isfinite, pow, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from mocap_ros.engine.geometry cimport dot

ctypedef const double[::1] Vector
ctypedef const double[:, ::1] Rows
ctypedef const double[:, :, ::1] Stack
ctypedef const float[::1] Floats
ctypedef const long long[::1] Indices

cdef extern from *:
    """
    /* The constants of joints and the powers were chosen together on 53 trials of persons of the training data, with
       clean points and as three detectors give them: least errors of acceleration for 0.1 to 0.6 mm of the positions.
       The stiffness of joints and the power of jitter were set last, with other persons in sight (docs/method.md).
       Factors of deviations are by likelihood in these trials, then set so that two thirds of other persons' errors
       are within the standard deviation. */
    typedef struct {
        double stiffness;          /* rad/s at 1 m/s and w = w_0; Omega */
        double damping;            /* zeta */
        double fade;               /* 1/s; b: limbs swing to and fro, who walks goes on for some seconds */
        double speed_floor;        /* m/s; s_0 */
        double jitter_factors[3];  /* f_w of x, y and z */
        double speed_factors[3];   /* f_s */
        double velocity_floor;     /* m/s; f_0 */
    } Spring;
    static const Spring JOINT = {40.0, 0.5, 6.4, 0.055, {1.6, 1.6, 0.5}, {0.0, 0.0, 0.62}, 0.0};
    /* its steps should not overshoot; its first solutions may be off by a tenth of the depth; it rises and falls */
    static const Spring CENTRE = {20.0, 1.0, 0.5, 0.2, {1.1, 1.1, 1.1}, {0.14, 0.14, 0.55}, 0.07};
    #define SPEED_POWER 0.73      /* p */
    #define JITTER_POWER 0.45     /* q */
    #define JITTER_UNIT_M 0.005   /* w_0, the jitter with OpenPose's points */
    #define SPEED_MEMORY_S 0.077  /* time constant of the mean square of the speed */
    #define JITTER_MEMORY_S 0.113 /* time constant of that of the second differences, short for joints that are astray */
    #define MAX_RISE 6.0          /* mean squares; a single squared difference counts at most so much */
    #define MIN_JITTER_M 1e-4     /* far below what is seen, keeps the stiffness finite */
    #define SQUARES 6.0           /* sum of the squared coefficients of a second difference at even times: 1, -2, 1 */

    #define INPUT_LIMIT 4.0       /* standard deviations; there is next to nothing beyond in training */
    #define MAX_CORRECTION 1.5    /* standard deviations of the filter's velocity; one in 40 would be larger */
    #define LIMIT_FIRST 1         /* of the spans, 0.1 to 0.4 s; less has jitter, more remembers what has ended */
    #define LIMIT_LAST 4
    """
    ctypedef struct Spring:
        double stiffness, damping, fade, speed_floor, velocity_floor
        double[3] jitter_factors, speed_factors
    const Spring JOINT, CENTRE
    const double SPEED_POWER, JITTER_POWER, JITTER_UNIT_M, SPEED_MEMORY_S, JITTER_MEMORY_S, MAX_RISE
    const double MIN_JITTER_M, SQUARES, INPUT_LIMIT, MAX_CORRECTION
    const int LIMIT_FIRST, LIMIT_LAST

cdef enum:  # rows of the filter's state: x, v, mean squares of the second differences and of v, variance of v
    X, V, SECOND, SPEED, VARIANCE
    LEFT = 1  # index of the axis of the body whose sign a mirror changes


cdef inline double square(double x) noexcept nogil:
    return x * x


cdef void pose(
    const double* theta, Py_ssize_t count, const double* rotation, const double* root, Rows mean, Stack components,
    double size, double* out,
) noexcept nogil:
    cdef Py_ssize_t j, k, i
    cdef double[3] point
    for j in range(mean.shape[0]):
        for i in range(3):
            point[i] = mean[j, i]
            for k in range(count):
                point[i] += theta[k] * components[k, j, i]
        for i in range(3):
            out[3 * j + i] = size * (dot(rotation + 3 * i, point) + root[i])


def locate_joints(Vector theta, Rows rotation, Vector root, Rows mean, Stack components, double size):
    """Return the joints (J, 3) m of a pose: size (R (Q_0 + sum_k theta_k Q_k) + root).

    Args:
        theta: (K,) m.
        rotation: (3, 3) R.
        root: (3,) m.
        mean: (J, 3) m, Q_0.
        components: (K or more, J, 3), Q_k.
        size: of the person over that of the solution.
    """
    result = np.empty((mean.shape[0], 3))
    cdef double[:, ::1] out = result
    pose(&theta[0], theta.shape[0], &rotation[0, 0], &root[0], mean, components, size, &out[0, 0])
    return result


def sample_joints(
    Vector wanted, Vector times, Rows theta, Stack rotation, Rows roots, Rows mean, Stack components, double size
):
    """Return the joints (T, J, 3) m at some times (T,) s, interpolated between those of F frames; NaN before them."""
    cdef Py_ssize_t n, f, k, first, values = 3 * mean.shape[0], count = theta.shape[1]
    cdef double share
    result = np.full((wanted.shape[0], mean.shape[0], 3), np.nan)
    cdef double[:, :, ::1] out = result
    cdef double* after = <double*> malloc(values * sizeof(double))
    cdef double* before
    for n in range(wanted.shape[0]):
        if not wanted[n] >= times[0]:
            continue
        first = 0
        while first < times.shape[0] - 2 and times[first + 1] < wanted[n]:
            first += 1
        before = &out[n, 0, 0]
        share = (wanted[n] - times[first]) / (times[first + 1] - times[first])
        pose(&theta[first, 0], count, &rotation[first, 0, 0], &roots[first, 0], mean, components, size, before)
        pose(&theta[first + 1, 0], count, &rotation[first + 1, 0, 0], &roots[first + 1, 0], mean, components, size,
             after)
        for k in range(values):
            before[k] += share * (after[k] - before[k])
    free(after)
    return result


def split_centre(Rows joints):
    """Return joints (J, 3) about their centre, followed by the centre: (J + 1, 3)."""
    cdef Py_ssize_t j, i, count = joints.shape[0]
    result = np.zeros((count + 1, 3))
    cdef double[:, ::1] out = result
    for j in range(count):
        for i in range(3):
            out[count, i] += joints[j, i] / count
    for j in range(count):
        for i in range(3):
            out[j, i] = joints[j, i] - out[count, i]
    return result


def read_motion(Stack state, Py_ssize_t left_hip, Py_ssize_t right_hip):
    """Return joints, velocities (J, 3), deviations (J,) and the covariance (3, 3) of the velocity between the hips.

    The errors of both hips are mostly the same, so the variance of the point between them is their mean.

    Args:
        state: (5, J + 1, 3) of the filter.
        left_hip: index of the joint.
        right_hip: likewise.
    """
    cdef Py_ssize_t j, i, count = state.shape[1] - 1
    cdef double variance
    arrays = np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.zeros((3, 3))
    cdef double[:, ::1] joints = arrays[0], velocity = arrays[1], covariance = arrays[3]
    cdef double[::1] std = arrays[2]
    for j in range(count):
        variance = 0
        for i in range(3):
            joints[j, i] = state[X, j, i] + state[X, count, i]
            velocity[j, i] = state[V, j, i] + state[V, count, i]
            variance += state[VARIANCE, j, i] + state[VARIANCE, count, i]
        std[j] = sqrt(variance)
    for i in range(3):
        covariance[i, i] = (state[VARIANCE, left_hip, i] + state[VARIANCE, right_hip, i]) / 2
        covariance[i, i] += state[VARIANCE, count, i]
    return arrays


cdef void write_difference(Vector times, double* out) noexcept nogil:
    """Write the coefficients of the divided second difference at three times, scaled as at even times."""
    cdef int i, j
    cdef double product, squares = 0
    for i in range(3):
        product = 1
        for j in range(3):
            if j != i:
                product *= times[i] - times[j]
        out[i] = 1 / product
        squares += out[i] * out[i]
    for i in range(3):
        out[i] *= sqrt(SQUARES / squares)


def advance_motion(Stack state, Stack recent, Vector times, double max_jitter):
    """Return the state (5, N, 3) of the filter after the newest frame.

    Args:
        state: (5, N, 3) of the frame before.
        recent: (n, N, 3) m, unfiltered points of the newest frames, up to 3; the last of the N points is the centre.
        times: (n,) s, their times.
        max_jitter: m, largest standard deviation of the jitter of a joint.
    """
    cdef Py_ssize_t p, c, i, newest = times.shape[0] - 1, points = state.shape[1]
    cdef double step = times[newest] - times[newest - 1], difference, squared_speed, second, jitter, omega, rho
    cdef double turn, kept, x, innovation
    cdef double jitter_forgotten = 1 - exp(-step / JITTER_MEMORY_S), speed_forgotten = 1 - exp(-step / SPEED_MEMORY_S)
    cdef double[3] coefficients
    cdef const Spring* spring
    result = np.array(state)
    cdef double[:, :, ::1] out = result
    if newest == 2:
        write_difference(times, coefficients)
    for p in range(points):
        spring = &CENTRE if p == points - 1 else &JOINT
        squared_speed, second = square(spring.speed_floor), 0.0
        for c in range(3):
            if newest == 2:
                difference = 0
                for i in range(3):
                    difference += coefficients[i] * recent[i, p, c]
                x = state[SECOND, p, c]
                out[SECOND, p, c] += jitter_forgotten * (min(difference * difference, MAX_RISE * x) - x)
            out[SPEED, p, c] += speed_forgotten * (square(state[V, p, c]) - state[SPEED, p, c])
            squared_speed += out[SPEED, p, c]
            second += out[SECOND, p, c] / 3
        for c in range(3):
            if p == points - 1:
                jitter = sqrt(out[SECOND, p, c] / SQUARES)
            else:
                jitter = min(sqrt(second / SQUARES), max_jitter)
            jitter = max(jitter, MIN_JITTER_M)
            omega = spring.stiffness * pow(squared_speed, SPEED_POWER / 2) * pow(jitter / JITTER_UNIT_M, -JITTER_POWER)
            rho = exp(-spring.damping * omega * step)
            turn = min(sqrt(1 - square(spring.damping)) * omega * step, M_PI / 2)  # at most a quarter turn
            kept = exp(-spring.fade * step)
            x = state[X, p, c] + (1 - kept) / spring.fade * state[V, p, c]
            innovation = recent[newest, p, c] - x
            out[X, p, c] = x + (1 - rho * rho) * innovation
            out[V, p, c] = kept * state[V, p, c] + (square(1 - rho) + 2 * rho * (1 - cos(turn))) / step * innovation
            out[VARIANCE, p, c] = (
                square(spring.jitter_factors[c] * jitter * omega)
                + square(spring.speed_factors[c]) * squared_speed + square(spring.velocity_floor)
            )
    return result


def build_inputs(Rows velocity, Rows joints, Stack earlier, Rows axes, Vector spans, Indices mirror, Indices hips):
    """Return the inputs x (2, I) of a person and of the mirror image, neither centred nor scaled.

    Args:
        velocity: this and the next three are attributes of `VelocityPast`.
        joints: likewise.
        earlier: likewise.
        axes: likewise.
        spans: (T,) s.
        mirror: (J + 1,) counterparts of the joints and of the root.
        hips: (2,) indices.
    """
    cdef Py_ssize_t k, j, i, a, own, other, count = joints.shape[0], times = spans.shape[0]
    cdef double length = 0, value
    cdef double[:, :, ::1] points = np.empty((times + 2, count + 1, 3))  # the root is last
    result = np.zeros((2, (times + 2) * (count + 1) * 3))
    cdef double[:, ::1] out = result
    for j in range(count):
        for i in range(3):
            points[0, j, i], points[times + 1, j, i] = velocity[j, i], joints[j, i]
            for k in range(times):  # what is not known of the past is as if the person had moved as now
                value = (joints[j, i] - earlier[k, j, i]) / spans[k] - velocity[j, i]
                points[1 + k, j, i] = 0.0 if earlier[k, j, 0] != earlier[k, j, 0] else value
    for k in range(times + 2):
        for i in range(3):
            points[k, count, i] = (points[k, hips[0], i] + points[k, hips[1], i]) / 2
            for j in range(count):
                points[k, j, i] -= points[k, count, i]
    length = sqrt(dot(&points[times + 1, count, 0], &points[times + 1, count, 0]))
    for i in range(3):
        points[times + 1, count, i] /= length
    for k in range(times + 2):
        for j in range(count + 1):
            own, other = 3 * (k * (count + 1) + j), 3 * (k * (count + 1) + mirror[j])
            for i in range(3):
                for a in range(3):
                    out[0, own + i] += axes[a, i] * points[k, j, a]
                out[1, other + i] = -out[0, own + i] if i == LEFT else out[0, own + i]
    return result


cdef void evaluate(
    const double* inputs, Floats centre, Floats scale, const float[:, ::1] weight_0, Floats bias_0,
    const float[:, ::1] weight_1, Floats bias_1, float* hidden, float* found,
) noexcept nogil:
    """Write what the network says of inputs (I,): `found` (3 (J + 1),)."""
    cdef Py_ssize_t i, n, units = bias_0.shape[0], outputs = bias_1.shape[0]
    cdef float factor
    for n in range(units):
        hidden[n] = bias_0[n]
    for n in range(outputs):
        found[n] = bias_1[n]
    for i in range(centre.shape[0]):
        factor = <float> min(max((inputs[i] - centre[i]) / scale[i], -INPUT_LIMIT), INPUT_LIMIT)
        for n in range(units):
            hidden[n] += factor * weight_0[i, n]
    for i in range(units):
        factor = hidden[i] / (1 + expf(-hidden[i]))
        for n in range(outputs):
            found[n] += factor * weight_1[i, n]


def add_correction(
    Rows velocity, Vector std, Rows covariance, Rows correction, Py_ssize_t left_hip, Py_ssize_t right_hip,
    double std_factor, double correction_factor, double root_factor,
):
    """Return corrected velocities (J, 3), their deviations (J,) and covariance (3, 3); None where none is corrected.

    The formulas are in `tracking.output`.

    Args:
        velocity: (J, 3) of the filter.
        std: (J,) likewise.
        covariance: (3, 3) likewise, of the velocity between the hips.
        correction: (J, 3).
        left_hip: index of the joint.
        right_hip: likewise.
        std_factor: f.
        correction_factor: g.
        root_factor: h.
    """
    cdef Py_ssize_t j, i, k, count = velocity.shape[0]
    cdef double squared
    cdef bint is_corrected = False
    cdef double[3] at_root
    arrays = np.empty((count, 3)), np.empty(count), np.empty((3, 3))
    cdef double[:, ::1] new_velocity = arrays[0], new_covariance = arrays[2]
    cdef double[::1] new_std = arrays[1]
    for j in range(count):
        squared = dot(&correction[j, 0], &correction[j, 0])
        is_corrected = is_corrected or squared > 0
        new_std[j] = sqrt(square(std_factor * std[j]) + square(correction_factor) * squared)
        for i in range(3):
            new_velocity[j, i] = velocity[j, i] + correction[j, i]
    if not is_corrected:
        return None
    for i in range(3):
        at_root[i] = (correction[left_hip, i] + correction[right_hip, i]) / 2
    for i in range(3):
        for k in range(3):
            new_covariance[i, k] = square(root_factor * std_factor) * covariance[i, k]
            new_covariance[i, k] += square(root_factor * correction_factor) * at_root[i] * at_root[k]
    return arrays


def correct_velocity(
    Rows velocity, Vector std, Rows joints, Stack earlier, Rows axes, Vector spans, Indices mirror, Indices hips,
    Floats centre, Floats scale, const float[:, ::1] weight_0, Floats bias_0, const float[:, ::1] weight_1,
    Floats bias_1,
):
    """Return what is to be added to the velocities (J, 3) m/s, limited (the l_j).

    Args:
        velocity: this and the next four are the attributes of `VelocityPast`.
        std: likewise.
        joints: likewise.
        earlier: likewise.
        axes: likewise.
        spans: with the next two as of `build_inputs`.
        mirror: likewise.
        hips: likewise.
        centre: with the next five the attributes of `VelocityCorrection`.
        scale: likewise.
        weight_0: likewise.
        bias_0: likewise.
        weight_1: likewise.
        bias_1: likewise.
    """
    cdef Py_ssize_t j, i, a, k, n, count = joints.shape[0]
    cdef const double[:, ::1] inputs = build_inputs(velocity, joints, earlier, axes, spans, mirror, hips)
    cdef double[:, ::1] said = np.zeros((count + 1, 3))
    cdef float[::1] hidden = np.empty(bias_0.shape[0], np.float32), found = np.empty(bias_1.shape[0], np.float32)
    cdef double along, apart_along, most_along, most_across, squared, length
    cdef double[3] sight, apart
    result = np.zeros((count, 3))
    cdef double[:, ::1] out = result
    for n in range(2):  # the mean of the person and of the mirror image
        evaluate(&inputs[n, 0], centre, scale, weight_0, bias_0, weight_1, bias_1, &hidden[0], &found[0])
        for j in range(count + 1):
            for i in range(3):
                length = found[3 * (mirror[j] if n else j) + i] / 2
                said[j, i] += -length if n and i == LEFT else length
    for i in range(3):
        sight[i] = joints[hips[0], i] + joints[hips[1], i]
    length = sqrt(dot(sight, sight))
    for i in range(3):
        sight[i] /= length
    for j in range(count):
        for i in range(3):
            for a in range(3):
                out[j, i] += axes[i, a] * (said[j, a] + said[count, a])
        along, most_along, most_across = dot(&out[j, 0], sight), 0.0, 0.0
        for k in range(LIMIT_FIRST, LIMIT_LAST):
            for i in range(3):
                apart[i] = (joints[j, i] - earlier[k, j, i]) / spans[k] - velocity[j, i]
            apart_along = dot(apart, sight)
            for i in range(3):
                apart[i] -= apart_along * sight[i]
            squared = sqrt(dot(apart, apart))
            if fabs(apart_along) > most_along:  # not with NaN, which is not larger
                most_along = fabs(apart_along)
            if squared > most_across:
                most_across = squared
        for i in range(3):
            out[j, i] -= along * sight[i]
        squared = dot(&out[j, 0], &out[j, 0])
        length = most_across / sqrt(squared) if squared > most_across * most_across else 1.0
        along = min(max(along, -most_along), most_along)
        for i in range(3):
            out[j, i] = length * out[j, i] + along * sight[i]
        length = sqrt(dot(&out[j, 0], &out[j, 0]))
        most_along = MAX_CORRECTION * std[j]
        if not (isfinite(length) and isfinite(most_along)):
            out[j, 0] = out[j, 1] = out[j, 2] = 0.0
        elif length > most_along:
            for i in range(3):
                out[j, i] *= most_along / length
    return result
