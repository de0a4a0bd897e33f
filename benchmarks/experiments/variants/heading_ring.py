# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The joint solver from a ring of initial headings, beyond the closed-form cameras and their Necker reversal.

The headings R -> R Rz(angle) cover every wrong initial heading of a person who stands upright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint
from mocap_ros.solvers.joint.solver import negative_log_posterior
from mocap_ros.solvers.window import (
    InitialValues,
    Reconstruction,
    Window,
    choose_initial_values,
    reverse_depth,
)

# degrees; changes of heading that are tried after the reversal, in this order; steps of 45 cover all headings
HEADING_OFFSETS_DEG = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)


def solve_from_ring(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig, count: int
) -> tuple[Reconstruction, ...]:
    """Reconstruct each window from `count` initial cameras, 1 to 9, and return the most likely results."""
    batch: list[Window] = []
    for window in windows:
        start, unit = choose_initial_values(window, model.truncate(config.components), config.start_window)
        batch += [replace(window, start=s, unit=unit) for s in list_starts(start)[:count]]
    results = joint.solve(batch, model, config)
    groups = [results[i : i + count] for i in range(0, len(results), count)]
    return tuple(
        min(group, key=lambda r: negative_log_posterior(r, window, config))
        for group, window in zip(groups, windows, strict=True)
    )


def list_starts(start: InitialValues) -> list[InitialValues]:
    """Return the initial values, their Necker reversal, and the changed headings, all with the same weights."""
    turns = [rotation_from_vector(np.radians([0.0, 0.0, offset])) for offset in HEADING_OFFSETS_DEG]
    cameras = start.cameras
    turned = [WeakPerspectiveCameras(cameras.scale, cameras.rotation @ turn) for turn in turns]
    return [start, reverse_depth(start), *(InitialValues(start.theta, c) for c in turned)]
