# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Comparison of the joint solver with Algorithm 1 and with scipy.optimize.least_squares.

The solvers in one row of a table start from the same state and minimise the same objective.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import common
import numpy as np
from experiments.least_squares import Progress, SparseProblem
from report import Records, Report, run

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.objective import JointObjective, read_state
from mocap_ros.solvers.joint.reference import advance, compute_cost
from mocap_ros.solvers.window import InitialValues, Reconstruction, Window, choose_initial_values

CLOSE_TO_OPTIMUM = (
    1e-4  # relative distance of an objective from the optimum at which the optimum counts as reached
)
TARGET_COMPONENTS = 30  # number of base poses for which the targets hold
# Options of the joint solver that let it converge as far as it can.
TO_CONVERGENCE: dict[str, Any] = {'tolerance': 1e-10, 'max_iterations': 500}
# Options of `least_squares` by their names in the tables.
SCIPY_OPTIONS: dict[str, dict[str, Any]] = {
    'analytic sparse Jacobian': {'x_scale': 'jac', 'tr_solver': 'lsmr'},
    'analytic sparse Jacobian, x_scale 1': {'x_scale': 1.0, 'tr_solver': 'lsmr'},
    '2-point Jacobian, sparsity given': {'x_scale': 'jac', 'tr_solver': 'lsmr', 'differences': True},
}
# Tolerances of `least_squares`: its defaults, and a limit that ends hopeless runs.
SCIPY_TOLERANCES: dict[str, Any] = {'ftol': 1e-8, 'xtol': 1e-8, 'gtol': 1e-8, 'max_nfev': 200}


@dataclass(frozen=True)
class Case:
    """A sequence of at most 120 frames, and the base poses that solve it."""

    label: str
    trial: str
    heading: float
    category: str
    options: tuple[tuple[str, float], ...] = ()

    @property
    def model(self) -> BasePoses:
        return common.train_base_poses(self.category, without_subjects=(self.trial[:2],))

    @property
    def window(self) -> Window:
        return common.make_views(self.trial, [self.heading], **dict(self.options))[0].window


WALK = Case('walk 16_32, 45 degrees', '16_32', 45, 'walk')
# Sequences that the solvers are compared on.
CASES = (
    WALK,
    Case('walk 16_32, frontal', '16_32', 0, 'walk'),
    Case(
        'walk 16_32, 45 degrees, 2 % noise, 5 % missing', '16_32', 45, 'walk', (('noise', 0.02), ('missing', 0.05))
    ),
    Case('run 35_17, 45 degrees', '35_17', 45, 'run'),
    Case('jump 13_11, 45 degrees, all-motions model', '13_11', 45, ''),
)


def fix_initial_values(case: Case, config: SolverConfig) -> tuple[Window, JointObjective, State]:
    """Fix the initial values and the unit of a case, so that every solver minimises the same objective.

    Returns:
        The window, the objective and the initial state.
    """
    model = case.model.truncate(config.components)
    window = case.window
    start, unit = choose_initial_values(window, model, config.start_window)
    window = replace(window, start=start, unit=unit)
    batch = Batch.build([window], np.array([unit]), model)
    problem = JointObjective.build(batch, model, config)
    state = batch.initial_state([start], np.array([unit]))
    return window, problem, read_state(problem.compile(state, settle_steps=1))


def convert_to_state(result: Reconstruction, unit: float) -> State:
    cameras = result.cameras
    return State(result.theta, cameras.rotation, np.log(cameras.scale / unit), result.translation / unit)


def check_same_objective(problem: JointObjective, state: State, result: Reconstruction, unit: float) -> None:
    """Check that the squared residual vector equals the objective at the start, nearby and at the solution."""
    step = 0.05 * np.random.default_rng(0).standard_normal((len(state.theta), len(problem.model.std) + 4))
    end = convert_to_state(result, unit)
    for at in (state, advance(state, step), end):
        sparse, expected = SparseProblem(problem, at), compute_cost(problem, at)[0]
        squares = float((sparse.residuals(sparse.pack(at)) ** 2).sum())
        if not np.isclose(squares, expected, rtol=1e-9):
            raise AssertionError(f'objectives differ: {squares} and {expected}')
    if not np.isclose(result.cost, compute_cost(problem, end)[0], rtol=1e-9):
        raise AssertionError('the solver reports an objective that its solution does not have')
    if not np.isclose(result.history[0], compute_cost(problem, state)[0], rtol=1e-9):
        raise AssertionError('the solver starts from a different state')
    if np.any(np.diff(result.history) > 0):
        raise AssertionError('the objective rose')


