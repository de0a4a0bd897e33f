# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vertical of a camera, and lifted poses turned towards it.

How far a body leans along the line of sight hardly shows, so lifted poses lean to and fro. Each pose shows a
direction upwards u (`models.upward_direction`); the vertical v of a camera is their robust mean over people and
some time:

    v_t = normalise(sum_i max(p_i, L) k_i u_i),    k_i = exp(-|t - t_i| / T) dt_i / (1 + (angle(u_i, v) / A)^2)
    s_v^2 = min((B^2 sum_i p_i dt_i + S^2) / sum_i p_i k_i, MAX_STD_DEG^2) + max(angle(v_t, v_0) - A_0, 0)^2

with p_i the share to which the pose stands and dt_i the time since the frame before. Live, the sums are over the
frames up to t, each with the v that was known then. In a whole sequence the same goes forwards and backwards, and
both sums are added: on 21 views that is 6.0 degrees off in the mean; sums with one v for all frames are 6.2 off.
Who lies or stands on the hands has straight hips as well, and cameras are mostly level:
p_i is multiplied by a share that falls from 1 to 0 as the angle from u_i to -y grows from `LEVEL_DEG`[0] to [1].
It is also multiplied by the share to which hips and knees are seen, for inferred legs nearly always stand.
Part of the error of a direction lasts, for it is that of a body, B; the rest is another one after a second. Both
count more where poses disagree. Who reclines looks like one who stands before a camera that looks far down, A_0.

The lifter errs towards the cameras that it knows: of one that looks down by theta, lifted poses show 0.85 theta
and 1 degree, as least squares demand. With v_0 the vertical of a level camera that looks down a little, half of
that is undone in y and z, before all that follows: v_t <- normalise(v_t + K (v_t - v_0)). The errors of bodies
would grow by more than that of the lifter falls if all of it was undone.

Where hardly anybody stands, the likeliest vertical is v_0: with n the seconds in which people are seen and m those
in which people stand, by the same weights,

    v = normalise((1 - r) v_t + r v_0),    r = clip((n - m / STANDING_SHARE) / n, 0, 1)
    s = (1 - r) s_v + r (MAX_STD_DEG + q (ASKEW_STD_DEG - MAX_STD_DEG))

with q the share of n in which people have straight hips, but not upright in the image: they lie, or the camera is
on its side; 1 where the image was turned (`solvers.image_roll`), for who lies may have looked like people before a
camera that is upside down. There -y becomes y in all of this.

Each lifted pose y is then turned about the horizontal axis of its virtual camera, as the probabilities demand:

    y' = R_x(p g phi / (1 + (phi / C)^2)) y,    g = s_y^2 / (s_y^2 + s_u^2 + s_v^2)

with a p that falls to 0 with the angle between u and v as above, for who lies does not lean.
s_y = KAPPA sigma_z / r is the standard deviation of the lean of a lifted pose of radius r and depths sigma_z, and
s_u that of the angle from u to the vertical in true poses. The lifter gets a vertical that is given as well, to
the share of `models.upward_direction` alone, also of who lies, but none that was found, which rests on its own
poses and makes left-out persons 1 mm worse (the turns: 0.3 better).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig, parse_numbers
from mocap_ros.engine import vertical as engine
from mocap_ros.errors import ConfigError
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.upward_direction import Stances
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.observed_window import RAY_FOCAL
from mocap_ros.units import NS_PER_S

AUTO, NONE = 'auto', 'none'  # values of `tracker.vertical` besides three numbers
# Constants of the formulas above; angles in degrees. All were measured on training persons seen by the protocol's
# detectors from elevations of 0 to 32 degrees.
MEMORY_S = 20.0  # s; T: long for people who turn about, short enough for a camera that is moved
BODY_STD_DEG = 4.0  # B: of the directions that all poses of a person show
SECOND_STD_DEG = 4.0  # S: besides, of the mean direction of a second
SHRINKAGE = 0.08  # 1; K
USUAL_DEG = 30.0  # A_0: between v_0 and the verticals of nearly all cameras
MAX_STD_DEG = 12.0  # of v_0: that of cameras before people who sit all the time
GIVEN_STD_DEG = 1.0  # s_v of a vertical that is given: that of a spirit level or an accelerometer at rest
LEVEL_DEG = 50.0, 60.0  # between up in the image of a level camera and who stands: cameras look down by up to 45
LEVEL_PITCH_DEG = 10.0  # by which v_0 looks down, as robots and tripods do; roll and pitch differ by some 10
STANDING_SHARE = 0.1  # 1; of the time; who stands for less of it still shows more than v_0 does
ASKEW_STD_DEG = 45.0  # half of the quarter of a turn by which v_0 is wrong if the camera is on its side
OUTLIER_DEG = 10.0  # A: who lies or tumbles does not show the vertical
MIN_STANDING = 0.02  # L: where no person stands, a vertical is better than none
WAYS = slice(None), slice(None, None, -1)  # forwards and backwards
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
MAX_PITCH_DEG = 90.0  # degrees; of a camera that looks straight down
UNIT_TOLERANCE = 0.01  # 1; difference of a given direction's length from 1 that rounding may cause


