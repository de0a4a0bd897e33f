# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False

"""The lifter from image points to poses; the formulas are in `models.lifter_input`, `models.network`, `models.lifter`.

Sizes: F frames, N histories, T slots, J joints, J_c of the core, which come first, I inputs, W hidden units, H hidden
layers, O = 5 J outputs.
"""

from libc.math cimport INFINITY, NAN, exp, fabs, isfinite, sqrt

import numpy as np

from mocap_ros.engine.geometry cimport Rows, Stack, Vector, dot, rotate_ray, turn_to_axis

ctypedef const float[::1] Floats

cdef extern from *:
    """
    #define MAX_FEATURE 5.0        /* mean distances from the centroid; bounds the effect of gross outliers */
    #define MAX_COORDINATE 1e12    /* units of the input; the squares of larger coordinates could overflow */
    #define ANGULAR_SIZE_UNIT_RAD 0.1 /* brings the angular size of a person at usual distances to the order of 1 */
    #define MIN_TOTAL_WEIGHT 1e-9  /* guards divisions by sums of confidence scores */
    #define MIN_SEEN_JOINTS 3      /* core joints of the newest frame; fewer say hardly anything of a pose */

    /* y += a C, z += b C for rows C of codes, eight rows at a time to fetch and store y and z less often. Processors
       with AVX2 or AVX-512 convert and multiply 8 or 16 codes at once, which no compiler does by itself as well. */
    #define SUM(name, code) \\
    static void name(const code *codes, Py_ssize_t width, const long long *rows, Py_ssize_t count, const float *a, \\
                     const float *b, float *__restrict y, float *__restrict z) { \\
        for (Py_ssize_t n = 0; n < count; n++) \\
            for (Py_ssize_t o = 0; o < width; o++) { \\
                y[o] += a[n] * codes[rows[n] * width + o]; \\
                z[o] += b[n] * codes[rows[n] * width + o]; \\
            } \\
    }
    SUM(add_codes_8, signed char)
    SUM(add_codes_16, short)
    #if defined(__x86_64__) && defined(__GNUC__)
    #include <immintrin.h>
    #define SUM_WIDE(name, features, code, lanes, vector, set, convert, from, load, multiply_add, store) \\
    __attribute__((target(features))) \\
    static void name(const code *codes, Py_ssize_t width, const long long *rows, Py_ssize_t count, const float *a, \\
                     const float *b, float *y, float *z) { \\
        for (Py_ssize_t n = 0; n < count; n += 8) { \\
            const code *row[8]; \\
            vector p[8], q[8]; \\
            for (int k = 0; k < 8; k++) { \\
                row[k] = codes + rows[n + k] * width; \\
                p[k] = set(a[n + k]); \\
                q[k] = set(b[n + k]); \\
            } \\
            for (Py_ssize_t o = 0; o < width; o += lanes) { \\
                vector s = load(y + o), t = load(z + o); \\
                for (int k = 0; k < 8; k++) { \\
                    const vector w = convert(from((const void *) (row[k] + o))); \\
                    s = multiply_add(p[k], w, s); \\
                    t = multiply_add(q[k], w, t); \\
                } \\
                store(y + o, s); \\
                store(z + o, t); \\
            } \\
        } \\
    }
    #define SUM_AVX2(name, code, from) SUM_WIDE(name##_avx2, "avx2,fma", code, 8, __m256, _mm256_set1_ps, \\
        _mm256_cvtepi32_ps, from, _mm256_loadu_ps, _mm256_fmadd_ps, _mm256_storeu_ps)
    #define SUM_AVX512(name, code, from) SUM_WIDE(name##_avx512, "avx512f", code, 16, __m512, _mm512_set1_ps, \\
        _mm512_cvtepi32_ps, from, _mm512_loadu_ps, _mm512_fmadd_ps, _mm512_storeu_ps)
    #define LOAD_8(from) _mm256_cvtepi8_epi32(_mm_loadl_epi64(from))
    #define LOAD_16(from) _mm256_cvtepi16_epi32(_mm_loadu_si128(from))
    #define LOAD_8_WIDE(from) _mm512_cvtepi8_epi32(_mm_loadu_si128(from))
    #define LOAD_16_WIDE(from) _mm512_cvtepi16_epi32(_mm256_loadu_si256(from))
    SUM_AVX2(add_codes_8, signed char, LOAD_8)
    SUM_AVX2(add_codes_16, short, LOAD_16)
    SUM_AVX512(add_codes_8, signed char, LOAD_8_WIDE)
    SUM_AVX512(add_codes_16, short, LOAD_16_WIDE)
    #define CHOOSE(name) (__builtin_cpu_supports("avx512f") ? name##_avx512 : \\
                          __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? name##_avx2 : name)
    #else
    #define CHOOSE(name) name
    #endif
    #define ADD_CODES_8 CHOOSE(add_codes_8)
    #define ADD_CODES_16 CHOOSE(add_codes_16)
    """
    const double MAX_FEATURE, MAX_COORDINATE, ANGULAR_SIZE_UNIT_RAD, MIN_TOTAL_WEIGHT
    const int MIN_SEEN_JOINTS
    void ADD_CODES_8(const signed char*, Py_ssize_t, const long long*, Py_ssize_t, const float*, const float*, float*,
                     float*) noexcept nogil
    void ADD_CODES_16(const short*, Py_ssize_t, const long long*, Py_ssize_t, const float*, const float*, float*,
                      float*) noexcept nogil

