# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The non-periodic model, solved jointly for cameras and base-pose weights (TPAMI 2016, section 3.4)."""

from mocap_ros.solvers.joint.sections import solve_in_sections
from mocap_ros.solvers.joint.solver import (
    JointReconstruction,
    solve,
    solve_hypotheses,
    solve_hypotheses_stepwise,
    solve_stepwise,
)

__all__ = [
    'JointReconstruction',
    'solve',
    'solve_hypotheses',
    'solve_hypotheses_stepwise',
    'solve_in_sections',
    'solve_stepwise',
]
