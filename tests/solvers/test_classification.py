# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the choice of category by evidence and of the periodic decision with its hysteresis."""

from collections.abc import Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import ClassifierConfig, SolverConfig
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.classification import (
    PeriodicFit,
    PeriodicSwitch,
    choose_category,
    fit_periodic_stepwise,
    is_periodic,
    measure_jitter,
)
from mocap_ros.solvers.periodic.solver import EstimatedPoses
from mocap_ros.solvers.stepwise import run_to_end
from mocap_ros.solvers.window import Window
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.evaluation_data import shared
from tests.support.synthetic_walk import make_walk

QUICK = SolverConfig(components=20, max_iterations=30)


def fit_periodic(
    window: Window, models: Mapping[str, BasePoses], config: SolverConfig, initial: EstimatedPoses | None = None
) -> PeriodicFit:
    return run_to_end(fit_periodic_stepwise(window, models, config, initial))


def make_window(protocol: ModuleType, trial: str, heading: float) -> Window:
    data = np.load(shared('data/cmu/cmu15_30fps.npz'))
    view = protocol.make_view(data[trial], data['_joints'], heading, noise=0.01, missing=0.05)
    keypoints = np.nan_to_num(view['keypoints'].astype(float))
    return Window(keypoints[..., :2], keypoints[..., 2], view['timestamps'])


@pytest.fixture(scope='module')
def models_without_35() -> dict[str, BasePoses]:
    trials = [t for t in load_trials(shared('data/cmu/cmu15_30fps.npz')) if t.subject != '35' and t.clean]

    def train(category: str) -> BasePoses:
        poses = [t.poses for t in trials if t.category == category]
        return fit_base_poses(poses, name=category, alignment='heading', mirror=True, bodies=1)

    everything = fit_base_poses(
        [t.poses for t in trials if t.category in ('walk', 'run', 'jump', 'dance')], name='all'
    )
    return {'walk': train('walk'), 'run': train('run'), 'jump': train('jump'), 'all': everything}


@pytest.mark.parametrize(('trial', 'category', 'heading'), [('35_02', 'walk', 0), ('35_17', 'run', 120)])
def test_evidence_finds_the_category_of_an_unseen_person(
    protocol: ModuleType, models_without_35: dict[str, BasePoses], trial: str, category: str, heading: float
) -> None:
    window = make_window(protocol, trial, heading)
    assert choose_category(window, models_without_35, QUICK).category == category
    periodic = fit_periodic(window, models_without_35, QUICK)
    assert periodic.category == category
    assert is_periodic(periodic, ClassifierConfig())


@pytest.fixture(scope='module')
def fits(walk_model: BasePoses) -> dict[str, PeriodicFit]:
    """A walk, as the periodic model of either category finds it."""
    _, _, points, times = make_walk(walk_model)
    window = Window(points, np.ones(points.shape[:2]), times)
    return {name: fit_periodic(window, {name: walk_model}, QUICK) for name in ('walk', 'run')}


@pytest.mark.parametrize('category', ['walk', 'run'])
@pytest.mark.parametrize('threshold', ['residual', 'amplitude', 'cadence'])
def test_a_larger_factor_loosens_every_threshold(
    fits: dict[str, PeriodicFit], category: str, threshold: str
) -> None:
    fit = fits[category]
    passed: dict[str, Any] = {f'{category}_residual': 1.0, 'amplitude': 0.0, f'{category}_cadence': 0.0}
    other = 'run' if category == 'walk' else 'walk'
    never_passed: dict[str, Any] = {f'{other}_residual': 0.0, f'{other}_cadence': 5.0}
    config = ClassifierConfig(**passed, **never_passed)
    assert is_periodic(fit, config)
    just_missed = {
        'residual': 0.95 * fit.excess_residual,
        'amplitude': 1.05 * fit.amplitude,
        'cadence': 1.05 * fit.reconstruction.cadence,
    }
    name = threshold if threshold == 'amplitude' else f'{category}_{threshold}'
    missed: dict[str, Any] = {name: just_missed[threshold]}
    assert not is_periodic(fit, replace(config, **missed))
    assert is_periodic(fit, replace(config, **missed), 1.1)


@pytest.mark.parametrize('hysteresis', [1.1, 1.25])
def test_switch_has_hysteresis(fits: dict[str, PeriodicFit], hysteresis: float) -> None:
    config = ClassifierConfig(hysteresis=hysteresis)
    switch = PeriodicSwitch(config)
    shares = (1.5, 1.02, 1.05 / hysteresis, 0.95 / hysteresis, 0.98, 0.95 * hysteresis, 1.05 * hysteresis, 1.02)
    residuals = [replace(fits['walk'], excess_residual=share * config.walk_residual) for share in shares]
    decisions = [switch.update(fit) for fit in residuals]
    assert decisions == [False, False, False, True, True, True, False, False]


def test_a_walk_is_periodic_whatever_the_detector_adds_to_all_frames_alike(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model, 60)
    rng = np.random.default_rng(3)
    offset = 12 * rng.normal(size=(1, *points.shape[1:]))  # px, 5 cm at the body, constant in each joint
    poses = walk_model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2)
    estimated = EstimatedPoses(poses, cameras.scale, 0.01)
    window = Window(points + offset, np.ones(points.shape[:2]), times)
    by_residual = fit_periodic(window, {'walk': walk_model}, QUICK)
    by_movement = fit_periodic(window, {'walk': walk_model}, QUICK, estimated)
    assert not is_periodic(by_residual, ClassifierConfig())
    assert is_periodic(by_movement, ClassifierConfig())
    assert by_movement.excess_residual < 0.5 * by_residual.excess_residual


def test_what_a_periodic_motion_does_not_explain_counts(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model, 60)
    estimates = []
    for added in (0.0, 1.0):  # m, of a movement that is no cycle of the walk
        moved = theta.copy()
        moved[:, 1] += added * np.sin(times**2 * 4)
        poses = walk_model.poses(moved) @ np.swapaxes(cameras.rotation, -1, -2)
        window = Window(cameras.project(walk_model.poses(moved)), np.ones(points.shape[:2]), times)
        fit = fit_periodic(window, {'walk': walk_model}, QUICK, EstimatedPoses(poses, cameras.scale, 0.01))
        estimates.append(fit.excess_residual)
    assert estimates[0] < 0.005
    assert estimates[1] > 2 * ClassifierConfig().walk_residual


@pytest.mark.parametrize('rate', [30.0, 100.0])
def test_jitter_is_what_remains_of_noise_without_the_motion(rng: np.random.Generator, rate: float) -> None:
    times = np.arange(int(2 * rate)) / rate
    swing = 0.2 * np.sin(2 * np.pi * times[:, None, None] + rng.uniform(0, 6, (15, 2)))
    assert measure_jitter(times, swing) < 0.003, 'm; the motion of 0.2 m'
    noise = rng.normal(0, 0.02, swing.shape)
    noise -= noise.mean(axis=1, keepdims=True)
    assert measure_jitter(times, swing + noise) == pytest.approx(0.02 * np.sqrt(2), rel=0.15)
    moved = swing + noise + np.cumsum(rng.normal(0, 1, (len(times), 1, 2)), axis=0)
    assert measure_jitter(times, moved) == pytest.approx(measure_jitter(times, swing + noise)), 'of the body'
    few_frames, slow = slice(5), slice(0, None, int(rate / 10))
    assert measure_jitter(times[few_frames], noise[few_frames]) == measure_jitter(times[slow], noise[slow]) == 0
