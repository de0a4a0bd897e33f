# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How large a person is and so how far away, and what is known of it: from the body height, and from the floor.

One camera sees the same image of a large person far away and of a small one near by. The true body is r times as
large as the assumed one and r times as far away; at first ln r has the variance s_0^2 = s_height^2 + s_pose^2 of
body heights and of the reconstruction, s_pose = H h with the share h of the body that is hidden in depth. Where
the floor is known, by the direction upwards u and the height c of the camera, the lower ankle, found at a, is f b
over it, with b the assumed body height and f the share of an ankle:

    c + r u.a = r f b,    x = ln r = ln c - ln(f b - u.a)
    s_x^2 = s_noise^2 + s_floor^2,    s_noise = F / c,    s_floor^2 = (G / c)^2 + (T d / c)^2

with d the horizontal distance, T the standard deviation of the vertical and G what ankles are higher or lower. The
x of frames in which the lower foot neither rises nor sinks are averaged, robustly; frames within C count as one:

    n = sum_i k_i / C,    m = sum_i k_i x_i / sum_i k_i,    k_i = dt_i / (1 + ((x_i - m_i) / (2 s_x))^2)
    s_m^2 = s_noise^2 / (n + 1) + s_floor^2,    g = s_0^2 / (s_0^2 + s_m^2)
    ln r = x_0 + g (m - x_0),    s^2 = min(Q^2 g s_m^2, s_0^2)

with x_0 = 0, or the logarithm of a height that is known of the person, over the assumed one. The covariance of the
root is the sum of five parts:

    C = std^2 (I / 6 + u u^T / 2)  of the hips about the body's origin (`models/joint_std.py`)
        + noise^2 I                of the image, for a detector puts both hips off the same way
        + (s d)^2 u u^T            of the size, along the line of sight u, at the distance d
        + (t z)^2 e e^T            of the focal length (relative deviation t), along the optical axis e, at depth z
        + c c^T                    of inertia and standing feet, which displace the body by c (`solvers.footing`)

The std of an inferred hip is multiplied by J / J_seen: of the J joints of the core, whose mean is the body's
origin, only those that are seen say where it is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.errors import ConfigError
from mocap_ros.geometry.level import Floor
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.floor import FOCAL_SHARE, POSE_SHARE, SIZE_RANGE
from mocap_ros.units import NS_PER_S

KNOWN_HEIGHT_STD_M = 0.02  # m; of a height that a user stated, shoes and posture included
HEIGHT_RANGE_M = 0.3, 2.6  # m; range of body heights, as of `tracker.body_height`
ANKLE_SHARE = 0.042  # 1; f, share of the body height: 0.03 to 0.055 in motion capture, more in a walk
NOISE_M = 0.04  # m; F, of an ankle's height over the floor from image noise and heels that rise
GROUND_M = 0.04  # m; G, by which ankles, shoes and carpets differ, and detectors put ankles elsewhere
FLOOR_FACTOR = 1.7  # 1; Q, so that 95 of 100 roots of training persons are within the ellipsoids
SCALE_NOISE = 0.03  # 1; s_noise of depths, by the scale of a solution, which wanders
LASTING_M = 0.03  # m; s_floor of depths, by surfaces, clothes and the depth camera
CORRELATION_S = 0.5  # s; C, as long as a step lasts
MAX_RISE_M_S = 0.3  # m/s; of a foot that stands; depth jitters, and lets standing feet rise and sink a little
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
LEAST, LARGEST = map(math.log, SIZE_RANGE)  # range of ln r
MIN_DROP_SHARE = 0.1  # of the camera's height; a foot that seems higher than this below the camera shows nothing
FORGOTTEN_COMMA = re.compile(r'=\s*[\d.]+[\s;]')  # in what should be an id: a height is in it
# 1; H, so that 96 of 100 roots of training persons of known height are within the ellipsoids of 95: rather too
# wide than too narrow
HIDDEN_FACTOR = 1.8
MIN_HIDDEN_SHARE = 1e-6  # 1; less is rounding: without a lifter nothing says what is hidden
ANKLES = CMU15.index('lankle'), CMU15.index('rankle')


class BodySize(NamedTuple):
    """A person's size, and how certain it and so the distance is."""

    ratio: float  # r, of the true size to the assumed
    share: float  # standard deviation of the size and of the distance, as a share of them
    focal_share: float = 0.0  # that of the focal length and so of the depth


