# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The extremities of a whole sequence, followed forwards and backwards.

The sequence is followed forwards (f) and backwards (b, before its correction), with the sizes that were learnt
from all frames, and smoothed: with the rotation vectors d_b = log(R_b R_f^T) and d_A = log(A R_f^T),

    P^-1 = P_f^-1 + P_b^-1 - S^-1,    R = exp(P (P_b^-1 d_b - S^-1 d_A)) R_f
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOL,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    FLOATS_4D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_4D,
    kernel,
)
from mocap_ros.geometry.rotations import write_rotation_from_vector
from mocap_ros.skeleton import EXTREMITY_COUNT
from mocap_ros.solvers.body_segments import PART_SEGMENTS, SEGMENT_COUNT, write_product
from mocap_ros.solvers.extremities.evidence import ExtremityEvidence
from mocap_ros.solvers.extremities.following import advance, write_result
from mocap_ros.solvers.extremities.parts import PART_COUNT, REST_STD, SIZE_COUNT
from mocap_ros.solvers.extremities.small_matrices import write_inverse, write_vector

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@kernel(
    void(
        FLOATS_4D,
        FLOATS_3D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_2D,
        INPUT_3D,
        INPUT_3D,
        INPUT_3D,
        INPUT_3D,
        INPUT_2D,
        FLOAT,
        FLOAT,
        INPUT_1D,
        BOOL,
    )
)
def _follow(
    segments: Array,
    twist: Array,
    turns: Array,
    covariances: Array,
    predicted_turns: Array,
    predicted_covariances: Array,
    sizes: Array,
    core: Array,
    lifted: Array,
    lifted_std: Array,
    rays: Array,
    weight: Array,
    noise: float,
    stature: float,
    steps: Array,
    is_learning: bool,
) -> None:
    """Advance through F frames; arguments as of `advance`, with F frames each, but for `sizes`.

    Args:
        segments: overwritten, as the next five.
        twist: as above.
        turns: as above.
        covariances: as above.
        predicted_turns: as above.
        predicted_covariances: as above.
        sizes: (3, 2), those before the first frame; overwritten.
        core: as of `advance`, as the next four.
        lifted: as above.
        lifted_std: as above.
        rays: as above.
        weight: as above.
        noise: as of `advance`.
        stature: as of `advance`.
        steps: (F,) s, time since the frame before; infinite for the first.
        is_learning: as of `advance`.
    """
    for f in range(len(core)):
        if f > 0:
            segments[f], twist[f], turns[f], covariances[f] = (
                segments[f - 1],
                twist[f - 1],
                turns[f - 1],
                covariances[f - 1],
            )
        else:
            segments[f], twist[f], turns[f], covariances[f] = np.eye(3), 0.0, np.eye(3), np.eye(3)
        advance(
            segments[f],
            twist[f],
            turns[f],
            covariances[f],
            sizes,
            predicted_turns[f],
            predicted_covariances[f],
            core[f],
            lifted[f],
            lifted_std[f],
            rays[f],
            weight[f],
            noise,
            stature,
            steps[f],
            is_learning,
        )


