# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The work of a tracker that waits until the outputs of a frame are published: hypothesis checks, classification.

No frame waits for a whole check. The work is done in slices, each about a step of a solver, and after each frame
only as many are done as a budget allows. The budget limits the cost and not the time (`slices`), so a replay
does the same slices after the same frames as the live node.

One piece of work is done at a time. It is about one person, and about this person's track as it was when the work
began. What it finds is taken over when its last slice is done, some frames later (`take_over`). It ends without a
result if meanwhile the person was forgotten, the camera changed, or left and right of an earlier frame were
exchanged; a check also does if the image noise rose so much that all models are tried again. It is due again if
the person is still there.

The next piece is the one that is latest in proportion to its interval. So a new person, whose checks are due every
0.1 s, comes before those who are checked every few seconds. Nobody is passed over for ever: whoever waits gets
later all the time, while a piece that was done is not due again before its interval has passed. If more is due
than can be done, all intervals become longer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeAlias

from mocap_ros.tracking.hypotheses import HypothesisChecker, classify_as_other
from mocap_ros.tracking.slices import Slices
from mocap_ros.tracking.state import BegunWork, TrackerState, WorkKind
from mocap_ros.tracking.take_over import is_outdated, take_over
from mocap_ros.tracking.track import Track

FRAME_BUDGET = 75_000  # elements; 2 to 3 ms of a core, so that the next frame does not wait (docs/tracker.md)
# The same without a lifter, about 10 ms: only the checks then find the model and the heading, and with a smaller
# budget they come too late (docs/tracker.md)
FRAME_BUDGET_WITHOUT_LIFTER = 300_000
WINDOW_COST = 20_000  # elements; building the windows of a piece of work, its first slice, takes as long

# What a piece of work has found: a function that takes it over into the track as it is now.
Finding: TypeAlias = Callable[[Track], Track]


class DeferredWork:
    """Chooses the deferred work, and does it slice by slice.

    Args:
        checker: makes the checks.
        candidate_models: names of the models to check, in turn.
        max_check_interval_s: s, upper limit of the time between two checks of a track.
        frame_budget: elements, largest cost of the slices that follow a frame; one is done whatever it costs.
        compares_leads: whether the leading prior (`solvers.leading_prior`) has a turn after the models.
    """

    def __init__(
        self,
        checker: HypothesisChecker,
        candidate_models: tuple[str, ...],
        max_check_interval_s: float,
        frame_budget: int = FRAME_BUDGET,
        *,
        compares_leads: bool = False,
    ) -> None:
        self._checker = checker
        self._candidate_models = candidate_models
        self._turns = len(candidate_models) + compares_leads
        self._max_check_interval_s = max_check_interval_s
        self._frame_budget = frame_budget
        self._run: _Run | None = None  # the latest run; only a cache, for `state.begun_work` determines it

    def advance(self, state: TrackerState) -> Iterator[TrackerState]:
        """Do the slices that follow the newest frame, if that was not done yet.

        Args:
            state: state after this frame.

        Yields:
            The state before and after each piece of work of which slices are done. The piece itself is in the last
            state alone, so if a slice raises an error, the state before has no trace of the piece but that it has
            begun, and it is not repeated at once.
        """
        if not state.is_work_pending:
            return
        work = state.begun_work
        state = self._restart_where_noise_rose(replace(state, is_work_pending=False, begun_work=None))
        state = self._end_periodic_motion(state)
        if work is not None and _has_ended(work, state.find_track(work.track.id)):
            state, work = _make_due_again(state, work), None
        budget: float = self._frame_budget
        while True:
            if work is None:
                state, work = self._begin_latest(state)
            yield state
            if work is None:
                return
            run = self._resume(work)
            while run.finding is None and (budget == self._frame_budget or run.next_cost <= budget):
                budget -= run.next_cost
                run.do_slice()
            if run.finding is None:
                yield replace(state, begun_work=run.pause())
                return
            state = state.put_tracks([run.finding(t) for t in state.tracks if t.id == work.track.id])
            work = self._run = None  # the run holds some MB

    def _restart_where_noise_rose(self, state: TrackerState) -> TrackerState:
        """Return the state, with re-initialisations under all models due where the image noise has risen much."""
        restarted = []
        for track in state.newest_tracks:
            stamp_ns = track.seen.stamps_ns[-1]
            schedule = track.schedule.restart_if_noise_rose(track.solved.noise, stamp_ns, self._turns)
            if schedule is not track.schedule:
                restarted.append(replace(track, schedule=schedule))
        return state.put_tracks(restarted)

    def _end_periodic_motion(self, state: TrackerState) -> TrackerState:
        """Return the state in which the motion of people who no longer repeat their last cycle is not periodic."""
        ended = []
        for track in state.newest_tracks:
            schedule = track.schedule
            if not self._checker.still_repeats(track, schedule.classification):
                other, stamp_ns = classify_as_other(track), track.seen.stamps_ns[-1]
                ended.append(replace(track, schedule=schedule.finish_classification(stamp_ns, other)))
        return state.put_tracks(ended)

    def _begin_latest(self, state: TrackerState) -> tuple[TrackerState, BegunWork | None]:
        """Return the state in which the latest piece has begun, and this piece; None if none is due."""
        pieces = []
        for track in state.newest_tracks:
            schedule, stamp_ns = track.schedule, track.seen.stamps_ns[-1]
            if track.seen.age_s > 0:
                pieces.append((schedule.measure_check_lateness(stamp_ns), WorkKind.CHECK, track))
            pieces.append((schedule.measure_classification_lateness(stamp_ns), WorkKind.CLASSIFICATION, track))
        due = [piece for piece in pieces if piece[0] >= 0]
        if not due:
            return state, None
        _, kind, track = max(due, key=lambda piece: piece[0])
        schedule, stamp_ns = track.schedule, track.seen.stamps_ns[-1]
        if kind is WorkKind.CHECK:
            schedule = schedule.begin_check(stamp_ns, track.seen.age_s, self._max_check_interval_s)
        else:
            schedule = schedule.begin_classification(stamp_ns)
        track = replace(track, schedule=schedule)
        return state.put_tracks([track]), BegunWork(kind, track)

    def _resume(self, work: BegunWork) -> _Run:
        """Return the run of a piece of work, from the cache or, after a `restore`, done again so far."""
        if self._run is None or not self._run.is_at(work):
            self._run = _Run(work, self._list_slices(work))
        return self._run

    def _list_slices(self, work: BegunWork) -> Slices[Finding]:
        """Return the slices of a piece of work, which do not refer to this object, so that both end with it."""
        if work.kind is WorkKind.CHECK:
            return _check(self._checker, work.track, self._candidate_models, self._turns)
        return _classify(self._checker, work.track)


