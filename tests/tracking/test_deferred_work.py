# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the deferred work: its choice, its slices, when it ends without a result, and that nobody starves."""

import gc
import weakref
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.tracking.deferred_work import FRAME_BUDGET, WINDOW_COST, DeferredWork
from mocap_ros.tracking.hypotheses import CheckOutcome, HypothesisChecker
from mocap_ros.tracking.schedule import CheckSchedule, Classification
from mocap_ros.tracking.slices import Slices
from mocap_ros.tracking.state import BegunWork, TrackerState, WorkKind
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS, make_detection, track_walk

S = 10**9  # ns
FRAMES = 61
CONFIG = with_values(Config(), {'solver.prior': 'pca', 'tracker.components': 10})
CHECK_SLICES, CHECK_COST = 20, 12_000
WALK = Motion(MotionKind.PERIODIC, 'walk', 0.01, 1.0)


@dataclass(frozen=True, eq=False)
class IdleChecker(HypothesisChecker):
    """Finds that every solution is the likeliest, in slices of known cost.

    Attributes:
        costs: those of the slices that were done.
        checked: ids of the people who were checked, in this order.
        classified: ids of the people who were classified, in this order.
    """

    costs: list[int] = field(default_factory=list)
    checked: list[str] = field(default_factory=list)
    classified: list[str] = field(default_factory=list)

    def reinitialise(self, track: Track, model_names: Iterable[str]) -> Slices[CheckOutcome]:  # noqa: ARG002
        for _ in range(CHECK_SLICES):
            yield CHECK_COST
            self.costs.append(CHECK_COST)
        self.checked.append(track.id)
        return CheckOutcome(track.solved, False, (), ())

    def classify_motion(self, track: Track) -> Slices[Classification | None]:
        yield CHECK_COST
        self.classified.append(track.id)
        return None


@pytest.fixture(scope='module')
def track(walk_model: BasePoses) -> Track:
    """A track of two seconds."""
    tracker = track_walk({'walk': walk_model}, CONFIG, make_walk(walk_model, FRAMES)[2])
    (track,) = tracker.snapshot().tracks
    return track


@pytest.fixture(scope='module')
def models(walk_model: BasePoses) -> dict[str, BasePoses]:
    return {'jump': load_base_poses('jump').truncate(10), 'walk': walk_model.truncate(10)}


@pytest.fixture
def work(models: dict[str, BasePoses]) -> DeferredWork:
    return DeferredWork(HypothesisChecker(models, CONFIG), ('jump', 'walk'), 0.5)


def with_schedule(
    track: Track, name: str, check_ns: int, classification_ns: int, interval_s: float = 0.1
) -> Track:
    schedule = CheckSchedule(check_ns, interval_s, next_classification_ns=classification_ns)
    return replace(track, id=name, schedule=schedule)


def make_state(*tracks: Track) -> TrackerState:
    """Return the state after a frame that shows these people."""
    (stamp_ns,) = {t.seen.stamps_ns[-1] for t in tracks}
    return TrackerState(tracks, newest_stamp_ns=stamp_ns, is_work_pending=True)


def move_to(track: Track, stamp_ns: int, first_stamp_ns: int | None = None) -> Track:
    """Return the track with another stamp of its newest frame."""
    first = track.seen.first_stamp_ns if first_stamp_ns is None else first_stamp_ns
    stamps_ns = (*track.seen.stamps_ns[:-1], stamp_ns)
    return replace(track, seen=replace(track.seen, first_stamp_ns=first, stamps_ns=stamps_ns))


def advance(work: DeferredWork, state: TrackerState) -> TrackerState:
    """Return the state after the slices that follow its newest frame."""
    for after in work.advance(state):
        state = after
    return state


def finish(work: DeferredWork, state: TrackerState) -> TrackerState:
    """Return the state after the work that is due, as if frames without news followed."""
    state = advance(work, state)
    while state.begun_work is not None:
        state = advance(work, replace(state, is_work_pending=True))
    return state


def begin(work: DeferredWork, state: TrackerState) -> BegunWork:
    """Return the work that begins after a frame."""
    begun = advance(work, state).begun_work
    assert begun is not None
    return begun


