# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which motion: periodic or not with its hysteresis, and which prior leads."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.arrays import Array
from mocap_ros.config import ClassifierConfig, Config, SolverConfig
from mocap_ros.demo.motions import load_motions
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline import whole_sequence
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.classification import PeriodicFit, fit_periodic_stepwise, is_periodic, measure_jitter
from mocap_ros.solvers.leading_prior import MAX_NOISE, MAX_NOISE_RATIO, NEGLIGIBLE_NOISE, explains_as_well
from mocap_ros.solvers.levenberg_marquardt import run_to_end
from mocap_ros.solvers.periodic import EstimatedPoses
from mocap_ros.solvers.window import Window
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.synthetic_walk import BODY_TO_OPTICAL, make_walk, mpjpe_mm, with_scores
from tests.support.tracks import STEP_NS, feed

QUICK = SolverConfig(components=20, max_iterations=30)


def fit_periodic(
    window: Window, model: BasePoses, initial: EstimatedPoses | None = None, category: str = 'walk'
) -> PeriodicFit:
    return run_to_end(fit_periodic_stepwise(window, category, model, QUICK, initial))


@pytest.fixture(scope='module')
def fits(walk_model: BasePoses) -> dict[str, PeriodicFit]:
    """A walk, as the periodic model of either category finds it."""
    window = make_walk(walk_model).window
    return {name: fit_periodic(window, walk_model, category=name) for name in ('walk', 'run')}


@pytest.mark.parametrize('category', ['walk', 'run'])
@pytest.mark.parametrize('threshold', ['residual', 'amplitude', 'cadence'])
def test_hysteresis_moves_every_threshold(fits: dict[str, PeriodicFit], category: str, threshold: str) -> None:
    fit, other = fits[category], 'run' if category == 'walk' else 'walk'
    limits: dict[str, Any] = {f'{category}_residual': 1.0, 'amplitude': 0.0, f'{category}_cadence': 0.0}
    limits |= {f'{other}_residual': 0.0, f'{other}_cadence': 5.0, 'hysteresis': 1.1}
    values = {'residual': fit.excess_residual, 'amplitude': fit.amplitude, 'cadence': fit.reconstruction.cadence}
    name, value = threshold if threshold == 'amplitude' else f'{category}_{threshold}', values[threshold]
    cases = (1.15, True, False), (1.05, True, True), (0.95, False, False), (0.87, False, True)
    for share, was_periodic, expected in cases:
        limits[name] = value / share if threshold == 'residual' else value * share
        assert is_periodic(fit, ClassifierConfig(**limits), was_periodic=was_periodic) is expected


def test_a_walk_is_periodic_whatever_the_detector_adds_to_all_frames_alike(walk_model: BasePoses) -> None:
    walk = make_walk(walk_model, 60)
    offset = 12 * np.random.default_rng(3).normal(size=(1, 15, 2))  # px, 5 cm at the body, constant in each joint
    estimated = EstimatedPoses(walk.poses(walk_model), walk.cameras.scale, 0.01)
    window = replace(walk.window, points=walk.points + offset)
    by_residual = fit_periodic(window, walk_model)
    by_movement = fit_periodic(window, walk_model, estimated)
    assert not is_periodic(by_residual, ClassifierConfig(hysteresis=1.0), was_periodic=False)
    assert is_periodic(by_movement, ClassifierConfig(hysteresis=1.0), was_periodic=False)
    assert by_movement.excess_residual < 0.5 * by_residual.excess_residual


def test_what_a_periodic_motion_does_not_explain_counts(walk_model: BasePoses) -> None:
    walk, estimates = make_walk(walk_model, 60), []
    for added in (0.0, 1.0):  # m, of a movement that is no cycle of the walk
        moved = walk._replace(theta=walk.theta.copy())
        moved.theta[:, 1] += added * np.sin(walk.times**2 * 4)
        window = replace(walk.window, points=walk.cameras.project(walk_model.poses(moved.theta)))
        fit = fit_periodic(window, walk_model, EstimatedPoses(moved.poses(walk_model), walk.cameras.scale, 0.01))
        estimates.append(fit.excess_residual)
    assert estimates[0] < 0.005
    assert estimates[1] > 2 * ClassifierConfig().walk_residual


