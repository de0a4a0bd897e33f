# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People who are none are never more than tentative, and those who are there stay who they are."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings
from mocap_ros.keypoints.identities import TENTATIVE_FORGET_S
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS

CONFIG = with_settings(Config(), {'solver.components': 8, 'solver.prior': 'pca'})
FRAMES = 60
APART = np.array([400.0, 0.0])  # px
UPPER = np.array(
    [joint in ('head', 'neck') or joint[1:] in ('shoulder', 'elbow', 'wrist') for joint in CMU15.joints]
)


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, FRAMES)[2]


@pytest.fixture
def tracker(walk_model: BasePoses) -> Tracker:
    return Tracker(walk_model, CONFIG)


def see(points: Array, name: str = '', joints: Array | None = None) -> Person2D:
    """Return the detection of a person at points (J, 2) px, of whom all joints or some were seen."""
    return Person2D(name, CMU15.joints, points, np.ones(15) if joints is None else joints.astype(float))


def describe(people: tuple[Person3D, ...]) -> list[tuple[str, str]]:
    """Return the id of each person, and whether the person is tentative, predicted or neither."""
    return [(p.id, 'tentative' if p.tentative else 'predicted' if p.predicted else 'seen') for p in people]


def test_a_tentative_person_is_never_predicted_and_costs_no_deferred_work(tracker: Tracker, points: Array) -> None:
    ghosts = 0
    for frame in range(12):
        seen = [see(points[frame])] + ([see(points[frame] + APART)] if frame == 6 else [])
        people = describe(tracker.update(frame * STEP_NS, seen, CAMERA))
        tracker.run_deferred_work()
        begun = tracker._deferred_work.begun
        assert begun is None or begun.track.id == 'person_1'
        ghosts += len(people) > 1
        if len(people) > 1:
            assert people == [('person_1', 'seen'), ('person_2', 'tentative')]
    assert ghosts == 1
    tracker.update((12 + round(TENTATIVE_FORGET_S * 30)) * STEP_NS, [], CAMERA)
    assert [t.id for t in tracker.tracks] == ['person_1']


def test_a_person_who_comes_back_while_the_track_is_kept_is_certain(tracker: Tracker, points: Array) -> None:
    for frame in range(5):
        tracker.update(frame * STEP_NS, [see(points[0], 'ann')], CAMERA)
    assert tracker.update(5 * STEP_NS + 600_000_000, [], CAMERA) == ()
    back = tracker.update(5 * STEP_NS + 700_000_000, [see(points[0] + 5, 'new')], CAMERA)
    assert describe(back) == [('ann', 'seen')]
    assert describe(tracker.update(10**10, [see(points[0], 'ann')], CAMERA)) == [('ann', 'seen')], 'after silence'
    tracker.update(2 * 10**10, [], CAMERA)
    again = tracker.update(2 * 10**10 + STEP_NS, [see(points[0], 'ann')], CAMERA)
    assert describe(again) == [('ann', 'tentative')], 'who was forgotten is new'


@pytest.mark.parametrize(('name', 'seed'), [('p', 0), ('', 1)])
def test_fragments_and_new_ids_make_no_people(tracker: Tracker, points: Array, name: str, seed: int) -> None:
    """A tenth of the detections are broken in two, seen twice or given a new id, of two people side by side."""
    rng = np.random.default_rng(seed)
    new_ids = [f'new_{i}' for i in range(1000)] if name else [''] * 1000

    def disturb(person: Array, own_id: str) -> list[Person2D]:
        kind = rng.choice(['whole', 'broken', 'twice', 'new id'], p=[0.7, 0.1, 0.1, 0.1])
        if kind == 'whole':
            return [see(person, own_id)]
        if kind == 'new id':
            return [see(person, new_ids.pop())]
        first, second = own_id if rng.random() < 0.5 else new_ids.pop(), new_ids.pop()
        whole = UPPER if kind == 'broken' else np.ones(15)
        return [see(person, first, whole), see(person + rng.normal(0, 1, (15, 2)), second, ~UPPER)]

    detections = people = 0
    for frame in range(FRAMES):
        both = (points[frame], f'{name}1' if name else ''), (points[frame] + APART, f'{name}2' if name else '')
        seen = [d for body, own in both for d in (disturb(body, own) if frame else [see(body, own)])]
        order = rng.permutation(len(seen)) if frame else [0, 1]
        published = describe(tracker.update(frame * STEP_NS, [seen[i] for i in order], CAMERA))
        expected = 'tentative' if frame < 2 else 'seen'
        names = (f'{name}1', f'{name}2') if name else ('person_1', 'person_2')
        assert sorted(published) == [(n, expected) for n in names], frame
        detections, people = detections + len(seen), people + len(published)
    assert detections > 1.1 * people
    assert tracker.unusable_people == detections - people
