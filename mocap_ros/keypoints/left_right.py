# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Detection of left and right exchanged by the detector: a hidden Markov model, decoded by Viterbi's algorithm.

Detectors exchange left and right of the whole body, of the legs or of the arms. The hidden state z_t of frame t
has a bit for each, and each bit is a Markov chain of its own. Over n frames of 1/30 s

    P(bit is set | it was not) = a m(n),   P(bit is not set | it was) = b m(n)
    m(n) = (1 - (1 - a - b)^n) / (a + b)

The labels of the shoulders are wrong if the bit of the whole body is set, those of legs and arms if either that
bit or their own is. The likelihood of the points x_j, relabelled as the state says, compares them with those
predicted from the last relabelled points y_j of a path, with velocities v_j, seen d_j seconds before at the score
c_j:

    -log p(x_j | z, path) = -log[(1 - eps) exp(-e_j^2 / 2) / sigma_j^2 + eps / (sigma_j^2 + s^2)]
    e_j     = |x_j - y_j - v_j tau (1 - exp(-d_j / tau))| / (sigma_j * body size)
    sigma_j = (2 - c_j) (PREDICTION_STD + PREDICTION_STD_PER_S d_j + PREDICTION_STD_PER_S2 d_j^2)

with eps = `OUTLIER_PROBABILITY`, s = `OUTLIER_STD`, tau = `TAU_S` (constants in
`engine/left_right.pyx`). A measured velocity changes v_j by the share 1 - exp(-d_j / tau), times the probability
that x_j is no outlier: a path goes on after a bad frame as before. Where left and right nearly coincide, the
likelihoods of both labels are the same, and the state stays.

A path may have confused left and right of a part before. With C_g(l) the sum of these costs over part g with
labels l, it may exchange them in its own past, which bounds what one frame can say; and hips are below their own
shoulder, elbows on their own upper arm, so with D_g the growth in body sizes of the lines to these if exchanged,

    C'_g(l) = min[C_g(l), C_g(other l) + CONFUSION_COST]
    cost of a set bit: ATTACHMENT_COST max(0, tanh(D_g / ATTACHMENT_SCALE)) min(elapsed / ATTACHMENT_TIME_S, 1)

Viterbi's algorithm keeps the likeliest path to each of the eight states, with its own relabelled points:

    cost_t(k) = min_i [cost_(t-1)(i) - log p(x_t | z_t = k, path i) - log P(z_t = k | z_(t-1) = i)]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import left_right as engine
from mocap_ros.keypoints.association import measure_sizes, show_people
from mocap_ros.skeleton import Skeleton

# Parts whose labels a state exchanges together, and the ends of the names of their joints; other joints that exist
# on both sides, such as eyes, go with the shoulders.
PARTS = ('shoulders', 'legs', 'arms')
_LEG_JOINTS = ('hip', 'knee', 'ankle', 'heel', 'toe', 'foot_index')
_ARM_JOINTS = ('elbow', 'wrist', 'hand', 'index', 'pinky', 'thumb')
# Joints whose line from the upper to the lower one shows which lower joint belongs to which shoulder, by part.
_ATTACHMENTS = {'legs': ('lshoulder', 'lhip'), 'arms': ('lshoulder', 'lelbow')}

STATES = len(engine.SWAPPED_PARTS)
_OWN_STATES = np.arange(STATES, dtype=np.int8)[:, None]


class BodySides(NamedTuple):
    """Which joints of a skeleton are left and right ones, and to which part they belong."""

    # (J,) index of each joint's counterpart on the other side; its own index for a joint without one
    mirror: NDArray[np.intp]
    part: NDArray[np.intp]  # (J,) index of each joint's part in `PARTS`; -1 for a joint without a counterpart
    # (3,) left joint from which the line to a part starts that shows left from right; -1 for none
    upper: NDArray[np.intp]
    lower: NDArray[np.intp]  # (3,) left joint of the part at which the line ends; -1 for none

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


