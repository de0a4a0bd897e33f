# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Detection of left and right exchanged by the detector: a hidden Markov model, decoded by Viterbi's algorithm.

Detectors exchange left and right of the whole body, of the legs alone or of the arms alone. The hidden state z_t
of frame t has a bit for each of these, and each bit is a Markov chain of its own. Over n frames of 1/30 s

    P(bit is set | it was not) = a m(n),   P(bit is not set | it was) = b m(n)
    m(n) = (1 - (1 - a - b)^n) / (a + b)

with a = `ENTER_PROBABILITY` and b = `LEAVE_PROBABILITY`. The labels of the shoulders are wrong if the bit of the
whole body is set, those of legs and arms if either that bit or their own is set, and not both. The likelihood of
the image points x_j, relabelled as the state says, compares them with predicted points x'_j. The prediction starts
from the last relabelled points y_j of a path with velocities v_j, seen d_j seconds before; c_j is the confidence
score:

    -log p(x_j | z, path) = -log[(1 - eps) exp(-e_j^2 / 2) / sigma_j^2 + eps / (sigma_j^2 + s^2)]
    e_j     = |x_j - x'_j| / (sigma_j * body size)
    x'_j    = y_j + v_j tau (1 - exp(-d_j / tau))
    sigma_j = (2 - c_j) (PREDICTION_STD + PREDICTION_STD_PER_S d_j + PREDICTION_STD_PER_S2 d_j^2)

with eps = `OUTLIER_PROBABILITY`, s = `OUTLIER_STD` and tau = `VELOCITY_TIME_S`, over the joints that have a
counterpart on the other side. Where left and right are close together, as in a person seen from the side, the
likelihood is the same for both labels, and the state stays as it is.

A path may have confused left and right of a part before, where they crossed. With C_g(l) the sum of these costs
over the joints of part g with labels l (as they are or exchanged), the path may exchange them in its own past:

    C'_g(l) = min[C_g(l), C_g(other l) + CONFUSION_COST]

This bounds what one frame can say, so that a wrong verdict is left again: to stay in a state with a bit set costs
-log(1 - b) in each frame.

Hips are below their own shoulder and elbows on their own upper arm. Let D_g be, in body sizes, by how much the
lines from the shoulders to the hips or elbows of part g get longer if left and right of these are exchanged. A
state whose bit for the legs or the arms is set costs in addition

    ATTACHMENT_COST max(0, tanh(D_g / ATTACHMENT_SCALE)) min(elapsed time / ATTACHMENT_TIME_S, 1)

Viterbi's algorithm keeps the likeliest path to each of the eight states:

    cost_t(k) = min_i [cost_(t-1)(i) - log p(x_t | z_t = k, path i) - log P(z_t = k | z_(t-1) = i)]

Each path carries its own relabelled points. A later frame may make another path the likeliest one, which changes
the decisions about earlier frames of the window.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_BOOLS_2D,
    INPUT_INTS_1D,
    INTS_1D,
    kernel,
)
from mocap_ros.keypoints.association import measure_extent
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]

# Parts whose labels a state exchanges together, and the ends of the names of their joints; other joints that exist
# on both sides, such as eyes, go with the shoulders.
PARTS = ('shoulders', 'legs', 'arms')
_LEG_JOINTS = ('hip', 'knee', 'ankle', 'heel', 'toe', 'foot_index')
_ARM_JOINTS = ('elbow', 'wrist', 'hand', 'index', 'pinky', 'thumb')
# Joints whose line from the upper to the lower one shows which lower joint belongs to which shoulder, by part.
_ATTACHMENTS = {'legs': ('lshoulder', 'lhip'), 'arms': ('lshoulder', 'lelbow')}

STATES = 8  # bit 0: whole body, bit 1: legs, bit 2: arms
# (8, 3), the bits of each state.
STATE_BITS = np.array([[s >> bit & 1 for bit in range(3)] for s in range(STATES)])
SWAPPED_PARTS = (STATE_BITS ^ (STATE_BITS[:, :1] & [0, 1, 1])).astype(bool)  # (8, 3) parts with wrong labels

