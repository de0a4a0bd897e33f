# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""Orientations of the segments of a body, and face, feet and hands as rigid parts that hang on its core.

The formulas are in `solvers.extremities`. Matrices are 9
numbers in the order of their rows. Sizes: 15 core joints and segments, 4 limbs, 5 parts, 11 points of these, 3 sizes.
"""

from libc.math cimport INFINITY, M_PI, NAN, atan2, cos, exp, hypot, isfinite, sin, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.geometry cimport (
    Rows, Stack, Vector, cross, dot, multiply, multiply_transposed, rotation_from_vector, square, subtract, transform,
    vector_from_rotation,
)

cdef double MIN_LENGTH_M = 1e-6  # far under any bone, guards divisions
cdef double WEAK_SINE = 0.2  # W; sine of 12 degrees, by which a bent joint differs from a straight, noisy one
cdef double REST_SINE = 0.15  # D; weight of the direction without evidence: that of a limb bent by 9 degrees
cdef double FOOT_SINE = 1.0  # D_f; weight of the foot: that of a knee bent by 90 degrees
cdef double KNOWN_SINE = 0.3  # |v| from which the bend of a limb says how it is turned, and not its rest
cdef double LIMB_MEMORY_S = 0.3  # T; so long a straight limb keeps the direction that it had when it was bent
cdef double LIFTED_MEMORY_S = 0.1  # T of the lifter's errors; more would leave turning heads and steps behind
cdef double IMAGE_MEMORY_S = 1.0  # T of the detector's errors, most of which last for a whole sequence
cdef double SHIFT_STD_M = 0.05  # s: std of a core joint's error and of a detector's idea of it
cdef double RAY_STD_M = 0.03  # at the body; error of a seen point besides the image noise: detectors' offsets
cdef double ROBUST_STDS = 2.5  # standard deviations from which an image point counts less
cdef double MAX_STEP_RAD = 0.5  # a longer step would leave the range in which the linearisation holds
cdef double MIN_DEPTH_M = 0.1  # a nearer point has no image
cdef double MIN_ANGLE = 1e-9  # rad; guards a division
cdef double MIN_PIVOT = 1e-12  # guards the square roots of a Cholesky factorisation against rounding
cdef double MAX_SIZE_STDS = 5.0  # of people's sizes; there is no such face, foot or hand
cdef double SIZE_MEMORY_S = 60.0  # a person's size does not change, but the detector may
cdef double MAX_TURN_STD_RAD = 0.4363323129985824  # 25 degrees; a turn that is known no better counts as unknown
cdef double VELOCITY_MEMORY_S = 0.1  # over which the velocity of a point about its anchor is averaged
cdef double ANGULAR_SPEED_STD = 1.5  # rad/s; of heads, feet and hands about their anchors
# Of the filter of orientations, chosen on 12 views of persons of the training data and detections at 60 Hz: the
# jitter at 60 Hz halved, at 0.4 degrees more of error.
cdef double STIFFNESS = 12.0  # rad/s at rest; Omega
cdef double DAMPING = 0.7  # zeta
cdef double MIN_SPIN = 1.0  # rad/s; s_0, of someone who moves little
cdef double SPIN_MEMORY_S = 0.2  # of the mean square of the angular velocity
cdef double MAX_LAG_RAD = 0.5  # d; a segment that seems to turn by more in a frame is taken for a wrong one
cdef double MAX_STEADY_GAP_S = 0.2  # after a longer one nothing is known of the angular velocity

cdef enum:
    CORE = 15
    LIMBS = 4
    PARTS = 5
    POINTS = 11
    SIZES = 3
    STEPS = 2  # of Gauss and Newton; a third changes directions by less than 0.1 degrees


cdef struct State:  # what is known of the extremities of a person in a frame
    double segments[CORE][9]  # as the core has them: rotations, in the order of the joints at which they begin
    double twist[LIMBS][3]  # v of the limbs
    double turns[PARTS][9]  # R
    double covariances[PARTS][9]  # rad^2; P
    double sizes[SIZES][2]  # b and I of face, feet and hands
    double offsets[POINTS][3]  # m, points less the core joints on which they hang
    double offset_std[POINTS]  # m
    double velocity[POINTS][3]  # m/s, of the offsets
    double quaternions[CORE][4]  # x, y, z, w, orientations of the segments
    double is_turn_seen[CORE]  # 1 where the image says how a segment is turned about itself
    double spin[CORE][3]  # rad/s; w
    double squared_spin[CORE]  # rad^2/s^2; s^2
    double time_s  # s, of this frame

cdef State _state
STATE = np.asarray(<State[:1]> &_state).dtype


cdef struct Evidence:  # of a frame, the attributes of `ExtremityEvidence`, and the stature
    const double* core
    const double* lifted
    const double* lifted_std
    const double* rays
    const double* weight
    double noise, stature


cdef struct Sums:  # halves of the derivatives of a sum of squares by turn, displacement and size of a part
    double hessian[7][7]  # lower triangle
    double gradient[7]


cdef void write_axes(const double* left, const double* up, double* out) noexcept nogil:
    """Write the axes forward, left and up, in columns, of two vectors; `out` stays where they are parallel."""
    cdef double[3] x
    cdef double up_length = sqrt(dot(up, up)), length
    cdef int i
    cross(left, up, x)
    length = sqrt(dot(x, x))
    if not length > MIN_LENGTH_M * MIN_LENGTH_M or not up_length > MIN_LENGTH_M:
        return
    for i in range(3):
        out[3 * i], out[3 * i + 2] = x[i] / length, up[i] / up_length
    for i in range(3):
        out[3 * i + 1] = (
            out[3 * ((i + 1) % 3) + 2] * out[3 * ((i + 2) % 3)] - out[3 * ((i + 2) % 3) + 2] * out[3 * ((i + 1) % 3)]
        )


cdef inline void find_unit(const double* a, const double* b, double* out) noexcept nogil:
    """Write the direction from a to b."""
    cdef double length
    subtract(b, a, out)
    length = max(sqrt(dot(out, out)), MIN_LENGTH_M)
    out[0], out[1], out[2] = out[0] / length, out[1] / length, out[2] / length


cdef inline void column(const double* matrix, int index, double sign, double* out) noexcept nogil:
    out[0], out[1], out[2] = sign * matrix[index], sign * matrix[3 + index], sign * matrix[6 + index]


cdef void swing(const double* direction, const double* parent, double* out) noexcept nogil:
    """Write f y_s of a limb: the parent's y, swung by the smallest rotation from its -z to the limb's direction.

    With the axis a = r x d of the rotation and the cosine c = r . d, R y = c y + a x y + (a . y) a / (1 + c); and
    with f = (1 + c) / 2 nothing is divided by 0.
    """
    cdef double[3] rest, left, axis, turned
    cdef double cosine
    cdef int i
    column(parent, 2, -1.0, rest)
    column(parent, 1, 1.0, left)
    cross(rest, direction, axis)
    cross(axis, left, turned)
    cosine = dot(rest, direction)
    for i in range(3):
        out[i] = (1 + cosine) / 2 * (cosine * left[i] + turned[i]) + dot(axis, left) * axis[i] / 2


cdef void write_quaternion(const double* r, double* out) noexcept nogil:
    """Write the unit quaternion x, y, z, w of a rotation by Shepperd's method: of the two, that nearer to `out`.

    Where `out` holds zeros, it is the one with w >= 0. So the quaternions of a motion do not jump.
    """
    cdef double[4] q
    cdef double trace = r[0] + r[4] + r[8], length, along
    cdef int i, j, k
    if trace >= max(r[0], max(r[4], r[8])):
        q[0], q[1], q[2], q[3] = r[7] - r[5], r[2] - r[6], r[3] - r[1], 1 + trace
    else:
        i = 0 if r[0] >= max(r[4], r[8]) else 1 if r[4] >= r[8] else 2
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i], q[3] = 1 + 2 * r[4 * i] - trace, r[3 * k + j] - r[3 * j + k]
        q[j], q[k] = r[3 * i + j] + r[3 * j + i], r[3 * i + k] + r[3 * k + i]
    length = sqrt(dot(q, q) + q[3] * q[3])
    along = dot(out, q) + out[3] * q[3]
    if along < 0 or (along == 0 and q[3] < 0):
        length = -length
    for i in range(4):
        out[i] = q[i] / length


cdef void add_turn(const double* vector, const double* turn, double* out) noexcept nogil:
    """Write the quaternion of a rotation, turned by a rotation vector."""
    cdef double angle = sqrt(dot(vector, vector)), w = cos(angle / 2)
    cdef double half = sin(angle / 2) / angle if angle > MIN_ANGLE else 0.5
    cdef int i
    cross(vector, turn, out)
    for i in range(3):
        out[i] = half * (turn[3] * vector[i] + out[i]) + w * turn[i]
    out[3] = w * turn[3] - half * dot(vector, turn)


cdef void steady_turn(
    const double* rotation, double* turn, double* spin, double* squared, double step_s
) noexcept nogil:
    """Move quaternion, angular velocity and its mean square towards a rotation, by the filter of orientations."""
    cdef double[4] ahead, seen
    cdef double[3] moved, lag
    cdef double rate, fall, length, share = exp(-step_s / SPIN_MEMORY_S)
    cdef int i
    if step_s > MAX_STEADY_GAP_S:
        write_quaternion(rotation, turn)
        spin[0] = spin[1] = spin[2] = squared[0] = 0.0
        return
    for i in range(3):
        moved[i] = spin[i] * step_s
    add_turn(moved, turn, ahead)
    memcpy(seen, ahead, sizeof(seen))
    write_quaternion(rotation, seen)
    cross(ahead, seen, lag)  # the rotation vector from `ahead` to `seen` is along the vector of seen times ahead^-1
    for i in range(3):
        lag[i] = ahead[3] * seen[i] - seen[3] * ahead[i] + lag[i]
    length = sqrt(dot(lag, lag))
    if length > MIN_ANGLE:
        rate = min(2 * atan2(length, dot(ahead, seen) + ahead[3] * seen[3]), MAX_LAG_RAD) / length
        lag[0], lag[1], lag[2] = rate * lag[0], rate * lag[1], rate * lag[2]
    rate = STIFFNESS * sqrt(sqrt(1 + squared[0] / (MIN_SPIN * MIN_SPIN))) * step_s
    fall = exp(-DAMPING * rate)
    rate = 1 + fall * fall - 2 * fall * cos(min(sqrt(1 - DAMPING * DAMPING) * rate, M_PI / 2))
    for i in range(3):
        moved[i] = (1 - fall * fall) * lag[i]
        spin[i] += rate / step_s * lag[i]
    add_turn(moved, ahead, turn)
    squared[0] += (1 - share) * (dot(spin, spin) - squared[0])


cdef void invert(double* matrix, int n, double* out) noexcept nogil:
    """Write the inverse of a positive definite matrix (n, n), which is overwritten, by Cholesky's method."""
    cdef int i, j, k, c
    cdef double rest
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[n * i + j]
            for k in range(j):
                rest -= matrix[n * i + k] * matrix[n * j + k]
            matrix[n * i + j] = sqrt(max(rest, MIN_PIVOT)) if i == j else rest / matrix[n * j + j]
    for c in range(n):
        for i in range(n):
            rest = 1.0 if i == c else 0.0
            for k in range(i):
                rest -= matrix[n * i + k] * out[n * k + c]
            out[n * i + c] = rest / matrix[n * i + i]
        for i in range(n - 1, -1, -1):
            rest = out[n * i + c]
            for k in range(i + 1, n):
                rest -= matrix[n * k + i] * out[n * k + c]
            out[n * i + c] = rest / matrix[n * i + i]


