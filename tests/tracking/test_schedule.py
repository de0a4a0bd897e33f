"""Tests of when a track is checked and classified, and of the choice of the work that is due."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.tracking.deferred_work import MIN_DEFERRED_GAP_S, DeferredWork
from mocap_ros.tracking.hypotheses import HypothesisChecker
from mocap_ros.tracking.schedule import NEW_TRACK_S, CheckSchedule, Classification
from mocap_ros.tracking.state import TrackerState
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import STEP_NS, track_walk

S = 10**9  # ns
PERIODIC = Classification(Motion(MotionKind.PERIODIC, 'walk', 0.01, 0.9), 'walk')
OTHER = Classification(Motion(MotionKind.NON_PERIODIC, 'jump', 0.01, np.nan), '')
CONFIG = with_values(Config(), {'solver.prior': 'pca', 'tracker.components': 10})


def check(schedule: CheckSchedule, stamp_s: float, age_s: float, noise: float = 0.01) -> CheckSchedule:
    """Return the schedule after a check among three models, at most half a second apart."""
    return schedule.begin_check().finish_check(round(stamp_s * S), age_s, 0.5, noise, model_count=3)


def test_checks_become_rarer_with_age() -> None:
    schedule = CheckSchedule().check_after_initialisation(5 * S)
    assert schedule.next_check_ns == 5.1 * S
    intervals = {age_s: check(schedule, 7, age_s).next_check_ns / S - 7 for age_s in (0.1, 0.5, 1.5, 9.0)}
    assert intervals == pytest.approx({0.1: 0.1, 0.5: 0.1, 1.5: 0.3, 9.0: 0.5})


def test_a_new_track_is_solved_from_scratch_at_each_check() -> None:
    assert CheckSchedule().is_from_scratch(NEW_TRACK_S - 0.01)
    assert not CheckSchedule().is_from_scratch(NEW_TRACK_S)


def test_the_noise_after_a_round_of_all_models_is_the_baseline() -> None:
    schedule = CheckSchedule()
    baselines = []
    for number, noise in enumerate([0.01, 0.02, 0.03, 0.04, 0.05, 0.06]):
        schedule = check(schedule, number, age_s=5.0, noise=noise)
        baselines.append(schedule.baseline_noise)
    assert baselines == [np.inf, np.inf, 0.03, 0.03, 0.03, 0.06]


def test_a_rise_of_the_noise_starts_a_round_from_scratch() -> None:
    calm = replace(CheckSchedule(), check_count=3, baseline_noise=0.01, next_check_ns=100 * S)
    assert calm.restart_if_noise_rose(0.0129, 9 * S, 3) is calm
    assert CheckSchedule().restart_if_noise_rose(5.0, 9 * S, 3).pending_restarts == 0, 'no baseline yet'
    schedule = calm.restart_if_noise_rose(0.0131, 9 * S, 3)
    assert (schedule.pending_restarts, schedule.next_check_ns, schedule.baseline_noise) == (3, 9 * S, np.inf)
    pending = []
    for number in range(3):
        assert schedule.is_from_scratch(age_s=60.0)
        schedule = check(schedule, 9 + number, age_s=60.0, noise=0.02)
        pending.append(schedule.pending_restarts)
        assert schedule.next_check_ns == pytest.approx((9 + number + 0.1) * S), 'soon, whatever the age'
    assert pending == [2, 1, 0]
    assert schedule.baseline_noise == 0.02, 'a new round of all models has ended'
    assert not schedule.is_from_scratch(age_s=60.0)
    assert check(schedule, 20, age_s=60.0).next_check_ns == 20.5 * S
    assert (calm.pending_restarts, calm.baseline_noise) == (0, 0.01)


def test_a_baseline_is_not_taken_while_restarts_are_pending() -> None:
    """The round of models may end before the restarts do."""
    schedule = replace(CheckSchedule(), check_count=2, pending_restarts=3)
    assert check(schedule, 1, age_s=9.0).baseline_noise == np.inf


def test_a_periodic_motion_is_classified_less_often() -> None:
    periodic = CheckSchedule().finish_classification(4 * S, PERIODIC)
    assert (periodic.next_classification_ns, periodic.classification_count) == (5 * S, 1)
    assert periodic.classification is PERIODIC
    other = periodic.finish_classification(5 * S, OTHER)
    assert (other.next_classification_ns, other.classification_count) == (5.5 * S, 2)
    assert other.classification is OTHER


def test_a_classification_that_was_not_possible_changes_no_result() -> None:
    first = CheckSchedule().finish_classification(4 * S, None)
    assert (first.next_classification_ns, first.classification_count) == (4.5 * S, 0)
    assert first.classification.motion.kind is MotionKind.UNKNOWN
    periodic = first.finish_classification(5 * S, PERIODIC).finish_classification(6 * S, None)
    assert (periodic.next_classification_ns, periodic.classification_count) == (7 * S, 1)
    assert periodic.classification is PERIODIC


@pytest.fixture(scope='module')
def track(walk_model: BasePoses) -> Track:
    """A track of one second."""
    tracker = track_walk({'walk': walk_model}, CONFIG, make_walk(walk_model, 31)[2])
    (track,) = tracker.snapshot().tracks
    return track


@pytest.fixture(scope='module')
def models(walk_model: BasePoses) -> dict[str, BasePoses]:
    return {'jump': load_base_poses('jump').truncate(10), 'walk': walk_model.truncate(10)}


def with_schedule(track: Track, name: str, check_ns: int, classification_ns: int) -> Track:
    schedule = CheckSchedule(next_check_ns=check_ns, next_classification_ns=classification_ns)
    return replace(track, id=name, schedule=schedule)


def make_state(*tracks: Track) -> TrackerState:
    """Return the state after a frame that shows these people."""
    (stamp_ns,) = {t.seen.stamps_ns[-1] for t in tracks}
    return TrackerState(tracks, newest_stamp_ns=stamp_ns, pending_ids=tuple(t.id for t in tracks))


def test_the_work_that_is_due_longest_is_chosen(track: Track, models: dict[str, BasePoses]) -> None:
    work = DeferredWork(HypothesisChecker(models, CONFIG), ('jump', 'walk'), 0.5)
    now = track.seen.stamps_ns[-1]
    late = now + STEP_NS
    ann, bob = with_schedule(track, 'ann', 500, late), with_schedule(track, 'bob', 600, 400)
    state, chosen = work.choose(make_state(ann, bob))
    assert chosen is not None
    assert (chosen.track.id, chosen.is_classification) == ('bob', True)
    assert (state.last_check_ns, state.pending_ids) == (now, ())
    assert [t.schedule.check_count for t in state.tracks] == [0, 0]

    state, chosen = work.choose(
        make_state(ann, replace(bob, schedule=replace(bob.schedule, next_classification_ns=late)))
    )
    assert chosen is not None
    assert (chosen.track.id, chosen.is_classification) == ('ann', False)
    assert [t.schedule.check_count for t in state.tracks] == [1, 0], 'it has begun'
    assert ann.schedule.check_count == 0

    assert work.choose(make_state(with_schedule(track, 'ann', late, late)))[1] is None
    undetected = replace(make_state(ann, bob), pending_ids=('ann',))
    _, chosen = work.choose(undetected)
    assert chosen is not None
    assert chosen.track.id == 'ann', 'only people of the newest frame'


def test_pieces_of_work_keep_a_distance(track: Track, models: dict[str, BasePoses]) -> None:
    work = DeferredWork(HypothesisChecker(models, CONFIG), ('jump', 'walk'), 0.5)
    state = make_state(with_schedule(track, 'ann', 0, 0))
    now = track.seen.stamps_ns[-1]
    gap_ns = round(MIN_DEFERRED_GAP_S * S)
    assert work.choose(replace(state, last_check_ns=now - gap_ns + 1))[1] is None
    assert work.choose(replace(state, last_check_ns=now - gap_ns))[1] is not None
    assert work.choose(replace(state, pending_ids=()))[1] is None


def test_work_that_fails_is_not_repeated_for_ever(track: Track, models: dict[str, BasePoses]) -> None:
    """The next check is that of the next model; here the first model of the two does not exist."""
    work = DeferredWork(HypothesisChecker(models, CONFIG), ('missing', 'walk'), 0.5)
    state, chosen = work.choose(make_state(with_schedule(track, 'ann', 0, 2 * S)))
    assert chosen is not None
    with pytest.raises(KeyError, match='missing'):
        work.do(chosen)
    state, chosen = work.choose(replace(state, pending_ids=('ann',), last_check_ns=0))
    assert chosen is not None
    after = work.do(chosen)
    assert after.schedule.check_count == 2
    assert after.schedule.next_check_ns > state.tracks[0].schedule.next_check_ns


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
    _, chosen = work.choose(make_state(replace(track, seen=seen, solution=wrong, schedule=late)))
    assert chosen is not None
    after = work.do(chosen)
    same_heading = np.trace(after.solved.rotation[-1] @ right.T) > 2  # less than 60 degrees apart
    assert same_heading == is_found
    assert after.schedule.check_count == 1
    assert after.schedule.next_check_ns > newest_ns
