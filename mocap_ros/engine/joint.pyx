# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The objective of the joint solver, its normal equations, and Levenberg-Marquardt.

A frame t has K weights theta of the base poses, a rotation R (body to camera), a scale s and a translation as
unknowns. A step x has n = K + 4 numbers a frame: changes of the weights, a rotation vector w with R <- exp([w]x) R,
and the change of log s; the translation is eliminated. With the pose P_j = Q_0j + sum_l theta_l Q_lj of a frame, its
scaled joints q_j = s R P_j, and Cauchy's loss rho(a) = c^2 log(1 + a / c^2) (c infinite: least squares), the
objective of a sequence is the sum over its frames of

    sum_j w_j rho(|e_j|^2) / v          reprojection: e_j = (q_j[:2] + translation) / d_j - x_j, d_j = 1 + q_jz / f
  + sum_b beta_b (l_b - m_b)^2          bone lengths l_b and their means m_b over the sequence (TPAMI 2016, eq. 20)
  + sum_l lambda_l theta_l^2            prior of the base poses
  + omega sum_j rho(sum_i (q_ji - y_ji)^2 pi_ji)              lifted poses y with the precisions pi
  + sum_f w_f (sum_e c_te x_(t+e)f)^2   differences of order 1 or 2 of the features x of neighbouring frames

with v the variance of the image noise over that of the reference of 10 mm. The features are the K weights and, of
the camera, the 6 elements of s R[:2], the 6 of R[:2], and log s.

Normal equations (A - G G^T / F) x = -g, A block banded (`block_banded`). Terms of the joints' positions have
Gauss-Newton matrices M_j (3, 3) and half gradients m_j (3,) by q_j, and U_j (3, 2) are the mixed second derivatives
by q_j and the translation. In the body frame, where dq_j / dx = s R J_j and the first K columns of J_j are always
the same, these are S_j = s^2 R^T M_j R, s R^T m_j and s R^T U_j. Bones add their matrices to those of the joints at
their ends. One product then gives the block of a frame, its gradient, and u = sum_j J_j^T s R^T U_j:

    J^T (S J, m, U),    less u u^T / w for the elimination of the translation

with w the second derivative by the translation.

The mean bone lengths are eliminated exactly: with G the gradients of sum_t sqrt(beta_b) l_tb, a column a bone, they
subtract G G^T / F, of rank B. The Gauss-Newton matrix lacks the second derivatives of the lengths, and then needs
several times as many steps; those of bones that are too long are positive semidefinite and are put in. The means
are B unknowns z more, which are eliminated last. With A = U^T U under damping, y = U^-T g and V = U^-T G,

    (F I - V^T V) z = -V^T y,    x = -U^-1 (y - V z)

Sequences are not coupled: each has a damping of its own, and steps until it has converged.

Sizes: P sequences, N frames of all and F of one, J joints, B bones, K base poses, T differences of order up to D.
"""

from libc.math cimport INFINITY, NAN, exp, isfinite, log1p, sqrt
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.blas cimport multiply_vector, multiply_vector_transposed
from mocap_ros.engine.block_banded cimport (
    TILE_COLUMNS, TILE_ROWS, System, add_products, add_up, factorise_blocks, pad_columns, pad_rows, solve_backward,
    solve_forward,
)
from mocap_ros.engine.geometry cimport multiply as multiply_3x3, rotation_from_vector

cdef extern from *:
    """
    /* T = S J: S (3, 3), J (3, size). */
    WIDE static void weigh_rows(Py_ssize_t size, const double *s, const double *j, double *__restrict t) {
        for (Py_ssize_t i = 0; i < size; i++)
            for (int row = 0; row < 3; row++)
                t[row * size + i] = s[3 * row] * j[i] + s[3 * row + 1] * j[size + i]
                                  + s[3 * row + 2] * j[2 * size + i];
    }

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
    void weigh_rows(Py_ssize_t, const double*, const double*, double*) noexcept nogil
    void add_bone(
        Py_ssize_t, Py_ssize_t, const double*, const double*, double, double, double*, double*, double*
    ) noexcept nogil

cdef enum:
    CAMERA = 4  # unknowns of a camera: rotation vector and log s
    FEATURES = 13  # of a camera: s R[:2], R[:2], log s
    SINGULAR = -1
    MAX_ITERATIONS = 0
    CONVERGED = 1
    NO_LOWER_STEP = 2
    SQUARES = 14  # K^(2^14): what belongs to an eigenvalue that is smaller by 1 % is gone to the last digit

cdef double NOISE_REFERENCE = 0.01  # m
cdef double MIN_DEPTH = 0.1  # of that of the body's origin; a joint nearer to the camera is a failed solution
cdef double MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen
cdef double MIN_LENGTH = 1e-9  # m; guards the division by the length of a bone
cdef double MAX_LOG_SCALE_STEP = 1  # of one step; a larger one is a failed linearisation
cdef double MIN_DIAGONAL = 1e-12  # added to the diagonal, for unknowns on which nothing depends
cdef double LARGE = 1e300  # keeps a matrix positive definite whatever is subtracted
cdef double MIN_INFORMATION = 1e-9  # m^2; keeps a block solvable in which the image does not determine an unknown
cdef double MIN_DAMPING = 1e-5  # relative; a smaller damping changes no digit of a step that matters
cdef double MAX_DAMPING = 1e8  # relative; a sequence whose steps are still refused under more is at its minimum
cdef double DAMPING_AFTER_SUCCESS = 0.2  # factor; tuned on CMU views for few steps, as the next
cdef double DAMPING_AFTER_FAILURE = 10
DAMPINGS = MIN_DAMPING, MAX_DAMPING, DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE  # for `periodic`
cdef double ROUGHNESS_STEP_S = 1.0 / 30  # s between the frames of which third differences are taken
cdef double MAX_ROUGHNESS_STEP_S = 0.05  # s; third differences over longer ones are those of the motion
cdef double ROUGHNESS_LOSS_M = 0.02  # m; c of the loss of third differences: joints jump in single frames
cdef double MOTION_ROUGHNESS_M = 0.002  # m; q of people who move, without noise
cdef double NOISE_OVER_ROUGHNESS = 4.0  # 1; detectors err by 3 to 5 times what is new in a frame of 30 Hz
cdef double WHITE_CORRELATION = 0.27  # of third differences two frames apart; 0.3 of white noise, less by motion
cdef double WALK_CORRELATION = 1.0 / 6  # the same, of errors that wander
cdef double MIN_FREE_SHARE = 0.05  # of the coordinates; so many still measure the noise if all are fitted
cdef int COUNTED_FRAMES = 3  # frames of a sequence, at least, in which absorbed coordinates are counted
cdef double MIN_SCALE = 1e-9  # px/m; guards against a scale of zero where a lifted pose is degenerate
cdef int COUNTED_FRAME_STEP = 15  # frames; of a longer sequence one further frame in so many is counted


