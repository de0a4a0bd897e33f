# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""What the joint solver is given: sequences of any number of people and hypotheses, one after the other.

Image lengths are divided by the sequence's unit in px/m, so that they are metres at the body. The formulas of the
noise that points show by themselves are in `solvers.joint.noise_annealing`.
"""

from libc.math cimport isfinite, sqrt

import numpy as np

from mocap_ros.engine.geometry cimport dot, rotate_ray, square

MIN_TIME_STEP_S = 1e-4  # s; guards divisions by time steps, far below that of any camera
cdef double MIN_STEP_S = MIN_TIME_STEP_S
cdef double LASTING_S = 1.0 / 30  # s; frames that are nearer have the same errors, for which weights were tuned
cdef double MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen
cdef double MIN_STD_M = 0.01  # m; a smaller standard deviation of the lifter is not believed: its poses are no better
cdef double ROUGHNESS_STEP_S = 1.0 / 30  # s between the frames of which third differences are taken
cdef double MAX_ROUGHNESS_STEP_S = 0.05  # s; third differences over longer ones are those of the motion
cdef double ROUGHNESS_LOSS_M = 0.02  # m; c of the loss of third differences: joints jump in single frames
cdef double MOTION_ROUGHNESS_M = 0.002  # m; q of people who move, without noise
cdef double NOISE_OVER_ROUGHNESS = 4.0  # 1; detectors err by 3 to 5 times what is new in a frame of 30 Hz
cdef double WHITE_CORRELATION = 0.27  # of third differences two frames apart; 0.3 of white noise, less by motion
cdef double WALK_CORRELATION = 1.0 / 6  # the same, of errors that wander

cdef Measured _measured
cdef Sequence _sequence
MEASURED, SEQUENCE = np.asarray(<Measured[:1]> &_measured).dtype, np.asarray(<Sequence[:1]> &_sequence).dtype


cdef class Batch:
    """The measurements of P sequences of N frames in all, and the values from which a solver starts.

    Args:
        counts: (P,) number of frames of each sequence.
        components: K, number of base poses.
        has_lifted: whether there are lifted poses.

    Attributes:
        frames: (N,) records `Measured`.
        sequences: (P,) records `Sequence`.
        theta: (N, K) m, base-pose weights.
        rotation: (N, 3, 3) body frame to camera frame.
        log_scale: (N,) logarithm of the scale in the sequence's unit.
    """

    def __init__(self, counts, Py_ssize_t components, bint has_lifted):
        cdef Py_ssize_t frames = sum(counts)
        self.frames, self.sequences = np.zeros(frames, MEASURED), np.zeros(len(counts), SEQUENCE)
        self.has_lifted = has_lifted
        self.sequences['count'], self.sequences['start'] = counts, np.cumsum(counts) - counts
        self.sequences['noise_ratio'] = 1
        self.theta, self.rotation = np.empty((frames, components)), np.empty((frames, 3, 3))
        self.log_scale = np.empty(frames)
        self.measured, self.of_sequence = self.frames, self.sequences
        self.weights, self.rotations, self.logs = self.theta, self.rotation, self.log_scale

    cdef void measure(
        self, Py_ssize_t p, const double[:] times, const double[:, :, :] points, const double[:, :] score,
        const double* camera, double factor, double focal, const double[:, :, ::1] lifted, const double[:, :, :] std,
    ) noexcept nogil:
        """Write the measurements of a sequence of free frames.

        Points (F, J, 2) and lifted poses (F, J, 3) are turned by the rotation `camera`; `factor` times them, and
        times the standard deviations of poses (F, J, 3), is in m, as is `focal`.
        """
        cdef Sequence* s = &self.of_sequence[p]
        cdef Measured* m
        cdef Py_ssize_t t, j, i
        cdef double total, value, deviation
        for t in range(s.count):
            m, total = &self.measured[s.start + t], 0
            m.time, m.focal, m.is_free, m.centroid[0], m.centroid[1] = times[t], focal, True, 0, 0
            for j in range(JOINTS):
                m.score[j], m.image[j][0], m.image[j][1] = score[t, j], 0, 0
                if m.score[j] > 0:
                    rotate_ray(camera, points[t, j, 0], points[t, j, 1], factor, m.image[j])
                    total += m.score[j]
                    for i in range(2):
                        m.centroid[i] += m.score[j] * m.image[j][i]
                for i in range(3 if self.has_lifted else 0):
                    value = factor * dot(camera + 3 * i, &lifted[t, j, 0])
                    deviation = max(factor * std[t, j, i], MIN_STD_M)
                    m.lifted[j][i] = value if isfinite(value) else 0
                    m.precision[j][i] = 1 / (deviation * deviation) if isfinite(value) else 0
            for i in range(2):
                m.centroid[i] /= max(total, MIN_TOTAL_WEIGHT)
        value = max(times[s.count - 1] - times[0], MIN_STEP_S)
        s.motion_share, s.earlier_frames = max(LASTING_S * (s.count - 1) / value, 1), 0

    cdef Path follow(self, Py_ssize_t p) noexcept nogil:
        """Return the image points of a sequence."""
        cdef const Measured* first = &self.measured[self.of_sequence[p].start]
        cdef int stride = sizeof(Measured) // sizeof(double)
        return Path(
            self.of_sequence[p].count, &first.time, &first.image[0][0], &first.score[0], stride, stride, stride, 1
        )

    def measure_window(self, Py_ssize_t p, window, double unit):
        """Write the measurements of a `solvers.window.Window`, of which `unit` px are 1 m."""
        cdef double[9] identity = [1, 0, 0, 0, 1, 0, 0, 0, 1]
        cdef const double[:, :, ::1] lifted = None
        cdef const double[:, :, :] std = None
        if self.has_lifted:
            lifted, std = np.ascontiguousarray(window.lifted.joints), window.lifted.std
        self.of_sequence[p].unit = unit
        self.measure(
            p, window.times, window.points, window.weight, identity, 1 / unit, window.focal / unit, lifted, std
        )

    def measure_least_noise(self):
        """Find the noise that the points of each sequence show by themselves."""
        cdef Py_ssize_t p
        cdef Path path
        for p in range(self.of_sequence.shape[0]):
            path = self.follow(p)
            self.of_sequence[p].least_noise = measure_roughness(&path) if self.has_lifted else 0
            if self.of_sequence[p].least_noise > 0:
                self.of_sequence[p].least_noise *= compute_noise_growth(&path)


cdef int count_frames_of_step(const Path* path, double* step) noexcept nogil:
    """Find the mean time between frames, and return how many are a step between the points of a third difference."""
    step[0] = (path.times[(path.count - 1) * path.time_stride] - path.times[0]) / (path.count - 1)
    return max(<int> (ROUGHNESS_STEP_S / max(step[0], MIN_STEP_S) + 0.5), 1)


cdef double take_third_difference(const Path* path, int t, int j, int s, double* out) noexcept nogil:
    """Write that of a point (2,) m over the frames t - 3 s, ..., t, and return the least score of these."""
    cdef const double* newest = path.points + t * path.point_stride + 2 * j
    cdef const double* score = path.score + t * path.score_stride + j
    cdef Py_ssize_t step = s * path.point_stride
    cdef int i
    for i in range(2):
        out[i] = path.unit * (newest[i] - 3 * newest[i - step] + 3 * newest[i - 2 * step] - newest[i - 3 * step])
    step = s * path.score_stride
    return min(min(score[0], score[-step]), min(score[-2 * step], score[-3 * step]))


cdef double measure_roughness(const Path* path) noexcept nogil:
    """Return what is new in each frame of points in m, as of white noise; 0 if it is not known."""
    cdef int t, j, s, points = 0
    cdef double step, squares = 0, weight
    cdef double[2] change
    if path.count < 4:
        return 0
    s = count_frames_of_step(path, &step)
    if s * step > MAX_ROUGHNESS_STEP_S:
        return 0
    for t in range(3 * s, path.count):
        if path.times[t * path.time_stride] - path.times[(t - 3 * s) * path.time_stride] > 4.5 * s * step:
            continue
        for j in range(JOINTS):
            weight = take_third_difference(path, t, j, s, change)
            if weight > 0:
                points += 1
                squares += weight * compute_loss(
                    (square(change[0]) + square(change[1])) / 20, ROUGHNESS_LOSS_M
                )
    return sqrt(max(squares / (2 * points) - square(MOTION_ROUGHNESS_M), 0)) if points > 0 else 0


cdef double compute_noise_growth(const Path* path) noexcept nogil:
    """g of `solvers.joint.noise_annealing`: the errors of points over what is new of them in each frame."""
    cdef int t, j, s
    cdef double step, products = 0, powers = 0, weight, correlation, newer, older
    cdef double[2] new
    cdef double[2] old
    if path.count < 6:
        return NOISE_OVER_ROUGHNESS
    s = count_frames_of_step(path, &step)
    for t in range(5 * s, path.count):
        if path.times[t * path.time_stride] - path.times[(t - 5 * s) * path.time_stride] > 7.5 * s * step:
            continue
        for j in range(JOINTS):
            weight = take_third_difference(path, t, j, s, new)
            weight = min(weight, take_third_difference(path, t - 2 * s, j, s, old))
            if not weight > 0:
                continue
            newer, older = square(new[0]) + square(new[1]), square(old[0]) + square(old[1])
            weight /= 1 + max(newer, older) / (20 * square(ROUGHNESS_LOSS_M))
            products += weight * (new[0] * old[0] + new[1] * old[1])
            powers += weight * (newer + older) / 2
    correlation = products / powers if powers > 0 else 0
    correlation = (WHITE_CORRELATION - correlation) / (WHITE_CORRELATION - WALK_CORRELATION)
    return 1 + (NOISE_OVER_ROUGHNESS - 1) * min(max(correlation, 0), 1)