cdef enum:
    TILE = 64  # rows of weights, a multiple of 8; few enough to stay in the cache

ctypedef fused Code:
    signed char
    short


cdef void sample_history(
    Stack rays, Rows weight, Vector times, Py_ssize_t frame, Stack rotation, Vector slots, double max_gap_s,
    double tolerance_s, double[:, :, ::1] out, double[:, ::1] out_weight, Py_ssize_t first,
) noexcept nogil:
    """Write the points and scores at the slots before a frame, of joints from `first` on; they are 0 before."""
    cdef Py_ssize_t t, j, i, before, nearest, older, newer, after = frame
    cdef double time, to_after, to_before, share
    cdef double[2] seen, later = [0.0, 0.0]
    cdef const double* turn
    for t in range(slots.shape[0]):
        time = times[frame] - slots[t]
        while after > 0 and times[after - 1] >= time - tolerance_s:
            after -= 1
        before = max(after - 1, 0)
        to_after, to_before = times[after] - time, time - times[before]
        nearest = after
        while nearest < frame and fabs(times[nearest + 1] - time) < fabs(times[nearest] - time):
            nearest += 1
        if fabs(times[nearest] - time) <= tolerance_s:
            older, newer, share = nearest, nearest, 0.0
        elif to_before > 0 and to_after + to_before <= max_gap_s:
            older, newer, share = before, after, to_before / (to_after + to_before)
        else:
            continue
        for j in range(weight.shape[1]):
            if weight[older, j] > 0 and weight[newer, j] > 0:
                out_weight[t, first + j] = (1 - share) * weight[older, j] + share * weight[newer, j]
                turn = &rotation[min(older, rotation.shape[0] - 1), 0, 0]
                rotate_ray(turn, rays[older, j, 0], rays[older, j, 1], 1.0, seen)
                if share > 0:
                    turn = &rotation[min(newer, rotation.shape[0] - 1), 0, 0]
                    rotate_ray(turn, rays[newer, j, 0], rays[newer, j, 1], 1.0, later)
                for i in range(2):
                    out[t, first + j, i] = (1 - share) * seen[i] + share * later[i]


