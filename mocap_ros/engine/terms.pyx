# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The terms of the objective of the joint solver: each has its formula, its cost and the linearisation of it.

A frame t has K weights theta of the base poses, a rotation R (body to camera), a scale s and a translation as
unknowns. Of the pose P_j = Q_0j + sum_l theta_l Q_lj there follow the scaled joints q_j = s R P_j, the lengths l_b
of the bones, and the features x: the K weights and, of the camera, the 6 elements of s R[:2], the 6 of R[:2], and
log s. Cauchy's loss is rho(a) = c^2 log(1 + a / c^2), c infinite for least squares. `joint.pyx` has the normal
equations; where terms of the joints' positions add their Gauss-Newton matrices by q_j, the others write to the
unknowns themselves.

To add a term, write a class with `measure` and the parts of the linearisation that it needs, its twin in
`tests/support/plain_objective.py`, and name it in `solvers.joint.objective.list_terms`.
"""

from libc.math cimport sqrt
from libc.string cimport memset

from mocap_ros.engine.batch import MIN_TIME_STEP_S

from mocap_ros.engine.batch cimport compute_loss
from mocap_ros.engine.block_banded cimport pad_rows  # and with it WIDE
from mocap_ros.engine.geometry cimport square, subtract

cdef extern from *:
    """
    /* Write u^T Q, with the direction u of a bone and the changes Q (3, K) of its vector with the weights. Add its
       matrix (a u u^T + c (I - u u^T)) times Q to the rows of its outer joint, and subtract it from the inner's. */
    WIDE static void add_bone(Py_ssize_t K, Py_ssize_t size, const double *u, const double *q, double a, double c,
                              double *__restrict along, double *__restrict outer, double *__restrict inner) {
        for (Py_ssize_t i = 0; i < K; i++)
            along[i] = u[0] * q[i] + u[1] * q[K + i] + u[2] * q[2 * K + i];
        for (int row = 0; row < 3; row++)
            for (Py_ssize_t i = 0; i < K; i++) {
                double force = c * q[row * K + i] + (a - c) * u[row] * along[i];
                outer[row * size + i] += force;
                inner[row * size + i] -= force;
            }
    }
    """
    void add_bone(int, int, double*, double*, double, double, double*, double*, double*) noexcept nogil

cdef double MIN_DEPTH = 0.1  # of that of the body's origin; a joint nearer to the camera is a failed solution
cdef double MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen
cdef double MIN_STEP_S = MIN_TIME_STEP_S
MAX_NOISE_RATIO = 1.5  # R; with more, runs and acrobatics lose what is gained elsewhere
cdef double MAX_RATIO = MAX_NOISE_RATIO


cdef class Term:
    """A term of the objective.

    Frames t are counted from the first of a sequence.
    """

    cdef double measure(self, Motion* of) noexcept nogil:
        """Return the cost of a sequence in m^2."""
        return 0

    cdef void begin(self, Motion* of) noexcept nogil:
        """Prepare the linearisation of the frames of a sequence."""

    cdef void pull_joints(self, Motion* of, int t, Pull* out) noexcept nogil:
        """Add what depends on the positions of the joints of frame t."""

    cdef void add_to_frame(self, Motion* of, int t, Equations* out) noexcept nogil:
        """Add what depends on the unknowns of frame t themselves."""

    cdef void add_to_motion(self, Motion* of, Equations* out) noexcept nogil:
        """Add what depends on several frames."""


cdef double find_error(Motion* of, int t, int j, double* error) noexcept nogil:
    """Write the error e_tj (2,) m of a joint's image and its square; return the depth d_tj over that of the origin."""
    cdef Frame* f = &of.frames[t]
    cdef double depth = max(1 + f.joints[j][2] / of.known[t].focal, MIN_DEPTH)
    cdef int i
    for i in range(2):
        error[i] = (f.joints[j][i] + f.translation[i]) / depth - of.known[t].image[j][i]
    error[2] = error[0] * error[0] + error[1] * error[1]
    return depth


