# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Levenberg-Marquardt over a batch: every sequence has its own damping and its own end, and all step together.

A step x solves (A + mu diag(A)) x = -g. It is taken where it lowers the objective of its sequence, whose damping
mu is then divided by five; elsewhere it is multiplied by ten and the step is tried again.

Solvers can be interrupted: a stepwise function is a generator, which yields None after each piece of its work (one
step, or something that takes about as long) and returns the result at its end.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol, TypeAlias, TypeVar

import numpy as np

from mocap_ros.arrays import Array

Result = TypeVar('Result')

Stepwise: TypeAlias = Generator[None, None, Result]


class Problem(Protocol):
    """What is minimised: one objective for each of P sequences, which have no unknowns in common, and a point."""

    @property
    def cost(self) -> Array:
        """Objectives (P,) at the current point."""

    def begin(self, damping: float) -> None:
        """Set the damping of the first step of all sequences, and compute the normal equations."""

    def update_equations(self) -> None:
        """Compute the normal equations of the sequences that have moved and are not done."""

    def try_steps(self, tolerance: float) -> tuple[int, int]:
        """Try a step of each sequence; return how many were taken, and how many sequences are not done.

        A step that lowers an objective by a share of `tolerance` or less is the last of its sequence.
        """


def minimise_stepwise(problem: Problem, max_iterations: int, tolerance: float, damping: float) -> Stepwise[Array]:
    """Minimise the objectives from the current point, in pieces: a step is one, its normal equations the next.

    Returns objectives (I + 1, P) at the start and after each step that was tried.
    """
    problem.begin(damping)
    history, is_outdated = [problem.cost.copy()], False
    for _ in range(max_iterations):
        yield
        if is_outdated:
            problem.update_equations()
            yield
        taken, remaining = problem.try_steps(tolerance)
        history.append(problem.cost.copy())
        if not remaining:
            break
        is_outdated = taken > 0
    return np.array(history)


def run_to_end(work: Stepwise[Result]) -> Result:
    """Do all pieces of the work, and return its result."""
    try:
        while True:
            next(work)
    except StopIteration as end:
        return end.value
