"""The tracker: people come and go, stamps are what they are, the same input gives the same output."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_alternation import scene

from mocap_ros.base_poses import BasePoses
from mocap_ros.config import Config, with_values
from mocap_ros.errors import FrameDropped, SkeletonError
from mocap_ros.people import Intrinsics, Person2D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracker import Tracker

CAMERA = Intrinsics(500.0, (320.0, 240.0), known=True)
STEP_NS = 33_333_333
CONFIG = with_values(Config(), {'solver.components': 8, 'solver.prior_weight': 1e-5})


def people(points, frame: int, ids=('',), apart: float = 400.0) -> list[Person2D]:
    return [
        Person2D(name, CMU15.joints, points[frame] + [apart * i, 0], np.ones(15)) for i, name in enumerate(ids)
    ]


@pytest.fixture
def walk(walk_model: BasePoses):
    return scene(walk_model, frames=40)


def test_follows_a_walk(walk_model: BasePoses, walk) -> None:
    theta, cameras, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    error = []
    for frame in range(len(points)):
        (person,) = tracker.update(frame * STEP_NS, people(points, frame), CAMERA)
        truth = walk_model.poses(theta[frame]) @ cameras.rotation[frame].T
        mine = person.joints - person.joints.mean(axis=0)
        mine *= (mine * truth).sum() / (mine * mine).sum()
        error.append(np.linalg.norm(mine - truth, axis=-1).mean() * 1e3)
        assert person.id == 'person_1'
        assert not person.filled.any()
    assert np.mean(error[10:]) < 40
    depth = CAMERA.focal / cameras.scale[-1] * CONFIG.tracker.body_height / walk_model.stature
    assert person.joints[:, 2].mean() == pytest.approx(depth, rel=0.05)
    assert person.joints.mean(axis=0)[:2] == pytest.approx([0, 0], abs=0.05)


def test_two_people_keep_their_names_when_the_detector_reorders_them(walk_model, walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    for frame in range(6):
        seen = people(points, frame, ('', ''))
        out = tracker.update(frame * STEP_NS, seen[:: -1 if frame % 2 else 1], CAMERA)
        names = [p.id for p in out]
        assert names == (['person_2', 'person_1'] if frame % 2 else ['person_1', 'person_2'])


def test_the_detectors_ids_are_kept(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    for frame in range(4):
        ids = ('ann', 'bob') if frame % 2 else ('bob', 'ann')
        out = tracker.update(frame * STEP_NS, people(points, frame, ids, apart=0.0), CAMERA)
        assert tuple(p.id for p in out) == ids


def test_old_and_repeated_stamps_are_dropped_and_change_nothing(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    plain, disturbed = Tracker(walk_model, CONFIG), Tracker(walk_model, CONFIG)
    for frame in range(8):
        stamp = (frame + 1) * STEP_NS
        (a,) = plain.update(stamp, people(points, frame), CAMERA)
        (b,) = disturbed.update(stamp, people(points, frame), CAMERA)
        with pytest.raises(FrameDropped, match='repeats'):
            disturbed.update(stamp, people(points, frame), CAMERA)
        with pytest.raises(FrameDropped, match='older'):
            disturbed.update(stamp - 5, people(points, 0), CAMERA)
        with pytest.raises(SkeletonError):
            disturbed.update(stamp + 1, [Person2D('', ('nose',), np.zeros((1, 2)), np.ones(1))], CAMERA)
        assert (a.joints == b.joints).all()


def test_stamps_that_go_far_back_start_it_afresh(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    tracker, fresh = Tracker(walk_model, CONFIG), Tracker(walk_model, CONFIG)
    for frame in range(4):
        tracker.update(10**10 + frame * STEP_NS, people(points, frame + 20), CAMERA)
    newest = 10**10 + 3 * STEP_NS
    with pytest.raises(FrameDropped, match='older'):
        tracker.update(newest - 10**9, people(points, 0), CAMERA)
    with pytest.raises(SkeletonError):
        tracker.update(1, [Person2D('', ('nose',), np.zeros((1, 2)), np.ones(1))], CAMERA)
    start = newest - 10**9 - 1
    for frame in range(4):
        (a,) = tracker.update(start + frame * STEP_NS, people(points, frame), CAMERA)
        (b,) = fresh.update(start + frame * STEP_NS, people(points, frame), CAMERA)
        assert (a.joints == b.joints).all()
        assert tracker.went_back == pytest.approx(0 if frame else 1.0)


def test_reset_begins_anew(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    first = [tracker.update(f * STEP_NS, people(points, f), CAMERA)[0].joints for f in range(5)]
    tracker.reset()
    again = [tracker.update(f * STEP_NS, people(points, f), CAMERA)[0].joints for f in range(5)]
    assert all((a == b).all() for a, b in zip(first, again, strict=True))


def test_nobody_is_a_normal_state_and_the_lost_are_forgotten(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    assert tracker.update(0, [], CAMERA) == ()
    assert tracker.update(1 * STEP_NS, people(points, 0), CAMERA)[0].id == 'person_1'
    assert tracker.update(2 * STEP_NS, [], CAMERA) == ()
    assert tracker.update(3 * STEP_NS, people(points, 1), CAMERA)[0].id == 'person_1'
    assert tracker.update(200 * STEP_NS, people(points, 2), CAMERA)[0].id == 'person_2'


def test_hidden_joints_are_filled_and_flagged(walk_model: BasePoses, walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    for frame in range(10):
        (seen,) = people(points, frame)
        seen.score[[3, 4]] = 0.0
        seen.points[[3, 4]] = np.nan
        (person,) = tracker.update(frame * STEP_NS, [seen], CAMERA)
        assert person.filled[[3, 4]].all()
        assert person.filled.sum() == 2
        assert np.isfinite(person.joints).all()


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_whatever_keypoints_come_the_tracker_lives(walk_model: BasePoses, data) -> None:
    tracker = Tracker(walk_model, CONFIG)
    number = st.one_of(st.just(float('nan')), st.floats(-1e7, 1e7))
    for frame in range(data.draw(st.integers(1, 5))):
        seen = [
            Person2D(
                data.draw(st.sampled_from(['', 'a', 'b'])) if i == 0 else '',
                CMU15.joints,
                np.array(data.draw(st.lists(number, min_size=30, max_size=30))).reshape(15, 2),
                np.array(data.draw(st.lists(st.floats(0, 1), min_size=15, max_size=15))),
            )
            for i in range(data.draw(st.integers(0, 3)))
        ]
        for person in tracker.update(frame * STEP_NS, seen, CAMERA):
            assert np.isfinite(person.joints).all()
            assert person.rotation @ person.rotation.T == pytest.approx(np.eye(3), abs=1e-6)
