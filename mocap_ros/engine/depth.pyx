# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Which measured depths are those of a person's joints, and how far away the person is: formulas in `solvers.depth`."""

from libc.math cimport INFINITY, M_PI, exp, hypot, isfinite, log, sqrt

import numpy as np

from mocap_ros.engine.geometry cimport Rows, Stack, Vector, square


cdef enum:
    CORE = 15  # joints
    ROUNDS = 4  # in which the distance settles

cdef double NOISE_M = 0.04  # m; N_0, of the surface about a joint, by clothes, postures and points beside the joint
cdef double STEREO = 0.00125  # 1/m; N_1, a stereo camera's: 2 cm at 4 m
cdef double VISIBLE = 0.5  # 1; Q: detectors' points lie beside limbs, on other parts of the body and on furniture
cdef double HIDDEN = 0.01  # 1; Q of a joint that has another part of the body before it
cdef double OTHER_M = 0.7  # m; W, range of the depths of what is no surface of the joint
cdef double BEFORE_M = 0.05  # m; a part of the body that is nearer by this hides a joint
cdef double LEAST_LENGTH = 1e-6  # guards divisions


cdef double find_front(const double* point, const double* a, const double* b, double radius) noexcept nogil:
    """Depth at which the line of sight through a point (3,) meets the capsule from a to b; infinite if it does not."""
    cdef double x = b[0] - a[0], y = b[1] - a[1], u, squared = x * x + y * y
    if squared < LEAST_LENGTH:
        u = 0 if a[2] < b[2] else 1
    else:
        u = ((point[0] - a[0]) * x + (point[1] - a[1]) * y) / squared
        u = 0 if u < 0 else 1 if u > 1 else u
    x, y = a[0] + u * x - point[0], a[1] + u * y - point[1]
    squared = radius * radius - x * x - y * y
    return a[2] + u * (b[2] - a[2]) - sqrt(squared) if squared > 0 else INFINITY


cdef double compute_density(double error, double std) noexcept nogil:
    return exp(-square(error / std) / 2) / (std * sqrt(2 * M_PI))


def measure_depths(
    Rows surface, Stack rays, Rows axes, Stack poses, Rows std, Vector expected, double prior, Rows thickness,
    const long long[:, ::1] segments, Vector radii,
):
    """Return distances (N,) m, their variances (N,) m^2, and of each joint deviation, trust and noise (N, 15).

    surface (N, 15) m along the optical axis, NaN where unknown; rays (N, 15, 2) of the joints; axes (N, 3) of the
    virtual cameras; poses (N, 15, 3) in their axes and std (N, 15) along them, in units of the distance;
    expected (N,) m distances, with the deviation `prior` as a share; thickness (N, 15) m from surface to joint;
    segments (S, 2) of the body with radii (S,) m.
    """
    cdef Py_ssize_t n, j, s, c, k, count = surface.shape[0]
    cdef double z0, best, total, distance, weight, sums, front, density, other, error, information
    cdef double[CORE] z, deep, noise, share
    cdef double[CORE * 3] body
    distances, variances = np.empty(count), np.empty(count)
    deviations, trusts, noises = np.zeros((count, CORE)), np.zeros((count, CORE)), np.ones((count, CORE))
    cdef double[::1] out_distance = distances, out_variance = variances
    cdef double[:, ::1] deviation = deviations, trust = trusts, relative = noises
    for n in range(count):
        z0 = expected[n]
        for j in range(CORE):
            for k in range(3):
                body[3 * j + k] = z0 * poses[n, j, k]
            z[j] = (surface[n, j] + thickness[n, j]) * (
                axes[n, 0] * rays[n, j, 0] + axes[n, 1] * rays[n, j, 1] + axes[n, 2])
            deep[j], share[j] = 1 + poses[n, j, 2], VISIBLE
            noise[j] = hypot(NOISE_M, STEREO * square(z[j]))
            if not (isfinite(z[j]) and isfinite(deep[j])):
                share[j] = 0
        for j in range(CORE):
            for s in range(segments.shape[0] if share[j] > 0 else 0):
                front = find_front(&body[3 * j], &body[3 * segments[s, 0]], &body[3 * segments[s, 1]], radii[s])
                if front < body[3 * j + 2] - thickness[n, j] - BEFORE_M:
                    share[j] = HIDDEN
        best, distance = -INFINITY, z0
        for c in range(CORE + 1):  # the likeliest distance that one of the depths shows
            if c < CORE and share[c] == 0:
                continue
            weight = z[c] / deep[c] if c < CORE else z0
            total = -log(1 + square((weight / z0 - 1) / prior))
            for j in range(CORE):
                if share[j] > 0:
                    error = z[j] - weight * deep[j]
                    density = compute_density(error, hypot(std[n, j] * z0, noise[j]))
                    total += log(share[j] * density + (1 - share[j]) / OTHER_M)
            if total > best:
                best, distance = total, weight
        for c in range(ROUNDS + 1):
            information = 1 / (square(prior * z0) + square(distance - z0))
            sums = z0 * information
            for j in range(CORE):
                if share[j] > 0:
                    error, front = z[j] - distance * deep[j], hypot(std[n, j] * z0, noise[j])
                    density = share[j] * compute_density(error, front)
                    trust[n, j] = density / (density + (1 - share[j]) / OTHER_M)
                    weight = trust[n, j] * square(deep[j] / front)
                    information += weight
                    sums += weight * z[j] / deep[j]
            if c < ROUNDS:
                distance = sums / information
        out_distance[n], out_variance[n] = distance, 1 / information
        for j in range(CORE):
            if share[j] > 0:
                deviation[n, j], relative[n, j] = z[j] / distance - deep[j], noise[j] / distance
    return distances, variances, deviations, trusts, noises
