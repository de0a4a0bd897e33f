# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Table 1 of TPAMI 2016 with methods of others, for fixed, orbiting and shaken cameras.

The others are in `rivals.py`. Each has a grid of settings; for each motion and camera the table shows the errors,
mean over the headings, of the setting that has the smallest error on two of the views. The views, the splits and
the rows of this project and of Algorithm 1 are those of `paper.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product
from typing import Any

import common
import numpy as np
import paper
import rivals
from common import View
from numpy.typing import NDArray
from paper import ALGORITHM_1, CAMERAS, JOINT, PERIODIC, TABLE_1_TRIALS, Method
from report import Report, run
from scipy.cluster.vq import kmeans2

from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation
from mocap_ros.training.fit_base_poses import align_to_mean

Array = NDArray[np.float64]
# Image points of the views of one case to its poses (F, 15, 3) in the camera's optical frame, one array a view.
Solver = Callable[['Case'], Sequence[Array]]

CHOICE_HEADINGS = (0.0, 90.0)  # degrees; on these views, from the front and the side, the setting is chosen
# cm, the printed errors of the reference on these motions.
PRINTED_BREGLER_CM = {'walk': 4.557, 'run': 10.821, 'jump': 8.531}
EXAMPLE_EVERY = 5  # frames; neighbours are much alike


@dataclass(frozen=True, eq=False)
class Case:
    """The views of one motion by one kind of camera, and what may be trained for it: nothing knows the trial."""

    category: str
    trial: str
    views: Sequence[View]

    @cached_property
    def points(self) -> list[Array]:
        """Image points of each view (F, 15, 2), m."""
        return [v.window.points / common.load_protocol().PX_PER_M for v in self.views]

    @property
    def choice(self) -> Case:
        """The case with the views on which the settings are chosen."""
        return replace(self, views=[v for v in self.views if v.heading in CHOICE_HEADINGS] or self.views[:1])


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the table.

    Where `is_mirrored`, the method cannot tell a motion from its mirror image in depth, so that the better one
    counts; `printed` are the errors in cm that the paper prints, by motion.
    """

    name: str
    settings: Sequence[Solver]
    categories: Sequence[str] = tuple(TABLE_1_TRIALS)
    is_mirrored: bool = False
    printed: Mapping[str, float] | None = None


def list_methods(quick: bool) -> list[Row]:
    """List the rows of the table: this project, Algorithm 1, and the others."""

    def by(method: Method, category: str | None = None, **values: Any) -> Solver:
        """Solve with base poses of the motion's category, or of another one."""
        return lambda case: [
            r.joints
            for r in method.solve(
                case.views, case.category if category is None else category, case.trial, **values
            )
        ]

    def factorise(shapes: int) -> Solver:
        return lambda case: [rivals.factorise_points(p, shapes) for p in case.points]

    def represent(size: int, sparsity: float) -> Solver:
        def solve(case: Case) -> list[Array]:
            examples = choose_examples(case.category, case.trial, size)
            found = rivals.represent_sparsely(np.concatenate(case.points), examples, sparsity)
            return np.split(found, np.cumsum([len(p) for p in case.points])[:-1])

        return solve

    shapes = (3,) if quick else (1, 2, 3, 4)
    betas, sizes, sparsities = ((1.0,), (16,), (0.1,)) if quick else (paper.BETAS, (16, 64), (0.01, 0.1))
    return [
        Row('this project, joint solver', [by(JOINT)]),
        Row('this project, all motions', [by(JOINT, '')]),
        Row('this project, periodic', [by(PERIODIC)], ('walk', 'run')),
        Row(
            'Algorithm 1, best',
            [by(ALGORITHM_1, bone_weight=b, tolerance=2e-4) for b in betas],
            printed=paper.PRINTED_CM['best'],
        ),
        Row(
            'Bregler et al. 2000, full upgrade',
            [factorise(k) for k in shapes],
            is_mirrored=True,
            printed=PRINTED_BREGLER_CM,
        ),
        Row('Zhou et al. 2015, refined', [represent(*setting) for setting in product(sizes, sparsities)]),
    ]


@cache
def choose_examples(category: str, trial: str, size: int) -> Array:
    """Choose example poses (size, 15, 3), the centres of clusters of the training poses turned to one heading."""
    chosen = common.choose_trials(category, without_trials=(trial,))
    poses = centre_poses(np.concatenate([t.poses for t in chosen])[::EXAMPLE_EVERY])
    _, aligned = align_to_mean(poses, np.full(len(poses), 1 / len(poses)), fit_heading_rotation)
    centres, _ = kmeans2(aligned.reshape(len(aligned), -1), size, minit='++', seed=0)
    return np.asarray(centres.reshape(size, -1, 3))


def score(solve: Solver, case: Case, is_mirrored: bool) -> tuple[float, float]:
    """Return e in cm and the MPJPE in mm of one setting, means over the views."""
    errors = []
    for view, poses in zip(case.views, solve(case), strict=True):
        sides = [poses, rivals.reflect_in_depth(poses)] if is_mirrored else [poses]
        errors.append(min((common.compute_errors(view, s) for s in sides), key=lambda r: r['e_paper_cm']))
    return common.mean_error(errors, 'e_paper_cm'), common.mean_error(errors)


def measure_method(method: Row, case: Case) -> tuple[str, float]:
    """Return e in cm / MPJPE in mm with the best setting on `CHOICE_HEADINGS`, and its CPU ms a frame."""
    chosen = method.settings[0]
    if len(method.settings) > 1:
        chosen = min(method.settings, key=lambda s: score(s, case.choice, method.is_mirrored)[0])
    e, mpjpe = score(chosen, case, method.is_mirrored)
    first = replace(case, views=case.views[:1])  # with nothing solved yet
    _, seconds = common.measure_time(lambda: chosen(first))
    return f'{e:.2f} / {mpjpe:.0f}', 1e3 * seconds / len(first.points[0])


def report_errors(report: Report) -> None:
    methods, headings = list_methods(report.quick), paper.choose_headings(report.quick)
    cases = [
        (camera, Case(category, trial, common.make_views(trial, headings, **CAMERAS[camera])))
        for camera in list(CAMERAS)[: 1 if report.quick else 3]
        for category, trial in list(TABLE_1_TRIALS.items())[: 1 if report.quick else 3]
    ]
    rows = []
    for method in common.show_progress(methods, 'table 1'):
        found = [measure_method(method, c) if c.category in method.categories else None for _, c in cases]
        ms = np.mean([f[1] for f in found if f])
        printed = [(method.printed or {}).get(c) for c in TABLE_1_TRIALS]
        rows.append([method.name, *(f and f[0] for f in found), f'{ms:.2f}', *printed])
    header = ['method', *(f'{camera.split()[0]}: {case.category}' for camera, case in cases), 'ms a frame']
    report.table([*header, *(f'paper: {c}' for c in TABLE_1_TRIALS)], rows, page='rivals.errors')


if __name__ == '__main__':
    run(__doc__, {'errors': report_errors})