# The values were tuned on motion capture as models of three real detectors see it. The
# probabilities are per 1/30 s, for the whole body,
# the legs and the arms: real detectors swap the whole body in 0.1 % of the frames, for 0.3 s, legs and arms in 0.3
# to 3 %, for 0.06 s.
ENTER_PROBABILITY = np.array([0.0005, 0.003, 0.003])  # a, the probability that a swap begins
LEAVE_PROBABILITY = np.array([0.2, 0.55, 0.55])  # b, the probability that it ends
INITIAL_COST = np.array([7.0, 5.0, 5.0])  # nats; about the shares of frames above, for nothing was seen before
PREDICTION_STD = 0.05  # body sizes; std of a predicted coordinate with no time in between: image noise
PREDICTION_STD_PER_S = 1.0  # body sizes/s; growth of that std, for the velocity is not known exactly
PREDICTION_STD_PER_S2 = 2.0  # body sizes/s^2; makes either labelling acceptable after a gap
OUTLIER_PROBABILITY = 0.1  # eps; share of points that are far from where the joint is
OUTLIER_STD = 0.3  # body sizes (s); such points are still on the body
CONFUSION_COST = 12.0  # nats; more than to enter a swap of legs or arms, so that these are seen at once
ATTACHMENT_COST = 5.0  # nats; log odds that the much shorter lines are those of the right labels
ATTACHMENT_SCALE = 0.25  # body sizes; lines that are longer by this have log odds of about 4 nats
ATTACHMENT_TIME_S = 0.1  # s; frames that follow each other more closely say the same
VELOCITY_TIME_S = 0.08  # s; tau, time constant of the smoothing of velocities and of their decay in a prediction
MAX_VELOCITY_GAP_S = 0.2  # s; a joint that was not seen for longer restarts with velocity 0
MIN_STEP_S = 1e-3  # s; guards the divisions by a time step, for images may be a millisecond apart
REFERENCE_FRAME_S = 1 / 30  # s; frame interval that the transition probabilities refer to

_Indices = NDArray[np.intp]
_Frame = tuple[float, Array, Array, float, _Indices, _Indices, _Indices, _Indices]
_NEWEST_STATES = np.arange(STATES, dtype=np.int8)[:, None]


@dataclass(frozen=True, eq=False)
class BodySides:
    """Which joints of a skeleton are left and right ones, and to which part they belong.

    Attributes:
        mirror: (J,) index of each joint's counterpart on the other side; its own index for a joint without one.
        part: (J,) index of each joint's part in `PARTS`; -1 for a joint without a counterpart.
        upper: (3,) left joint from which the line to a part starts that shows left from right; -1 for none.
        lower: (3,) left joint of the part at which the line ends; -1 for none.
    """

    mirror: NDArray[np.intp]
    part: NDArray[np.intp]
    upper: NDArray[np.intp]
    lower: NDArray[np.intp]

    @staticmethod
    @lru_cache(maxsize=16)
    def of(skeleton: Skeleton) -> BodySides:
        """Return the sides of a skeleton."""
        mirror = np.array(skeleton.mirror)
        part = np.array([_find_part(name) for name in skeleton.joints])
        part[mirror == np.arange(len(mirror))] = -1
        lines = np.full((len(PARTS), 2), -1)
        for name, ends in _ATTACHMENTS.items():
            if set(ends) <= set(skeleton.joints):
                lines[PARTS.index(name)] = [skeleton.index(joint) for joint in ends]
        upper, lower = lines.T
        return BodySides(mirror, part, np.ascontiguousarray(upper), np.ascontiguousarray(lower))


def _find_part(joint: str) -> int:
    if joint.endswith(_LEG_JOINTS):
        return PARTS.index('legs')
    return PARTS.index('arms') if joint.endswith(_ARM_JOINTS) else PARTS.index('shoulders')


@dataclass(frozen=True, eq=False)
class ViterbiPaths:
    """The likeliest path to each of the eight states of the newest frame, in the order of `SWAPPED_PARTS`.

    Attributes:
        cost: (8,) negative log likelihoods in nats, up to a common constant.
        states: (8, F) states in the frames of the window.
        points: (8, J, 2) last seen image point of each joint as the path relabels it.
        velocity: (8, J, 2) velocities of these points, per second.
        last_seen_s: (8, J) s, time at which each joint was last seen; -inf if never.
    """

    cost: Array
    states: NDArray[np.int8]
    points: Array
    velocity: Array
    last_seen_s: Array


