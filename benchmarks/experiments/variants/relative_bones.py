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

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.noise_annealing import COLD_DAMPING
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.solver import make_reconstruction
from mocap_ros.solvers.levenberg_marquardt import minimise_stepwise
from mocap_ros.solvers.stepwise import run_to_end
from mocap_ros.solvers.window import Reconstruction, SolverStatus, Window, choose_initial_values


def solve_with_relative_bones(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    """Reconstruct a window as `joint.solve` does, but with relative bones and no estimate of the image noise."""
    model = model.truncate(config.components)
    start, unit = choose_initial_values(window, model, config.start_window)
    units = np.array([unit])
    batch = Batch.build([window], units, model)
    objective = use_relative_bones(JointObjective.build(batch, model, config))
    problem = objective.compile(batch.initial_state([start], units), settle_steps=2)
    descent = minimise_stepwise(problem, config.max_iterations, config.tolerance, COLD_DAMPING)
    history = [float(cost[0]) for cost in run_to_end(descent)]
    status, iterations = SolverStatus(problem.status[0]), int(problem.iterations[0])
    return make_reconstruction(problem, batch, window, unit, status, history, iterations)


def use_relative_bones(objective: JointObjective) -> JointObjective:
    """Return the objective with the weight of each bone divided by the square of its relative length."""
    lengths = objective.model.skeleton.bone_lengths(objective.model.mean)
    return replace(objective, bone_weight=objective.bone_weight * (lengths.mean() / lengths) ** 2)
