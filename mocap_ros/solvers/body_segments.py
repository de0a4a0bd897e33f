# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Orientations of the fifteen segments of a body, from the positions of the core joints.

A segment begins at a core joint and turns about it: the pelvis at `pelvis`, the torso at `neck`, the head at
`head`, upper arm, forearm and hand at `lshoulder`, `lelbow` and `lwrist`, thigh, shank and foot at `lhip`, `lknee`
and `lankle`, and likewise on the right. Its rotation takes the segment's axes to the camera's optical frame. Of
somebody who stands upright with hanging arms, the axes of all segments are x forward, y to the left and z up
(REP-103, REP-155).

Up and left determine a segment's axes:

    z = unit(up),    x = unit(left x z),    y = z x x

    segment                 up                                         left
    pelvis                  shoulders' middle - hips' middle           lhip - rhip
    torso                   neck - pelvis                              lshoulder - rshoulder
    head                    head - neck, then turned by `HEAD_REST`    y of the torso
    arm, thigh              from the lower to the upper joint          v
    forearm, shank          from the lower to the upper joint          y of the arm, y of the thigh
    hand, foot              the forearm and the shank turned by `REST`

The turn of arm and thigh about themselves is told by the plane in which elbow or knee is bent. With u and l the
unit vectors along the limb's upper and lower bone, |u x l| is the sine of that angle. Where they are straight, y
falls back to that of the parent segment, swung with the limb by the smallest rotation from the direction of rest
(y_s; f = 1 there and 0 at the opposite direction). Over the frames, h seconds apart, v follows

    n = +-(u x l) + D f y_s,    v <- v' + (1 - e^(-h (1 + |n|^2 / W^2) / T)) (n - v')

where v' is the old v, turned with the parent segment. So a limb that is straight for a short time keeps its
direction.

Head, hands and feet have rotations of their own where face, hands and feet are followed (`extremities/`). The
turn of a leg is then also told by the foot: y of thigh and shank is v + D_f y_foot. Nothing tells how forearm and
hand are turned about themselves.
"""

from __future__ import annotations

import math

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOLS_1D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_BOOLS_1D,
    INT,
    kernel,
)
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

MIN_LENGTH_M = 1e-6  # m; far under any bone, guards divisions
WEAK_SINE = 0.2  # W; sine of 12 degrees, by which a bent joint is told from the noise of a straight one
REST_SINE = 0.15  # D; weight of the direction without evidence: that of a limb bent by 9 degrees
FOOT_SINE = 0.3  # D_f; weight of the foot: that of a knee bent by 17 degrees
TOLD_SINE = 0.3  # |v| from which the turn of a limb is told by its bend, and not by its rest
MEMORY_S = 0.3  # T, s; so long a straight limb keeps the direction that it had when it was bent

SEGMENT_COUNT = len(CMU15.joints)  # segments, in the order of the core joints at which they begin
PART_SEGMENTS = np.array(
    [CMU15.index(n) for n in ('head', 'lankle', 'rankle', 'lwrist', 'rwrist')]
)  # head, feet, hands
HEAD, NECK, PELVIS = (CMU15.index(name) for name in ('head', 'neck', 'pelvis'))
LSHOULDER, RSHOULDER, LHIP, RHIP = (CMU15.index(name) for name in ('lshoulder', 'rshoulder', 'lhip', 'rhip'))
# Limbs: upper, middle and lower joint and parent segment.
LIMBS = np.array(
    [
        [CMU15.index(side + name) for name in joints] + [parent]
        for joints, parent in ((('shoulder', 'elbow', 'wrist'), NECK), (('hip', 'knee', 'ankle'), PELVIS))
        for side in 'lr'
    ]
)
# 1; forearms bend forwards and shanks backwards, so u x l points to the right in arms and to the left in legs
BENDS = np.array([-1.0, -1.0, 1.0, 1.0])


def rotation_about(axis: int, degrees: float) -> Array:
    """Return the rotation (3, 3) by an angle about the axis x, y or z (0, 1, 2)."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    out = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    out[first, first] = out[second, second] = cosine
    out[first, second], out[second, first] = -sine, sine
    return out


# Mean rotations of head, hands and feet against the bones that they hang on, in all motions of the training data
HEAD_REST = rotation_about(1, -13.0)
HAND_REST = np.stack([rotation_about(0, 16.0), rotation_about(0, -16.0)])
FOOT_REST = rotation_about(1, -19.0)


