# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the tracker: people who come and go, stamps out of order, and equal output for equal input."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mocap_ros.tracking.tracker as tracker_module
from mocap_ros.config import Config, with_settings
from mocap_ros.errors import FrameDropped, SkeletonError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15, CORE_COUNT
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import Walk, make_walk

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
STEP_NS = 33_333_333
CONFIG = with_settings(Config(), {'solver.components': 8, 'solver.prior_weight': 1e-5})


def people(points: np.ndarray, frame: int, ids: Sequence[str] = ('',), apart: float = 400.0) -> list[Person2D]:
    return [
        Person2D(name, CMU15.joints, points[frame] + [apart * i, 0], np.ones(15)) for i, name in enumerate(ids)
    ]


@pytest.fixture
def walk(walk_model: BasePoses) -> Walk:
    return make_walk(walk_model, frames=40)


def test_a_walk_is_reconstructed(walk_model: BasePoses, walk: Walk) -> None:
    theta, cameras, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    error = []
    for frame in range(len(points)):
        (person,) = tracker.update(frame * STEP_NS, people(points, frame), CAMERA)
        truth = walk_model.poses(theta[frame]) @ cameras.rotation[frame].T
        pose = person.core - person.core.mean(axis=0)
        pose *= (pose * truth).sum() / (pose * pose).sum()
        error.append(np.linalg.norm(pose - truth, axis=-1).mean() * 1e3)
        assert person.id == 'person_1'
        assert not person.inferred[:CORE_COUNT].any()
    assert np.mean(error[10:]) < 1.1 * 25.2  # mm, measured
    depth = CAMERA.focal / cameras.scale[-1] * CONFIG.tracker.body_height / walk_model.stature
    assert person.core[:, 2].mean() == pytest.approx(depth, rel=1.1 * 0.051)  # measured: 0.051
    assert person.core.mean(axis=0)[:2] == pytest.approx([0, 0], abs=0.05)


def test_old_and_repeated_stamps_are_dropped_and_change_nothing(walk_model: BasePoses, walk: Walk) -> None:
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


@pytest.mark.parametrize('restart_after', [1.0, 0.25])
def test_a_large_backward_jump_of_stamps_restarts_the_tracker(
    walk_model: BasePoses, walk: Walk, restart_after: float
) -> None:
    _, _, points, _ = walk
    config = with_settings(CONFIG, {'tracker.restart_after': restart_after})
    tracker, fresh = Tracker(walk_model, config), Tracker(walk_model, config)
    limit_ns = round(restart_after * 1e9)
    for frame in range(4):
        tracker.update(10**10 + frame * STEP_NS, people(points, frame + 20), CAMERA)
    newest = 10**10 + 3 * STEP_NS
    with pytest.raises(FrameDropped, match='older'):
        tracker.update(newest - limit_ns, people(points, 0), CAMERA)
    with pytest.raises(SkeletonError):
        tracker.update(1, [Person2D('', ('nose',), np.zeros((1, 2)), np.ones(1))], CAMERA)
    start = newest - limit_ns - 1
    for frame in range(4):
        (a,) = tracker.update(start + frame * STEP_NS, people(points, frame), CAMERA)
        (b,) = fresh.update(start + frame * STEP_NS, people(points, frame), CAMERA)
        assert (a.joints == b.joints).all()
        assert tracker.backward_jump_s == pytest.approx(0 if frame else restart_after)


def test_lost_people_are_predicted_and_later_forgotten(walk_model: BasePoses, walk: Walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, with_settings(CONFIG, {'tracker.predict_for': 0.2}))
    assert tracker.update(0, [], CAMERA) == ()
    for frame in range(12):
        (last,) = tracker.update((frame + 1) * STEP_NS, people(points + np.array([3.0 * frame, 0]), frame), CAMERA)
    (gone,) = tracker.update(14 * STEP_NS, [], CAMERA)
    assert (gone.id, gone.predicted, last.predicted) == ('person_1', True, False)
    assert gone.inferred.all()
    few = people(points, 12)
    few[0].score[3:] = 0
    assert tracker.update(15 * STEP_NS, few, CAMERA)[0].predicted
    assert tracker.update(12 * STEP_NS + 200_000_000, [], CAMERA)[0].predicted
    assert tracker.update(12 * STEP_NS + 200_000_001, [], CAMERA) == ()
    back = tracker.update(41 * STEP_NS, people(points + [36.0, 0], 13), CAMERA)
    assert [(p.id, p.predicted) for p in back] == [('person_1', False)]
    tracker.update(100 * STEP_NS, [], CAMERA)
    assert tracker.update(200 * STEP_NS, people(points + [900.0, 0], 2), CAMERA)[0].id == 'person_2'


def test_a_reset_restores_the_initial_state_but_keeps_counting(walk_model: BasePoses, walk: Walk) -> None:
    tracker = Tracker(walk_model, CONFIG)
    dot = Person2D('', CMU15.joints, np.full((15, 2), 100.0), np.ones(15))  # no person
    runs = []
    for _ in range(2):
        runs.append([tracker.update(f * STEP_NS, [*people(walk[2], f), dot], CAMERA)[0].joints for f in range(5)])
        tracker.reset()
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (tracker.tracks, tracker.unusable_people, tracker.predict((0.1,))) == ([], 10, [[]])


def test_outputs_belong_to_the_caller_and_early_deferred_work_does_not_change_them(
    walk_model: BasePoses, walk: Walk
) -> None:
    lazy, eager = Tracker(walk_model, CONFIG), Tracker(walk_model, CONFIG)
    for frame in range(30):
        given = people(walk[2], frame)
        (expected,) = lazy.update(frame * STEP_NS, given, CAMERA)
        (found,) = eager.update(frame * STEP_NS, given, CAMERA)
        for field in fields(found):
            value, before = getattr(found, field.name), getattr(expected, field.name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, before)
                value[...] = -7
        eager.run_deferred_work()