cdef void write_spread(const double* rest, const double* std, double* out) noexcept nogil:
    """Write the covariance of standard deviations about the axes of a rotation."""
    cdef int i, j
    cdef double[9] scaled
    for i in range(3):
        for j in range(3):
            scaled[3 * i + j] = rest[3 * i + j] * square(std[j])
    multiply_transposed(scaled, rest, out)


cdef void write_arm(
    const double* template, const double* turn, double size, double* arm, double[3][7] slopes
) noexcept nogil:
    """Write the offset of a point from its anchor, and its derivatives by d, t (0: it is not displaced) and b."""
    cdef int i
    transform(turn, template, arm)
    memset(slopes, 0, 21 * sizeof(double))
    for i in range(3):
        arm[i] *= size
        slopes[i][6] = arm[i]
    slopes[0][1], slopes[0][2] = arm[2], -arm[1]
    slopes[1][0], slopes[1][2] = -arm[2], arm[0]
    slopes[2][0], slopes[2][1] = arm[1], -arm[0]


cdef inline void add_row(Sums* sums, const double* slopes, double error, double information) noexcept nogil:
    """Add `information` times the square of an error with these derivatives (7,)."""
    cdef int a, b
    for a in range(7):
        sums.gradient[a] += information * error * slopes[a]
        for b in range(a + 1):
            sums.hessian[a][b] += information * slopes[a] * slopes[b]


