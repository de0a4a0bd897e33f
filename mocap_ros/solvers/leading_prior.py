# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which prior has its full weight in the joint objective: the lifted poses or the base poses, which then lead.

Base poses may be those of this very person, and the errors of lifted poses last for seconds. So base poses other
than those of all motions may lead, with the weights that they have alone and `LIFTER_SHARE` of that of the lifted
poses, which still separates front from back. They do where they explain the image as well,

    (n_b^2 + n_0^2)^(1/2) <= MAX_NOISE_RATIO (n_l^2 + n_0^2)^(1/2)    and    n_b <= MAX_NOISE

with n_b and n_l the misfit where base poses or lifted poses lead, and n_0 = `NEGLIGIBLE_NOISE`.
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
        lifter_acceleration_factor=1.0,
    )


def explains_as_well(misfit: float, lifter_misfit: float, slack: float = 1.0) -> bool:
    """Return whether base poses explain the image as well, by misfits in m; `slack` widens the limits."""
    ratio = math.hypot(misfit, NEGLIGIBLE_NOISE) / math.hypot(lifter_misfit, NEGLIGIBLE_NOISE)
    return misfit <= slack * MAX_NOISE and ratio <= slack * MAX_NOISE_RATIO
