# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The extremities of a person, followed from frame to frame.

Without evidence a part is as the core has it, A_k (the segments of `body_segments.py`). From frame to frame, h
seconds apart, it returns there with the time constant tau and the spread S_k of training data:

    R_k <- A_k exp(a log(A_k'^T R_k')),    P_k <- a^2 P_k + (1 - a^2) S_k,    a = e^(-h / tau)

where the prime marks the frame before and P_k (rad^2) is the covariance of the rotation. The frame then corrects
it (`correction.py`). The sizes follow from the sums of i and j of its corrections:

    b_k <- b_k - j / (I + i + 1 / s_b^2)

where I is the sum of earlier i, which fades over `SIZE_MEMORY_S`, and s_b the spread of people. A step beyond the
range in which it is linear could give a part any size: b_k stays within `MAX_SIZE_STDS` s_b of 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOL,
    BOOLS_1D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    kernel,
)
from mocap_ros.geometry.rotations import write_rotation_from_vector
from mocap_ros.skeleton import CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers.body_segments import (
    PART_SEGMENTS,
    SEGMENT_COUNT,
    write_core_segments,
    write_orientations,
    write_product,
    write_quaternions,
)
from mocap_ros.solvers.extremities.correction import correct_part
from mocap_ros.solvers.extremities.evidence import ExtremityEvidence
from mocap_ros.solvers.extremities.parts import (
    PART_COUNT,
    PART_OF,
    POINT_COUNTS,
    REST_MEMORY_S,
    REST_STD,
    SIZE_COUNT,
    SIZE_OF,
    SIZE_STD,
    TEMPLATE,
)
from mocap_ros.solvers.extremities.small_matrices import write_vector

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MAX_SIZE_STDS = 5.0  # standard deviations of people's sizes; nobody has such a face, foot or hand
SIZE_MEMORY_S = 60.0  # s; a person's size does not change, but the detector may
TURN_TOLD_RAD = math.radians(25)  # rad; a part whose turn about its axis is known no better is flagged
ANGULAR_SPEED_STD = 1.5  # rad/s; of heads, feet and hands about their anchors, for the deviation of velocities
VELOCITY_MEMORY_S = 0.1  # s; over which the velocity of a point about its anchor is averaged


@kernel(void(FLOATS_2D, FLOATS_2D, INPUT_2D, INPUT_2D, INPUT_1D, FLOAT))
def _predict_part(
    turn: Array, covariance: Array, rest: Array, old_rest: Array, rest_std: Array, kept: float
) -> None:
    """Move the rotation of a part to the next frame.

    Args:
        turn: (3, 3) R, overwritten.
        covariance: (3, 3) rad^2, P, overwritten.
        rest: (3, 3) A.
        old_rest: (3, 3) A of the frame before.
        rest_std: (3,) rad, standard deviations of S about the axes of the part.
        kept: a.
    """
    relative, moved, product = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    vector = np.empty(3)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += old_rest[k, i] * turn[k, j]
                moved[i, j] += rest[i, k] * old_rest[j, k]
    write_vector(vector, relative)
    vector *= kept
    write_rotation_from_vector(vector, relative)
    write_product(turn, rest, relative)
    write_product(product, moved, covariance)
    for i in range(3):
        for j in range(3):
            old = new = 0.0
            for k in range(3):
                old += product[i, k] * moved[j, k]
                new += rest[i, k] * rest_std[k] ** 2 * rest[j, k]
            covariance[i, j] = kept**2 * old + (1 - kept**2) * new


