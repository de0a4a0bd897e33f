# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: cdivision=True

"""Types of arrays; rotations, rays and lens distortion of single points, for the other modules of the engine.

Vectors are pointers to 3 numbers, matrices to 9 in the order of their rows. An output is none of the inputs, unless
a function says so. The formulas are in the modules of `mocap_ros.geometry`.
"""

from libc.math cimport atan, atan2, fabs, hypot, sin, sqrt, tan

ctypedef const double[::1] Vector
ctypedef const double[:, ::1] Rows
ctypedef const double[:, :, ::1] Stack
ctypedef const long long[::1] Indices

cdef extern from *:
    """
    #define MIN_SINE 1e-9              /* below it a rotation vector is its sine */
    #define MIN_RAY_DEPTH 0.05         /* z of a ray whose z was 1; rays behind a turned camera stay finite */
    #define UNDISTORT_ITERATIONS 20    /* inverts the lenses of tests/geometry to within 1e-6 of a focal length */
    #define MAX_RAY_ANGLE 1.5          /* rad from the optical axis; a pinhole camera shows no ray at pi / 2 */
    #define MIN_RADIUS 1e-12           /* focal lengths; guards the divisions by the radius at the optical axis */
    #define ANGLE_STEP 1e-6            /* rad; step of the central difference, far below any pixel */
    #define MIN_SLOPE 1e-3             /* guards the Newton step where the fisheye polynomial is flat */
    #define MAX_DEPTH_CHANGE 0.3       /* of the depth; a root that changes by more is another solution or person */
    #define MAX_SPEED_M_S 10.0         /* m/s; of a sprinter */
    """
    const double MIN_SINE, MIN_RAY_DEPTH, MAX_RAY_ANGLE, MIN_RADIUS, ANGLE_STEP, MIN_SLOPE
    const double MAX_DEPTH_CHANGE, MAX_SPEED_M_S
    const int UNDISTORT_ITERATIONS


cdef inline double square(double x) noexcept nogil:
    return x * x


cdef inline double dot(const double* a, const double* b) noexcept nogil:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


cdef inline void multiply(const double* a, const double* b, double* out) noexcept nogil:
    """A B."""
    cdef int i, j
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j]


cdef inline void subtract(const double* a, const double* b, double* out) noexcept nogil:
    out[0], out[1], out[2] = a[0] - b[0], a[1] - b[1], a[2] - b[2]


cdef inline void transform(const double* matrix, const double* vector, double* out) noexcept nogil:
    """A v."""
    out[0], out[1], out[2] = dot(matrix, vector), dot(matrix + 3, vector), dot(matrix + 6, vector)


cdef inline void cross(const double* a, const double* b, double* out) noexcept nogil:
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


cdef inline void multiply_first_transposed(const double* a, const double* b, double* out) noexcept nogil:
    """A^T B."""
    cdef int i, j
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = a[i] * b[j] + a[3 + i] * b[3 + j] + a[6 + i] * b[6 + j]


cdef inline void multiply_transposed(const double* a, const double* b, double* out) noexcept nogil:
    """A B^T."""
    cdef int i, j
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = dot(a + 3 * i, b + 3 * j)


cdef inline void rotation_from_vector(const double* vector, double* out) noexcept nogil:
    """exp([v]x), of a rotation vector in rad."""
    cdef double x = vector[0], y = vector[1], z = vector[2]
    cdef double angle = sqrt(x * x + y * y + z * z)
    cdef double half = sin(angle / 2) / (angle / 2) if angle > 0 else 1.0
    cdef double a = sin(angle) / angle if angle > 0 else 1.0
    cdef double b = 0.5 * half * half
    out[0], out[1], out[2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    out[3], out[4], out[5] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    out[6], out[7], out[8] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)


cdef inline void vector_from_rotation(const double* rotation, double* out) noexcept nogil:
    """log R in rad, of a rotation by less than pi."""
    cdef double sine, factor
    cdef int i
    out[0] = (rotation[7] - rotation[5]) / 2
    out[1] = (rotation[2] - rotation[6]) / 2
    out[2] = (rotation[3] - rotation[1]) / 2
    sine = sqrt(dot(out, out))
    if sine > MIN_SINE:
        factor = atan2(sine, (rotation[0] + rotation[4] + rotation[8] - 1) / 2) / sine
        for i in range(3):
            out[i] *= factor


