# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""The newest frames of tracked people, as the joint solver gets them and as it leaves them.

The formulas are in `tracking.refinement`, `geometry.virtual_camera` and `solvers.joint`. Sizes: P people, N frames of
all, F frames of one person's window, of which all but the newest are solved, J joints, B bones, K base poses.
"""

from libc.math cimport NAN, isfinite, log, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from mocap_ros.engine.batch cimport BONES, JOINTS, Batch, Path, Sequence, compute_noise_growth, measure_roughness
from mocap_ros.engine.geometry cimport (
    Indices, Rows, Stack, Vector, dot, multiply, multiply_first_transposed, multiply_transposed, rotation_from_vector,
    vector_from_rotation,
)
from mocap_ros.engine.lifted_start cimport PoseFit
from mocap_ros.engine.median cimport find_median
from mocap_ros.engine.terms cimport Frame

cdef double MAX_APPROACH = 0.5  # of the last depth, by which a person comes nearer at most; stays in view
cdef double MIN_DEPTH_M = 1e-3  # m; guards the division by the depth of the body's origin


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


def add_newest(
    Batch batch, Py_ssize_t p, Py_ssize_t fixed_frames, double share, observed, solution, PoseFit pose_fit
):
    """Write the frames of a person, of whom all but the newest are solved, and their state as initial values.

    Args:
        batch: has been made for the frames of all people.
        p: index of the person.
        fixed_frames: number of frames at the beginning that keep their state.
        share: a, of the last step that is repeated.
        observed: `solvers.observed_window.ObservedWindow` of F frames with one virtual camera.
        solution: `tracking.solution.TrackSolution` of F - 1 frames.
        pose_fit: fits the newest lifted pose.
    """
    cdef Vector times = observed.times
    cdef Stack rays = observed.rays, rotation = solution.rotation, lifted = None, std = None
    cdef Rows score = observed.evidence, camera = observed.virtual_camera.rotation
    cdef Rows theta = solution.theta, roots = solution.roots, bone_lengths = solution.bone_lengths
    cdef double focal = observed.virtual_camera.intrinsics.focal, solver_focal = observed.focal
    cdef Sequence* s = &batch.of_sequence[p]
    cdef Py_ssize_t frames = times.shape[0], first = frames - s.count, newest = s.start + s.count - 1, t, n, i
    cdef double variance = 0
    cdef bint is_lifted = batch.has_lifted
    cdef double[3] root
    cdef double[9] turn
    cdef Path path
    cdef double* scales = <double*> malloc(s.count * sizeof(double))
    for t in range(s.count - 1):
        batch.weights[s.start + t] = theta[first + t]
        multiply(&camera[0, 0], &rotation[first + t, 0, 0], &batch.rotations[s.start + t, 0, 0])
        scales[t] = focal / max(dot(&camera[2, 0], &roots[first + t, 0]), MIN_DEPTH_M)
    extrapolate(share, theta, rotation, roots, &batch.weights[newest, 0], turn, root)
    multiply(&camera[0, 0], turn, &batch.rotations[newest, 0, 0])
    scales[s.count - 1] = focal / max(dot(&camera[2, 0], root), MIN_DEPTH_M)
    for t in range(s.count):
        batch.logs[s.start + t] = log(scales[t])
    s.unit = find_median(scales, s.count)
    free(scales)
    for t in range(s.count):
        batch.logs[s.start + t] -= log(s.unit)
    if batch.has_lifted:
        lifted, std = observed.lifted.joints[first:], observed.lifted.std[first:]
    batch.measure(
        p, times[first:], rays[first:], score[first:], &camera[0, 0], focal / s.unit, solver_focal / s.unit, lifted,
        std,
    )
    path = batch.follow(p)
    s.least_noise = measure_roughness(&path) if batch.has_lifted else 0
    path = Path(frames, &times[0], &rays[0, 0, 0], &score[0, 0], 1, 2 * JOINTS, JOINTS, focal / s.unit)
    s.least_noise *= compute_noise_growth(&path)
    for t in range(fixed_frames):
        batch.measured[s.start + t].is_free = False
    s.earlier_frames = first if fixed_frames > 0 else 0
    for i in range(BONES):
        s.earlier_lengths[i] = 0
        for t in range(s.earlier_frames):
            s.earlier_lengths[i] += bone_lengths[t, i] / s.earlier_frames
    for i in range(3 * JOINTS if is_lifted else 0):
        is_lifted = is_lifted and batch.measured[newest].precision[i // 3][i % 3] > 0
        variance += (focal / s.unit * std[s.count - 1, i // 3, i % 3]) ** 2 / (3 * JOINTS)
    if is_lifted:  # the newest pose starts from the lifted one
        pose_fit.fit(
            &batch.measured[newest].lifted[0][0], variance, &batch.weights[newest, 0], &variance,
            &batch.rotations[newest, 0, 0],
        )


def finish_newest(
    Batch batch, Frame[::1] states, const double[:, ::1] squared_errors, fixed_frames, observed, solutions,
    Vector stature_per_bone, Indices parents, Indices children, double hidden_share,
):
    """Return the solution of all F frames of each person, and what follows from it.

    Args:
        batch: has the frames of `add_newest`.
        states: (N,) records of what was found, and squared errors (N, J) m^2.
        fixed_frames: with windows and solutions so far those of `add_newest`, of all people.
        stature_per_bone: (B,) 1; with the joints at the bones' ends those of the model.
        hidden_share: `models.joint_std.HIDDEN_SHARE`.

    Returns:
        For each person weights (F, K) m, rotations (F, 3, 3), roots (F, 3) m, bone lengths (F, B) m and residuals
        (F,) px; then the stature in m, and the residual of the newest frames as a fraction of the body's RMS
        radius.
    """
    cdef Rows camera, theta, roots, lengths
    cdef Stack rotation, lifted_std
    cdef Vector residuals
    cdef double[:, ::1] new_theta, new_roots, new_lengths
    cdef double[:, :, ::1] new_rotation
    cdef double[::1] new_residuals
    cdef const Sequence* s
    cdef const Frame* f
    cdef Py_ssize_t p, frames, first, kept, t, n, i, j, seen, seen_frames, K = batch.weights.shape[1]
    cdef double focal, stature, squares, total, radius, depth, hidden
    cdef double[3] towards
    finished = []
    for p in range(len(solutions)):
        s, solution, lifted_std = &batch.of_sequence[p], solutions[p], None
        camera, focal = observed[p].virtual_camera.rotation, observed[p].virtual_camera.intrinsics.focal
        if observed[p].lifted is not None:
            lifted_std = observed[p].lifted.std
        theta, rotation, roots = solution.theta, solution.rotation, solution.roots
        lengths, residuals = solution.bone_lengths, solution.frame_residuals
        frames = theta.shape[0] + 1
        first, stature, squares, seen_frames = frames - s.count, 0, 0, 0
        kept = first + fixed_frames[p]
        arrays = [np.empty((frames, *shape)) for shape in ((K,), (3, 3), (3,), (BONES,), ())]
        new_theta, new_rotation, new_roots, new_lengths, new_residuals = arrays
        new_theta[:kept], new_rotation[:kept], new_roots[:kept] = theta[:kept], rotation[:kept], roots[:kept]
        new_lengths[:kept], new_residuals[:first] = lengths[:kept], residuals[:first]
        for n in range(first, frames):
            t, seen, total = s.start + n - first, 0, 0
            f = &states[t]
            for j in range(JOINTS):
                if batch.measured[t].score[j] > 0:
                    seen += 1
                    total += squared_errors[t, j]
            new_residuals[n] = s.unit * sqrt(total / seen) if seen > 0 else NAN
            if seen > 0:
                squares += total / seen
                seen_frames += 1
            if n < kept:
                continue
            for i in range(K):
                new_theta[n, i] = f.features[i]
            for i in range(BONES):
                new_lengths[n, i] = f.length[i]
            towards = [f.translation[0], f.translation[1], focal / s.unit]
            multiply_first_transposed(&camera[0, 0], &f.rotation[0][0], &new_rotation[n, 0, 0])
            for i in range(3):
                new_roots[n, i] = (
                    towards[0] * camera[0, i] + towards[1] * camera[1, i] + towards[2] * camera[2, i]
                ) / f.scale
        for n in range(frames):
            depth = dot(&new_roots[n, 0], &camera[2, 0])
            for i in range(BONES):
                hidden = 0
                if lifted_std is not None and stature_per_bone[i] > 0:
                    hidden = depth * max(lifted_std[n, parents[i], 2], lifted_std[n, children[i], 2])
                    hidden = hidden_share * hidden * hidden if isfinite(hidden) else 0
                stature += sqrt(new_lengths[n, i] * new_lengths[n, i] + hidden) * stature_per_bone[i] / frames
        radius, f = 0, &states[s.start + s.count - 1]
        for j in range(JOINTS):
            radius += (f.joints[j][0] * f.joints[j][0] + f.joints[j][1] * f.joints[j][1]) / JOINTS
        finished.append((*arrays, stature, sqrt(squares / seen_frames / radius) if seen_frames > 0 else NAN))
    return finished