def test_what_jitters_does_not_rule_out_a_periodic_motion(walk_model: BasePoses, rng: np.random.Generator) -> None:
    window = make_walk(walk_model).window
    exact = fit_periodic(window, walk_model).reconstruction
    jittering = exact.joints + rng.normal(0, 0.02, exact.joints.shape)
    poses = [EstimatedPoses(jittering, exact.cameras.scale, 0.01, jitter) for jitter in (0.0, 0.01)]
    excess = [fit_periodic(window, walk_model, p).excess_residual for p in poses]
    assert excess[0] ** 2 - excess[1] ** 2 == pytest.approx(3 * (0.01 / walk_model.stature) ** 2, rel=0.05)


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


FRAMES = 30
TIMES = np.arange(FRAMES) / 30
UNKNOWN = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scenes are orthographic


def make_motion(name: str, times: Array = TIMES) -> tuple[Array, BasePoses, Array]:
    """Return poses (F, 15, 3) m of a motion of the demo in the camera's axes, its base poses and keypoints."""
    model, motions = load_motions()
    poses, own = (model.poses(motions[name].sample(t)[:, :-2]) for t in (times, TIMES))
    base_poses = fit_base_poses([own], name='own', alignment='heading')
    truth = poses @ (BODY_TO_OPTICAL @ rotation_from_vector(np.array([0.0, 0.0, 0.8]))).T
    return truth, base_poses, 200 * truth[..., :2] + [320, 240]


def reconstruct(points: Array, base_poses: BasePoses, prior: str = 'learned') -> Array:
    config = Config(solver=SolverConfig(prior=prior))
    return reconstruct_sequence(with_scores(points), CMU15.joints, TIMES, UNKNOWN, base_poses, config).core


@pytest.mark.parametrize('lifter_noise', [0.0, 0.001, 0.01, 0.02, 2 * MAX_NOISE])
def test_a_little_more_noise_is_allowed_but_not_any(lifter_noise: float) -> None:
    total = MAX_NOISE_RATIO * np.hypot(lifter_noise, NEGLIGIBLE_NOISE)
    limit = min(np.sqrt(total**2 - NEGLIGIBLE_NOISE**2), MAX_NOISE)
    assert explains_as_well(0.999 * limit, lifter_noise)
    assert not explains_as_well(1.001 * limit, lifter_noise)
    assert explains_as_well(1.001 * limit, lifter_noise, slack=1.1)


def test_base_poses_of_the_very_person_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    truth, base_poses, points = make_motion('run')
    own, alone = (reconstruct(points, base_poses, prior) for prior in ('learned', 'pca'))
    of_all = reconstruct(points, replace(base_poses, name='all'))
    monkeypatch.setattr(whole_sequence, 'explains_as_well', lambda *_: False)
    lifter_leads = reconstruct(points, base_poses)
    assert mpjpe_mm(own, truth) < 1.1 * mpjpe_mm(alone, truth)
    assert mpjpe_mm(own, truth) < 0.6 * mpjpe_mm(lifter_leads, truth)
    np.testing.assert_array_equal(of_all, lifter_leads, 'base poses of that name are those of all motions')


def test_live_the_lead_is_taken_and_given_back() -> None:
    """Base poses of a run lead soon after the run has begun, and no longer when a walk has taken its place."""
    times = np.arange(2 * FRAMES) / 30
    _, base_poses, run = make_motion('run', times)
    _, _, walk = make_motion('walk', times)
    trackers = [Tracker(m, Config()) for m in (base_poses, replace(base_poses, name='all'))]
    leads: list[list[bool]] = [[], []]
    for frame, points in enumerate([*run, *walk]):
        for tracker, lead in zip(trackers, leads, strict=True):
            feed(tracker, points[None], frame * STEP_NS, UNKNOWN)
            tracker.run_deferred_work()
            lead.append(tracker.tracks[0].solved.base_poses_lead)
    own, of_all = leads
    assert not own[0], 'a first solution needs the lifter, for a frame does not tell front from back'
    assert all(own[45 : 2 * FRAMES])
    assert not any(own[3 * FRAMES + 15 :])
    assert not any(of_all)