@kernel(
    void(
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_3D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
        FLOAT,
        FLOAT,
        BOOL,
    )
)
def advance(
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    sizes: Array,
    predicted_turns: Array,
    predicted_covariances: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    step_s: float,
    is_learning: bool,
) -> None:
    """Advance the state of a person's extremities by a frame.

    Args:
        segments: with the following four, attributes of `ExtremityState`, overwritten.
        twist: as above.
        turns: as above.
        covariances: as above.
        sizes: as above.
        predicted_turns: (5, 3, 3) R before the correction, overwritten.
        predicted_covariances: (5, 3, 3) rad^2, P before the correction, overwritten.
        core: with the following, those of `ExtremityEvidence`.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as above.
        stature: m.
        step_s: s, time since the frame before; infinite for the first frame.
        is_learning: whether the sizes are learnt.
    """
    old = segments.copy()
    write_core_segments(segments, twist, core, step_s)
    sums = np.zeros((SIZE_COUNT, 2))
    for part in range(PART_COUNT):
        anchor, kind, turn, covariance = PART_SEGMENTS[part], SIZE_OF[part], turns[part], covariances[part]
        kept = math.exp(-step_s / REST_MEMORY_S[part])
        _predict_part(turn, covariance, segments[anchor], old[anchor], REST_STD[part], kept)
        predicted_turns[part], predicted_covariances[part] = turn, covariance
        size = stature * math.exp(sizes[kind, 0])
        correct_part(
            part, turn, covariance, sums[kind], core, lifted, lifted_std, rays, weight, size, noise, step_s
        )
    if is_learning:
        for kind in range(SIZE_COUNT):
            earlier = sizes[kind, 1] * math.exp(-min(step_s, SIZE_MEMORY_S) / SIZE_MEMORY_S)
            sizes[kind, 1] = earlier + sums[kind, 0]
            size = sizes[kind, 0] + sums[kind, 1] / (sizes[kind, 1] + 1 / SIZE_STD[kind] ** 2)
            limit = MAX_SIZE_STDS * SIZE_STD[kind]
            sizes[kind, 0] = min(max(size, -limit), limit)


@kernel(
    void(
        FLOATS_2D,
        FLOATS_1D,
        FLOATS_2D,
        BOOLS_1D,
        INPUT_3D,
        INPUT_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
    )
)
def write_result(
    offsets: Array,
    offset_std: Array,
    quaternions: Array,
    is_turn_told: Bools,
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    sizes: Array,
    weight: Array,
    stature: float,
) -> None:
    """Write what the state of a frame means for its points and orientations; shapes as in `ExtremityState`.

    Args:
        offsets: overwritten, as the next three.
        offset_std: as above.
        quaternions: those of the frame before, or zeros.
        is_turn_told: as above.
        segments: the state, as the next four.
        twist: as above.
        turns: as above.
        covariances: as above.
        sizes: as above.
        weight: (26,) confidence scores of all joints.
        stature: m.
    """
    is_part_told, seen = np.zeros(PART_COUNT, np.bool_), np.zeros(SEGMENT_COUNT, np.bool_)
    for joint in range(SEGMENT_COUNT):
        seen[joint] = weight[joint] > 0
    for p in range(len(PART_OF)):
        part = PART_OF[p]
        turn, covariance, kind = turns[part], covariances[part], SIZE_OF[part]
        size = stature * math.exp(sizes[kind, 0])
        squared, trace, quadratic = 0.0, 0.0, 0.0
        for i in range(3):
            offsets[p, i] = 0.0
            for j in range(3):
                offsets[p, i] += size * turn[i, j] * TEMPLATE[p, j]
            squared += offsets[p, i] ** 2
            trace += covariance[i, i]
        turn_variance = 0.0
        for i in range(3):
            for j in range(3):
                quadratic += offsets[p, i] * covariance[i, j] * offsets[p, j]
                turn_variance += turn[i, 2] * covariance[i, j] * turn[j, 2]
        size_variance = 1 / (sizes[kind, 1] + 1 / SIZE_STD[kind] ** 2)
        offset_std[p] = math.sqrt(max(trace * squared - quadratic, 0.0) + size_variance * squared)
        is_seen = weight[CORE_COUNT + p] > 0
        is_part_told[part] = is_part_told[part] or (
            is_seen and POINT_COUNTS[part] > 1 and turn_variance < TURN_TOLD_RAD**2
        )
    rotations = np.empty((SEGMENT_COUNT, 3, 3))
    write_orientations(rotations, is_turn_told, segments, twist, turns, is_part_told, seen)
    write_quaternions(quaternions, rotations)


