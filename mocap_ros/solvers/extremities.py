# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Orientations of the segments of a body, and face, feet and hands: rigid parts that hang on it, over time.

A segment turns about its core joint: pelvis, torso (`neck`), head, arm, forearm and hand (shoulder, elbow, wrist),
thigh, shank and foot (hip, knee, ankle). In upright people with hanging arms all axes are x forward, y left, z up
(REP-103, REP-155). Up and left determine them:

    z = unit(up),    x = unit(left x z),    y = z x x

    segment                 up                                         left
    pelvis                  shoulders' middle - hips' middle           lhip - rhip
    torso                   neck - pelvis                              lshoulder - rshoulder
    head                    head - neck, then turned by `HEAD_REST`    y of the torso
    arm, thigh              from the lower to the upper joint          v
    forearm, shank          from the lower to the upper joint          y of the arm, y of the thigh
    hand, foot              the forearm and the shank turned by `REST`

    n = +-(u x l) + D f y_s,    v <- v' + (1 - e^(-h (1 + |n|^2 / W^2) / T)) (n - v')

u and l are unit vectors along upper and lower bone, y_s is y of the parent segment swung with the limb from rest
(f = 1 there, 0 opposite), v' the old v turned with the parent, h seconds ago: a limb that is straight for a short
time keeps its direction. Where feet are followed, y of thigh and shank is v + D_f y_foot.

Part k of the extremities hangs on a core joint c_k (`head`, ankles, wrists) and turns by R_k from its axes to the
camera's optical frame; T_i is the template of an average person (1 of the stature H), b_k the logarithmic size:

    p_i = c_k + e^(b_k) H R_k T_i

Without evidence a part returns to A_k, where the core has it, with the time constant tau and the spread S_k:

    R_k <- A_k exp(a log(A_k'^T R_k')),    P_k <- a^2 P_k + (1 - a^2) S_k,    a = e^(-h / tau)

with h s since the frame of the primes, P_k (rad^2) the covariance of the rotation. The frame corrects it by the
rotation d and the displacement t (m) that minimise, in two steps of Gauss and Newton,

    d^T P_k^-1 d + |t|^2 / s^2 + g_l sum_i |C_i^(-1/2) (p_i - c_k - o_i)|^2 / N
                               + g_r sum_i rho(|z (pi(p_i + t) - r_i)| / n_i)

o_i is the lifted offset from c_k with the covariance C_i, of N points with one error; r_i the ray of a seen point,
n_i the image noise (m) by its score, rho Cauchy's loss. Errors last for some T, so g = min(1, h / T). The size
moves by the information i and gradient j, d and t eliminated, with I the fading sum of earlier i, and stays within
5 s_b:

    b_k <- b_k - j / (I + i + 1 / s_b^2)

A whole sequence is followed forwards (f) and backwards (b, before its correction), with the sizes of all frames:

    P^-1 = P_f^-1 + P_b^-1 - S^-1,    R = exp(P (P_b^-1 log(R_b R_f^T) - S^-1 log(A R_f^T))) R_f