cdef class Reprojection(Term):
    """sum_tj w_tj rho(|e_tj|^2) / v,    e_j = (q_j[:2] + translation) / d_j - x_j,    d_j = 1 + q_jz / f.

    v is the square of the ratio r of the image noise to that of the reference of 10 mm. Under more noise the scale of
    the loss is c max(r, 1).
    """

    def __init__(self, double robust_scale):
        self.robust_scale = robust_scale

    cdef double find_robust_scale(self, Sequence* s) noexcept nogil:
        return self.robust_scale * max(s.noise_ratio, 1)

    cdef void settle(self, Motion* of, double robust_scale) noexcept nogil:
        """Move the translations of a sequence by a step of the robust fit with this c."""
        cdef int t, j, i
        cdef double depth, weight, total
        cdef double[3] error
        cdef double[2] shift
        for t in range(of.sequence.count):
            total = shift[0] = shift[1] = 0
            for j in range(JOINTS):
                depth = find_error(of, t, j, error)
                weight = of.known[t].score[j] / depth
                weight /= 1 + error[2] / square(robust_scale)
                total += weight / depth
                for i in range(2):
                    shift[i] += weight * error[i]
            for i in range(2):
                of.frames[t].translation[i] -= shift[i] / max(total, MIN_TOTAL_WEIGHT)

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int t, j
        cdef double c = self.find_robust_scale(of.sequence), cost = 0
        cdef double[3] error
        for t in range(of.sequence.count):
            for j in range(JOINTS):
                if of.known[t].score[j] > 0:
                    find_error(of, t, j, error)
                    cost += of.known[t].score[j] * compute_loss(error[2], c)
        return cost / square(of.sequence.noise_ratio)

    cdef void pull_joints(self, Motion* of, int t, Pull* out) noexcept nogil:
        """With E = de / dq d = (1 0 a; 0 1 b): M = v E^T E, U = v E^T and m = v d E^T e."""
        cdef int j, i, k
        cdef double c = self.find_robust_scale(of.sequence), depth, weight
        cdef double[3] error
        cdef double[2][3] slope = [[1, 0, 0], [0, 1, 0]]
        for j in range(JOINTS):
            depth = find_error(of, t, j, error)
            weight = of.known[t].score[j] / square(of.sequence.noise_ratio) / (depth * depth)
            weight /= 1 + error[2] / square(c)
            out.weight += weight
            for i in range(2):
                slope[i][2] = -(error[i] + of.known[t].image[j][i]) / of.known[t].focal
                out.by_translation[i] += weight * depth * error[i]
            for i in range(3):
                for k in range(2):
                    out.mixed[j][2 * i + k] += weight * slope[k][i]
                    out.force[j][i] += weight * depth * slope[k][i] * error[k]
                for k in range(3):
                    out.matrix[j][3 * i + k] += weight * (slope[0][i] * slope[0][k] + slope[1][i] * slope[1][k])


cdef class LiftedPoses(Term):
    """omega sum_tj rho(sum_i (q_tji - y_tji)^2 pi_tji), lifted poses y with the precisions pi."""

    cdef readonly double weight, robust_scale

    def __init__(self, double weight, double robust_scale):
        self.weight, self.robust_scale = weight, robust_scale

    cdef inline double find_square(self, Motion* of, int t, int j) noexcept nogil:
        cdef int i
        cdef double distance, total = 0
        for i in range(3):
            distance = of.frames[t].joints[j][i] - of.known[t].lifted[j][i]
            total += of.known[t].precision[j][i] * distance * distance
        return total

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int t, j
        cdef double cost = 0
        for t in range(of.sequence.count):
            for j in range(JOINTS):
                cost += compute_loss(self.find_square(of, t, j), self.robust_scale)
        return self.weight * cost

    cdef void pull_joints(self, Motion* of, int t, Pull* out) noexcept nogil:
        cdef int j, i
        cdef double share, stiffness
        for j in range(JOINTS):
            share = 1 + self.find_square(of, t, j) / square(self.robust_scale)
            for i in range(3):
                stiffness = self.weight * of.known[t].precision[j][i] / share
                out.matrix[j][4 * i] += stiffness
                out.force[j][i] += stiffness * (of.frames[t].joints[j][i] - of.known[t].lifted[j][i])