def test_swapped_frames_are_undone_and_counted(walk_model: BasePoses, walk: Walk) -> None:
    plain, disturbed = Tracker(walk_model, CONFIG), Tracker(walk_model, CONFIG)
    for frame in range(len(walk[2])):
        (a,) = plain.update(frame * STEP_NS, people(walk[2], frame), CAMERA)
        seen = walk[2][:, np.array(CMU15.mirror)] if frame in (20, 21, 30) else walk[2]
        (b,) = disturbed.update(frame * STEP_NS, people(seen, frame), CAMERA)
        assert (a.joints == b.joints).all(), frame
    assert (plain.swapped_frames, disturbed.swapped_frames) == (0, 3)


@pytest.mark.parametrize(
    ('lag', 'window', 'delay'), [(0.09, 2.0, 3), (0.3, 0.2, 9), (0.5, 2.0, 15), (2.0, 2.0, 60)]
)
def test_with_a_lag_every_visit_is_output_once_in_order_to_its_end(
    walk_model: BasePoses, walk: Walk, lag: float, window: float, delay: int
) -> None:
    """A person is forgotten 1 s after the last detection, and frames of the window leave it earlier."""
    tracker = Tracker(walk_model, with_settings(CONFIG, {'tracker.lag': lag, 'tracker.window': window}))
    jitter_ns = np.random.default_rng(2).integers(-3_000_000, 3_000_000, 140)
    given, shown, stamps_ns = [], {}, []
    for frame in range(140):
        given.append(int(STEP_NS * (frame + 1) + jitter_ns[frame]))
        is_there = 5 <= frame < 25 or 30 <= frame < 60
        out = tracker.update(given[-1], people(walk[2], frame % 40) if is_there else [], CAMERA)
        stamps_ns.append(tracker.output_stamp_ns)
        if out:
            shown[given.index(stamps_ns[-1])] = frame
    assert stamps_ns == sorted(stamps_ns)
    assert list(shown) == [*range(5, 25), *range(30, 60)]
    assert {frame - first for first, frame in shown.items()} <= {delay - 1, delay, delay + 1}


@pytest.mark.parametrize('lens', [Distortion(), Distortion('plumb_bob', (-0.2, 0.05, 0.001, -0.002, 0.0))])
def test_a_person_near_the_camera_and_off_its_axis_is_located(walk_model: BasePoses, lens: Distortion) -> None:
    theta, cameras, _, _ = make_walk(walk_model, frames=45)
    camera = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True, distortion=lens)
    size = CONFIG.tracker.body_height / walk_model.stature
    tracker = Tracker(walk_model, with_settings(CONFIG, {'tracker.steady_output': False}))
    for frame in range(45):
        joints = walk_model.poses(theta[frame]) @ cameras.rotation[frame].T * size
        joints = joints + [0.5 + 0.01 * frame, 0.1, 3.0]
        seen = [Person2D('', CMU15.joints, camera.project(joints), np.ones(15))]
        (person,) = tracker.update(frame * STEP_NS, seen, camera)
    assert np.linalg.norm(person.core - joints, axis=-1).mean() < 1.1 * 0.0602  # m, measured
    reprojection_error = np.linalg.norm(camera.project(person.core) - seen[0].points, axis=-1)
    assert reprojection_error.max() < 1.1 * 2.9  # px, measured


def test_hidden_joints_are_inferred_and_flagged(walk_model: BasePoses, walk: Walk) -> None:
    _, _, points, _ = walk
    tracker = Tracker(walk_model, CONFIG)
    for frame in range(10):
        (seen,) = people(points, frame)
        seen.score[[3, 4]] = 0.0
        seen.points[[3, 4]] = np.nan
        (person,) = tracker.update(frame * STEP_NS, [seen], CAMERA)
        assert person.inferred[[3, 4]].all()
        assert person.inferred[:CORE_COUNT].sum() == 2
        assert person.inferred[CORE_COUNT:].all()
        assert np.isfinite(person.joints).all()
    (odd,) = people(points, 10)
    odd.score[:2], odd.points[4:6] = np.inf, [1e200, np.nan]
    (person,) = tracker.update(10 * STEP_NS, [odd], CAMERA)
    assert np.isfinite(person.joints).all()
    assert person.inferred[:CORE_COUNT].sum() == 2


@settings(max_examples=25)
@given(data=st.data())
def test_arbitrary_keypoints_give_finite_output(walk_model: BasePoses, data: st.DataObject) -> None:
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


@pytest.mark.parametrize('stage', ['refine', 'make_people', 'advance_extremities'])
def test_a_fault_forgets_the_people_whom_it_concerns_and_the_stream_goes_on(
    walk_model: BasePoses, walk: Walk, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    tracker, names = Tracker(walk_model, CONFIG), ('bob', 'ann')

    def update(frame: int) -> dict[str, bool]:
        seen = people(walk[2], frame, names)
        return {p.id: p.tentative for p in tracker.update(frame * STEP_NS, seen, CAMERA)}

    for frame in range(6):
        update(frame)
    with monkeypatch.context() as patch:

        def fail(*_given: object, **_named: object) -> None:
            raise ZeroDivisionError('a fault')

        patch.setattr(tracker_module, stage, fail)
        with pytest.raises(ZeroDivisionError):
            update(6)
    with pytest.raises(FrameDropped, match='repeats'):
        update(6)
    assert update(7) == dict.fromkeys(names, True)
