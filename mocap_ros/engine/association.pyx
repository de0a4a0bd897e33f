# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Distances between people who are expected and people who are detected; the formulas are in `keypoints.association`.

Sizes: J joints, P people who are expected, D detections. A joint is known or seen if its weight is positive.
"""

from libc.math cimport INFINITY, NAN, fabs, hypot, isfinite, log, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from mocap_ros.engine.geometry cimport Indices, Rows, Stack, Vector
from mocap_ros.engine.median cimport find_median

cdef struct Extent:
    double x, y, size


cdef struct Difference:
    double distance, growth


cdef Extent measure_one(Rows points, Vector weight, double min_size) noexcept nogil:
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
    Rows expected, Vector known, Extent person, Rows detected, Vector seen, Extent detection,
    Indices counterpart, double* offset, int min_shared, double radius_offset,
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


def measure_sizes(Stack points, Rows weight, double min_size):
    """Return the sizes (N,) of the seen joints of points (N, J, 2) with weights (N, J); NaN if none was seen."""
    cdef Py_ssize_t n
    result = np.empty(points.shape[0])
    cdef double[::1] out = result
    for n in range(points.shape[0]):
        out[n] = measure_one(points[n], weight[n], min_size).size
    return result


def expect_people(
    people, long long stamp_ns, Py_ssize_t joints, double max_moved_s, double min_span_s, int min_shared
):
    """Return where joints are expected (P, J, 2) and whether they were seen (P, J), as of `keypoints.association`."""
    cdef Py_ssize_t p, j, f, first, last
    cdef int shared
    cdef double span_s, x, y, moved_s
    cdef Stack points
    cdef Rows weight
    cdef tuple stamps_ns
    arrays = np.zeros((len(people), joints, 2)), np.zeros((len(people), joints))
    cdef double[:, :, ::1] out = arrays[0]
    cdef double[:, ::1] out_weight = arrays[1]
    for p in range(len(people)):
        points, weight, stamps_ns = people[p].rays, people[p].weight, people[p].stamps_ns
        first = last = len(stamps_ns) - 1
        while first > 0 and measure_span(stamps_ns[first - 1], stamps_ns[last]) <= max_moved_s:
            first -= 1
        span_s, shared = measure_span(stamps_ns[first], stamps_ns[last]), 0
        x = y = 0
        for j in range(joints):
            if weight[first, j] > 0 and weight[last, j] > 0:
                shared += 1
                x += points[last, j, 0] - points[first, j, 0]
                y += points[last, j, 1] - points[first, j, 1]
        if span_s >= min_span_s and shared >= min_shared:
            x, y = x / (shared * span_s), y / (shared * span_s)
        else:
            x = y = 0
        for j in range(joints):
            f = last
            while f >= first and not weight[f, j] > 0:
                f -= 1
            if f >= first:
                moved_s = min(measure_span(stamps_ns[f], stamp_ns), max_moved_s)
                out[p, j, 0], out[p, j, 1] = points[f, j, 0] + x * moved_s, points[f, j, 1] + y * moved_s
                out_weight[p, j] = 1
    return arrays


cdef inline double measure_span(long long first_ns, long long last_ns) noexcept nogil:
    return (last_ns - first_ns) / 1e9


def measure_distances(
    Stack expected, Rows known, Stack detected, Rows seen,
    Indices mirror, int min_shared, double min_size, int few_shared, double radius_offset,
):
    """Return the distances (D, P) and growths (D, P) of points (P, J, 2), (D, J, 2) with weights (P, J), (D, J).

    The formulas, and limits that are arguments, are those of `keypoints.association`; weights are `known` and `seen`,
    and mirror (J,) are the counterparts of the joints. With fewer than `min_shared` joints that are both known and seen
    the distance is infinite; with fewer than `few_shared` centres and sizes are compared.
    """
    cdef Py_ssize_t p, d, j, people = known.shape[0], detections = seen.shape[0], joints = known.shape[1]
    cdef int shared
    cdef Difference own, exchanged
    cdef Indices same = np.arange(joints)
    out, growths = np.empty((detections, people)), np.zeros((detections, people))
    cdef double[:, ::1] distance = out, growth = growths
    cdef double* offset = <double*> malloc(joints * sizeof(double))
    cdef Extent* extent = <Extent*> malloc((people + detections) * sizeof(Extent))
    for p in range(people):
        extent[p] = measure_one(expected[p], known[p], min_size)
    for d in range(detections):
        extent[people + d] = measure_one(detected[d], seen[d], min_size)
    distance[:] = INFINITY
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


def choose_pairs(const double[:, :] costs not None):
    """Return for each of D detections the person of P, so that the sum of costs (D, P) is least; -1 for none.

    Each row i in turn gets a column j along the shortest augmenting path, by reduced costs c_ij - u_i - v_j >= 0
    (Kuhn and Munkres; `scipy.optimize.linear_sum_assignment` is slow to import). Rows and columns count from 1.
    """
    cdef bint transposed = costs.shape[0] > costs.shape[1]
    cdef const double[:, :] cost = costs.T if transposed else costs
    cdef Py_ssize_t row, i, j, column, following = 0, rows = cost.shape[0], columns = cost.shape[1]
    cdef double[:, ::1] numbers = np.zeros((3, columns + 1))
    cdef long long[:, ::1] indices = np.zeros((3, columns + 1), np.int64)
    cdef double* u = &numbers[0, 0]
    cdef double* v = &numbers[1, 0]
    cdef double* shortest = &numbers[2, 0]  # reduced cost of the path to each column
    cdef long long* row_of = &indices[0, 0]
    cdef long long* before = &indices[1, 0]
    cdef long long* is_passed = &indices[2, 0]
    cdef double least
    result = np.full(costs.shape[0], -1)
    cdef long long[::1] person_of = result
    for i in range(rows):
        for j in range(columns):
            if not isfinite(cost[i, j]):
                raise ValueError('a cost is not finite')
    for row in range(1, rows + 1):
        row_of[0], column = row, 0
        for j in range(columns + 1):
            shortest[j], is_passed[j] = INFINITY, 0
        while row_of[column] > 0:
            i, least, is_passed[column] = row_of[column], INFINITY, 1
            for j in range(1, columns + 1):
                if is_passed[j]:
                    continue
                if cost[i - 1, j - 1] - u[i] - v[j] < shortest[j]:
                    shortest[j], before[j] = cost[i - 1, j - 1] - u[i] - v[j], column
                if shortest[j] < least:
                    least, following = shortest[j], j
            for j in range(columns + 1):
                if is_passed[j]:
                    u[row_of[j]] += least
                    v[j] -= least
                else:
                    shortest[j] -= least
            column = following
        while column > 0:
            row_of[column] = row_of[before[column]]
            column = before[column]
    for j in range(1, columns + 1):
        if row_of[j] > 0 and transposed:
            person_of[j - 1] = row_of[j] - 1
        elif row_of[j] > 0:
            person_of[row_of[j] - 1] = j - 1
    return result
