# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Rays of rotated cameras and of lenses; the formulas are in `geometry.virtual_camera` and `geometry.distortion`."""

import numpy as np

ctypedef const double[:, ::1] Rows
ctypedef const double[:, :, ::1] Stack


def turn_to_axes(Rows rays):
    """Return the smallest rotations (N, 3, 3) that bring rays (N, 2) to the optical axis."""
    cdef Py_ssize_t n
    result = np.empty((rays.shape[0], 3, 3))
    cdef double[:, :, ::1] out = result
    for n in range(rays.shape[0]):
        turn_to_axis(rays[n, 0], rays[n, 1], &out[n, 0, 0])
    return result


def face_points(Stack rays, Rows weight, double min_total):
    """Return the smallest rotation (3, 3) that brings the weighted centroid of rays (F, J, 2) to the optical axis."""
    cdef Py_ssize_t n, j
    cdef double x = 0, y = 0, total = 0
    result = np.empty((3, 3))
    cdef double[:, ::1] out = result
    for n in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            x += weight[n, j] * rays[n, j, 0]
            y += weight[n, j] * rays[n, j, 1]
            total += weight[n, j]
    total = max(total, min_total)
    turn_to_axis(x / total, y / total, &out[0, 0])
    return result


def rotate_rays(Stack rays, Stack rotation):
    """Return the rays of N groups (N, M, 2), each rotated by its rotation (N, 3, 3)."""
    cdef Py_ssize_t n, m
    result = np.empty((rays.shape[0], rays.shape[1], 2))
    cdef double[:, :, ::1] out = result
    for n in range(rays.shape[0]):
        for m in range(rays.shape[1]):
            rotate_ray(&rotation[n, 0, 0], rays[n, m, 0], rays[n, m, 1], 1.0, &out[n, m, 0])
    return result


def view_rays(Stack rays, Rows weight, Stack rotation, double focal):
    """Return the image points (F, J, 2) of rays, 0 where the weight is 0; rotation (F, 3, 3), or (1, 3, 3) for all."""
    cdef Py_ssize_t n, j
    result = np.zeros((rays.shape[0], rays.shape[1], 2))
    cdef double[:, :, ::1] out = result
    for n in range(rays.shape[0]):
        for j in range(rays.shape[1]):
            if weight[n, j] > 0:
                rotate_ray(&rotation[n % rotation.shape[0], 0, 0], rays[n, j, 0], rays[n, j, 1], focal, &out[n, j, 0])
    return result


def distort_points(Rows points, const double[::1] lens):
    """Return where a lens shows normalised points (N, 2)."""
    cdef Py_ssize_t n
    result = np.empty((points.shape[0], 2))
    cdef double[:, ::1] out = result
    for n in range(points.shape[0]):
        distort_point(points[n, 0], points[n, 1], &lens[0], &out[n, 0])
    return result


def undistort_points(Rows points, const double[::1] lens):
    """Return the normalised points (N, 2) that a lens shows at these points."""
    cdef Py_ssize_t n
    result = np.empty((points.shape[0], 2))
    cdef double[:, ::1] out = result
    for n in range(points.shape[0]):
        undistort_point(points[n, 0], points[n, 1], &lens[0], &out[n, 0])
    return result