cdef struct Frame:
    # Where the numbers of a frame at a point are; they lie one after the other in this order.
    double* theta  # (K,) m
    double* features  # (13,) of the camera
    double* rotation  # (3, 3)
    double* log_scale
    double* translation  # (2,) m
    double* scaled_pose  # (J, 3) m, q
    double* depth  # (J,) d
    double* error  # (J, 2) m, e
    double* squared  # (J,) m^2, |e|^2
    double* direction  # (B, 3) unit vectors along the bones, body frame
    double* length  # (B,) m
    double* excess  # (B,) m, length less the mean of the sequence


cdef struct Joint:
    # M_j = v E^T E + diag(stiffness), U_j = v E^T, E = (1 0 a; 0 1 b), and m_j.
    double v, a, b
    double[3] stiffness, gradient
    double[2] pull  # half gradient by the translation


cdef inline double compute_loss(double squared, double c) noexcept nogil:
    """Return rho."""
    return squared if c == INFINITY else c * c * log1p(squared / (c * c))


cdef void write_features(Frame* f) noexcept nogil:
    cdef int i
    cdef double scale = exp(f.log_scale[0])
    for i in range(6):
        f.features[i], f.features[6 + i] = scale * f.rotation[i], f.rotation[i]
    f.features[12] = f.log_scale[0]


cdef void differentiate_features(Frame* f, double* out) noexcept nogil:
    """Write the derivatives (13, 4) of the camera's features by the rotation vector and log s."""
    cdef int i, column
    cdef double scale = exp(f.log_scale[0]), factor
    cdef double* row
    memset(out, 0, FEATURES * CAMERA * sizeof(double))
    for i in range(12):
        factor, column = (scale if i < 6 else 1), i % 3
        row = out + i * CAMERA
        if i % 6 < 3:  # of the first image axis
            row[1], row[2] = factor * f.rotation[6 + column], -factor * f.rotation[3 + column]
        else:
            row[0], row[2] = -factor * f.rotation[6 + column], factor * f.rotation[column]
        if i < 6:
            row[3] = f.features[i]
    out[12 * CAMERA + 3] = 1


cdef inline int count_frames_of_step(double step) noexcept nogil:
    """Return how many frames, `step` s apart, are a step between the points of a third difference."""
    return max(<int> (ROUGHNESS_STEP_S / max(step, 1e-4) + 0.5), 1)


cdef inline double take_third_difference(const double[:, :, :] points, int t, int j, int i, int s) noexcept nogil:
    """Return the third difference of a coordinate over the frames t - 3 s, ..., t."""
    return points[t, j, i] - 3 * points[t - s, j, i] + 3 * points[t - 2 * s, j, i] - points[t - 3 * s, j, i]


cdef double compute_noise_growth(
    const double[:, :, :] points, const double[:, :] score, const double[:] times, int start, int end, double unit
) noexcept nogil:
    """g of `solvers.joint.noise_annealing`: the errors of points over what is new of them in each frame.

    Points (F, J, 2) are, times `unit`, in m; scores (F, J); times (F,) s; of the frames from `start` to before `end`.
    """
    cdef int t, j, i, k, s
    cdef double step, products = 0, powers = 0, weight, product
    cdef double[2] square
    cdef double[2][2] change
    if end - start < 6:
        return NOISE_OVER_ROUGHNESS
    step = (times[end - 1] - times[start]) / (end - start - 1)
    s = count_frames_of_step(step)
    for t in range(start + 5 * s, end):
        if times[t] - times[t - 5 * s] > 7.5 * s * step:
            continue
        for j in range(points.shape[1]):
            weight = score[t, j]
            for k in range(1, 6):
                weight = min(weight, score[t - k * s, j])
            if not weight > 0:
                continue
            product = 0
            for k in range(2):
                square[k] = 0
                for i in range(2):
                    change[k][i] = unit * take_third_difference(points, t - 2 * k * s, j, i, s)
                    square[k] += change[k][i] * change[k][i]
            for i in range(2):
                product += change[0][i] * change[1][i]
            weight /= 1 + max(square[0], square[1]) / (20 * ROUGHNESS_LOSS_M * ROUGHNESS_LOSS_M)
            products += weight * product
            powers += weight * (square[0] + square[1]) / 2
    product = products / powers if powers > 0 else 0
    product = (WHITE_CORRELATION - product) / (WHITE_CORRELATION - WALK_CORRELATION)
    return 1 + (NOISE_OVER_ROUGHNESS - 1) * min(max(product, 0.0), 1.0)


