# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The objective of the periodic model (TPAMI 2016, section 3.3), its normal equations, and Levenberg-Marquardt.

    E = sum_tj w_tj rho(|s_t C_t[:2] Rz(psi_t) P_tj + t_t - x_tj|^2 / s0^2)    reprojection error (eq. 18)
      + beta   sum_tb (length_tb - mean_b)^2                                   bone lengths (eq. 20)
      + lambda sum_pl c_pl^2 / var_pl                                          prior of the coefficients
      + gamma  int |dM / dt|^2 dt + kappa int |d^2 M / dt^2|^2 dt              movement of the camera, M = s C[:2]
      + nu     mean_t |tilt_t|^2                                               level cameras

P_tj has the weights theta_t; u_t = (theta_t, psi_t) are Fourier series (`solvers.periodic`), psi the turn of
the body with every stride, Rz a rotation about its vertical, C_t the camera without the strides, rho Cauchy's loss.
The tilt is x and z of C_t e_z, for base poses aligned by heading. The paper weighs changes of the camera (eq. 12) and
has neither prior nor tilt. The unknowns of a step are

    x    G = P (K + 1) + 1 coefficients c_pl of the K weights and the heading, then the frequency omega
    z_t  4 unknowns of each frame's camera: rotation vector w_t of C_t <- exp([w_t]x) C_t, and log scale log s_t

and with d u_tl / d c_pl = terms_tp and d u_tl / d omega = slope_tl, together J_t = d u_t / d x, (K + 1, G),

    slope_tl = sum_h h (t - t0) [b_hl cos(h omega (t - t0)) - a_hl sin(h omega (t - t0))]

The joint solver gives the matrix H_t and half the gradient h_t of a frame, by its weights, the rotation vector v_t
of the body's rotation C_t Rz(psi_t), and the log scale. psi_t turns the body about a_t = C_t e_z, so v_t = w_t +
a_t psi_t, and the heading is inserted as unknown K + 1 of H'_t with the column H_tv a_t, the diagonal a_t^T H_vv
a_t, and a_t^T h_v in h'_t. The columns of g_t are the gradients of the bone lengths by u_t, whose eliminated means
subtract b b^T / N. D (diagonal, 0 for omega) and d come from the prior of the coefficients, E (cameras of frames up
to two apart) and e from movement and tilt:

    [ A    B ] [dx]     [a]        A    = sum_t J_t^T H'_uu,t J_t - b b^T / N + D,    b = sum_t J_t^T g_t
    [ B^T  C ] [dz] = - [c]        B^T  = (B_1^T; ... B_N^T),    B_t^T = H'_zu,t J_t
                                   C_tu = E_tu,    C_tt = E_tt + H'_zz,t
                                   a    = sum_t J_t^T h'_u,t + d,    c_t  = h'_z,t + e_t

With the block Cholesky factorisation C = L L^T (`block_banded`), V = L^-1 B^T and v = L^-1 c, S = A - V^T V and
s = a - V^T v, the step is dx = - S^-1 s, dz = - L^-T (v + V dx). One factorisation of a matrix that has a row and a
column more, with any large r, also gives y = U^-T s:

    [ S    s ]   [ U^T    ] [ U  y ]        [ U  y ] [ dx ]   [ 0 ]
    [ s^T  . ] = [ y^T  r ] [    r ],       [    r ] [ 1  ] = [ r ]

