# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""The vertical of a camera, and lifted poses turned towards it; the formulas are in `solvers.vertical`.

Sizes: P people in a frame, F frames, J joints, J_c of the core, which come first.
"""

from libc.math cimport NAN, acos, atan2, cos, isfinite, sin, sqrt

import numpy as np

from mocap_ros.engine.geometry cimport Rows, Stack, Vector, dot


cdef double DEGREE = 3.14159265358979323846 / 180
cdef double LEAN_PER_DEPTH = 0.36  # KAPPA: share of the depths' errors that is a lean of the whole body
cdef double BALANCE_STD_DEG = 4.0  # s_u
cdef double MAX_TURN_DEG = 20.0  # C: a larger angle is rather a person who does not stand


cdef inline double fall(double value, double first, double last) noexcept nogil:
    """A share that falls from 1 to 0 as a value goes from `first` to `last`."""
    return min(max((last - value) / (last - first), 0.0), 1.0)


def add_frame(
    Vector direction, sums, double faded, double step_s, double sign,
    double level_deg, double last_level_deg, double outlier_deg, double min_standing, Rows upward, Vector standing,
    Vector shown,
):
    """Return the new direction (3,) and the new sums of seconds, those of `solvers.vertical.Sums`.

    `direction` (3,) and `sums` of the frame before, of which a share `faded` counts; `step_s` s, dt of the new frame;
    `sign` 1, or -1 where the camera is upside down; degrees `LEVEL_DEG` and A, and L; u (P, 3) and p (P,), not yet
    multiplied, and the shares (P,) to which hips and knees are seen.
    """
    cdef Py_ssize_t p, i
    cdef double angle, discounted, share, norm, level, stands, weight, certain, seen, upright, askew
    weight, certain, seen, upright, askew = [faded * seconds for seconds in sums]
    result = np.array(direction)
    cdef double[::1] out = result
    for i in range(3):
        out[i] *= weight
    for p in range(upward.shape[0]):
        level = fall(acos(min(max(-sign * upward[p, 1], -1.0), 1.0)) / DEGREE, level_deg, last_level_deg)
        stands = standing[p] * level
        seen += step_s
        askew += step_s * (standing[p] - stands)
        stands *= shown[p]
        upright += step_s * stands
        angle = acos(min(max(dot(&direction[0], &upward[p, 0]), -1.0), 1.0)) / (outlier_deg * DEGREE)
        discounted = step_s / (1 + angle * angle)
        if level == 0 or not (discounted >= 0 and stands >= 0):  # not known
            continue
        share = discounted * max(stands, min_standing)
        weight += share
        certain += discounted * stands
        for i in range(3):
            out[i] += share * upward[p, i]
    norm = sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    for i in range(3):
        out[i] = out[i] / norm if norm > 0 else direction[i]
    return result, weight, certain, seen, upright, askew


cdef inline void normalise(double* v) noexcept nogil:
    cdef double length = max(sqrt(dot(v, v)), 1e-300)
    v[0], v[1], v[2] = v[0] / length, v[1] / length, v[2] / length


def judge(
    Rows found, Rows sums, double sign, bint is_turned, double level_pitch_deg, double shrinkage,
    double standing_share, double usual_deg, double body_deg, double second_deg, double max_deg, double askew_deg,
):
    """Return verticals (N, 3) and their standard deviations (N,) in rad.

    By v_t (N, 3), of any length, and `Sums` (N, 5) in s; `sign` -1 where the camera is upside down; `is_turned`
    whether q is 1; then the pitch of v_0, K, `STANDING_SHARE`, A_0, B, S, and the two of v_0, in degrees.
    """
    cdef Py_ssize_t n
    cdef int i
    cdef double seen, r, own, beyond, prior
    cdef double[3] level, v
    level[0], level[1] = 0, -sign * cos(level_pitch_deg * DEGREE)
    level[2] = -sin(level_pitch_deg * DEGREE)
    direction, std = np.empty((found.shape[0], 3)), np.empty(found.shape[0])
    cdef double[:, ::1] out = direction
    cdef double[::1] deviation = std
    for n in range(found.shape[0]):
        v[0], v[1], v[2] = found[n, 0], found[n, 1], found[n, 2]
        normalise(v)
        for i in range(1, 3):
            v[i] += shrinkage * (v[i] - level[i])
        normalise(v)
        seen = max(sums[n, 2], 1e-12)
        r = min(max(1 - sums[n, 3] / (standing_share * seen), 0.0), 1.0)
        own = sqrt((body_deg * body_deg * sums[n, 3] + second_deg * second_deg) / max(sums[n, 1], 1e-9))
        own = min(own, max_deg)
        beyond = max(acos(min(max(dot(v, level), -1.0), 1.0)) / DEGREE - usual_deg, 0.0)
        prior = max_deg + (askew_deg - max_deg) * (1.0 if is_turned else sums[n, 4] / seen)
        deviation[n] = ((1 - r) * sqrt(own * own + beyond * beyond) + r * prior) * DEGREE
        for i in range(3):
            v[i] = (1 - r) * v[i] + r * level[i]
        normalise(v)
        out[n, 0], out[n, 1], out[n, 2] = v[0], v[1], v[2]
    return direction, std


def turn_poses(
    Stack joints, Stack std, Stack cameras, Rows upward, Vector standing, Rows vertical, Vector vertical_std,
    Py_ssize_t core, double level_deg, double last_level_deg,
):
    """Return poses (F, J, 3) turned towards the vertical about the horizontal axes of their virtual cameras.

    `std` (F, J, 3); `cameras` (F, 3, 3) rotations to the axes of the poses from those of u (F, 3) and v, (F, 3) or
    (1, 3) for all; s_v (F,) or (1,) rad; p (F,), which falls to 0 with the angle between u and v.
    """
    cdef Py_ssize_t t, j, s
    cdef double angle, spread, radius, lean, turn, cosine, sine, stands
    cdef double[3] u, v
    result = np.array(joints)
    cdef double[:, :, ::1] out = result
    for t in range(joints.shape[0]):
        s = min(t, vertical.shape[0] - 1)
        for j in range(3):
            u[j], v[j] = dot(&cameras[t, j, 0], &upward[t, 0]), dot(&cameras[t, j, 0], &vertical[s, 0])
        angle = atan2(u[1] * v[2] - u[2] * v[1], u[1] * v[1] + u[2] * v[2])
        spread = radius = 0
        for j in range(core):
            spread += std[t, j, 2] * std[t, j, 2]
            radius += joints[t, j, 1] * joints[t, j, 1] + joints[t, j, 2] * joints[t, j, 2]
        lean = LEAN_PER_DEPTH * LEAN_PER_DEPTH * spread / max(radius, 1e-300)
        spread = lean + (BALANCE_STD_DEG * DEGREE) * (BALANCE_STD_DEG * DEGREE) + vertical_std[s] * vertical_std[s]
        turn = angle / (MAX_TURN_DEG * DEGREE)
        stands = acos(min(max(dot(u, v), -1.0), 1.0)) / DEGREE
        stands = standing[t] * fall(stands, level_deg, last_level_deg)
        turn = stands * lean / spread * angle / (1 + turn * turn)
        if not isfinite(turn):
            continue
        cosine, sine = cos(turn), sin(turn)
        for j in range(joints.shape[1]):
            out[t, j, 1] = cosine * joints[t, j, 1] - sine * joints[t, j, 2]
            out[t, j, 2] = sine * joints[t, j, 1] + cosine * joints[t, j, 2]
    return result


cdef inline void subtract(const double[:, ::1] pose, Py_ssize_t a, Py_ssize_t b, double* out) noexcept nogil:
    out[0], out[1], out[2] = pose[a, 0] - pose[b, 0], pose[a, 1] - pose[b, 1], pose[a, 2] - pose[b, 2]


def find_stances(
    Stack joints, Stack cameras, Vector masses, const long long[:, ::1] sides, const long long[::1] hands,
    Py_ssize_t neck, Py_ssize_t pelvis, Py_ssize_t head, double support_ahead, double hanging_share,
    double standing_deg, double seated_deg, double min_length,
):
    """Return the directions upwards (N, 3) that poses (N, J, 3) show, and the shares (N,) to which they stand.

    The formulas, with b, H, PHI_0 and PHI_1, are in `models.upward_direction`. `cameras` (N, 3, 3), or (1, 3, 3) for
    all, rotations to the axes of the poses from those of the directions; `masses` (J_c,); `sides` (2, 4) left and right
    shoulder, hip, knee and ankle; `hands` (2,) the wrists.
    """
    cdef Py_ssize_t n, j, s
    cdef int i, over
    cdef double size, length, cosine, of_knee, straighter = 0
    cdef double[3] lever, bone, across, ahead, hips, trunk, thigh, shank
    upward, standing = np.empty((joints.shape[0], 3)), np.empty(joints.shape[0])
    cdef double[:, ::1] out = upward
    cdef double[::1] share = standing
    for n in range(joints.shape[0]):
        for i in range(3):
            lever[i] = -(joints[n, sides[0, 3], i] + joints[n, sides[1, 3], i]) / 2
            for j in range(masses.shape[0]):
                lever[i] += masses[j] * joints[n, j, i]
        subtract(joints[n], neck, pelvis, trunk)
        size = sqrt(dot(trunk, trunk))
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
        s = min(n, cameras.shape[0] - 1)
        for i in range(3):
            out[n, i] = 0
            for j in range(3):
                out[n, i] += lever[j] / length * cameras[s, j, i]
        over = 0
        for s in range(2):
            subtract(joints[n], hands[s], head, bone)
            over += dot(bone, trunk) > hanging_share * dot(trunk, trunk)
            subtract(joints[n], sides[s, 1], sides[s, 2], thigh)
            subtract(joints[n], sides[s, 2], sides[s, 3], shank)
            cosine = dot(trunk, thigh) / max(sqrt(dot(trunk, trunk)) * sqrt(dot(thigh, thigh)), min_length)
            of_knee = dot(thigh, shank) / max(sqrt(dot(thigh, thigh)) * sqrt(dot(shank, shank)), min_length)
            cosine = of_knee if of_knee < cosine else cosine
            straighter = cosine if s == 0 or not cosine <= straighter else straighter  # NaN stays
        share[n] = NAN
        if straighter == straighter:
            share[n] = fall(acos(min(max(straighter, -1.0), 1.0)) / DEGREE, standing_deg, seated_deg) * (over < 2)
    return upward, standing
