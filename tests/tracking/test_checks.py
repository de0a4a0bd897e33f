# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of hypotheses: what replaces a solution, when they are due, their slices, and that no person waits."""

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.tracking.deferred_work import FRAME_BUDGET, WINDOW_COST, DeferredWork, Work
from mocap_ros.tracking.hypotheses import HypothesisChecker, Slices, classify_as_other, still_repeats
from mocap_ros.tracking.schedule import NEW_TRACK_S, CheckSchedule
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import PeopleTracker
from tests.support.synthetic_walk import CAMERA, STEP_NS, Walk, change, make_walk, mpjpe_mm, see, track_walk

S = 10**9  # ns
FRAMES = 45
NOW = (FRAMES - 1) * STEP_NS
LATE = NOW + 9 * S
CONFIG = with_settings(
    Config(),
    {'solver.prior': 'pca', 'tracker.components': 20, 'classifier.section': 1.2, 'classifier.walk_residual': 0.2},
)


@pytest.fixture(scope='module')
def walk(walk_model: PoseModel) -> Walk:
    return make_walk(walk_model, frames=FRAMES + 35)


@pytest.fixture(scope='module')
def tracker(walk_model: PoseModel, walk: Walk) -> PeopleTracker:
    """A tracker that has found the right model and the right solution of a walk."""
    return track_walk({'jump': load_base_poses('jump'), 'walk': walk_model}, CONFIG, walk.points[:FRAMES])


@pytest.fixture(scope='module')
def track(tracker: PeopleTracker) -> Track:
    (track,) = tracker.tracks
    assert track.solved.model_name == 'walk'
    return track


@pytest.fixture(scope='module')
def checker(tracker: PeopleTracker) -> HypothesisChecker:
    return HypothesisChecker(tracker.models, CONFIG)


def finish(slices: Slices[Any]) -> Any:
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
def test_a_margin_is_needed(track: Track, checker: HypothesisChecker, std_ratio: float, is_replaced: bool) -> None:
    """A twin of the model with a slightly tighter prior is slightly more likely, which is not enough."""
    walk_model = checker.models['walk']
    twin = replace(walk_model, std=std_ratio * walk_model.std)
    found = finish(HypothesisChecker({**checker.models, 'twin': twin}, CONFIG).check(track, 'twin'))
    assert (found is not None) is is_replaced
    assert found is None or found.model_name == 'twin'


def test_the_tracker_finds_back_to_the_right_solution(walk_model: PoseModel, walk: Walk) -> None:
    """A wrong solution is given to a person; checks replace it within a second."""
    injected = track_walk({'jump': load_base_poses('jump'), 'walk': walk_model}, CONFIG, walk.points[:FRAMES])
    (track,) = injected.tracks
    # the other way, in the pose that the image then shows
    half_turn = track.solved.rotation @ rotation_from_vector(np.array([0.0, 0.0, np.pi]))
    track.solution = replace(track.solved, rotation=half_turn, theta=np.zeros_like(track.solved.theta))
    restarts, errors, truth = [], [], walk.poses(walk_model)
    for frame in range(FRAMES, FRAMES + 35):
        (person,) = injected.update(frame * STEP_NS, [see(walk.points[frame])], CAMERA).people
        restarts.append(track.schedule.pending_restarts)
        errors.append(mpjpe_mm(person.core[None], truth[[frame]]))
    assert max(restarts) > 0, 'the rise of the image noise was noticed'
    assert errors[0] > 100
    assert max(errors[-5:]) < 60


def test_first_solutions_have_all_frames_and_the_likeliest_model(track: Track, checker: HypothesisChecker) -> None:
    unsolved = change(track, solution=None)
    solutions = checker.initialise([unsolved, unsolved], ['jump', 'walk'])
    assert [(s.model_name, len(s.theta)) for s in solutions] == [('walk', FRAMES)] * 2
    assert solutions[0].theta == pytest.approx(solutions[1].theta, abs=1e-9), 'people of a batch are independent'
    assert unsolved.solution is None


def test_a_walk_of_a_full_section_is_classified(track: Track, checker: HypothesisChecker) -> None:
    motion = finish(checker.classify_motion(track))
    assert motion is not None
    assert (motion.kind, motion.category) == (MotionKind.PERIODIC, 'walk')
    strict = with_settings(CONFIG, {'classifier.amplitude': 0.9})
    other = finish(replace(checker, config=strict).classify_motion(track))
    assert other is not None
    assert (other.kind, other.category) == (MotionKind.NON_PERIODIC, 'walk')


def test_a_short_section_is_enough_for_who_has_walked_before(track: Track, checker: HypothesisChecker) -> None:
    checker = replace(checker, config=with_settings(CONFIG, {'classifier.section': 2.0}))
    assert finish(checker.classify_motion(track)) is None, '1.5 s of 2 s'
    other = classify_as_other(track)
    walked = track.copy()
    walked.schedule.last_periodic_ns, walked.schedule.motion = 0, other
    motion = finish(checker.classify_motion(walked))
    assert motion is not None
    assert (motion.kind, motion.category) == (MotionKind.PERIODIC, 'walk')
    assert still_repeats(walked, motion)
    assert still_repeats(walked, other), 'other motion need not repeat itself'


