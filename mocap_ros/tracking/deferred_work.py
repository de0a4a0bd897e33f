# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The work of a tracker that waits until the outputs of a frame are published: checks and classifications.

Each piece of work is a generator of slices, each about a step of a solver; after each frame as many are done as a
budget of cost, not time, allows (`hypotheses`), so a replay does the same slices as the live node. A piece is
about one track as it was when it began, and ends without a result if meanwhile the person was forgotten, the
camera changed, or left and right of an earlier frame were exchanged; a check also if the image noise rose so much
that all models are tried again. The next piece is the one that is latest in proportion to its interval: new people
come first, and if more is due than can be done, all intervals become longer.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

from mocap_ros.tracking.hypotheses import HypothesisChecker, Slices, classify_as_other, still_repeats
from mocap_ros.tracking.track import Track

FRAME_BUDGET = 75_000  # elements; 2 to 3 ms of a core, so that the next frame does not wait
# The same without a lifter, about 10 ms: only the checks then find the model and the heading, and with a smaller
# budget they come too late
FRAME_BUDGET_WITHOUT_LIFTER = 300_000
WINDOW_COST = 20_000  # elements; building the windows of a piece of work, its first slice, takes as long


@dataclass(eq=False)
class Work:
    """A piece of work that has begun."""

    track: Track
    then: Track  # the person's track as it was when the work began
    is_check: bool  # whether it is a check and not a classification
    slices: Slices[None]  # the rest of the work, which ends by changing the track
    next_cost: float | None  # cost of the next slice; None when all are done


@dataclass(eq=False)
class DeferredWork:
    """Chooses the deferred work, and does it slice by slice."""

    checker: HypothesisChecker
    # names of the models to check in turn; '' is the turn of the leading prior (`solvers.leading_prior`)
    turns: tuple[str, ...]
    max_check_interval_s: float  # s, upper limit of the time between two checks of a track
    # elements, largest cost of the slices that follow a frame; one is done whatever it costs
    frame_budget: int = FRAME_BUDGET
    begun: Work | None = None  # the piece of work that has begun and is not finished

    def advance(self, tracks: Sequence[Track], stamp_ns: int) -> None:
        """Do the slices that follow a frame; an error gives its piece of work up until it is next due."""
        newest = [t for t in tracks if t.stamps_ns[-1] == stamp_ns and not t.is_tentative]
        for track in newest:
            track.schedule.restart_if_noise_rose(track.solved.noise, stamp_ns, len(self.turns))
            if not still_repeats(track, track.schedule.motion):
                track.schedule.finish_classification(stamp_ns, classify_as_other(track))
        work, self.begun = self.begun, None
        if work is not None and not any(t is work.track for t in tracks):
            work = None
        elif work is not None and _is_outdated(work):
            work.track.schedule.be_due(stamp_ns, is_check=work.is_check)
            work = None
        budget: float = self.frame_budget
        while work := work or self._begin_latest(newest, stamp_ns):
            while work.next_cost is not None and (budget == self.frame_budget or work.next_cost <= budget):
                budget -= work.next_cost
                work.next_cost = next(work.slices, None)
            if work.next_cost is not None:
                self.begun = work
                return
            work = None

    def _begin_latest(self, newest: Sequence[Track], stamp_ns: int) -> Work | None:
        pieces = []
        for track in newest:
            if track.age_s > 0:
                pieces.append((track.schedule.measure_check_lateness(stamp_ns), True, track))
            pieces.append((track.schedule.measure_classification_lateness(stamp_ns), False, track))
        due = [piece for piece in pieces if piece[0] >= 0]
        if not due:
            return None
        _, is_check, track = max(due, key=lambda piece: piece[0])
        if is_check:
            track.schedule.begin_check(stamp_ns, track.age_s, self.max_check_interval_s)
            then = track.copy()
            slices = _check(self.checker, then, track, self.turns)
        else:
            track.schedule.begin_classification(stamp_ns)
            then = track.copy()
            slices = _classify(self.checker, then, track)
        return Work(track, then, is_check, slices, next(slices))


def _check(checker: HypothesisChecker, then: Track, now: Track, turns: tuple[str, ...]) -> Slices[None]:
    """Check a track as it was against the model whose turn it is, and change the track as it is now."""
    yield WINDOW_COST
    found = yield from checker.check(then, turns[(then.schedule.check_count - 1) % len(turns)])
    kept = None if found is None else found.drop_oldest(_count_dropped(then, now))
    if kept is not None:
        now.solution = kept.follow(now.solved)
    now.schedule.finish_check(now.solved.noise, len(turns))


def _classify(checker: HypothesisChecker, then: Track, now: Track) -> Slices[None]:
    """Classify the motion of a track as it was, and change the track as it is now."""
    yield WINDOW_COST
    found = yield from checker.classify_motion(then)
    if found is not None and not still_repeats(now, found):
        found = classify_as_other(now)
    now.schedule.finish_classification(then.stamps_ns[-1], found)


def _count_dropped(then: Track, now: Track) -> int:
    return bisect_left(then.stamps_ns, now.stamps_ns[0])


def _is_outdated(work: Work) -> bool:
    """Return whether the result of a piece of work would count for nothing (text of the module)."""
    then, now = work.then, work.track
    kept = then.swap_filter.is_swapped[_count_dropped(then, now) :]
    is_relabelled = now.swap_filter.is_swapped[: len(kept)].tobytes() != kept.tobytes()
    has_restarted = work.is_check and now.schedule.pending_restarts > then.schedule.pending_restarts
    return is_relabelled or not len(kept) or then.intrinsics != now.intrinsics or has_restarted