@dataclass(frozen=True, eq=False)
class SwapFilter:
    """Filter that finds the parts of one person's body whose left and right are swapped; it is immutable.

    Attributes:
        sides: left and right joints.
        enabled: False if the detector's labels are to be believed.
        is_swapped: (F, 3) decisions about the parts in the frames of the window, along the likeliest path.
        paths: the Viterbi paths; None before the first frame, or if the filter is not enabled.
    """

    sides: BodySides
    enabled: bool = True
    is_swapped: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, len(PARTS)), bool))
    paths: ViterbiPaths | None = None

    def update(
        self, time_s: float, points: Array, weight: Array, body_size: float, dropped: int = 0
    ) -> SwapFilter:
        """Return the filter after one more frame, without its decisions about the oldest ones.

        Args:
            time_s: s, time of the frame.
            points: (J, 2) points as the detector labelled them.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
            body_size: size of the body in the units of the points, above 0.
            dropped: number of the oldest frames, which leave the window.
        """
        if not self.enabled:
            frames = len(self.is_swapped) - dropped + 1
            return SwapFilter(self.sides, False, np.zeros((frames, len(PARTS)), bool))
        frame = _describe(time_s, points, weight, body_size, self.sides)
        if self.paths is None:
            cost, *rest = _begin_paths(*frame)
            states = _NEWEST_STATES
        else:
            old = self.paths
            predecessor, cost, *rest = _continue_paths(old.cost, old.points, old.velocity, old.last_seen_s, *frame)
            states = np.concatenate([old.states[predecessor, dropped:], _NEWEST_STATES], axis=1)
        is_swapped = SWAPPED_PARTS[states[cost.argmin()]]
        return SwapFilter(self.sides, True, is_swapped, ViterbiPaths(cost, states, *rest))

    def convert_points(self, convert: Callable[[Array], Array]) -> SwapFilter:
        """Return the filter with its points (..., 2) converted, as to rays of another camera."""
        if self.paths is None:
            return self
        points, movement = self.paths.points, VELOCITY_TIME_S * self.paths.velocity
        converted = np.ascontiguousarray(convert(points))
        velocity = (convert(points + movement) - converted) / VELOCITY_TIME_S
        return replace(self, paths=replace(self.paths, points=converted, velocity=velocity))


def _describe(time_s: float, points: Array, weight: Array, body_size: float, sides: BodySides) -> _Frame:
    return time_s, points, weight, body_size, sides.mirror, sides.part, sides.upper, sides.lower


@kernel(FLOATS_2D(FLOAT))
def compute_transition_cost(elapsed_s: float) -> Array:
    """Return -log P(z_t | z_(t-1)), (8, 8) in nats; rows are states before, columns states after a step."""
    frames = max(elapsed_s, MIN_STEP_S) / REFERENCE_FRAME_S
    cost = np.zeros((STATES, STATES))
    for bit in range(3):
        a, b = ENTER_PROBABILITY[bit], LEAVE_PROBABILITY[bit]
        mixing = (1 - (1 - a - b) ** frames) / (a + b)
        step = -np.log(np.array([[1 - a * mixing, a * mixing], [b * mixing, 1 - b * mixing]]))
        for before in range(STATES):
            for after in range(STATES):
                cost[before, after] += step[STATE_BITS[before, bit], STATE_BITS[after, bit]]
    return cost


_FRAME = (FLOAT, INPUT_2D, INPUT_1D, FLOAT)  # types of time, points, weight and body size
_SIDES = (INPUT_INTS_1D, INPUT_INTS_1D, INPUT_INTS_1D, INPUT_INTS_1D)  # types of the fields of `BodySides`


@kernel(FLOATS_1D(INPUT_2D, INPUT_1D, FLOAT, INPUT_INTS_1D, INPUT_INTS_1D, INPUT_INTS_1D))
def compute_attachment_cost(
    points: Array,
    weight: Array,
    body_size: float,
    mirror: NDArray[np.intp],
    upper: NDArray[np.intp],
    lower: NDArray[np.intp],
) -> Array:
    """Return what it costs to exchange left and right of a part, but not of the shoulders, (3,) in nats."""
    cost = np.zeros(len(upper))
    for part in range(len(upper)):
        if upper[part] < 0:
            continue
        left, right, longer = upper[part], mirror[upper[part]], 0.0
        near, far = lower[part], mirror[lower[part]]
        if weight[left] > 0 and weight[right] > 0 and weight[near] > 0 and weight[far] > 0:
            for a, b, sign in ((left, far, 1), (right, near, 1), (left, near, -1), (right, far, -1)):
                longer += sign * math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1])
            cost[part] = ATTACHMENT_COST * max(0.0, math.tanh(longer / body_size / ATTACHMENT_SCALE))
    return cost