cdef void add_lifted(
    Sums* sums, const double[3][7] slopes, const double* error, const double* sight, double across, double along
) noexcept nogil:
    """Add the squared distance of a point from the lifted one: `error` m apart, across and along the line of sight."""
    cdef int a
    cdef double[7] in_depth
    for a in range(3):
        add_row(sums, slopes[a], error[a], across)
    for a in range(7):
        in_depth[a] = sight[0] * slopes[0][a] + sight[1] * slopes[1][a] + sight[2] * slopes[2][a]
    add_row(sums, in_depth, dot(sight, error), along - across)


cdef void add_ray(
    Sums* sums, const double[3][7] slopes, const double* point, const double* ray, double variance, double share
) noexcept nogil:
    """Add the robust distance of a point's image from a ray; variance in m^2 at the body."""
    cdef int a, axis
    cdef double squared = 0, information
    cdef double[2] error
    cdef double[2][7] across
    for axis in range(2):
        error[axis] = (point[axis] / point[2] - ray[axis]) * point[2]
        squared += error[axis] * error[axis]
        for a in range(7):
            across[axis][a] = slopes[axis][a] - point[axis] / point[2] * slopes[2][a]
    information = share / (variance * (1 + squared / variance / (ROBUST_STDS * ROBUST_STDS)))
    for axis in range(2):
        add_row(sums, across[axis], error[axis], information)


cdef void add_seen(
    Sums* sums, double[3][7] slopes, double* point, const double* origin, const double* shift, const double* ray,
    double weight, double noise, double share,
) noexcept nogil:
    """Add what the image says of a displaced point, if it was seen and is in front of the camera.

    The offset `point` from its anchor `origin` and the derivatives are overwritten by those of its position.
    """
    cdef int i
    for i in range(3):
        point[i] += origin[i] + shift[i]
        slopes[i][3 + i] = 1.0
    if weight > 0 and point[2] > MIN_DEPTH_M:
        add_ray(sums, slopes, point, ray, (noise * noise + RAY_STD_M * RAY_STD_M) / weight, share)