@dataclass(frozen=True)
class SizeEvidence:
    """What feet on the floor, or measured depths, say of a person's size; what adds a frame returns a new one."""

    mean: float  # 1, the m of the module: mean of ln r
    seconds: float  # s, for how long it was seen, frames that are discounted counting less
    noise: float
    lasting: float  # 1; s_floor, or that of measured depths
    stamp_ns: int  # ns, stamp of the newest frame

    @staticmethod
    def add_floor(
        before: SizeEvidence | None,
        stamp_ns: int,
        joints: Array,
        velocity: Array,
        scores: Array,
        floor: Floor,
        body_height: float,
    ) -> SizeEvidence | None:
        """Return what is known after another frame, of joints (J, 3) m of a person of the assumed size.

        Where the lower ankle was not seen, by the scores (J,), that is what was known before.
        """
        ankles, height = joints[list(ANKLES)], floor.camera_height
        if height is None:
            return before
        drops = -(ankles @ floor.upward)
        lower = int(np.argmax(drops))
        drop, ankle = float(drops[lower]), ankles[lower]
        rise = float(velocity[ANKLES[lower]] @ floor.upward)
        is_seen = bool(scores[ANKLES[lower]] > 0)
        if not (is_seen and drop > MIN_DROP_SHARE * height and abs(rise) < MAX_RISE_M_S):
            return before
        found = math.log(height / (ANKLE_SHARE * body_height + drop))
        distance = math.sqrt(max(float(ankle @ ankle) - drop * drop, 0.0)) * math.exp(found)
        lasting = math.hypot(GROUND_M, floor.tilt_std * distance) / height
        return SizeEvidence._add(before, stamp_ns, found, NOISE_M / height, lasting)

    @staticmethod
    def add_depth(
        before: SizeEvidence | None, stamp_ns: int, log_size: float, distance: float
    ) -> SizeEvidence | None:
        """Return what is known after another frame, whose depths show ln r of a person at a distance in m."""
        return SizeEvidence._add(before, stamp_ns, log_size, SCALE_NOISE, LASTING_M / distance)

    @staticmethod
    def _add(
        before: SizeEvidence | None, stamp_ns: int, found: float, noise: float, lasting: float
    ) -> SizeEvidence | None:
        if not LEAST < found < LARGEST:
            return before
        if before is None:
            return SizeEvidence(found, 0.0, noise, lasting, stamp_ns)
        if stamp_ns <= before.stamp_ns:  # with a lag, this frame was shown before
            return before
        step = min((stamp_ns - before.stamp_ns) / NS_PER_S, MAX_STEP_S)
        off = (found - before.mean) / (2 * math.hypot(noise, lasting))
        weight = step / (1 + off * off)
        seconds = before.seconds + weight
        mean = before.mean + (found - before.mean) * weight / max(seconds, step)
        return SizeEvidence(mean, seconds, noise, lasting, stamp_ns)

    def find_size(self, prior: BodySize) -> BodySize:
        """Return the size that this and what is known besides show together."""
        own = self.noise**2 / (self.seconds / CORRELATION_S + 1) + self.lasting**2
        gain = prior.share**2 / (prior.share**2 + own)
        before = math.log(prior.ratio)
        share = min(FLOOR_FACTOR * math.sqrt(gain * own), prior.share)
        return BodySize(math.exp(before + gain * (self.mean - before)), share, prior.focal_share)


@lru_cache(maxsize=10)
def read_body_heights(text: str) -> Mapping[str, float]:
    """Return the body heights in m, by id, that `tracker.body_heights` gives, or raise a `ConfigError`."""
    heights: dict[str, float] = {}
    for part in filter(str.strip, text.split(',')):
        person_id, sign, number = (word.strip() for word in part.rpartition('='))
        try:
            height = float(number)
        except ValueError:
            height = math.nan
        is_one = sign and person_id and not FORGOTTEN_COMMA.search(person_id)
        if not (is_one and HEIGHT_RANGE_M[0] <= height <= HEIGHT_RANGE_M[1]):
            raise ConfigError(
                f'tracker.body_heights: {part.strip()!r}: expected an id and a height of {HEIGHT_RANGE_M[0]:g} to '
                f'{HEIGHT_RANGE_M[1]:g} m, such as 7=1.82, with commas between them'
            )
        if person_id in heights:
            raise ConfigError(f'tracker.body_heights: {person_id!r} has two heights')
        heights[person_id] = height
    return heights


def assume_size(
    config: TrackerConfig, person_id: str = '', is_focal_known: bool = True, hidden_share: float = 0.0
) -> BodySize:
    """Return what is known of a person's size before anything is seen: s_0 of the module, and the ratio of x_0.

    `hidden_share` is that of `TrackSolution`; below `MIN_HIDDEN_SHARE` it counts as not known.
    """
    height, std = read_body_heights(config.body_heights).get(person_id), KNOWN_HEIGHT_STD_M
    if height is None:
        height, std = config.body_height, config.body_height_std
    pose = HIDDEN_FACTOR * hidden_share if hidden_share > MIN_HIDDEN_SHARE else POSE_SHARE
    share = math.hypot(std / height, pose)
    return BodySize(height / config.body_height, share, 0.0 if is_focal_known else FOCAL_SHARE)
