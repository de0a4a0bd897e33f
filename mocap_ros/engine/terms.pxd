# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from mocap_ros.engine.batch cimport BONES, JOINTS, Measured, Sequence

cdef enum:
    MAX_COMPONENTS = 45  # base poses are orthogonal: there are no more than coordinates of joints
    CAMERA = 4  # unknowns of a camera: rotation vector and log s
    FEATURES = 13  # of a camera: s R[:2], R[:2] and log s


cdef struct Frame:  # the unknowns of a frame, and what follows from them
    double[MAX_COMPONENTS + FEATURES] features  # (K + 13,) the weights theta in m, then those of the camera
    double[3][3] rotation  # body frame to camera frame
    double log_scale  # of the scale in the sequence's unit
    double[2] translation  # m, image of the body's origin
    double scale
    double[3 * JOINTS] pose  # m, P in the body frame
    double[JOINTS][3] joints  # m, q = s R P
    double[BONES] length  # m, of the bones


cdef struct Motion:  # the frames of a sequence at a point
    Sequence* sequence
    Measured* known
    Frame* frames


cdef struct Pull:  # what terms of the joints' positions q_j add to the normal equations of a frame
    double[JOINTS][9] matrix  # M_j (3, 3)
    double[JOINTS][3] force  # m_j, half the gradient
    double[JOINTS][6] mixed  # U_j (3, 2), half the second derivatives by q_j and the translation
    double[2] by_translation  # half the gradient by the translation
    double weight  # w, half the second derivative by a coordinate of the translation


cdef struct Equations:  # those of a sequence, as described at the head of `joint.pyx`
    int components, width, frame_size, distances  # K, numbers in a row of a block, numbers of a block, D
    double* blocks  # (F, frame_size) rows (A_tt, g, u)
    double* vectors  # (F, K + 4, B) G
    double* couplings  # (F, D, K + 16)
    double* slopes  # (F, 13, 4) derivatives of the camera's features
    double* weighted  # (3 J, width) rows (S J, m, U) of one frame


cdef class Term:
    cdef readonly int order  # number of the next frames that it couples with each
    cdef double measure(self, Motion* of) noexcept nogil
    cdef void begin(self, Motion* of) noexcept nogil
    cdef void pull_joints(self, Motion* of, int t, Pull* out) noexcept nogil
    cdef void add_to_frame(self, Motion* of, int t, Equations* out) noexcept nogil
    cdef void add_to_motion(self, Motion* of, Equations* out) noexcept nogil


cdef class Reprojection(Term):
    cdef readonly double robust_scale
    cdef double find_robust_scale(self, Sequence* s) noexcept nogil
    cdef void settle(self, Motion* of, double robust_scale) noexcept nogil


cdef double find_error(Motion* of, int t, int j, double* error) noexcept nogil
