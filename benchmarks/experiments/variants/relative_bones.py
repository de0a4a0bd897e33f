# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The bone-length term with the variance of each bone relative to its length, which the paper also tried.

    beta sum_tb (l / l_b)^2 (l_tb - m_b)^2

with l_tb the length of bone b in frame t, m_b its mean over the sequence, l_b its length in the mean pose, and l
the mean of the l_b, which keeps beta comparable.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mocap_ros.solvers.joint.problem import JointProblem

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.noise_annealing import COLD_DAMPING
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.solver import make_reconstruction
from mocap_ros.solvers.levenberg_marquardt import minimise
from mocap_ros.solvers.window import Reconstruction, SolverStatus, Window, choose_initial_values


def solve_with_relative_bones(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    """Reconstruct a window as `joint.solve` does, but with relative bones and no estimate of the image noise."""
    model = model.truncate(config.components)
    start, unit = choose_initial_values(window, model, config.start_window)
    units = np.array([unit])
    objective = use_relative_bones(JointObjective.build([window], units, model, config))
    fit = objective.with_optimal_translation(objective.initial_state([start], units))
    fit = objective.with_optimal_translation(fit.state)
    descent = minimise(JointProblem(objective), fit, config.max_iterations, config.tolerance, COLD_DAMPING)
    history = [float(cost[0]) for cost in descent.history]
    status, iterations = SolverStatus(descent.status[0]), int(descent.iterations[0])
    return make_reconstruction(window, unit, descent.point, status, history, iterations)


def use_relative_bones(objective: JointObjective) -> JointObjective:
    """Return the objective with the weight of each bone divided by the square of its relative length."""
    lengths = objective.model.skeleton.bone_lengths(objective.model.mean)
    bones = replace(objective.bones, weight=objective.bones.weight * (lengths.mean() / lengths) ** 2)
    terms = tuple(bones if term is objective.bones else term for term in objective.terms)
    return replace(objective, bones=bones, terms=terms)
