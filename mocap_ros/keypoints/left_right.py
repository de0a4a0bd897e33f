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

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

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

    @staticmethod
    def initialise(time_s: float, points: Array, seen: NDArray[np.bool_]) -> ViterbiPaths:
        """Return the paths that consist of a first frame.

        Args:
            time_s: s, time of the frame.
            points: (2, J, 2) points as labelled and relabelled.
            seen: (2, J) whether each of these was seen.
        """
        return ViterbiPaths(
            np.array([0.0, INITIAL_SWAP_COST]),
            np.array([[False], [True]]),
            points,
            np.zeros_like(points),
            np.where(seen, time_s, -np.inf),
        )

    def negative_log_likelihood(
        self, time_s: float, points: Array, seen: NDArray[np.bool_], body_size: float
    ) -> Array:
        """Return -log p(x | z, path) of a frame for each path (rows) and each state (columns), (2, 2) in nats.

        Args:
            time_s: s, time of the frame.
            points: (2, J, 2) points as labelled and relabelled.
            seen: (2, J) whether each of these was seen and has a counterpart on the other side.
            body_size: size of the body in the units of the points.
        """
        was_seen = np.isfinite(self.last_seen_s)
        age = time_s - np.where(was_seen, self.last_seen_s, time_s)
        horizon = VELOCITY_TIME_S * (1 - np.exp(-age / VELOCITY_TIME_S)) * VELOCITY_GAIN
        predicted = self.points + self.velocity * horizon[..., None]
        std = PREDICTION_STD + PREDICTION_STD_PER_S * age + PREDICTION_STD_PER_S2 * age**2
        error = points - predicted[:, None]
        squared = np.einsum('hljd,hljd->hlj', error, error) / (body_size * std[:, None]) ** 2
        cost = CAUCHY_SCALE * np.log1p((0.5 / CAUCHY_SCALE) * squared) + 2 * np.log(std)[:, None]
        return np.asarray((cost * (seen & was_seen[:, None])).sum(axis=-1))

    def advance(
        self, time_s: float, points: Array, seen: NDArray[np.bool_], cost: Array, predecessor: NDArray[np.intp]
    ) -> ViterbiPaths:
        """Return the paths continued by a frame.

        Args:
            time_s: s, time of the frame.
            points: (2, J, 2) points as labelled and relabelled.
            seen: (2, J) whether each of these was seen.
            cost: (2,) cost of the likeliest path to each state of this frame.
            predecessor: (2,) index of the path that it continues.
        """
        last_points, velocity = self.points[predecessor], self.velocity[predecessor]
        last_seen_s = self.last_seen_s[predecessor]
        age = np.maximum(time_s - last_seen_s, MIN_STEP_S)
        blend = 1 - np.exp(-age / VELOCITY_TIME_S)
        measured = (points - last_points) / age[..., None]
        smoothed = velocity + blend[..., None] * (measured - velocity)
        smoothed = np.where((age < MAX_VELOCITY_GAP_S)[..., None], smoothed, 0.0)
        return ViterbiPaths(
            cost - cost.min(),
            np.concatenate([self.is_swapped[predecessor], [[False], [True]]], axis=1),
            np.where(seen[..., None], points, last_points),
            np.where(seen[..., None], smoothed, velocity),
            np.where(seen, time_s, last_seen_s),
        )


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

    def update(self, time_s: float, points: Array, weight: Array, body_size: float) -> SwapFilter:
        """Return the filter after one more frame.

        Args:
            time_s: s, time of the frame.
            points: (J, 2) points as the detector labelled them.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
            body_size: size of the body in the units of the points.
        """
        if not self.enabled:
            return replace(self, is_swapped=np.append(self.is_swapped, False))
        labellings = np.stack([points, points[self.mirror]])
        seen = np.stack([weight, weight[self.mirror]]) > 0
        if self.paths is None:
            paths = ViterbiPaths.initialise(time_s, labellings, seen)
        else:
            elapsed_s = time_s - float(self.paths.last_seen_s[0].max())
            has_counterpart = self.mirror != np.arange(len(self.mirror))
            cost = (
                self.paths.cost[:, None]
                + self.paths.negative_log_likelihood(time_s, labellings, seen & has_counterpart, body_size)
                + compute_transition_cost(elapsed_s)
            )
            predecessor = cost.argmin(axis=0)
            paths = self.paths.advance(time_s, labellings, seen, cost[predecessor, [0, 1]], predecessor)
        return replace(self, paths=paths, is_swapped=paths.is_swapped[paths.cost.argmin()])

    def drop_oldest(self, frames: int) -> SwapFilter:
        """Return the filter without its decisions about the oldest frames of the window.

        Args:
            frames: number of frames to drop.
        """
        if frames == 0:
            return self
        paths = self.paths
        if paths is not None:
            paths = replace(paths, is_swapped=paths.is_swapped[:, frames:])
        return replace(self, paths=paths, is_swapped=self.is_swapped[frames:])


def compute_transition_cost(elapsed_s: float) -> Array:
    """Return -log P(z_t | z_(t-1)), (2, 2) in nats: rows are states before and columns states after a time step.

    Args:
        elapsed_s: s, length of the time step.
    """
    frames = max(elapsed_s, MIN_STEP_S) / REFERENCE_FRAME_S
    mixing = (1 - (1 - ENTER_PROBABILITY - LEAVE_PROBABILITY) ** frames) / (ENTER_PROBABILITY + LEAVE_PROBABILITY)
    enter, leave = ENTER_PROBABILITY * mixing, LEAVE_PROBABILITY * mixing
    return np.asarray(-np.log([[1 - enter, enter], [leave, 1 - leave]]))


def find_swapped_frames(times: Array, points: Array, weight: Array, mirror: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return the frames of a sequence whose left and right are swapped, (F,).

    Args:
        times: (F,) s, increasing.
        points: (F, J, 2) image points in any unit.
        weight: (F, J) confidence scores; 0 for a joint that was not seen.
        mirror: (J,) index of each joint's counterpart on the other side.
    """
    swap_filter = SwapFilter(mirror)
    is_swapped = np.zeros(len(times), bool)
    seen_frames = np.flatnonzero((weight > 0).sum(axis=1) > 1)
    for frame in seen_frames:
        _, body_size = measure_extent(points[frame], weight[frame])
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
    if not is_swapped.any():
        return points, weight
    exchanged_points = np.where(is_swapped[:, None, None], points[:, mirror], points)
    return exchanged_points, np.where(is_swapped[:, None], weight[:, mirror], weight)