def test_the_work_that_is_latest_in_proportion_to_its_interval_begins(track: Track, work: DeferredWork) -> None:
    now = track.seen.stamps_ns[-1]
    late = now + STEP_NS
    new = with_schedule(track, 'new', now - S // 10, late, interval_s=0.1)  # one interval late
    old = with_schedule(track, 'old', now - S, late, interval_s=2.0)  # half an interval
    begun = begin(work, make_state(old, new))
    assert (begun.track.id, begun.kind) == ('new', WorkKind.CHECK)
    assert begun.track.schedule.check_count == 1, 'it has begun'
    assert new.schedule.check_count == 0
    later = with_schedule(track, 'old', now - 3 * S, late, interval_s=2.0)
    assert begin(work, make_state(later, new)).track.id == 'old'
    unclassified = with_schedule(
        track, 'moving', late, now - S
    )  # two intervals of half a second, the others 1.5, 1
    begun = begin(work, make_state(later, new, unclassified))
    assert (begun.track.id, begun.kind) == ('moving', WorkKind.CLASSIFICATION)


def test_interrupted_work_ends_with_the_object_that_does_it(track: Track, models: dict[str, BasePoses]) -> None:
    """It holds some MB, and Python's garbage collections may not come for an hour."""
    work = DeferredWork(IdleChecker(models, CONFIG), ('walk',), 0.5, frame_budget=1)
    state = advance(work, make_state(with_schedule(track, 'anna', track.seen.stamps_ns[-1], 100 * S)))
    assert state.begun_work is not None
    watched: list[weakref.ref[Any]] = [weakref.ref(work), weakref.ref(work._run)]
    gc.disable()
    try:
        del work
        assert [reference() for reference in watched] == [None, None]
    finally:
        gc.enable()


def test_only_people_of_the_newest_frame_are_checked_and_only_once(track: Track, work: DeferredWork) -> None:
    now = track.seen.stamps_ns[-1]
    late = now + S
    assert advance(work, make_state(with_schedule(track, 'ann', late, late))).begun_work is None
    undetected = move_to(with_schedule(track, 'bob', 0, 0), now - STEP_NS)
    state = replace(make_state(with_schedule(track, 'ann', late, late)), tracks=(undetected,))
    assert advance(work, state).begun_work is None
    state = advance(work, make_state(with_schedule(track, 'ann', 0, late)))
    assert (state.begun_work is None, state.is_work_pending) == (False, False)
    assert list(work.advance(state)) == [], 'the slices of this frame are done'


def test_a_frame_is_followed_by_as_many_slices_as_the_budget_allows(
    track: Track,
) -> None:
    checker = IdleChecker({}, CONFIG)
    work = DeferredWork(checker, ('walk',), 0.5)
    state = make_state(with_schedule(track, 'ann', 0, track.seen.stamps_ns[-1] + S))
    running, counts = state, [0]
    while counts == [0] or running.begun_work is not None:
        running = advance(work, replace(running, is_work_pending=True))
        counts.append(len(checker.costs))
    first = (FRAME_BUDGET - WINDOW_COST) // CHECK_COST
    whole = FRAME_BUDGET // CHECK_COST
    assert first < whole
    per_frame = np.diff(counts).tolist()
    assert per_frame[:-1] == [first] + [whole] * (len(per_frame) - 2)
    assert sum(per_frame) == CHECK_SLICES
    work = DeferredWork(checker, ('walk',), 0.5, frame_budget=1)
    for frame in range(4):
        state = advance(work, replace(state, is_work_pending=True))
        assert state.begun_work is not None
        assert state.begun_work.slices_done == frame + 1, 'one slice is always done'


def test_nobody_starves_and_new_people_come_first(track: Track) -> None:
    """Forty people want more than can be done; one of them is new."""
    checker = IdleChecker({}, CONFIG)
    work = DeferredWork(checker, ('walk',), 5.0)
    first_ns = track.seen.stamps_ns[-1]
    known = [replace(track, solution=replace(track.solved, model_name='walk'))] * 40
    state = TrackerState(tuple(with_schedule(t, f'old {i}', first_ns, first_ns, 5.0) for i, t in enumerate(known)))
    new_checks = 0
    for frame in range(1, 1500):
        now = first_ns + frame * STEP_NS
        tracks = [move_to(t, now) for t in state.tracks]
        if frame == 1:
            tracks = [move_to(t, now, first_stamp_ns=-100 * S) for t in tracks]
        if frame == 900:
            tracks.append(move_to(with_schedule(track, 'new', now + S // 10, now, 0.1), now, first_stamp_ns=now))
        state = replace(state, tracks=tuple(tracks), newest_stamp_ns=now, is_work_pending=True)
        state = advance(work, state)
        if frame == 930:
            new_checks = checker.checked.count('new')
    assert new_checks >= 2, 'within the first second'
    counts = Counter(checker.checked)
    old = [counts[f'old {i}'] for i in range(40)]
    assert min(old) >= 3
    assert max(old) <= min(old) + 2, 'about equally often'
    assert set(checker.classified) == set(checker.checked)


def test_work_that_fails_is_not_repeated_for_ever(track: Track, models: dict[str, BasePoses]) -> None:
    """The next check is that of the next model; here the first model of the two does not exist."""
    work = DeferredWork(HypothesisChecker(models, CONFIG), ('missing', 'walk'), 0.5)
    state = make_state(with_schedule(track, 'ann', 0, track.seen.stamps_ns[-1] + S))
    slices = work.advance(state)
    state = next(slices)
    with pytest.raises(KeyError, match='missing'):
        list(slices)
    (failed,) = state.tracks
    assert (state.begun_work, state.is_work_pending, failed.schedule.check_count) == (None, False, 1)
    assert failed.schedule.next_check_ns > track.seen.stamps_ns[-1]
    due = replace(failed, schedule=replace(failed.schedule, next_check_ns=0))
    (after,) = finish(work, make_state(due)).tracks
    assert after.schedule.check_count == 2
    assert after.schedule.next_check_ns > track.seen.stamps_ns[-1]


@pytest.mark.parametrize(
    ('checked_model', 'restarts', 'age_s', 'is_found'),
    [('walk', 0, 9.0, True), ('jump', 0, 9.0, False), ('jump', 1, 9.0, True), ('jump', 0, 0.9, True)],
)
def test_only_a_check_from_scratch_finds_another_heading(
    track: Track, models: dict[str, BasePoses], checked_model: str, restarts: int, age_s: float, is_found: bool
) -> None:
    """A check of another model starts from the poses so far, unless the solution may be wrong."""
    right, newest_ns = track.solved.rotation[-1], track.seen.stamps_ns[-1]
    half_turn = np.diag([-1.0, -1.0, 1.0])
    wrong = replace(track.solved, rotation=track.solved.rotation @ half_turn, theta=0 * track.solved.theta)
    seen = replace(track.seen, first_stamp_ns=newest_ns - round(age_s * S))
    names = (checked_model, 'walk' if checked_model == 'jump' else 'jump')
    work = DeferredWork(HypothesisChecker(models, CONFIG), names, 0.5)
    late = CheckSchedule(pending_restarts=restarts, next_classification_ns=newest_ns + S)
    (after,) = finish(work, make_state(replace(track, seen=seen, solution=wrong, schedule=late))).tracks
    same_heading = np.trace(after.solved.rotation[-1] @ right.T) > 2  # less than 60 degrees apart
    assert same_heading == is_found
    assert after.schedule.check_count == 1
    assert after.schedule.next_check_ns > newest_ns


@pytest.mark.parametrize('kind', list(WorkKind))
@pytest.mark.parametrize(
    ('event', 'is_ended', 'is_due'),
    [
        ('nothing', False, False),
        ('person forgotten', True, False),
        ('another person of the same id', True, False),
        ('camera', True, True),
        ('sides', True, True),
        ('noise', True, True),
    ],
)
def test_work_ends_where_its_track_is_not_what_it_was(
    track: Track, work: DeferredWork, kind: WorkKind, event: str, is_ended: bool, is_due: bool
) -> None:
    newest_ns = track.seen.stamps_ns[-1]
    late = newest_ns + 9 * S
    due = (0, late) if kind is WorkKind.CHECK else (late, 0)
    state = advance(work, make_state(with_schedule(track, 'ann', *due)))
    begun = state.begun_work
    assert begun is not None
    assert begun.kind is kind
    (now,) = state.tracks
    if event == 'camera':
        now = now.change_camera(replace(CAMERA, focal=600.0), 600.0)
    elif event == 'sides':
        is_swapped = now.seen.swap_filter.is_swapped.copy()
        is_swapped[-3] = True
        swapped = replace(now.seen.swap_filter, is_swapped=is_swapped)
        now = replace(now, seen=replace(now.seen, swap_filter=swapped))
    elif event == 'noise':
        now = replace(now, schedule=replace(now.schedule, baseline_noise=now.solved.noise / 2))
        if kind is WorkKind.CLASSIFICATION:
            return  # a classification needs no other model
    elif event == 'another person of the same id':
        now = move_to(now, newest_ns, first_stamp_ns=newest_ns - S // 2)
    tracks = () if event == 'person forgotten' else (now,)
    state = next(work.advance(replace(state, tracks=tracks, is_work_pending=True)))
    if not is_ended:
        assert state.begun_work is None, 'it is not in the state while its slices are done'
        assert state.tracks == (now,)
        return
    assert state.begun_work is None
    if not is_due:
        assert all(t.schedule is now.schedule for t in state.tracks)
        return
    (after,) = state.tracks  # the same work has begun again
    counts = after.schedule.check_count - now.schedule.check_count
    assert counts == (1 if kind is WorkKind.CHECK else 0)


def test_slices_that_are_done_again_give_the_same(track: Track, models: dict[str, BasePoses]) -> None:
    """A state that is restored in the middle goes on as if its slices had not been lost."""
    state = make_state(with_schedule(track, 'ann', 0, track.seen.stamps_ns[-1] + S))
    first, second = (DeferredWork(HypothesisChecker(models, CONFIG), ('jump',), 0.5) for _ in range(2))
    middle = advance(first, state)
    assert middle.begun_work is not None
    (a,), (b,) = (
        finish(first, replace(middle, is_work_pending=True)).tracks,
        finish(second, replace(middle, is_work_pending=True)).tracks,
    )
    assert (a.solved.theta == b.solved.theta).all()
    assert a.schedule.check_count == b.schedule.check_count == 1


def test_an_answer_is_taken_over_into_the_frames_that_came_meanwhile(
    track: Track, models: dict[str, BasePoses], walk_model: BasePoses
) -> None:
    """The new frames follow the solution that was found, and keep the person's movement."""
    points = make_walk(walk_model, FRAMES + 1)[2]
    newest_ns = track.seen.stamps_ns[-1]
    half_turn = np.diag([-1.0, -1.0, 1.0])
    turned = replace(track.solved, rotation=track.solved.rotation @ half_turn, theta=0 * track.solved.theta)
    schedule = CheckSchedule(next_classification_ns=newest_ns + S)
    wrong = replace(track, solution=turned, schedule=schedule)
    work = DeferredWork(HypothesisChecker(models, CONFIG), ('walk',), 0.5)
    state = advance(work, make_state(wrong))
    assert state.begun_work is not None
    seen = track.seen.add_frame(newest_ns + STEP_NS, make_detection(points[FRAMES]), 0)
    states = (turned.theta[-1:], turned.rotation[-1:], turned.roots[-1:])
    longer = replace(state.tracks[0], seen=seen, solution=turned.append_states(*states, models['walk']))
    state = replace(state, tracks=(longer,), newest_stamp_ns=newest_ns + STEP_NS, is_work_pending=True)
    (after,) = finish(work, state).tracks
    assert len(after.solved.theta) == FRAMES + 1
    for frame in (FRAMES - 1, FRAMES):
        assert np.trace(after.solved.rotation[frame] @ track.solved.rotation[-1].T) > 2


def walk_on(track: Track, *, stops: bool) -> Track:
    """Return the track as one of a walk, at its cadence or with other poses in the newest 0.3 s."""
    solution, count = track.solved, len(track.solved.theta)
    phase = 2 * np.pi * WALK.cadence * np.arange(count)[:, None] * STEP_NS / S
    theta = np.sin(phase + np.arange(solution.theta.shape[1]))
    if stops:
        theta[-9:] = 3.0
    schedule = replace(track.schedule, classification=Classification(WALK, 'walk'))
    return replace(track, solution=replace(solution, theta=theta), schedule=schedule)


def test_periodic_motion_ends_when_the_newest_poses_do_not_repeat_the_last_cycle(
    track: Track, models: dict[str, BasePoses]
) -> None:
    late = track.seen.stamps_ns[-1] + S
    idle = DeferredWork(IdleChecker(models, CONFIG), ('jump', 'walk'), 0.5)
    for stops in (False, True):
        walker = walk_on(with_schedule(track, 'walker', late, late), stops=stops)
        (after,) = advance(idle, make_state(walker)).tracks
        found = after.schedule.classification
        assert (found.motion.kind is MotionKind.NON_PERIODIC) == stops
        assert found.periodic_model_name == ('' if stops else 'walk')


def test_a_classification_that_is_overtaken_by_the_end_of_the_motion_does_not_bring_it_back(
    track: Track, models: dict[str, BasePoses]
) -> None:
    class WalkChecker(IdleChecker):
        def classify_motion(self, track: Track) -> Slices[Classification | None]:  # noqa: ARG002
            yield 10 * CHECK_COST  # more than the budget of a frame
            return Classification(WALK, 'walk')

    work = DeferredWork(WalkChecker(models, CONFIG), ('jump', 'walk'), 0.5)
    now_ns = track.seen.stamps_ns[-1]
    walker = walk_on(with_schedule(track, 'walker', now_ns + S, now_ns), stops=False)
    state = advance(work, make_state(walker))
    assert state.begun_work is not None
    kinds = []
    for stops in (False, True):
        later = replace(walker, solution=walk_on(walker, stops=stops).solution)
        (after,) = finish(work, replace(state, tracks=(later,), is_work_pending=True)).tracks
        kinds.append(after.schedule.classification.motion.kind)
    assert kinds == [MotionKind.PERIODIC, MotionKind.NON_PERIODIC]