@kernel(types.Tuple((FLOATS_1D, FLOATS_3D, FLOATS_3D, FLOATS_2D))(*_FRAME, *_SIDES))
def _begin_paths(
    time_s: float,
    points: Array,
    weight: Array,
    body_size: float,
    mirror: NDArray[np.intp],
    part: NDArray[np.intp],
    upper: NDArray[np.intp],
    lower: NDArray[np.intp],
) -> tuple[Array, Array, Array, Array]:
    """Return the paths that consist of a first frame: costs, points, velocities and times of `ViterbiPaths`."""
    joints = len(mirror)
    attachment_cost = compute_attachment_cost(points, weight, body_size, mirror, upper, lower)
    cost = np.zeros(STATES)
    path_points, last_seen_s = np.empty((STATES, joints, 2)), np.full((STATES, joints), -np.inf)
    for state in range(STATES):
        for bit in range(3):
            cost[state] += STATE_BITS[state, bit] * (INITIAL_COST[bit] + attachment_cost[bit])
        for j in range(joints):
            source = mirror[j] if part[j] >= 0 and SWAPPED_PARTS[state, part[j]] else j
            path_points[state, j] = points[source]
            if weight[source] > 0:
                last_seen_s[state, j] = time_s
    return cost, path_points, np.zeros((STATES, joints, 2)), last_seen_s


@kernel(FLOATS_3D(INPUT_3D, INPUT_3D, INPUT_2D, *_FRAME, INPUT_INTS_1D, INPUT_INTS_1D))
def compute_label_cost(
    path_points: Array,
    velocity: Array,
    last_seen_s: Array,
    time_s: float,
    points: Array,
    weight: Array,
    body_size: float,
    mirror: NDArray[np.intp],
    part: NDArray[np.intp],
) -> Array:
    """Return the costs C_g(l) of a frame in nats, (8, 3, 2): for each path, part and label, 1 for exchanged."""
    cost = np.zeros((STATES, len(PARTS), 2))
    known_age, horizon = -1.0, 0.0
    for path in range(STATES):
        for j in range(len(mirror)):
            if part[j] < 0 or last_seen_s[path, j] == -np.inf:
                continue
            age = time_s - last_seen_s[path, j]
            if age != known_age:  # most joints were seen in the same frame
                known_age, horizon = age, VELOCITY_TIME_S * (1 - math.exp(-age / VELOCITY_TIME_S))
            growth = PREDICTION_STD + PREDICTION_STD_PER_S * age + PREDICTION_STD_PER_S2 * age**2
            for label in range(2):
                source = mirror[j] if label else j
                if weight[source] > 0:
                    error_x = points[source, 0] - (path_points[path, j, 0] + velocity[path, j, 0] * horizon)
                    error_y = points[source, 1] - (path_points[path, j, 1] + velocity[path, j, 1] * horizon)
                    variance = (growth * (2 - weight[source])) ** 2
                    squared = (error_x * error_x + error_y * error_y) / (body_size * body_size * variance)
                    likelihood = (1 - OUTLIER_PROBABILITY) * math.exp(-0.5 * squared) / variance
                    likelihood += OUTLIER_PROBABILITY / (variance + OUTLIER_STD**2)
                    cost[path, part[j], label] -= math.log(likelihood)
    return cost


