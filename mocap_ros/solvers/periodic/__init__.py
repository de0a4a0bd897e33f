# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The periodic model: base-pose weights as Fourier series of time (TPAMI 2016, section 3.3)."""

from mocap_ros.solvers.periodic.solver import EstimatedPoses, PeriodicReconstruction, solve, solve_stepwise

__all__ = ['EstimatedPoses', 'PeriodicReconstruction', 'solve', 'solve_stepwise']