cdef class BoneLengths(Term):
    """beta sum_tb (l_tb - m_b)^2, bone lengths and their means over the sequence (TPAMI 2016, eq. 20).

    The means are over the F frames of the sequence and the E before it, E (m_b - m_0b)^2 of which are the cost. They
    are eliminated exactly: with G the gradients of sum_t sqrt(beta) l_tb, a column a bone, this subtracts
    G G^T / (F + E) from the matrix. The Gauss-Newton matrix lacks the second derivatives of the lengths, and then
    needs several times as many steps; those of bones that are too long are positive semidefinite and are put in.

    Args:
        weight: m^2 / m^2, beta.
        arrays: `models.base_poses.ModelArrays`, whose first K base poses count.
    """

    cdef readonly double weight
    cdef const long long[::1] parents, children
    cdef const double[:, ::1] changes  # (3 B, K)
    cdef double[BONES] mean

    def __init__(self, double weight, arrays, int components):
        self.weight, self.parents, self.children = weight, arrays.parents, arrays.children
        self.changes = arrays.bones[:, :components].copy()

    cdef void begin(self, Motion* of) noexcept nogil:
        cdef int b, t
        for b in range(BONES):
            self.mean[b] = of.sequence.earlier_frames * of.sequence.earlier_lengths[b]
            for t in range(of.sequence.count):
                self.mean[b] += of.frames[t].length[b]
            self.mean[b] /= of.sequence.count + of.sequence.earlier_frames

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int b, t
        cdef double change, cost = 0
        self.begin(of)
        for b in range(BONES):
            change = self.mean[b] - of.sequence.earlier_lengths[b]
            cost += of.sequence.earlier_frames * change * change
            for t in range(of.sequence.count):
                change = of.frames[t].length[b] - self.mean[b]
                cost += change * change
        return self.weight * cost

    cdef void add_to_frame(self, Motion* of, int t, Equations* out) noexcept nogil:
        cdef int b, i, K = out.components
        cdef double excess, across, root = sqrt(self.weight)
        cdef double[3] direction
        cdef double[MAX_COMPONENTS] along
        cdef double* block = out.blocks + t * out.frame_size
        cdef double* vectors = out.vectors + t * (K + CAMERA) * BONES
        cdef Frame* f = &of.frames[t]
        for b in range(BONES):
            subtract(f.pose + 3 * self.children[b], f.pose + 3 * self.parents[b], direction)
            for i in range(3):
                direction[i] /= f.length[b]
            excess = f.length[b] - self.mean[b]
            across = self.weight * max(excess / f.length[b], 0)
            add_bone(
                K, out.width, direction, &self.changes[3 * b, 0], self.weight, across, along,
                out.weighted + 3 * self.children[b] * out.width, out.weighted + 3 * self.parents[b] * out.width,
            )
            for i in range(K):
                vectors[i * BONES + b] = root * along[i]
                block[i * out.width + K + CAMERA] += self.weight * excess * along[i]


cdef class Prior(Term):
    """sum_tl lambda_l theta_tl^2, prior of the base poses.

    Args:
        weight: (K,) lambda.
    """

    cdef readonly object weight
    cdef const double[::1] weights

    def __init__(self, weight):
        self.weight = self.weights = weight

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int t, i
        cdef double cost = 0
        for t in range(of.sequence.count):
            for i in range(self.weights.shape[0]):
                cost += self.weights[i] * of.frames[t].features[i] * of.frames[t].features[i]
        return cost

    cdef void add_to_frame(self, Motion* of, int t, Equations* out) noexcept nogil:
        cdef int i
        cdef double* row = out.blocks + t * out.frame_size
        for i in range(out.components):
            row[i] += self.weights[i]
            row[out.components + CAMERA] += self.weights[i] * of.frames[t].features[i]
            row += out.width


cdef class Level(Term):
    """nu sum_t (z_tx^2 + z_tz^2), z the direction of the body's z axis in the camera: it is level.

    Args:
        weight: m^2, nu.
    """

    cdef readonly double weight

    def __init__(self, double weight):
        self.weight = weight

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int t
        cdef double cost = 0
        for t in range(of.sequence.count):
            cost += of.frames[t].rotation[0][2] * of.frames[t].rotation[0][2]
            cost += of.frames[t].rotation[2][2] * of.frames[t].rotation[2][2]
        return self.weight * cost

    cdef void add_to_frame(self, Motion* of, int t, Equations* out) noexcept nogil:
        cdef int i, j
        cdef double x = of.frames[t].rotation[0][2], y = of.frames[t].rotation[1][2], z = of.frames[t].rotation[2][2]
        cdef double[3] by_x = [0, z, -y]
        cdef double[3] by_z = [y, -x, 0]
        cdef double* row = out.blocks + t * out.frame_size + out.components * (out.width + 1)
        for i in range(3):
            for j in range(3):
                row[j] += self.weight * (by_x[i] * by_x[j] + by_z[i] * by_z[j])
            row[CAMERA] += self.weight * (x * by_x[i] + z * by_z[i])
            row += out.width