cdef void take_step(Sums* sums, double* turn, double* turned, double* shift, double* inverse) noexcept nogil:
    """Take a step of Gauss and Newton: R, d and t are changed; write the covariance (6, 6) of d and t."""
    cdef int i, j
    cdef double[36] factor
    cdef double[6] step
    cdef double[3] vector
    cdef double[9] rotation, old
    cdef double length
    for i in range(6):
        memcpy(&factor[6 * i], sums.hessian[i], 6 * sizeof(double))
    invert(factor, 6, inverse)
    for i in range(6):
        step[i] = 0
        for j in range(6):
            step[i] -= inverse[6 * i + j] * sums.gradient[j]
    length = min(1.0, MAX_STEP_RAD / max(sqrt(dot(step, step)), MIN_ANGLE))
    for i in range(3):
        vector[i] = step[i] * length
        turned[i] += vector[i]
        shift[i] += step[3 + i]
    rotation_from_vector(vector, rotation)
    memcpy(old, turn, sizeof(old))
    multiply(rotation, old, turn)


def collect_evidence(Stack core, windows, frames):
    """Return what a frame of each of P windows says: `ExtremityEvidence` from lifted joints to scores.

    `core` (P, 15, 3) m; without a lifter the first two are NaN, and without extremities rays and scores are 0.
    """
    cdef Py_ssize_t p, frame, j, i, people = core.shape[0]
    cdef double depth
    cdef Stack lifted, std, rays, other_rays
    cdef Rows camera, weight, other_weight
    arrays = (np.empty((people, CORE + POINTS, 3)), np.empty((people, CORE + POINTS, 3)),
              np.zeros((people, CORE + POINTS, 2)), np.zeros((people, CORE + POINTS)))
    cdef double[:, :, ::1] out_lifted = arrays[0], out_std = arrays[1], out_rays = arrays[2]
    cdef double[:, ::1] out_weight = arrays[3]
    out_lifted[...] = NAN
    out_std[...] = NAN
    for p in range(people):
        window, frame, depth = windows[p], frames[p], 0
        if window.lifted is not None:
            turn, lifted, std = window.virtual_camera.rotation, window.lifted.joints, window.lifted.std
            if turn.ndim == 3:  # a virtual camera for each frame, or one for all
                turn = turn[frame]
            camera = turn
            for j in range(CORE):
                for i in range(3):
                    depth += camera[2, i] * core[p, j, i] / CORE
            for j in range(CORE + POINTS):
                for i in range(3):
                    out_lifted[p, j, i], out_std[p, j, i] = depth * lifted[frame, j, i], depth * std[frame, j, i]
        rays, weight = window.rays, window.weight
        memcpy(&out_rays[p, 0, 0], &rays[frame, 0, 0], 2 * CORE * sizeof(double))
        memcpy(&out_weight[p, 0], &weight[frame, 0], CORE * sizeof(double))
        if window.extremities is not None:
            other_rays, other_weight = window.extremities
            memcpy(&out_rays[p, CORE, 0], &other_rays[frame, 0, 0], 2 * POINTS * sizeof(double))
            memcpy(&out_weight[p, CORE], &other_weight[frame, 0], POINTS * sizeof(double))
    return arrays


