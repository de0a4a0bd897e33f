# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Viterbi's algorithm for left and right exchanged by a detector; the formulas are in `keypoints.left_right`.

Sizes: J joints, F frames, 8 states, 3 parts: shoulders, legs and arms. Bits 0, 1 and 2 of a state: whole body, legs
and arms are exchanged. The values were tuned on motion capture as models of three real detectors see it. The
probabilities are per 1/30 s: real detectors swap the whole body in 0.1 % of the frames, for 0.3 s, legs and arms in
0.3 to 3 %, for 0.06 s.
"""

from libc.math cimport INFINITY, exp, hypot, log, pow, tanh

import numpy as np

from mocap_ros.engine.geometry cimport Indices, Rows, Stack, Vector


cdef double[3] ENTER = [0.0005, 0.003, 0.003]  # a, the probability that a swap begins
cdef double[3] LEAVE = [0.2, 0.55, 0.55]  # b, the probability that it ends
cdef double[3] INITIAL_COST = [7.0, 5.0, 5.0]  # nats; the shares of frames above
cdef double PREDICTION_STD = 0.05  # body sizes; std of a predicted coordinate at once: image noise
cdef double PREDICTION_STD_PER_S = 1.0  # body sizes/s; for the velocity is not known exactly
cdef double PREDICTION_STD_PER_S2 = 2.0  # body sizes/s^2; makes either labelling acceptable after a gap
cdef double OUTLIER_PROBABILITY = 0.1  # eps; share of points that are far from where the joint is
cdef double OUTLIER_STD = 0.3  # body sizes (s); such points are still on the body
cdef double CONFUSION_COST = 12.0  # nats; more than to enter a swap of legs or arms, so that these show at once
cdef double ATTACHMENT_COST = 5.0  # nats; log odds that the much shorter lines are those of the right labels
cdef double ATTACHMENT_SCALE = 0.25  # body sizes; lines longer by this have log odds of about 4 nats
cdef double ATTACHMENT_TIME_S = 0.1  # s; frames that follow each other more closely say the same
cdef double TAU_S = 0.08  # s; of the smoothing of velocities and of their decay in a prediction
cdef double MAX_VELOCITY_GAP_S = 0.2  # s; a joint that was not seen for longer restarts with velocity 0
cdef double MIN_STEP_S = 1e-3  # s; guards divisions by a time step, for images may be a millisecond apart
cdef double REFERENCE_FRAME_S = (1.0 / 30)  # s; frame interval that the transition probabilities refer to

cdef enum:
    STATES = 8
    PARTS = 3


cdef inline int has_bit(int state, int bit) noexcept nogil:
    return state >> bit & 1


cdef inline int is_swapped(int state, Py_ssize_t part) noexcept nogil:
    """Whether a state exchanges a part: legs and arms by their own bit or that of the whole body, not by both."""
    return has_bit(state, 0) if part == 0 else has_bit(state, part) ^ has_bit(state, 0)


# For `keypoints.left_right`: tau, and the parts (8, 3) with wrong labels.
VELOCITY_TIME_S = TAU_S
SWAPPED_PARTS = np.array([[is_swapped(state, part) for part in range(PARTS)] for state in range(STATES)], bool)


cdef void find_transition_cost(double elapsed_s, double[STATES][STATES] cost) noexcept nogil:
    """Write -log P(z_t | z_(t-1)) in nats, or -log P(z_0); rows are states before, columns states after a step."""
    cdef int bit, before, after
    cdef double frames = max(elapsed_s, MIN_STEP_S) / REFERENCE_FRAME_S, mixing
    cdef double[4] step
    for before in range(STATES):
        for after in range(STATES):
            cost[before][after] = 0
    for bit in range(PARTS):
        mixing = (1 - pow(1 - ENTER[bit] - LEAVE[bit], frames)) / (ENTER[bit] + LEAVE[bit])
        step[0], step[1] = -log(1 - ENTER[bit] * mixing), -log(ENTER[bit] * mixing)
        step[2], step[3] = -log(LEAVE[bit] * mixing), -log(1 - LEAVE[bit] * mixing)
        if elapsed_s == INFINITY:  # the first frame
            step[0], step[1], step[2], step[3] = 0, INITIAL_COST[bit], 0, INITIAL_COST[bit]
        for before in range(STATES):
            for after in range(STATES):
                cost[before][after] += step[2 * has_bit(before, bit) + has_bit(after, bit)]


cdef void find_attachment_cost(
    Rows points, Vector weight, double body_size, Indices mirror, Indices upper, Indices lower, double[PARTS] cost
) noexcept nogil:
    """Write what it costs to exchange left and right of a part, but not of the shoulders, in nats."""
    cdef Py_ssize_t part, left, right, near, far
    cdef double longer
    for part in range(PARTS):
        cost[part] = 0
        if upper[part] < 0:
            continue
        left, right, near, far = upper[part], mirror[upper[part]], lower[part], mirror[lower[part]]
        if weight[left] > 0 and weight[right] > 0 and weight[near] > 0 and weight[far] > 0:
            longer = (
                measure(points, left, far) + measure(points, right, near)
                - measure(points, left, near) - measure(points, right, far)
            )
            cost[part] = ATTACHMENT_COST * max(0.0, tanh(longer / body_size / ATTACHMENT_SCALE))


cdef inline double measure(Rows points, Py_ssize_t a, Py_ssize_t b) noexcept nogil:
    return hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1])


cdef void add_label_cost(
    Stack joints, double time_s, Rows points, Vector weight, double body_size, Indices mirror, Indices part,
    double[STATES][PARTS][2] cost,
) noexcept nogil:
    """Add the costs C_g(l) of a frame in nats: for each path, part and label, 1 for exchanged."""
    cdef Py_ssize_t j, source
    cdef int path, label, p
    cdef double age, known_age = -1, horizon = 0, x, y, variance, inlier
    cdef double[PARTS][2] product  # of likelihoods: one logarithm serves all joints of a part
    for path in range(STATES):
        for p in range(PARTS):
            product[p][0] = product[p][1] = 1
        for j in range(mirror.shape[0]):
            if part[j] < 0 or joints[path, j, 4] == -INFINITY:
                continue
            age = time_s - joints[path, j, 4]
            if age != known_age:  # most joints were seen in the same frame
                known_age, horizon = age, TAU_S * (1 - exp(-age / TAU_S))
            for label in range(2):
                source = mirror[j] if label else j
                if weight[source] > 0:
                    x = points[source, 0] - (joints[path, j, 0] + joints[path, j, 2] * horizon)
                    y = points[source, 1] - (joints[path, j, 1] + joints[path, j, 3] * horizon)
                    variance = find_variance(age, weight[source])
                    inlier = find_inlier_likelihood((x * x + y * y) / (body_size * body_size), variance)
                    product[part[j]][label] *= inlier + find_outlier_likelihood(variance)
        for p in range(PARTS):
            for label in range(2):
                cost[path][p][label] -= log(product[p][label])


cdef inline double find_variance(double age_s, double score) noexcept nogil:
    """Return sigma^2, in body sizes squared, of a point of some score."""
    cdef double std = PREDICTION_STD + PREDICTION_STD_PER_S * age_s + PREDICTION_STD_PER_S2 * age_s * age_s
    return (2 - score) * (2 - score) * std * std


cdef inline double find_inlier_likelihood(double squared_error, double variance) noexcept nogil:
    return (1 - OUTLIER_PROBABILITY) * exp(-0.5 * squared_error / variance) / variance


cdef inline double find_outlier_likelihood(double variance) noexcept nogil:
    return OUTLIER_PROBABILITY / (variance + OUTLIER_STD * OUTLIER_STD)


def continue_paths(
    Vector path_cost, const signed char[:, :] path_states, Stack path_joints, double time_s, Rows points,
    Vector weight, double body_size, Indices mirror, Indices part, Indices upper, Indices lower,
):
    """Return the paths continued by a frame: costs (8,), states (8, F + 1) and joints (8, J, 5); and decisions.

    The first three are the attributes of `ViterbiPaths`, the last four of `BodySides`; points (J, 2) are as detected.
    Decisions (F + 1, 3) are the parts whose labels are wrong along the likeliest path.
    """
    cdef Py_ssize_t f, j, d, source, before, joints = mirror.shape[0], frames = path_states.shape[1]
    cdef int path, state, p, label, bit, predecessor, best = 0
    cdef double elapsed_s = INFINITY, share, age, known_age = -1, blend = 0, total, velocity
    cdef double squared, variance, inlier, trust
    cdef double[2] moved
    cdef double[STATES][PARTS][2] label_cost
    cdef double[STATES][STATES] transition
    cdef double[PARTS] attachment
    cdef bint[STATES][PARTS][2] is_confused  # whether the path exchanges the part in its own past
    for path in range(STATES):
        for p in range(PARTS):
            label_cost[path][p][0] = label_cost[path][p][1] = 0
    for j in range(joints):
        elapsed_s = min(elapsed_s, time_s - path_joints[0, j, 4])
    add_label_cost(path_joints, time_s, points, weight, body_size, mirror, part, label_cost)
    for path in range(STATES):
        for p in range(PARTS):
            total = min(label_cost[path][p][0], label_cost[path][p][1]) + CONFUSION_COST
            for label in range(2):
                is_confused[path][p][label] = label_cost[path][p][label] > total
                label_cost[path][p][label] = min(label_cost[path][p][label], total)
    find_transition_cost(elapsed_s, transition)
    find_attachment_cost(points, weight, body_size, mirror, upper, lower, attachment)
    arrays = np.full(STATES, np.inf), np.empty((STATES, frames + 1), np.int8), np.empty((STATES, joints, 5)), np.empty(
        (frames + 1, PARTS), bool
    )
    cdef double[::1] cost = arrays[0]
    cdef signed char[:, ::1] states = arrays[1]
    cdef double[:, :, ::1] new = arrays[2]
    cdef unsigned char[:, ::1] decisions = arrays[3].view(np.uint8)
    share = min(elapsed_s / ATTACHMENT_TIME_S, 1.0)
    for state in range(STATES):
        predecessor = 0
        for path in range(STATES):
            total = path_cost[path] + transition[path][state]
            for p in range(PARTS):
                total += label_cost[path][p][is_swapped(state, p)]
            if total < cost[state]:
                cost[state], predecessor = total, path
        for bit in range(PARTS):
            cost[state] += has_bit(state, bit) * attachment[bit] * share
        best = state if cost[state] < cost[best] else best
        for f in range(frames):
            states[state, f] = path_states[predecessor, f]
        states[state, frames] = state
        for j in range(joints):
            source = before = j
            if part[j] >= 0:
                label = is_swapped(state, part[j])
                source = mirror[j] if label else j
                before = mirror[j] if is_confused[predecessor][part[j]][label] else j
            if not weight[source] > 0:
                for d in range(5):
                    new[state, j, d] = path_joints[predecessor, before, d]
                continue
            age = max(time_s - path_joints[predecessor, before, 4], MIN_STEP_S)
            if age != known_age:  # most joints were seen in the same frame
                known_age, blend = age, 1 - exp(-age / TAU_S)
            squared = 0
            for d in range(2):
                moved[d] = points[source, d] - path_joints[predecessor, before, d]
                squared += ((moved[d] - path_joints[predecessor, before, 2 + d] * TAU_S * blend) / body_size) ** 2
            variance = find_variance(age, weight[source])
            inlier = find_inlier_likelihood(squared, variance)
            trust = blend * inlier / (inlier + find_outlier_likelihood(variance))
            for d in range(2):
                velocity = path_joints[predecessor, before, 2 + d]
                velocity += trust * (moved[d] / age - velocity)
                new[state, j, d] = points[source, d]
                new[state, j, 2 + d] = velocity if age < MAX_VELOCITY_GAP_S else 0.0
            new[state, j, 4] = time_s
    total = cost[best]
    for state in range(STATES):
        cost[state] -= total
    for f in range(frames + 1):
        for p in range(PARTS):
            decisions[f, p] = is_swapped(states[best, f], p)
    return arrays


def exchange_sides(Stack points, Rows weight, const unsigned char[:, ::1] is_swapped, Indices mirror, Indices part):
    """Return points (F, J, 2) and weights (F, J) with left and right of some parts (F, 3) exchanged."""
    cdef Py_ssize_t f, j, source
    arrays = np.empty((weight.shape[0], weight.shape[1], 2)), np.empty((weight.shape[0], weight.shape[1]))
    cdef double[:, :, ::1] out = arrays[0]
    cdef double[:, ::1] out_weight = arrays[1]
    for f in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            source = mirror[j] if part[j] >= 0 and is_swapped[f, part[j]] else j
            out[f, j, 0], out[f, j, 1] = points[f, source, 0], points[f, source, 1]
            out_weight[f, j] = weight[f, source]
    return arrays
