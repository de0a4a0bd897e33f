"""Parameters whose name changed since version 0.1, so that recordings of version 0.1 can still be replayed."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_ros.config.defaults import Value

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


def current_names(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return the values by today's parameter names; the given names may be those of version 0.1."""
    return {RENAMED_SINCE_0_1.get(name, name): value for name, value in values.items()}