cdef class Body:
    """How segments and parts hang together; what the arguments are is said in `solvers.extremities`."""

    cdef Py_ssize_t head, neck, pelvis, lshoulder, rshoulder, lhip, rhip
    cdef Py_ssize_t[LIMBS][4] limbs
    cdef Py_ssize_t[PARTS] part_segments, size_of, point_counts
    cdef Py_ssize_t[POINTS] part_of
    cdef double[LIMBS] bends
    cdef double[9] head_rest
    cdef double[LIMBS][9] end_rest
    cdef double[POINTS][3] template
    cdef double[PARTS][3] rest_std
    cdef double[PARTS] rest_memory_s
    cdef double[SIZES] size_std

    def __init__(self, joints, limbs, bends, head_rest, end_rest, part_segments, part_of, size_of, template, rest_std,
                 rest_memory_s, size_std):
        self.head, self.neck, self.pelvis, self.lshoulder, self.rshoulder, self.lhip, self.rhip = joints
        self.limbs, self.bends, self.part_segments, self.part_of, self.size_of = (
            limbs, bends, part_segments, part_of, size_of
        )
        self.point_counts = [list(part_of).count(part) for part in range(PARTS)]
        self.head_rest, self.end_rest = np.ravel(head_rest), [np.ravel(rest) for rest in end_rest]
        self.template, self.rest_std, self.rest_memory_s, self.size_std = template, rest_std, rest_memory_s, size_std

    cdef void turn_limb(self, State* state, const double* joints, int limb, double step_s) noexcept nogil:
        """Turn the three segments of a limb; that of its parent is of this frame already."""
        cdef Py_ssize_t a = self.limbs[limb][0], b = self.limbs[limb][1], c = self.limbs[limb][2]
        cdef double* parent = state.segments[self.limbs[limb][3]]
        cdef double* twist = state.twist[limb]
        cdef double[3] upper, lower, left, bend, column_of
        cdef double confidence, gain
        cdef int i
        find_unit(joints + 3 * a, joints + 3 * b, upper)
        find_unit(joints + 3 * b, joints + 3 * c, lower)
        swing(upper, parent, left)
        cross(upper, lower, bend)
        for i in range(3):
            left[i] = self.bends[limb] * bend[i] + REST_SINE * left[i]
        confidence = dot(left, left)
        gain = 1 - exp(-step_s * (1 + confidence / (WEAK_SINE * WEAK_SINE)) / LIMB_MEMORY_S)
        for i in range(3):  # v is kept in the axes of the parent segment, and so turns with it
            column(parent, i, 1.0, column_of)
            twist[i] += gain * (dot(column_of, left) - twist[i])
        transform(parent, twist, left)
        for i in range(3):
            upper[i], lower[i] = -upper[i], -lower[i]
        write_axes(left, upper, state.segments[a])
        column(state.segments[a], 1, 1.0, left)
        write_axes(left, lower, state.segments[b])
        multiply(state.segments[b], self.end_rest[limb], state.segments[c])

    cdef void turn_segments(self, State* state, const double* joints, double step_s) noexcept nogil:
        """Turn the segments as the core joints (15, 3) say, a time after the frame before."""
        cdef double[3] left, up
        cdef double[9] bone
        cdef int i, limb
        subtract(joints + 3 * self.lhip, joints + 3 * self.rhip, left)
        for i in range(3):
            up[i] = (joints[3 * self.lshoulder + i] + joints[3 * self.rshoulder + i]
                     - joints[3 * self.lhip + i] - joints[3 * self.rhip + i]) / 2
        write_axes(left, up, state.segments[self.pelvis])
        subtract(joints + 3 * self.lshoulder, joints + 3 * self.rshoulder, left)
        subtract(joints + 3 * self.neck, joints + 3 * self.pelvis, up)
        write_axes(left, up, state.segments[self.neck])
        memcpy(bone, state.segments[self.neck], sizeof(bone))
        column(bone, 1, 1.0, left)
        subtract(joints + 3 * self.head, joints + 3 * self.neck, up)
        write_axes(left, up, bone)
        multiply(bone, self.head_rest, state.segments[self.head])
        for limb in range(LIMBS):
            self.turn_limb(state, joints, limb, step_s)

    cdef void write_orientations(
        self, State* state, const double* weight, const bint* is_part_known, double step_s
    ) noexcept nogil:
        """Write the quaternions of all segments, and whether the image says how they are turned about themselves.

        They are filtered, unless the time since the frame before is infinite.
        """
        cdef double[CORE][9] rotations
        cdef double[3] left, foot, up
        cdef Py_ssize_t part, a, b, c, j
        cdef int limb, i
        cdef bint known
        memcpy(rotations, state.segments, sizeof(rotations))
        memset(state.is_turn_seen, 0, sizeof(state.is_turn_seen))
        for part in range(PARTS):
            memcpy(rotations[self.part_segments[part]], state.turns[part], 9 * sizeof(double))
            state.is_turn_seen[self.part_segments[part]] = is_part_known[part]
        state.is_turn_seen[self.pelvis] = weight[self.lhip] > 0 and weight[self.rhip] > 0
        state.is_turn_seen[self.neck] = weight[self.lshoulder] > 0 and weight[self.rshoulder] > 0
        for limb in range(LIMBS):
            a, b, c = self.limbs[limb][0], self.limbs[limb][1], self.limbs[limb][2]
            known = sqrt(dot(state.twist[limb], state.twist[limb])) >= KNOWN_SINE
            known = known and weight[a] > 0 and weight[b] > 0 and weight[c] > 0
            state.is_turn_seen[a] = known
            if limb < 2:
                continue
            known = known or (state.is_turn_seen[c] > 0 and weight[b] > 0)
            state.is_turn_seen[a] = state.is_turn_seen[b] = known
            column(rotations[c], 1, FOOT_SINE, foot)
            transform(state.segments[self.limbs[limb][3]], state.twist[limb], left)
            for i in range(3):
                left[i] += foot[i]
            column(state.segments[a], 2, 1.0, up)
            write_axes(left, up, rotations[a])
            column(state.segments[b], 2, 1.0, up)
            write_axes(left, up, rotations[b])
        for j in range(CORE):
            steady_turn(rotations[j], state.quaternions[j], state.spin[j], &state.squared_spin[j], step_s)

    cdef void predict_part(self, State* state, Py_ssize_t part, const double* old_rest, double step_s) noexcept nogil:
        """Move the rotation of a part to the next frame: it returns to where the core has it."""
        cdef double* turn = state.turns[part]
        cdef double* covariance = state.covariances[part]
        cdef double* rest = state.segments[self.part_segments[part]]
        cdef double[9] relative, moved, product, spread
        cdef double[3] vector
        cdef double kept = exp(-step_s / self.rest_memory_s[part])
        cdef int i, j
        for i in range(3):
            for j in range(3):
                relative[3 * i + j] = (
                    old_rest[i] * turn[j] + old_rest[3 + i] * turn[3 + j] + old_rest[6 + i] * turn[6 + j]
                )
        multiply_transposed(rest, old_rest, moved)
        vector_from_rotation(relative, vector)
        for i in range(3):
            vector[i] *= kept
        rotation_from_vector(vector, relative)
        multiply(rest, relative, turn)
        multiply(moved, covariance, product)
        multiply_transposed(product, moved, covariance)
        write_spread(rest, self.rest_std[part], spread)
        for i in range(9):
            covariance[i] = kept * kept * covariance[i] + (1 - kept * kept) * spread[i]

    cdef void correct_part(
        self, State* state, Py_ssize_t part, const Evidence* seen, double step_s, double* size_sums
    ) noexcept nogil:
        """Correct the rotation of a part by what a frame says; add its i and -j to the sums (2,)."""
        cdef Py_ssize_t anchor = self.part_segments[part], p, joint
        cdef const double* origin = seen.core + 3 * anchor
        cdef double* turn = state.turns[part]
        cdef double* covariance = state.covariances[part]
        cdef double size = seen.stature * exp(state.sizes[self.size_of[part]][0])
        cdef double lifted_share = min(1.0, step_s / LIFTED_MEMORY_S) / self.point_counts[part]
        cdef double image_share = min(1.0, step_s / IMAGE_MEMORY_S), distance, information, slope
        cdef bint has_lifted = isfinite(seen.lifted[3 * anchor])
        cdef double[9] prior, work
        cdef double[36] inverse
        cdef double[3] sight, error, arm, turned = [0, 0, 0], shift = [0, 0, 0]
        cdef double[3][7] slopes
        cdef Sums sums
        cdef int i, j, step
        distance = max(sqrt(dot(origin, origin)), MIN_DEPTH_M)
        for i in range(3):
            sight[i] = origin[i] / distance
        memcpy(work, covariance, sizeof(work))
        invert(work, 3, prior)
        for step in range(STEPS):
            memset(&sums, 0, sizeof(sums))
            for i in range(3):
                for j in range(3):
                    sums.hessian[i][j] = prior[3 * i + j]
                    sums.gradient[i] += prior[3 * i + j] * turned[j]
                sums.hessian[3 + i][3 + i] = 1 / (SHIFT_STD_M * SHIFT_STD_M)
                sums.gradient[3 + i] = shift[i] / (SHIFT_STD_M * SHIFT_STD_M)
            for p in range(POINTS):
                if self.part_of[p] != part:
                    continue
                joint = CORE + p
                write_arm(self.template[p], turn, size, arm, slopes)
                if has_lifted:
                    for i in range(3):
                        error[i] = arm[i] - seen.lifted[3 * joint + i] + seen.lifted[3 * anchor + i]
                    add_lifted(
                        &sums, slopes, error, sight, lifted_share / square(seen.lifted_std[3 * joint]),
                        lifted_share / square(seen.lifted_std[3 * joint + 2]),
                    )
                add_seen(&sums, slopes, arm, origin, shift, seen.rays + 2 * joint, seen.weight[joint], seen.noise,
                         image_share)
            memset(slopes, 0, sizeof(slopes))
            arm[0] = arm[1] = arm[2] = 0.0  # the anchor itself was seen, too
            add_seen(&sums, slopes, arm, origin, shift, seen.rays + 2 * anchor, seen.weight[anchor], seen.noise,
                     image_share)
            take_step(&sums, turn, turned, shift, inverse)
        information, slope = sums.hessian[6][6], sums.gradient[6]
        for i in range(6):
            for j in range(6):
                information -= sums.hessian[6][i] * inverse[6 * i + j] * sums.hessian[6][j]
                slope -= sums.hessian[6][i] * inverse[6 * i + j] * sums.gradient[j]
        for i in range(3):
            memcpy(covariance + 3 * i, inverse + 6 * i, 3 * sizeof(double))
        size_sums[0] += information
        size_sums[1] -= slope

    cdef void advance(
        self, State* state, const Evidence* seen, double step_s, bint is_learning, double* predicted_turns,
        double* predicted_covariances,
    ) noexcept nogil:
        """Advance segments, parts and sizes by a frame; write (5, 9) what was predicted, where that is wanted."""
        cdef double[CORE][9] old
        cdef double[SIZES][2] sums
        cdef Py_ssize_t part, kind
        cdef double size, limit
        memset(sums, 0, sizeof(sums))
        memcpy(old, state.segments, sizeof(old))
        self.turn_segments(state, seen.core, step_s)
        for part in range(PARTS):
            self.predict_part(state, part, old[self.part_segments[part]], step_s)
            if predicted_turns != NULL:
                memcpy(predicted_turns + 9 * part, state.turns[part], 9 * sizeof(double))
                memcpy(predicted_covariances + 9 * part, state.covariances[part], 9 * sizeof(double))
            self.correct_part(state, part, seen, step_s, sums[self.size_of[part]])
        if not is_learning:
            return
        for kind in range(SIZES):
            state.sizes[kind][1] *= exp(-min(step_s, SIZE_MEMORY_S) / SIZE_MEMORY_S)
            state.sizes[kind][1] += sums[kind][0]
            size = state.sizes[kind][0] + sums[kind][1] / (state.sizes[kind][1] + 1 / square(self.size_std[kind]))
            limit = MAX_SIZE_STDS * self.size_std[kind]
            state.sizes[kind][0] = min(max(size, -limit), limit)

    cdef void write_result(self, State* state, const double* weight, double stature, double step_s) noexcept nogil:
        """Write what rotations and sizes mean for points, their deviations and the orientations of segments."""
        cdef bint[PARTS] is_part_known
        cdef Py_ssize_t p, part, kind
        cdef double* offset
        cdef double* covariance
        cdef double[3] product, axis
        cdef double size, squared, trace, quadratic
        memset(is_part_known, 0, sizeof(is_part_known))
        for p in range(POINTS):
            part, offset = self.part_of[p], state.offsets[p]
            kind, covariance = self.size_of[part], state.covariances[part]
            size = stature * exp(state.sizes[kind][0])
            transform(state.turns[part], self.template[p], offset)
            offset[0], offset[1], offset[2] = size * offset[0], size * offset[1], size * offset[2]
            squared, trace = dot(offset, offset), covariance[0] + covariance[4] + covariance[8]
            transform(covariance, offset, product)
            quadratic = dot(offset, product)
            state.offset_std[p] = sqrt(
                max(trace * squared - quadratic, 0.0)
                + squared / (state.sizes[kind][1] + 1 / square(self.size_std[kind]))
            )
            column(state.turns[part], 2, 1.0, axis)
            transform(covariance, axis, product)
            if weight[CORE + p] > 0 and self.point_counts[part] > 1:
                is_part_known[part] |= dot(axis, product) < MAX_TURN_STD_RAD * MAX_TURN_STD_RAD
        self.write_orientations(state, weight, is_part_known, step_s)

    def follow(
        self, double[:, :] states, evidence, Vector stature, Vector times, bint is_steady,
    ):
        """Overwrite the states (P, N) of people by those of the next frame, with filtered orientations if `is_steady`.

        `evidence` is an `ExtremityEvidence` of this frame; statures (P,) in m; times (P,) in s, and nothing changes
        where they are not newer.
        """
        cdef Stack core = evidence[0], lifted = evidence[1], lifted_std = evidence[2], rays = evidence[3]
        cdef Rows weight = evidence[4]
        cdef Vector noise = evidence[5]
        cdef State* person
        cdef Evidence seen
        cdef double[POINTS][3] old
        cdef double share, step_s
        cdef Py_ssize_t n
        cdef int p, i
        for n in range(states.shape[0]):
            person = <State*> &states[n, 0]
            step_s = times[n] - person.time_s  # infinite for the first
            if step_s <= 0:
                continue
            seen = Evidence(&core[n, 0, 0], &lifted[n, 0, 0], &lifted_std[n, 0, 0], &rays[n, 0, 0], &weight[n, 0],
                            noise[n], stature[n])
            memcpy(old, person.offsets, sizeof(old))
            self.advance(person, &seen, step_s, True, NULL, NULL)
            self.write_result(person, seen.weight, stature[n], step_s if is_steady else INFINITY)
            person.time_s = times[n]
            if not isfinite(step_s):
                memset(person.velocity, 0, sizeof(person.velocity))
                continue
            share = 1 - exp(-step_s / VELOCITY_MEMORY_S)
            for p in range(POINTS):
                for i in range(3):
                    person.velocity[p][i] += share * (
                        (person.offsets[p][i] - old[p][i]) / step_s - person.velocity[p][i]
                    )

    def complete(
        self, double[:, :] states, Vector sizes, motion, const double[:, :] std, double[:, :, ::1] root_covariance
    ):
        """Return all joints and what is known of them, (P, 26, ...), of people who are enlarged to their sizes (P,).

        States (P, N), `motion`, a `CoreMotion`, and deviations (P, 15) m of joints are of the assumed size; the
        covariances (P, 3, 3) of roots and of their velocities are enlarged in place. Joints, velocities and their
        deviations are followed by quaternions x, y, z, w of the segments that turn about the joints or hold them,
        and by whether their turn about themselves is inferred; then come the middles (P, 3) m of the cores. Errors
        of an offset and of the core joint are independent.
        """
        cdef Stack joints = motion[0], velocity = motion[1]
        cdef Rows velocity_std = motion[2]
        cdef double[:, :, ::1] root_velocity_covariance = motion[3]
        cdef State* state
        cdef Py_ssize_t n, j, k, i, anchor, people = joints.shape[0], count = CORE + POINTS
        cdef double size, share
        arrays = (np.empty((people, count, 3)), np.empty((people, count)), np.empty((people, count, 3)),
                  np.empty((people, count)), np.empty((people, count, 4)), np.empty((people, count), np.bool_),
                  np.zeros((people, 3)))
        cdef double[:, :, ::1] out_joints = arrays[0], out_velocity = arrays[2], out_turns = arrays[4]
        cdef double[:, ::1] out_std = arrays[1], out_velocity_std = arrays[3], middles = arrays[6]
        cdef unsigned char[:, ::1] is_inferred = arrays[5].view(np.uint8)
        for n in range(people):
            state, size = <State*> &states[n, 0], sizes[n]
            for k in range(9):
                (&root_covariance[n, 0, 0])[k] *= size * size
                (&root_velocity_covariance[n, 0, 0])[k] *= size * size
            for j in range(count):
                k, anchor, share = 0, j, 0  # core joints have no offsets
                if j >= CORE:
                    k, share = j - CORE, 1
                    anchor = self.part_segments[self.part_of[k]]
                for i in range(3):
                    out_joints[n, j, i] = size * (joints[n, anchor, i] + share * state.offsets[k][i])
                    out_velocity[n, j, i] = size * (velocity[n, anchor, i] + share * state.velocity[k][i])
                    middles[n, i] += (1 - share) * out_joints[n, j, i] / CORE
                out_std[n, j] = size * hypot(std[n, anchor], share * state.offset_std[k])
                share *= ANGULAR_SPEED_STD * sqrt(dot(state.offsets[k], state.offsets[k]))
                out_velocity_std[n, j] = size * hypot(velocity_std[n, anchor], share)
                memcpy(&out_turns[n, j, 0], state.quaternions[anchor], 4 * sizeof(double))
                is_inferred[n, j] = not state.is_turn_seen[anchor] > 0
        return arrays

    def run(
        self, double[::1] start, evidence, double stature, Vector steps, bint is_learning,
    ):
        """Return the states (F, N) after each frame of a sequence, and R and P (2, F, 5, 9) before its correction.

        `start` (N,) is the state before the first frame; `evidence` an `ExtremityEvidence` of F frames; `steps` (F,)
        s since the frame before, infinite for the first; `is_learning` whether the sizes are learned.
        """
        cdef Py_ssize_t f, count = steps.shape[0]
        cdef Stack core = evidence[0], lifted = evidence[1], lifted_std = evidence[2], rays = evidence[3]
        cdef Rows weight = evidence[4]
        cdef Vector noise = evidence[5]
        cdef State state
        cdef Evidence seen
        states, predicted = np.empty((count, start.shape[0])), np.empty((2, count, PARTS, 9))
        cdef double[:, ::1] out = states
        cdef double[:, :, :, ::1] out_predicted = predicted
        memcpy(&state, &start[0], sizeof(state))
        for f in range(count):
            seen = Evidence(&core[f, 0, 0], &lifted[f, 0, 0], &lifted_std[f, 0, 0], &rays[f, 0, 0], &weight[f, 0],
                            noise[f], stature)
            self.advance(&state, &seen, steps[f], is_learning, &out_predicted[0, f, 0, 0], &out_predicted[1, f, 0, 0])
            memcpy(&out[f, 0], &state, sizeof(state))
        return states, predicted

    def finish(self, double[:, ::1] states, Rows weight, double stature):
        """Overwrite points, deviations and orientations in the states (F, N) of a sequence by what the others mean."""
        cdef Py_ssize_t f
        for f in range(states.shape[0]):
            if f > 0:
                memcpy((<State*> &states[f, 0]).quaternions, (<State*> &states[f - 1, 0]).quaternions,
                       CORE * 4 * sizeof(double))
            self.write_result(<State*> &states[f, 0], &weight[f, 0], stature, INFINITY)


