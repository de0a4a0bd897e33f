# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Roots that have inertia and feet that stand: the contacts and the least squares of `solvers.footing`.

The unknowns of a frame are u = (c, a_left, a_right), 9 numbers: displacements of the whole body and of both feet in
the real camera's axes. Terms couple a frame with the two before it. With all terms up to frame t added, the unknowns
of frame t - 2 are eliminated, which leaves a matrix (18, 18) and a right side (18,) of frames t - 1 and t. Its
solution is the estimate of frame t from its past; a sequence is then substituted backwards.
"""

from libc.math cimport INFINITY, NAN, atanh, exp, fabs, fmax, fmin, isfinite, isnan, log, rint, sqrt, tanh
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.geometry cimport MAX_DEPTH_CHANGE, MAX_SPEED_M_S, Indices, Rows, Stack, Vector, dot


cdef enum:
    CORE = 15  # joints
    OWN = 9  # unknowns of a frame
    TWO = 18
    ALL = 27
    FEET = 2
    POINTS = 4  # left heel, left toe, right heel, right toe
    HIP = 0  # of a leg, in `legs` (2, 3)
    KNEE = 1
    ANKLE = 2

cdef double BASE_STEP_S = 1.0 / 30  # s; for which deviations of accelerations are given
cdef double MIN_STEP_S = 1e-3  # guards divisions by a time step
cdef double MIN_INFORMATION = 1e-9  # 1/m^2; keeps what nothing determines solvable
cdef double MEASURED_M = 0.1  # m; C along the line of sight where depths are measured, which say more than inertia
cdef double FAR_M = 5  # m; beyond it the root's error along the line of sight grows with the distance
cdef double MIN_LENGTH_M = 1e-6  # m; guards divisions by lengths
cdef double MIN_TILT_M = 0.01  # m; legs along the line of sight do not tilt
cdef double MAX_REACH = 0.9999  # of the length of a leg; a straight knee has no direction in which it bends
cdef double MIN_REACH = 1.0001  # of the difference of thigh and shank; nor has one that is folded up
cdef double LEAST_NOISE_M = 5e-4  # image noise of points without errors
# Of contacts, in the letters of `solvers.footing`.
cdef double SPEED_M_S = 0.2  # V_s
cdef double FAST_M_S = 0.9  # V_m
cdef double SPEED_ERROR = 10.0  # 1/s; V_n
cdef double HEIGHT_M = 0.07  # H
cdef double HEIGHT_ERROR = 2.0  # 1; H_n
cdef double EVIDENCE_S = 0.2  # tau_e: as near frames share points and errors, those of so long count as one
cdef double MOVING = 4.0  # D
cdef double HOLD_S = 0.35  # tau_h
cdef double MAX_STEP_S = 0.1  # longest time that one frame stands for
# longer lines blur short stands, and in shorter ones a detector's noise hides them; frames of 30 Hz may be late
cdef double REACH_S = 0.11
cdef double ROUNDING_S = 1e-6  # differences of times that are equal but for rounding are smaller
cdef double FORGOTTEN = 2 * atanh(0.05)  # |log f| of p within 0.025 of 1/2, which is no knowledge, after about 1 s


cdef struct Memory:  # what is kept of a person in a frame
    double time_s  # s, of the newest frame
    double log_odds[POINTS]  # logarithms of the odds that heels and toes stand; NaN where unknown
    double standing[FEET]  # probabilities that heel or toe of the left and of the right foot stand, likewise
    double core[CORE * 3]  # m, in the axes of the camera
    double found[TWO]  # m, unknowns u of the frame before, and of this one
    double matrix[TWO * TWO]  # 1/m^2, lower triangle, and the right side, of the unknowns of both
    double right[TWO]
    double root[3]  # m; X_t, and V_t in m/s
    double velocity[3]
    double points[POINTS * 3]  # m; x_ti, and p_ti
    double contact[POINTS]
    double step_s  # s, since the frame before
    double frames  # number so far, at most 2

cdef Memory _memory
FOOTING = np.asarray(<Memory[:1]> &_memory).dtype


cdef struct Model:
    double along, across  # m; C along the line of sight and across it
    double error_s, leg_s  # s; T of c and of a
    double acceleration_along, acceleration_across  # m/s^2; B
    double leg_tilt, leg_across  # m; A as legs tilt in depth, and across it
    double slip  # m/s; S
    double pace  # m/s; V_0
    double roll  # 1; R
    double fast  # m/s; c of rho, four times as much without estimate


cdef Model choose_model(double noise, bint is_live):
    """The constants under an image noise in m at the body, of whole sequences or of the newest frame."""
    cdef Model model
    noise = fmax(noise, LEAST_NOISE_M)
    model.along, model.across = 0.03 + 0.5 * noise, 0.004 + 0.3 * noise
    model.leg_across = 0.004 + 0.1 * noise  # with more, feet slide less and knees are worse
    model.slip = 0.09 * sqrt(1 + (0.007 / noise) * (0.007 / noise))  # with less, errors of contacts add up
    if is_live:
        model.error_s, model.leg_s, model.acceleration_along, model.acceleration_across = 0.7, 0.1, 4.0, 7.0
        model.leg_tilt, model.pace, model.roll, model.fast = model.leg_across, INFINITY, 0.3, 0.3
    else:  # accelerations of people who walk
        model.error_s, model.leg_s, model.acceleration_along, model.acceleration_across = 0.5, 0.2, 2.0, 3.5
        model.leg_tilt, model.pace, model.roll, model.fast = 0.02 + 0.6 * noise, 1.2, 0.05, 0.1
    return model


def list_constants(double noise, bint is_live):
    """Return the fields of `Model`, (12,)."""
    cdef Model model = choose_model(noise, is_live)
    return np.array(<double[:12]> &model.along)


cdef void add_term(
    double* a, double* b, int count, const int* at, const double* by, const double* m, const double* r
) noexcept nogil:
    """Add the term d^T M d with d = sum_i by_i u[at_i] + r, M (3, 3), to the lower triangle A (27, 27) and b."""
    cdef int i, j, x, y
    cdef double pull
    for i in range(count):
        for j in range(count):
            if at[j] > at[i]:
                continue
            for x in range(3):
                for y in range(3):
                    a[(at[i] + x) * ALL + at[j] + y] += by[i] * by[j] * m[3 * x + y]
        for x in range(3):
            pull = m[3 * x] * r[0] + m[3 * x + 1] * r[1] + m[3 * x + 2] * r[2]
            b[at[i] + x] -= by[i] * pull


cdef void write_precision(const double* sight, double along, double across, double* m) noexcept nogil:
    """Write (I - s s^T) / across^2 + s s^T / along^2."""
    cdef int i, j
    cdef double wide = 1 / (across * across), deep = 1 / (along * along)
    for i in range(3):
        for j in range(3):
            m[3 * i + j] = (wide if i == j else 0) + (deep - wide) * sight[i] * sight[j]


cdef void add_frame(
    const Memory* before, const Model* model, double step_s, const double* root, const double* points,
    const double* tilts, const double* contact, const double* estimate, const double* ahead, double* a, double* b,
) noexcept nogil:
    """Write the normal equations A (27, 27), b (27,) of the frames t - 2, t - 1 and t.

    `estimate` (18,) are the unknowns of the frames t - 1 and t as last found, NULL if none are; `ahead` (2,) is a
    measured displacement of the body along the optical axis in m, and its information in 1/m^2, NaN or NULL where
    depths are not measured.
    """
    cdef int i, j, k, f
    cdef bint is_measured = ahead != NULL and isfinite(ahead[1])
    cdef double kept, h, weight, squared, distance = sqrt(dot(root, root))
    cdef double[9] m
    cdef double[3] r, sight
    cdef int[4] at
    cdef double[4] by
    memset(a, 0, ALL * ALL * sizeof(double))
    memset(b, 0, ALL * sizeof(double))
    for i in range(TWO):
        for j in range(i + 1):
            a[i * ALL + j] = before.matrix[i * TWO + j]
        b[i] = before.right[i]
    for i in range(ALL):
        a[i * ALL + i] += MIN_INFORMATION
    for i in range(3):
        sight[i], r[i] = root[i] / distance, 0
    # errors of the root and of the legs fade: c_t - kept c_(t-1)
    at[0], at[1], by[0] = TWO, OWN, 1
    kept = exp(-step_s / model.error_s) if before.frames > 0 else 0
    by[1], h = -kept, sqrt(1 - kept * kept)
    weight = h * MEASURED_M if is_measured else h * model.along * fmax(distance / FAR_M, 1.0)
    write_precision(sight, weight, h * model.across, m)
    add_term(a, b, 2, at, by, m, r)
    if is_measured:
        a[(TWO + 2) * ALL + TWO + 2] += ahead[1]
        b[TWO + 2] += ahead[1] * ahead[0]
    kept = exp(-step_s / model.leg_s) if before.frames > 0 else 0
    by[1], h = -kept, sqrt(1 - kept * kept)
    for f in range(FEET):
        write_precision(tilts + 3 * f, h * model.leg_tilt, h * model.leg_across, m)
        at[0], at[1] = TWO + 3 + 3 * f, OWN + 3 + 3 * f
        add_term(a, b, 2, at, by, m, r)
    if before.frames > 1:  # acceleration of the root
        at[0], at[1], at[2] = 0, OWN, TWO
        by[0], by[2] = 1 / before.step_s, 1 / step_s
        by[1], h = -by[0] - by[2], sqrt(BASE_STEP_S * (before.step_s + step_s) / 2)
        for i in range(3):
            r[i] = (root[i] - before.root[i]) / step_s - before.velocity[i]
        squared = dot(before.velocity, before.velocity) / (model.pace * model.pace)
        h *= sqrt(1 + squared * squared)
        write_precision(sight, h * model.acceleration_along, h * model.acceleration_across, m)
        add_term(a, b, 3, at, by, m, r)
    if before.frames < 1:
        return
    by[0], by[1], by[2], by[3] = 1 - model.roll, 1, model.roll - 1, -1
    for k in range(POINTS):
        f = k // 2
        weight = fmin(contact[k], before.contact[k])
        if not weight > 0:
            continue
        at[0], at[1], at[2], at[3] = TWO, TWO + 3 + 3 * f, OWN, OWN + 3 + 3 * f
        squared = 0
        for i in range(3):
            r[i] = points[3 * k + i] - before.points[3 * k + i] - model.roll * (root[i] - before.root[i])
            h = r[i]
            if estimate != NULL:
                h += (1 - model.roll) * (estimate[OWN + i] - estimate[i])
                h += estimate[OWN + 3 + 3 * f + i] - estimate[3 + 3 * f + i]
            squared += h * h
        h = (model.fast if estimate != NULL else 4 * model.fast) * step_s
        weight /= (1 + squared / (h * h)) * model.slip * model.slip * step_s * step_s
        memset(m, 0, sizeof(m))
        m[0] = m[4] = m[8] = weight
        add_term(a, b, 4, at, by, m, r)


cdef void foresee(const Memory* before, double step_s, const double* root, double* estimate) noexcept nogil:
    """Write the unknowns (18,) of frames t - 1 and t, if the root goes on as before and the feet about it, too."""
    cdef int i
    cdef double velocity
    memcpy(estimate, &before.found[OWN], OWN * sizeof(double))
    memcpy(estimate + OWN, &before.found[OWN], OWN * sizeof(double))
    for i in range(3):
        velocity = before.velocity[i] + (before.found[OWN + i] - before.found[i]) / before.step_s
        estimate[OWN + i] += before.root[i] + velocity * step_s - root[i]


cdef void eliminate(double* a, double* b, Memory* memory) noexcept nogil:
    """Overwrite A and b by L and L^-1 b of A = L L^T, and keep what the frame t - 2 leaves to the others."""
    cdef int k, i, j
    cdef double pivot
    for k in range(ALL):
        if k == OWN:
            for i in range(TWO):
                memcpy(&memory.matrix[i * TWO], &a[(OWN + i) * ALL + OWN], (i + 1) * sizeof(double))
                memory.right[i] = b[OWN + i]
        pivot = sqrt(a[k * ALL + k])
        for i in range(k, ALL):
            a[i * ALL + k] /= pivot
        b[k] /= pivot
        for i in range(k + 1, ALL):
            for j in range(k + 1, i + 1):
                a[i * ALL + j] -= a[i * ALL + k] * a[j * ALL + k]
            b[i] -= a[i * ALL + k] * b[k]


cdef void substitute(const double* l, const double* y, int first, int end, double* u) noexcept nogil:
    """Write the unknowns `first` to `end` of L^T u = y, from those after them."""
    cdef int i, j
    for i in range(end - 1, first - 1, -1):
        u[i] = y[i]
        for j in range(i + 1, ALL):
            u[i] -= l[j * ALL + i] * u[j]
        u[i] /= l[i * ALL + i]


cdef void remember(
    Memory* memory, double step_s, const double* root, const double* points, const double* contact
) noexcept nogil:
    cdef int i
    for i in range(3):
        memory.velocity[i] = (root[i] - memory.root[i]) / step_s
    memcpy(memory.root, root, 3 * sizeof(double))
    memcpy(memory.points, points, POINTS * 3 * sizeof(double))
    memcpy(memory.contact, contact, POINTS * sizeof(double))
    memory.step_s = step_s
    memory.frames = fmin(memory.frames + 1, 2)


cdef void move_leg(const double* moved, double* hip, double* knee, double* ankle) noexcept nogil:
    """Move an ankle about its hip; the lengths of thigh and shank stay, and so does where the knee bends to."""
    cdef int i
    cdef double thigh = 0, shank = 0, reach = 0, along, aside = 0, part
    cdef double[3] to, side
    for i in range(3):
        to[i], side[i] = ankle[i] + moved[i] - hip[i], knee[i] - hip[i]
        thigh += side[i] * side[i]
        shank += (ankle[i] - knee[i]) * (ankle[i] - knee[i])
        reach += to[i] * to[i]
    thigh, shank, reach = sqrt(thigh), sqrt(shank), sqrt(reach)
    for i in range(3):
        to[i] /= fmax(reach, MIN_LENGTH_M)
    reach = fmin(fmax(reach, MIN_REACH * fabs(thigh - shank)), MAX_REACH * (thigh + shank))
    along = (thigh * thigh - shank * shank + reach * reach) / fmax(2 * reach, MIN_LENGTH_M)
    part = dot(side, to)
    for i in range(3):
        side[i] -= part * to[i]
        aside += side[i] * side[i]
    aside = sqrt(fmax(thigh * thigh - along * along, 0.0)) / fmax(sqrt(aside), MIN_LENGTH_M)
    for i in range(3):
        knee[i] = hip[i] + along * to[i] + aside * side[i]
        ankle[i] = hip[i] + reach * to[i]


cdef void find_points(
    double[:, ::1] core, Rows feet, const long long[:, ::1] legs, double* root, double* points, double* tilts
) noexcept nogil:
    """Write the middle of the hips, the points that may stand, and where ankles go as legs tilt in depth."""
    cdef int i, k, f
    cdef double length, along
    cdef double[3] leg
    for f in range(FEET):
        length = along = 0
        for i in range(3):
            leg[i] = core[legs[f, ANKLE], i] - core[legs[f, HIP], i]
            length += leg[i] * leg[i]
            along += leg[i] * core[legs[f, HIP], i]
        length = fmax(length, MIN_LENGTH_M * MIN_LENGTH_M)
        for i in range(3):
            tilts[3 * f + i] = core[legs[f, HIP], i] - along / length * leg[i]
        length = fmax(sqrt(dot(tilts + 3 * f, tilts + 3 * f)), MIN_TILT_M)
        for i in range(3):
            tilts[3 * f + i] /= length
    for i in range(3):
        root[i] = (core[legs[0, HIP], i] + core[legs[1, HIP], i]) / 2
        for k in range(POINTS):
            points[3 * k + i] = core[legs[k // 2, ANKLE], i] + feet[k, i]


cdef void displace(double[:, ::1] core, const long long[:, ::1] legs, const double* u) noexcept nogil:
    """Move a body and its feet by the unknowns of a frame."""
    cdef int f, i, j
    for f in range(FEET):
        move_leg(u + 3 + 3 * f, &core[legs[f, HIP], 0], &core[legs[f, KNEE], 0], &core[legs[f, ANKLE], 0])
    for j in range(core.shape[0]):
        for i in range(3):
            core[j, i] += u[i]


cdef void find_ankles(const double[:, :] other_weight, Py_ssize_t frames, Indices others, bint* is_ankle):
    """Write of which points (4,) only the ankles were seen in a window."""
    cdef Py_ssize_t k, t
    for k in range(POINTS):
        is_ankle[k] = True
        for t in range(0 if other_weight is None or other_weight.shape[1] == 0 else frames):
            if other_weight[t, others[k]] > 0:
                is_ankle[k] = False
                break


cdef void follow_points(
    Py_ssize_t t, Py_ssize_t frames, Vector times, const double[:, :, :] rays, const double[:, :] weight,
    const double[:, :, :] other_rays, const double[:, :] other_weight, const double[:, :] core, double[:, :] feet,
    const double[:] upward, const long long[:, ::1] legs, Indices others, const bint* is_ankle, double noise,
    double* odds, double* evidence,
):
    """Overwrite log f (4,) by that of frame t, and write e (4,); later frames than `frames` take no part."""
    cdef double error = SPEED_ERROR * noise, squared_speed = SPEED_M_S * SPEED_M_S + error * error
    cdef double standing = log((FAST_M_S * FAST_M_S + error * error) / squared_speed)  # K
    cdef double height_std = sqrt(HEIGHT_M * HEIGHT_M + HEIGHT_ERROR * HEIGHT_ERROR * noise * noise)
    cdef Py_ssize_t s, k, i, at, start = max(t - 4, 0), count = min(start + 4, frames - 1) - start
    cdef double step_s = MAX_STEP_S, reach_s = REACH_S, lowest = INFINITY
    cdef double ago, sum_1, sum_2, x, y, sum_x, sum_y, squared_ratio, height
    cdef double[4] heights, depths
    cdef const double[:, :, :] seen
    cdef const double[:, :] score
    if count > 0:
        reach_s = fmax(reach_s, 2.5 * (times[start + count] - times[start]) / count + ROUNDING_S)
        step_s = fmin(step_s, times[max(t, 1)] - times[max(t, 1) - 1])
    for k in range(POINTS):
        at, height = legs[k // 2, ANKLE], 0
        for i in range(3):
            height += upward[i] * (core[at, i] + feet[k, i])
        heights[k], depths[k], lowest = height, core[at, 2] + feet[k, 2], fmin(lowest, height)
    for k in range(POINTS):
        if is_ankle[k]:
            seen, score, at = rays, weight, legs[k // 2, ANKLE]
            feet[k, 0], feet[k, 1], feet[k, 2] = 0, 0, 0
        else:
            seen, score, at = other_rays, other_weight, others[k]
        count, sum_1, sum_2, x, y, sum_x, sum_y, s = 0, 0, 0, 0, 0, 0, 0, t
        while s > 0 and times[t] - times[s - 1] <= reach_s:
            s -= 1
        while s < frames and times[s] - times[t] <= reach_s:
            if score[s, at] > 0:
                ago = times[s] - times[t]
                count, sum_1, sum_2 = count + 1, sum_1 + ago, sum_2 + ago * ago
                sum_x, sum_y = sum_x + seen[s, at, 0], sum_y + seen[s, at, 1]
                x, y = x + ago * seen[s, at, 0], y + ago * seen[s, at, 1]
            s += 1
        odds[k] = hold(odds[k] if isfinite(odds[k]) else 0.0, times[t] - times[t - 1] if t > 0 else step_s)
        evidence[k] = NAN
        if count >= 3 and score[t, at] > 0 and isfinite(depths[k]):
            sum_2 = count * sum_2 - sum_1 * sum_1
            x, y = (count * x - sum_1 * sum_x) / sum_2, (count * y - sum_1 * sum_y) / sum_2
            squared_ratio = depths[k] * depths[k] * (x * x + y * y) / squared_speed
            height = (heights[k] - lowest) / height_std if isfinite(lowest) else 0
            evidence[k] = score[t, at] * step_s / EVIDENCE_S * fmax(
                standing - squared_ratio - height * height, -MOVING
            )
            odds[k] += evidence[k]


cdef inline double hold(double odds, double step_s) noexcept nogil:
    """log g, of a logarithm of odds."""
    return 2 * atanh(exp(-step_s / HOLD_S) * tanh(odds / 2))


def find_contacts(
    Vector times, const double[:, :, :] rays, const double[:, :] weight, const double[:, :, :] other_rays,
    const double[:, :] other_weight, const double[:, :, :] core, double[:, :, :] feet, const double[:, :] upward,
    const long long[:, ::1] legs, Indices others, double noise,
):
    """Return the probabilities (F, 4) that heels and toes stand; NaN where unknown.

    Rays and scores are of the core and of the extremities; core (F, J, 3) m, and feet (F, 4, 3) m about their
    ankles, which are set to 0 where the window has only the ankles; noise in m, of the image at the body.
    """
    cdef Py_ssize_t t, k, frames = times.shape[0]
    cdef double[4] odds = [NAN, NAN, NAN, NAN]
    cdef double[4] after = [0, 0, 0, 0]
    cdef bint[4] is_ankle
    cdef bint is_seen
    result = np.empty((frames, POINTS))
    cdef double[:, ::1] out = result, evidence = np.empty((frames, POINTS))
    find_ankles(other_weight, frames, others, is_ankle)
    for t in range(frames):
        follow_points(t, frames, times, rays, weight, other_rays, other_weight, core[t], feet[t], upward[t], legs,
                      others, is_ankle, noise, odds, &evidence[t, 0])
        memcpy(&out[t, 0], odds, sizeof(odds))
    for t in range(frames - 1, -1, -1):
        for k in range(POINTS):
            odds[k], is_seen = out[t, k] + after[k], not isnan(evidence[t, k])
            out[t, k] = 1 / (1 + exp(-odds[k])) if is_seen or fabs(odds[k]) >= FORGOTTEN else NAN
            if t > 0:
                after[k] = hold(after[k] + (evidence[t, k] if is_seen else 0), times[t] - times[t - 1])
    return result


def follow_contacts(
    double[:, :] footings, Vector times, windows, frames, Stack core, double[:, :, ::1] feet, Vector upward,
    const long long[:, ::1] legs, Indices others, Vector noise,
):
    """Overwrite odds, and what follows for feet, by those in a frame of each window; later frames take no part.

    `footings` and `times` as of `advance`; windows P `ObservedWindow`, frames indices in them; core (P, J, 3) m;
    noise (P,) m; else as `find_contacts`.
    """
    cdef Py_ssize_t p, k, frame
    cdef double[4] evidence
    cdef bint[4] is_ankle
    cdef Memory* own
    cdef const double[:, :, :] other_rays
    cdef const double[:, :] other_weight
    for p in range(footings.shape[0]):
        own, window, frame = <Memory*> &footings[p, 0], windows[p], frames[p]
        if times[p] <= own.time_s:
            continue
        other_rays, other_weight = (None, None) if window.extremities is None else window.extremities
        find_ankles(other_weight, frame + 1, others, is_ankle)
        follow_points(frame, frame + 1, window.times, window.rays, window.weight, other_rays, other_weight,
                      core[p], feet[p], upward, legs, others, is_ankle, noise[p], own.log_odds, evidence)
        for k in range(POINTS):
            if isnan(evidence[k]) and fabs(own.log_odds[k]) < FORGOTTEN:
                own.log_odds[k] = NAN
        for k in range(FEET):
            own.standing[k] = 1 / (1 + exp(-fmax(own.log_odds[2 * k], own.log_odds[2 * k + 1])))


def advance(
    double[:, :] footings, Vector times, Vector noise, double[:, :, ::1] core, Stack feet,
    const long long[:, ::1] legs, Rows ahead=None,
):
    """Overwrite the cores (P, 15, 3) m of people by those with the displacements that the frames so far give.

    Where the root is too far away for a person to have moved there, or what was found is not finite, all begins anew.
    A frame that is not newer than the last changes nothing, and if it is the last, it has its core.

    `footings` (P, N), each a `Memory`, are overwritten, all but the odds; `times` (P,) s; noise
    (P,) m, of the image at the body; feet (P, 4, 3) m about their ankles; `ahead` (P, 2) as of `add_frame`.
    """
    cdef Memory* own
    cdef Model model
    cdef double[ALL * ALL] a
    cdef double[ALL] b, u
    cdef double[TWO] estimate
    cdef double[3] root
    cdef double[POINTS * 3] points
    cdef double[FEET * 3] tilts
    cdef double[POINTS] contact
    cdef double squared, known, step_s
    cdef Py_ssize_t p
    cdef int i
    for p in range(footings.shape[0]):
        own, squared, known = <Memory*> &footings[p, 0], 0, 0
        if times[p] <= own.time_s:
            if times[p] == own.time_s:
                memcpy(&core[p, 0, 0], own.core, sizeof(own.core))
            continue
        model = choose_model(rint(1e4 * noise[p]) / 1e4, True)  # by steps of 0.1 mm
        step_s = 1.0 if isnan(own.time_s) else fmax(times[p] - own.time_s, MIN_STEP_S)
        find_points(core[p], feet[p], legs, root, points, tilts)
        for i in range(3):
            squared += (root[i] - own.root[i]) * (root[i] - own.root[i])
        for i in range(TWO):
            known += own.found[i]
        if not (isfinite(known) and sqrt(squared) <= MAX_DEPTH_CHANGE * fabs(root[2]) + MAX_SPEED_M_S * step_s):
            memset(own.found, 0, sizeof(Memory) - (<char*> own.found - <char*> own))
        for i in range(POINTS):
            contact[i] = 0 if isnan(own.log_odds[i]) else 1 / (1 + exp(-own.log_odds[i]))
        if own.frames > 1:
            foresee(own, step_s, root, estimate)
        add_frame(own, &model, step_s, root, points, tilts, contact, estimate if own.frames > 1 else NULL,
                  NULL if ahead is None else &ahead[p, 0], a, b)
        eliminate(a, b, own)
        substitute(a, b, OWN, ALL, u)
        memcpy(own.found, u + OWN, TWO * sizeof(double))
        remember(own, step_s, root, points, contact)
        displace(core[p], legs, u + TWO)
        memcpy(own.core, &core[p, 0, 0], sizeof(own.core))
        own.time_s = times[p]


def smooth(
    double noise, Vector times, Stack core, Stack feet, Rows contact, const long long[:, ::1] legs, int rounds,
    Rows ahead=None,
):
    """Return the cores (F, J, 3) m of a sequence with the displacements that all frames give; else as `advance`."""
    cdef Py_ssize_t frames = core.shape[0], t, n
    cdef Model model = choose_model(noise, False)
    cdef double step_s
    cdef double[ALL] u
    result, unknowns = np.array(core), np.zeros((frames + 2, OWN))
    cdef double[:, :, ::1] out = result, factors = np.empty((frames, ALL, ALL))
    cdef double[:, ::1] rights = np.empty((frames, ALL)), found = unknowns, roots = np.empty((frames, 3))
    cdef double[:, ::1] points = np.empty((frames, POINTS * 3)), tilts = np.empty((frames, FEET * 3))
    cdef Memory memory
    for t in range(frames):
        find_points(out[t], feet[t], legs, &roots[t, 0], &points[t, 0], &tilts[t, 0])
    with nogil:
        for n in range(rounds):
            memset(&memory, 0, sizeof(Memory))
            for t in range(frames):
                step_s = fmax(times[t] - times[t - 1], MIN_STEP_S) if t > 0 else 1
                add_frame(
                    &memory, &model, step_s, &roots[t, 0], &points[t, 0], &tilts[t, 0], &contact[t, 0],
                    &found[t + 1, 0] if n > 0 else NULL, NULL if ahead is None else &ahead[t, 0],
                    &factors[t, 0, 0], &rights[t, 0],
                )
                eliminate(&factors[t, 0, 0], &rights[t, 0], &memory)
                remember(&memory, step_s, &roots[t, 0], &points[t, 0], &contact[t, 0])
            substitute(&factors[frames - 1, 0, 0], &rights[frames - 1, 0], OWN, ALL, u)
            memcpy(&found[frames, 0], u + OWN, TWO * sizeof(double))
            for t in range(frames - 1, -1, -1):
                memcpy(u + OWN, &found[t + 1, 0], TWO * sizeof(double))
                substitute(&factors[t, 0, 0], &rights[t, 0], 0, OWN, u)
                memcpy(&found[t, 0], u, OWN * sizeof(double))
    for t in range(frames):
        displace(out[t], legs, &found[t + 2, 0])
    return result
