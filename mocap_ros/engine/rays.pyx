# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""Rays of lenses and of rotated cameras, and a detector's keypoints as rays to the joints of the model.

The formulas are in `geometry.distortion`, `geometry.virtual_camera`, and `keypoints.joint_map`, `keypoints.rays`.
Sizes: F frames, S keypoints of the detector, A alternatives, J joints of the model, E extremities.
"""

from libc.math cimport INFINITY, NAN, exp, fabs, hypot, isfinite, isinf, sqrt, tan

import numpy as np

from mocap_ros.engine.geometry cimport (
    MAX_RAY_ANGLE, Rows, Stack, Vector, distort_point, rotate_ray, turn_to_axis, undistort_point,
)


cdef double MIN_SCORED_WEIGHT = 0.08  # a keypoint of a smaller weight in the sum decides nothing about the score
cdef double MAX_POINT_PX = 1e7  # px; far outside any image; keeps arithmetic finite
cdef double MAX_SCORE = 1.0  # scores are probabilities
# So near to the middle no neck and no pelvis is seen: a share of the size of the body in the image, and what whole
# pixels are off. True ones are 14 % of the trunk away.
cdef double MIDWAY_SHARE = 0.006, MIDWAY_PX = 1.1


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


def distort_points(Rows points, Vector lens):
    """Return where a lens shows normalised points (N, 2)."""
    cdef Py_ssize_t n
    result = np.empty((points.shape[0], 2))
    cdef double[:, ::1] out = result
    for n in range(points.shape[0]):
        distort_point(points[n, 0], points[n, 1], &lens[0], &out[n, 0])
    return result


def undistort_points(Rows points, Vector lens):
    """Return the normalised points (N, 2) that a lens shows at these points."""
    cdef Py_ssize_t n
    result = np.empty((points.shape[0], 2))
    cdef double[:, ::1] out = result
    for n in range(points.shape[0]):
        undistort_point(points[n, 0], points[n, 1], &lens[0], &out[n, 0])
    return result


def mark_unseen(const double[:, :, :] points, const double[:, :] score, double max_coordinate):
    """Return points (N, S, 2) px and scores (N, S) as of `validation.mark_unseen`, and whether one of them is faulty.

    A coordinate beyond `max_coordinate` px and an infinite score are.
    """
    cdef Py_ssize_t n, s
    cdef bint is_low = False, is_high = False, is_faulty = False
    cdef double x, y, value, largest
    if not (points.shape[0] == score.shape[0] and points.shape[1] == score.shape[1] and points.shape[2] == 2):
        raise ValueError(f'points {points.shape}, but scores {score.shape}')
    result = np.empty((score.shape[0], score.shape[1], 2)), np.zeros((score.shape[0], score.shape[1]))
    cdef double[:, :, ::1] out = result[0]
    cdef double[:, ::1] out_score = result[1]
    out[:] = NAN
    for n in range(score.shape[0]):
        for s in range(score.shape[1]):
            is_low, is_high = is_low or score[n, s] < -1, is_high or score[n, s] > 1
            is_faulty = is_faulty or fabs(points[n, s, 0]) > max_coordinate or fabs(points[n, s, 1]) > max_coordinate
            is_faulty = is_faulty or isinf(score[n, s])
    for n in range(score.shape[0]):
        largest = 1.0
        for s in range(score.shape[1]):
            x, y, value = points[n, s, 0], points[n, s, 1], score[n, s]
            if is_low and is_high:
                value = 1 / (1 + exp(-value))
            if value > 0 and isfinite(x) and isfinite(y) and not (x == y and (x == 0 or x == -1)):
                out[n, s, 0], out[n, s, 1], out_score[n, s] = x, y, value
                largest = max(largest, value)
        for s in range(score.shape[1]):
            out_score[n, s] /= largest
    return result[0], result[1], bool(is_faulty)


cdef double find_least_score(
    const double* points, const double* score, const double* weights, Py_ssize_t sources, Py_ssize_t dimensions
) noexcept nogil:
    """Least score of the keypoints (S, D) whose weights count; 0 if a keypoint of the sum was not seen."""
    cdef Py_ssize_t s, d
    cdef double least = INFINITY
    for s in range(sources):
        if weights[s] == 0:
            continue
        if not score[s] > 0:
            return 0.0
        for d in range(dimensions):
            if not isfinite(points[s * dimensions + d]):
                return 0.0
        if fabs(weights[s]) >= MIN_SCORED_WEIGHT:
            least = min(least, score[s])
    return least


def map_joints(Stack points, Rows score, Stack weights, Rows score_factor):
    """Return the joints (F, J, D) and scores (F, J) of keypoints (F, S, D) with scores (F, S).

    y_t = sum_s W_ts x_s, by the first alternative whose keypoints were all seen; NaN and 0 if there is none.

    `points` any unit; `score` 0 for keypoints that were not seen; `weights` (A, J, S) W; `score_factor` (A, J)
    factors on the least score.
    """
    frames, joints = points.shape[0], score_factor.shape[1]
    mapped, mapped_score = np.empty((frames, joints, points.shape[2])), np.empty((frames, joints))
    map_frames(points, score, weights, score_factor, mapped, mapped_score)
    return mapped, mapped_score


cdef void map_frames(
    Stack points, Rows score, Stack weights, Rows score_factor, double[:, :, ::1] out, double[:, ::1] out_score
) noexcept nogil:
    cdef Py_ssize_t n, t, a, s, d, dimensions = points.shape[2], sources = points.shape[1]
    cdef double least
    for n in range(points.shape[0]):
        for t in range(score_factor.shape[1]):
            out_score[n, t] = 0.0
            for d in range(dimensions):
                out[n, t, d] = NAN
            for a in range(score_factor.shape[0]):
                if not score_factor[a, t] > 0:
                    continue
                least = find_least_score(&points[n, 0, 0], &score[n, 0], &weights[a, t, 0], sources, dimensions)
                if not least > 0:
                    continue
                out_score[n, t] = least * score_factor[a, t]
                for d in range(dimensions):
                    out[n, t, d] = 0.0
                for s in range(sources):
                    if weights[a, t, s] != 0:
                        for d in range(dimensions):
                            out[n, t, d] += weights[a, t, s] * points[n, s, d]
                break


cdef inline bint find_offset(
    const double* rays, const double* weight, Py_ssize_t joint, const long long* ends, double* out
) noexcept nogil:
    """Write by how much a joint is off the middle between two others (2,); return whether all three were seen."""
    cdef int d
    for d in range(2):
        out[d] = rays[2 * joint + d] - (rays[2 * ends[0] + d] + rays[2 * ends[1] + d]) / 2
    return weight[joint] > 0 and weight[ends[0]] > 0 and weight[ends[1]] > 0


def convert_to_rays(
    Stack points, Rows score, Stack weights, Rows score_factor, double min_score, Vector focal_lengths, Vector center,
    Vector lens, const unsigned char[::1] shows, const long long[:, ::1] midway, int min_evidence,
    const long long[:, ::1] anchors, Vector reach,
):
    """Return rays (F, C, 2), scores (F, C) and evidence (F, C) of the core, and (F, E, 2) and (F, E) of extremities.

    Points (F, S, 2) in px with scores (F, S) below `min_score`, or NaN, are not seen; rays and scores are 0 where
    nothing was seen. The J joints are the core, then the extremities; those too far from the core to belong to it
    count as not seen. Where fewer than `min_evidence` joints are seen evidence, all are evidence.

    `weights` (A, J, S), `score_factor` (A, J), `shows` (J,) and `midway` (M, 3) are attributes of `JointMap`; `lens`
    is `Distortion.parameters`; `anchors` (E, 2) the two joints of the core between which each extremity hangs, it
    stays where one was not seen; `reach` (E,) largest distance from there, as a share of the diagonal of the core's
    points.
    """
    cdef Py_ssize_t n, s, t, m, joints = score_factor.shape[1], core = joints - reach.shape[0]
    cdef int count
    cdef double max_ray = tan(MAX_RAY_ANGLE)  # beyond it no camera shows anything
    cdef double low_x, low_y, high_x, high_y, tolerance
    cdef double[2] offset
    if not (points.shape[0] == score.shape[0] and points.shape[1] == score.shape[1] == weights.shape[2]
            and points.shape[2] == 2):
        raise ValueError(f'points {points.shape} and scores {score.shape} of {weights.shape[2]} joints')
    cdef double[:, ::1] used = np.zeros((score.shape[0], score.shape[1]))
    body = np.empty((score.shape[0], joints, 2)), np.empty((score.shape[0], joints))
    is_evidence = np.empty((score.shape[0], core), bool)
    cdef double[:, :, ::1] rays = body[0]
    cdef double[:, ::1] weight = body[1]
    cdef unsigned char[:, ::1] evidence = is_evidence.view(np.uint8)
    for n in range(score.shape[0]):
        for s in range(score.shape[1]):
            if (fabs(points[n, s, 0]) < MAX_POINT_PX and fabs(points[n, s, 1]) < MAX_POINT_PX
                    and score[n, s] >= min_score):
                used[n, s] = min(score[n, s], MAX_SCORE)
    map_frames(points, used, weights, score_factor, rays, weight)
    for n in range(score.shape[0]):
        low_x = low_y = INFINITY
        high_x = high_y = -INFINITY
        for t in range(joints):
            if weight[n, t] > 0:
                undistort_point(
                    (rays[n, t, 0] - center[0]) / focal_lengths[0], (rays[n, t, 1] - center[1]) / focal_lengths[1],
                    &lens[0], &rays[n, t, 0],
                )
            if not (weight[n, t] > 0 and fabs(rays[n, t, 0]) <= max_ray and fabs(rays[n, t, 1]) <= max_ray):
                rays[n, t, 0] = rays[n, t, 1] = weight[n, t] = 0.0
            elif t < core:
                low_x, high_x = min(low_x, rays[n, t, 0]), max(high_x, rays[n, t, 0])
                low_y, high_y = min(low_y, rays[n, t, 1]), max(high_y, rays[n, t, 1])
        for t in range(core):
            evidence[n, t] = shows[t]
        tolerance = max(
            MIDWAY_SHARE * max(high_x - low_x, high_y - low_y), MIDWAY_PX / sqrt(focal_lengths[0] * focal_lengths[1])
        )
        for m in range(midway.shape[0]):
            if find_offset(&rays[n, 0, 0], &weight[n, 0], midway[m, 0], &midway[m, 1], offset):
                if max(fabs(offset[0]), fabs(offset[1])) <= tolerance:
                    evidence[n, midway[m, 0]] = 0
        count = 0
        for t in range(core):
            count += evidence[n, t] and weight[n, t] > 0
        for t in range(core if count < min_evidence else 0):
            evidence[n, t] = 1
        for t in range(core, joints):
            if find_offset(&rays[n, 0, 0], &weight[n, 0], t, &anchors[t - core, 0], offset) and hypot(
                offset[0], offset[1]
            ) > reach[t - core] * hypot(high_x - low_x, high_y - low_y):
                rays[n, t, 0] = rays[n, t, 1] = weight[n, t] = 0.0
    parts = [np.ascontiguousarray(array[:, part]) for part in (slice(core), slice(core, None)) for array in body]
    return parts[0], parts[1], is_evidence, parts[2], parts[3]
