# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the hypothesis checks: what replaces a solution, and what does not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.config import Config, with_settings
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.people import MotionKind, Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.hypotheses import HypothesisChecker, Slices, classify_as_other
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import Walk, make_walk
from tests.support.tracks import CAMERA, STEP_NS, change, track_walk

FRAMES = 45
CONFIG = with_settings(Config(), {'solver.prior': 'pca', 'tracker.components': 20})


@pytest.fixture(scope='module')
def walk(walk_model: BasePoses) -> Walk:
    return make_walk(walk_model, frames=FRAMES + 35)


@pytest.fixture(scope='module')
def tracker(walk_model: BasePoses, walk: Walk) -> Tracker:
    """A tracker that has found the right model and the right solution of a walk."""
    return track_walk({'jump': load_base_poses('jump'), 'walk': walk_model}, CONFIG, walk[2][:FRAMES])


@pytest.fixture(scope='module')
def track(tracker: Tracker) -> Track:
    (track,) = tracker.tracks
    assert track.solved.model_name == 'walk'
    return track


@pytest.fixture(scope='module')
def checker(tracker: Tracker) -> HypothesisChecker:
    return HypothesisChecker(tracker.models, CONFIG)


def turn_round(solution: TrackSolution) -> TrackSolution:
    """Return the wrong solution in which the person faces the other way, in the pose that the image then shows."""
    half_turn = rotation_from_vector(np.array([0.0, 0.0, np.pi]))
    return replace(solution, rotation=solution.rotation @ half_turn, theta=np.zeros_like(solution.theta))


def measure_error(joints: Array, walk_model: BasePoses, walk: Walk, frames: NDArray[np.intp]) -> float:
    """Return the mean error in mm of joints (n, J, 3) about the body's origin, after one scale."""
    theta, cameras, _, _ = walk
    truth = walk_model.poses(theta[frames]) @ np.swapaxes(cameras.rotation[frames], -1, -2)
    scaled = joints * (joints * truth).sum() / (joints * joints).sum()
    return float(np.linalg.norm(scaled - truth, axis=-1).mean() * 1e3)


def finish(slices: Slices[Any]) -> Any:
    """Do all slices at once, and return the result."""
    try:
        while True:
            next(slices)
    except StopIteration as end:
        return end.value


def test_a_wrong_model_is_replaced_and_the_right_one_is_kept(track: Track, checker: HypothesisChecker) -> None:
    wrong = change(track, solution=track.solved.change_model('jump', checker.models['jump']))
    found = finish(checker.check(wrong, 'walk'))
    assert (found.model_name, len(found.theta)) == ('walk', FRAMES)
    assert found.noise < 0.01
    for restarts in (0, 1):  # from the poses so far, and from scratch
        checked = track.copy()
        checked.schedule.pending_restarts = restarts
        assert finish(checker.check(checked, 'jump')) is None


@pytest.mark.parametrize(('std_ratio', 'is_replaced'), [(0.98, False), (0.93, True), (1.05, False)])
def test_a_margin_keeps_the_choice_of_the_model(
    track: Track, checker: HypothesisChecker, std_ratio: float, is_replaced: bool
) -> None:
    """A twin of the model with a slightly tighter prior is slightly more likely, which is not enough."""
    walk_model = checker.models['walk']
    twin = replace(walk_model, std=std_ratio * walk_model.std)
    found = finish(HypothesisChecker({**checker.models, 'twin': twin}, CONFIG).check(track, 'twin'))
    assert (found is not None) is is_replaced
    assert found is None or found.model_name == 'twin'


def test_the_tracker_finds_back_to_the_right_solution(walk_model: BasePoses, walk: Walk) -> None:
    """A wrong solution is given to a person; checks replace it within a second."""
    injected = track_walk({'jump': load_base_poses('jump'), 'walk': walk_model}, CONFIG, walk[2][:FRAMES])
    (track,) = injected.tracks
    track.solution = turn_round(track.solved)
    restarts, errors = [], []
    for frame in range(FRAMES, FRAMES + 35):
        seen = Person2D('', CMU15.joints, walk[2][frame], np.ones(15))
        (person,) = injected.update(frame * STEP_NS, [seen], CAMERA)
        restarts.append(track.schedule.pending_restarts)
        errors.append(measure_error(centre(person)[None], walk_model, walk, np.array([frame])))
    assert max(restarts) > 0, 'the rise of the image noise was noticed'
    assert errors[0] > 100
    assert max(errors[-5:]) < 60


def centre(person: Person3D) -> Array:
    return np.asarray(person.core - person.core.mean(axis=0))


def test_first_solutions_have_all_frames_and_the_likeliest_model(track: Track, checker: HypothesisChecker) -> None:
    unsolved = change(track, solution=None)
    solutions = checker.initialise([unsolved, unsolved], ['jump', 'walk'])
    assert [(s.model_name, len(s.theta)) for s in solutions] == [('walk', FRAMES)] * 2
    assert solutions[0].theta == pytest.approx(solutions[1].theta, abs=1e-9), 'people of a batch are independent'
    assert unsolved.solution is None


def test_a_walk_of_a_full_section_is_classified(track: Track, checker: HypothesisChecker) -> None:
    config = with_settings(CONFIG, {'classifier.section': 1.2, 'classifier.walk_residual': 0.2})
    classification = finish(replace(checker, config=config).classify_motion(track))
    assert classification is not None
    assert (classification.motion.kind, classification.periodic_model_name) == (MotionKind.PERIODIC, 'walk')
    strict = with_settings(config, {'classifier.amplitude': 0.9})
    other = finish(replace(checker, config=strict).classify_motion(track))
    assert other is not None
    assert (other.motion.kind, other.periodic_model_name) == (MotionKind.NON_PERIODIC, '')
    assert other.motion.category == 'walk'


def test_a_short_section_is_enough_for_who_has_walked_before(track: Track, checker: HypothesisChecker) -> None:
    config = with_settings(CONFIG, {'classifier.walk_residual': 0.2})
    checker = replace(checker, config=config)
    assert finish(checker.classify_motion(track)) is None, '1.5 s of 2 s'
    other = classify_as_other(track)
    walked = track.copy()
    walked.schedule.last_periodic_ns, walked.schedule.classification = 0, other
    classification = finish(checker.classify_motion(walked))
    assert classification is not None
    assert (classification.motion.kind, classification.periodic_model_name) == (MotionKind.PERIODIC, 'walk')
    assert checker.still_repeats(walked, classification)
    assert checker.still_repeats(walked, other), 'other motion need not repeat itself'