cdef class JointProblem:
    """The objectives of P sequences with N frames in all, a point, and what Levenberg-Marquardt needs.

    Args:
        objective: a `solvers.joint.objective.JointObjective`, whose arrays are C-contiguous.
        arrays: `models.base_poses.ModelArrays` of its model.

    Attributes:
        diagonal: (N, n, n) blocks of the normal equations; only their upper triangles are written.
        gradient: (N, n) half the gradient.
        bone_vectors: (N, n, B) G.
        coupling: (N, D, K + 16) blocks in the rows of frame t + d + 1 and the columns of frame t: the diagonal of the
            weights, and the block of the cameras (4, 4).
        cost: (P,) m^2.
        iterations: (P,) number of steps that were tried.
        status: (P,) `SolverStatus`.
    """

    cdef readonly int sequences, frames, joints, bones_count, components, unknowns, distances  # P, N, J, B, K, n, D
    # the objective
    cdef const long long[::1] starts, counts, earlier_frames, parents, children
    cdef const unsigned char[::1] is_free
    cdef const double[:, :, ::1] image, lifted, precision  # (N, J, 2), (N, J, 3), (N, J, 3)
    cdef const double[:, ::1] score, earlier_lengths, basis, mean, bones  # (N, J), (P, B), (3J, K), (J, 3), (3B, K)
    cdef const double[::1] times, focal, noise_ratio, bone_weight, prior  # (N,), (P,), (B,), (K,)
    cdef double robust_scale, lifter_weight, lifter_robust_scale
    cdef const long long[::1] orders
    cdef const double[:, :, ::1] factors  # (T, N, 3)
    cdef const double[:, ::1] feature_weight  # (T, K + 13)
    # the current point, that after a step, and that of the normal equations: a `Frame` in each row, of this width
    cdef readonly object point
    cdef double[:, ::1] current, trial, linearised
    cdef int width
    cdef dict fields
    # the normal equations, for Python and in typed views
    cdef readonly object diagonal, gradient, bone_vectors, coupling
    cdef double[:, :, ::1] equations  # (N, n, n + 3) A, g and u, filled up for `block_banded`
    cdef double[:, :, ::1] vectors, couplings
    # the state of Levenberg-Marquardt, likewise
    cdef readonly object cost, iterations, status
    cdef double[::1] costs, dampings
    cdef long long[::1] tried, ends
    cdef unsigned char[::1] done, outdated, has_step
    cdef double[:, :, ::1] last_factor  # (P, n, n) of the last step: U_tt of the last frame, filled up
    # working memory: J and (S J, m, U), (3 J, n + 3) filled up; the rows of a sequence, and of a frame alone
    cdef double[:, ::1] jacobian, weighted, alone, products, step, by_translation
    cdef double[:, :, ::1] system, feature_jacobian
    cdef double[::1] along, pose, means

    def __init__(self, objective, arrays):
        batch, K, differences = objective.batch, len(objective.prior), objective.differences
        cdef Py_ssize_t largest = int(max(batch.counts))
        self.orders = np.array([d.order for d in differences], np.int64)
        self.feature_weight = np.array([d.weight for d in differences]).reshape(-1, K + FEATURES)
        self.starts, self.counts, self.is_free = batch.starts, batch.counts, batch.is_free.view(np.uint8)
        self.image, self.score, self.focal = batch.image, batch.score, batch.focal
        self.times = batch.times
        self.lifted, self.precision = batch.lifted, batch.precision
        self.earlier_lengths, self.earlier_frames = batch.earlier_lengths, batch.earlier_frames
        self.mean, self.parents, self.children = objective.model.mean, arrays.parents, arrays.children
        self.basis = np.ascontiguousarray(arrays.components[:, :K])
        self.bones = np.ascontiguousarray(arrays.bones[:, :K])
        self.robust_scale = objective.robust_scale
        self.bone_weight, self.prior = objective.bone_weight, objective.prior
        self.lifter_weight, self.lifter_robust_scale = objective.lifter_weight, objective.lifter_robust_scale
        self.sequences, self.frames, self.joints = len(batch.counts), len(batch.times), len(objective.model.mean)
        self.bones_count, self.components = len(arrays.parents), K
        self.weigh(objective.noise_ratio, objective.factors)
        cdef int N = self.frames, J = self.joints, B = self.bones_count, n = K + CAMERA
        cdef int D = max((d.order for d in differences), default=1)
        self.unknowns, self.distances = n, D
        self.width = K + FEATURES + 12 + 7 * J + 5 * B
        self.fields = {  # first number, end and shape of what Python reads
            'theta': (0, K, (N, K)), 'rotation': (K + 13, K + 22, (N, 3, 3)), 'log_scale': (K + 22, K + 23, N),
            'translation': (K + 23, K + 25, (N, 2)), 'squared': (K + 25 + 6 * J, K + 25 + 7 * J, (N, J)),
        }
        self.point = np.zeros((N, self.width))
        self.current, self.trial = self.point, np.zeros((N, self.width))
        self.linearised = np.zeros((N, self.width))
        cdef int rows = pad_rows(n), size = pad_columns(n), width = pad_columns(n + 3), right = pad_columns(B + 1)
        equations = np.zeros((N, rows, width))
        self.equations, self.diagonal, self.gradient = equations, equations[:, :n, :n], equations[:, :n, n]
        self.bone_vectors = np.zeros((N, n, B))
        self.coupling = np.empty((N, D, K + CAMERA * CAMERA))
        self.vectors, self.couplings = self.bone_vectors, self.coupling
        self.last_factor = np.zeros((self.sequences, rows, size))
        self.cost, self.dampings = np.zeros(self.sequences), np.zeros(self.sequences)
        self.iterations, self.status = np.zeros(self.sequences, np.int64), np.zeros(self.sequences, np.int64)
        self.costs, self.tried, self.ends = self.cost, self.iterations, self.status
        self.done, self.outdated, self.has_step = np.zeros((3, self.sequences), np.uint8)
        self.jacobian, self.weighted = np.zeros((3 * J, width)), np.zeros((3 * J, width))
        self.jacobian[:, :K] = self.basis
        self.system = np.zeros((largest, rows, (1 + D) * size + right))
        self.alone = np.zeros((rows, size + pad_columns(3 * J)))
        self.products, self.means = np.zeros((right, right)), np.zeros(right)
        self.step, self.feature_jacobian = np.zeros((largest, size)), np.empty((largest, FEATURES, CAMERA))
        self.along, self.pose, self.by_translation = np.empty(K), np.empty(3 * J), np.zeros((2, width))

    cdef inline Frame view(self, double* numbers) noexcept nogil:
        cdef int J = self.joints, B = self.bones_count
        cdef Frame f
        f.theta = numbers
        f.features = f.theta + self.components
        f.rotation = f.features + FEATURES
        f.log_scale = f.rotation + 9
        f.translation = f.log_scale + 1
        f.scaled_pose = f.translation + 2
        f.depth = f.scaled_pose + 3 * J
        f.error = f.depth + J
        f.squared = f.error + 2 * J
        f.direction = f.squared + J
        f.length = f.direction + 3 * B
        f.excess = f.length + B
        return f

    # Measurement

    cdef void project(self, int t, Frame* f, double robust_scale, bint settle) noexcept nogil:
        """Write depths and errors of a frame, after one robust step of the translation if it is to settle."""
        cdef int j
        cdef double d, x, y, u, total = 0, shift_x = 0, shift_y = 0
        for j in range(self.joints):
            d = max(1 + f.scaled_pose[3 * j + 2] / self.focal[t], MIN_DEPTH)
            x = (f.scaled_pose[3 * j] + f.translation[0]) / d - self.image[t, j, 0]
            y = (f.scaled_pose[3 * j + 1] + f.translation[1]) / d - self.image[t, j, 1]
            f.depth[j], f.error[2 * j], f.error[2 * j + 1], f.squared[j] = d, x, y, x * x + y * y
            u = self.score[t, j] / (1 + f.squared[j] / (robust_scale * robust_scale)) / d
            total += u / d
            shift_x -= u * x
            shift_y -= u * y
        if not settle:
            return
        total = max(total, MIN_TOTAL_WEIGHT)
        shift_x, shift_y = shift_x / total, shift_y / total
        f.translation[0] += shift_x
        f.translation[1] += shift_y
        for j in range(self.joints):
            x, y = f.error[2 * j] + shift_x / f.depth[j], f.error[2 * j + 1] + shift_y / f.depth[j]
            f.error[2 * j], f.error[2 * j + 1], f.squared[j] = x, y, x * x + y * y

    cdef inline double robust_scale_of(self, int p) noexcept nogil:
        """c of the reprojection, which grows with noise above the reference."""
        return self.robust_scale * max(self.noise_ratio[p], 1.0)

    cdef double measure(self, int p, double* point, double settle_scale) noexcept nogil:
        """Write what follows from the unknowns of a sequence at a point (N, width); return its objective in m^2.

        `settle_scale` m is the c under which the translations settle by one step; 0 keeps them.
        """
        cdef int start = self.starts[p], count = self.counts[p], J = self.joints, B = self.bones_count
        cdef int t, i, j, b, row, K = self.components
        cdef double scale, x, y, z, total, own, c = self.robust_scale_of(p)
        cdef double weight = 1 / (self.noise_ratio[p] * self.noise_ratio[p]), cost = 0
        cdef bint has_lifted = self.lifted.shape[0] > 0
        cdef double* pose = &self.pose[0]
        cdef Frame f
        for t in range(start, start + count):
            f = self.view(point + t * self.width)
            memcpy(pose, &self.mean[0, 0], 3 * J * sizeof(double))
            multiply_vector(3 * J, K, 1, &self.basis[0, 0], f.theta, 1, pose)
            scale = exp(f.log_scale[0])
            for j in range(J):
                for i in range(3):
                    f.scaled_pose[3 * j + i] = scale * (
                        f.rotation[3 * i] * pose[3 * j]
                        + f.rotation[3 * i + 1] * pose[3 * j + 1]
                        + f.rotation[3 * i + 2] * pose[3 * j + 2]
                    )
            self.project(t, &f, settle_scale if settle_scale > 0 else c, settle_scale > 0)
            for j in range(J):
                if self.score[t, j] > 0:
                    cost += weight * self.score[t, j] * compute_loss(f.squared[j], c)
                if has_lifted:
                    total = 0
                    for i in range(3):
                        x = f.scaled_pose[3 * j + i] - self.lifted[t, j, i]
                        total += self.precision[t, j, i] * x * x
                    cost += self.lifter_weight * compute_loss(total, self.lifter_robust_scale)
            for i in range(K):
                cost += self.prior[i] * f.theta[i] * f.theta[i]
            for b in range(B):
                row, i = 3 * self.children[b], 3 * self.parents[b]
                x, y, z = pose[row] - pose[i], pose[row + 1] - pose[i + 1], pose[row + 2] - pose[i + 2]
                own = max(sqrt(x * x + y * y + z * z), MIN_LENGTH)
                f.length[b] = own
                f.direction[3 * b], f.direction[3 * b + 1], f.direction[3 * b + 2] = x / own, y / own, z / own
            write_features(&f)
        for b in range(B):
            total = self.earlier_frames[p] * self.earlier_lengths[p, b]
            for t in range(start, start + count):
                total += self.view(point + t * self.width).length[b]
            own = total / (count + self.earlier_frames[p])
            x = own - self.earlier_lengths[p, b]
            cost += self.earlier_frames[p] * self.bone_weight[b] * x * x
            for t in range(start, start + count):
                f = self.view(point + t * self.width)
                f.excess[b] = f.length[b] - own
                cost += self.bone_weight[b] * f.excess[b] * f.excess[b]
        return cost + self.measure_differences(p, point)

    cdef double measure_differences(self, int p, double* point) noexcept nogil:
        """Return the value of all differences of a sequence."""
        cdef int term, t, e, i, start = self.starts[p], order
        cdef double change, cost = 0
        cdef const double* c
        for term in range(self.orders.shape[0]):
            order = self.orders[term]
            for t in range(start, start + self.counts[p] - order):
                c = &self.factors[term, t, 0]
                for i in range(self.components + FEATURES):
                    if self.feature_weight[term, i] == 0:
                        continue
                    change = 0
                    for e in range(order + 1):
                        change += c[e] * point[(t + e) * self.width + i]
                    cost += self.feature_weight[term, i] * change * change
        return cost

    # Normal equations

    cdef Joint linearise_joint(self, int p, int t, int j, Frame* f, bint with_lifted) noexcept nogil:
        """Return what the terms of one joint's position add."""
        cdef Joint m
        cdef int i
        cdef double c = self.robust_scale_of(p), c2 = self.lifter_robust_scale * self.lifter_robust_scale
        cdef double d = f.depth[j], x = f.error[2 * j], y = f.error[2 * j + 1], u, squared = 0
        cdef double distance[3]
        u = self.score[t, j] / (self.noise_ratio[p] * self.noise_ratio[p]) / (1 + f.squared[j] / (c * c))
        m.a, m.b = -(x + self.image[t, j, 0]) / self.focal[t], -(y + self.image[t, j, 1]) / self.focal[t]
        m.v = u / (d * d)
        m.pull[0], m.pull[1] = u / d * x, u / d * y
        m.gradient[0], m.gradient[1], m.gradient[2] = m.pull[0], m.pull[1], u / d * (m.a * x + m.b * y)
        memset(m.stiffness, 0, sizeof(m.stiffness))
        if with_lifted:
            for i in range(3):
                distance[i] = f.scaled_pose[3 * j + i] - self.lifted[t, j, i]
                squared += self.precision[t, j, i] * distance[i] * distance[i]
            for i in range(3):
                m.stiffness[i] = self.lifter_weight * self.precision[t, j, i] / (1 + squared / c2)
                m.gradient[i] += m.stiffness[i] * distance[i]
        return m

    cdef void write_jacobian(self, const Frame* f) noexcept nogil:
        """Write the columns of the camera of J: r_a x P_j for the rotations, with r_a the rows of R, and P_j."""
        cdef int j, a, i, K = self.components
        cdef double scale = exp(f.log_scale[0])
        cdef double pose[3]
        cdef const double* q
        cdef const double* r
        cdef double* out
        for j in range(self.joints):
            q, r, out = f.scaled_pose + 3 * j, f.rotation, &self.jacobian[3 * j, K]
            for i in range(3):
                pose[i] = (r[i] * q[0] + r[3 + i] * q[1] + r[6 + i] * q[2]) / scale
                self.jacobian[3 * j + i, K + 3] = pose[i]
            for a in range(3):
                for i in range(3):
                    self.jacobian[3 * j + i, K + a] = (
                        r[3 * a + (i + 1) % 3] * pose[(i + 2) % 3] - r[3 * a + (i + 2) % 3] * pose[(i + 1) % 3]
                    )

    cdef double write_weighted_jacobian(self, int p, int t, Frame* f) noexcept nogil:
        """Write (S J, m, U) of a frame and the half gradient by the translation, and return w."""
        cdef int j, b, i, k, row, column, n = self.unknowns, K = self.components, size = self.jacobian.shape[1]
        cdef double w = 0, scale = exp(f.log_scale[0]), across, weight
        cdef double camera[9]
        cdef double own[18]  # (M s R, m, U) by columns, then s R^T times it
        cdef double body[9]
        cdef Joint m
        for i in range(9):
            camera[i] = scale * f.rotation[i]
        self.by_translation[0, n] = self.by_translation[1, n] = 0
        for j in range(self.joints):
            m = self.linearise_joint(p, t, j, f, self.lifted.shape[0] > 0)
            w += m.v
            for i in range(3):
                own[3 * i] = m.v * (camera[i] + m.a * camera[6 + i])
                own[3 * i + 1] = m.v * (camera[3 + i] + m.b * camera[6 + i])
                own[3 * i + 2] = m.a * own[3 * i] + m.b * own[3 * i + 1] + m.stiffness[2] * camera[6 + i]
                own[3 * i] += m.stiffness[0] * camera[i]
                own[3 * i + 1] += m.stiffness[1] * camera[3 + i]
                own[9 + i] = m.gradient[i]
            own[12], own[13], own[14], own[15], own[16], own[17] = m.v, 0, m.v * m.a, 0, m.v, m.v * m.b
            for i in range(3):
                for column in range(3):
                    body[3 * i + column] = (
                        camera[i] * own[3 * column] + camera[3 + i] * own[3 * column + 1]
                        + camera[6 + i] * own[3 * column + 2]
                    )
            weigh_rows(size, body, &self.jacobian[3 * j, 0], &self.weighted[3 * j, 0])
            for i in range(3):
                for column in range(3):
                    self.weighted[3 * j + i, n + column] = (
                        camera[i] * own[9 + 3 * column] + camera[3 + i] * own[10 + 3 * column]
                        + camera[6 + i] * own[11 + 3 * column]
                    )
            for i in range(2):
                self.by_translation[i, n] += m.pull[i]
        for b in range(self.bones_count):
            row, i = 3 * self.children[b], 3 * self.parents[b]
            weight = self.bone_weight[b]
            across = weight * max(f.excess[b] / f.length[b], 0.0)
            add_bone(
                K, size, f.direction + 3 * b, &self.bones[3 * b, 0], weight, across, &self.along[0],
                &self.weighted[row, 0], &self.weighted[i, 0],
            )
            for k in range(K):
                self.vectors[t, k, b] = sqrt(weight) * self.along[k]
                self.equations[t, k, n] += weight * f.excess[b] * self.along[k]
        return w

    cdef void linearise(self, int p) noexcept nogil:
        """Write the normal equations of a sequence at the current point."""
        cdef int start = self.starts[p], count = self.counts[p], t, i, j, a, n = self.unknowns, D = self.distances
        cdef int size = self.equations.shape[2], rows = self.equations.shape[1]
        cdef double w
        cdef double* u = &self.by_translation[0, 0]
        cdef Frame f
        memcpy(&self.linearised[start, 0], &self.current[start, 0], count * self.width * sizeof(double))
        memset(&self.couplings[start, 0, 0], 0, count * D * self.couplings.shape[2] * sizeof(double))
        self.outdated[p] = False
        for t in range(start, start + count):
            for i in range(rows):
                j = i // TILE_COLUMNS * TILE_COLUMNS
                memset(&self.equations[t, i, j], 0, (size - j) * sizeof(double))
            if not self.is_free[t]:
                continue
            f = self.view(&self.current[t, 0])
            self.write_jacobian(&f)
            w = self.write_weighted_jacobian(p, t, &f)
            for i from 0 <= i < n by TILE_ROWS:
                for j from i // TILE_COLUMNS * TILE_COLUMNS <= j < size by TILE_COLUMNS:
                    add_products(
                        0, 3 * self.joints, 1, &self.jacobian[0, i], &self.weighted[0, j], size,
                        &self.equations[t, i, j], size, NULL,
                    )
            if w > 0:
                for i in range(n):
                    for a in range(2):
                        u[a * size + i] = self.equations[t, i, n + 1 + a]
                for i from 0 <= i < n by TILE_ROWS:
                    for j from i // TILE_COLUMNS * TILE_COLUMNS <= j < size by TILE_COLUMNS:
                        add_products(0, 2, -1 / w, u + i, u + j, size, &self.equations[t, i, j], size, NULL)
            for i in range(self.components):
                self.equations[t, i, i] += self.prior[i]
                self.equations[t, i, n] += self.prior[i] * f.theta[i]
        self.add_differences(p)

    cdef void add_differences(self, int p) noexcept nogil:
        """Add the differences of a sequence to its normal equations."""
        cdef int start = self.starts[p], count = self.counts[p], K = self.components, n = self.unknowns
        cdef int term, t, d, e, f, i, j, order
        cdef double change, weight, value
        cdef const double* c
        cdef const double* first
        cdef const double* later
        cdef Frame frame
        for t in range(count):
            frame = self.view(&self.current[start + t, 0])
            differentiate_features(&frame, &self.feature_jacobian[t, 0, 0])
        for term in range(self.orders.shape[0]):
            order = self.orders[term]
            for t in range(start, start + count - order):
                c = &self.factors[term, t, 0]
                for f in range(K + FEATURES):
                    weight = self.feature_weight[term, f]
                    if weight == 0:
                        continue
                    change = 0
                    for e in range(order + 1):
                        change += c[e] * self.current[t + e, f]
                    for e in range(order + 1):
                        if f < K:
                            self.equations[t + e, f, n] += weight * c[e] * change
                            self.equations[t + e, f, f] += weight * c[e] * c[e]
                            for d in range(1, order + 1 - e):
                                self.couplings[t + e, d - 1, f] += weight * c[e] * c[e + d]
                            continue
                        first = &self.feature_jacobian[t - start + e, f - K, 0]
                        for i in range(CAMERA):
                            self.equations[t + e, K + i, n] += weight * c[e] * change * first[i]
                            for j in range(i, CAMERA):
                                self.equations[t + e, K + i, K + j] += weight * c[e] * c[e] * first[i] * first[j]
                        for d in range(1, order + 1 - e):
                            later, value = first + d * FEATURES * CAMERA, weight * c[e] * c[e + d]
                            for i in range(CAMERA):
                                for j in range(CAMERA):
                                    self.couplings[t + e, d - 1, K + CAMERA * i + j] += value * later[i] * first[j]

    # Levenberg-Marquardt

    cdef bint solve(self, int p) noexcept nogil:
        """Write the negative of the damped step of a sequence; False if its matrix is not positive definite."""
        cdef int start = self.starts[p], end = start + self.counts[p], n = self.unknowns, K = self.components
        cdef int B = self.bones_count, D = self.distances, size = pad_columns(n), right = self.products.shape[0]
        cdef int stride = self.system.shape[2], t, d, i, j, b
        cdef double* row
        cdef double* solved
        cdef System system, means
        while start < end - 1 and not self.is_free[start]:
            start += 1
        system = System(end - start, n, D, CAMERA, right, stride, &self.system[0, 0, 0])
        for t in range(start, end):
            for i in range(n):
                row, j = &self.system[t - start, i, 0], i // TILE_COLUMNS * TILE_COLUMNS
                memcpy(row + j, &self.equations[t, i, j], (n - j) * sizeof(double))
                memset(row + size, 0, D * size * sizeof(double))
                row[i] += self.dampings[p] * row[i] + MIN_DIAGONAL
                for d in range(D):
                    if i < K:
                        row[(1 + d) * size + i] = self.couplings[t, d, i]
                        continue
                    for j in range(CAMERA):
                        row[(1 + d) * size + K + j] = self.couplings[t, d, K + CAMERA * j + i - K]
                memcpy(row + (1 + D) * size, &self.vectors[t, i, 0], B * sizeof(double))
                row[(1 + D) * size + B] = self.equations[t, i, n]
        if not factorise_blocks(&system):
            return False
        # (F I - V^T V, -V^T y) and a last row with any large r on the diagonal: U^-1 (0, r^(1/2)) is (-z, 1)
        memset(&self.products[0, 0], 0, right * right * sizeof(double))
        for t in range(end - start):
            solved = &self.system[t, 0, (1 + D) * size]
            for i from 0 <= i < right by TILE_ROWS:
                for j from i // TILE_COLUMNS * TILE_COLUMNS <= j < right by TILE_COLUMNS:
                    add_products(0, n, -1, solved + i, solved + j, stride, &self.products[i, j], right, NULL)
        for b in range(B):
            self.products[b, b] += self.counts[p] + self.earlier_frames[p]
        self.products[B, B] = LARGE
        means = System(1, B + 1, 0, B + 1, 0, right, &self.products[0, 0])
        if not factorise_blocks(&means):
            return False
        memset(&self.means[0], 0, right * sizeof(double))
        self.means[B] = 1 / self.products[B, B]
        solve_backward(&means, &self.means[0])
        memset(&self.step[0, 0], 0, self.counts[p] * size * sizeof(double))
        for t in range(end - start):
            for i in range(n):
                self.step[t, i] = add_up(right, &self.system[t, i, (1 + D) * size], &self.means[0])
        solve_backward(&system, &self.step[0, 0])
        for i in range(n):
            memcpy(&self.last_factor[p, i, 0], &self.system[end - start - 1, i, 0], size * sizeof(double))
        self.has_step[p] = True
        return True

    cdef void advance(self, int p) noexcept nogil:
        """Write the unknowns of a sequence after the step into the trial point."""
        cdef int start = self.starts[p], end = start + self.counts[p], t, i, K = self.components
        cdef double vector[3]
        cdef double turn[9]
        cdef double* step = &self.step[0, 0]
        cdef Frame before, after
        memcpy(&self.trial[start, 0], &self.current[start, 0], self.counts[p] * self.width * sizeof(double))
        for t in range(start, end):
            if not self.is_free[t]:
                continue
            before, after = self.view(&self.current[t, 0]), self.view(&self.trial[t, 0])
            for i in range(K):
                after.theta[i] -= step[i]
            for i in range(3):
                vector[i] = -step[K + i]
            rotation_from_vector(vector, turn)
            multiply_3x3(turn, before.rotation, after.rotation)
            after.log_scale[0] += min(max(-step[K + 3], -MAX_LOG_SCALE_STEP), MAX_LOG_SCALE_STEP)
            step += self.step.shape[1]

    cdef bint take_step(self, int p, double tolerance) noexcept nogil:
        """Try a step of a sequence, set its next damping or its end, and return whether the step is taken."""
        cdef double cost, gain = 0
        cdef bint is_definite = self.solve(p), is_better = False
        if is_definite:
            self.advance(p)
            cost = self.measure(p, &self.trial[0, 0], self.robust_scale_of(p))
            is_better = cost < self.costs[p]
        self.tried[p] += 1
        if is_better:
            gain = self.costs[p] - cost
            self.costs[p] = cost
            self.outdated[p] = True
            memcpy(
                &self.current[self.starts[p], 0], &self.trial[self.starts[p], 0],
                self.counts[p] * self.width * sizeof(double),
            )
        if is_better and gain <= tolerance * self.costs[p]:
            self.ends[p], self.done[p] = CONVERGED, True
        elif self.dampings[p] > MAX_DAMPING:
            self.ends[p] = NO_LOWER_STEP if is_definite and isfinite(self.costs[p]) else SINGULAR
            self.done[p] = True
        else:
            self.ends[p] = MAX_ITERATIONS if is_definite else SINGULAR
            self.dampings[p] = max(
                self.dampings[p] * (DAMPING_AFTER_SUCCESS if is_better else DAMPING_AFTER_FAILURE), MIN_DAMPING
            )
        return is_better

    # Noise and covariance

    cdef double measure_roughness(self, int p) noexcept nogil:
        """Return what is new in each frame of the points of a sequence in m, as of white noise; 0 if not known."""
        cdef int start = self.starts[p], count = self.counts[p], t, j, i, stride, points = 0
        cdef double step, squares = 0, total, x, weight
        if count < 4 or self.lifted.shape[0] == 0:
            return 0
        step = (self.times[start + count - 1] - self.times[start]) / (count - 1)
        stride = count_frames_of_step(step)
        if stride * step > MAX_ROUGHNESS_STEP_S:
            return 0
        for t in range(start + 3 * stride, start + count):
            if self.times[t] - self.times[t - 3 * stride] > 4.5 * stride * step:
                continue
            for j in range(self.joints):
                weight = min(min(self.score[t, j], self.score[t - stride, j]),
                             min(self.score[t - 2 * stride, j], self.score[t - 3 * stride, j]))
                if not weight > 0:
                    continue
                total = 0
                for i in range(2):
                    x = take_third_difference(self.image, t, j, i, stride)
                    total += x * x / 20
                points += 1
                squares += weight * compute_loss(total, ROUGHNESS_LOSS_M)
        return sqrt(max(squares / (2 * points) - MOTION_ROUGHNESS_M * MOTION_ROUGHNESS_M, 0.0)) if points > 0 else 0

    cdef void write_alone(self, const Frame* f, const double* block, int stride) noexcept nogil:
        """Write the rows (A, J^T) of one frame, with the block A of rows of this length."""
        cdef int i, j
        self.write_jacobian(f)
        for i in range(self.unknowns):
            memcpy(&self.alone[i, 0], block + i * stride, self.unknowns * sizeof(double))
            for j in range(3 * self.joints):
                self.alone[i, pad_columns(self.unknowns) + j] = self.jacobian[j, i]

    cdef double count_absorbed_coordinates(self, int p, int t) noexcept nogil:
        """Return how many image coordinates of a frame its unknowns fit away while its neighbours are held.

        It is tr(A_t^-1 D_t) + 2, with D_t = sum_j v_j C_j^T C_j - u u^T / w the part of the block A_t that the
        reprojection has added, C_j = E_j s R J_j and u = sum_j v_j C_j^T, and the two coordinates that the
        translation takes. With A_t = U^T U it follows from the products of U^-T J_j^T.
        """
        cdef int i, j, k, a, n = self.unknowns, size = pad_columns(n), stride = self.alone.shape[1]
        cdef double total = 0, w = 0, value, scale
        cdef double[3] row
        cdef Joint m
        cdef Frame f = self.view(&self.linearised[t, 0])
        cdef System system = System(1, n, 0, n, stride - size, stride, &self.alone[0, 0])
        self.write_alone(&f, &self.equations[t, 0, 0], self.equations.shape[2])
        for i in range(n):
            self.alone[i, i] += MIN_INFORMATION
            self.by_translation[0, i] = self.by_translation[1, i] = 0
        if not factorise_blocks(&system):
            return 2
        scale = exp(f.log_scale[0])
        for j in range(self.joints):
            m = self.linearise_joint(p, t, j, &f, False)
            w += m.v
            for a in range(2):
                for k in range(3):
                    row[k] = scale * (f.rotation[3 * a + k] + (m.b if a else m.a) * f.rotation[6 + k])
                for i in range(n):
                    value = 0
                    for k in range(3):
                        value += row[k] * self.alone[i, size + 3 * j + k]
                    total += m.v * value * value
                    self.by_translation[a, i] += m.v * value
        for i in range(n if w > 0 else 0):
            for a in range(2):
                total -= self.by_translation[a, i] * self.by_translation[a, i] / w
        return 2 + total

    def measure_misfit(self):
        """Return what the poses leave unexplained, as a noise (P,) m of a coordinate of a point of weight 1.

        It follows from the residual and the coordinates that are not absorbed.
        """
        cdef int p, t, j, end, first, stride, coordinates, counted
        cdef double squares, absorbed
        cdef Frame f
        misfit = np.empty(self.sequences)
        cdef double[::1] out = misfit
        for p in range(self.sequences):
            first, coordinates, counted, squares, absorbed = self.starts[p], 0, 0, 0, 0
            end = first + self.counts[p]
            for t in range(first, end):
                f = self.view(&self.current[t, 0])
                for j in range(self.joints):
                    if self.score[t, j] > 0:
                        coordinates += 2
                        squares += self.score[t, j] * compute_loss(f.squared[j], self.robust_scale_of(p))
            while first < end and not self.is_free[first]:
                first += 1
            stride = COUNTED_FRAMES + (end - first) // COUNTED_FRAME_STEP
            stride = max((end - first + stride - 1) // stride, 1)
            for t from first <= t < end by stride:
                absorbed += self.count_absorbed_coordinates(p, t)
                counted += 1
            absorbed *= self.counts[p]
            out[p] = sqrt(
                squares / max(coordinates - absorbed / max(counted, 1), MIN_FREE_SHARE * coordinates + 1)
            )
        return misfit

    def measure_least_noise(self, growth=None):
        """Return the noise (P,) m that the points show by themselves, whatever the poses; 0 without lifted poses.

        `growth` (P,) is g of more frames than those of the batch.
        """
        cdef int p, start, end
        noise = np.empty(self.sequences)
        for p in range(self.sequences):
            start, end = self.starts[p], self.starts[p] + self.counts[p]
            noise[p] = self.measure_roughness(p)
            if growth is None and noise[p] > 0:
                noise[p] *= compute_noise_growth(self.image, self.score, self.times, start, end, 1.0)
        return noise if growth is None else noise * growth

    def measure_joint_std(self):
        """Return the posterior standard deviations (P, J) m of the last joints about the body's origin.

        They are roots of the traces of their covariances; NaN where no step could be computed.
        """
        cdef int p, j, i, k, n = self.unknowns, size = pad_columns(n), stride = self.alone.shape[1]
        cdef double total
        cdef Frame f
        std = np.empty((self.sequences, self.joints))
        cdef double[:, ::1] out = std
        out[:] = NAN
        for p in range(self.sequences):
            if not self.has_step[p]:
                continue
            f = self.view(&self.current[self.starts[p] + self.counts[p] - 1, 0])
            self.write_alone(&f, &self.last_factor[p, 0, 0], size)
            memset(&self.alone[n - 1, size], 0, 3 * self.joints * sizeof(double))  # the scale moves no joint
            solve_forward(n, stride - size, stride, &self.alone[0, 0])
            for j in range(self.joints):
                total = 0
                for i in range(n):
                    for k in range(3):
                        total += self.alone[i, size + 3 * j + k] * self.alone[i, size + 3 * j + k]
                out[p, j] = NOISE_REFERENCE * sqrt(total)
        return std

    # What Python calls

    def weigh(self, const double[::1] noise_ratio not None, const double[:, :, ::1] factors not None):
        """Take the image noise (P,) over the reference and the factors (T, N, 3) of the differences.

        Raises:
            ValueError: the arrays have other sizes; factors of more differences are left out.
        """
        if (
            noise_ratio.shape[0] != self.sequences or factors.shape[0] < self.orders.shape[0]
            or factors.shape[1] != self.frames or factors.shape[2] != 3
        ):
            raise ValueError('the noise or the factors are not those of the sequences and differences')
        self.noise_ratio, self.factors = noise_ratio, factors

    def start(self, theta, rotation, log_scale, translation, int settle_steps=0, bint at_reference=False):
        """Set the point: theta (N, K), rotation (N, 3, 3), log_scale (N,), translation (N, 2).

        Translations take `settle_steps` of the robust fit, `at_reference` under the scale of the reference noise.
        """
        cdef int p, i, K = self.components, first = K + FEATURES
        cdef double c
        self.point[:, :K], self.point[:, first : first + 9] = theta, np.reshape(rotation, (-1, 9))
        self.point[:, first + 9], self.point[:, first + 10 : first + 12] = log_scale, translation
        with nogil:
            for p in range(self.sequences):
                c = self.robust_scale if at_reference else self.robust_scale_of(p)
                for i in range(max(settle_steps, 1)):
                    self.costs[p] = self.measure(p, &self.current[0, 0], c if settle_steps > 0 else 0)

    def begin(self, double damping):
        """Set the damping of the first step of all sequences, and compute the normal equations."""
        cdef int p
        with nogil:
            for p in range(self.sequences):
                self.dampings[p], self.tried[p], self.ends[p] = damping, 0, MAX_ITERATIONS
                self.done[p], self.has_step[p] = False, False
                self.linearise(p)

    def update_equations(self):
        """Compute the normal equations of the sequences that have moved and are not done."""
        cdef int p
        with nogil:
            for p in range(self.sequences):
                if self.outdated[p] and not self.done[p]:
                    self.linearise(p)

    def try_steps(self, double tolerance):
        """Try a step of each sequence; return how many were taken, and how many sequences are not done.

        Normal equations that are not those of the current point are computed first. A step that lowers an objective
        by no more than a share `tolerance` of it is the last of its sequence.
        """
        cdef int p, taken = 0, remaining = 0
        with nogil:
            for p in range(self.sequences):
                if not self.done[p]:
                    if self.outdated[p]:
                        self.linearise(p)
                    taken += self.take_step(p, tolerance)
                    remaining += not self.done[p]
        return taken, remaining

    def describe(self, const double[::1] units):
        """Return joints (N, J, 3) m, scales (N,) px/m, translations (N, 2) px and residuals (N,) px of all frames.

        They are those of `solvers.window.Reconstruction`; units (P,) px/m.
        """
        cdef int p, t, j, i, seen
        cdef double scale, total
        cdef Frame f
        joints, scales = np.empty((self.frames, self.joints, 3)), np.empty(self.frames)
        translations, residuals = np.empty((self.frames, 2)), np.empty(self.frames)
        cdef double[:, :, ::1] joint = joints
        cdef double[::1] scale_px = scales, residual = residuals
        cdef double[:, ::1] translation = translations
        for p in range(self.sequences):
            for t in range(self.starts[p], self.starts[p] + self.counts[p]):
                f, seen, total = self.view(&self.current[t, 0]), 0, 0
                scale = exp(f.log_scale[0])
                for j in range(self.joints):
                    for i in range(3):
                        joint[t, j, i] = f.scaled_pose[3 * j + i] / scale
                    if self.score[t, j] > 0:
                        total += f.squared[j]
                        seen += 1
                scale_px[t], residual[t] = scale * units[p], (units[p] * sqrt(total / seen) if seen > 0 else NAN)
                translation[t, 0], translation[t, 1] = f.translation[0] * units[p], f.translation[1] * units[p]
        return joints, scales, translations, residuals

    def read(self, str name):
        """Return a copy (N, ...) of a quantity of the current point, by the name of the field of `Frame`."""
        first, end, shape = self.fields[name]
        return self.point[:, first:end].reshape(shape).copy()


cdef void write_best_rotation(const double* products, double* out) noexcept nogil:
    """Write the rotation R (3, 3) that maximises tr(R^T M), M = sum_j q_j p_j^T (3, 3): the closest R p_j to q_j.

    tr(R^T M) is a quadratic form of the quaternion of R, with a matrix K (4, 4) (Horn 1987). Its eigenvalues are
    within 3^(1/2) |M|, so each column of high powers of K + 3^(1/2) |M| I is along the eigenvector of the largest.
    Where others are nearly as large, as with an M of rank 1, it is a combination of theirs, and its rotation nearly
    as good as the best. Where M is 0 the rotation is I.
    """
    cdef int i, j, a, square, largest = 0
    cdef double size = 0, trace, w, x, y, z
    cdef const double* m = products
    cdef double[4][4] k, power
    for i in range(9):
        size += m[i] * m[i]
        out[i] = 1 if i % 4 == 0 else 0
    if not size > 0:
        return
    k[0][:] = [m[0] + m[4] + m[8], m[7] - m[5], m[2] - m[6], m[3] - m[1]]
    k[1][:] = [k[0][1], m[0] - m[4] - m[8], m[3] + m[1], m[2] + m[6]]
    k[2][:] = [k[0][2], k[1][2], m[4] - m[0] - m[8], m[7] + m[5]]
    k[3][:] = [k[0][3], k[1][3], k[2][3], m[8] - m[0] - m[4]]
    for i in range(4):
        k[i][i] += sqrt(3 * size)
    for square in range(SQUARES):
        trace = k[0][0] + k[1][1] + k[2][2] + k[3][3]
        for i in range(4):
            for j in range(4):
                power[i][j] = 0
                for a in range(4):
                    power[i][j] += k[i][a] * k[a][j] / (trace * trace)
        memcpy(k, power, sizeof(k))
    for i in range(1, 4):
        largest = i if k[i][i] > k[largest][largest] else largest
    size = 0
    for i in range(4):
        size += k[largest][i] * k[largest][i]
    size = sqrt(size)
    w, x, y, z = k[largest][0] / size, k[largest][1] / size, k[largest][2] / size, k[largest][3] / size
    out[0], out[1], out[2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[3], out[4], out[5] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[6], out[7], out[8] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


cdef void fit_lifted_pose(
    const double* joints, const double* std, double factor, const double[:, ::1] basis, const double[:, ::1] mean,
    const double[::1] sigma, int alternations, double* theta, double* scale, double* rotation,
) noexcept nogil:
    """Fit weights (K,) and a camera to a lifted pose (J, 3), whose standard deviations are `factor` times `std`."""
    cdef int J = mean.shape[0], K = basis.shape[1], i, j, a, b, turn
    cdef double variance = 0, squares, along
    cdef double products[9]
    cdef double* pose = <double*> malloc(3 * J * sizeof(double))
    for i in range(3 * J):
        variance += factor * std[i] * factor * std[i] / (3 * J)
    memset(theta, 0, K * sizeof(double))
    for turn in range(alternations):
        memcpy(pose, &mean[0, 0], 3 * J * sizeof(double))
        multiply_vector(3 * J, K, 1, &basis[0, 0], theta, 1, pose)
        memset(products, 0, sizeof(products))
        squares, along = 0, 0
        for j in range(J):
            for a in range(3):
                squares += pose[3 * j + a] * pose[3 * j + a]
                for b in range(3):
                    products[3 * a + b] += joints[3 * j + a] * pose[3 * j + b]
        write_best_rotation(products, rotation)
        for i in range(9):
            along += rotation[i] * products[i]
        scale[0] = max(along / squares, MIN_SCALE)
        for j in range(J):
            for i in range(3):
                pose[3 * j + i] = (
                    rotation[i] * joints[3 * j] + rotation[3 + i] * joints[3 * j + 1]
                    + rotation[6 + i] * joints[3 * j + 2]
                ) / scale[0] - mean[j, i]
        multiply_vector_transposed(3 * J, K, 1, &basis[0, 0], pose, 0, theta)
        for i in range(K):
            theta[i] /= 1 + variance / ((scale[0] * sigma[i]) * (scale[0] * sigma[i]))
    free(pose)


def fit_lifted_poses(
    const double[:, :, ::1] joints, const double[:, :, ::1] std, const double[:, ::1] basis,
    const double[:, ::1] mean, const double[::1] sigma, int alternations,
):
    """Fit weights and cameras to lifted poses; the formulas are in `solvers.joint.lifted_start`."""
    cdef Py_ssize_t t, frames = joints.shape[0]
    theta, scale, rotation = np.zeros((frames, basis.shape[1])), np.empty(frames), np.empty((frames, 3, 3))
    cdef double[:, ::1] weights = theta
    cdef double[::1] scales = scale
    cdef double[:, :, ::1] rotations = rotation
    for t in range(frames):
        fit_lifted_pose(
            &joints[t, 0, 0], &std[t, 0, 0], 1, basis, mean, sigma, alternations, &weights[t, 0], &scales[t],
            &rotations[t, 0, 0],
        )
    return theta, scale, rotation
