# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is scheduled for a tracked person: when to check the solution and to classify the motion, and why.

Checks are due at intervals that grow with the person's age, each of another model in turn. After a round of all
models the image noise is the baseline; if it rises far above that, all models are tried from scratch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mocap_ros.people import Motion, MotionKind
from mocap_ros.units import NS_PER_S

MIN_CHECK_INTERVAL_S = 0.1  # s; the first solution comes from a single frame, which leaves the heading ambiguous
CHECK_INTERVAL_GROWTH = 0.2  # s per s of the track's age; a solution that passed many checks is rarely wrong
NEW_TRACK_S = 1.0  # s; younger tracks are solved from scratch at each check, since their solution may be wrong
NOISE_ALARM_RATIO = 1.3  # no unit; a rise of the image noise by 30 % indicates another motion or a wrong solution
CLASSIFICATION_INTERVAL_S = 1.0  # s; for periodic motion
OTHER_CLASSIFICATION_INTERVAL_S = 0.5  # s; for other motion, to find a new walk sooner
RESUMED_CLASSIFICATION_INTERVAL_S = 0.25  # s; for a person who has walked or run and may go on with it
RESUME_WITHIN_S = 10.0  # s; for so long after a walk it is expected to go on, which costs classifications


# Of a track before its window is long enough to be classified.
UNKNOWN = Motion(MotionKind.UNKNOWN, '', math.nan, math.nan)


@dataclass(eq=False)
class CheckSchedule:
    """The checks and classifications of a track that are due, and what they are decided by."""

    next_check_ns: int = 0  # ns, stamp at which the next check is due
    # s, interval from the check before it, in which its lateness is measured
    check_interval_s: float = MIN_CHECK_INTERVAL_S
    check_count: int = 0
    # number of solutions from scratch that are still due after the image noise has risen
    pending_restarts: int = 0
    # m, image noise after the last round of checks in which every model had its turn; infinite before the first
    # round
    baseline_noise: float = math.inf
    next_classification_ns: int = 0  # ns, stamp at which the motion is to be classified again
    classification_count: int = 0
    motion: Motion = UNKNOWN  # kind of motion of the window; its category is the model by which it was classified
    # ns, stamp of the last classification that found periodic motion; None if none did, or if that is long ago
    last_periodic_ns: int | None = None

    def check_at(self, stamp_ns: int) -> None:
        """Schedule an urgent check at a stamp in ns."""
        self.next_check_ns, self.check_interval_s = stamp_ns, MIN_CHECK_INTERVAL_S

    def be_due(self, stamp_ns: int, *, is_check: bool) -> None:
        """Make the next check, or else the next classification, due at a stamp in ns."""
        if is_check:
            self.check_at(stamp_ns)
        else:
            self.next_classification_ns = stamp_ns

    def measure_check_lateness(self, stamp_ns: int) -> float:
        """Return how late the next check is at a stamp in ns, in intervals; negative before it is due."""
        return (stamp_ns - self.next_check_ns) / (self.check_interval_s * NS_PER_S)

    def measure_classification_lateness(self, stamp_ns: int) -> float:
        """Return how late the next classification is at a stamp in ns, in intervals; negative before it is due."""
        return (stamp_ns - self.next_classification_ns) / (self.classification_interval_s * NS_PER_S)

    def restart_if_noise_rose(self, noise: float, stamp_ns: int, turns: int) -> None:
        """Schedule `turns` solutions from scratch, from now on, if the noise in m is far above its baseline."""
        if noise > NOISE_ALARM_RATIO * self.baseline_noise:
            self.pending_restarts, self.baseline_noise = turns, math.inf
            self.check_at(stamp_ns)

    def begin_check(self, stamp_ns: int, age_s: float, max_interval_s: float) -> None:
        """Count a check that begins, and schedule the next one an interval later."""
        interval_s = min(max(MIN_CHECK_INTERVAL_S, CHECK_INTERVAL_GROWTH * age_s), max_interval_s)
        if self.pending_restarts:
            interval_s = min(interval_s, MIN_CHECK_INTERVAL_S)
        self.check_count += 1
        self.next_check_ns, self.check_interval_s = stamp_ns + round(interval_s * NS_PER_S), interval_s

    def is_from_scratch(self, age_s: float) -> bool:
        """Return whether a check at an age in s must start from the keypoints alone."""
        return self.pending_restarts > 0 or age_s < NEW_TRACK_S

    def finish_check(self, noise: float, turns: int) -> None:
        """End a check that has begun; the arguments are those of `restart_if_noise_rose`, after the check."""
        self.pending_restarts = max(self.pending_restarts - 1, 0)
        if self.check_count % turns == 0 and not self.pending_restarts:
            self.baseline_noise = noise

    @property
    def is_periodic(self) -> bool:
        """Whether the motion is periodic."""
        return self.motion.kind is MotionKind.PERIODIC

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

    def begin_classification(self, stamp_ns: int) -> None:
        """Schedule the next classification an interval after a stamp in ns."""
        self.next_classification_ns = stamp_ns + round(self.classification_interval_s * NS_PER_S)

    def finish_classification(self, stamp_ns: int, motion: Motion | None) -> None:
        """End a classification, begun at a stamp in ns; None if the window is too short for one."""
        if motion is not None:
            self.motion = motion
            self.classification_count += 1
        if self.is_periodic:
            self.last_periodic_ns = stamp_ns
        elif self.last_periodic_ns is not None and stamp_ns - self.last_periodic_ns > RESUME_WITHIN_S * NS_PER_S:
            self.last_periodic_ns = None
        self.begin_classification(stamp_ns)
