# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of when a track is checked and classified."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.people import Motion, MotionKind
from mocap_ros.tracking.schedule import NEW_TRACK_S, CheckSchedule, Classification

S = 10**9  # ns
PERIODIC = Classification(Motion(MotionKind.PERIODIC, 'walk', 0.01, 0.9), 'walk')
OTHER = Classification(Motion(MotionKind.NON_PERIODIC, 'jump', 0.01, np.nan), '')


def check(schedule: CheckSchedule, stamp_s: float, age_s: float, noise: float = 0.01) -> CheckSchedule:
    """Return the schedule after a check among three models, at most half a second apart."""
    return schedule.begin_check(round(stamp_s * S), age_s, 0.5).finish_check(noise, model_count=3)


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
    other = CheckSchedule().finish_classification(5 * S, OTHER)
    assert (other.next_classification_ns, other.classification_count) == (5.5 * S, 1)
    assert other.classification is OTHER


def test_who_has_walked_is_classified_often_until_the_walk_goes_on() -> None:
    stopped = CheckSchedule().finish_classification(4 * S, PERIODIC).finish_classification(5 * S, OTHER)
    assert (stopped.next_classification_ns, stopped.classification_count) == (5.25 * S, 2)
    assert (stopped.may_resume, stopped.last_periodic_ns) == (True, 4 * S)
    assert stopped.finish_classification(6 * S, None).may_resume
    resumed = stopped.finish_classification(6 * S, PERIODIC)
    assert (resumed.next_classification_ns, resumed.may_resume, resumed.is_periodic) == (7 * S, False, True)
    assert not CheckSchedule().finish_classification(5 * S, OTHER).may_resume
    long_ago = stopped.finish_classification(20 * S, OTHER)
    assert (long_ago.may_resume, long_ago.next_classification_ns) == (False, 20.5 * S)


def test_a_classification_that_was_not_possible_changes_no_result() -> None:
    first = CheckSchedule().finish_classification(4 * S, None)
    assert (first.next_classification_ns, first.classification_count) == (4.5 * S, 0)
    assert first.classification.motion.kind is MotionKind.UNKNOWN
    periodic = first.finish_classification(5 * S, PERIODIC).finish_classification(6 * S, None)
    assert (periodic.next_classification_ns, periodic.classification_count) == (7 * S, 1)
    assert periodic.classification is PERIODIC


def test_lateness_is_measured_in_intervals() -> None:
    new = check(CheckSchedule().check_after_initialisation(0), 1.0, age_s=0.3)
    old = check(CheckSchedule(), 1.0, age_s=9.0)
    assert new.measure_check_lateness(round(1.2 * S)) == pytest.approx(1)
    assert old.measure_check_lateness(round(1.2 * S)) == pytest.approx(-0.6)
    assert old.measure_check_lateness(2 * S) == pytest.approx(1)
    assert old.check_at(2 * S).measure_check_lateness(round(2.1 * S)) == pytest.approx(1), 'an urgent check'
    periodic = CheckSchedule().finish_classification(4 * S, PERIODIC)
    assert periodic.measure_classification_lateness(7 * S) == pytest.approx(2)
    assert periodic.classify_at(6 * S).measure_classification_lateness(7 * S) == pytest.approx(1)


def test_work_that_has_begun_is_not_due_before_its_interval_has_passed() -> None:
    begun = CheckSchedule().begin_check(3 * S, 9.0, 0.5)
    assert (begun.check_count, begun.next_check_ns) == (1, 3.5 * S)
    assert CheckSchedule().begin_classification(3 * S).next_classification_ns == 3.5 * S