def _classify(checker: HypothesisChecker, track: Track) -> Slices[Finding]:
    """Classify the motion of a track."""
    yield WINDOW_COST
    classification = yield from checker.classify_motion(track)
    stamp_ns = track.seen.stamps_ns[-1]

    def finish(now: Track) -> Track:
        found = classification
        if found is not None and not checker.still_repeats(now, found):
            found = classify_as_other(now)
        return replace(now, schedule=now.schedule.finish_classification(stamp_ns, found))

    return finish


def _check(
    checker: HypothesisChecker, track: Track, candidate_models: tuple[str, ...], turns: int
) -> Slices[Finding]:
    """Check a track against the model whose turn it is, or compare the leading priors.

    The hypothesis is the track's own poses under that model. It is a solution from scratch if the model is the
    track's own, if the track is new, or after a rise of the image noise.
    """
    yield WINDOW_COST
    schedule = track.schedule
    turn = (schedule.check_count - 1) % turns
    name = candidate_models[turn] if turn < len(candidate_models) else ''
    if not name:
        outcome = yield from checker.compare_leads(track)
    elif schedule.is_from_scratch(track.seen.age_s) or name == track.solved.model_name:
        outcome = yield from checker.reinitialise(track, [name])
    else:
        outcome = yield from checker.compare_models(track, [name])

    def finish(now: Track) -> Track:
        solution = now.solved
        if outcome.is_replaced:
            solution = take_over(outcome.solution, track, now, checker.models)
        return replace(now, solution=solution, schedule=now.schedule.finish_check(solution.noise, turns))

    return finish


class _Run:
    """The run of a piece of work.

    Args:
        work: the piece; the slices of it that are done are done again.
        slices: all its slices.

    Attributes:
        work: the piece as it was when it was last paused.
        next_cost: cost of the next slice.
        finding: what was found; None before the last slice.
    """

    def __init__(self, work: BegunWork, slices: Slices[Finding]) -> None:
        self.work = work
        self.finding: Finding | None = None
        self.next_cost = next(slices)
        self._slices = slices
        self._slices_done = 0
        while self._slices_done < work.slices_done:
            self.do_slice()

    def do_slice(self) -> None:
        """Do the next slice."""
        self._slices_done += 1
        try:
            self.next_cost = next(self._slices)
        except StopIteration as end:
            self.finding = end.value

    def is_at(self, work: BegunWork) -> bool:
        """Return whether this is the run of a piece of work, and no slice further."""
        return self.work is work and self._slices_done == work.slices_done

    def pause(self) -> BegunWork:
        """Return the piece of work with the slices that are done, from which the run can go on."""
        self.work = replace(self.work, slices_done=self._slices_done)
        return self.work


def _has_ended(work: BegunWork, now: Track | None) -> bool:
    """Return whether a piece of work ends without a result, because its person's track is not what it was.

    Args:
        work: the piece of work.
        now: the track of that id now; None if there is none.
    """
    then = work.track
    if now is None or now.seen.first_stamp_ns != then.seen.first_stamp_ns:
        return True
    has_restarted = now.schedule.pending_restarts > then.schedule.pending_restarts
    return is_outdated(then.seen, now.seen) or (has_restarted and work.kind is WorkKind.CHECK)


def _make_due_again(state: TrackerState, work: BegunWork) -> TrackerState:
    """Return the state in which a piece of work that has ended without a result is due, if its person is there."""
    track, stamp_ns = state.find_track(work.track.id), state.newest_stamp_ns
    if track is None or stamp_ns is None or track.seen.first_stamp_ns != work.track.seen.first_stamp_ns:
        return state
    is_check = work.kind is WorkKind.CHECK
    schedule = track.schedule.check_at(stamp_ns) if is_check else track.schedule.classify_at(stamp_ns)
    return state.put_tracks([replace(track, schedule=schedule)])
