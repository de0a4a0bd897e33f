# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Distances between people who are expected and people who are detected; the formulas are in `keypoints.association`.

Sizes: J joints, P people who are expected, D detections. A joint is known or seen if its weight is positive.
"""

from libc.math cimport INFINITY, NAN, fabs, hypot, log, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

ctypedef const double[:, ::1] Points
ctypedef const double[::1] Weights

cdef struct Extent:
    double x, y, size


cdef struct Difference:
    double distance, growth


cdef Extent measure_one(Points points, Weights weight, double min_size) noexcept nogil:
    """Centre and size of the seen joints; NaN if there is none."""
    cdef Py_ssize_t j
    cdef int seen = 0
    cdef double x = 0, y = 0, squares = 0
    for j in range(weight.shape[0]):
        if weight[j] > 0:
            seen += 1
            x += points[j, 0]
            y += points[j, 1]
    if seen == 0:
        return Extent(NAN, NAN, NAN)
    x /= seen
    y /= seen
    for j in range(weight.shape[0]):
        if weight[j] > 0:
            squares += (points[j, 0] - x) * (points[j, 0] - x) + (points[j, 1] - y) * (points[j, 1] - y)
    return Extent(x, y, sqrt(squares / seen) + min_size)


cdef double find_median(double* values, Py_ssize_t n) noexcept nogil:
    """Median of a few values, which are sorted by insertion."""
    cdef Py_ssize_t i, place
    cdef double value
    for i in range(1, n):
        value, place = values[i], i
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return (values[(n - 1) // 2] + values[n // 2]) / 2


cdef Difference compare(
    Points expected, Weights known, Extent person, Points detected, Weights seen, Extent detection,
    const long long[::1] counterpart, double* offset, int min_shared, double radius_offset,
) noexcept nogil:
    """Distance and growth of a pair; joint j of the person is called counterpart[j] in the detection."""
    cdef Py_ssize_t j, i
    cdef int shared = 0
    cdef double size = max(person.size, detection.size), growth, radius, other_radius, x, y, u, v
    cdef double own_x = 0, own_y = 0, own_squares = 0, other_x = 0, other_y = 0, other_squares = 0
    for j in range(known.shape[0]):
        i = counterpart[j]
        if known[j] > 0 and seen[i] > 0:
            x, y = expected[j, 0] - person.x, expected[j, 1] - person.y
            u, v = detected[i, 0] - detection.x, detected[i, 1] - detection.y
            own_x, own_y, own_squares = own_x + x, own_y + y, own_squares + x * x + y * y
            other_x, other_y = other_x + u, other_y + v
            other_squares += u * u + v * v
            offset[shared] = hypot(detected[i, 0] - expected[j, 0], detected[i, 1] - expected[j, 1])
            shared += 1
    if shared < min_shared:
        growth = log(detection.size / person.size)
        return Difference(
            hypot(detection.x - person.x, detection.y - person.y) / size + fabs(growth), growth
        )
    radius = sqrt(max(own_squares / shared - (own_x * own_x + own_y * own_y) / (shared * shared), 0.0))
    other_radius = sqrt(
        max(other_squares / shared - (other_x * other_x + other_y * other_y) / (shared * shared), 0.0)
    )
    growth = log((other_radius + radius_offset * size) / (radius + radius_offset * size))
    return Difference(find_median(offset, shared) / size + fabs(growth), growth)


def measure_extent(Points points, Weights weight, double min_size):
    """Return centre and size of the seen joints of points (J, 2) with weights (J,); NaN if none was seen."""
    cdef Extent extent = measure_one(points, weight, min_size)
    return extent.x, extent.y, extent.size


def measure_distances(
    const double[:, :, ::1] expected, Points known, const double[:, :, ::1] detected, Points seen,
    const long long[::1] mirror, int min_shared, double min_size, int few_shared, double radius_offset,
):
    """Return the distances (D, P) and growths (D, P) of points (P, J, 2), (D, J, 2) with weights (P, J), (D, J).

    Args:
        expected: where the people are expected.
        known: weights of these.
        detected: detections, in the same unit.
        seen: weights of these.
        mirror: (J,) for each joint its counterpart on the other side of the body.
        min_shared: number of joints that must be both known and seen; with fewer the distance is infinite.
        min_size: added to each size, in the unit of the points.
        few_shared: number of such joints below which centres and sizes are compared instead.
        radius_offset: added to both radii, as a share of the larger size.
    """
    cdef Py_ssize_t p, d, j, people = known.shape[0], detections = seen.shape[0], joints = known.shape[1]
    cdef int shared
    cdef Difference own, exchanged
    cdef const long long[::1] same = np.arange(joints)
    out, growths = np.full((detections, people), INFINITY), np.zeros((detections, people))
    cdef double[:, ::1] distance = out, growth = growths
    cdef double* offset = <double*> malloc(joints * sizeof(double))
    cdef Extent* extent = <Extent*> malloc((people + detections) * sizeof(Extent))
    for p in range(people):
        extent[p] = measure_one(expected[p], known[p], min_size)
    for d in range(detections):
        extent[people + d] = measure_one(detected[d], seen[d], min_size)
    for p in range(people):
        for d in range(detections):
            shared = 0
            for j in range(joints):
                shared += known[p, j] > 0 and seen[d, j] > 0
            if shared < min_shared:
                continue
            own = compare(expected[p], known[p], extent[p], detected[d], seen[d], extent[people + d],
                          same, offset, few_shared, radius_offset)
            exchanged = compare(expected[p], known[p], extent[p], detected[d], seen[d], extent[people + d],
                                mirror, offset, few_shared, radius_offset)
            if exchanged.distance < own.distance:
                own = exchanged
            distance[d, p], growth[d, p] = own.distance, own.growth
    free(extent)
    free(offset)
    return out, growths
