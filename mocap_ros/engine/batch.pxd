# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: cdivision=True

from libc.math cimport INFINITY, log1p

cdef enum:
    JOINTS = 15  # J, B: of `skeleton.CMU15`, which all base poses have
    BONES = 14


cdef struct Measured:  # what is known of a frame
    double time  # s
    double focal  # m, focal length; infinite for weak perspective
    long long is_free  # 0 for first frames of a sequence that keep their initial values
    double[2] centroid  # m, weighted mean of the image points
    double[JOINTS][2] image  # m
    double[JOINTS] score  # of confidence; 0 for a joint that was not seen
    double[JOINTS][3] lifted  # m, lifted pose about the mean of the joints
    double[JOINTS][3] precision  # 1/m^2, inverse variances of these coordinates; 0 where nothing is known


cdef struct Sequence:
    long long start, count  # index of its first frame in the batch, and number of its frames
    double unit  # px/m, by which image lengths are divided
    double noise_ratio  # image noise over that of the reference
    double least_noise  # m, that the points show by themselves, whatever the poses; 0 without lifted poses
    double motion_share  # weight of changes over time: as errors of a detector last, more frames a second say no more
    long long earlier_frames  # number of the frames before the first, and their mean bone lengths in m
    double[BONES] earlier_lengths


cdef inline double compute_loss(double squared, double c) noexcept nogil:
    """Return Cauchy's loss rho of a squared error; c is infinite for least squares."""
    return squared if c == INFINITY else c * c * log1p(squared / (c * c))


cdef struct Path:  # image points over time, with the distances in memory between those of two frames
    int count
    const double* times
    const double* points
    const double* score
    Py_ssize_t time_stride, point_stride, score_stride
    double unit  # m


cdef double measure_roughness(const Path* path) noexcept nogil
cdef double compute_noise_growth(const Path* path) noexcept nogil


cdef class Batch:
    cdef readonly object frames, sequences, theta, rotation, log_scale
    cdef readonly bint has_lifted
    cdef Measured[::1] measured
    cdef Sequence[::1] of_sequence
    cdef double[:, ::1] weights
    cdef double[:, :, ::1] rotations
    cdef double[::1] logs
    cdef Path follow(self, Py_ssize_t p) noexcept nogil
    cdef void measure(
        self, Py_ssize_t p, const double[:] times, const double[:, :, :] points, const double[:, :] score,
        const double* camera, double factor, double focal, const double[:, :, ::1] lifted, const double[:, :, :] std,
    ) noexcept nogil
