# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People come, are tentative, are delayed, go and are forgotten; detections that are none make no people."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.config import Config, with_settings
from mocap_ros.errors import FrameDropped
from mocap_ros.keypoints.identities import TENTATIVE_FORGET_S
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.delayed_output import find_delayed_frame, find_oldest_needed_ns
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


FORGET_ALL_S = 3.0  # s, in these tests
VISIT_FRAMES = 20  # of a visit


def make_tracker(model: BasePoses, **values: float) -> Tracker:
    settings = {'solver.components': 8, 'solver.prior': 'pca', 'tracker.forget_all_after': FORGET_ALL_S, **values}
    return Tracker(model, with_settings(Config(), settings))


def visit(tracker: Tracker, first_frame: int, points: Array) -> list[tuple[Person3D, ...]]:
    output = []
    for frame in range(VISIT_FRAMES):
        people = [Person2D('', CMU15.joints, points[frame] + [shift, 0], np.ones(15)) for shift in (0, 400)]
        output.append(tracker.update((first_frame + frame) * STEP_NS, people, CAMERA))
    return output


def wait(tracker: Tracker, first_frame: int, seconds: float) -> int:
    last = first_frame + round(seconds * 30)
    for frame in range(first_frame, last):
        assert tracker.update(frame * STEP_NS, [], CAMERA) == () or frame < first_frame + 30
    return last


@pytest.mark.parametrize('lag', [0.0, 0.2])
def test_after_a_long_absence_a_tracker_is_as_new(walk_model: BasePoses, lag: float) -> None:
    points = make_walk(walk_model, VISIT_FRAMES)[2]
    used, new = (make_tracker(walk_model, **{'tracker.lag': lag}) for _ in range(2))
    visit(used, 0, points)
    back = wait(used, VISIT_FRAMES, FORGET_ALL_S + 1.0)
    for tracker in (used, new):
        tracker.update(back * STEP_NS, [], CAMERA)
    later = [visit(tracker, back + 1, points) for tracker in (used, new)]
    found, expected = ([[vars(p) for p in people] for people in visited] for visited in later)
    np.testing.assert_equal(found, expected)
    assert {p.id for p in later[0][-1]} == {'person_1', 'person_2'}
    with pytest.raises(FrameDropped):
        used.update((back - 1) * STEP_NS, [], CAMERA)


def test_after_a_shorter_absence_names_are_remembered(walk_model: BasePoses) -> None:
    points = make_walk(walk_model, VISIT_FRAMES)[2]
    tracker = make_tracker(walk_model)
    visit(tracker, 0, points)
    back = wait(tracker, VISIT_FRAMES, FORGET_ALL_S - 1.0)
    assert {p.id for p in visit(tracker, back, points)[-1]} == {'person_1', 'person_2'}


def delay(stamps_ns: list[int], lag_s: float) -> list[tuple[int, int]]:
    """Return the stamp of each frame with that of the frame that is output after it, both in ns."""
    waiting: list[int] = []
    out, has_begun = [], False
    for stamp_ns in stamps_ns:
        waiting.append(stamp_ns)
        first, has_begun = find_delayed_frame(waiting, lag_s, has_begun=has_begun)
        waiting = waiting[first:]
        if has_begun:
            out.append((stamp_ns, waiting[0]))
    return out


@pytest.mark.parametrize('lag_s', [0.02, 1 / 30, 0.1, 0.22])
def test_one_frame_follows_another_whatever_the_jitter(lag_s: float) -> None:
    jitter = np.random.default_rng(0).uniform(-8, 8, 400)  # ms
    stamps_ns = [int(i * STEP_NS + 1e6 * j) for i, j in enumerate(jitter)]
    shown = [s for _, s in delay(stamps_ns, lag_s)]
    last = stamps_ns.index(shown[-1]) + 1
    assert shown[20:] == stamps_ns[last - len(shown) + 20 : last]


@given(
    steps_ms=st.lists(st.integers(1, 400), min_size=2, max_size=60),
    lag_s=st.floats(0.001, 1.0),
)
def test_stamps_never_go_back_and_delays_are_bounded(steps_ms: list[int], lag_s: float) -> None:
    stamps_ns = [int(s) for s in np.cumsum(steps_ms) * 1_000_000]
    out = delay(stamps_ns, lag_s)
    shown = [s for _, s in out]
    assert shown == sorted(shown)
    for now_ns, shown_ns in out[1:]:
        index = stamps_ns.index(shown_ns)
        assert now_ns - shown_ns >= lag_s / 2 * 1e9 - 1
        following_ns = stamps_ns[index + 1] if index + 1 < len(stamps_ns) else now_ns
        assert now_ns - following_ns <= 1.5 * lag_s * 1e9 + 1, 'a later frame is older than the lag by a half'
        needed = [s for s in stamps_ns if s <= find_oldest_needed_ns(now_ns, lag_s)]
        assert not needed or shown_ns >= needed[-1]
