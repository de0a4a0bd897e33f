# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The methods that the paper's experiments compare: the paper's own two and this project's two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import common
import numpy as np
from common import View
from panels import JUMP, RUN, WALK
from panels import PERIODIC as PERIODIC_COLOUR

from experiments.variants.sines import solve_with_sines
from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import Reconstruction

Scores = list[dict[str, float]]  # errors by the protocol, one record for each view


def choose_headings(quick: bool) -> tuple[int, ...]:
    return common.HEADINGS_DEG[1:2] if quick else common.HEADINGS_DEG


def choose_few_headings(quick: bool) -> tuple[int, ...]:
    return (45,) if quick else (0, 45, 90, 135)


@dataclass(frozen=True, eq=False)
class Method:
    """A solver with the base poses and the configuration that it has in the experiments.

    Attributes:
        name: as printed.
        colour: in the pictures.
        is_of_paper: whether the base poses are trained on the poses alone, as the paper does, and whether the
            configuration is the paper's.
        solve_views: of views, base poses and configuration.
        values: of the configuration that differ.
    """

    name: str
    colour: str
    is_of_paper: bool
    solve_views: Callable[[Sequence[View], BasePoses, SolverConfig], Sequence[Reconstruction]]
    values: Mapping[str, Any] = field(default_factory=dict)

    def configure(self, **values: Any) -> SolverConfig:
        make = common.make_paper_config if self.is_of_paper else common.make_config
        return make(**{**self.values, **values})

    def train(self, category: str, trial: str, *, own: bool = False) -> BasePoses:
        """Train base poses of a category without a trial; `own`: on the trial's subject alone."""
        only = (trial[:2],) if own else ()
        plain = self.is_of_paper and bool(category)  # those of all motions are plain in any case
        return common.train_base_poses(category, without_trials=(trial,), only_subjects=only, plain=plain)

    def solve(
        self, tests: Sequence[View], category: str, trial: str, *, own: bool = False, **values: Any
    ) -> Sequence[Reconstruction]:
        """Solve views with base poses of a category without a trial, and values of the configuration."""
        return self.solve_views(tests, self.train(category, trial, own=own), self.configure(**values))

    def score(
        self, tests: Sequence[View], category: str, trial: str, *, own: bool = False, **values: Any
    ) -> Scores:
        """Return the errors of the views; arguments as of `solve`."""
        return common.compute_all_errors(tests, self.solve(tests, category, trial, own=own, **values))


def _solve_with_sines(tests: Sequence[View], model: BasePoses, config: SolverConfig) -> Sequence[Reconstruction]:
    return solve_with_sines([v.window for v in tests], model, config)


ALGORITHM_1 = Method('Algorithm 1', WALK, True, common.solve_by_alternation)
JOINT = Method('joint', RUN, False, common.solve_jointly)
SINES = Method("the paper's sines", JUMP, True, _solve_with_sines, {'components': 4})
PERIODIC = Method('periodic', PERIODIC_COLOUR, False, common.solve_periodically)


def compute_mean_errors(tests: Sequence[View], found: Sequence[Reconstruction]) -> tuple[float, float]:
    """Return the mean 3D and 2D error in mm."""
    flat = float(np.mean([common.compute_residual_mm(v, r) for v, r in zip(tests, found, strict=True)]))
    return common.mean_error(common.compute_all_errors(tests, found)), flat
