# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The normal equations of the joint solver and Levenberg-Marquardt, for any list of `terms`.

A step x has n = K + 4 numbers a frame: changes of the weights, a rotation vector w with R <- exp([w]x) R, and the
change of log s; the translation is eliminated. The normal equations are (A - G G^T / F) x = -g, A block banded
(`block_banded`) and G of the bones (`terms.BoneLengths`). Terms of the joints' positions have Gauss-Newton matrices
M_j (3, 3) and half gradients m_j (3,) by q_j, and U_j (3, 2) are the mixed second derivatives by q_j and the
translation. In the body frame, where dq_j / dx = s R J_j and the first K columns of J_j are always the same, these
are S_j = s^2 R^T M_j R, s R^T m_j and s R^T U_j. Bones add their matrices to those of the joints at their ends. One
product then gives the block of a frame, its gradient, and u = sum_j J_j^T s R^T U_j:

    J^T (S J, m, U),    less u u^T / w for the elimination of the translation

with w the second derivative by the translation. The B mean bone lengths are unknowns z more, which are eliminated
last. With A = U^T U under damping, y = U^-T g and V = U^-T G,

    (F I - V^T V) z = -V^T y,    x = -U^-1 (y - V z)

Sequences are not coupled: each has a damping of its own, and steps until it has converged.