class ViterbiPaths(NamedTuple):
    """The likeliest path to each of the eight states of the newest frame, ordered as `engine.SWAPPED_PARTS`."""

    cost: Array  # (8,) negative log likelihoods in nats, up to a common constant
    states: NDArray[np.int8]  # (8, F) states in the frames of the window
    # (8, J, 5) each joint as the path relabels it: image point and velocity (per second) when it was last seen,
    # and this time in s, -inf if it never was
    joints: Array

    @staticmethod
    def begin(sides: BodySides) -> ViterbiPaths:
        """Return the paths before the first frame."""
        joints = np.tile([0.0, 0.0, 0.0, 0.0, -np.inf], (STATES, len(sides.mirror), 1))
        return ViterbiPaths(np.zeros(STATES), np.zeros((STATES, 0), np.int8), joints)


@dataclass(eq=False)
class SwapFilter:
    """Filter that finds the parts of one person's body whose left and right are swapped; it is immutable."""

    sides: BodySides
    enabled: bool = True  # False if the detector's labels are to be believed
    # (F, 3) decisions about the parts in the frames of the window, along the likeliest path
    is_swapped: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, len(PARTS)), bool))
    # the Viterbi paths; None before the first frame, or if the filter is not enabled
    paths: ViterbiPaths | None = None

    def update(
        self, time_s: float, points: Array, weight: Array, body_size: float, dropped: int = 0
    ) -> SwapFilter:
        """Return the filter after one more frame, without its decisions about the `dropped` oldest ones.

        Points (J, 2) and scores (J,) are as the detector labelled them; `body_size` is in their units, above 0.
        """
        if not self.enabled:
            frames = len(self.is_swapped) - dropped + 1
            return SwapFilter(self.sides, False, np.zeros((frames, len(PARTS)), bool))
        cost, states, joints = self.paths or ViterbiPaths.begin(self.sides)
        frame = time_s, points, weight, body_size, *self.sides
        cost, states, joints, is_swapped = engine.continue_paths(cost, states[:, dropped:], joints, *frame)
        return SwapFilter(self.sides, True, is_swapped, ViterbiPaths(cost, states, joints))

    def convert_points(self, convert: Callable[[Array], Array]) -> SwapFilter:
        """Return the filter with its points (..., 2) converted, as to rays of another camera."""
        if self.paths is None:
            return self
        points, movement = self.paths.joints[..., :2], engine.VELOCITY_TIME_S * self.paths.joints[..., 2:4]
        converted = convert(points)
        velocity = (convert(points + movement) - converted) / engine.VELOCITY_TIME_S
        joints = np.concatenate([converted, velocity, self.paths.joints[..., 4:]], axis=-1)
        return replace(self, paths=self.paths._replace(joints=joints))


def find_swapped_parts(times: Array, points: Array, weight: Array, sides: BodySides) -> NDArray[np.bool_]:
    """Return the parts (F, 3) of the body whose left and right are swapped in the frames of a sequence.

    A frame with all its points (J, 2), in rays or px, at one position does not count.
    """
    is_swapped = np.zeros((len(times), len(PARTS)), bool)
    sizes = measure_sizes(points, weight)
    frames = np.flatnonzero(show_people(sizes)).tolist()
    if not frames:
        return is_swapped
    cost, _, joints = ViterbiPaths.begin(sides)
    predecessors = []
    for f in frames:
        frame = float(times[f]), points[f], weight[f], float(sizes[f]), *sides
        cost, states, joints, _ = engine.continue_paths(cost, _OWN_STATES, joints, *frame)
        predecessors.append(states[:, 0])
    path = [int(cost.argmin())]
    for predecessor in predecessors[:0:-1]:
        path.append(int(predecessor[path[-1]]))
    is_swapped[frames] = engine.SWAPPED_PARTS[path[::-1]]
    return is_swapped


def exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.bool_], sides: BodySides
) -> tuple[Array, Array]:
    """Return points (F, J, 2) and weights (F, J) with left and right of some parts (F, 3) exchanged."""
    return engine.exchange_sides(points, weight, is_swapped.view(np.uint8), sides.mirror, sides.part)
