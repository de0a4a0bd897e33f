# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The unknowns of the periodic model, and what follows from them for the terms of its objective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers.joint.state import Fit, State
from mocap_ros.solvers.periodic.fourier import FourierSeries

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """Values of the unknowns of a window of N frames.

    Attributes:
        series: Fourier series of the weights and the heading.
        cameras: cameras C_t without the heading, with no weights: theta is (N, 0).
        fit: what the terms of the joint solver measure, with the weights and the heading of the series.
    """

    series: FourierSeries
    cameras: State
    fit: Fit


def make_body_state(series: FourierSeries, cameras: State, times: Array) -> State:
    """Return the state of the body at times (N,) s: weights theta_t and rotations C_t Rz(psi_t)."""
    values = series.evaluate(times)
    rotation = cameras.rotation @ rotations_about_vertical(values[:, -1])
    return State(values[:, :-1], rotation, cameras.log_scale, cameras.translation)


def rotations_about_vertical(angle: Array) -> Array:
    """Return the rotations (N, 3, 3) of the body about its vertical axis (z) by angles (N,) in rad."""
    out = np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angle)
    out[:, 1, 0] = np.sin(angle)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out
