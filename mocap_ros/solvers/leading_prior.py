# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which prior leads in the joint objective: the lifted poses or the base poses.

The lifter knows people in general, and base poses may be those of this very person. Then the lifted poses, whose
errors last for seconds and are alike in many joints, draw the solution away from better poses. So base poses that
are not those of all motions may lead: they have the weights that they have without a lifter, and the lifted poses
`LIFTER_SHARE` of theirs, which still tells front from back. They lead where they explain the image as well as
under the lead of the lifted poses:

    (n_b^2 + n_0^2)^(1/2) <= MAX_NOISE_RATIO (n_l^2 + n_0^2)^(1/2)    and    n_b <= MAX_NOISE

n_b and n_l are the image noise of the two solutions, estimated from their residuals (`joint.noise_estimate`), and
n_0 is `NEGLIGIBLE_NOISE`. Base poses that do not suit the person or the motion keep, at full weight, the solution
away from the image, and then n_b is larger. The base poses of all motions can explain nearly every image, so for
them the comparison says little, and the lifted poses lead.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import ALL_MOTIONS

# The constants were chosen on people whom neither the lifter nor the general base poses were trained on
# (docs/method.md, "Base poses of your own").
LIFTER_SHARE = 0.1  # share of `lifter_weight` that the lifted poses keep where the base poses lead
MAX_NOISE_RATIO = 1.05  # residuals of base poses that fit a person are at most so much larger where they lead
NEGLIGIBLE_NOISE = 0.003  # m; below it, base poses of a person differ from the person more than the points do
MAX_NOISE = 0.03  # m; base poses that leave more have not been shown to be the person's, whoever leads


def can_base_poses_lead(name: str) -> bool:
    """Return whether base poses of this name may lead, for they are not those of all motions."""
    return name != ALL_MOTIONS


def let_base_poses_lead(config: SolverConfig) -> SolverConfig:
    """Return the parameters of the joint solver with which base poses lead."""
    return replace(
        config,
        lifter_weight=LIFTER_SHARE * config.lifter_weight,
        lifter_prior_factor=1.0,
        lifter_flip_factor=1.0,
        lifter_smooth_factor=1.0,
    )


def explains_as_well(noise: float, lifter_noise: float, slack: float = 1.0) -> bool:
    """Return whether base poses in the lead explain the image as well as lifted poses in the lead.

    Args:
        noise: m, estimated image noise where the base poses lead.
        lifter_noise: m, the same where the lifted poses lead.
        slack: factor on the limits.
    """
    ratio = math.hypot(noise, NEGLIGIBLE_NOISE) / math.hypot(lifter_noise, NEGLIGIBLE_NOISE)
    return noise <= slack * MAX_NOISE and ratio <= slack * MAX_NOISE_RATIO
