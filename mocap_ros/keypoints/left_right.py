"""Detection of frames whose left and right the detector has swapped: a hidden Markov model, decoded by Viterbi.

The hidden state z_t of frame t is 0 if the labels are correct and 1 if left and right are swapped. Over n frames
of 1/30 s the transition probabilities are those of n steps of a two-state Markov chain:

    P(z_t = 1 | z_(t-1) = 0) = a m(n),   P(z_t = 0 | z_(t-1) = 1) = b m(n)
    m(n) = (1 - (1 - a - b)^n) / (a + b)

with a = `ENTER_PROBABILITY` and b = `LEAVE_PROBABILITY`. The likelihood of the image points x_j, relabelled as the
state says, compares them with predicted points x'_j. The prediction starts from the path's last relabelled points
y_j with velocities v_j, seen d_j seconds before:

    -log p(x | z, path) = sum_j [c log(1 + e_j^2 / (2 c)) + 2 log sigma_j]
    e_j     = |x_j - x'_j| / (sigma_j * body size)
    x'_j    = y_j + g v_j tau (1 - exp(-d_j / tau))
    sigma_j = PREDICTION_STD + PREDICTION_STD_PER_S d_j + PREDICTION_STD_PER_S2 d_j^2

with c = `CAUCHY_SCALE`, tau = `VELOCITY_TIME_S` and g = `VELOCITY_GAIN`, over the joints that have a counterpart
on the other side. Viterbi's algorithm keeps the likeliest path to each of the two states:

    cost_t(k) = min_i [cost_(t-1)(i) - log p(x_t | z_t = k, path i) - log P(z_t = k | z_(t-1) = i)]

Each path carries its own relabelled points. A later frame may make the other path the likelier one, which changes
the decisions about earlier frames of the window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOLS_2D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_BOOLS_1D,
    INPUT_BOOLS_2D,
    INPUT_INTS_1D,
    INT,
    kernel,
)
from mocap_ros.keypoints.association import measure_extent

Array = NDArray[np.float64]

# The values were tuned on CMU motions; `benchmarks/tracker.py --only swaps` measures their effect
# (docs/tracker.md).
ENTER_PROBABILITY = 0.01  # per 1/30 s; a, the probability that a detector with correct labels begins to swap
LEAVE_PROBABILITY = 0.15  # per 1/30 s; a detector that swaps returns to correct labels (b), so swaps are short
INITIAL_SWAP_COST = 3.0  # nats; a first frame is swapped with odds of exp(-3), for nothing was seen before it
PREDICTION_STD = 0.05  # body sizes; std of a predicted coordinate with no time in between: image noise
PREDICTION_STD_PER_S = 1.0  # body sizes/s; growth of that std, for the velocity is not known exactly
PREDICTION_STD_PER_S2 = 5.0  # body sizes/s^2; makes either labelling acceptable after a gap
CAUCHY_SCALE = 9.0  # nats; scale of the Cauchy loss, so that one misplaced joint cannot decide (c)
VELOCITY_TIME_S = 0.06  # s; tau, time constant of the smoothing of velocities and of their decay in a prediction
VELOCITY_GAIN = 2.0  # no unit; factor on the predicted displacement (g)
MAX_VELOCITY_GAP_S = 0.2  # s; a joint that was not seen for longer restarts with velocity 0
MIN_STEP_S = 1e-3  # s; guards the divisions by a time step, for images may be a millisecond apart
REFERENCE_FRAME_S = 1 / 30  # s; frame interval that the two transition probabilities refer to


@dataclass(frozen=True, eq=False)
class ViterbiPaths:
    """The likeliest path to each state of the newest frame: row 0 to correct labels, row 1 to swapped ones.

    Attributes:
        cost: (2,) negative log likelihoods in nats, up to a common constant.
        is_swapped: (2, F) decisions about the frames of the window.
        points: (2, J, 2) last seen image point of each joint as the path relabels it.
        velocity: (2, J, 2) velocities of these points, per second.
        last_seen_s: (2, J) s, time at which each joint was last seen; -inf if never.
    """

    cost: Array
    is_swapped: NDArray[np.bool_]
    points: Array
    velocity: Array
    last_seen_s: Array


@dataclass(frozen=True, eq=False)
class SwapFilter:
    """Filter that finds the frames of one person whose left and right are swapped.

    The filter is immutable: every method returns a new one.

    Attributes:
        mirror: (J,) index of each joint's counterpart on the other side; its own index for a joint without one.
        enabled: False if the detector's labels are to be believed.
        is_swapped: (F,) decisions about the frames of the window, along the likelier path.
        paths: both Viterbi paths; None before the first frame, or if the filter is not enabled.
    """

    mirror: NDArray[np.intp]
    enabled: bool = True
    is_swapped: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    paths: ViterbiPaths | None = None

    def update(
        self, time_s: float, points: Array, weight: Array, body_size: float, dropped: int = 0
    ) -> SwapFilter:
        """Return the filter after one more frame, without its decisions about the oldest ones.

        Args:
            time_s: s, time of the frame.
            points: (J, 2) points as the detector labelled them.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
            body_size: size of the body in the units of the points.
            dropped: number of the oldest frames, which leave the window.
        """
        if not self.enabled:
            return SwapFilter(self.mirror, False, np.zeros(len(self.is_swapped) - dropped + 1, bool))
        if self.paths is None:
            paths = ViterbiPaths(*_begin_paths(time_s, points, weight, self.mirror))
        else:
            old = self.paths
            paths = ViterbiPaths(
                *_continue_paths(
                    old.cost,
                    old.is_swapped,
                    old.points,
                    old.velocity,
                    old.last_seen_s,
                    time_s,
                    points,
                    weight,
                    self.mirror,
                    body_size,
                    dropped,
                )
            )
        likelier = 1 if paths.cost[1] < paths.cost[0] else 0
        return SwapFilter(self.mirror, True, paths.is_swapped[likelier], paths)


@kernel(FLOATS_2D(FLOAT))
def compute_transition_cost(elapsed_s: float) -> Array:
    """Return -log P(z_t | z_(t-1)), (2, 2) in nats: rows are states before and columns states after a time step.

    Args:
        elapsed_s: s, length of the time step.
    """
    frames = max(elapsed_s, MIN_STEP_S) / REFERENCE_FRAME_S
    mixing = (1 - (1 - ENTER_PROBABILITY - LEAVE_PROBABILITY) ** frames) / (ENTER_PROBABILITY + LEAVE_PROBABILITY)
    enter, leave = ENTER_PROBABILITY * mixing, LEAVE_PROBABILITY * mixing
    return -np.log(np.array([[1 - enter, enter], [leave, 1 - leave]]))


_PATHS = types.Tuple((FLOATS_1D, BOOLS_2D, FLOATS_3D, FLOATS_3D, FLOATS_2D))  # the fields of `ViterbiPaths`


@kernel(_PATHS(FLOAT, INPUT_2D, INPUT_1D, INPUT_INTS_1D))
def _begin_paths(
    time_s: float, points: Array, weight: Array, mirror: NDArray[np.intp]
) -> tuple[Array, NDArray[np.bool_], Array, Array, Array]:
    """Return the paths that consist of a first frame; the arguments are those of `SwapFilter.update`."""
    joints = len(mirror)
    path_points, last_seen_s = np.empty((2, joints, 2)), np.full((2, joints), -np.inf)
    for state in range(2):
        for j in range(joints):
            source = mirror[j] if state else j
            path_points[state, j] = points[source]
            if weight[source] > 0:
                last_seen_s[state, j] = time_s
    cost, is_swapped = np.array([0.0, INITIAL_SWAP_COST]), np.array([[False], [True]])
    return cost, is_swapped, path_points, np.zeros((2, joints, 2)), last_seen_s


@kernel(FLOATS_2D(INPUT_3D, INPUT_3D, INPUT_2D, FLOAT, INPUT_2D, INPUT_1D, INPUT_INTS_1D, FLOAT))
def _compute_likelihood_cost(
    path_points: Array,
    velocity: Array,
    last_seen_s: Array,
    time_s: float,
    points: Array,
    weight: Array,
    mirror: NDArray[np.intp],
    body_size: float,
) -> Array:
    """Return -log p(x | z, path) of a frame for each path (rows) and each state (columns), (2, 2) in nats.

    The first arguments are fields of `ViterbiPaths`, the others those of `SwapFilter.update`.
    """
    cost = np.zeros((2, 2))
    for path in range(2):
        for j in range(len(mirror)):
            if mirror[j] == j or last_seen_s[path, j] == -np.inf:
                continue
            age = time_s - last_seen_s[path, j]
            horizon = VELOCITY_TIME_S * (1 - math.exp(-age / VELOCITY_TIME_S)) * VELOCITY_GAIN
            std = PREDICTION_STD + PREDICTION_STD_PER_S * age + PREDICTION_STD_PER_S2 * age**2
            for state in range(2):
                source = mirror[j] if state else j
                if weight[source] > 0:
                    error_x = points[source, 0] - (path_points[path, j, 0] + velocity[path, j, 0] * horizon)
                    error_y = points[source, 1] - (path_points[path, j, 1] + velocity[path, j, 1] * horizon)
                    squared = (error_x * error_x + error_y * error_y) / (body_size * std) ** 2
                    cost[path, state] += CAUCHY_SCALE * math.log1p(0.5 / CAUCHY_SCALE * squared)
                    cost[path, state] += 2 * math.log(std)
    return cost


@kernel(
    _PATHS(
        *(INPUT_1D, INPUT_BOOLS_2D, INPUT_3D, INPUT_3D, INPUT_2D),
        *(FLOAT, INPUT_2D, INPUT_1D, INPUT_INTS_1D, FLOAT, INT),
    )
)
def _continue_paths(
    path_cost: Array,
    is_swapped: NDArray[np.bool_],
    path_points: Array,
    velocity: Array,
    last_seen_s: Array,
    time_s: float,
    points: Array,
    weight: Array,
    mirror: NDArray[np.intp],
    body_size: float,
    dropped: int,
) -> tuple[Array, NDArray[np.bool_], Array, Array, Array]:
    """Return the paths continued by a frame.

    The first arguments are the fields of `ViterbiPaths`, the others those of `SwapFilter.update`.
    """
    joints, frames = len(mirror), is_swapped.shape[1] - dropped
    cost = compute_transition_cost(time_s - last_seen_s[0].max())
    cost += _compute_likelihood_cost(path_points, velocity, last_seen_s, time_s, points, weight, mirror, body_size)
    new_cost, new_is_swapped = np.empty(2), np.empty((2, frames + 1), np.bool_)
    new_points, new_velocity = np.empty((2, joints, 2)), np.empty((2, joints, 2))
    new_last_seen_s = np.empty((2, joints))
    for state in range(2):
        path = 1 if path_cost[1] + cost[1, state] < path_cost[0] + cost[0, state] else 0
        new_cost[state] = path_cost[path] + cost[path, state]
        new_is_swapped[state, :frames] = is_swapped[path, dropped:]
        new_is_swapped[state, frames] = state == 1
        for j in range(joints):
            source = mirror[j] if state else j
            if not weight[source] > 0:
                new_points[state, j] = path_points[path, j]
                new_velocity[state, j] = velocity[path, j]
                new_last_seen_s[state, j] = last_seen_s[path, j]
                continue
            age = max(time_s - last_seen_s[path, j], MIN_STEP_S)
            blend = 1 - math.exp(-age / VELOCITY_TIME_S)
            for d in range(2):
                measured = (points[source, d] - path_points[path, j, d]) / age
                smoothed = velocity[path, j, d] + blend * (measured - velocity[path, j, d])
                new_points[state, j, d] = points[source, d]
                new_velocity[state, j, d] = smoothed if age < MAX_VELOCITY_GAP_S else 0.0
            new_last_seen_s[state, j] = time_s
    return new_cost - new_cost.min(), new_is_swapped, new_points, new_velocity, new_last_seen_s


def find_swapped_frames(times: Array, points: Array, weight: Array, mirror: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return the frames of a sequence whose left and right are swapped, (F,).

    Args:
        times: (F,) s, increasing.
        points: (F, J, 2) image points in any unit.
        weight: (F, J) confidence scores; 0 for a joint that was not seen.
        mirror: (J,) index of each joint's counterpart on the other side.
    """
    swap_filter, is_swapped = SwapFilter(mirror), np.zeros(len(times), bool)
    seen_frames = np.flatnonzero((weight > 0).sum(axis=1) > 1)
    for frame in seen_frames:
        body_size = measure_extent(points[frame], weight[frame]).size
        swap_filter = swap_filter.update(float(times[frame]), points[frame], weight[frame], body_size)
    is_swapped[seen_frames] = swap_filter.is_swapped
    return is_swapped


def exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.bool_], mirror: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return points (F, J, 2) and weights (F, J) with left and right exchanged in some frames.

    Args:
        points: (F, J, 2) image points in any unit.
        weight: (F, J) confidence scores.
        is_swapped: (F,) frames whose sides are exchanged.
        mirror: (J,) index of each joint's counterpart on the other side.
    """
    return (
        _exchange_sides(points, weight, is_swapped, mirror) if np.count_nonzero(is_swapped) else (points, weight)
    )


@kernel(types.Tuple((FLOATS_3D, FLOATS_2D))(INPUT_3D, INPUT_2D, INPUT_BOOLS_1D, INPUT_INTS_1D))
def _exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.bool_], mirror: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Compute `exchange_sides`."""
    new_points, new_weight = np.empty_like(points), np.empty_like(weight)
    for frame in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            source = mirror[j] if is_swapped[frame] else j
            new_points[frame, j] = points[frame, source]
            new_weight[frame, j] = weight[frame, source]
    return new_points, new_weight