@kernel(
    types.Tuple(
        (
            FLOATS_3D,
            FLOATS_2D,
            FLOATS_3D,
            FLOATS_3D,
            FLOATS_2D,
            FLOATS_2D,
            FLOATS_1D,
            FLOATS_2D,
            FLOATS_2D,
            BOOLS_1D,
        )
    )(
        INPUT_3D,
        INPUT_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_2D,
        INPUT_1D,
        FLOAT,
        FLOAT,
        FLOAT,
    )
)
def _follow_frame(
    old_segments: Array,
    old_twist: Array,
    old_turns: Array,
    old_covariances: Array,
    old_sizes: Array,
    old_offsets: Array,
    old_velocity: Array,
    old_quaternions: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    step_s: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Bools]:
    """Return the attributes of `ExtremityState` in a frame, from those of the frame before and the evidence.

    Args:
        old_segments: with the following seven, attributes of the state before.
        old_twist: as above.
        old_turns: as above.
        old_covariances: as above.
        old_sizes: as above.
        old_offsets: as above.
        old_velocity: as above.
        old_quaternions: as above.
        core: with the following five, those of `ExtremityEvidence`.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as above.
        stature: m.
        step_s: s, time since the frame before; infinite for the first frame.
    """
    segments, twist, sizes = old_segments.copy(), old_twist.copy(), old_sizes.copy()
    turns, covariances, quaternions = old_turns.copy(), old_covariances.copy(), old_quaternions.copy()
    predicted, unused = np.empty(turns.shape), np.empty(turns.shape)
    advance(
        segments,
        twist,
        turns,
        covariances,
        sizes,
        predicted,
        unused,
        core,
        lifted,
        lifted_std,
        rays,
        weight,
        noise,
        stature,
        step_s,
        True,
    )
    offsets, std, told = np.empty(old_offsets.shape), np.empty(len(old_offsets)), np.empty(SEGMENT_COUNT, np.bool_)
    write_result(offsets, std, quaternions, told, segments, twist, turns, covariances, sizes, weight, stature)
    velocity = np.zeros(offsets.shape)
    if math.isfinite(step_s):
        share = 1 - math.exp(-step_s / VELOCITY_MEMORY_S)
        for p in range(len(offsets)):
            for i in range(3):
                moved = (offsets[p, i] - old_offsets[p, i]) / step_s
                velocity[p, i] = old_velocity[p, i] + share * (moved - old_velocity[p, i])
    return segments, twist, turns, covariances, sizes, offsets, std, velocity, quaternions, told


@dataclass(frozen=True, eq=False)
class ExtremityState:
    """The extremities of a person in one frame; immutable, `advance` returns those of the next.

    Attributes:
        segments: (15, 3, 3) rotations of the segments as the core tells them (`body_segments.py`).
        twist: (4, 3) turns of the limbs, likewise.
        turns: (5, 3, 3) R, rotations of the `PARTS`.
        covariances: (5, 3, 3) rad^2, P.
        sizes: (3, 2) b and I of face, feet and hands.
        offsets: (11, 3) m, points less the core joints on which they hang.
        offset_std: (11,) m, standard deviation of each of them.
        velocity: (11, 3) m/s, velocity of the offsets.
        quaternions: (15, 4) x, y, z, w, orientations of the segments.
        is_turn_told: (15,) whether the image tells the turn of a segment about its own axis.
    """

    segments: Array
    twist: Array
    turns: Array
    covariances: Array
    sizes: Array
    offsets: Array
    offset_std: Array
    velocity: Array
    quaternions: Array
    is_turn_told: Bools

    @staticmethod
    def begin(evidence: ExtremityEvidence, stature: float) -> ExtremityState:
        """Return the extremities of a person who is seen for the first time; `stature` in m."""
        unknown = np.tile(np.eye(3), (PART_COUNT, 1, 1))
        start = ExtremityState(
            np.tile(np.eye(3), (SEGMENT_COUNT, 1, 1)),
            np.zeros((4, 3)),
            unknown,
            unknown,
            np.zeros((SIZE_COUNT, 2)),
            np.zeros((EXTREMITY_COUNT, 3)),
            np.zeros(EXTREMITY_COUNT),
            np.zeros((EXTREMITY_COUNT, 3)),
            np.zeros((SEGMENT_COUNT, 4)),
            np.zeros(SEGMENT_COUNT, bool),
        )
        return start.advance(math.inf, evidence, stature)

    def advance(self, step_s: float, evidence: ExtremityEvidence, stature: float) -> ExtremityState:
        """Return the extremities in the next frame.

        Args:
            step_s: s, time since this frame, positive.
            evidence: what tells of them.
            stature: m, stature of the person.
        """
        old = self.segments, self.twist, self.turns, self.covariances, self.sizes
        shown = self.offsets, self.velocity, self.quaternions
        seen = evidence.make_contiguous()
        return ExtremityState(*_follow_frame(*old, *shown, *seen[:5], seen.noise, stature, step_s))