Sizes: P sequences, N frames of all and F of one, J joints, B bones, K base poses, differences of order up to D.
"""

from libc.math cimport NAN, exp, isfinite, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.batch cimport BONES, JOINTS, Batch, Sequence
from mocap_ros.engine.blas cimport multiply_vector
from mocap_ros.engine.block_banded cimport (
    TILE_COLUMNS, TILE_ROWS, System, add_products, add_up, factorise_blocks, pad_columns, pad_rows, solve_backward,
    solve_forward,
)
from mocap_ros.engine.geometry cimport (
    cross, dot, multiply, multiply_first_transposed, rotation_from_vector, square, subtract, transform,
)
from mocap_ros.engine.terms cimport (
    CAMERA, FEATURES, Equations, Frame, Motion, Pull, Reprojection, Term, find_error,
)

cdef extern from *:
    """
    /* T = S J: S (3, 3), J (3, size). */
    WIDE static void weigh_rows(Py_ssize_t size, const double *s, const double *j, double *__restrict t) {
        for (Py_ssize_t i = 0; i < size; i++)
            for (int row = 0; row < 3; row++)
                t[row * size + i] = s[3 * row] * j[i] + s[3 * row + 1] * j[size + i]
                                  + s[3 * row + 2] * j[2 * size + i];
    }
    """
    void weigh_rows(Py_ssize_t, const double*, const double*, double*) noexcept nogil

cdef enum:
    MAX_TERMS = 8

cpdef enum Ending:  # why a search ended, or its last step
    SINGULAR = -1
    MAX_ITERATIONS = 0
    CONVERGED = 1
    NO_LOWER_STEP = 2

cdef double MIN_LENGTH = 1e-9  # m; guards the division by the length of a bone
cdef double MAX_LOG_SCALE_STEP = 1  # of one step; a larger one is a failed linearisation
cdef double MIN_DIAGONAL = 1e-12  # added to the diagonal, for unknowns on which nothing depends
cdef double LARGE = 1e300  # keeps a matrix positive definite whatever is subtracted
cdef double MIN_INFORMATION = 1e-9  # m^2; keeps a block solvable in which the image does not determine an unknown
cdef double MIN_DAMPING = 1e-5  # relative; a smaller damping changes no digit of a step that matters
cdef double MAX_DAMPING = 1e8  # relative; a sequence whose steps are still refused under more is at its minimum
cdef double DAMPING_AFTER_SUCCESS = 0.2  # factor; tuned on CMU views for few steps, as the next
cdef double DAMPING_AFTER_FAILURE = 10
cdef double MIN_FREE_SHARE = 0.05  # of the coordinates; so many still measure the noise if all are fitted
cdef int COUNTED_FRAMES = 3  # frames of a sequence, at least, in which absorbed coordinates are counted
cdef int COUNTED_FRAME_STEP = 15  # frames; of a longer sequence one further frame in so many is counted


cdef struct Search:  # of a sequence
    double cost  # m^2
    double damping
    long long iterations  # number of steps that were tried
    long long status  # an `Ending`
    bint is_done, is_outdated, has_step


cdef Frame _frame
cdef Search _search
FRAME, SEARCH = np.asarray(<Frame[:1]> &_frame).dtype, np.asarray(<Search[:1]> &_search).dtype


cdef bint end_trial(Search* search, bint is_definite, double cost, double tolerance) noexcept nogil:
    """Set the next damping of a search, or its end, after a step to this cost; return whether the step is taken."""
    cdef bint is_better = is_definite and cost < search.cost
    cdef double before = search.cost
    search.iterations += 1
    if is_better:
        search.cost, search.is_outdated = cost, True
    if is_better and before - cost <= tolerance * cost:
        search.status, search.is_done = CONVERGED, True
    elif search.damping > MAX_DAMPING:
        search.status = NO_LOWER_STEP if is_definite and isfinite(before) else SINGULAR
        search.is_done = True
    else:
        search.status = MAX_ITERATIONS if is_definite else SINGULAR
    search.damping *= DAMPING_AFTER_SUCCESS if is_better else DAMPING_AFTER_FAILURE
    search.damping = max(search.damping, MIN_DAMPING)
    return is_better


def end_step(Search[::1] search, bint is_definite, double cost, double tolerance):
    """End a step of the only search, as `JointProblem.try_steps` does; return whether the step is taken."""
    return end_trial(&search[0], is_definite, cost, tolerance)


cdef class JointProblem:
    """The objectives of P sequences with N frames in all, a point, and what Levenberg-Marquardt needs.

    Args:
        batch: the measurements. They may change before `start`, but not in size.
        model: base poses.
        arrays: `models.base_poses.ModelArrays` of them.
        terms: the objective; the reprojection comes first, if there is one.
        components: K, so many base poses count.

    Attributes:
        frames: (N,) records `Frame` of the current point.
        searches: (P,) records `Search`.
        diagonal: (N, n, n) blocks of the normal equations; only their upper triangles are written.
        gradient: (N, n) half the gradient.
        bone_vectors: (N, n, B) G.
        coupling: (N, D, K + 16) blocks in the rows of frame t and the columns of frame t + d + 1: the diagonal of the
            weights, and the block of the cameras (4, 4).
    """

    cdef readonly Batch batch
    cdef readonly tuple terms
    cdef void* term_pointers[MAX_TERMS]
    cdef int term_count
    cdef Reprojection reprojection
    cdef readonly int components  # K
    cdef int sequences, unknowns, distances  # P, n, D
    cdef const double[:, ::1] basis, mean  # (3 J, K), (J, 3)
    cdef const long long[::1] parents, children  # (B,)
    # the current point, that after a step, and that of the normal equations
    cdef readonly object frames
    cdef Frame[::1] current, trial, linearised
    cdef readonly object searches
    cdef Search[::1] search
    # the normal equations: (N, n, n + 3) A, g and u, filled up for `block_banded`
    cdef readonly object diagonal, gradient, bone_vectors, coupling
    cdef double[:, :, ::1] equations, vectors, couplings
    cdef double[:, :, ::1] last_factor  # (P, n, n) of the last step: U_tt of the last frame, filled up
    # working memory: J and (S J, m, U), (3 J, n + 3) filled up; the rows of a sequence, and of a frame alone
    cdef double[:, ::1] jacobian, weighted, alone, products, step, by_translation
    cdef double[:, :, ::1] system, slopes
    cdef double[::1] means

    def __init__(self, Batch batch, model, arrays, tuple terms, int components):
        cdef int N = len(batch.frames), P = len(batch.sequences), n = components + CAMERA, D = 1, i
        cdef int largest = max(batch.sequences['count'])
        if len(terms) > MAX_TERMS:
            raise ValueError(f'an objective has at most {MAX_TERMS} terms')
        self.batch, self.terms, self.term_count = batch, terms, len(terms)
        for i in range(self.term_count):
            self.term_pointers[i] = <void*> <Term> terms[i]
            D = max(D, (<Term> terms[i]).order)
        self.reprojection = terms[0] if isinstance(terms[0], Reprojection) else None
        self.sequences, self.components, self.unknowns, self.distances = P, components, n, D
        self.basis, self.mean = arrays.components[:, :components].copy(), model.mean
        self.parents, self.children = arrays.parents, arrays.children
        self.frames, self.searches = np.zeros(N, FRAME), np.zeros(P, SEARCH)
        self.current, self.search = self.frames, self.searches
        self.trial, self.linearised = np.zeros(N, FRAME), np.zeros(N, FRAME)
        cdef int rows = pad_rows(n), size = pad_columns(n), width = pad_columns(n + 3), right = pad_columns(BONES + 1)
        equations = np.zeros((N, rows, width))
        self.equations, self.diagonal, self.gradient = equations, equations[:, :n, :n], equations[:, :n, n]
        self.vectors = self.bone_vectors = np.zeros((N, n, BONES))
        self.couplings = self.coupling = np.empty((N, D, components + CAMERA * CAMERA))
        self.last_factor = np.zeros((P, rows, size))
        self.jacobian, self.weighted = np.zeros((3 * JOINTS, width)), np.zeros((3 * JOINTS, width))
        self.jacobian[:, :components] = self.basis
        self.system = np.zeros((largest, rows, (1 + D) * size + right))
        self.alone = np.zeros((rows, size + pad_columns(3 * JOINTS)))
        self.products, self.means = np.zeros((right, right)), np.zeros(right)
        self.step, self.slopes = np.zeros((largest, size)), np.empty((largest, FEATURES, CAMERA))
        self.by_translation = np.zeros((2, width))

    @property
    def cost(self):
        """Objectives (P,) in m^2 at the current point."""
        return self.searches['cost']


    # The point

    cdef void place(self, Frame* f) noexcept nogil:
        """Write what follows from the unknowns of a frame."""
        cdef int i, j, b, K = self.components
        cdef double[3] bone
        cdef double* camera = f.features + K
        f.scale = exp(f.log_scale)
        for i in range(6):
            camera[i], camera[6 + i] = f.scale * (&f.rotation[0][0])[i], (&f.rotation[0][0])[i]
        camera[12] = f.log_scale
        if K == 0:  # a camera alone
            return
        memcpy(f.pose, &self.mean[0, 0], sizeof(f.pose))
        multiply_vector(3 * JOINTS, K, 1, &self.basis[0, 0], f.features, 1, f.pose)
        for j in range(JOINTS):
            transform(&f.rotation[0][0], f.pose + 3 * j, f.joints[j])
            for i in range(3):
                f.joints[j][i] *= f.scale
        for b in range(BONES):
            subtract(f.pose + 3 * self.children[b], f.pose + 3 * self.parents[b], bone)
            f.length[b] = max(sqrt(dot(bone, bone)), MIN_LENGTH)

    cdef Motion select(self, int p, Frame* frames) noexcept nogil:
        """Return the frames of a sequence at a point."""
        cdef Sequence* s = &self.batch.of_sequence[p]
        return Motion(s, &self.batch.measured[s.start], frames + s.start)

    cdef double measure(self, int p, Frame* frames, double settle_scale) noexcept nogil:
        """Write what follows from the unknowns of a sequence, and return its objective in m^2.

        `settle_scale` m is the c under which the translations settle by one step; 0 keeps them.
        """
        cdef Motion of = self.select(p, frames)
        cdef double cost = 0
        cdef int t, i
        for t in range(of.sequence.count):
            self.place(&of.frames[t])
        if settle_scale > 0:
            self.reprojection.settle(&of, settle_scale)
        for i in range(self.term_count):
            cost += (<Term> self.term_pointers[i]).measure(&of)
        return cost

    # Normal equations

    cdef void write_jacobian(self, Frame* f) noexcept nogil:
        """Write the columns of the camera of J: r_a x P_j for the rotations, with r_a the rows of R, and P_j."""
        cdef int j, a, i
        cdef double[3] turned
        for j in range(JOINTS):
            for a in range(3):
                cross(f.rotation[a], f.pose + 3 * j, turned)
                for i in range(3):
                    self.jacobian[3 * j + i, self.components + a] = turned[i]
                self.jacobian[3 * j + a, self.components + 3] = f.pose[3 * j + a]

    cdef void write_slopes(self, Frame* f, double* out) noexcept nogil:
        """Write the derivatives (13, 4) of the camera's features by the rotation vector and log s."""
        cdef int i, c
        cdef double factor
        memset(out, 0, FEATURES * CAMERA * sizeof(double))
        for i in range(12):
            c, factor = i % 3, f.scale if i < 6 else 1
            if i % 6 < 3:  # of the first image axis
                out[1], out[2] = factor * f.rotation[2][c], -factor * f.rotation[1][c]
            else:
                out[0], out[2] = -factor * f.rotation[2][c], factor * f.rotation[0][c]
            out[3] = f.features[self.components + i] if i < 6 else 0
            out += CAMERA
        out[3] = 1

    cdef void linearise(self, int p) noexcept nogil:
        """Write the normal equations of a sequence at the current point."""
        cdef Sequence* s = &self.batch.of_sequence[p]
        cdef Motion of = self.select(p, &self.linearised[0])
        cdef int t, i, width = self.equations.shape[2]
        cdef Equations out = Equations(
            self.components, width, self.equations.shape[1] * width, self.distances, &self.equations[s.start, 0, 0],
            &self.vectors[s.start, 0, 0], &self.couplings[s.start, 0, 0], &self.slopes[0, 0, 0], &self.weighted[0, 0],
        )
        memcpy(of.frames, &self.current[s.start], s.count * sizeof(Frame))
        memset(out.couplings, 0, s.count * self.distances * self.couplings.shape[2] * sizeof(double))
        memset(out.blocks, 0, s.count * out.frame_size * sizeof(double))
        self.search[p].is_outdated = False
        for i in range(self.term_count):
            (<Term> self.term_pointers[i]).begin(&of)
        for t in range(s.count):
            if of.known[t].is_free:
                self.linearise_frame(&of, t, &out)
            self.write_slopes(&of.frames[t], out.slopes + t * FEATURES * CAMERA)
        for i in range(self.term_count):
            (<Term> self.term_pointers[i]).add_to_motion(&of, &out)

    cdef void linearise_frame(self, Motion* of, int t, Equations* out) noexcept nogil:
        """Write the block of a frame, of terms that do not depend on others."""
        cdef int i, a, n = self.unknowns, width = out.width
        cdef Pull pull
        cdef double* u = &self.by_translation[0, 0]
        cdef double* block = out.blocks + t * out.frame_size
        if self.components > 0:  # else a camera alone
            self.write_weighted_jacobian(of, t, &pull)
        for i in range(self.term_count):
            (<Term> self.term_pointers[i]).add_to_frame(of, t, out)
        if self.components == 0:
            return
        add_product(3 * JOINTS, n, width, 1, &self.jacobian[0, 0], out.weighted, block)
        if pull.weight > 0:
            for a in range(2):
                for i in range(n):
                    u[a * width + i] = block[i * width + n + 1 + a]
                u[a * width + n] = pull.by_translation[a]
            add_product(2, n, width, -1 / pull.weight, u, u, block)

    cdef void write_weighted_jacobian(self, Motion* of, int t, Pull* pull) noexcept nogil:
        """Write J and (S J, m, U) of a frame by the terms of its joints' positions, of which the bones are not."""
        cdef int i, j
        cdef double[9] camera
        cdef double[9] matrix
        cdef double[9] vectors
        memset(pull, 0, sizeof(Pull))
        scale_rotation(&of.frames[t], camera)
        self.write_jacobian(&of.frames[t])
        for i in range(self.term_count):
            (<Term> self.term_pointers[i]).pull_joints(of, t, pull)
        for j in range(JOINTS):
            turn_to_body(camera, pull, j, matrix, vectors)
            weigh_rows(self.jacobian.shape[1], matrix, &self.jacobian[3 * j, 0], &self.weighted[3 * j, 0])
            for i in range(3):
                memcpy(&self.weighted[3 * j + i, self.unknowns], vectors + 3 * i, 3 * sizeof(double))

    # Levenberg-Marquardt

    cdef bint solve(self, int p) noexcept nogil:
        """Write the negative of the damped step of a sequence; False if its matrix is not positive definite."""
        cdef Sequence* s = &self.batch.of_sequence[p]
        cdef int start = s.start, end = start + s.count, n = self.unknowns, K = self.components
        cdef int D = self.distances, size = pad_columns(n), right = self.products.shape[0]
        cdef int stride = self.system.shape[2], t, d, i, j, b
        cdef double* row
        cdef double* solved
        cdef System system, means
        while start < end - 1 and not self.batch.measured[start].is_free:
            start += 1
        system = System(end - start, n, D, CAMERA, right, stride, &self.system[0, 0, 0])
        for t in range(start, end):
            for i in range(n):
                row, j = &self.system[t - start, i, 0], i // TILE_COLUMNS * TILE_COLUMNS
                memcpy(row + j, &self.equations[t, i, j], (n - j) * sizeof(double))
                memset(row + size, 0, D * size * sizeof(double))
                row[i] += self.search[p].damping * row[i] + MIN_DIAGONAL
                for d in range(D):
                    if i < K:
                        row[(1 + d) * size + i] = self.couplings[t, d, i]
                        continue
                    memcpy(row + (1 + d) * size + K, &self.couplings[t, d, K + CAMERA * (i - K)], CAMERA * sizeof(double))
                memcpy(row + (1 + D) * size, &self.vectors[t, i, 0], BONES * sizeof(double))
                row[(1 + D) * size + BONES] = self.equations[t, i, n]
        if not factorise_blocks(&system):
            return False
        # (F I - V^T V, -V^T y) and a last row with any large r on the diagonal: U^-1 (0, r^(1/2)) is (-z, 1)
        memset(&self.products[0, 0], 0, right * right * sizeof(double))
        for t in range(end - start):
            solved = &self.system[t, 0, (1 + D) * size]
            for i from 0 <= i < right by TILE_ROWS:
                for j from i // TILE_COLUMNS * TILE_COLUMNS <= j < right by TILE_COLUMNS:
                    add_products(0, n, -1, solved + i, solved + j, stride, &self.products[i, j], right, NULL)
        for b in range(BONES):
            self.products[b, b] += s.count + s.earlier_frames
        self.products[BONES, BONES] = LARGE
        means = System(1, BONES + 1, 0, BONES + 1, 0, right, &self.products[0, 0])
        if not factorise_blocks(&means):
            return False
        memset(&self.means[0], 0, right * sizeof(double))
        self.means[BONES] = 1 / self.products[BONES, BONES]
        solve_backward(&means, &self.means[0])
        memset(&self.step[0, 0], 0, s.count * size * sizeof(double))
        for t in range(end - start):
            for i in range(n):
                self.step[t, i] = add_up(right, &self.system[t, i, (1 + D) * size], &self.means[0])
        solve_backward(&system, &self.step[0, 0])
        for i in range(n):
            memcpy(&self.last_factor[p, i, 0], &self.system[end - start - 1, i, 0], size * sizeof(double))
        self.search[p].has_step = True
        return True

    cdef void advance(self, Sequence* s) noexcept nogil:
        """Write the unknowns of a sequence after the step into the trial point."""
        cdef int t, i, row = 0, K = self.components
        cdef double[3] vector
        cdef double[9] turn
        cdef double* step
        cdef Frame* after
        memcpy(&self.trial[s.start], &self.current[s.start], s.count * sizeof(Frame))
        for t in range(s.start, s.start + s.count):
            if not self.batch.measured[t].is_free:
                continue
            after, step = &self.trial[t], &self.step[row, 0]
            for i in range(K):
                after.features[i] -= step[i]
            for i in range(3):
                vector[i] = -step[K + i]
            rotation_from_vector(vector, turn)
            multiply(turn, &self.current[t].rotation[0][0], &after.rotation[0][0])
            after.log_scale += min(max(-step[K + 3], -MAX_LOG_SCALE_STEP), MAX_LOG_SCALE_STEP)
            row += 1

    cdef bint take_step(self, int p, double tolerance) noexcept nogil:
        """Try a step of a sequence, set its next damping or its end, and return whether the step is taken."""
        cdef Sequence* s = &self.batch.of_sequence[p]
        cdef double cost = 0
        cdef bint is_definite = self.solve(p)
        if is_definite:
            self.advance(s)
            cost = self.measure(p, &self.trial[0], self.reprojection.find_robust_scale(s))
        if not end_trial(&self.search[p], is_definite, cost, tolerance):
            return False
        memcpy(&self.current[s.start], &self.trial[s.start], s.count * sizeof(Frame))
        return True

    # Noise and covariance

    cdef void write_alone(self, Frame* f, double* block, int stride) noexcept nogil:
        """Write the rows (A, J^T) of one frame, with the block A of rows of this length."""
        cdef int i, j
        self.write_jacobian(f)
        for i in range(self.unknowns):
            memcpy(&self.alone[i, 0], block + i * stride, self.unknowns * sizeof(double))
            for j in range(3 * JOINTS):
                self.alone[i, pad_columns(self.unknowns) + j] = self.jacobian[j, i]

    cdef double count_absorbed_coordinates(self, Motion* of, int t) noexcept nogil:
        """Return how many image coordinates of a frame its unknowns fit away while its neighbours are held.

        It is tr(A_t^-1 D_t) + 2, with D_t = sum_j J_j^T S_j J_j - u u^T / w the part of the block A_t that the
        reprojection has added, and the two coordinates that the translation takes. With A_t = U^T U it follows from
        the products of U^-T J_j^T.
        """
        cdef int i, j, k, a, n = self.unknowns, size = pad_columns(n), stride = self.alone.shape[1]
        cdef double total = 0
        cdef Pull pull
        cdef double[9] camera
        cdef double[9] matrix
        cdef double[9] vectors
        cdef double* y
        cdef Frame* f = &of.frames[t]
        cdef System system = System(1, n, 0, n, stride - size, stride, &self.alone[0, 0])
        self.write_alone(f, &self.equations[of.sequence.start + t, 0, 0], self.equations.shape[2])
        for i in range(n):
            self.alone[i, i] += MIN_INFORMATION
            self.by_translation[0, i] = self.by_translation[1, i] = 0
        if not factorise_blocks(&system):
            return 2
        memset(&pull, 0, sizeof(pull))
        scale_rotation(f, camera)
        self.reprojection.pull_joints(of, t, &pull)
        for j in range(JOINTS):
            turn_to_body(camera, &pull, j, matrix, vectors)
            for i in range(n):
                y = &self.alone[i, size + 3 * j]
                for k in range(3):
                    total += y[k] * dot(matrix + 3 * k, y)
                    for a in range(2):
                        self.by_translation[a, i] += y[k] * vectors[3 * k + 1 + a]
        for i in range(n if pull.weight > 0 else 0):
            for a in range(2):
                total -= square(self.by_translation[a, i]) / pull.weight
        return 2 + total

    def measure_misfit(self):
        """Return what the poses leave unexplained, as a noise (P,) m of a coordinate of a point of weight 1.

        It follows from the residual and the coordinates that are not absorbed.
        """
        cdef int p, t, j, count, first, stride, coordinates, counted
        cdef double absorbed
        cdef Motion of
        cdef double[::1] out = self.measure_residual()
        for p in range(self.sequences):
            of = self.select(p, &self.linearised[0])
            count, first, coordinates, counted, absorbed = of.sequence.count, 0, 0, 0, 0
            for t in range(count):
                for j in range(JOINTS):
                    coordinates += 2 * (of.known[t].score[j] > 0)
            while first < count and not of.known[first].is_free:
                first += 1
            stride = COUNTED_FRAMES + (count - first) // COUNTED_FRAME_STEP
            stride = max((count - first + stride - 1) // stride, 1)
            for t from first <= t < count by stride:
                absorbed += self.count_absorbed_coordinates(&of, t)
                counted += 1
            absorbed *= count
            out[p] = sqrt(
                out[p] / max(coordinates - absorbed / max(counted, 1), MIN_FREE_SHARE * coordinates + 1)
            )
        return np.asarray(out)

    def measure_joint_std(self):
        """Return the posterior standard deviations (P, J) of the last joints about the body's origin.

        They are roots of the traces of their covariances, relative to the reference noise; NaN where no step could
        be computed.
        """
        cdef int p, j, i, k, n = self.unknowns, size = pad_columns(n), stride = self.alone.shape[1]
        cdef double total
        cdef double* y
        cdef Sequence* s
        std = np.full((self.sequences, JOINTS), NAN)
        cdef double[:, ::1] out = std
        for p in range(self.sequences):
            if not self.search[p].has_step:
                continue
            s = &self.batch.of_sequence[p]
            self.write_alone(&self.current[s.start + s.count - 1], &self.last_factor[p, 0, 0], size)
            memset(&self.alone[n - 1, size], 0, 3 * JOINTS * sizeof(double))  # the scale moves no joint
            solve_forward(n, stride - size, stride, &self.alone[0, 0])
            for j in range(JOINTS):
                total = 0
                for i in range(n):
                    y = &self.alone[i, size + 3 * j]
                    total += dot(y, y)
                out[p, j] = sqrt(total)
        return std

    # What Python calls

    def start(self, theta, rotation, log_scale, translation, int settle_steps=0, bint at_reference=False):
        """Set the point: theta (N, K), rotation (N, 3, 3), log_scale (N,), translation (N, 2).

        Translations take `settle_steps` of the robust fit, `at_reference` under the scale of the reference noise.
        """
        cdef int p, i
        cdef double c
        self.frames['features'][:, : self.components], self.frames['rotation'] = theta, rotation
        self.frames['log_scale'], self.frames['translation'] = log_scale, translation
        with nogil:
            for p in range(self.sequences):
                c = 0
                if settle_steps > 0:
                    c = self.reprojection.find_robust_scale(&self.batch.of_sequence[p])
                    c = self.reprojection.robust_scale if at_reference else c
                for i in range(max(settle_steps, 1)):
                    self.search[p].cost = self.measure(p, &self.current[0], c)

    def begin(self, double damping):
        """Set the damping of the first step of all sequences, and compute the normal equations."""
        cdef int p
        with nogil:
            for p in range(self.sequences):
                self.search[p] = Search(self.search[p].cost, damping, 0, MAX_ITERATIONS, False, False, False)
                self.linearise(p)

    def update_equations(self):
        """Compute the normal equations of the sequences that have moved and are not done."""
        cdef int p
        with nogil:
            for p in range(self.sequences):
                if self.search[p].is_outdated and not self.search[p].is_done:
                    self.linearise(p)

    def try_steps(self, double tolerance):
        """Try a step of each sequence; return how many were taken, and how many sequences are not done.

        Normal equations that are not those of the current point are computed first. A step that lowers an objective
        by no more than a share `tolerance` of it is the last of its sequence.
        """
        cdef int p, taken = 0, remaining = 0
        self.update_equations()
        with nogil:
            for p in range(self.sequences):
                if not self.search[p].is_done:
                    taken += self.take_step(p, tolerance)
                    remaining += not self.search[p].is_done
        return taken, remaining

    def read_camera_blocks(self):
        """Return the blocks (N, 4, 4) of the cameras in the normal equations, symmetric."""
        cdef int t, i, j, K = self.components
        cdef double[:, :, ::1] out = np.empty((len(self.frames), CAMERA, CAMERA))
        for t in range(out.shape[0]):
            for i in range(CAMERA):
                for j in range(i, CAMERA):
                    out[t, i, j] = out[t, j, i] = self.equations[t, K + i, K + j]
        return np.asarray(out)

    def measure_residual(self):
        """Return the reprojection's cost (P,) m^2 without the weight that the image noise gives it."""
        cdef int p
        cdef Motion of
        cdef double[::1] out = np.empty(self.sequences)
        for p in range(self.sequences):
            of = self.select(p, &self.current[0])
            out[p] = square(of.sequence.noise_ratio) * self.reprojection.measure(&of)
        return np.asarray(out)

    def measure_squared_errors(self):
        """Return the squares (N, J) m^2 of the errors of the points at the current point."""
        cdef int t, j
        cdef double[3] error
        cdef double[:, ::1] out = np.empty((len(self.frames), JOINTS))
        cdef Motion of = Motion(NULL, &self.batch.measured[0], &self.current[0])
        for t in range(out.shape[0]):
            for j in range(JOINTS):
                find_error(&of, t, j, error)
                out[t, j] = error[2]
        return np.asarray(out)


cdef inline void scale_rotation(Frame* f, double* out) noexcept nogil:
    """Write s R."""
    cdef int i
    for i in range(9):
        out[i] = f.scale * (&f.rotation[0][0])[i]


cdef inline void turn_to_body(
    double* camera, Pull* pull, int j, double* matrix, double* vectors
) noexcept nogil:
    """Write S_j (3, 3) and s R^T (m_j, U_j) (3, 3) of a joint, by s R."""
    cdef int i
    cdef double[9] product
    multiply(pull.matrix[j], camera, product)
    multiply_first_transposed(camera, product, matrix)
    for i in range(3):
        product[3 * i] = pull.force[j][i]
        product[3 * i + 1], product[3 * i + 2] = pull.mixed[j][2 * i], pull.mixed[j][2 * i + 1]
    multiply_first_transposed(camera, product, vectors)


cdef void add_product(
    int k, int n, int width, double factor, double* a, double* b, double* out
) noexcept nogil:
    """C += factor A^T B: A and B (k, width), of C (n, width) the tiles from those of the diagonal on."""
    cdef int i, j
    for i from 0 <= i < n by TILE_ROWS:
        for j from i // TILE_COLUMNS * TILE_COLUMNS <= j < width by TILE_COLUMNS:
            add_products(0, k, factor, a + i, b + j, width, out + i * width + j, width, NULL)
