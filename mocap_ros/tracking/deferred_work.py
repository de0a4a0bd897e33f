"""The work of a tracker that waits until the outputs of a frame are published: hypothesis checks, classification.

At most one piece of work is done for a frame, and none sooner than `MIN_DEFERRED_GAP_S` after the last: the one
that is due longest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mocap_ros.tracking.hypotheses import HypothesisChecker
from mocap_ros.tracking.state import TrackerState
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

MIN_DEFERRED_GAP_S = 0.2  # s between two checks or classifications; each takes up to 70 ms (docs/tracker.md)


@dataclass(frozen=True, eq=False)
class DueWork:
    """A piece of work that is due.

    Attributes:
        due_ns: ns, stamp since which it is due.
        track: the track that it is about.
        is_classification: True to classify the motion, False to check the solution.
    """

    due_ns: int
    track: Track
    is_classification: bool


@dataclass(frozen=True, eq=False)
class DeferredWork:
    """Chooses and does the deferred work.

    Attributes:
        checker: makes the checks.
        candidate_models: names of the models to check, in turn.
        max_check_interval_s: s, upper limit of the time between two checks of a track.
    """

    checker: HypothesisChecker
    candidate_models: tuple[str, ...]
    max_check_interval_s: float

    def choose(self, state: TrackerState) -> tuple[TrackerState, DueWork | None]:
        """Choose the work for the newest frame.

        Args:
            state: state after this frame.

        Returns:
            The state in which the work has begun, so that work that fails is not repeated at once; and the work,
            None if nothing is due.
        """
        stamp_ns, pending_ids = state.newest_stamp_ns, state.pending_ids
        if stamp_ns is None or not pending_ids:
            return state, None
        pending = [self._restart_if_noise_rose(t, stamp_ns) for t in state.tracks if t.id in pending_ids]
        state = replace(state.put_tracks(pending), pending_ids=())
        if stamp_ns < state.last_check_ns + MIN_DEFERRED_GAP_S * NS_PER_S:
            return state, None
        work = [DueWork(t.schedule.next_check_ns, t, False) for t in pending if t.seen.age_s > 0]
        work += [DueWork(t.schedule.next_classification_ns, t, True) for t in pending]
        due = [w for w in work if w.due_ns <= stamp_ns]
        if not due:
            return state, None
        chosen = min(due, key=lambda w: w.due_ns)
        state = replace(state, last_check_ns=stamp_ns)
        if not chosen.is_classification:
            track = replace(chosen.track, schedule=chosen.track.schedule.begin_check())
            state, chosen = state.put_tracks([track]), replace(chosen, track=track)
        return state, chosen

    def do(self, work: DueWork) -> Track:
        """Return the track after a piece of work that `choose` has chosen."""
        return self._classify(work.track) if work.is_classification else self._check(work.track)

    def _restart_if_noise_rose(self, track: Track, stamp_ns: int) -> Track:
        """Return the track, with re-initialisations under all models due if its image noise has risen much."""
        models = len(self.candidate_models)
        schedule = track.schedule.restart_if_noise_rose(track.solved.noise, stamp_ns, models)
        return track if schedule is track.schedule else replace(track, schedule=schedule)

    def _classify(self, track: Track) -> Track:
        """Return the track with its motion classified."""
        classification = self.checker.classify_motion(track)
        stamp_ns = track.seen.stamps_ns[-1]
        return replace(track, schedule=track.schedule.finish_classification(stamp_ns, classification))

    def _check(self, track: Track) -> Track:
        """Return the track after a check against the model whose turn it is.

        The hypothesis is the track's own poses under that model. It is a solution from scratch if the model is the
        track's own, if the track is new, or after a rise of the image noise.
        """
        schedule, age_s, stamp_ns = track.schedule, track.seen.age_s, track.seen.stamps_ns[-1]
        count = len(self.candidate_models)
        name = self.candidate_models[(schedule.check_count - 1) % count]
        if schedule.is_from_scratch(age_s) or name == track.solved.model_name:
            outcome = self.checker.reinitialise(track, [name])
        else:
            outcome = self.checker.compare_models(track, [name])
        noise = outcome.solution.noise
        schedule = schedule.finish_check(stamp_ns, age_s, self.max_check_interval_s, noise, count)
        return replace(track, solution=outcome.solution, schedule=schedule)
