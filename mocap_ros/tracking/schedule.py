# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is scheduled for a tracked person: when to check the solution and to classify the motion, and why.

A check is due soon after the first solution, then at intervals that grow with the person's age. Each check is one
of another model, in turn; after a round of all models the image noise is the baseline. If the noise rises far
above it, the person's motion has changed or the solution is wrong, and all models are tried from scratch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mocap_ros.people import Motion, MotionKind
from mocap_ros.units import NS_PER_S

MIN_CHECK_INTERVAL_S = 0.1  # s; the first solution comes from a single frame, which leaves the heading ambiguous
CHECK_INTERVAL_GROWTH = 0.2  # s per s of the track's age; a solution that passed many checks is rarely wrong
NEW_TRACK_S = 1.0  # s; younger tracks are solved from scratch at each check, since their solution may be wrong
NOISE_ALARM_RATIO = 1.3  # no unit; a rise of the image noise by 30 % indicates another motion or a wrong solution
CLASSIFICATION_INTERVAL_S = 1.0  # s; for periodic motion
OTHER_CLASSIFICATION_INTERVAL_S = 0.5  # s; for other motion, to find a new walk sooner
RESUMED_CLASSIFICATION_INTERVAL_S = 0.25  # s; for somebody who has walked or run and may go on with it
RESUME_WITHIN_S = 10.0  # s; for so long after a walk it is expected to go on, which costs classifications
# Motion of a track before its window is long enough to be classified.
UNKNOWN_MOTION = Motion(MotionKind.UNKNOWN, '', math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Classification:
    """Kind of motion of a track's window.

    Attributes:
        motion: kind of motion.
        periodic_model_name: name of the model of the periodic motion; empty if the motion is not periodic.
    """

    motion: Motion
    periodic_model_name: str


@dataclass(frozen=True, eq=False)
class CheckSchedule:
    """The checks and classifications of a track that are due, and what they are decided by.

    Attributes:
        next_check_ns: ns, stamp at which the next hypothesis check is due.
        check_interval_s: s, interval from the check before it, in which its lateness is measured.
        check_count: number of hypothesis checks that have begun.
        pending_restarts: number of re-initialisations that are still due after the image noise has risen.
        baseline_noise: m, image noise after the last round of checks in which every model had its turn; infinite
            before the first round.
        next_classification_ns: ns, stamp at which the motion is to be classified again.
        classification_count: number of classifications so far.
        classification: the latest one.
        last_periodic_ns: ns, stamp of the last classification that found periodic motion; None if none did, or if
            that is long ago.
    """

    next_check_ns: int = 0
    check_interval_s: float = MIN_CHECK_INTERVAL_S
    check_count: int = 0
    pending_restarts: int = 0
    baseline_noise: float = math.inf
    next_classification_ns: int = 0
    classification_count: int = 0
    classification: Classification = Classification(UNKNOWN_MOTION, '')
    last_periodic_ns: int | None = None

    def check_at(self, stamp_ns: int) -> CheckSchedule:
        """Return the schedule with an urgent check at a stamp in ns."""
        return replace(self, next_check_ns=stamp_ns, check_interval_s=MIN_CHECK_INTERVAL_S)

    def classify_at(self, stamp_ns: int) -> CheckSchedule:
        """Return the schedule with the next classification at a stamp in ns."""
        return replace(self, next_classification_ns=stamp_ns)

    def measure_check_lateness(self, stamp_ns: int) -> float:
        """Return how late the next check is at a stamp in ns, in intervals; negative before it is due."""
        return (stamp_ns - self.next_check_ns) / (self.check_interval_s * NS_PER_S)

    def measure_classification_lateness(self, stamp_ns: int) -> float:
        """Return how late the next classification is at a stamp in ns, in intervals; negative before it is due."""
        return (stamp_ns - self.next_classification_ns) / (self.classification_interval_s * NS_PER_S)

    def check_after_initialisation(self, stamp_ns: int) -> CheckSchedule:
        """Return the schedule of a track that was initialised at a stamp in ns."""
        return self.check_at(stamp_ns + round(MIN_CHECK_INTERVAL_S * NS_PER_S))

    def restart_if_noise_rose(self, noise: float, stamp_ns: int, model_count: int) -> CheckSchedule:
        """Return the schedule with re-initialisations under all models if the noise is far above its baseline.

        Args:
            noise: m, image noise of the solution.
            stamp_ns: ns, stamp of the newest frame, at which they are then due.
            model_count: number of turns of a round: the candidate models and, if made, the comparison of leads.
        """
        if noise > NOISE_ALARM_RATIO * self.baseline_noise:
            restarted = replace(self, pending_restarts=model_count, baseline_noise=math.inf)
            return restarted.check_at(stamp_ns)
        return self

    def begin_check(self, stamp_ns: int, age_s: float, max_interval_s: float) -> CheckSchedule:
        """Return the schedule after the beginning of a check, with the next one an interval later.

        Args:
            stamp_ns: ns, stamp of the newest frame.
            age_s: s, time since the person was first seen.
            max_interval_s: s, upper limit of the interval.
        """
        interval_s = min(max(MIN_CHECK_INTERVAL_S, CHECK_INTERVAL_GROWTH * age_s), max_interval_s)
        if self.pending_restarts:
            interval_s = min(interval_s, MIN_CHECK_INTERVAL_S)
        return replace(
            self,
            check_count=self.check_count + 1,
            next_check_ns=stamp_ns + round(interval_s * NS_PER_S),
            check_interval_s=interval_s,
        )

    def is_from_scratch(self, age_s: float) -> bool:
        """Return whether a check must start from the keypoints alone, for the solution may be wrong.

        Args:
            age_s: s, time since the person was first seen.
        """
        return self.pending_restarts > 0 or age_s < NEW_TRACK_S

    def finish_check(self, noise: float, model_count: int) -> CheckSchedule:
        """Return the schedule after a check that has begun with `begin_check`.

        Args:
            noise: m, image noise of the solution after the check.
            model_count: number of turns of a round: the candidate models and, if made, the comparison of leads.
        """
        pending_restarts = max(self.pending_restarts - 1, 0)
        has_finished_round = self.check_count % model_count == 0
        return replace(
            self,
            pending_restarts=pending_restarts,
            baseline_noise=noise if has_finished_round and not pending_restarts else self.baseline_noise,
        )

    @property
    def is_periodic(self) -> bool:
        """Whether the motion is periodic."""
        return self.classification.motion.kind is MotionKind.PERIODIC

    @property
    def may_resume(self) -> bool:
        """Whether the motion is not periodic now but has been shortly before."""
        return self.last_periodic_ns is not None and not self.is_periodic

    @property
    def classification_interval_s(self) -> float:
        """Time in s from one classification to the next."""
        if self.is_periodic:
            return CLASSIFICATION_INTERVAL_S
        return RESUMED_CLASSIFICATION_INTERVAL_S if self.may_resume else OTHER_CLASSIFICATION_INTERVAL_S

    def begin_classification(self, stamp_ns: int) -> CheckSchedule:
        """Return the schedule after the beginning of a classification, with the next one an interval later."""
        return replace(self, next_classification_ns=stamp_ns + round(self.classification_interval_s * NS_PER_S))

    def finish_classification(self, stamp_ns: int, classification: Classification | None) -> CheckSchedule:
        """Return the schedule after a classification.

        Args:
            stamp_ns: ns, stamp of the newest frame when it began.
            classification: its result; None if the window is too short for one.
        """
        if classification is None:
            count, classification = self.classification_count, self.classification
        else:
            count = self.classification_count + 1
        last_ns = stamp_ns if classification.motion.kind is MotionKind.PERIODIC else self.last_periodic_ns
        if last_ns is not None and stamp_ns - last_ns > RESUME_WITHIN_S * NS_PER_S:
            last_ns = None
        finished = replace(
            self, classification_count=count, classification=classification, last_periodic_ns=last_ns
        )
        return finished.begin_classification(stamp_ns)