def sample_histories(people, Py_ssize_t joints, Vector slots, double max_gap_s, double tolerance_s):
    """Return the points (N, T, J, 2) and scores (N, T, J) at the slots before some frames, 0 where not seen.

    The rotations (N, 3, 3) of these frames are returned too. Rules are those of
    `models.lifter_input.sample_histories`; slots (T,) s before the frames increase.

    Args:
        people: of each person the times (F,) s, the frames, the rotations (F, 3, 3), or (1, 3, 3) for all frames, of
            the cameras that see the rays, and groups of joints, one after the other: rays (F, J_i, 2) and scores
            (F, J_i).
        joints: J; those that no group has are not seen.
    """
    cdef Py_ssize_t n = 0, row = 0, first
    cdef Vector times
    cdef Stack rotation, rays
    cdef Rows weight
    shape = sum([len(frames) for _, frames, _, _ in people]), slots.shape[0], joints
    sampled, sampled_weight, cameras = np.zeros((*shape, 2)), np.zeros(shape), np.empty((shape[0], 3, 3))
    cdef double[:, :, :, ::1] out = sampled
    cdef double[:, :, ::1] out_weight = sampled_weight, camera = cameras
    for times, frames, rotation, groups in people:
        first = 0
        for rays, weight in groups:
            row = n
            for frame in frames:
                sample_history(
                    rays, weight, times, frame, rotation, slots, max_gap_s, tolerance_s, out[row], out_weight[row],
                    first,
                )
                camera[row] = rotation[min(<Py_ssize_t> frame, rotation.shape[0] - 1)]
                row += 1
            first += weight.shape[1]
        n = row
    return sampled, sampled_weight, cameras


cdef inline bint is_seen(const double* point, double weight) noexcept nogil:
    return weight > 0 and fabs(point[0]) < MAX_COORDINATE and fabs(point[1]) < MAX_COORDINATE


cdef void face_newest(Stack points, Rows weight, Py_ssize_t core, double focal, double* out) noexcept nogil:
    """Write the rotation to a virtual camera that faces the newest points (T, J, 2)."""
    cdef Py_ssize_t j
    cdef double total = 0, x = 0, y = 0
    for j in range(core):
        if is_seen(&points[0, j, 0], weight[0, j]):
            total += weight[0, j]
            x += weight[0, j] * points[0, j, 0]
            y += weight[0, j] * points[0, j, 1]
    total = max(total, MIN_TOTAL_WEIGHT)
    turn_to_axis(x / total / focal, y / total / focal, out)


cdef double centre_points(
    Stack points, Rows weight, Py_ssize_t core, double focal, const double* rotation,
    double[:, :, ::1] centred, double[:, ::1] score,
) noexcept nogil:
    """Write the points as a rotated camera sees them, about their centroids, and scores; return the unit.

    They are not rotated if the focal length is infinite. Points and scores are 0 where not seen.
    """
    cdef Py_ssize_t t, j
    cdef double slot_total, x, y, total = 0, distance = 0
    for t in range(weight.shape[0]):
        slot_total = x = y = 0
        for j in range(weight.shape[1]):
            centred[t, j, 0] = centred[t, j, 1] = score[t, j] = 0.0
            if not is_seen(&points[t, j, 0], weight[t, j]):
                continue
            score[t, j] = min(weight[t, j], 1.0)
            if isfinite(focal):
                rotate_ray(rotation, points[t, j, 0] / focal, points[t, j, 1] / focal, focal, &centred[t, j, 0])
            else:
                centred[t, j, 0], centred[t, j, 1] = points[t, j, 0], points[t, j, 1]
            if not is_seen(&centred[t, j, 0], score[t, j]):
                centred[t, j, 0] = centred[t, j, 1] = score[t, j] = 0.0
            elif j < core:
                slot_total += score[t, j]
                x += score[t, j] * centred[t, j, 0]
                y += score[t, j] * centred[t, j, 1]
        x, y = x / max(slot_total, MIN_TOTAL_WEIGHT), y / max(slot_total, MIN_TOTAL_WEIGHT)
        for j in range(weight.shape[1]):
            if score[t, j] > 0:
                centred[t, j, 0] -= x
                centred[t, j, 1] -= y
                if j < core:
                    total += score[t, j]
                    distance += score[t, j] * sqrt(
                        centred[t, j, 0] * centred[t, j, 0] + centred[t, j, 1] * centred[t, j, 1]
                    )
    distance /= max(total, MIN_TOTAL_WEIGHT)
    return distance if distance > 0 else 1.0