class Sums(NamedTuple):
    """Seconds of people, those of long ago counting less."""

    weight: float = 0.0  # sum of max(p, L) k
    certain: float = 0.0  # sum of p k
    seen: float = 0.0  # n
    standing: float = 0.0  # m
    askew: float = 0.0  # q n


NO_SUMS = Sums()


def _judge(found: Array, sums: Array, sign: float, *, is_turned: bool) -> tuple[Array, Array]:
    """Return directions (N, 3) and their standard deviations (N,) in rad (formulas of this module).

    Args:
        found: (N, 3) v_t, of any length.
        sums: (N, 5) s, the `Sums`.
        sign: 1, or -1 for a camera that is upside down.
        is_turned: whether the image was turned, so that q is 1.
    """
    return engine.judge(
        found,
        sums,
        sign,
        is_turned,
        LEVEL_PITCH_DEG,
        SHRINKAGE,
        STANDING_SHARE,
        USUAL_DEG,
        BODY_STD_DEG,
        SECOND_STD_DEG,
        MAX_STD_DEG,
        ASKEW_STD_DEG,
    )


@dataclass(eq=False)
class Vertical:
    """What is known of the vertical of a camera; it is immutable, and `advance` returns a new one.

    Attributes:
        direction: (3,) unit vector upwards in the camera's optical frame.
        std: rad, standard deviation of the direction.
        is_given: whether the direction was given, so that it owes nothing to lifted poses.
        stamp_ns: ns, stamp of the newest frame that it rests on.
        found: (3,) the direction that people show alone.
        sums: s, what people have been seen to do.
        sign: 1, or -1 where the camera is upside down.
    """

    direction: Array
    std: float
    is_given: bool = False
    stamp_ns: int = 0
    found: Array = field(default_factory=lambda: np.full(3, np.nan))
    sums: Sums = NO_SUMS
    sign: float = 1.0

    @staticmethod
    def give(direction: Array, stamp_ns: int = 0, std: float = 0.0) -> Vertical:
        """Return a vertical that is given, (3,) unit vector, with a standard deviation in rad if that is known."""
        return Vertical(direction, max(std, math.radians(GIVEN_STD_DEG)), True, stamp_ns)

    @staticmethod
    def begin(stamp_ns: int, stances: Stances, sign: float = 1.0) -> Vertical:
        """Return the vertical that the first poses show; the arguments are those of `advance`."""
        total = stances.upward.sum(axis=0)
        found = total / max(float(np.linalg.norm(total)), 1e-9)
        begun = Vertical(found, 0.0, False, stamp_ns, found, sign=sign).advance(stamp_ns + 1, stances, sign)
        return replace(begun, stamp_ns=stamp_ns, found=found, sums=begun.sums._replace(weight=0.0, certain=0.0))

    def advance(self, stamp_ns: int, stances: Stances, sign: float = 1.0) -> Vertical:
        """Return the vertical after another frame.

        Args:
            stamp_ns: ns, stamp of the frame, later than those before.
            stances: what the poses of its P >= 0 people show, directions in the camera's optical frame; finite.
            sign: 1, or -1 where the camera is upside down.
        """
        if self.is_given:
            return self
        if sign != self.sign:
            return Vertical.begin(stamp_ns, stances, sign)
        age_s = (stamp_ns - self.stamp_ns) / NS_PER_S
        faded, step_s = math.exp(-age_s / MEMORY_S), min(age_s, MAX_STEP_S)
        found, *seconds = engine.add_frame(
            self.found, self.sums, faded, step_s, sign, *LEVEL_DEG, OUTLIER_DEG, MIN_STANDING, *stances
        )
        is_turned = self.sign < 0
        (direction,), (std,) = _judge(found[None], np.array([seconds]), self.sign, is_turned=is_turned)
        return Vertical(direction, float(std), False, stamp_ns, found, Sums(*seconds), self.sign)

    def forget(self) -> Vertical | None:
        """Return what is left when the camera may have changed: a vertical that was given."""
        return self if self.is_given else None