@kernel(void(FLOATS_2D, FLOATS_1D, INPUT_2D, INPUT_2D, INPUT_2D, FLOAT))
def _add_estimate(information: Array, pull: Array, own: Array, other: Array, added: Array, sign: float) -> None:
    """Add another estimate of a rotation to what is known, or take it away.

    Args:
        information: (3, 3) 1/rad^2, to which that of the estimate is added.
        pull: (3,) 1/rad, to which this times the rotation vector from `own` to the estimate is added.
        own: (3, 3) rotation about which everything is linearised.
        other: (3, 3) rotation of the estimate.
        added: (3, 3) 1/rad^2, its information.
        sign: 1 to add, -1 to take away.
    """
    relative, vector = np.zeros((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += other[i, k] * own[j, k]
    write_vector(vector, relative)
    for i in range(3):
        for j in range(3):
            information[i, j] += sign * added[i, j]
            pull[i] += sign * added[i, j] * vector[j]


@kernel(void(FLOATS_2D, FLOATS_2D, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_1D))
def _smooth_part(
    turn: Array,
    covariance: Array,
    rest: Array,
    backward_turn: Array,
    backward_covariance: Array,
    rest_std: Array,
) -> None:
    """Smooth the rotation of a part in a frame (formulas at the head of this module).

    Args:
        turn: (3, 3) R_f, overwritten by R.
        covariance: (3, 3) P_f, overwritten by P.
        rest: (3, 3) A.
        backward_turn: (3, 3) R_b.
        backward_covariance: (3, 3) P_b.
        rest_std: (3,) rad, standard deviations of S about the axes of the part.
    """
    work, information, added = covariance.copy(), np.empty((3, 3)), np.empty((3, 3))
    pull, vector = np.zeros(3), np.zeros(3)
    rotation, new = np.empty((3, 3)), np.empty((3, 3))
    write_inverse(information, work)
    work[:] = backward_covariance
    write_inverse(added, work)
    _add_estimate(information, pull, turn, backward_turn, added, 1.0)
    for i in range(3):
        for j in range(3):
            added[i, j] = 0.0
            for k in range(3):
                added[i, j] += rest[i, k] / rest_std[k] ** 2 * rest[j, k]
    _add_estimate(information, pull, turn, rest, added, -1.0)
    write_inverse(covariance, information)
    for i in range(3):
        for j in range(3):
            vector[i] += covariance[i, j] * pull[j]
    write_rotation_from_vector(vector, rotation)
    write_product(new, rotation, turn)
    turn[:] = new


@kernel(void(FLOATS_4D, FLOATS_4D, INPUT_4D, INPUT_4D, INPUT_4D))
def _smooth(
    turns: Array, covariances: Array, segments: Array, backward_turns: Array, backward_covariances: Array
) -> None:
    """Smooth the rotations of F frames; the arguments have F frames and 5 parts of those of `_smooth_part`.

    Args:
        turns: (F, 5, 3, 3) R_f, overwritten by R.
        covariances: (F, 5, 3, 3) P_f, overwritten by P.
        segments: (F, 15, 3, 3) segments as the core tells them.
        backward_turns: (F, 5, 3, 3) R_b.
        backward_covariances: (F, 5, 3, 3) P_b.
    """
    for f in range(len(turns)):
        for part in range(PART_COUNT):
            _smooth_part(
                turns[f, part],
                covariances[f, part],
                segments[f, PART_SEGMENTS[part]],
                backward_turns[f, part],
                backward_covariances[f, part],
                REST_STD[part],
            )


class ExtremitySequence(NamedTuple):
    """The extremities of a person over F frames, smoothed.

    Attributes:
        offsets: (F, 11, 3) m, points less the core joints on which they hang.
        offset_std: (F, 11) m, standard deviation of each of them.
        quaternions: (F, 15, 4) x, y, z, w, orientations of the segments, continuous.
        is_turn_told: (F, 15) whether the image tells the turn of a segment about its own axis.
    """

    offsets: Array
    offset_std: Array
    quaternions: Array
    is_turn_told: Bools


def smooth_extremities(times: Array, evidence: ExtremityEvidence, stature: float) -> ExtremitySequence:
    """Estimate the extremities of a person over a whole sequence (formulas at the head of this module).

    Args:
        times: (F,) s, increasing.
        evidence: that of F frames, each array with a first dimension F; the image noise is one for all.
        stature: m, stature of the person.
    """
    frames = len(times)
    evidence = evidence.make_contiguous()
    steps, reverse_steps = (np.append(np.inf, np.diff(t)) for t in (times, -times[::-1]))
    sizes = np.zeros((SIZE_COUNT, 2))
    forward, backward = _Passes.empty(frames), _Passes.empty(frames)
    _follow(*forward, sizes, *evidence, stature, steps, True)
    _follow(*forward, sizes, *evidence, stature, steps, False)
    _follow(*backward, sizes, *evidence.reverse(), stature, reverse_steps, False)
    turns, covariances = forward.turns, forward.covariances
    _smooth(
        turns,
        covariances,
        forward.segments,
        backward.predicted_turns[::-1].copy(),
        backward.predicted_covariances[::-1].copy(),
    )
    offsets, std = np.empty((frames, EXTREMITY_COUNT, 3)), np.empty((frames, EXTREMITY_COUNT))
    quaternions, told = np.zeros((frames, SEGMENT_COUNT, 4)), np.zeros((frames, SEGMENT_COUNT), bool)
    for f in range(frames):
        if f:
            quaternions[f] = quaternions[f - 1]
        write_result(
            offsets[f],
            std[f],
            quaternions[f],
            told[f],
            forward.segments[f],
            forward.twist[f],
            turns[f],
            covariances[f],
            sizes,
            evidence.weight[f],
            stature,
        )
    return ExtremitySequence(offsets, std, quaternions, told)


class _Passes(NamedTuple):
    """What `_follow` writes for F frames: attributes of `ExtremityState`, and the predictions of turns."""

    segments: Array
    twist: Array
    turns: Array
    covariances: Array
    predicted_turns: Array
    predicted_covariances: Array

    @staticmethod
    def empty(frames: int) -> _Passes:
        """Return arrays for these frames."""
        parts = (frames, PART_COUNT, 3, 3)
        return _Passes(
            np.empty((frames, SEGMENT_COUNT, 3, 3)),
            np.empty((frames, 4, 3)),
            *(np.empty(parts) for _ in range(4)),
        )