cpdef encode(
    const double[:, :, :, ::1] points, Stack weight, Vector focal, Rows upward, const long long[::1] mirror,
    Py_ssize_t core, bint turns_cameras, int images,
):
    """Return features (N, images, I), newest points (N, J, 2), units (N,) and rotations (N, 3, 3) of the cameras.

    Points (N, T, J, 2) and scores may lack the last joints; focal lengths (N,), in the unit of the points, are infinite
    if unknown; `upward` (N, 3) is k v; `mirror` (J,) are the counterparts of the joints. Of `images`, 2 are the history
    and its mirror image. Virtual cameras turn to the newest points, if they turn, where the focal length is known.
    """
    cdef Py_ssize_t n, t, j, k, image, first, joints = mirror.shape[0]
    cdef Py_ssize_t count = weight.shape[0], slots = weight.shape[1], given = weight.shape[2]
    cdef double unit, x, y, camera_focal
    features = np.zeros((count, images, 3 * slots * joints + 4), np.float32)
    found = np.zeros((count, joints, 2)), np.empty(count), np.zeros((count, 3, 3))
    cdef float[:, :, ::1] out = features
    cdef double[:, :, ::1] newest = found[0], rotation = found[2]
    cdef double[::1] size = found[1]
    cdef double[:, :, ::1] centred = np.empty((slots, given, 2))
    cdef double[:, ::1] score = np.empty((slots, given))
    for n in range(count):
        camera_focal = focal[n] if turns_cameras else INFINITY
        rotation[n, 0, 0] = rotation[n, 1, 1] = rotation[n, 2, 2] = 1
        if isfinite(camera_focal):
            face_newest(points[n], weight[n], core, camera_focal, &rotation[n, 0, 0])
        unit = centre_points(points[n], weight[n], core, camera_focal, &rotation[n, 0, 0], centred, score)
        size[n] = unit
        for image in range(images):
            k = 3 * slots * joints
            for j in range(3):
                x = dot(&rotation[n, j, 0], &upward[n, 0])
                out[n, image, k + j] = -x if image and j == 0 else x
            out[n, image, k + 3] = min(unit / focal[n] / ANGULAR_SIZE_UNIT_RAD, MAX_FEATURE)
            for t in range(slots):
                for j in range(given):
                    x = min(max(centred[t, j, 0] / unit, -MAX_FEATURE), MAX_FEATURE)
                    y = min(max(centred[t, j, 1] / unit, -MAX_FEATURE), MAX_FEATURE)
                    first = 3 * (t * joints + (mirror[j] if image else j))
                    out[n, image, first], out[n, image, first + 1] = -x if image else x, y
                    out[n, image, first + 2] = score[t, j]
                    if t == 0:
                        newest[n, j, 0], newest[n, j, 1] = x, y
    return features, *found


cdef void apply_layer(
    const float[:, :, ::1] inputs, const Code[:, ::1] codes, Floats scales, Floats bias, float[:, :, ::1] out,
    long long* used, float* factors, bint rectifies,
) noexcept nogil:
    """X W + b of pairs of rows of inputs (N, 2, I or more), without negative results if it rectifies.

    All pairs go through some rows of W before any does through the next, so that these are fetched once.
    """
    cdef Py_ssize_t n, i, o, row, first, count
    cdef float x, y
    for n in range(inputs.shape[0]):
        for row in range(2):
            for o in range(bias.shape[0]):
                out[n, row, o] = bias[o]
    for first from 0 <= first < codes.shape[0] by TILE:
        for n in range(inputs.shape[0]):
            count = 0
            for i in range(first, min(first + TILE, codes.shape[0])):  # those that are not 0 in at least one row
                x, y = inputs[n, 0, i], inputs[n, 1, i]
                used[count], factors[count], factors[TILE + count] = i, x * scales[i], y * scales[i]
                count += (x != 0) | (y != 0)  # without a branch, which no processor could predict
            while count % 8 > 0:
                used[count] = 0
                factors[count] = factors[TILE + count] = 0
                count += 1
            if Code is short:
                ADD_CODES_16(&codes[0, 0], codes.shape[1], used, count, factors, factors + TILE, &out[n, 0, 0],
                             &out[n, 1, 0])
            else:
                ADD_CODES_8(&codes[0, 0], codes.shape[1], used, count, factors, factors + TILE, &out[n, 0, 0],
                            &out[n, 1, 0])
    if rectifies:
        for n in range(inputs.shape[0]):
            for row in range(2):
                for o in range(bias.shape[0]):
                    out[n, row, o] = max(out[n, row, o], <float> 0)