Sizes: N frames, J joints, B bones, K base poses, n = K + 4 unknowns of the joint solver a frame, m = K + 1 functions,
P terms of a series, G unknowns of the series.
"""

from libc.math cimport INFINITY, NAN, ceil, cos, exp, isfinite, log1p, sin, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.block_banded import log_determinant
from mocap_ros.engine.joint import DAMPINGS

from mocap_ros.engine.blas cimport add_outer, factorise, multiply, multiply_transposed, multiply_vector, solve_rows
from mocap_ros.engine.block_banded cimport (
    System, add_up, factorise_blocks, pad_columns, solve_backward, write_small_blocks,
)
from mocap_ros.engine.geometry cimport multiply as multiply_3x3, rotation_from_vector
from scipy.linalg.cython_blas cimport dsyrk, dtrsv
from scipy.linalg.cython_lapack cimport dpotrf, dtrtri

cdef enum:
    CAMERA = 4  # unknowns of a camera
    COUPLED = 2  # next frames with which each camera is coupled: acceleration compares three
    SINGULAR = -1  # why a search ends, as of `solvers.window.SolverStatus`
    MAX_ITERATIONS = 0
    CONVERGED = 1
    NO_LOWER_STEP = 2

cdef double MAX_FREQUENCY_STEP = 0.1  # of omega; guards a step against leaving the cadence of its hypothesis
cdef double MAX_LOG_SCALE_STEP = 1  # of one step; a larger one is a failed linearisation
cdef double MIN_FREE_SHARE = 0.05  # of the coordinates; guards the noise estimate against too many unknowns
# Added to diagonals that are factorised; both are far below the information of a single seen joint.
cdef double MIN_CAMERA_INFORMATION = 1e-6  # m^2; the prior of the cameras leaves a constant camera free
cdef double MIN_INFORMATION = 1e-12  # m^2; keeps the equations solvable where the image determines no unknown
cdef double LARGE = 1e300  # m^2; keeps a matrix positive definite whatever is subtracted
cdef double MIN_DAMPING = DAMPINGS[0], MAX_DAMPING = DAMPINGS[1]
cdef double DAMPING_AFTER_SUCCESS = DAMPINGS[2], DAMPING_AFTER_FAILURE = DAMPINGS[3]
cdef double NEWEST_S = 0.4  # s; most of a step of a walk: half of it shows that something else has begun
cdef double SAMPLE_STEP_S = 1.0 / 15  # s; at which a motion is compared, often enough for a run
cdef double MAX_STRETCH = 0.1  # of the cycle; by so much two cycles of a person differ, and a cadence is wrong
cdef int STRETCHES = 9  # lengths of a cycle that are tried
REPETITION = NEWEST_S, MAX_STRETCH  # for `solvers.classification`


cdef class Point:
    """Values of the unknowns: coefficients and omega of the series, the cameras C_t, log s_t and translations."""

    cdef readonly object coefficients  # (P, m) m, in the last column rad
    cdef readonly double omega  # rad/s
    cdef readonly object rotation, log_scale, translation  # (N, 3, 3), (N,), (N, 2) m
    cdef double[:, ::1] series
    cdef double[:, :, ::1] cameras
    cdef double[::1] log_scales

    def __init__(self, coefficients, double omega, rotation, log_scale, translation):
        self.coefficients, self.omega = np.array(coefficients, order='C'), omega
        self.rotation, self.log_scale = np.array(rotation, order='C'), np.array(log_scale)
        self.translation = np.array(translation)
        self.series, self.cameras, self.log_scales = self.coefficients, self.rotation, self.log_scale

    @property
    def values(self):
        """The values, in the order of the arguments."""
        return self.coefficients, self.omega, self.rotation, self.log_scale, self.translation


cdef class PeriodicProblem:
    """E of one window of N frames, minimised from a point; a `Problem` of `solvers.levenberg_marquardt`.

    Args:
        body: reprojection and bone lengths, a `JointProblem` of the window without prior and differences. Problems
            may share it, of which one after the other is minimised.
        score: (N, J) confidence scores.
        robust_scale: m, c of the reprojection; infinite for least squares.
        times: (N,) s from the time t0 at which the phases are 0.
        prior: (P, K + 1) lambda / var_pl, the factor on the square of each coefficient.
        level_weight: nu / N, m^2.
        movement: (2, N, 3) factors on M of three frames that give weighted velocities and changes of these.
        start: the values of a `Point`.
        noise_ratio: image noise over that of the reference.
        settle_steps: of the robust fit, by which each translation first moves to its optimum.
    """

    cdef readonly object body  # as given
    cdef readonly Point point  # current values
    cdef readonly object cost  # (1,) m^2, E at the point
    cdef readonly double damping, noise_ratio
    cdef readonly int status  # why the search ended, or 0
    # the equations, of the current point or an earlier one: A without D, the diagonal of D, a; B^T (N, 4, G), H'_zz
    # and E_tt (N, 4, 4), E_ut (N, 2, 4, 4) in the rows of frame u = t + d + 1, c (N, 4)
    cdef readonly object series_matrix, series_prior, series_gradient
    cdef readonly object mixed_matrix, camera_image, camera_prior, camera_coupling, camera_gradient
    cdef readonly object series_step, camera_step  # dx (G,) and dz (N, 4)
    cdef Point trial
    cdef bint has_equations
    cdef int N, K, m, P, G
    cdef double robust_scale, level_weight
    cdef const double[:, ::1] score, prior
    cdef const double[::1] times
    cdef const double[:, :, ::1] movement
    cdef object theta, turned  # weights (N, K) and rotations C_t Rz(psi_t) of the body
    cdef double[:, ::1] matrix, terms, functions, matrices, z, out_camera, bordered, remaining
    cdef double[::1] costs, prior_diagonal, right, x
    cdef double[:, :, ::1] rotations, mixed, image, blocks, work, rows
    cdef double[:, :, :, ::1] coupling

    def __init__(self, body, score, double robust_scale, times, prior, double level_weight, movement, start,
                 double noise_ratio, int settle_steps=0):
        cdef int N = len(times), P = prior.shape[0], m = prior.shape[1], G = P * m + 1
        if P % 2 == 0:
            raise ValueError('a series is a mean and pairs of terms')
        self.body, self.score, self.robust_scale, self.times, self.prior = body, score, robust_scale, times, prior
        self.movement, self.level_weight, self.noise_ratio = movement, level_weight, noise_ratio
        self.N, self.K, self.m, self.P, self.G = N, m - 1, m, P, G
        self.series_matrix, self.series_gradient = np.empty((G, G)), np.empty(G)
        self.series_prior = np.append(np.ravel(prior), 0.0)
        self.mixed_matrix, self.camera_gradient = np.empty((N, CAMERA, G)), np.empty((N, CAMERA))
        self.camera_image, self.camera_prior = np.empty((N, CAMERA, CAMERA)), np.empty((N, CAMERA, CAMERA))
        self.camera_coupling = np.empty((N, COUPLED, CAMERA, CAMERA))
        self.series_step, self.camera_step = np.zeros(G), np.empty((N, CAMERA))
        self.matrix, self.right, self.prior_diagonal = self.series_matrix, self.series_gradient, self.series_prior
        self.mixed, self.image, self.blocks = self.mixed_matrix, self.camera_image, self.camera_prior
        self.coupling, self.out_camera = self.camera_coupling, self.camera_gradient
        self.x, self.z = np.zeros(pad_columns(G + 1)), self.camera_step
        self.terms, self.matrices = np.ones((N, P)), np.empty((N, 6))
        functions, self.turned = np.empty((N, m)), np.empty((N, 3, 3))
        self.functions, self.theta, self.rotations = functions, functions[:, :-1], self.turned
        self.work, self.bordered = np.empty((N, CAMERA, CAMERA)), np.empty((G + 1, G + 1))
        self.rows = np.zeros((N, CAMERA, (1 + COUPLED) * pad_columns(CAMERA) + pad_columns(G + 1)))
        self.remaining = np.zeros((N, pad_columns(CAMERA)))
        self.point, self.trial, self.cost = Point(*start), Point(*start), np.empty(1)
        self.costs, self.status, self.damping = self.cost, MAX_ITERATIONS, 0
        self.costs[0] = self.measure(self.point, settle_steps)

    def set_noise(self, double ratio):
        """Continue from the point under another ratio, which is that of all problems with the same body."""
        self.noise_ratio = ratio
        self.body.batch.sequences['noise_ratio'] = ratio
        self.restart()

    def restart(self):
        """Set the body to the point, and measure E there."""
        self.costs[0] = self.measure(self.point, 0)

    # Measurement

    cdef double measure(self, Point at, int settle_steps) except? -1:
        """Return E at a point, of which the translations settle; the body is at the point then."""
        cdef int N = self.N, K = self.K, t, h, i, term
        cdef double angle, c, s, change, cost
        for t in range(N):
            for h in range(1, self.P // 2 + 1):
                angle = at.omega * self.times[t] * h
                self.terms[t, 2 * h - 1], self.terms[t, 2 * h] = cos(angle), sin(angle)
        multiply(N, self.P, self.m, 1, &self.terms[0, 0], &at.series[0, 0], 0, &self.functions[0, 0])
        for t in range(N):
            c, s = cos(self.functions[t, K]), sin(self.functions[t, K])
            for i in range(3):
                self.rotations[t, i, 0] = c * at.cameras[t, i, 0] + s * at.cameras[t, i, 1]
                self.rotations[t, i, 1] = c * at.cameras[t, i, 1] - s * at.cameras[t, i, 0]
                self.rotations[t, i, 2] = at.cameras[t, i, 2]
        self.body.start(self.theta, self.turned, at.log_scale, at.translation, settle_steps)
        at.translation = self.body.frames['translation'].copy()
        cost = self.body.cost[0]
        for h in range(self.P):
            for i in range(self.m):
                cost += self.prior[h, i] * at.series[h, i] * at.series[h, i]
        for t in range(N):
            c, s = at.cameras[t, 0, 2], at.cameras[t, 2, 2]
            cost += self.level_weight * (c * c + s * s)
            c = exp(at.log_scales[t])
            for i in range(6):
                self.matrices[t, i] = c * at.cameras[t, i // 3, i % 3]
        for term in range(2):
            for t in range(N - 1 - term):
                for i in range(6):
                    change = self.find_change(term, t, i)
                    cost += change * change
        return cost

    cdef inline double find_change(self, int term, int t, int i) noexcept nogil:
        """Return a weighted velocity or its change, of an element of M."""
        cdef int e
        cdef double change = 0
        for e in range(term + 2):
            change += self.movement[term, t, e] * self.matrices[t + e, i]
        return change

    def estimate_noise(self):
        """Return the standard deviation (m) of a coordinate of a point of weight 1.

        The squared residuals are shared among the coordinates that the parameters leave free; these may be those
        of the point before the last step:

            noise^2 = sum of squared residuals / (number of coordinates - effective number of parameters)
        """
        cdef double parameters = self.count_effective_parameters(), loss = 0, c, free
        cdef int t, j, coordinates = 0
        self.restart()
        cdef double[:, ::1] squared = self.body.measure_squared_errors()
        c = self.robust_scale * max(self.noise_ratio, 1.0)
        for t in range(self.N):
            for j in range(self.score.shape[1]):
                if self.score[t, j] > 0:
                    coordinates += 2
                    loss += self.score[t, j] * (
                        squared[t, j] if c == INFINITY else c * c * log1p(squared[t, j] / (c * c))
                    )
        free = max(coordinates - parameters, MIN_FREE_SHARE * coordinates + 1)
        return sqrt(loss / free)

    def count_effective_parameters(self):
        """Return the effective number of parameters, that is, of coordinates that the unknowns fit.

            tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t) + 2 N

        Series and cameras are counted with the other fixed; the last term counts the translations.

        Raises:
            LinAlgError: A or a C_tt is not positive definite.
        """
        cdef int G = self.G, info = 0, i, j, t
        cdef double total = G + 2 * self.N
        cdef double[CAMERA * CAMERA] block
        cdef double[CAMERA * CAMERA] rows
        self.require_equations()
        cdef double[:, ::1] factor = self.series_matrix.copy()
        for i in range(G):
            factor[i, i] += self.prior_diagonal[i] + MIN_INFORMATION
        dpotrf(b'L', &G, &factor[0, 0], &G, &info)
        if info != 0:
            raise np.linalg.LinAlgError('the matrix of the series is not positive definite')
        dtrtri(b'L', b'N', &G, &factor[0, 0], &G, &info)
        for j in range(G):
            for i in range(j, G):
                total -= factor[j, i] * factor[j, i] * self.prior_diagonal[j]
        for t in range(self.N):
            for i in range(CAMERA):
                for j in range(CAMERA):
                    rows[CAMERA * i + j] = self.image[t, i, j]
                    block[CAMERA * i + j] = self.image[t, i, j] + self.blocks[t, i, j]
                block[CAMERA * i + i] += MIN_INFORMATION
            if not factorise(CAMERA, block):
                raise np.linalg.LinAlgError('the matrix of a camera is not positive definite')
            solve_rows(CAMERA, CAMERA, block, rows, False)
            solve_rows(CAMERA, CAMERA, block, rows, True)
            for i in range(CAMERA):
                total += rows[CAMERA * i + i]
        return total

    def camera_log_determinant_ratio(self):
        """Return log det C - log det E, minus twice the log of the cameras' posterior over prior volume."""
        self.require_equations()
        small = MIN_CAMERA_INFORMATION * np.eye(CAMERA)
        try:
            posterior = log_determinant(self.camera_image + self.camera_prior + small, self.camera_coupling)
            return posterior - log_determinant(self.camera_prior + small, self.camera_coupling)
        except np.linalg.LinAlgError:
            return INFINITY

    # Normal equations

    def require_equations(self):
        """Compute the equations, if there were none yet."""
        if not self.has_equations:
            self.begin(self.damping)

    def begin(self, double damping):
        """Set the damping of the first step, and compute the equations at the point."""
        self.restart()
        self.damping, self.status = damping, MAX_ITERATIONS
        self.update_equations()

    def update_equations(self):
        """Compute the equations at the point, at which the body is."""
        cdef int p, k
        self.body.begin(0.0)
        self.assemble(self.body.diagonal, self.body.gradient, self.body.bone_vectors)
        for p in range(self.P):
            for k in range(self.m):
                self.right[p * self.m + k] += self.prior[p, k] * self.point.series[p, k]
        self.add_movement_and_tilt()
        self.has_equations = True

    cdef void assemble(
        self, const double[:, :, :] diagonal, const double[:, :] gradient, const double[:, :, ::1] bone_vectors
    ):
        """Write the equations of the body alone, by H_t (N, n, n), upper triangles, h_t (N, n) and g_t (N, n, B)."""
        cdef int N = self.N, P = self.P, m = self.m, K = self.K, G = self.G, B = bone_vectors.shape[2]
        cdef int last = P * m, pairs = P * (P + 1) // 2, t, p, q, k, l, c, i, h
        cdef double value, slope
        cdef double[:, ::1] out = self.matrix, out_camera = self.out_camera, series = self.point.series
        cdef double[::1] out_gradient = self.right
        cdef double[:, :, ::1] mixed = self.mixed, image = self.image, cameras = self.point.cameras
        cdef double[:, :, ::1] functions = np.empty((N, m, m)), blocks = np.empty((pairs, m, m))  # H'_uu
        cdef double[:, ::1] products = np.empty((pairs, N)), bones = np.zeros((G, B))
        cdef double[:, ::1] of_camera = np.empty((CAMERA, m))  # H'_zu of a frame
        cdef double[::1] force = np.empty(m), by_omega = np.empty(m)  # h'_u and H'_uu slope of a frame
        cdef double[::1] slopes = np.empty(m)
        cdef double[3] vertical
        with nogil:
            out_gradient[:] = 0
            out[last, :] = 0
            for t in range(N):
                for i in range(3):
                    vertical[i] = cameras[t, i, 2]
                slopes[:] = 0
                for h in range(1, P // 2 + 1):
                    value = h * self.times[t]
                    for k in range(m):
                        slopes[k] += value * (
                            self.terms[t, 2 * h - 1] * series[2 * h, k] - self.terms[t, 2 * h] * series[2 * h - 1, k]
                        )
                for k in range(K):
                    for l in range(k, K):
                        functions[t, k, l] = functions[t, l, k] = diagonal[t, k, l]
                    force[k] = gradient[t, k]
                    value = 0
                    for i in range(3):
                        value += diagonal[t, k, K + i] * vertical[i]
                    functions[t, k, K] = functions[t, K, k] = value
                functions[t, K, K] = force[K] = 0
                for c in range(CAMERA):
                    for k in range(K):
                        of_camera[c, k] = diagonal[t, k, K + c]
                    of_camera[c, K] = 0
                    for i in range(CAMERA):
                        image[t, c, i] = diagonal[t, K + min(c, i), K + max(c, i)]
                    for i in range(3):
                        of_camera[c, K] += image[t, c, i] * vertical[i]
                    out_camera[t, c] = gradient[t, K + c]
                for i in range(3):
                    functions[t, K, K] += vertical[i] * of_camera[i, K]
                    force[K] += vertical[i] * gradient[t, K + i]
                multiply_vector(m, m, 1, &functions[t, 0, 0], &slopes[0], 0, &by_omega[0])
                i = 0
                for p in range(P):
                    value = self.terms[t, p]
                    for q in range(p + 1):
                        products[i, t] = value * self.terms[t, q]
                        i += 1
                    for k in range(m):
                        out_gradient[p * m + k] += value * force[k]
                        out[last, p * m + k] += value * by_omega[k]
                    for k in range(K):
                        for l in range(B):
                            bones[p * m + k, l] += value * bone_vectors[t, k, l]
                    for c in range(CAMERA):
                        for k in range(m):
                            mixed[t, c, p * m + k] = value * of_camera[c, k]
                for k in range(m):
                    slope = slopes[k]
                    out_gradient[last] += slope * force[k]
                    out[last, last] += slope * by_omega[k]
                for k in range(K):
                    for l in range(B):
                        bones[last, l] += slopes[k] * bone_vectors[t, k, l]
                for c in range(CAMERA):
                    mixed[t, c, last] = 0
                    for k in range(m):
                        mixed[t, c, last] += of_camera[c, k] * slopes[k]
            multiply(pairs, N, m * m, 1, &products[0, 0], &functions[0, 0, 0], 0, &blocks[0, 0, 0])
            i = 0
            for p in range(P):
                for q in range(p + 1):
                    for k in range(m):
                        memcpy(&out[p * m + k, q * m], &blocks[i, k, 0], m * sizeof(double))
                        memcpy(&out[q * m + k, p * m], &blocks[i, k, 0], m * sizeof(double))
                    i += 1
            for k in range(last):
                out[k, last] = out[last, k]
            add_outer(G, B, -1.0 / N, &bones[0, 0], &out[0, 0])

    cdef void add_movement_and_tilt(self):
        """Add E and e."""
        cdef int N = self.N, t, term, d, e, i, j, f
        cdef double x, y, z, s, change
        cdef double[:, :, ::1] cameras = self.point.cameras, jacobian = np.empty((N, 6, CAMERA))  # of M
        cdef double[:, ::1] pull = np.zeros((N, 6)), squares = np.zeros((N, COUPLED + 1))
        cdef double[3] across
        cdef double[3] along
        with nogil:
            for t in range(N):
                s = exp(self.point.log_scales[t])
                for f in range(3):
                    x, y, z = s * cameras[t, 0, f], s * cameras[t, 1, f], s * cameras[t, 2, f]
                    jacobian[t, f, 0], jacobian[t, f, 1], jacobian[t, f, 2], jacobian[t, f, 3] = 0, z, -y, x
                    jacobian[t, 3 + f, 0], jacobian[t, 3 + f, 1], jacobian[t, 3 + f, 2] = -z, 0, x
                    jacobian[t, 3 + f, 3] = y
            for term in range(2):
                for t in range(N - 1 - term):
                    for e in range(term + 2):
                        for d in range(term + 2 - e):
                            squares[t + e, d] += self.movement[term, t, e] * self.movement[term, t, e + d]
                    for f in range(6):
                        change = self.find_change(term, t, f)
                        for e in range(term + 2):
                            pull[t + e, f] += self.movement[term, t, e] * change
            memset(&self.blocks[0, 0, 0], 0, N * CAMERA * CAMERA * sizeof(double))
            memset(&self.coupling[0, 0, 0, 0], 0, N * COUPLED * CAMERA * CAMERA * sizeof(double))
            for t in range(N):
                for i in range(CAMERA):
                    for f in range(6):
                        self.out_camera[t, i] += jacobian[t, f, i] * pull[t, f]
                        for j in range(CAMERA):
                            self.blocks[t, i, j] += squares[t, 0] * jacobian[t, f, i] * jacobian[t, f, j]
                            for d in range(1, min(COUPLED + 1, N - t)):
                                self.coupling[t, d - 1, i, j] += (
                                    squares[t, d] * jacobian[t + d, f, i] * jacobian[t, f, j]
                                )
                x, y, z = cameras[t, 0, 2], cameras[t, 1, 2], cameras[t, 2, 2]
                across[0], across[1], across[2] = 0, z, -y  # d x / d w
                along[0], along[1], along[2] = y, -x, 0  # d z / d w
                for i in range(3):
                    self.out_camera[t, i] += self.level_weight * (x * across[i] + z * along[i])
                    for j in range(3):
                        self.blocks[t, i, j] += self.level_weight * (across[i] * across[j] + along[i] * along[j])

    # Levenberg-Marquardt

    def solve(self, double damping):
        """Find the step with diagonals of A and C raised by `damping`; False if one is not positive definite.

        Large matrices are upper triangles, whose factorisation is faster than that of lower ones.
        """
        cdef int N = self.N, G = self.G, t, c, k, size = G + 1, rows = N * CAMERA, info = 0, step = 1
        cdef double one = 1, minus = -1
        cdef int first = (1 + COUPLED) * pad_columns(CAMERA), right = pad_columns(size), stride = first + right
        cdef double[:, ::1] bordered = self.bordered
        cdef System system = System(N, CAMERA, COUPLED, CAMERA, right, stride, &self.rows[0, 0, 0])
        for t in range(N):
            for c in range(CAMERA):
                for k in range(CAMERA):
                    self.work[t, c, k] = self.image[t, c, k] + self.blocks[t, c, k]
                self.work[t, c, c] = (1 + damping) * self.work[t, c, c] + MIN_INFORMATION
                memcpy(&self.rows[t, c, first], &self.mixed[t, c, 0], G * sizeof(double))
                self.rows[t, c, first + G] = self.out_camera[t, c]
        write_small_blocks(&system, self.work, self.coupling)
        if not factorise_blocks(&system):  # (V, v) in the place of (B^T, c)
            return False
        for k in range(G):
            memcpy(&bordered[k, 0], &self.matrix[k, 0], G * sizeof(double))
            bordered[k, k] = (1 + damping) * (bordered[k, k] + self.prior_diagonal[k]) + MIN_INFORMATION
            bordered[k, G] = self.right[k]
        bordered[G, G] = LARGE
        dsyrk(b'L', b'N', &size, &rows, &minus, &self.rows[0, 0, first], &stride, &one, &bordered[0, 0], &size)
        dpotrf(b'L', &size, &bordered[0, 0], &size, &info)
        if info != 0:
            return False
        self.x[:] = 0
        self.x[G] = bordered[G, G]
        dtrsv(b'L', b'T', b'N', &size, &bordered[0, 0], &size, &self.x[0], &step)
        for t in range(N):
            for c in range(CAMERA):
                self.remaining[t, c] = -add_up(right, &self.rows[t, c, first], &self.x[0])
        solve_backward(&system, &self.remaining[0, 0])
        self.z[:] = self.remaining[:, :CAMERA]
        self.series_step[:] = self.x[:G]
        return True

    cdef void advance(self):
        """Write the unknowns after the step into the trial point."""
        cdef Point old = self.point, new = self.trial
        cdef int p, k, t
        cdef double limit = MAX_FREQUENCY_STEP * old.omega
        cdef double[9] turn
        for p in range(self.P):
            for k in range(self.m):
                new.series[p, k] = old.series[p, k] + self.x[p * self.m + k]
        new.omega = old.omega + min(max(self.x[self.G - 1], -limit), limit)
        for t in range(self.N):
            rotation_from_vector(&self.z[t, 0], turn)
            multiply_3x3(turn, &old.cameras[t, 0, 0], &new.cameras[t, 0, 0])
            new.log_scales[t] = old.log_scales[t] + min(max(self.z[t, 3], -MAX_LOG_SCALE_STEP), MAX_LOG_SCALE_STEP)
        new.translation = old.translation

    def try_steps(self, double tolerance):
        """Try a step; return whether it was taken, and whether it was not the last (`Problem.try_steps`)."""
        cdef bint is_definite = self.solve(self.damping), is_better = False
        cdef double before = self.costs[0], cost
        if is_definite:
            self.advance()
            cost = self.measure(self.trial, 1)
            is_better = cost < before
        if is_better:
            self.point, self.trial, self.costs[0] = self.trial, self.point, cost
        if is_better and before - cost <= tolerance * cost:
            self.status = CONVERGED
        elif self.damping > MAX_DAMPING:
            self.status = NO_LOWER_STEP if is_definite and isfinite(before) else SINGULAR
            return int(is_better), 0
        else:
            self.status = MAX_ITERATIONS if is_definite else SINGULAR
        self.damping = max(self.damping * (DAMPING_AFTER_SUCCESS if is_better else DAMPING_AFTER_FAILURE), MIN_DAMPING)
        return int(is_better), int(self.status != CONVERGED)


def fit_series(
    const double[::1] times, const double[:, ::1] theta, const double[::1] frequencies, const double[::1] ridge
):
    """Fit series to weights at many frequencies: c_l = (T^T T + D)^-1 T^T theta_l, T the terms (N, P) of one.

    Args:
        times: (N,) s from the time t0 at which the phases are 0.
        theta: (K, N) m.
        frequencies: (C,) rad/s.
        ridge: (P,) the diagonal of D.

    Returns:
        Coefficients (C, K, P) in m and what they explain, sum_l c_l^T T^T theta_l, (C,) m^2.
    """
    cdef int N = times.shape[0], K = theta.shape[0], P = ridge.shape[0], f, t, h, p, k
    cdef double c, s
    fits, explained = np.empty((frequencies.shape[0], K, P)), np.zeros(frequencies.shape[0])
    cdef double[:, :, ::1] out = fits
    cdef double[::1] total = explained
    cdef double[:, ::1] terms = np.ones((P, N)), matrix = np.empty((P, P)), right = np.empty((K, P))
    if P < 3 or P % 2 == 0 or theta.shape[1] != N:
        raise ValueError('a series is a mean and pairs of terms, and each time has a pose')
    with nogil:
        for f in range(frequencies.shape[0]):
            for t in range(N):
                c, s = cos(frequencies[f] * times[t]), sin(frequencies[f] * times[t])
                terms[1, t], terms[2, t] = c, s
                for h in range(2, P // 2 + 1):
                    terms[2 * h - 1, t] = c * terms[2 * h - 3, t] - s * terms[2 * h - 2, t]
                    terms[2 * h, t] = s * terms[2 * h - 3, t] + c * terms[2 * h - 2, t]
            memset(&matrix[0, 0], 0, P * P * sizeof(double))
            for p in range(P):
                matrix[p, p] = ridge[p]
            add_outer(P, N, 1, &terms[0, 0], &matrix[0, 0])
            multiply_transposed(K, N, P, 1, &theta[0, 0], &terms[0, 0], 0, &right[0, 0])
            memcpy(&out[f, 0, 0], &right[0, 0], K * P * sizeof(double))
            factorise(P, &matrix[0, 0])
            solve_rows(P, K, &matrix[0, 0], &out[f, 0, 0], False)
            solve_rows(P, K, &matrix[0, 0], &out[f, 0, 0], True)
            for k in range(K):
                for p in range(P):
                    total[f] += out[f, k, p] * right[k, p]
    return fits, explained


def measure_repetition(const double[::1] times, const double[:, ::1] theta, double cadence):
    """Return how well the newest part of a motion repeats what was one cycle before; NaN if that is not known.

    With theta(t) the base-pose weights at a time, n the newest 0.4 s, and c these and the cycle before them,

        r = 1 - min_T mean_n |theta(t) - theta(t - T)|^2 / (2 mean_c |theta(t) - mean_c theta|^2)

    where T is any length near that of the cycle. This is a coefficient of correlation: 1 if the motion repeats
    itself, 0 if the newest poses have nothing to do with those before, as after a walk has ended in a jump. It is
    not known where the motion is shorter, or does not move.

    Args:
        times: (F,) s, increasing.
        theta: (F, K) m, base-pose weights at these times.
        cadence: Hz, full cycles.
    """
    cdef int K = theta.shape[1], count, newest, i, k, s
    cdef double end = times[times.shape[0] - 1], known = end - times[0] - NEWEST_S, cycle = 1 / cadence
    cdef double shortest = (1 - MAX_STRETCH) * cycle, longest = min((1 + MAX_STRETCH) * cycle, known)
    cdef double spread = 0, least = INFINITY, change, mean, difference
    if known * cadence < 1:
        return NAN
    count, newest = <int> ceil((NEWEST_S + cycle) / SAMPLE_STEP_S), <int> (NEWEST_S / SAMPLE_STEP_S) + 1
    cdef double[:, ::1] poses = np.empty((count, K))
    cdef double[::1] before = np.empty(K)
    for i in range(count):
        interpolate(times, theta, end - i * SAMPLE_STEP_S, &poses[i, 0])
    for k in range(K):
        mean = 0
        for i in range(count):
            mean += poses[i, k]
        mean /= count
        for i in range(count):
            spread += (poses[i, k] - mean) * (poses[i, k] - mean)
    for s in range(STRETCHES):
        cycle, change = shortest + (longest - shortest) * s / (STRETCHES - 1), 0
        for i in range(newest):
            interpolate(times, theta, end - i * SAMPLE_STEP_S - cycle, &before[0])
            for k in range(K):
                difference = poses[i, k] - before[k]
                change += difference * difference
        least = min(least, change)
    return 1 - least / newest / (2 * spread / count) if spread > 0 else NAN


cdef void interpolate(
    const double[::1] times, const double[:, ::1] samples, double time, double* out
) noexcept nogil:
    """Write samples (n, K) of increasing times, interpolated at a time; the ends hold beyond them."""
    cdef int last = times.shape[0] - 1, after = last, k
    cdef double share
    while after > 1 and times[after - 1] >= time:
        after -= 1
    share = min(max((time - times[after - 1]) / (times[after] - times[after - 1]), 0.0), 1.0)
    for k in range(samples.shape[1]):
        out[k] = (1 - share) * samples[after - 1, k] + share * samples[after, k]