@kernel(void(FLOATS_2D, INPUT_1D, INPUT_1D))
def write_axes(out: Array, left: Array, up: Array) -> None:
    """Write the axes forward, left and up (3, 3), in columns, of two vectors; `out` stays where they are parallel.

    Args:
        out: (3, 3), which holds a rotation.
        left: (3,) of any length.
        up: (3,) of any length.
    """
    up_length = math.sqrt(up[0] ** 2 + up[1] ** 2 + up[2] ** 2)
    x0 = left[1] * up[2] - left[2] * up[1]
    x1 = left[2] * up[0] - left[0] * up[2]
    x2 = left[0] * up[1] - left[1] * up[0]
    length = math.sqrt(x0**2 + x1**2 + x2**2)
    if not length > MIN_LENGTH_M**2 or not up_length > MIN_LENGTH_M:
        return
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    z0, z1, z2 = up[0] / up_length, up[1] / up_length, up[2] / up_length
    out[0, 0], out[1, 0], out[2, 0] = x0, x1, x2
    out[0, 1], out[1, 1], out[2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    out[0, 2], out[1, 2], out[2, 2] = z0, z1, z2


@kernel(void(FLOATS_2D, INPUT_2D, INPUT_2D))
def write_product(out: Array, first: Array, second: Array) -> None:
    """Write the product (3, 3) of two matrices; `out` is neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = first[i, 0] * second[0, j] + first[i, 1] * second[1, j] + first[i, 2] * second[2, j]


@kernel(void(FLOATS_1D, INPUT_1D, INPUT_2D))
def _write_swung(out: Array, direction: Array, parent: Array) -> None:
    """Write f y_s of a limb: the parent's y, swung by the smallest rotation from its -z to the limb's direction.

    With the axis a = r x d of the rotation and the cosine c = r . d, R y = c y + a x y + (a . y) a / (1 + c); and
    with f = (1 + c) / 2 nothing is divided by 0.
    """
    rest = np.empty(3)
    axis = np.empty(3)
    for i in range(3):
        rest[i] = -parent[i, 2]
    axis[0] = rest[1] * direction[2] - rest[2] * direction[1]
    axis[1] = rest[2] * direction[0] - rest[0] * direction[2]
    axis[2] = rest[0] * direction[1] - rest[1] * direction[0]
    cosine, along = 0.0, 0.0
    for i in range(3):
        cosine += rest[i] * direction[i]
        along += axis[i] * parent[i, 1]
    share = (1 + cosine) / 2
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turned = axis[j] * parent[k, 1] - axis[k] * parent[j, 1]
        out[i] = share * (cosine * parent[i, 1] + turned) + along * axis[i] / 2


@kernel(void(FLOATS_3D, FLOATS_1D, INPUT_2D, INT, FLOAT))
def _write_limb(segments: Array, twist: Array, joints: Array, limb: int, step_s: float) -> None:
    """Write the rotations of the three segments of a limb; arguments as of `write_core_segments`.

    Args:
        segments: (15, 3, 3), overwritten; that of the parent segment is of this frame.
        twist: (3,) v of this limb, overwritten.
        joints: (15, 3) m.
        limb: index of the limb in `LIMBS`.
        step_s: s.
    """
    a, b, c, parent = LIMBS[limb, 0], LIMBS[limb, 1], LIMBS[limb, 2], LIMBS[limb, 3]
    upper, lower = joints[b] - joints[a], joints[c] - joints[b]
    upper /= max(math.sqrt(upper[0] ** 2 + upper[1] ** 2 + upper[2] ** 2), MIN_LENGTH_M)
    lower /= max(math.sqrt(lower[0] ** 2 + lower[1] ** 2 + lower[2] ** 2), MIN_LENGTH_M)
    left, own = np.empty(3), np.zeros(3)
    _write_swung(left, upper, segments[parent])
    confidence = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        left[i] = BENDS[limb] * (upper[j] * lower[k] - upper[k] * lower[j]) + REST_SINE * left[i]
        confidence += left[i] * left[i]
    gain = 1 - math.exp(-step_s * (1 + confidence / WEAK_SINE**2) / MEMORY_S)
    for i in range(3):  # v is kept in the axes of the parent segment, and so turns with it
        for j in range(3):
            own[i] += segments[parent, j, i] * left[j]
        twist[i] += gain * (own[i] - twist[i])
    for i in range(3):
        left[i] = 0.0
        for j in range(3):
            left[i] += segments[parent, i, j] * twist[j]
    write_axes(segments[a], left, -upper)
    left[:] = segments[a, :, 1]
    write_axes(segments[b], left, -lower)
    write_product(segments[c], segments[b], HAND_REST[limb] if limb < 2 else FOOT_REST)


@kernel(void(FLOATS_3D, FLOATS_2D, INPUT_2D, FLOAT))
def write_core_segments(segments: Array, twist: Array, joints: Array, step_s: float) -> None:
    """Write the rotations of the segments that the core joints tell (formulas at the head of this module).

    Args:
        segments: (15, 3, 3) rotations of the frame before, or the identity before the first; they are overwritten.
        twist: (4, 3) v of the limbs in the frame before, in the axes of their parent segments; likewise.
        joints: (15, 3) m, core joints in the camera's optical frame.
        step_s: s, time since the frame before; infinite before the first.
    """
    left, up = np.empty(3), np.empty(3)
    for i in range(3):
        left[i] = joints[LHIP, i] - joints[RHIP, i]
        up[i] = (joints[LSHOULDER, i] + joints[RSHOULDER, i] - joints[LHIP, i] - joints[RHIP, i]) / 2
    write_axes(segments[PELVIS], left, up)
    for i in range(3):
        left[i] = joints[LSHOULDER, i] - joints[RSHOULDER, i]
        up[i] = joints[NECK, i] - joints[PELVIS, i]
    write_axes(segments[NECK], left, up)
    bone = np.empty((3, 3))
    bone[:] = segments[NECK]
    for i in range(3):
        left[i] = segments[NECK, i, 1]
        up[i] = joints[HEAD, i] - joints[NECK, i]
    write_axes(bone, left, up)
    write_product(segments[HEAD], bone, HEAD_REST)
    for limb in range(len(LIMBS)):
        _write_limb(segments, twist[limb], joints, limb, step_s)


@kernel(void(FLOATS_3D, BOOLS_1D, INPUT_3D, INPUT_2D, INPUT_3D, INPUT_BOOLS_1D, INPUT_BOOLS_1D))
def write_orientations(
    out: Array,
    told: NDArray[np.bool_],
    segments: Array,
    twist: Array,
    parts: Array,
    is_part_told: NDArray[np.bool_],
    seen: NDArray[np.bool_],
) -> None:
    """Write the rotations of all segments, and whether the image tells their turn about their own axis.

    Args:
        out: (15, 3, 3) rotations from the segments to the camera's optical frame, overwritten.
        told: (15,) overwritten.
        segments: (15, 3, 3) as `write_core_segments` writes them.
        twist: (4, 3) likewise.
        parts: (5, 3, 3) rotations of head, feet and hands, in the order of `PART_SEGMENTS`.
        is_part_told: (5,) whether points of the part were seen that tell its turn.
        seen: (15,) whether the core joints were seen.
    """
    out[:] = segments
    told[:] = False
    for part in range(len(PART_SEGMENTS)):
        out[PART_SEGMENTS[part]] = parts[part]
        told[PART_SEGMENTS[part]] = is_part_told[part]
    told[PELVIS] = seen[LHIP] and seen[RHIP]
    told[NECK] = seen[LSHOULDER] and seen[RSHOULDER]
    left = np.empty(3)
    for limb in range(len(LIMBS)):
        a, b, c, parent = LIMBS[limb, 0], LIMBS[limb, 1], LIMBS[limb, 2], LIMBS[limb, 3]
        sine = math.sqrt(twist[limb, 0] ** 2 + twist[limb, 1] ** 2 + twist[limb, 2] ** 2)
        told[a] = sine >= TOLD_SINE and seen[a] and seen[b] and seen[c]
        if limb < 2:
            continue
        told[a] = told[a] or (told[c] and seen[b])
        told[b] = told[a]
        for i in range(3):
            left[i] = FOOT_SINE * out[c, i, 1]
            for j in range(3):
                left[i] += segments[parent, i, j] * twist[limb, j]
        write_axes(out[a], left, segments[a, :, 2].copy())
        write_axes(out[b], left, segments[b, :, 2].copy())


@kernel(void(FLOATS_2D, INPUT_3D))
def write_quaternions(out: Array, rotations: Array) -> None:
    """Write the unit quaternions x, y, z, w (N, 4) of rotations (N, 3, 3), by Shepperd's method.

    Of the two quaternions of a rotation, the one that is nearer to the one in `out` is written; of the first
    frame, where `out` holds zeros, the one with w >= 0. So the quaternions of a motion do not jump.
    """
    q = np.empty(4)
    for n in range(len(rotations)):
        r = rotations[n]
        trace = r[0, 0] + r[1, 1] + r[2, 2]
        if trace >= max(r[0, 0], r[1, 1], r[2, 2]):
            q[0], q[1], q[2], q[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + trace
        else:
            i = 0 if r[0, 0] >= max(r[1, 1], r[2, 2]) else 1 if r[1, 1] >= r[2, 2] else 2
            j, k = (i + 1) % 3, (i + 2) % 3
            q[i], q[j], q[k] = 1 + 2 * r[i, i] - trace, r[i, j] + r[j, i], r[i, k] + r[k, i]
            q[3] = r[k, j] - r[j, k]
        length = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
        along = out[n, 0] * q[0] + out[n, 1] * q[1] + out[n, 2] * q[2] + out[n, 3] * q[3]
        if along < 0 or (along == 0 and q[3] < 0):
            length = -length
        for i in range(4):
            out[n, i] = q[i] / length