def find_first_close(costs: Sequence[float], best: float) -> int | None:
    """Return the index of the first cost within `CLOSE_TO_OPTIMUM` of `best`, or None."""
    near = np.flatnonzero(np.asarray(costs) <= best * (1 + CLOSE_TO_OPTIMUM))
    return int(near[0]) if len(near) else None


def compare_with_scipy(case: Case, settings: Sequence[str], repeats: int) -> dict[str, Any]:
    config = common.make_config(components=TARGET_COMPONENTS, adapt_noise=False)
    model = case.model
    window, problem, state = fix_initial_values(case, config)
    (exact,) = joint.solve([window], model, replace(config, **TO_CONVERGENCE))
    unit = float(window.unit or 1.0)
    check_same_objective(problem, state, exact, unit)
    record: dict[str, Any] = {
        'case': case.label,
        'frames': len(window.times),
        'joint optimum': exact.cost,
        'iterations': find_first_close(exact.history, exact.cost),
        'scipy': {},
    }
    stopped = replace(config, tolerance=0.0, max_iterations=max(record['iterations'] or 0, 1))
    record['seconds'] = common.measure_time(lambda: joint.solve([window], model, stopped), repeats)[1]
    for name in settings:
        _, progress, jacobians = SparseProblem(problem, state).solve(**SCIPY_OPTIONS[name], **SCIPY_TOLERANCES)
        found = _summarise_progress(progress, jacobians)
        found['joint iterations'] = find_first_close(exact.history, found['optimum'])
        found['times faster'] = found['seconds'] / record['seconds']
        if found['joint iterations'] is not None:
            near = replace(stopped, max_iterations=max(found['joint iterations'], 1))
            joint_s = common.measure_time(partial(joint.solve, [window], model, near), repeats)[1]
            found['times faster to its optimum'] = found['seconds'] / joint_s
        record['scipy'][name] = found
    return record


def _summarise_progress(progress: Progress, jacobians: int) -> dict[str, Any]:
    at = find_first_close(progress.cost, progress.cost[-1]) or 0
    return {
        'optimum': progress.cost[-1],
        'iterations': jacobians,
        'seconds': progress.seconds[at],
        'seconds in all': progress.seconds[-1],
    }


def compare_with_alternation(case: Case, components: int, prior: bool, repeats: int) -> dict[str, Any]:
    """Run both solvers to convergence on the objective of the paper, with the Gaussian prior added if `prior`."""
    paper = common.make_paper_config(
        components=components, start_window=1.0, bone_weight=SolverConfig().bone_weight
    )
    if prior:
        paper = replace(paper, prior_weight=SolverConfig().prior_weight)
    exact = replace(paper, tolerance=1e-7, max_iterations=3000)
    model, window = case.model.truncate(components), case.window
    start, unit = choose_initial_values(window, model, paper.start_window)
    window = replace(window, start=start, unit=unit)
    plain, plain_seconds = common.measure_time(lambda: alternation.reconstruct(window, model, exact))
    (jointly,), joint_seconds = common.measure_time(lambda: joint.solve([window], model, exact), repeats)
    end = replace(window, start=InitialValues(plain.theta, plain.cameras))
    (onwards,) = joint.solve([end], model, replace(exact, max_iterations=1))
    for theirs, ours in ((plain.history[0], jointly.history[0]), (plain.cost, onwards.history[0])):
        if not np.isclose(theirs, ours, rtol=1e-6):
            raise AssertionError(f'objectives differ: {theirs} and {ours}')
    return {
        'case': case.label,
        'components': components,
        'prior': prior,
        'alternation': {
            'seconds': plain_seconds,
            'iterations': plain.iterations,
            'objective': plain.cost,
        },
        'joint': {'seconds': joint_seconds, 'iterations': jointly.iterations, 'objective': jointly.cost},
    }