Live, orientations Q of all segments are steadied by a filter without lag at constant angular velocity w: with
Z the orientation of this frame, and e of at most d, rho and beta as in `tracking.motion_filter`,

    e = log(Z Q'^T),    Q' = exp(h w) Q,    Q <- exp((1 - rho^2) e) Q',    w <- w + beta / h e
    omega = Omega (1 + s^2 / s_0^2)^(1/4),    s_0 = 1 rad/s

s is the RMS angular velocity over the last frames. A segment whose angular velocity changes by a, in rad/s^2, is
behind by about a / omega^2. Points are not filtered.

The constants and the code are in `engine/extremities.pyx`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import extremities as engine
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.solvers.observed_window import ObservedWindow

Bools = NDArray[np.bool_]

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

EXTREMITIES = BODY26.joints[CORE_COUNT:]
PARTS = ('head', 'lfoot', 'rfoot', 'lhand', 'rhand')
_HEAD_PART = PARTS.index('head')

# Points (m per m of stature) in the axes of their part: the mean of the people of the training data. The line from
# the ears to the nose is 19.6 degrees below the horizontal in people who walk.
_FACE_PITCH = rotation_about(1, 19.6)
_TEMPLATES = {
    'toe': (0.115, 0.0, -0.0314),
    'heel': (-0.0307, 0.0, -0.0314),
    'hand': (0.0, 0.0, -0.0433),
    'nose': tuple(_FACE_PITCH @ (0.0710, 0.0, -0.0283)),
    'leye': tuple(_FACE_PITCH @ (0.0583, 0.0188, -0.0098)),
    'reye': tuple(_FACE_PITCH @ (0.0583, -0.0188, -0.0098)),
    'lear': tuple(_FACE_PITCH @ (0.0110, 0.0441, -0.0283)),
    'rear': tuple(_FACE_PITCH @ (0.0110, -0.0441, -0.0283)),
}
TEMPLATE = np.array([_TEMPLATES.get(name, _TEMPLATES.get(name[1:])) for name in EXTREMITIES])
# index of the part of each point
PART_OF = np.array(
    [
        _HEAD_PART
        if n == 'nose' or n[1:] in ('eye', 'ear')
        else PARTS.index(n[0] + ('hand' if n[1:] == 'hand' else 'foot'))
        for n in EXTREMITIES
    ]
)
ANCHORS = PART_SEGMENTS[PART_OF]  # (11,) index of the core joint on which each point hangs
# (26,) index of the segment that turns about each joint or holds it
SEGMENT_OF = np.concatenate([np.arange(CORE_COUNT), ANCHORS])
SIZE_OF = np.array([0, 1, 1, 2, 2])  # parts of one size: face, feet, hands
# rad; S_k, standard deviations of head, feet and hands about x, y, z from where the core has them, in the training
# data; those of feet are a quarter wider, as solved shanks are worse than true ones. The turn of a hand about its
# own axis, which nothing measures, is chosen by judgement.
REST_STD = np.radians(
    [[8.0, 14.0, 22.0], [10.0, 18.0, 26.0], [10.0, 18.0, 26.0], [20.0, 20.0, 30.0], [20.0, 20.0, 30.0]]
)
REST_MEMORY_S = np.array([0.7, 0.4, 0.4, 0.4, 0.4])  # s; tau: half a step for feet, a look for heads
# 1; s_b: std of b of face, feet and hands in the training data, and of what detectors take for toe and hand
SIZE_STD = np.array([0.06, 0.12, 0.15])

BODY = engine.Body(
    (HEAD, NECK, PELVIS, LSHOULDER, RSHOULDER, LHIP, RHIP),
    LIMBS,
    BENDS,
    HEAD_REST,
    np.array([*HAND_REST, FOOT_REST, FOOT_REST]),
    PART_SEGMENTS,
    PART_OF,
    SIZE_OF,
    TEMPLATE,
    REST_STD,
    REST_MEMORY_S,
    SIZE_STD,
)
_start = np.zeros(1, engine.STATE)
for _name in ('segments', 'turns', 'covariances'):
    _start[_name] = np.eye(3).ravel()
_start['time_s'] = -np.inf
START = _start.view(float)  # (N,) state of a person before the first frame


BLOCK_FRAMES = 3600  # whose states are kept at once; they take 40 MB


def attach(core: Array, offsets: Array) -> Array:
    """Return all joints (..., 26, 3) m of core joints (..., 15, 3) and offsets (..., 11, 3) of extremities."""
    return np.concatenate([core, core[..., ANCHORS, :] + offsets], axis=-2)


class ExtremityEvidence(NamedTuple):
    """What is known of the extremities of P people in one frame, or of one in P frames, in the optical frame."""

    core: Array  # (P, 15, 3) m, solved core joints
    lifted: Array  # (P, 26, 3) m, lifted joints about any origin; NaN without a lifter
    lifted_std: Array  # (P, 26, 3) m, their standard deviations across (twice) and along the line of sight
    rays: Array  # (P, 26, 2) rays of all joints
    weight: Array  # (P, 26) confidence scores of all joints; 0 where not seen
    noise: Array  # (P,) m, image noise at the body

    @staticmethod
    def without_image(core: Array) -> ExtremityEvidence:
        """Return the evidence of people of whom only the core (P, 15, 3) m is known."""
        shape = len(core), len(BODY26.joints)
        lifted, std = np.full((2, *shape, 3), np.nan)
        return ExtremityEvidence(
            np.ascontiguousarray(core), lifted, std, np.zeros((*shape, 2)), np.zeros(shape), np.zeros(len(core))
        )


def collect_evidence(
    core: Array, observed: Sequence[ObservedWindow], noise: Array, frames: Sequence[int]
) -> ExtremityEvidence:
    """Return what a frame of each of P windows says of the extremities; core (P, 15, 3) m, noise (P,) m."""
    core = np.ascontiguousarray(core)
    return ExtremityEvidence(core, *engine.collect_evidence(core, observed, frames), noise)


def read_states(states: Array) -> NDArray[Any]:
    """Return the fields of P people, each (P, ...), from the states (P, N); matrices (3, 3) are 9 numbers."""
    return states.view(engine.STATE)[:, 0]


class ExtremitySequence(NamedTuple):
    """The extremities of a person over F frames, smoothed."""

    offsets: Array  # (F, 11, 3) m, points less the core joints on which they hang
    offset_std: Array  # (F, 11) m, standard deviation of each of them
    quaternions: Array  # (F, 15, 4) x, y, z, w, orientations of the segments, continuous
    is_turn_seen: Bools  # (F, 15) whether the image says how a segment is turned about its own axis


def smooth_extremities(times: Array, evidence: ExtremityEvidence, stature: float) -> ExtremitySequence:
    """Estimate the extremities of a person over times (F,) s (formulas of the module).

    The states of `BLOCK_FRAMES` at a time are in memory.
    """
    steps, start = np.append(np.inf, np.diff(times)), START[None].copy()
    blocks = [slice(first, first + BLOCK_FRAMES) for first in range(0, len(times), BLOCK_FRAMES)]
    parts = [ExtremityEvidence(*(values[block] for values in evidence)) for block in blocks]
    state = start[0]
    for block, seen in zip(blocks, parts, strict=True):
        state = BODY.run(state, seen, stature, steps[block], True)[0][-1]
    read_states(start)['sizes'] = read_states(state[None])['sizes']
    # backwards, the last frame is not the first: as errors last, it says no more than others
    after = ExtremityEvidence.without_image(evidence.core[-1:])
    state = BODY.run(start[0], after, stature, np.array([np.inf]), False)[0][-1]
    predicted, steps_back = np.empty((2, len(times), len(PARTS), 9)), np.append(steps[1:], steps[-1])
    for block, seen in zip(blocks[::-1], parts[::-1], strict=True):
        reversed_ = ExtremityEvidence(*(np.ascontiguousarray(values[::-1]) for values in seen))
        steps_on = np.ascontiguousarray(steps_back[block][::-1])
        states, found = BODY.run(state, reversed_, stature, steps_on, False)
        predicted[:, block], state = found[:, ::-1], states[-1]
    state, smoothed = start[0], []
    for block, seen in zip(blocks, parts, strict=True):
        forwards, _ = BODY.run(state, seen, stature, steps[block], False)
        state = forwards[-1].copy()
        smoothed.append(_join_directions(forwards, predicted[0, block], predicted[1, block], seen.weight, stature))
        read_states(state[None])['quaternions'] = smoothed[-1].quaternions[-1]  # whose signs the next ones have
    return ExtremitySequence(*map(np.concatenate, zip(*smoothed, strict=True)))


def _join_directions(
    forwards: Array, back: Array, back_covariance: Array, weight: Array, stature: float
) -> ExtremitySequence:
    """Overwrite states (F, N) of a person followed forwards by those of both directions, and return their results.

    R and P (F, 5, 9) are predicted backwards; scores (F, 26).
    """
    states = read_states(forwards)
    fields = (states[name].reshape(len(states), -1, 3, 3) for name in ('turns', 'segments', 'covariances'))
    turns, segments, covariances = fields  # views
    back, back_covariance = (values.reshape(turns.shape) for values in (back, back_covariance))
    rest = segments[:, PART_SEGMENTS]
    of_rest = rest @ (REST_STD[..., None] ** -2 * np.swapaxes(rest, -1, -2))  # S^-1
    of_back = np.linalg.inv(back_covariance)
    covariance = np.linalg.inv(np.linalg.inv(covariances) + of_back - of_rest)
    pull = of_back @ _find_turn(turns, back) - of_rest @ _find_turn(turns, rest)
    turns[:] = rotation_from_vector((covariance @ pull)[..., 0]) @ turns
    covariances[:] = covariance
    BODY.finish(forwards, weight, stature)
    offsets, std, quaternions = (np.ascontiguousarray(states[n]) for n in ('offsets', 'offset_std', 'quaternions'))
    return ExtremitySequence(offsets, std, quaternions, states['is_turn_seen'] > 0)


def _find_turn(own: Array, other: Array) -> Array:
    """Return the rotation vectors (..., 3, 1) from some rotations (..., 3, 3) to others."""
    return vector_from_rotation(other @ np.swapaxes(own, -1, -2))[..., None]
