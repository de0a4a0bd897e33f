"""Tests of the choice of category by evidence and of the periodic decision with its hysteresis."""

import dataclasses

import numpy as np
import pytest

from mocap_ros.config import ClassifierConfig, SolverConfig
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.solvers.classification import (
    PeriodicFit,
    PeriodicSwitch,
    choose_category,
    fit_periodic,
    is_periodic,
)
from mocap_ros.solvers.window import Window
from mocap_ros.training.base_poses import fit_base_poses
from tests.support.evaluation_data import shared

QUICK = SolverConfig(components=20, max_iterations=30)


def make_window(protocol, trial: str, heading: float) -> Window:
    data = np.load(shared('data/cmu/cmu15_30fps.npz'))
    view = protocol.make_view(data[trial], data['_joints'], heading, noise=0.01, missing=0.05)
    keypoints = np.nan_to_num(view['keypoints'].astype(float))
    return Window(keypoints[..., :2], keypoints[..., 2], view['timestamps'])


@pytest.fixture(scope='module')
def models_without_35():
    trials = [t for t in load_trials(shared('data/cmu/cmu15_30fps.npz')) if t.subject != '35' and t.clean]

    def train(category: str):
        poses = [t.poses for t in trials if t.category == category]
        return fit_base_poses(poses, name=category, alignment='heading', mirror=True, bodies=1)

    everything = fit_base_poses(
        [t.poses for t in trials if t.category in ('walk', 'run', 'jump', 'dance')], name='all'
    )
    return {'walk': train('walk'), 'run': train('run'), 'jump': train('jump'), 'all': everything}


@pytest.mark.parametrize(('trial', 'category'), [('35_02', 'walk'), ('35_17', 'run')])
@pytest.mark.parametrize('heading', [0, 120])
def test_evidence_finds_the_category_of_an_unseen_person(
    protocol, models_without_35, trial: str, category: str, heading: float
) -> None:
    window = make_window(protocol, trial, heading)
    assert choose_category(window, models_without_35, QUICK).category == category
    periodic = fit_periodic(window, models_without_35, QUICK)
    assert periodic.category == category
    assert is_periodic(periodic, ClassifierConfig())


def test_a_jump_is_neither_a_walk_nor_periodic(protocol) -> None:
    models = {name: load_base_poses(name) for name in ('walk', 'run', 'jump')}
    window = make_window(protocol, '13_11', 90)
    jump_frames = slice(40, 100)
    window = Window(window.points[jump_frames], window.weight[jump_frames], window.times[jump_frames])
    assert choose_category(window, models, QUICK).category == 'jump'
    assert not is_periodic(fit_periodic(window, models, QUICK), ClassifierConfig())


def test_switch_has_hysteresis() -> None:
    config = ClassifierConfig()

    @dataclasses.dataclass
    class FakeReconstruction:
        cadence: float = 0.9

    def fit_with_residual(share: float) -> PeriodicFit:
        return PeriodicFit('walk', 9.9, share * config.walk_residual, 2 * config.amplitude, FakeReconstruction())  # type: ignore[arg-type]

    switch = PeriodicSwitch(config)
    decisions = [switch.update(fit_with_residual(s)) for s in (1.5, 1.02, 0.98, 0.85, 0.98, 1.05, 1.2, 1.05)]
    assert decisions == [False, False, False, True, True, True, False, False]