def sum_derivatives(
    Vector template, Rows turn, double size, Vector origin, Vector lifted, double across, double along, Vector ray,
    double variance, double share,
):
    """Return the halved derivatives (7, 7) and (7,) of a point's sum of squares by d, t and b, at d = t = 0.

    `template` (3,) T of the point; `turn` (3, 3) R of the part; `size` m, e^b H; `origin` (3,) m, the anchor;
    `lifted` (3,) m, the point less the anchor in the lifted pose; `across` 1/m^2, information of the lifted pose
    across the line of sight; `along` 1/m^2, information along it; `ray` (2,) where the point was seen; `variance`
    m^2, of its image at the body; `share` g of the image.
    """
    cdef Sums sums
    cdef double[3][7] slopes
    cdef double[3] arm, error, sight
    cdef int i
    memset(&sums, 0, sizeof(sums))
    write_arm(&template[0], &turn[0, 0], size, arm, slopes)
    subtract(arm, &lifted[0], error)
    for i in range(3):
        sight[i] = origin[i] / sqrt(dot(&origin[0], &origin[0]))
    add_lifted(&sums, slopes, error, sight, across, along)
    for i in range(3):
        arm[i] += origin[i]
        slopes[i][3 + i] = 1.0
    add_ray(&sums, slopes, arm, &ray[0], variance, share)
    lower = np.array(<double[:7, :7]> &sums.hessian[0][0])
    return lower + np.tril(lower, -1).T, np.array(<double[:7]> sums.gradient)
