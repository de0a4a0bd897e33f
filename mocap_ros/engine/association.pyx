# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Distances between people who are expected and people who are detected; the formulas are in `keypoints.association`.

Sizes: J joints, P people who are expected, D detections. A joint is known or seen if its weight is positive.
"""

from libc.math cimport INFINITY, NAN, fabs, hypot, log, sqrt
from libc.stdlib cimport free, malloc

from mocap_ros.engine.median cimport find_median

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


def measure_sizes(const double[:, :, ::1] points, const double[:, ::1] weight, double min_size):
    """Return the sizes (N,) of the seen joints of points (N, J, 2) with weights (N, J); NaN if none was seen."""
    cdef Py_ssize_t n
    result = np.empty(points.shape[0])
    cdef double[::1] out = result
    for n in range(points.shape[0]):
        out[n] = measure_one(points[n], weight[n], min_size).size
    return result


def expect_person(
    const double[:, :, ::1] points, Points weight, Weights age_s, double max_moved_s, double min_span_s, int min_shared
):
    """Return where joints are expected (J, 2) and whether they were seen (J,), as of `keypoints.association`."""
    cdef Py_ssize_t j, f, last = weight.shape[0] - 1
    cdef int shared = 0
    cdef double span_s = age_s[0] - age_s[last], x = 0, y = 0, moved_s
    arrays = np.zeros((weight.shape[1], 2)), np.zeros(weight.shape[1])
    cdef double[:, ::1] out = arrays[0]
    cdef double[::1] out_weight = arrays[1]
    for j in range(weight.shape[1]):
        if weight[0, j] > 0 and weight[last, j] > 0:
            shared += 1
            x += points[last, j, 0] - points[0, j, 0]
            y += points[last, j, 1] - points[0, j, 1]
    if span_s >= min_span_s and shared >= min_shared:
        x, y = x / (shared * span_s), y / (shared * span_s)
    else:
        x = y = 0
    for j in range(weight.shape[1]):
        f = last
        while f >= 0 and not weight[f, j] > 0:
            f -= 1
        if f >= 0:
            moved_s = min(age_s[f], max_moved_s)
            out[j, 0], out[j, 1] = points[f, j, 0] + x * moved_s, points[f, j, 1] + y * moved_s
            out_weight[j] = 1
    return arrays


def measure_distances(
    const double[:, :, ::1] expected, Points known, const double[:, :, ::1] detected, Points seen,
    const long long[::1] mirror, int min_shared, double min_size, int few_shared, double radius_offset,
):
    """Return the distances (D, P) and growths (D, P) of points (P, J, 2), (D, J, 2) with weights (P, J), (D, J).

    `expected` where the people are expected; `known` weights of these; `detected` detections, in the same unit;
    `seen` weights of these; `mirror` (J,) for each joint its counterpart on the other side of the body;
    `min_shared` number of joints that must be both known and seen, with fewer the distance is infinite; `min_size`
    added to each size, in the unit of the points; `few_shared` number of such joints below which centres and sizes
    are compared instead; `radius_offset` added to both radii, as a share of the larger size.
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


def choose_pairs(Points cost):
    """Return for each of D detections the person of P, so that the sum of costs (D, P) is least; -1 for none.

    All costs are finite. Each row in turn is given a column along the shortest augmenting path, by reduced costs
    c_ij - u_i - v_j >= 0 (Crouse 2016; as in `scipy.optimize.linear_sum_assignment`, which is slow to import).
    """
    cdef Py_ssize_t i, j, k, index, row, sink, left, other, transposed = cost.shape[0] > cost.shape[1]
    cdef Py_ssize_t rows = min(cost.shape[0], cost.shape[1]), columns = max(cost.shape[0], cost.shape[1])
    cdef double reached, lowest, reduced
    cdef double[::1] u = np.zeros(rows), v = np.zeros(columns), shortest = np.empty(columns)
    cdef long long[::1] row_of = np.full(columns, -1), column_of = np.full(rows, -1)
    cdef long long[::1] path = np.empty(columns, np.int64), remaining = np.empty(columns, np.int64)
    cdef unsigned char[::1] is_row_passed = np.empty(rows, np.uint8), is_column_passed = np.empty(columns, np.uint8)
    for row in range(rows):
        for i in range(rows):
            is_row_passed[i] = 0
        for j in range(columns):
            is_column_passed[j], shortest[j] = 0, INFINITY
            remaining[j] = columns - j - 1  # in reverse order, so that equal costs give the identity
        i, sink, left, reached = row, -1, columns, 0.0
        while sink < 0:
            index, lowest, is_row_passed[i] = -1, INFINITY, 1
            for k in range(left):
                j = remaining[k]
                reduced = reached + (cost[j, i] if transposed else cost[i, j]) - u[i] - v[j]
                if not fabs(reduced) < INFINITY:
                    raise ValueError('a cost is not finite')
                if reduced < shortest[j]:
                    path[j], shortest[j] = i, reduced
                if shortest[j] < lowest or (shortest[j] == lowest and row_of[j] < 0):
                    lowest, index = shortest[j], k
            reached, j = lowest, remaining[index]
            if row_of[j] < 0:
                sink = j
            else:
                i = row_of[j]
            is_column_passed[j] = 1
            left -= 1
            remaining[index] = remaining[left]
        u[row] += reached
        for i in range(rows):
            if is_row_passed[i] and i != row:
                u[i] += reached - shortest[column_of[i]]
        for j in range(columns):
            if is_column_passed[j]:
                v[j] -= reached - shortest[j]
        j, i = sink, -1
        while i != row:
            i = path[j]
            row_of[j] = i
            other = column_of[i]
            column_of[i] = j
            j = other
    return np.array(row_of if transposed else column_of)
