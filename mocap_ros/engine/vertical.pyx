# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""The vertical of a camera, and lifted poses turned towards it; the formulas are in `solvers.vertical`.

Sizes: P people in a frame, F frames, J joints, J_c of the core, which come first.
"""

from libc.math cimport NAN, acos, atan2, cos, exp, isfinite, sin, sqrt

import numpy as np

from mocap_ros.engine.geometry cimport dot

ctypedef const double[::1] Vector
ctypedef const double[:, ::1] Rows
ctypedef const double[:, :, ::1] Stack

cdef extern from *:
    """
    #define DEGREE (3.14159265358979323846 / 180)
    #define MEMORY_S 20.0       /* T: long for people who turn about, short enough for a camera that is moved */
    #define OUTLIER_DEG 10.0    /* A: who lies or tumbles does not show the vertical */
    #define MIN_STANDING 0.02   /* P: where no person stands, a vertical is better than none */
    #define LEAN_PER_DEPTH 0.36 /* KAPPA: share of the depths' errors that is a lean of the whole body */
    #define BALANCE_STD_DEG 6.0 /* s_u */
    #define MAX_TURN_DEG 20.0   /* B: a larger angle is rather a person who does not stand */
    #define ROBUST_ROUNDS 4     /* rounds of weights and means of a whole sequence; more change nothing */
    """
    const double DEGREE, MEMORY_S, OUTLIER_DEG, MIN_STANDING, LEAN_PER_DEPTH, BALANCE_STD_DEG, MAX_TURN_DEG
    const int ROBUST_ROUNDS


cdef double discount(const double* direction, const double* upward) noexcept nogil:
    """1 / (1 + (angle / A)^2) of the angle between two directions."""
    cdef double angle = acos(min(max(dot(direction, upward), -1.0), 1.0)) / (OUTLIER_DEG * DEGREE)
    return 1 / (1 + angle * angle)


cdef inline double fall(double value, double first, double last) noexcept nogil:
    """A share that falls from 1 to 0 as a value goes from `first` to `last`."""
    return min(max((last - value) / (last - first), 0.0), 1.0)


def add_frame(
    Vector direction, double weight, double step_s, double sign, double level_deg, double last_level_deg, Rows upward,
    Vector standing,
):
    """Return the new direction (3,), and what the frame adds: weight, seconds, people who stand and who are askew.

    `direction` (3,) of the frame before; `weight` s, that it has now; `step_s` s, time that the new frame stands
    for; `sign` 1, or -1 where the camera is upside down; `level_deg` up to this angle to up in the image, people
    stand as before a level camera; `last_level_deg` from this angle on, they do not; `upward` (P, 3) directions of
    the new frame; `standing` (P,) shares to which these people have straight hips.
    """
    cdef Py_ssize_t p, i
    cdef double discounted, share, norm, level, stands, added = 0, seconds = 0, upright = 0, askew = 0
    result = np.array(direction)
    cdef double[::1] out = result
    for i in range(3):
        out[i] *= weight
    for p in range(upward.shape[0]):
        level = fall(acos(min(max(-sign * upward[p, 1], -1.0), 1.0)) / DEGREE, level_deg, last_level_deg)
        stands = standing[p] * level
        upright += stands
        askew += standing[p] - stands
        discounted = step_s * discount(&direction[0], &upward[p, 0])
        if level == 0 or not (discounted >= 0 and stands >= 0):  # not known
            continue
        share = discounted * max(stands, MIN_STANDING)
        added += share
        seconds += discounted * stands
        for i in range(3):
            out[i] += share * upward[p, i]
    norm = sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    for i in range(3):
        out[i] = out[i] / norm if norm > 0 else direction[i]
    return result, added, seconds, upright, askew


def find_sequence(Vector times, Rows upward, Vector weight, Vector standing):
    """Return the directions (F, 3) and the seconds (F,) of a whole sequence.

    `times` (F,) s, increasing; `upward` (F, 3) directions that poses show; `weight` (F,) s, time that each frame
    stands for, 0 where it shows nothing; `standing` (F,) shares to which the poses stand.
    """
    cdef Py_ssize_t t, i, frames = times.shape[0]
    cdef int round_
    cdef double kept, norm, counted
    cdef double[4] total
    found = np.empty((frames, 3)), np.empty(frames)
    cdef double[:, ::1] directions = found[0]
    cdef double[::1] seconds = found[1], robust = np.array(weight)
    for round_ in range(ROBUST_ROUNDS):
        total = [0, 0, 0, 0]
        for t in range(frames):  # frames before t and itself
            kept = exp((times[t - 1] - times[t]) / MEMORY_S) if t > 0 else 0.0
            counted = max(standing[t], MIN_STANDING) * robust[t]
            for i in range(3):
                total[i] = kept * total[i] + counted * upward[t, i]
                directions[t, i] = total[i]
            total[3] = kept * total[3] + standing[t] * robust[t]
            seconds[t] = total[3]
        total = [0, 0, 0, 0]
        for t in range(frames - 2, -1, -1):  # frames after t
            kept = exp((times[t] - times[t + 1]) / MEMORY_S)
            counted = max(standing[t + 1], MIN_STANDING) * robust[t + 1]
            for i in range(3):
                total[i] = kept * (total[i] + counted * upward[t + 1, i])
                directions[t, i] += total[i]
            total[3] = kept * (total[3] + standing[t + 1] * robust[t + 1])
            seconds[t] += total[3]
        for t in range(frames):
            norm = 0
            for i in range(3):
                norm += directions[t, i] * directions[t, i]
            norm = max(sqrt(norm), 1e-300)
            for i in range(3):
                directions[t, i] /= norm
            robust[t] = weight[t] * discount(&directions[t, 0], &upward[t, 0])
    return found


def turn_poses(
    Stack joints, Stack std, Rows upward, Rows vertical, Vector vertical_std, Vector standing, Py_ssize_t core
):
    """Return poses (F, J, 3) turned towards the vertical about the horizontal axes of their virtual cameras.

    `joints` (F, J, 3) lifted poses; `std` (F, J, 3) their deviations; `upward` (F, 3) directions upwards that they
    show; `vertical` (F, 3) in the same axes; `vertical_std` (F,) rad; `standing` (F,) shares to which they stand;
    `core` J_c.
    """
    cdef Py_ssize_t t, j
    cdef double angle, spread, radius, lean, turn, cosine, sine
    result = np.array(joints)
    cdef double[:, :, ::1] out = result
    for t in range(joints.shape[0]):
        angle = atan2(
            upward[t, 1] * vertical[t, 2] - upward[t, 2] * vertical[t, 1],
            upward[t, 1] * vertical[t, 1] + upward[t, 2] * vertical[t, 2],
        )
        spread = radius = 0
        for j in range(core):
            spread += std[t, j, 2] * std[t, j, 2]
            radius += joints[t, j, 1] * joints[t, j, 1] + joints[t, j, 2] * joints[t, j, 2]
        lean = LEAN_PER_DEPTH * LEAN_PER_DEPTH * spread / max(radius, 1e-300)
        spread = lean + (BALANCE_STD_DEG * DEGREE) * (BALANCE_STD_DEG * DEGREE) + vertical_std[t] * vertical_std[t]
        turn = angle / (MAX_TURN_DEG * DEGREE)
        turn = standing[t] * lean / spread * angle / (1 + turn * turn)
        if not isfinite(turn):
            continue
        cosine, sine = cos(turn), sin(turn)
        for j in range(joints.shape[1]):
            out[t, j, 1] = cosine * joints[t, j, 1] - sine * joints[t, j, 2]
            out[t, j, 2] = sine * joints[t, j, 1] + cosine * joints[t, j, 2]
    return result


cdef inline void subtract(const double[:, ::1] pose, Py_ssize_t a, Py_ssize_t b, double* out) noexcept nogil:
    out[0], out[1], out[2] = pose[a, 0] - pose[b, 0], pose[a, 1] - pose[b, 1], pose[a, 2] - pose[b, 2]


def find_upward(Stack joints, Vector masses, const long long[:, ::1] sides, Py_ssize_t neck, Py_ssize_t pelvis,
                double support_ahead, double min_length):
    """Return the directions upwards (N, 3) that poses (N, J, 3) show; the formula is in `models.upward_direction`.

    `joints` poses in any unit; `masses` (J_c,) shares of the body's mass; `sides` (2, 4) left and right shoulder,
    hip, knee and ankle; `neck`, `pelvis` index of the joint; `support_ahead` b; `min_length` guards divisions by
    lengths.
    """
    cdef Py_ssize_t n, j, s
    cdef int i
    cdef double size, length
    cdef double[3] lever, bone, across, ahead, hips
    result = np.empty((joints.shape[0], 3))
    cdef double[:, ::1] out = result
    for n in range(joints.shape[0]):
        for i in range(3):
            lever[i] = -(joints[n, sides[0, 3], i] + joints[n, sides[1, 3], i]) / 2
            for j in range(masses.shape[0]):
                lever[i] += masses[j] * joints[n, j, i]
        subtract(joints[n], neck, pelvis, bone)
        size = sqrt(dot(bone, bone))
        for s in range(2):
            for j in range(1, 3):
                subtract(joints[n], sides[s, j], sides[s, j + 1], bone)
                size += sqrt(dot(bone, bone)) / 2
        subtract(joints[n], sides[0, 1], sides[1, 1], hips)
        subtract(joints[n], sides[0, 0], sides[1, 0], across)
        for i in range(3):
            across[i] += hips[i]
        for i in range(3):
            ahead[i] = across[(i + 1) % 3] * lever[(i + 2) % 3] - across[(i + 2) % 3] * lever[(i + 1) % 3]
        length = support_ahead * size / max(sqrt(dot(ahead, ahead)), min_length)
        for i in range(3):
            lever[i] -= length * ahead[i]
        length = max(sqrt(dot(lever, lever)), min_length)
        for i in range(3):
            out[n, i] = lever[i] / length
    return result


def find_standing(
    Stack joints, const long long[:, ::1] sides, Py_ssize_t neck, Py_ssize_t pelvis, double min_length,
    double standing_deg, double seated_deg,
):
    """Return the shares (N,) to which poses stand.

    `joints`, `sides`, `neck`, `pelvis`, `min_length` as of `find_upward`; `standing_deg` who has a leg whose hip and
    knee are bent by no more stands; `seated_deg` who has in both legs one that is bent by more does not.
    """
    cdef Py_ssize_t n, s
    cdef double[3] trunk, thigh, shank
    cdef double cosine, of_knee, straighter = 0
    result = np.empty(joints.shape[0])
    cdef double[::1] out = result
    for n in range(joints.shape[0]):
        subtract(joints[n], neck, pelvis, trunk)
        for s in range(2):
            subtract(joints[n], sides[s, 1], sides[s, 2], thigh)
            subtract(joints[n], sides[s, 2], sides[s, 3], shank)
            cosine = dot(trunk, thigh) / max(sqrt(dot(trunk, trunk)) * sqrt(dot(thigh, thigh)), min_length)
            of_knee = dot(thigh, shank) / max(sqrt(dot(thigh, thigh)) * sqrt(dot(shank, shank)), min_length)
            cosine = of_knee if of_knee < cosine else cosine
            straighter = cosine if s == 0 or not cosine <= straighter else straighter  # NaN stays
        out[n] = NAN
        if straighter == straighter:
            out[n] = fall(acos(min(max(straighter, -1.0), 1.0)) / DEGREE, standing_deg, seated_deg)
    return result
