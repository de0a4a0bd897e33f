# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The tracker: people who come and go, stamps out of order, outputs with a lag, equal output for equal input."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mocap_ros.tracking.tracker as tracker_module
from mocap_ros.arrays import Array
from mocap_ros.config import Config, with_settings
from mocap_ros.errors import FrameDropped, SkeletonError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.identities import TENTATIVE_FORGET_S
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.people import People, TrackedFrame
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.tracking.track import find_delayed_frame, find_oldest_needed_ns
from mocap_ros.tracking.tracker import PeopleTracker
from tests.support.synthetic_walk import CAMERA, MIRROR, STEP_NS, UPPER, Walk, feed, make_walk, mpjpe_mm, see

FRAMES = 60
S = 10**9  # ns
APART = np.array([400.0, 0.0])  # px
NOSE_ALONE = [Person2D('', ('nose',), np.zeros((1, 2)), np.ones(1))]


@pytest.fixture(scope='module')
def walk(walk_model: PoseModel) -> Walk:
    return make_walk(walk_model, FRAMES)


@pytest.fixture(scope='module')
def points(walk: Walk) -> Array:
    return walk.points


def make_tracker(model: PoseModel, **values: object) -> PeopleTracker:
    """Return a tracker with these parameters of its own and a simple model."""
    own = {f'tracker.{name}': value for name, value in values.items()}
    return PeopleTracker(
        model, with_settings(Config(), {'solver.components': 8, 'solver.prior_weight': 1e-5, **own})
    )


@pytest.fixture
def tracker(walk_model: PoseModel) -> PeopleTracker:
    return make_tracker(walk_model)


def describe(people: People) -> list[tuple[str, str]]:
    return [(p.id, 'tentative' if p.tentative else 'predicted' if p.predicted else 'seen') for p in people]


def test_a_walk_is_reconstructed(walk_model: PoseModel, walk: Walk, tracker: PeopleTracker) -> None:
    people = feed(tracker, walk.points[:40])
    truth, found = walk.poses(walk_model), np.array([person.core for person in people])
    errors = [mpjpe_mm(found[f : f + 1], truth[f : f + 1]) for f in range(10, 40)]
    assert np.mean(errors) < 1.1 * 25.2  # mm, measured
    assert {person.id for person in people} == {'person_1'}
    assert not any(person.inferred[:CORE_COUNT].any() for person in people)
    depth = CAMERA.focal / walk.cameras.scale[39] * Config().tracker.body_height / walk_model.stature
    assert found[-1, :, 2].mean() == pytest.approx(depth, rel=1.1 * 0.051)  # measured: 0.051
    assert found[-1].mean(axis=0)[:2] == pytest.approx([0, 0], abs=0.05)