CHECK_SLICES, CHECK_COST = 20, 12_000
WALK = Motion(MotionKind.PERIODIC, 'walk', 0.01, 1.0)


@dataclass(frozen=True, eq=False)
class IdleChecker(HypothesisChecker):
    """Finds that every solution is the likeliest, in slices of known cost; lists what was done."""

    costs: list[int] = field(default_factory=list)
    checked: list[str] = field(default_factory=list)
    classified: list[str] = field(default_factory=list)

    def check(self, track: Track, model_name: str) -> Slices[TrackSolution | None]:  # noqa: ARG002
        for _ in range(CHECK_SLICES):
            yield CHECK_COST
            self.costs.append(CHECK_COST)
        self.checked.append(track.id)
        return None

    def classify_motion(self, track: Track) -> Slices[Motion | None]:
        yield CHECK_COST
        self.classified.append(track.id)
        return None


@pytest.fixture
def idle(track: Track) -> Track:
    """A track of which nothing is due."""
    return schedule(track, 'ann', LATE, LATE)


def make_work(checker: HypothesisChecker, *names: str, max_interval_s: float = 0.5, **values: Any) -> DeferredWork:
    return DeferredWork(checker, names or ('jump', 'walk'), max_interval_s, **values)


def schedule(track: Track, name: str, check_ns: int, classification_ns: int, interval_s: float = 0.1) -> Track:
    schedule = CheckSchedule(check_ns, interval_s, next_classification_ns=classification_ns)
    return change(track, id=name, schedule=schedule)


def begin(work: DeferredWork, *tracks: Track) -> Work:
    work.advance(tracks, NOW)
    assert work.begun is not None
    return work.begun


def test_the_work_latest_in_proportion_to_its_interval_begins(track: Track, checker: HypothesisChecker) -> None:
    def choose(*due: tuple[str, int, int, float]) -> tuple[str, bool]:
        begun = begin(make_work(checker), *(schedule(track, *one) for one in due))
        assert begun.then.schedule.check_count == begun.track.schedule.check_count == int(begun.is_check)
        return begun.track.id, begun.is_check

    new = 'new', NOW - S // 10, LATE, 0.1  # one interval late
    later = 'old', NOW - 3 * S, LATE, 2.0  # one and a half
    assert choose(new, ('old', NOW - S, LATE, 2.0)) == ('new', True)
    assert choose(new, later) == ('old', True)
    assert choose(new, later, ('moving', LATE, NOW - S, 0.1)) == ('moving', False), 'two of half a second'
    work, due = make_work(checker), schedule(track, 'b', 0, 0)
    work.advance([change(due, stamps_ns=(0, NOW - STEP_NS)), change(due, is_tentative=True)], NOW)
    assert work.begun is None, 'of certain people of the newest frame alone'


def test_a_frame_is_followed_by_as_many_slices_as_the_budget_allows(track: Track) -> None:
    checker = IdleChecker({}, CONFIG)
    work, due = make_work(checker, 'walk'), schedule(track, 'ann', 0, LATE)
    counts = [0]
    while counts == [0] or work.begun is not None:
        work.advance([due], NOW)
        counts.append(len(checker.costs))
    first, whole = (FRAME_BUDGET - WINDOW_COST) // CHECK_COST, FRAME_BUDGET // CHECK_COST
    assert first < whole
    per_frame = np.diff(counts).tolist()
    assert per_frame[:-1] == [first] + [whole] * (len(per_frame) - 2)
    assert sum(per_frame) == CHECK_SLICES


