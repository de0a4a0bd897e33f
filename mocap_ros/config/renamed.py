# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters that were renamed or removed since version 0.1, so that its recordings can still be replayed."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_ros.config.defaults import Value
from mocap_ros.errors import ConfigError

# Name of the parameter now, by its name in version 0.1.
RENAMED_SINCE_0_1 = {
    'solver.lifted_weight': 'solver.lifter_weight',
    'solver.lifted_robust': 'solver.lifter_robust_scale',
    'solver.lifted_prior': 'solver.lifter_prior_factor',
    'solver.lifted_turn': 'solver.lifter_flip_factor',
    'solver.lifted_smooth': 'solver.lifter_smooth_factor',
    'solver.upright_prior': 'solver.heading_prior_factor',
    'solver.upright_turn': 'solver.heading_flip_factor',
    'solver.upright_hypotheses': 'solver.heading_hypotheses',
    'solver.gait_prior': 'solver.periodic_prior_factor',
    'solver.drift_weight': 'solver.camera_velocity_weight',
    'solver.steady_weight': 'solver.camera_acceleration_weight',
    'tracker.refine': 'tracker.refine_seconds',
    'tracker.challenge_every': 'tracker.hypothesis_check_interval',
    'keyframes.largest': 'keyframes.max_matrix_frames',
    'keyframes.own_share': 'keyframes.frame_pose_share',
}


# Default in version 0.1 of each parameter that was removed. They selected variants of the papers' experiments.
REMOVED_SINCE_0_1: dict[str, Value] = {
    'solver.norm': 'squared',
    'solver.paper_sines': False,
    'solver.relative_bones': False,
}
# Where these variants are now, in the repository.
VARIANTS_FOLDER = 'benchmarks/experiments/variants'


def current_names(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return the values by today's parameter names; the given names may be those of version 0.1.

    A removed parameter is left out if it has its default of version 0.1, which is what the package still does.

    Raises:
        ConfigError: a removed parameter has another value.
    """
    for name, default in REMOVED_SINCE_0_1.items():
        if values.get(name, default) != default:
            raise ConfigError(f'{name} = {values[name]!r}: {describe_removal(name)}')
    return {
        RENAMED_SINCE_0_1.get(name, name): value for name, value in values.items() if name not in REMOVED_SINCE_0_1
    }


def describe_removal(name: str) -> str:
    """Return a clause, for an error message, about where the variants of a removed parameter are now."""
    default = REMOVED_SINCE_0_1[name]
    return f'version 0.2 removed it and computes as with {default!r}; the other variant is in {VARIANTS_FOLDER}'