@kernel(types.Tuple((FLOATS_1D, INTS_1D))(INPUT_1D, INPUT_2D, INPUT_3D))
def _find_predecessors(
    path_cost: Array, transition_cost: Array, label_cost: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Return the least cost (8,) of each state with the path (8,) that it continues.

    Args:
        path_cost: (8,) nats, cost of the paths so far.
        transition_cost: (8, 8) nats, cost of the states after those before.
        label_cost: (8, 3, 2) nats, cost of the labels of each part, for each path.
    """
    cost, predecessor = np.full(STATES, np.inf), np.zeros(STATES, np.int64)
    for state in range(STATES):
        for path in range(STATES):
            total = path_cost[path] + transition_cost[path, state]
            for part in range(len(PARTS)):
                total += label_cost[path, part, int(SWAPPED_PARTS[state, part])]
            if total < cost[state]:
                cost[state], predecessor[state] = total, path
    return cost, predecessor


@kernel(
    types.Tuple((INTS_1D, FLOATS_1D, FLOATS_3D, FLOATS_3D, FLOATS_2D))(
        *(INPUT_1D, INPUT_3D, INPUT_3D, INPUT_2D), *_FRAME, *_SIDES
    )
)
def _continue_paths(
    path_cost: Array,
    path_points: Array,
    velocity: Array,
    last_seen_s: Array,
    time_s: float,
    points: Array,
    weight: Array,
    body_size: float,
    mirror: NDArray[np.intp],
    part: NDArray[np.intp],
    upper: NDArray[np.intp],
    lower: NDArray[np.intp],
) -> tuple[NDArray[np.intp], Array, Array, Array, Array]:
    """Return the paths continued by a frame: which path each state continues (8,), then as `_begin_paths`."""
    joints, elapsed_s = len(mirror), time_s - last_seen_s[0].max()
    label_cost = compute_label_cost(
        path_points, velocity, last_seen_s, time_s, points, weight, body_size, mirror, part
    )
    is_confused = np.zeros(label_cost.shape, np.bool_)  # whether the path exchanges the part in its own past
    for path in range(STATES):
        for p in range(len(PARTS)):
            bound = label_cost[path, p].min() + CONFUSION_COST
            for label in range(2):
                is_confused[path, p, label] = label_cost[path, p, label] > bound
                label_cost[path, p, label] = min(label_cost[path, p, label], bound)
    cost, predecessor = _find_predecessors(path_cost, compute_transition_cost(elapsed_s), label_cost)
    attachment_cost = compute_attachment_cost(points, weight, body_size, mirror, upper, lower)
    share = min(elapsed_s / ATTACHMENT_TIME_S, 1.0)
    new_points, new_velocity = np.empty(path_points.shape), np.empty(velocity.shape)
    new_last_seen_s = np.empty(last_seen_s.shape)
    for state in range(STATES):
        path = predecessor[state]
        for bit in range(3):
            cost[state] += STATE_BITS[state, bit] * attachment_cost[bit] * share
        for j in range(joints):
            source, before = j, j
            if part[j] >= 0:
                label = int(SWAPPED_PARTS[state, part[j]])
                source = mirror[j] if label else j
                before = mirror[j] if is_confused[path, part[j], label] else j
            if not weight[source] > 0:
                new_points[state, j] = path_points[path, before]
                new_velocity[state, j] = velocity[path, before]
                new_last_seen_s[state, j] = last_seen_s[path, before]
                continue
            age = max(time_s - last_seen_s[path, before], MIN_STEP_S)
            blend = 1 - math.exp(-age / VELOCITY_TIME_S)
            for d in range(2):
                measured = (points[source, d] - path_points[path, before, d]) / age
                smoothed = velocity[path, before, d] + blend * (measured - velocity[path, before, d])
                new_points[state, j, d] = points[source, d]
                new_velocity[state, j, d] = smoothed if age < MAX_VELOCITY_GAP_S else 0.0
            new_last_seen_s[state, j] = time_s
    return predecessor, cost - cost.min(), new_points, new_velocity, new_last_seen_s


def find_swapped_parts(times: Array, points: Array, weight: Array, sides: BodySides) -> NDArray[np.bool_]:
    """Return the parts (F, 3) of the body whose left and right are swapped in the frames of a sequence.

    Args:
        times: (F,) s, increasing.
        points: (F, J, 2) image points in rays or px; a frame with all of them in one place does not count.
        weight: (F, J) confidence scores; 0 for a joint that was not seen.
        sides: left and right joints.
    """
    is_swapped = np.zeros((len(times), len(PARTS)), bool)
    extents = [measure_extent(*frame) for frame in zip(points, weight, strict=True)]
    frames = np.flatnonzero([not e.is_one_place for e in extents])
    if not len(frames):
        return is_swapped
    seen = [_describe(float(times[f]), points[f], weight[f], extents[f].size, sides) for f in frames]
    cost, path_points, velocity, last_seen_s = _begin_paths(*seen[0])
    predecessors = []
    for frame in seen[1:]:
        predecessor, cost, path_points, velocity, last_seen_s = _continue_paths(
            cost, path_points, velocity, last_seen_s, *frame
        )
        predecessors.append(predecessor)
    states = [int(cost.argmin())]
    for predecessor in predecessors[::-1]:
        states.append(int(predecessor[states[-1]]))
    is_swapped[frames] = SWAPPED_PARTS[states[::-1]]
    return is_swapped


def exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.bool_], sides: BodySides
) -> tuple[Array, Array]:
    """Return points (F, J, 2) and weights (F, J) with left and right of some parts (F, 3) exchanged."""
    if not np.count_nonzero(is_swapped):
        return points, weight
    return _exchange_sides(points, weight, is_swapped, sides.mirror, sides.part)


@kernel(types.Tuple((FLOATS_3D, FLOATS_2D))(INPUT_3D, INPUT_2D, INPUT_BOOLS_2D, INPUT_INTS_1D, INPUT_INTS_1D))
def _exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.bool_], mirror: NDArray[np.intp], part: NDArray[np.intp]
) -> tuple[Array, Array]:
    new_points, new_weight = np.empty_like(points), np.empty_like(weight)
    for frame in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            source = mirror[j] if part[j] >= 0 and is_swapped[frame, part[j]] else j
            new_points[frame, j] = points[frame, source]
            new_weight[frame, j] = weight[frame, source]
    return new_points, new_weight