def test_no_person_waits_for_ever_and_new_people_come_first(track: Track) -> None:
    """Forty people want more than can be done; one of them is new."""
    checker = IdleChecker({}, CONFIG)
    work = make_work(checker, 'walk', max_interval_s=5.0)
    people = [change(schedule(track, f'old {i}', NOW, NOW, 5.0), first_ns=-100 * S) for i in range(40)]
    new_checks = 0
    for frame in range(1, 1500):
        now = NOW + frame * STEP_NS
        if frame == 900:
            people.append(change(schedule(track, 'new', now + S // 10, now, 0.1), first_ns=now))
        for person in people:
            person.stamps_ns = (*person.stamps_ns[:-1], now)
        work.advance(people, now)
        if frame == 930:
            new_checks = checker.checked.count('new')
    assert new_checks >= 2, 'within the first second'
    counts = Counter(checker.checked)
    old = [counts[f'old {i}'] for i in range(40)]
    assert min(old) >= 3
    assert max(old) <= min(old) + 2, 'about equally often'
    assert set(checker.classified) == set(checker.checked)


def test_work_that_fails_is_not_repeated_for_ever(track: Track, checker: HypothesisChecker) -> None:
    """The next check is that of the next model; here the first model of the two does not exist."""
    work, due = make_work(checker, 'missing', 'walk'), schedule(track, 'ann', 0, LATE)
    with pytest.raises(KeyError, match='missing'):
        work.advance([due], NOW)
    assert (work.begun, due.schedule.check_count) == (None, 1)
    assert due.schedule.next_check_ns > NOW
    due.schedule.next_check_ns = 0
    begin(work, due)
    while work.begun is not None:
        work.advance([due], NOW)
    assert due.schedule.check_count == 2
    assert due.schedule.next_check_ns > NOW


@pytest.mark.parametrize('is_check', [True, False])
@pytest.mark.parametrize(
    ('event', 'is_kept', 'is_due'),
    [
        ('nothing', True, False),
        ('forgotten', False, False),
        ('another person of the same id', False, False),
        ('camera', False, True),
        ('sides', False, True),
        ('noise', False, True),
    ],
)
def test_work_ends_where_its_track_is_not_what_it_was(
    idle: Track, checker: HypothesisChecker, is_check: bool, event: str, is_kept: bool, is_due: bool
) -> None:
    work = make_work(checker, frame_budget=1)
    idle.schedule.be_due(0, is_check=is_check)
    begun, tracks = begin(work, idle), [idle]
    assert begun.is_check is is_check
    if event == 'camera':
        idle.change_camera(replace(CAMERA, focal=600.0), 600.0)
    elif event == 'sides':
        is_swapped = idle.swap_filter.is_swapped.copy()
        is_swapped[-3] = True
        idle.swap_filter = replace(idle.swap_filter, is_swapped=is_swapped)
    elif event == 'noise':
        idle.schedule.baseline_noise = idle.solved.noise / 2
        if not is_check:
            return  # a classification needs no other model
    elif event == 'another person of the same id':
        tracks = [idle.copy()]
    elif event == 'forgotten':
        tracks = []
    work.advance(tracks, NOW)
    assert (work.begun is begun) is is_kept
    assert (work.begun is not None) is (is_kept or is_due), 'what is due begins again'
    if is_due:
        assert idle.schedule.check_count == (2 if is_check else 0)


@pytest.mark.parametrize('stops', [False, True])
def test_periodic_motion_ends_with_the_repetition(idle: Track, checker: HypothesisChecker, stops: bool) -> None:
    phase = 2 * np.pi * WALK.cadence * np.arange(FRAMES)[:, None] * STEP_NS / S
    theta = np.sin(phase + np.arange(idle.solved.theta.shape[1]))
    theta[-9:] = 3.0 if stops else theta[-9:]
    idle.solution = replace(idle.solved, theta=theta)
    idle.schedule.motion = WALK
    make_work(IdleChecker(checker.models, CONFIG)).advance([idle], NOW)
    found = idle.schedule.motion
    assert (found.kind is MotionKind.NON_PERIODIC) == stops
    assert found.category == 'walk'


def check(schedule: CheckSchedule, stamp_s: float, age_s: float, noise: float = 0.01) -> float:
    """Check a track among three models, at most half a second apart; return the time in s to the next check."""
    schedule.begin_check(round(stamp_s * S), age_s, 0.5)
    schedule.finish_check(noise, turns=3)
    return schedule.next_check_ns / S - stamp_s


def test_checks_become_rarer_with_age() -> None:
    intervals = {age_s: check(CheckSchedule(), 7, age_s) for age_s in (0.1, 0.5, 1.5, 9.0)}
    assert intervals == pytest.approx({0.1: 0.1, 0.5: 0.1, 1.5: 0.3, 9.0: 0.5})
    assert CheckSchedule().is_from_scratch(NEW_TRACK_S - 0.01)
    assert not CheckSchedule().is_from_scratch(NEW_TRACK_S)


def test_a_rise_of_the_noise_starts_a_round_from_scratch() -> None:
    schedule = CheckSchedule(check_count=3, baseline_noise=0.01, next_check_ns=100 * S)
    schedule.restart_if_noise_rose(0.0129, 9 * S, 3)
    assert (schedule.pending_restarts, schedule.next_check_ns) == (0, 100 * S)
    new = CheckSchedule()
    new.restart_if_noise_rose(5.0, 9 * S, 3)
    assert new.pending_restarts == 0, 'no baseline yet'
    schedule.restart_if_noise_rose(0.0131, 9 * S, 3)
    assert (schedule.pending_restarts, schedule.next_check_ns, schedule.baseline_noise) == (3, 9 * S, np.inf)
    pending = []
    for number in range(3):
        assert schedule.is_from_scratch(age_s=60.0)
        assert check(schedule, 9 + number, age_s=60.0, noise=0.02) == pytest.approx(0.1), 'soon, whatever the age'
        pending.append(schedule.pending_restarts)
    assert pending == [2, 1, 0]
    assert schedule.baseline_noise == 0.02, 'a new round of all models has ended'
    assert not schedule.is_from_scratch(age_s=60.0)
    assert check(schedule, 20, age_s=60.0) == 0.5