cdef inline void turn_to_axis(double u, double v, double* out) noexcept nogil:
    """The smallest rotation that brings the ray (u, v, 1) to the optical axis."""
    cdef double length = sqrt(u * u + v * v + 1)
    cdef double x = u / length, y = v / length, z = 1 / length
    cdef double inverse = 1 / (1 + z)
    out[0], out[1], out[2] = 1 - x * x * inverse, -x * y * inverse, -x
    out[3], out[4], out[5] = -x * y * inverse, 1 - y * y * inverse, -y
    out[6], out[7], out[8] = x, y, z


cdef inline void rotate_ray(const double* rotation, double x, double y, double factor, double* out) noexcept nogil:
    """Write `factor` times the ray (x, y, 1) as a rotated camera sees it; `out` (2,)."""
    cdef double depth = max(rotation[6] * x + rotation[7] * y + rotation[8], MIN_RAY_DEPTH)
    out[0] = factor * ((rotation[0] * x + rotation[1] * y + rotation[2]) / depth)
    out[1] = factor * ((rotation[3] * x + rotation[4] * y + rotation[5]) / depth)


cdef inline double distort_angle(double angle, const double* lens) noexcept nogil:
    cdef double a2 = angle * angle
    return angle * (1 + a2 * (lens[1] + a2 * (lens[2] + a2 * (lens[3] + a2 * lens[4]))))


cdef inline void distort_point(double x, double y, const double* lens, double* out) noexcept nogil:
    """Write where a lens with these `Distortion.parameters` shows the normalised point (x, y); `out` (2,)."""
    cdef double factor, radius, r2
    if lens[0] == 1.0:
        radius = hypot(x, y)
        factor = distort_angle(atan(radius), lens) / max(radius, MIN_RADIUS)
        out[0], out[1] = x * factor, y * factor
        return
    r2 = x * x + y * y
    factor = (1 + r2 * (lens[1] + r2 * (lens[2] + r2 * lens[5]))) / (
        1 + r2 * (lens[6] + r2 * (lens[7] + r2 * lens[8]))
    )
    out[0] = x * factor + (2 * lens[3] * x * y + lens[4] * (r2 + 2 * x * x))
    out[1] = y * factor + (lens[3] * (r2 + 2 * y * y) + 2 * lens[4] * x * y)


cdef inline void undistort_point(double x, double y, const double* lens, double* out) noexcept nogil:
    """Write the normalised point that a lens with these `Distortion.parameters` shows at (x, y); `out` (2,)."""
    cdef double shown, angle, slope, closer_x, closer_y, max_ray
    cdef double[2] distorted = [x, y]
    cdef int k
    if lens[0] == 1.0:
        shown = hypot(x, y)
        angle = min(shown, MAX_RAY_ANGLE)
        for k in range(UNDISTORT_ITERATIONS):
            slope = distort_angle(angle + ANGLE_STEP, lens) - distort_angle(angle - ANGLE_STEP, lens)
            slope /= 2 * ANGLE_STEP
            angle -= (distort_angle(angle, lens) - shown) / (slope if fabs(slope) > MIN_SLOPE else 1.0)
            angle = min(max(angle, 0.0), MAX_RAY_ANGLE)
        slope = tan(angle) / max(shown, MIN_RADIUS)
        out[0], out[1] = x * slope, y * slope
        return
    max_ray = tan(MAX_RAY_ANGLE)
    out[0], out[1] = x, y
    for k in range(UNDISTORT_ITERATIONS):
        distort_point(out[0], out[1], lens, distorted)
        closer_x, closer_y = out[0] - (distorted[0] - x), out[1] - (distorted[1] - y)
        if not (fabs(closer_x) < max_ray and fabs(closer_y) < max_ray):  # nor a number
            return
        if closer_x == out[0] and closer_y == out[1]:
            return
        out[0], out[1] = closer_x, closer_y