cdef class FiniteDifference(Term):
    """sum_t sum_f w_f (sum_e c_te x_(t+e)f)^2, changes of the features over D + 1 neighbouring frames.

    Args:
        weight: (K + 13,) w.
    """

    cdef readonly object weight
    cdef const double[::1] weights

    def __init__(self, weight):
        self.weight = self.weights = weight

    cdef void write_factors(self, Motion* of, int t, double* c) noexcept nogil:
        """Write the factors c_t."""

    cdef inline double find_change(self, double* c, Frame* frames, int f) noexcept nogil:
        cdef int e
        cdef double change = 0
        for e in range(self.order + 1):
            change += c[e] * frames[e].features[f]
        return change

    cdef double measure(self, Motion* of) noexcept nogil:
        cdef int t, f
        cdef double change, cost = 0
        cdef double[3] c
        for t in range(of.sequence.count - self.order):
            self.write_factors(of, t, c)
            for f in range(self.weights.shape[0]):
                if self.weights[f] > 0:
                    change = self.find_change(c, &of.frames[t], f)
                    cost += self.weights[f] * change * change
        return cost

    cdef void add_to_motion(self, Motion* of, Equations* out) noexcept nogil:
        cdef int t, first, e, d, f
        cdef double[3] c
        cdef double[3] products
        cdef double[MAX_COMPONENTS + FEATURES] pull
        for t in range(of.sequence.count):
            memset(products, 0, sizeof(products))
            memset(pull, 0, sizeof(pull))
            for first in range(max(t - self.order, 0), min(t + 1, of.sequence.count - self.order)):  # changes with frame t
                self.write_factors(of, first, c)
                e = t - first
                for d in range(self.order + 1 - e):
                    products[d] += c[e] * c[e + d]
                for f in range(self.weights.shape[0]):
                    if self.weights[f] > 0:
                        pull[f] += self.weights[f] * c[e] * self.find_change(c, &of.frames[first], f)
            self.add_pairs(t, min(self.order, of.sequence.count - 1 - t), products, pull, out)

    cdef void add_pairs(
        self, int t, int later, double* products, double* pull, Equations* out
    ) noexcept nogil:
        """Add the half gradient by the features of frame t, and products of factors times w by it and later ones."""
        cdef int K = out.components, d, f, i, j, size = K + CAMERA * CAMERA
        cdef double* block = out.blocks + t * out.frame_size
        cdef double* coupling = out.couplings + (t * out.distances - 1) * size
        cdef double* slope = out.slopes + t * FEATURES * CAMERA
        cdef double* row
        cdef double value
        for f in range(K):
            block[f * (out.width + 1)] += self.weights[f] * products[0]
            block[f * out.width + K + CAMERA] += pull[f]
            for d in range(1, later + 1):
                coupling[d * size + f] += self.weights[f] * products[d]
        block += K * (out.width + 1)
        for f in range(FEATURES):
            for i in range(CAMERA if self.weights[K + f] > 0 else 0):
                block[i * out.width + CAMERA] += pull[K + f] * slope[i]
                for d in range(later + 1):
                    row = coupling + d * size + K + CAMERA * i if d > 0 else block + i * out.width
                    value = self.weights[K + f] * products[d] * slope[i]
                    for j in range(CAMERA):
                        row[j] += value * slope[d * FEATURES * CAMERA + j]
            slope += CAMERA


cdef class Velocity(FiniteDifference):
    """sum_tf w_f share (x_(t+1)f - x_tf)^2 / dt_t, with the sequence's `motion_share`."""

    def __init__(self, weight):
        super().__init__(weight)
        self.order = 1

    cdef void write_factors(self, Motion* of, int t, double* c) noexcept nogil:
        c[1] = sqrt(of.sequence.motion_share / max(of.known[t + 1].time - of.known[t].time, MIN_STEP_S))
        c[0] = -c[1]


cdef class Acceleration(FiniteDifference):
    """The integral of the squared acceleration, whatever the frame rate, which gives way to fast motion.

        sum_t share alpha_t |v_(t+1) - v_t|^2 / h_t,    v_t = (x_(t+1) - x_t) / dt_t,    h_t = (dt_t + dt_(t+1)) / 2
        alpha_t = alpha / (1 + a_t^4 / (A r)^4)

    a_t is the RMS acceleration about frame t (`solvers.joint.activity`), A that at which the weight is halved under
    the reference noise, and r the image noise over it, between 1 and R.

    Args:
        weight: (K + 13,) alpha of each feature.
        typical: A.
        activity: (N,) a_t^2 of all frames; None for rest.
    """

    cdef readonly double typical
    cdef readonly object activity
    cdef const double[::1] squares

    def __init__(self, weight, double typical=1, activity=None):
        super().__init__(weight)
        self.order, self.typical, self.activity, self.squares = 2, typical, activity, activity

    cdef void write_factors(self, Motion* of, int t, double* c) noexcept nogil:
        cdef double a = 1 / max(of.known[t + 1].time - of.known[t].time, MIN_STEP_S)
        cdef double b = 1 / max(of.known[t + 2].time - of.known[t + 1].time, MIN_STEP_S)
        cdef double share = of.sequence.motion_share * 2 * a * b / (a + b), limit
        if self.squares is not None:
            limit = self.typical * min(max(of.sequence.noise_ratio, 1), MAX_RATIO)
            share /= 1 + square(self.squares[of.sequence.start + t] / square(limit))
        share = sqrt(share)
        c[0], c[1], c[2] = a * share, -(a + b) * share, b * share
