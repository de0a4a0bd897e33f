# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of when a track is checked and classified."""

import numpy as np
import pytest

from mocap_ros.people import Motion, MotionKind
from mocap_ros.tracking.schedule import NEW_TRACK_S, CheckSchedule, Classification

S = 10**9  # ns
PERIODIC = Classification(Motion(MotionKind.PERIODIC, 'walk', 0.01, 0.9), 'walk')
OTHER = Classification(Motion(MotionKind.NON_PERIODIC, 'jump', 0.01, np.nan), '')


def check(schedule: CheckSchedule, stamp_s: float, age_s: float, noise: float = 0.01) -> float:
    """Check a track among three models, at most half a second apart; return the time in s to the next check."""
    schedule.begin_check(round(stamp_s * S), age_s, 0.5)
    schedule.finish_check(noise, turns=3)
    return schedule.next_check_ns / S - stamp_s


def classify(*found: tuple[float, Classification | None]) -> CheckSchedule:
    """Return the schedule after classifications at times in s."""
    schedule = CheckSchedule()
    for stamp_s, classification in found:
        schedule.finish_classification(round(stamp_s * S), classification)
    return schedule


def test_checks_become_rarer_with_age() -> None:
    intervals = {age_s: check(CheckSchedule(), 7, age_s) for age_s in (0.1, 0.5, 1.5, 9.0)}
    assert intervals == pytest.approx({0.1: 0.1, 0.5: 0.1, 1.5: 0.3, 9.0: 0.5})
    assert CheckSchedule().is_from_scratch(NEW_TRACK_S - 0.01)
    assert not CheckSchedule().is_from_scratch(NEW_TRACK_S)


def test_the_noise_after_a_round_of_all_models_is_the_baseline() -> None:
    schedule, baselines = CheckSchedule(), []
    for number, noise in enumerate([0.01, 0.02, 0.03, 0.04, 0.05, 0.06]):
        check(schedule, number, age_s=5.0, noise=noise)
        baselines.append(schedule.baseline_noise)
    assert baselines == [np.inf, np.inf, 0.03, 0.03, 0.03, 0.06]
    pending = CheckSchedule(check_count=2, pending_restarts=3)
    check(pending, 1, age_s=9.0)
    assert pending.baseline_noise == np.inf, 'the round of models may end before the restarts do'


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


def test_a_periodic_motion_is_classified_less_often() -> None:
    for classification, next_s in ((PERIODIC, 5.0), (OTHER, 4.5)):
        schedule = classify((4, classification))
        assert (schedule.next_classification_ns, schedule.classification_count) == (next_s * S, 1)
        assert schedule.classification is classification


def test_who_has_walked_is_classified_often_until_the_walk_goes_on() -> None:
    stopped = (4, PERIODIC), (5, OTHER)
    schedule = classify(*stopped)
    assert (schedule.next_classification_ns, schedule.classification_count) == (5.25 * S, 2)
    assert (schedule.may_resume, schedule.last_periodic_ns) == (True, 4 * S)
    assert classify(*stopped, (6, None)).may_resume
    resumed = classify(*stopped, (6, PERIODIC))
    assert (resumed.next_classification_ns, resumed.may_resume, resumed.is_periodic) == (7 * S, False, True)
    assert not classify((5, OTHER)).may_resume
    long_ago = classify(*stopped, (20, OTHER))
    assert (long_ago.may_resume, long_ago.next_classification_ns) == (False, 20.5 * S)


def test_a_classification_that_was_not_possible_changes_no_result() -> None:
    first = classify((4, None))
    assert (first.next_classification_ns, first.classification_count) == (4.5 * S, 0)
    assert first.classification.motion.kind is MotionKind.UNKNOWN
    periodic = classify((4, None), (5, PERIODIC), (6, None))
    assert (periodic.next_classification_ns, periodic.classification_count) == (7 * S, 1)
    assert periodic.classification is PERIODIC


def test_lateness_is_measured_in_intervals() -> None:
    new, old = CheckSchedule(), CheckSchedule()
    check(new, 1.0, age_s=0.3)
    check(old, 1.0, age_s=9.0)
    assert new.measure_check_lateness(round(1.2 * S)) == pytest.approx(1)
    assert old.measure_check_lateness(round(1.2 * S)) == pytest.approx(-0.6)
    assert old.measure_check_lateness(2 * S) == pytest.approx(1)
    old.be_due(2 * S, is_check=True)
    assert old.measure_check_lateness(round(2.1 * S)) == pytest.approx(1), 'an urgent check'
    periodic = classify((4, PERIODIC))
    assert periodic.measure_classification_lateness(7 * S) == pytest.approx(2)
    periodic.be_due(6 * S, is_check=False)
    assert periodic.measure_classification_lateness(7 * S) == pytest.approx(1)