def read_given_vertical(config: TrackerConfig) -> Vertical | None:
    """Return the vertical that `tracker.vertical` gives; None where it is to be found, or not to be used.

    Raises:
        ConfigError: The parameter is neither a word that it may be nor a pitch nor a unit vector of three numbers.
    """
    text = config.vertical
    if text in (AUTO, NONE):
        return None
    direction = np.array(parse_numbers(text))
    if direction.shape == (1,) and abs(direction[0]) <= MAX_PITCH_DEG:
        pitch = math.radians(float(direction[0]))
        direction = np.array([0.0, -math.cos(pitch), -math.sin(pitch)])
    if direction.shape != (3,) or not abs(float(np.linalg.norm(direction)) - 1) <= UNIT_TOLERANCE:
        raise ConfigError(
            f'tracker.vertical = {text!r}: expected auto, none, the degrees by which the camera looks down, or a '
            "unit vector upwards in its optical frame, such as '0 -1 0' of a level camera"
        )
    return Vertical.give(direction / np.linalg.norm(direction))


def lift_under_vertical(
    lifter: Lifter, points: Array, weight: Array, vertical: tuple[Array, Array] | None
) -> LiftedPoses:
    """Lift histories (N, T, J, 2) of rays, with scores (N, T, J), also under a vertical that is given.

    The vertical (N, 3) in the axes of the points, with its standard deviation (N,) rad, counts to the share to
    which the poses without it stand.
    """
    lifted = lifter.lift(points, weight, RAY_FOCAL)
    if vertical is None:
        return lifted
    under = lifter.lift(points, weight, RAY_FOCAL, *vertical)
    share = Stances.of(lifted.joints).standing[:, None, None]
    return LiftedPoses(
        lifted.joints + share * (under.joints - lifted.joints), lifted.std + share * (under.std - lifted.std)
    )


def turn_towards_vertical(
    lifted: LiftedPoses, stances: Stances, cameras: Array, vertical: Array, std: Array
) -> LiftedPoses:
    """Return lifted poses turned towards the vertical (formulas of this module).

    Args:
        lifted: poses of N frames in the axes of their virtual cameras, NaN where they are not known.
        stances: what they show, in the axes of the real camera.
        cameras: (N, 3, 3) rotations from these axes to the virtual cameras'.
        vertical: (N, 3), or (1, 3) for all, vertical in the axes of the real camera.
        std: (N,) or (1,) rad, its standard deviation.
    """
    turned = engine.turn_poses(
        lifted.joints,
        lifted.std,
        cameras,
        stances.upward,
        stances.standing * stances.seen,
        np.ascontiguousarray(vertical),
        std,
        CORE_COUNT,
        *LEVEL_DEG,
    )
    return LiftedPoses(turned, lifted.std)


def find_vertical(times: Array, stances: Stances, *, is_turned: bool = False) -> tuple[Array, Array]:
    """Return the vertical of a whole sequence, found from all its frames.

    Args:
        times: (F,) s, increasing.
        stances: what the F poses of one person show, in the optical frame of the camera, turned by
            `image_roll.find_camera_roll`; NaN where there is none.
        is_turned: whether that turned the camera.

    Returns:
        (F, 3) unit vectors and (F,) rad, their standard deviations; NaN where no frame has a pose.
    """
    known = np.asarray(np.isfinite(stances.upward).all(axis=1))
    if not known.any():
        return np.full(stances.upward.shape, np.nan), np.full(len(times), np.nan)
    ahead, back = (_follow(times[way], Stances(*(values[way] for values in stances)))[way] for way in WAYS)
    found, sums = np.split(ahead + back, [3], axis=1)
    return _judge(np.ascontiguousarray(found), np.ascontiguousarray(sums), 1.0, is_turned=is_turned)


def _follow(times: Array, stances: Stances) -> Array:
    """Return the direction times its weight, and the `Sums`, of the frames up to each one (F, 8)."""
    totals, vertical = np.zeros((len(times), 3 + len(NO_SUMS))), None
    known = np.isfinite(stances.upward[:, 0]).tolist()
    for frame, seconds in enumerate(np.abs(times - times[0]).tolist()):
        if known[frame]:
            own, stamp_ns = Stances(*(values[frame : frame + 1] for values in stances)), round(seconds * NS_PER_S)
            vertical = Vertical.begin(stamp_ns, own) if vertical is None else vertical.advance(stamp_ns, own)
        if vertical is not None:
            totals[frame] = *(vertical.sums.weight * vertical.found), *vertical.sums
    return totals