def measure_solver(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig, repeats: int
) -> dict[str, Any]:
    found, seconds = common.measure_time(lambda: joint.solve(windows, model, config), repeats)
    return {'ms': seconds * 1e3, 'iterations': float(np.mean([r.iterations for r in found]))}


def show_scipy(report: Report, records: Records, page: str = '') -> None:
    rows = [
        {
            'case': f'{r["case"]}, {r["frames"]} frames',
            'SciPy with': name,
            'joint / its optimum': f'{r["joint optimum"] / found["optimum"]:.4f}',
            'joint: iterations to own optimum': r['iterations'],
            'to its optimum': 'other minimum' if found['joint iterations'] is None else found['joint iterations'],
            'its iterations in all': found['iterations'],
            'joint, ms': f'{r["seconds"] * 1e3:.0f}',
            'its ms': f'{found["seconds"] * 1e3:.0f}',
            'times faster': f'{found["times faster"]:.0f}',
            'times faster to its optimum': f'{found.get("times faster to its optimum", float("nan")):.0f}',
        }
        for r in records
        for name, found in r['scipy'].items()
    ]
    title = 'Joint solver and scipy.optimize.least_squares (trf, lsmr): same objective, same initial state'
    fixed = 'all terms on, image noise fixed at 10 mm, since adapting it changes the objective.'
    report.rows(title, rows, f'K = {TARGET_COMPONENTS}, {fixed}', page=page)
    report.text(
        f'A solver has reached an optimum when its objective is within {CLOSE_TO_OPTIMUM:g} of it; each time is '
        "that to the own optimum, but in the last column both are times to SciPy's. SciPy also solves for "
        'translations and mean bone lengths, which keeps its Jacobian sparse. The objectives are checked to be '
        'equal at equal states.'
    )


def show_alternation(report: Report, records: Records) -> None:
    rows = []
    for r in records:
        a, j = r['alternation'], r['joint']
        rows.append(
            {
                'case': r['case'],
                'K': r['components'],
                'prior': 'yes' if r['prior'] else 'no',
                'joint / alternation objective': f'{j["objective"] / a["objective"]:.4f}',
                'joint iterations': j['iterations'],
                'alternations': a['iterations'],
                'joint, ms': f'{j["seconds"] * 1e3:.0f}',
                'alternation, ms': f'{a["seconds"] * 1e3:.0f}',
                'times faster': f'{a["seconds"] / j["seconds"]:.0f}',
            }
        )
    title = 'Joint solver and Algorithm 1 to convergence, without the terms that the paper does not have'
    report.rows(title, rows, page='solvers.alternation')


def measure(args: argparse.Namespace, report: Report) -> None:
    repeats = 3 if args.quick else 9
    one = {}
    for k in (SolverConfig().components, TARGET_COMPONENTS):
        one[k] = measure_solver([WALK.window], WALK.model, common.make_config(components=k), repeats * 3)['ms']
        report.text(f'120 frames, K = {k}, all terms on, one initial camera: {one[k]:.0f} ms')
    reference = common.measure_reference_kernel_s()
    report.text(f'Reference kernel in the same run: {reference * 1e3:.0f} ms')
    names = list(SCIPY_OPTIONS)[:1] if args.quick else list(SCIPY_OPTIONS)
    scipy_cases = CASES[:3:2] if args.quick else CASES
    by_scipy = [compare_with_scipy(c, names, repeats) for c in common.show_progress(scipy_cases, 'SciPy')]
    show_scipy(report, by_scipy, 'solvers.scipy')
    variants = [(6, False)] if args.quick else [(6, False), (30, True)]
    todo = [(c, k, prior) for c in (CASES[:1] if args.quick else CASES) for k, prior in variants]
    by_alternation = [compare_with_alternation(*t, repeats) for t in common.show_progress(todo, 'alternation')]
    show_alternation(report, by_alternation)
    times_ms = {f'K = {k}': ms for k, ms in one.items()}
    report.add(reference_s=reference, one_start_120_frames_ms=times_ms, scipy=by_scipy, alternation=by_alternation)


if __name__ == '__main__':
    run(__doc__, 'Solvers', measure)
