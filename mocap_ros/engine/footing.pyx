# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Roots that have inertia and feet that stand: the least squares of `solvers.footing`, frame by frame.

The unknowns of a frame are u = (c, a_left, a_right), 9 numbers: displacements of the whole body and of both feet in
the real camera's axes. Terms couple a frame with the two before it. With all terms up to frame t added, the unknowns
of frame t - 2 are eliminated, which leaves a matrix (18, 18) and a right side (18,) of frames t - 1 and t. Its
solution is the estimate of frame t from its past; a sequence is then substituted backwards.
"""

from libc.math cimport INFINITY, NAN, atanh, exp, fabs, fmax, fmin, isfinite, sqrt, tanh
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.geometry cimport Indices, Rows, Stack, Vector, dot


cdef enum:
    OWN = 9  # unknowns of a frame
    TWO = 18
    ALL = 27
    FEET = 2
    POINTS = 4  # left heel, left toe, right heel, right toe
    HIP = 0  # of a leg, in `legs` (2, 3)
    KNEE = 1
    ANKLE = 2

cdef double BASE_STEP_S = 1.0 / 30  # s; for which deviations of accelerations are given
cdef double MIN_STEP_S = 1e-3
cdef double MIN_INFORMATION = 1e-9  # 1/m^2; keeps what nothing determines solvable
cdef double MAX_DEPTH_CHANGE = 0.3  # of the depth; a root that changes by more is another solution, or another person
cdef double MAX_SPEED_M_S = 10  # m/s; of a sprinter
cdef double FAR_M = 5  # m; beyond it the root's error along the line of sight grows with the distance
cdef double MIN_LENGTH_M = 1e-6  # m; guards divisions by lengths
cdef double MIN_TILT_M = 0.01  # m; legs along the line of sight do not tilt
cdef double MAX_REACH = 0.9999  # of the length of a leg; a straight knee has no direction in which it bends


cdef struct Memory:
    # What is kept of the frames before; it lies in an array of doubles.
    double matrix[TWO * TWO]  # lower triangle, frames t - 1 and t
    double right[TWO]
    double found[TWO]  # unknowns of frames t - 1 and t
    double root[3]  # m, of frame t
    double velocity[3]  # m/s, from frame t - 1 to t
    double points[POINTS * 3]  # m
    double contact[POINTS]
    double step_s  # from frame t - 1 to t
    double frames  # number so far, at most 2


cdef struct Model:
    double along, across  # m; deviations of the root's error along the line of sight and across it
    double error_s, leg_s  # s; how long errors of the root and of legs last
    double acceleration_along, acceleration_across  # m/s^2
    double leg_tilt, leg_across  # m; deviations of a foot's error about the root: as legs tilt in depth, and across it
    double slip  # m/s; deviation of the speed of a point that stands
    double pace  # m/s; of a root whose deviation of accelerations is sqrt(2) of what it is at rest
    double roll  # 1; share of the root's velocity that a point has while it stands
    double fast  # m/s; a point that is faster hardly stands: c of Cauchy's loss, four times as much without estimate


cdef void add_term(double* a, double* b, int count, const int* at, const double* by, const double* m, const double* r) noexcept nogil:
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
    const double* tilts, const double* contact, const double* estimate, double* a, double* b,
) noexcept nogil:
    """Write the normal equations A (27, 27), b (27,) of the frames t - 2, t - 1 and t.

    `estimate` (18,) are the unknowns of the frames t - 1 and t as last found, NULL if none are.
    """
    cdef int i, j, k, f
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
    write_precision(sight, h * model.along * fmax(distance / FAR_M, 1.0), h * model.across, m)
    add_term(a, b, 2, at, by, m, r)
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
    reach = fmin(fmax(reach, 1.0001 * fabs(thigh - shank)), MAX_REACH * (thigh + shank))
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


cdef Model read_model(Vector numbers):
    cdef Model model
    memcpy(&model, &numbers[0], sizeof(Model))
    return model


def follow_contacts(
    Vector log_odds, Vector times, const double[:, :, :] rays, const double[:, :] weight,
    const double[:, :, :] other_rays, const double[:, :] other_weight, const double[:, :, :] core,
    double[:, :, :] feet, const double[:, :] upward, const long long[:, ::1] legs, Indices others, Vector numbers,
):
    """Return log f and e of `solvers.contacts`, both (N, 4); e is NaN where too little is seen.

    They are of the newest N frames of a window, `log_odds` (4,) of the frame before these; rays, scores and times (F,)
    of the window, `other_rays` those of the extremities; core (N, J, 3) m, and feet (N, 4, 3) m about their ankles,
    which are set to 0 where the window has only the ankles; numbers V, H, B, D, E, T, the longest step in s,
    and how far lines reach to both sides in s.
    """
    cdef Py_ssize_t frames = times.shape[0], known = core.shape[0], first = frames - known, n, t, s, k, i, at, start, count
    cdef double step_s, reach_s, ago, sum_1, sum_2, x, y, sum_x, sum_y, speed, height, lowest
    cdef double[4] odds, heights, depths
    cdef bint[4] is_ankle
    cdef const double[:, :, :] seen
    cdef const double[:, :] score
    found = np.empty((2, known, POINTS))
    cdef double[:, :, ::1] out = found
    for k in range(POINTS):
        odds[k], is_ankle[k] = log_odds[k] if isfinite(log_odds[k]) else 0.0, True
        for t in range(frames if other_weight.shape[1] > others[k] else 0):
            is_ankle[k] = is_ankle[k] and not other_weight[t, others[k]] > 0
    for n in range(known):
        t, start, lowest, step_s = first + n, max(first + n - 4, 0), INFINITY, numbers[6]
        count = min(start + 4, frames - 1) - start
        reach_s = numbers[7]
        if count > 0:
            reach_s = fmax(reach_s, 2.5 * (times[start + count] - times[start]) / count)
            step_s = fmin(step_s, times[max(t, 1)] - times[max(t, 1) - 1])
        for k in range(POINTS):
            at, height = legs[k // 2, ANKLE], 0
            for i in range(3):
                height += upward[n, i] * (core[n, at, i] + feet[n, k, i])
            heights[k], depths[k], lowest = height, core[n, at, 2] + feet[n, k, 2], fmin(lowest, height)
        for k in range(POINTS):
            if is_ankle[k]:
                seen, score, at = rays, weight, legs[k // 2, ANKLE]
                feet[n, k, 0], feet[n, k, 1], feet[n, k, 2] = 0, 0, 0
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
            odds[k] = 2 * atanh(exp(-(times[t] - times[t - 1] if t > 0 else step_s) / numbers[5]) * tanh(odds[k] / 2))
            out[1, n, k] = NAN
            if count >= 3 and score[t, at] > 0 and isfinite(depths[k]):
                sum_2 = count * sum_2 - sum_1 * sum_1
                x, y = (count * x - sum_1 * sum_x) / sum_2, (count * y - sum_1 * sum_y) / sum_2
                speed = depths[k] * sqrt(x * x + y * y) / numbers[0]
                height = (heights[k] - lowest) / numbers[1] if isfinite(lowest) else 0
                out[1, n, k] = score[t, at] * step_s / numbers[4] * fmax(
                    numbers[2] - speed * speed - height * height, -numbers[3]
                )
                odds[k] += out[1, n, k]
            out[0, n, k] = odds[k]
    return found


def begin():
    """Return the memory of a person of whom no frame is known."""
    return np.zeros(sizeof(Memory) // sizeof(double))


def advance(double[::1] memory, Vector numbers, double step_s, Rows core, Rows feet, Vector log_odds, const long long[:, ::1] legs):
    """Return the core (J, 3) m of the next frame with the displacements that the frames so far give.

    Where the root is too far away for a person to have moved there, or what was found is not finite, all begins anew.

    `memory` of the frames before is overwritten; `numbers` are the fields of `Model`; `step_s` since the frame before;
    feet (4, 3) m about their ankles, and the logarithms (4,) of the odds that they stand.
    """
    cdef Memory* own = <Memory*> &memory[0]
    cdef Model model = read_model(numbers)
    cdef double[ALL * ALL] a
    cdef double[ALL] b, u
    cdef double[TWO] estimate
    cdef double[3] root
    cdef double[POINTS * 3] points
    cdef double[FEET * 3] tilts
    cdef double[POINTS] contact
    cdef double squared = 0, known = 0
    cdef int i
    result = np.array(core)
    cdef double[:, ::1] out = result
    step_s = fmax(step_s, MIN_STEP_S)
    find_points(out, feet, legs, root, points, tilts)
    for i in range(3):
        squared += (root[i] - own.root[i]) * (root[i] - own.root[i])
    for i in range(TWO):
        known += own.found[i]
    if not (isfinite(known) and sqrt(squared) <= MAX_DEPTH_CHANGE * fabs(root[2]) + MAX_SPEED_M_S * step_s):
        memset(own, 0, sizeof(Memory))
    for i in range(POINTS):
        contact[i] = 1 / (1 + exp(-log_odds[i]))
    if own.frames > 1:
        foresee(own, step_s, root, estimate)
    add_frame(own, &model, step_s, root, points, tilts, contact, estimate if own.frames > 1 else NULL, a, b)
    eliminate(a, b, own)
    substitute(a, b, OWN, ALL, u)
    memcpy(own.found, u + OWN, TWO * sizeof(double))
    remember(own, step_s, root, points, contact)
    displace(out, legs, u + TWO)
    return result


def smooth(Vector numbers, Vector times, Stack core, Stack feet, Rows contact, const long long[:, ::1] legs, int rounds):
    """Return the cores (F, J, 3) m of a sequence with the displacements that all frames give; else as `advance`."""
    cdef Py_ssize_t frames = core.shape[0], t, n
    cdef Model model = read_model(numbers)
    cdef double step_s
    cdef double[ALL] b, u
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
                    &found[t + 1, 0] if n > 0 else NULL, &factors[t, 0, 0], &rights[t, 0],
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