@pytest.mark.parametrize('lag', [0.0, 0.2])
@pytest.mark.parametrize('event', ['reset', 'jump back', 'absence'])
def test_a_tracker_begins_anew(walk_model: PoseModel, points: Array, event: str, lag: float) -> None:
    def update(tracker: PeopleTracker, stamp_ns: int, frame: int) -> TrackedFrame:
        seen = [see(points[frame]), see(points[frame] + APART), see(np.full((15, 2), 100.0))]  # a dot is no person
        return tracker.update(stamp_ns, seen, CAMERA)

    values = {'lag': lag, 'restart_after': 0.25, 'forget_all_after': 3.0}
    used, new = make_tracker(walk_model, **values), make_tracker(walk_model, **values)
    for frame in range(20):
        assert update(used, 10 * S + frame * STEP_NS, frame + 10).unusable == 1
    newest, jump_s = 10 * S + 19 * STEP_NS, 0.0
    if event == 'reset':
        used.reset()
        assert (used.tracks, [then.ids for then in used.predict((0.1,))]) == ([], [()])
        begin = 0
    elif event == 'jump back':
        with pytest.raises(FrameDropped, match='older'):
            update(used, newest - S // 4, 0)
        with pytest.raises(SkeletonError):
            used.update(1, NOSE_ALONE, CAMERA)
        begin, jump_s = newest - S // 4 - 1, 0.25
    else:
        begin = newest + 4 * S
        for stamp_ns in range(newest + STEP_NS, begin, STEP_NS):
            assert not len(used.update(stamp_ns, [], CAMERA).people) or stamp_ns < newest + S + STEP_NS
        new.update(stamp_ns, [], CAMERA)
        with pytest.raises(FrameDropped):
            used.update(stamp_ns - STEP_NS, [], CAMERA)
    for frame in range(20):
        found, expected = (update(tracker, begin + frame * STEP_NS, frame) for tracker in (used, new))
        np.testing.assert_equal(vars(found.people), vars(expected.people))
        assert found.backward_jump_s == pytest.approx(0 if frame else jump_s)
    assert {*found.people.ids} == {'person_1', 'person_2'}


def test_lost_people_are_predicted_and_later_forgotten(walk_model: PoseModel, points: Array) -> None:
    tracker = make_tracker(walk_model, predict_for=0.2)
    assert not len(tracker.update(0, [], CAMERA).people)
    last = feed(tracker, points[:12] + 3.0 * np.arange(12)[:, None, None] * [1, 0], STEP_NS)[-1]
    (gone,) = tracker.update(14 * STEP_NS, [], CAMERA).people
    assert (gone.id, gone.predicted, last.predicted) == ('person_1', True, False)
    assert gone.inferred.all()
    few = see(points[12], score=np.arange(15) < 3)
    assert tracker.update(15 * STEP_NS, [few], CAMERA).people[0].predicted
    assert tracker.update(12 * STEP_NS + S // 5, [], CAMERA).people[0].predicted
    assert not len(tracker.update(12 * STEP_NS + S // 5 + 1, [], CAMERA).people)
    back = tracker.update(41 * STEP_NS, [see(points[13] + [36.0, 0])], CAMERA).people
    assert describe(back) == [('person_1', 'seen')]
    tracker.update(100 * STEP_NS, [], CAMERA)
    assert tracker.update(200 * STEP_NS, [see(points[2] + [900.0, 0])], CAMERA).people[0].id == 'person_2'


def test_outputs_belong_to_the_caller_and_deferred_work_keeps_them(walk_model: PoseModel, points: Array) -> None:
    lazy, eager = make_tracker(walk_model), make_tracker(walk_model)
    for frame in range(30):
        seen = [see(points[frame])]
        expected, found = (tracker.update(frame * STEP_NS, seen, CAMERA).people for tracker in (lazy, eager))
        for field in fields(found):
            value, before = getattr(found, field.name), getattr(expected, field.name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, before)
                value[...] = -7
        eager.run_deferred_work()


def test_swapped_frames_are_undone_and_counted(walk_model: PoseModel, points: Array) -> None:
    plain, disturbed = make_tracker(walk_model), make_tracker(walk_model)
    swapped = points[:40].copy()
    swapped[[20, 21, 30]] = swapped[[20, 21, 30]][:, MIRROR]
    counts = [0, 0]
    for frame, shown in enumerate(zip(points[:40], swapped, strict=True)):
        one, other = (
            tracker.update(frame * STEP_NS, [see(own)], CAMERA)
            for tracker, own in zip((plain, disturbed), shown, strict=True)
        )
        np.testing.assert_array_equal(one.people.joints, other.people.joints)
        counts = [counts[0] + one.swapped, counts[1] + other.swapped]
    assert counts == [0, 3]


@pytest.mark.parametrize(('lag', 'window', 'delay'), [(0.09, 2, 3), (0.22, 0.2, 7), (0.5, 2, 15), (2.0, 2, 60)])
def test_with_a_lag_every_visit_is_output_once_in_order_to_its_end(
    walk_model: PoseModel, points: Array, lag: float, window: float, delay: int
) -> None:
    """A person is forgotten 1 s after the last detection, and frames of the window leave it earlier."""
    tracker = make_tracker(walk_model, lag=lag, window=window)
    jitter_ns = np.random.default_rng(2).integers(-8_000_000, 8_000_000, 140)
    given, shown, stamps_ns = [], {}, []
    for frame in range(140):
        given.append(int(STEP_NS * (frame + 1) + jitter_ns[frame]))
        is_there = 5 <= frame < 25 or 30 <= frame < 60
        out = tracker.update(given[-1], [see(points[frame % 40])] if is_there else [], CAMERA)
        stamps_ns.append(out.stamp_ns)
        if len(out.people):
            shown[given.index(stamps_ns[-1])] = frame
    assert stamps_ns == sorted(stamps_ns)
    assert list(shown) == [*range(5, 25), *range(30, 60)]
    assert {frame - first for first, frame in shown.items()} <= {delay - 1, delay, delay + 1}


@given(steps_ms=st.lists(st.integers(1, 400), min_size=2, max_size=60), lag_s=st.floats(0.001, 1.0))
def test_stamps_never_go_back_and_delays_are_bounded(steps_ms: list[int], lag_s: float) -> None:
    stamps_ns = [int(s) for s in np.cumsum(steps_ms) * 1_000_000]
    waiting: list[int] = []
    out, has_begun = [], False
    for stamp_ns in stamps_ns:
        waiting.append(stamp_ns)
        first, has_begun = find_delayed_frame(waiting, lag_s, has_begun=has_begun)
        waiting = waiting[first:]
        if has_begun:
            out.append((stamp_ns, waiting[0]))
    shown = [s for _, s in out]
    assert shown == sorted(shown)
    for now_ns, shown_ns in out[1:]:
        index = stamps_ns.index(shown_ns)
        assert now_ns - shown_ns >= lag_s / 2 * S - 1
        following_ns = stamps_ns[index + 1] if index + 1 < len(stamps_ns) else now_ns
        assert now_ns - following_ns <= 1.5 * lag_s * S + 1, 'a later frame is older than the lag by a half'
        needed = [s for s in stamps_ns if s <= find_oldest_needed_ns(now_ns, lag_s)]
        assert not needed or shown_ns >= needed[-1]


@pytest.mark.parametrize('lens', [Distortion(), Distortion('plumb_bob', (-0.2, 0.05, 0.001, -0.002, 0.0))])
def test_a_person_near_and_off_the_axis_is_located(walk_model: PoseModel, walk: Walk, lens: Distortion) -> None:
    camera = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True, distortion=lens)
    poses = walk.poses(walk_model)[:45] * Config().tracker.body_height / walk_model.stature
    joints = poses + [0.5, 0.1, 3.0] + 0.01 * np.arange(45)[:, None, None] * [1, 0, 0]
    config = with_settings(Config(), {'solver.components': 8, 'tracker.steady_output': False})
    tracker = PeopleTracker(walk_model, config)
    person = feed(tracker, camera.project(joints), camera=camera)[-1]
    assert np.linalg.norm(person.core - joints[-1], axis=-1).mean() < 1.1 * 0.0602  # m, measured
    reprojection_error = np.linalg.norm(camera.project(person.core) - camera.project(joints[-1]), axis=-1)
    assert reprojection_error.max() < 1.1 * 2.9  # px, measured


def test_hidden_joints_are_inferred_and_flagged(tracker: PeopleTracker, points: Array) -> None:
    hidden = np.isin(np.arange(15), [3, 4])
    for frame, image in enumerate(points[:10]):
        seen = see(np.where(hidden[:, None], np.nan, image), score=~hidden)
        (person,) = tracker.update(frame * STEP_NS, [seen], CAMERA).people
        np.testing.assert_array_equal(person.inferred[:CORE_COUNT], hidden)
        assert person.inferred[CORE_COUNT:].all()
        assert np.isfinite(person.joints).all()


@settings(max_examples=25)
@given(data=st.data())
def test_arbitrary_keypoints_give_finite_output(walk_model: PoseModel, data: st.DataObject) -> None:
    tracker = make_tracker(walk_model)
    numbers = st.lists(st.sampled_from([np.nan, 1e200]) | st.floats(-1e7, 1e7), min_size=30, max_size=30)
    names = st.sampled_from(['', 'a', 'b'])
    scores = st.lists(st.just(np.inf) | st.floats(0, 1), min_size=15, max_size=15)
    for frame in range(data.draw(st.integers(1, 5))):
        seen = []
        for i in range(data.draw(st.integers(0, 3))):
            drawn, name = np.reshape(data.draw(numbers), (15, 2)), data.draw(names) if i == 0 else ''
            seen.append(see(drawn, name, data.draw(scores)))
        for person in tracker.update(frame * STEP_NS, seen, CAMERA).people:
            assert np.isfinite(person.joints).all()
            assert person.rotation @ person.rotation.T == pytest.approx(np.eye(3), abs=1e-6)


@pytest.mark.parametrize(
    ('owner', 'stage', 'focal', 'bob', 'ann'),
    [
        *(
            ('module', stage, 500.0, 'tentative', 'tentative')
            for stage in ('refine', 'make_people', 'follow_motion')
        ),
        ('track', 'change_camera', 600.0, 'tentative', 'seen'),  # of bob alone
        ('tracker', '_forget_lost', 600.0, 'seen', 'seen'),
    ],
)
def test_a_fault_forgets_the_people_whom_it_concerns_and_the_stream_goes_on(
    tracker: PeopleTracker,
    points: Array,
    monkeypatch: pytest.MonkeyPatch,
    owner: str,
    stage: str,
    focal: float,
    bob: str,
    ann: str,
) -> None:
    def update(frame: int, intrinsics: Intrinsics) -> list[tuple[str, str]]:
        seen = [see(points[frame], 'bob'), see(points[frame] + APART, 'ann')]
        return describe(tracker.update(frame * STEP_NS, seen, intrinsics).people)

    def fail(*_given: object, **_named: object) -> None:
        raise ZeroDivisionError('a fault')

    for frame in range(6):
        update(frame, CAMERA)
    owners, other = (
        {'module': tracker_module, 'track': tracker.tracks[0], 'tracker': tracker},
        replace(CAMERA, focal=focal),
    )
    with monkeypatch.context() as patch:
        patch.setattr(owners[owner], stage, fail)
        with pytest.raises(ZeroDivisionError):
            update(6, other)
    with pytest.raises(FrameDropped, match='repeats'):
        update(6, other)
    assert sorted(update(7, other)) == [('ann', ann), ('bob', bob)]


def test_a_tentative_person_is_never_predicted_and_costs_no_deferred_work(
    tracker: PeopleTracker, points: Array
) -> None:
    ghosts = 0
    for frame in range(12):
        seen = [see(points[frame])] + ([see(points[frame] + APART)] if frame == 6 else [])
        people = describe(tracker.update(frame * STEP_NS, seen, CAMERA).people)
        tracker.run_deferred_work()
        begun = tracker._deferred_work.begun
        assert begun is None or begun.track.id == 'person_1'
        ghosts += len(people) > 1
        if len(people) > 1:
            assert people == [('person_1', 'seen'), ('person_2', 'tentative')]
    assert ghosts == 1
    tracker.update((12 + round(TENTATIVE_FORGET_S * 30)) * STEP_NS, [], CAMERA)
    assert [t.id for t in tracker.tracks] == ['person_1']


def test_a_person_who_comes_back_while_the_track_is_kept_is_certain(tracker: PeopleTracker, points: Array) -> None:
    def update(stamp_ns: int, *seen: Person2D) -> list[tuple[str, str]]:
        return describe(tracker.update(stamp_ns, seen, CAMERA).people)

    for frame in range(5):
        update(frame * STEP_NS, see(points[0], 'ann'))
    assert update(5 * STEP_NS + 600_000_000) == []
    assert update(5 * STEP_NS + 700_000_000, see(points[0] + 5, 'new')) == [('ann', 'seen')]
    assert update(10 * S, see(points[0], 'ann')) == [('ann', 'seen')], 'after silence'
    update(20 * S)
    assert update(20 * S + STEP_NS, see(points[0], 'ann')) == [('ann', 'tentative')], 'who was forgotten is new'


@pytest.mark.parametrize(('name', 'seed'), [('p', 0), ('', 1)])
def test_fragments_and_new_ids_make_no_people(tracker: PeopleTracker, points: Array, name: str, seed: int) -> None:
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
        whole = UPPER if kind == 'broken' else 1.0
        return [see(person, first, whole), see(person + rng.normal(0, 1, (15, 2)), second, ~UPPER)]

    detections = people = unusable = 0
    for frame in range(FRAMES):
        both = (points[frame], f'{name}1' if name else ''), (points[frame] + APART, f'{name}2' if name else '')
        seen = [d for body, own in both for d in (disturb(body, own) if frame else [see(body, own)])]
        order = rng.permutation(len(seen)) if frame else [0, 1]
        tracked = tracker.update(frame * STEP_NS, [seen[i] for i in order], CAMERA)
        published = describe(tracked.people)
        expected = 'tentative' if frame < 2 else 'seen'
        names = (f'{name}1', f'{name}2') if name else ('person_1', 'person_2')
        assert sorted(published) == [(n, expected) for n in names], frame
        detections, people = detections + len(seen), people + len(published)
        unusable += tracked.unusable
    assert detections > 1.1 * people
    assert unusable == detections - people