def evaluate(
    const float[:, :, ::1] features, const short[:, ::1] first, Floats first_scales,
    const signed char[:, :, ::1] hidden, const float[:, ::1] hidden_scales, const short[:, ::1] last,
    Floats last_scales, const float[:, ::1] biases, Floats last_bias,
):
    """Return the outputs (N, 2, O) of features (N, 2, I); the others are the attributes of `RoundedNetwork`."""
    cdef Py_ssize_t n, layer, row, i, outputs = last_bias.shape[0]
    units = np.zeros((3, features.shape[0], 2, max(first.shape[1], last.shape[1])), np.float32)
    cdef float[:, :, ::1] h = units[0], inner = units[1], added = units[2]
    cdef long long[TILE] used
    cdef float[2 * TILE] factors
    apply_layer(features, first, first_scales, biases[0], h, used, factors, True)
    for layer in range(0, hidden.shape[0], 2):
        apply_layer(h, hidden[layer], hidden_scales[layer], biases[1 + layer], inner, used, factors, True)
        apply_layer(inner, hidden[layer + 1], hidden_scales[layer + 1], biases[2 + layer], added, used, factors, True)
        for n in range(features.shape[0]):
            for row in range(2):
                for i in range(biases.shape[1]):
                    h[n, row, i] += added[n, row, i]
    apply_layer(h, last, last_scales, last_bias, inner, used, factors, False)
    return units[1, :, :, :outputs].copy()


def lift(
    const double[:, :, :, ::1] points, Stack weight, Vector focal, Rows upward, network, const long long[::1] mirror,
    Py_ssize_t core, double min_log_std, double max_log_std,
):
    """Return the joints and deviations (N, J, 3) that the network means, for both images on average.

    `network` is a `RoundedNetwork`; the bounds of the logarithms of deviations are in units; the others are those of
    `encode`.
    """
    cdef Py_ssize_t n, j, m, i, seen, joints = mirror.shape[0], stds = 3 * joints  # where log deviations begin
    cdef double total, unit, across, along, log_across, log_along
    cdef double[3] mean, point
    encoded = encode(points, weight, focal, upward, mirror, core, True, 2)
    cdef const float[:, :, ::1] features = encoded[0], outputs = evaluate(features, *network)
    cdef Stack newest = encoded[1], rotation = encoded[3]
    cdef Vector size = encoded[2]
    poses, deviations = np.empty((outputs.shape[0], joints, 3)), np.empty((outputs.shape[0], joints, 3))
    cdef double[:, :, ::1] out = poses, std = deviations
    for n in range(outputs.shape[0]):
        seen, total = 0, 0.0
        for j in range(core):
            seen += features[n, 0, 3 * j + 2] > 0
        for i in range(outputs.shape[2]):
            total += outputs[n, 0, i] + outputs[n, 1, i]
        unit = size[n] if seen >= MIN_SEEN_JOINTS and isfinite(total) else NAN
        mean[0] = mean[1] = mean[2] = 0
        for j in range(joints):
            m = mirror[j]
            for i in range(3):
                across, along = outputs[n, 0, 3 * j + i], outputs[n, 1, 3 * m + i]
                point[i] = (across - along if i == 0 else across + along) / 2 + (newest[n, j, i] if i < 2 else 0)
                out[n, j, i] = point[i]
                if j < core:
                    mean[i] += point[i] / core
            across, along = outputs[n, 0, stds + 2 * j], outputs[n, 0, stds + 2 * j + 1]
            log_across = min(max((across + outputs[n, 1, stds + 2 * m]) / 2, min_log_std), max_log_std)
            log_along = min(max((along + outputs[n, 1, stds + 2 * m + 1]) / 2, min_log_std), max_log_std)
            std[n, j, 0] = std[n, j, 1] = exp(log_across) * unit
            std[n, j, 2] = exp(log_along) * unit
        for j in range(joints):
            for i in range(3):
                point[i] = out[n, j, i] - mean[i]
            for i in range(3):
                total = point[0] * rotation[n, 0, i] + point[1] * rotation[n, 1, i] + point[2] * rotation[n, 2, i]
                out[n, j, i] = total * unit
    return poses, deviations
