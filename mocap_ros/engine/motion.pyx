# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Where people are from frame to frame: states of the solution, filters, corrected velocities, their deviations.

The formulas are in `tracking.solution`, `tracking.motion_filter`, `models.velocity_correction`, `models.joint_std`
and `tracking.body_size`. Sizes: P people, J joints, F frames, K base poses, T spans of time, I inputs and H hidden
units of the network.
"""

from libc.math cimport M_PI, NAN, cos, exp, expf, fabs, hypot, isfinite, pow, sqrt
from libc.string cimport memcpy, memmove

import numpy as np

from scipy.linalg.cython_blas cimport sgemm

from mocap_ros.engine.geometry cimport MAX_DEPTH_CHANGE, MAX_SPEED_M_S, Indices, Rows, Stack, Vector, dot, square

# The constants of joints and the powers were chosen together on 53 trials of persons of the training data, with clean
# points and as three detectors give them: least errors of acceleration for 0.1 to 0.6 mm of the positions. The
# stiffness of joints, the power and the memory of jitter were set last, by recorded detections too. Factors of
# deviations are by likelihood in these trials, then set so that two thirds of other persons' errors are within the
# standard deviation.
cdef struct Spring:
    double[3] stiffness  # rad/s of x, y and z at 1 m/s and w = w_0; Omega
    double damping  # zeta
    double fade  # 1/s; b: limbs swing to and fro, who walks goes on for some seconds
    double speed_floor  # m/s; s_0
    double[3] jitter_factors  # f_w of x, y and z
    double[3] speed_factors  # f_s
    double velocity_floor  # m/s; f_0

cdef Spring JOINT = Spring([46.0, 46.0, 31.0], 0.5, 6.4, 0.055, [1.6, 1.6, 0.5], [0.0, 0.0, 0.62], 0.0)
# its steps should not overshoot; its first solutions may be off by a tenth of the depth; it rises and falls
cdef Spring CENTRE = Spring([20.0, 20.0, 20.0], 1.0, 0.5, 0.2, [1.1, 1.1, 1.1], [0.14, 0.14, 0.55], 0.07)
cdef double SPEED_POWER = 0.73  # p
cdef double JITTER_POWER = 0.45  # q
cdef double JITTER_UNIT_M = 0.005  # w_0, the jitter with OpenPose's points
cdef double SPEED_MEMORY_S = 0.077  # time constant of the mean square of the speed
cdef double JITTER_MEMORY_S = 0.25  # that of the second differences
cdef double MAX_RISE = 6.0  # mean squares; a single squared difference counts at most so much
cdef double MIN_JITTER_M = 1e-4  # far below what is seen, keeps the stiffness finite
cdef double SQUARES = 6.0  # sum of the squared coefficients of a second difference at even times: 1, -2, 1
cdef double INITIAL_JITTER_M = 0.005  # until it is estimated
cdef double INITIAL_SPEED_M_S = 1.0  # that of a walker
cdef double MAX_NOISE_SHARE = 0.5  # of the image noise; a joint rests on several frames and points
cdef double ROUNDING_S = 1e-6  # differences of times that are equal but for rounding are smaller
cdef double MAX_STEP_S = 0.200001  # over a gap of more than 0.2 s the differences say nothing of the jitter
# Of corrected velocities: two thirds of the errors are within, of persons in no training as well.
cdef double CORRECTED_STD = 0.7  # f
cdef double CORRECTION_STD = 0.7  # g
cdef double ROOT_SPREAD = 1.3  # h; errors of the root's velocity are at times large: 95 % are within
# Of joints, as `models.joint_std` says.
cdef double LIFTER_SEEN = 0.65  # f
cdef double NOISE_SEEN = 0.9  # n
cdef double LIFTER_INFERRED = 0.8  # g; the image says little of them
cdef double POSTERIOR_SEEN = 3.5  # h_j
cdef double POSTERIOR_INFERRED = 5.6  # h_j
cdef double POSTERIOR_FLOOR_M = 0.011  # the posterior does not know the poses that the base poses cannot represent
cdef double ACROSS = 1.0 / 6  # of the whole variance, in each direction across the line of sight
cdef double ALONG = 2.0 / 3  # and along it
VARIANCE_ACROSS, VARIANCE_ALONG = ACROSS, ALONG  # for `models.joint_std`

cdef enum:  # rows of the filter's state: x, v, mean squares of the second differences and of v, variance of v
    X, V, SECOND, SPEED, VARIANCE
    LEFT = 1  # index of the axis of the body whose sign a mirror changes
    LIMIT_FIRST = 1  # of the spans, 0.1 to 0.4 s; less has jitter, more remembers what has ended
    LIMIT_LAST = 4
    JOINTS = 15
    POINTS = 16  # the joints about their centre, and the centre


cdef struct Filter:  # of a person; NaN before the first frame
    double times[3]  # s, of the three newest frames; NaN before the first, or before a gap
    double recent[3][POINTS][3]  # m, unfiltered points of these frames
    # x in m, v in m/s, the mean squares of the second differences in m^2 and of v in m^2/s^2, and the variance of v
    # in m^2/s^2
    double state[5][POINTS][3]

cdef Filter _filter
MOTION = np.asarray(<Filter[:1]> &_filter).dtype


cdef void pose(
    const double* theta, Py_ssize_t count, const double* rotation, const double* root, Rows mean, Stack components,
    double size, double* out,
) noexcept nogil:
    cdef Py_ssize_t j, k, i, values = 3 * mean.shape[0]
    cdef double[3] point
    cdef const double* component
    for i in range(values):
        out[i] = (&mean[0, 0])[i]
    for k in range(count):
        component = &components[k, 0, 0]
        for i in range(values):
            out[i] += theta[k] * component[i]
    for j in range(mean.shape[0]):
        for i in range(3):
            point[i] = out[3 * j + i]
        for i in range(3):
            out[3 * j + i] = size * (dot(rotation + 3 * i, point) + root[i])


def sample_joints(Vector ago, frames, windows, solutions):
    """Return the joints (P, T, J, 3) m of people of the assumed size; NaN before the first frame of their windows.

    Positions at times `ago` (T,) s before a frame of each, given by its index, are interpolated between frames.
    """
    cdef Py_ssize_t p, n, k, first, frame, values, count
    cdef double share, wanted, size
    cdef Vector times
    cdef Rows theta, roots, mean
    cdef Stack rotation, components
    cdef double[:, :, :, ::1] out
    cdef double[::1] after
    cdef double* before
    result = np.empty((len(frames), ago.shape[0], *solutions[0].model.mean.shape))
    out, values = result, 3 * result.shape[2]
    out[...] = NAN
    after = np.empty(values)
    for p in range(out.shape[0]):
        solution, frame, times = solutions[p], frames[p], windows[p].times
        theta, rotation, roots = solution.theta, solution.rotation, solution.roots
        mean, components = solution.model.mean, solution.model.components
        size, count = 1 / <double> solution.stature_ratio, theta.shape[1]
        for n in range(ago.shape[0]):
            wanted, before, first = times[frame] - ago[n], &out[p, n, 0, 0], frame
            if not wanted >= times[0] - ROUNDING_S:
                continue
            wanted = max(wanted, times[0])
            while first > 0 and times[first] > wanted:
                first -= 1
            pose(&theta[first, 0], count, &rotation[first, 0, 0], &roots[first, 0], mean, components, size, before)
            if first == frame:
                continue
            share = (wanted - times[first]) / (times[first + 1] - times[first])
            pose(&theta[first + 1, 0], count, &rotation[first + 1, 0, 0], &roots[first + 1, 0], mean, components,
                 size, &after[0])
            for k in range(values):
                before[k] += share * (after[k] - before[k])
    return result


cdef void write_difference(const double* times, double* out) noexcept nogil:
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


cdef void begin_filter(double* state, const double* points, Py_ssize_t count) noexcept nogil:
    cdef Py_ssize_t k
    for k in range(3 * count):
        state[3 * count * X + k], state[3 * count * V + k] = points[k], 0.0
        state[3 * count * SECOND + k] = SQUARES * square(INITIAL_JITTER_M)
        state[3 * count * SPEED + k] = square(INITIAL_SPEED_M_S) / 3
        state[3 * count * VARIANCE + k] = square(INITIAL_SPEED_M_S)


cdef void advance_filter(
    double* state, const double* recent, const double* times, Py_ssize_t points, double max_jitter
) noexcept nogil:
    """Advance the state (5, N, 3) to the last of three times, of which the first may be NaN."""
    cdef Py_ssize_t p, c, i, at
    cdef bint has_difference = isfinite(times[0])
    cdef double step = times[2] - times[1], difference, squared_speed, second, jitter, omega, rho
    cdef double turn, kept, x, innovation
    cdef double jitter_forgotten = 1 - exp(-step / JITTER_MEMORY_S), speed_forgotten = 1 - exp(-step / SPEED_MEMORY_S)
    cdef double[3] coefficients
    cdef const Spring* spring
    cdef double* positions = state + 3 * points * X
    cdef double* velocities = state + 3 * points * V
    cdef double* seconds = state + 3 * points * SECOND
    cdef double* speeds = state + 3 * points * SPEED
    cdef double* variances = state + 3 * points * VARIANCE
    if has_difference:
        write_difference(times, coefficients)
    for p in range(points):
        spring = &CENTRE if p == points - 1 else &JOINT
        squared_speed, second = square(spring.speed_floor), 0.0
        for c in range(3):
            at = 3 * p + c
            if has_difference:
                difference = 0
                for i in range(3):
                    difference += coefficients[i] * recent[3 * points * i + at]
                x = seconds[at]
                seconds[at] += jitter_forgotten * (min(difference * difference, MAX_RISE * x) - x)
            speeds[at] += speed_forgotten * (square(velocities[at]) - speeds[at])
            squared_speed += speeds[at]
            second += seconds[at] / 3
        for c in range(3):
            at = 3 * p + c
            if p == points - 1:
                jitter = sqrt(seconds[at] / SQUARES)
            else:
                jitter = min(sqrt(second / SQUARES), max_jitter)
            jitter = max(jitter, MIN_JITTER_M)
            omega = spring.stiffness[c] * pow(squared_speed, SPEED_POWER / 2)
            omega *= pow(jitter / JITTER_UNIT_M, -JITTER_POWER)
            rho = exp(-spring.damping * omega * step)
            turn = min(sqrt(1 - square(spring.damping)) * omega * step, M_PI / 2)  # at most a quarter turn
            kept = exp(-spring.fade * step)
            x = positions[at] + (1 - kept) / spring.fade * velocities[at]
            innovation = recent[3 * points * 2 + at] - x
            positions[at] = x + (1 - rho * rho) * innovation
            velocities[at] = kept * velocities[at] + (square(1 - rho) + 2 * rho * (1 - cos(turn))) / step * innovation
            variances[at] = (
                square(spring.jitter_factors[c] * jitter * omega)
                + square(spring.speed_factors[c]) * squared_speed + square(spring.velocity_floor)
            )


cdef void filter_person(Filter* own, double time, const double* joints, double image_noise) noexcept nogil:
    """Advance the filter of a person, unless the frame is not newer than the last."""
    cdef Py_ssize_t j, i
    cdef double squared = 0, moved
    cdef double* points = &own.recent[2][0][0]
    cdef double* state = &own.state[0][0][0]
    cdef double* centre = own.recent[2][JOINTS]
    cdef const double* last = own.state[X][JOINTS]
    if time <= own.times[2]:
        return
    memmove(own.times, &own.times[1], 2 * sizeof(own.times[0]))
    memmove(own.recent, &own.recent[1], 2 * sizeof(own.recent[0]))
    own.times[2] = time
    for i in range(3):
        centre[i] = 0
        for j in range(JOINTS):
            centre[i] += joints[3 * j + i] / JOINTS
        for j in range(JOINTS):
            points[3 * j + i] = joints[3 * j + i] - centre[i]
        squared += square(last[i] - centre[i])
    moved = MAX_DEPTH_CHANGE * fabs(last[2]) + MAX_SPEED_M_S * (own.times[2] - own.times[1])
    if not sqrt(squared) <= moved:  # NaN before the first frame
        own.times[0] = own.times[1] = NAN
        begin_filter(state, points, POINTS)
        return
    if own.times[2] - own.times[1] > MAX_STEP_S:
        own.times[0] = NAN
    advance_filter(state, &own.recent[0][0][0], own.times, POINTS, MAX_NOISE_SHARE * image_noise)


def filter_motion(
    double[:, :] filters, Vector times, Stack located, Vector image_noise, Indices hips, bint is_steady
):
    """Return joints, velocities (P, J, 3), deviations (P, J) and covariances (P, 3, 3) of velocities between hips.

    The errors of both hips are mostly the same, so the variance of the point between them is their mean. If
    `is_steady`, the filters are advanced in place before.

    `filters` (P, R), each a `Filter`, NaN before the first frame; `times` (P,) s, a frame that is not newer than the last changes nothing; where a filter is not at this time, the joints
    are those located, and all else is NaN; `located` (P, J, 3) m; `image_noise` (P,) m, at the body.
    """
    cdef Py_ssize_t p, j, i, people = located.shape[0], count = located.shape[1]
    cdef double variance
    arrays = (np.array(located), np.empty((people, count, 3)), np.empty((people, count)), np.empty((people, 3, 3)))
    cdef double[:, :, ::1] joints = arrays[0], velocity = arrays[1], covariance = arrays[3]
    cdef double[:, ::1] std = arrays[2]
    cdef Filter* own
    for p in range(people):
        own = <Filter*> &filters[p, 0]
        if is_steady:
            filter_person(own, times[p], &located[p, 0, 0], image_noise[p])
        if own.times[2] != times[p]:
            velocity[p], std[p], covariance[p] = NAN, NAN, NAN
            continue
        for j in range(JOINTS):
            variance = 0
            for i in range(3):
                joints[p, j, i] = own.state[X][j][i] + own.state[X][JOINTS][i]
                velocity[p, j, i] = own.state[V][j][i] + own.state[V][JOINTS][i]
                variance += own.state[VARIANCE][j][i] + own.state[VARIANCE][JOINTS][i]
            std[p, j] = sqrt(variance)
        covariance[p, :, :] = 0.0
        for i in range(3):
            covariance[p, i, i] = (own.state[VARIANCE][hips[0]][i] + own.state[VARIANCE][hips[1]][i]) / 2
            covariance[p, i, i] += own.state[VARIANCE][JOINTS][i]
    return arrays


cpdef build_inputs(past, Vector spans, Indices mirror, Indices hips):
    """Return the inputs x (P, 2, I) of people and of the mirror images, neither centred nor scaled.

    `past` is a `VelocityPast`; `spans` (T,) s; `mirror` (J + 1,) counterparts of the joints and of the root;
    `hips` (2,) indices.
    """
    cdef Stack velocity = past[0], joints = past[2], axes = past[4]
    cdef const double[:, :, :, ::1] earlier = past[3]
    cdef Py_ssize_t p, k, j, i, a, own, other, count = joints.shape[1], times = spans.shape[0]
    cdef double length, value
    cdef double[:, :, ::1] points = np.empty((times + 2, count + 1, 3))  # the root is last
    result = np.zeros((joints.shape[0], 2, (times + 2) * (count + 1) * 3))
    cdef double[:, :, ::1] out = result
    for p in range(joints.shape[0]):
        for j in range(count):
            for i in range(3):
                points[0, j, i], points[times + 1, j, i] = velocity[p, j, i], joints[p, j, i]
                for k in range(times):  # what is not known of the past is as if the person had moved as now
                    value = (joints[p, j, i] - earlier[p, k, j, i]) / spans[k] - velocity[p, j, i]
                    points[1 + k, j, i] = 0.0 if earlier[p, k, j, 0] != earlier[p, k, j, 0] else value
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
                        out[p, 0, own + i] += axes[p, a, i] * points[k, j, a]
                    out[p, 1, other + i] = -out[p, 0, own + i] if i == LEFT else out[p, 0, own + i]
    return result


cdef evaluate(layers, const double[:, :, ::1] inputs, double limit):
    """Return c_j and c_0 (P, 2, 3 (J + 1)) of people and of the mirror images, by inputs (P, 2, I)."""
    cdef const float[::1] centre = layers[0], scale = layers[1], bias_0 = layers[3], bias_1 = layers[5]
    cdef const float[:, ::1] weight_0 = layers[2], weight_1 = layers[4]
    cdef int rows = 2 * inputs.shape[0], width = inputs.shape[2]
    cdef int units = weight_0.shape[1], outputs = weight_1.shape[1]
    cdef float one = 1
    cdef Py_ssize_t n, i
    cdef float[:, ::1] x = np.empty((rows, width), np.float32), hidden = np.empty((rows, units), np.float32)
    result = np.empty((inputs.shape[0], 2, outputs), np.float32)
    cdef float[:, :, ::1] out = result
    for n in range(rows):
        for i in range(width):
            x[n, i] = min(max((inputs[n // 2, n % 2, i] - centre[i]) / scale[i], -limit), limit)
        memcpy(&hidden[n, 0], &bias_0[0], units * sizeof(float))
        memcpy(&out[n // 2, n % 2, 0], &bias_1[0], outputs * sizeof(float))
    sgemm(b"N", b"N", &units, &rows, &width, &one, <float*> &weight_0[0, 0], &units, &x[0, 0], &width, &one,
          &hidden[0, 0], &units)
    for n in range(rows):
        for i in range(units):
            hidden[n, i] /= 1 + expf(-hidden[n, i])
    sgemm(b"N", b"N", &outputs, &rows, &units, &one, <float*> &weight_1[0, 0], &outputs, &hidden[0, 0], &units,
          &one, &out[0, 0, 0], &outputs)
    return result


def correct_velocity(
    layers, past, double[:, :, ::1] covariance, double limit, Py_ssize_t needed, double max_stds, Vector spans,
    Indices mirror, Indices hips,
):
    """Correct velocities, limited by the l_j, their deviations and the covariances (P, 3, 3) of roots in place.

    `layers` are the fields of `VelocityCorrection`; `limit` of the inputs, in standard deviations; `needed` index
    of the span without which nothing is corrected; `max_stds` L; else as `build_inputs`.
    """
    cdef double[:, :, ::1] velocity = past[0]
    cdef double[:, ::1] std = past[1]
    cdef Stack joints = past[2], axes = past[4]
    cdef const double[:, :, :, ::1] earlier = past[3]
    cdef const float[:, :, ::1] found
    cdef Py_ssize_t p, j, i, a, k, n, people = joints.shape[0], count = joints.shape[1]
    cdef double[:, ::1] said = np.zeros((count + 1, 3))
    cdef double along, apart_along, most_along, most_across, squared, length
    cdef double[3] sight, apart, out, root
    if not np.isfinite(past[3][:, needed, 0, 0]).any():
        return
    found = evaluate(layers, build_inputs(past, spans, mirror, hips), limit)
    for p in range(people):
        if not isfinite(earlier[p, needed, 0, 0]):
            continue
        said[:, :] = 0.0
        root = [0, 0, 0]
        for n in range(2):  # the mean of the person and of the mirror image
            for j in range(count + 1):
                for i in range(3):
                    length = found[p, n, 3 * (mirror[j] if n else j) + i] / 2
                    said[j, i] += -length if n and i == LEFT else length
        for i in range(3):
            sight[i] = joints[p, hips[0], i] + joints[p, hips[1], i]
        length = sqrt(dot(sight, sight))
        for i in range(3):
            sight[i] /= length
        for j in range(count):
            for i in range(3):
                out[i] = 0
                for a in range(3):
                    out[i] += axes[p, i, a] * (said[j, a] + said[count, a])
            along, most_along, most_across = dot(out, sight), 0.0, 0.0
            for k in range(LIMIT_FIRST, LIMIT_LAST):
                for i in range(3):
                    apart[i] = (joints[p, j, i] - earlier[p, k, j, i]) / spans[k] - velocity[p, j, i]
                apart_along = dot(apart, sight)
                for i in range(3):
                    apart[i] -= apart_along * sight[i]
                squared = sqrt(dot(apart, apart))
                if fabs(apart_along) > most_along:  # not with NaN, which is not larger
                    most_along = fabs(apart_along)
                if squared > most_across:
                    most_across = squared
            for i in range(3):
                out[i] -= along * sight[i]
            squared = dot(out, out)
            length = most_across / sqrt(squared) if squared > most_across * most_across else 1.0
            along = min(max(along, -most_along), most_along)
            for i in range(3):
                out[i] = length * out[i] + along * sight[i]
            length = sqrt(dot(out, out))
            most_along = max_stds * std[p, j]
            if not (isfinite(length) and isfinite(most_along)):
                out = [0, 0, 0]
            elif length > most_along:
                for i in range(3):
                    out[i] *= most_along / length
            std[p, j] = hypot(CORRECTED_STD * std[p, j], CORRECTION_STD * sqrt(dot(out, out)))
            for i in range(3):
                velocity[p, j, i] += out[i]
                if j == hips[0] or j == hips[1]:
                    root[i] += CORRECTION_STD * out[i] / 2
        for i in range(3):
            for a in range(3):
                covariance[p, i, a] = square(ROOT_SPREAD) * (
                    square(CORRECTED_STD) * covariance[p, i, a] + root[i] * root[a]
                )


def describe_cores(Rows posterior, evidence, Stack joints, Rows sizes, Rows shifts, Indices hips):
    """Return the deviations (P, J) m of joints, of `models.joint_std`, and the covariances (P, 3, 3) m^2 of roots.

    The covariances are `tracking.body_size`'s, but for the ratio. `posterior` (P, J) m of the solver;
    `evidence` an `ExtremityEvidence`; `joints` (P, J, 3) m; `sizes` (P, 3) the attributes of `BodySize`; `shifts`
    (P, 3) m by which inertia and feet displace people, NaN if unknown.
    """
    cdef Rows weight = evidence.weight
    cdef Stack lifted_std = evidence.lifted_std
    cdef Vector noise = evidence.noise
    cdef Py_ssize_t p, j, i, a
    cdef bint is_seen
    cdef int count
    cdef double length, variance, deep
    cdef double[3] root
    cdef const double* lifted
    result, covariances = np.empty((posterior.shape[0], posterior.shape[1])), np.empty((posterior.shape[0], 3, 3))
    cdef double[:, ::1] std = result
    cdef double[:, :, ::1] covariance = covariances
    for p in range(std.shape[0]):
        count = 0
        for j in range(std.shape[1]):
            is_seen, lifted = weight[p, j] > 0, &lifted_std[p, j, 0]
            count += is_seen
            length = sqrt(dot(lifted, lifted))
            if not isfinite(length):
                length = (POSTERIOR_SEEN if is_seen else POSTERIOR_INFERRED) * posterior[p, j]
                std[p, j] = hypot(length, POSTERIOR_FLOOR_M)
            elif is_seen:
                std[p, j] = hypot(LIFTER_SEEN / sqrt(ALONG) * lifted[2], NOISE_SEEN * noise[p])
            else:
                std[p, j] = LIFTER_INFERRED * length
        for i in range(3):
            root[i] = (joints[p, hips[0], i] + joints[p, hips[1], i]) / 2
        variance = 0
        for i in range(2):
            variance += std[p, hips[i]] / 2 * (1 if weight[p, hips[i]] > 0 else std.shape[1] / <double> max(count, 1))
        variance = square(variance)
        deep = variance * (ALONG - ACROSS) / dot(root, root) + square(sizes[p, 1])
        for i in range(3):
            for a in range(3):
                covariance[p, i, a] = deep * root[i] * root[a]
                if isfinite(shifts[p, i] * shifts[p, a]):
                    covariance[p, i, a] += shifts[p, i] * shifts[p, a]
            covariance[p, i, i] += ACROSS * variance + square(noise[p])
        covariance[p, 2, 2] += square(sizes[p, 2] * root[2])
    return result, covariances


def measure_stature(Rows lengths, Vector stature_per_bone):
    """Return the mean stature in m of a person with bones of the lengths (F, B) m."""
    cdef Py_ssize_t t, k
    cdef double stature = 0
    for t in range(lengths.shape[0]):
        for k in range(lengths.shape[1]):
            stature += lengths[t, k] * stature_per_bone[k]
    return stature / lengths.shape[0]
