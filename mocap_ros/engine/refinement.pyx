# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""The newest frames of tracked people, as the joint solver gets them and as it leaves them.

The formulas are in `tracking.refinement`, `geometry.virtual_camera` and `solvers.joint`. Sizes: P people, N frames of
all, F frames of one person's window, of which all but the newest are solved, J joints, B bones, K base poses.
"""

from libc.math cimport isfinite, log, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from mocap_ros.engine.geometry cimport (
    Indices, Rows, Stack, Vector, dot, multiply, multiply_transposed, rotate_ray, rotation_from_vector,
    vector_from_rotation,
)
from mocap_ros.engine.joint cimport compute_noise_growth, fit_lifted_pose
from mocap_ros.engine.median cimport find_median

cdef extern from *:
    """
    #define MAX_APPROACH 0.5        /* of the last depth, by which a person comes nearer at most; stays in view */
    #define MIN_DEPTH_M 1e-3        /* guards the division by the depth of the body's origin */
    #define MIN_STD_M 0.01          /* a smaller standard deviation of the lifter is not believed */
    #define LASTING_S (1.0 / 30)    /* with the next one as in `solvers.joint.objective` and `.differences` */
    #define MIN_TIME_STEP_S 1e-4    /* guards the divisions by time steps */
    #define MIN_TOTAL_WEIGHT 1e-12  /* guards the division by the weights of a frame in which no joint is seen */
    """
    const double MAX_APPROACH, MIN_DEPTH_M, MIN_STD_M, LASTING_S, MIN_TIME_STEP_S, MIN_TOTAL_WEIGHT


cdef void extrapolate(
    double share, Rows theta, Stack rotation, Rows roots, double* new_theta, double* new_rotation, double* new_root
) noexcept nogil:
    """Write the state of the newest frame, predicted from the last two solved ones, or from one."""
    cdef Py_ssize_t last = theta.shape[0] - 1, before = max(last - 1, 0), k
    cdef double[9] turn
    cdef double[3] vector
    cdef double root_share = share, moved
    multiply_transposed(&rotation[last, 0, 0], &rotation[before, 0, 0], turn)
    vector_from_rotation(turn, vector)
    for k in range(3):
        vector[k] *= share
    rotation_from_vector(vector, turn)
    multiply(turn, &rotation[last, 0, 0], new_rotation)
    moved = roots[last, 2] - roots[before, 2]
    if share * moved < -MAX_APPROACH * roots[last, 2]:  # at few frames a second a person may seem to pass the camera
        root_share = -MAX_APPROACH * roots[last, 2] / moved
    for k in range(theta.shape[1]):
        new_theta[k] = theta[last, k] + share * (theta[last, k] - theta[before, k])
    for k in range(3):
        new_root[k] = roots[last, k] + root_share * (roots[last, k] - roots[before, k])


cdef class NewestFrames:
    """The newest frames of P people, one after the other.

    Args:
        counts: number of frames of each.
        mean: (J, 3) m, mean pose of the model.
        arrays: `models.base_poses.ModelArrays` of it.
        sigma: (K,) m, standard deviations of the weights.
        has_lifted: whether there are lifted poses.

    Attributes:
        times: with the next ten, those of `solvers.joint.batch.Batch`.
        theta: (N, K) with the next three the initial values, those of `solvers.joint.batch.State`.
        units: (P,) px/m.
        growth: (P,) g of `solvers.joint.noise_annealing`, of all frames of the windows.
        factors: (1, N, 3) those of differences of order 1, by `solvers.joint.objective.weigh_motion`.
    """

    cdef readonly object times, starts, counts, image, score, focal, is_free, lifted, precision
    cdef readonly object earlier_lengths, earlier_frames, theta, rotation, log_scale, translation, units, growth
    cdef readonly object factors
    cdef double[::1] time, focals, logs, unit, growths
    cdef long long[::1] start, earlier
    cdef unsigned char[::1] free_frames
    cdef double[:, :, ::1] images, lifts, precisions, rotations, steps
    cdef double[:, ::1] scores, lengths, weights, translations, roots
    cdef Rows mean, basis
    cdef Vector sigma, mean_lengths
    cdef Indices parents, children

    def __init__(self, counts, mean, arrays, sigma, bint has_lifted):
        cdef Py_ssize_t P = len(counts), N = sum(counts), J = len(mean), K = len(sigma), B = len(arrays.parents)
        self.counts = np.array(counts, np.int64)
        self.starts = self.counts.cumsum() - self.counts
        self.times, self.focal, self.units, self.growth = np.empty(N), np.empty(N), np.empty(P), np.empty(P)
        self.image, self.score, self.is_free = np.empty((N, J, 2)), np.empty((N, J)), np.empty(N, np.bool_)
        self.lifted, self.precision = np.empty((N if has_lifted else 0, J, 3)), np.empty((N if has_lifted else 0, J, 3))
        self.earlier_lengths, self.earlier_frames = np.empty((P, B)), np.zeros(P, np.int64)
        self.theta, self.rotation = np.empty((N, K)), np.empty((N, 3, 3))
        self.log_scale, self.translation = np.empty(N), np.empty((N, 2))
        self.factors = np.zeros((1, N, 3))
        self.steps = self.factors
        self.time, self.focals, self.logs, self.unit = self.times, self.focal, self.log_scale, self.units
        self.growths = self.growth
        self.start, self.earlier, self.free_frames = self.starts, self.earlier_frames, self.is_free.view(np.uint8)
        self.images, self.lifts, self.precisions = self.image, self.lifted, self.precision
        self.rotations, self.scores, self.lengths = self.rotation, self.score, self.earlier_lengths
        self.weights = self.theta
        self.translations, self.roots = self.translation, np.empty((N, 3))
        self.mean, self.basis, self.sigma = mean, arrays.components, sigma
        self.mean_lengths, self.parents, self.children = arrays.mean_bone_lengths, arrays.parents, arrays.children

    def add(self, Py_ssize_t p, Py_ssize_t fixed_frames, double share, int alternations, observed, solution):
        """Add the frames of a person, of whom all but the newest are solved.

        Args:
            p: index of the person.
            fixed_frames: number of frames at the beginning that keep their state.
            share: a, of the last step that is repeated.
            alternations: of the fit to the newest lifted pose.
            observed: `solvers.observed_window.ObservedWindow` of F frames with one virtual camera.
            solution: `tracking.solution.TrackSolution` of F - 1 frames.
        """
        cdef Vector times = observed.times
        cdef Stack rays = observed.rays, rotation = solution.rotation, lifted = None, std = None
        cdef Rows weight = observed.evidence, camera = observed.virtual_camera.rotation
        cdef Rows theta = solution.theta, roots = solution.roots, bone_lengths = solution.bone_lengths
        cdef double focal = observed.virtual_camera.intrinsics.focal, solver_focal = observed.focal
        cdef Py_ssize_t start = self.start[p], count = self.counts[p], first = times.shape[0] - count
        cdef Py_ssize_t n, t, j, i, k, J = self.scores.shape[1], B = self.lengths.shape[1], K = self.weights.shape[1]
        cdef double depth, unit, total, x, y, value
        cdef bint is_known = True
        cdef double[9] turn
        cdef double* scales
        if observed.lifted is not None:
            lifted, std = observed.lifted.joints, observed.lifted.std
        scales = <double*> malloc(count * sizeof(double))
        for n in range(count):
            t = start + n
            self.time[t], self.free_frames[t] = times[first + n], n >= fixed_frames
            if n < count - 1:
                for k in range(K):
                    self.weights[t, k] = theta[first + n, k]
                for i in range(3):
                    self.roots[t, i] = roots[first + n, i]
                multiply(&camera[0, 0], &rotation[first + n, 0, 0], &self.rotations[t, 0, 0])
            else:
                extrapolate(share, theta, rotation, roots, &self.weights[t, 0], turn, &self.roots[t, 0])
                multiply(&camera[0, 0], turn, &self.rotations[t, 0, 0])
            depth = max(dot(&camera[2, 0], &self.roots[t, 0]), MIN_DEPTH_M)
            scales[n] = focal / depth
            self.logs[t] = log(scales[n])
        value = max(LASTING_S * (count - 1) / max(times[times.shape[0] - 1] - times[first], MIN_TIME_STEP_S), 1.0)
        for t in range(start, start + count - 1):
            self.steps[0, t, 1] = sqrt(value / max(self.time[t + 1] - self.time[t], MIN_TIME_STEP_S))
            self.steps[0, t, 0] = -self.steps[0, t, 1]
        unit = find_median(scales, count)
        free(scales)
        self.unit[p] = unit
        self.growths[p] = compute_noise_growth(rays, weight, times, 0, times.shape[0], focal / unit)
        for n in range(count):
            t = start + n
            self.focals[t] = solver_focal / unit
            self.logs[t] -= log(unit)
            total = x = y = 0
            for j in range(J):
                value = weight[first + n, j]
                self.scores[t, j], self.images[t, j, 0], self.images[t, j, 1] = value, 0.0, 0.0
                if value > 0:
                    rotate_ray(&camera[0, 0], rays[first + n, j, 0], rays[first + n, j, 1], focal / unit,
                               &self.images[t, j, 0])
                    total += value
                    x += value * self.images[t, j, 0]
                    y += value * self.images[t, j, 1]
            total = max(total, MIN_TOTAL_WEIGHT)
            self.translations[t, 0], self.translations[t, 1] = x / total, y / total
        self.earlier[p] = first if fixed_frames > 0 else 0
        for k in range(B):
            self.lengths[p, k] = self.mean_lengths[k] if self.earlier[p] == 0 else 0.0
            for n in range(self.earlier[p]):
                self.lengths[p, k] += bone_lengths[n, k] / self.earlier[p]
        if lifted is None:
            return
        for n in range(count):
            t = start + n
            for j in range(J):
                for i in range(3):
                    value = dot(&camera[i, 0], &lifted[first + n, j, 0])
                    depth = std[first + n, j, i]
                    if isfinite(value):
                        self.lifts[t, j, i] = focal * value / unit
                        depth = max(focal * depth / unit, MIN_STD_M)
                        self.precisions[t, j, i] = 1 / (depth * depth)
                    else:
                        self.lifts[t, j, i] = self.precisions[t, j, i] = 0.0
                        is_known = is_known and n < count - 1
        if is_known:  # the newest pose starts from the lifted one
            t = start + count - 1
            fit_lifted_pose(
                &self.lifts[t, 0, 0], &std[first + count - 1, 0, 0], focal / unit, self.basis, self.mean, self.sigma,
                alternations, &self.weights[t, 0], &value, &self.rotations[t, 0, 0],
            )

    def finish(
        self, fixed_frames, observed, solutions, Rows theta, Stack rotation, Stack joints, Vector scale,
        Rows translation, Vector residuals, Vector stature_per_bone, double hidden_share,
    ):
        """Return the solution of all F frames of each person, and what follows from it.

        Fixed frames, windows and solutions are those of `add`, of all people; weights (N, K) m, rotations (N, 3, 3)
        in the virtual cameras, joints (N, J, 3) m, scales (N,) px/m, translations (N, 2) px and residuals (N,) px
        are what the solver found; `hidden_share` is `models.joint_std.HIDDEN_SHARE`.

        Returns:
            For each person weights (F, K) m, rotations (F, 3, 3), roots (F, 3) m, bone lengths (F, B) m and residuals
            (F,) px; then the stature in m, and the residual of the newest frames as a fraction of the body's RMS
            radius.
        """
        return [
            self.finish_person(
                p, fixed_frames[p], observed[p], solutions[p], theta, rotation, joints, scale, translation, residuals,
                stature_per_bone, hidden_share,
            )
            for p in range(len(solutions))
        ]

    cdef tuple finish_person(
        self, Py_ssize_t p, Py_ssize_t fixed_frames, observed, solution, Rows new_theta, Stack new_rotation,
        Stack joints, Vector scale, Rows translation, Vector new_residuals, Vector stature_per_bone,
        double hidden_share,
    ):
        cdef Rows camera = observed.virtual_camera.rotation
        cdef Stack lifted_std = None if observed.lifted is None else observed.lifted.std
        cdef Rows theta = solution.theta, roots = solution.roots, bone_lengths = solution.bone_lengths
        cdef Stack rotation = solution.rotation
        cdef Vector residuals = solution.frame_residuals
        cdef double focal = observed.virtual_camera.intrinsics.focal
        cdef Py_ssize_t frames = theta.shape[0] + 1, start = self.start[p], count = self.counts[p]
        cdef Py_ssize_t first = frames - count, kept = first + fixed_frames, n, t, i, k, seen = 0
        cdef Py_ssize_t K = theta.shape[1], B = bone_lengths.shape[1], J = joints.shape[1]
        cdef double stature = 0, squares = 0, radius = 0, depth, hidden
        cdef double[3] towards
        arrays = [np.empty((frames, *shape)) for shape in ((K,), (3, 3), (3,), (B,), ())]
        cdef double[:, ::1] out_theta = arrays[0], out_roots = arrays[2], out_lengths = arrays[3]
        cdef double[:, :, ::1] out_rotation = arrays[1]
        cdef double[::1] out_residuals = arrays[4]
        out_theta[:kept], out_rotation[:kept], out_roots[:kept] = theta[:kept], rotation[:kept], roots[:kept]
        out_lengths[:kept], out_residuals[:first] = bone_lengths[:kept], residuals[:first]
        for n in range(first, frames):
            t = start + n - first
            out_residuals[n] = new_residuals[t]
            if isfinite(new_residuals[t]):
                squares += new_residuals[t] * new_residuals[t]
                seen += 1
            if n < kept:
                continue
            for k in range(K):
                out_theta[n, k] = new_theta[t, k]
            towards = [translation[t, 0] / scale[t], translation[t, 1] / scale[t], focal / scale[t]]
            for i in range(3):
                out_roots[n, i] = towards[0] * camera[0, i] + towards[1] * camera[1, i] + towards[2] * camera[2, i]
                for k in range(3):
                    out_rotation[n, i, k] = (
                        camera[0, i] * new_rotation[t, 0, k] + camera[1, i] * new_rotation[t, 1, k]
                        + camera[2, i] * new_rotation[t, 2, k]
                    )
            for k in range(B):
                for i in range(3):
                    towards[i] = joints[t, self.children[k], i] - joints[t, self.parents[k], i]
                out_lengths[n, k] = sqrt(dot(towards, towards))
        for n in range(frames):
            depth = dot(&out_roots[n, 0], &camera[2, 0])
            for k in range(B):
                hidden = 0
                if lifted_std is not None and stature_per_bone[k] > 0:
                    hidden = depth * max(lifted_std[n, self.parents[k], 2], lifted_std[n, self.children[k], 2])
                    hidden = hidden_share * hidden * hidden if isfinite(hidden) else 0
                stature += sqrt(out_lengths[n, k] * out_lengths[n, k] + hidden) * stature_per_bone[k]
        t = start + count - 1
        for k in range(J):
            radius += (joints[t, k, 0] * joints[t, k, 0] + joints[t, k, 1] * joints[t, k, 1]) / J
        return *arrays, stature / frames, sqrt(squares / seen if seen > 0 else np.nan) / (sqrt(radius) * scale[t])
