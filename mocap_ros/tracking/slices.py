# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Work in slices whose costs are known before they are done.

The cost of a slice is counted in elements of the solver's matrix: a step over F frames with n unknowns each, with
its normal equations, costs F n^2, and `STEP_BASE` more for what does not grow with the window. It follows from the
input and is no measured time, so it is the same whenever the same work is done.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias, TypeVar

from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.solvers.stepwise import Stepwise

Result = TypeVar('Result')

# Yields the cost of the slice that the next call of `next` will do, and returns the result at its end.
Slices: TypeAlias = Generator[float, None, Result]

STEP_BASE = 4000  # elements; what a step does once for all frames takes as long as so many of them
PIECES_OF_STEP = 2  # the solvers do a step and its normal equations one after the other


def compute_piece_cost(frames: int, components: int) -> float:
    """Return the cost of a piece of a step of the joint solver.

    Args:
        frames: number of frames of its window.
        components: number of base poses.
    """
    return (STEP_BASE + frames * (components + CAMERA_UNKNOWNS) ** 2) / PIECES_OF_STEP


def do_in_slices(work: Stepwise[Result], cost: float) -> Slices[Result]:
    """Do the pieces of stepwise work as slices, and return its result.

    Args:
        work: the work.
        cost: cost of each piece.
    """
    while True:
        yield cost
        try:
            next(work)
        except StopIteration as end:
            return end.value


def finish_slices(slices: Slices[Result]) -> Result:
    """Do all slices at once, and return the result."""
    try:
        while True:
            next(slices)
    except StopIteration as end:
        return end.value
