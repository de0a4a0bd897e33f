# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of a track against other hypotheses: another model, a solution from scratch, a periodic motion.

Hypotheses are compared by -2 log evidence of the image points (`classification.measure_evidence`) under the
same image noise; the lowest wins, one of another model by `EVIDENCE_MARGIN`. Which prior leads, the image
noise with either decides (`leading_prior`). A check is a generator of `Slices`; it changes nothing, and returns
the solution that the track, as it was at the beginning, has from now on.

The cost of a slice is counted in elements of the solver's matrix: a step over F frames with n unknowns each, with
its normal equations, costs F n^2 + `STEP_BASE`. It follows from the input and is no measured time.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import copy_with
from mocap_ros.config import Config, SolverConfig
from mocap_ros.engine import periodic as engine
from mocap_ros.errors import InputError
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.geometry.interpolation import interpolate_linearly
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.people import Motion, MotionKind
from mocap_ros.solvers.classification import (
    MIN_COMPARISON_NOISE,
    PERIODIC_CATEGORIES,
    fit_periodic_stepwise,
    is_periodic,
    measure_best_repetition,
    measure_evidence,
    measure_jitter,
    minus_twice_log_evidence_stepwise,
)
from mocap_ros.solvers.joint.solver import (
    JointReconstruction,
    solve_hypotheses,
    solve_hypotheses_stepwise,
    solve_stepwise,
    start_from_lifted_poses,
)
from mocap_ros.solvers.leading_prior import can_base_poses_lead, explains_as_well, let_base_poses_lead
from mocap_ros.solvers.levenberg_marquardt import Stepwise
from mocap_ros.solvers.periodic import EstimatedPoses
from mocap_ros.solvers.window import InitialValues, Window, choose_initial_values
from mocap_ros.tracking.solution import TrackSolution, select_start
from mocap_ros.tracking.track import Track

Result = TypeVar('Result')

# Yields the cost of the slice that the next call of `next` will do, and returns the result at its end.
Slices: TypeAlias = Generator[float, None, Result]

STEP_BASE = 4000  # elements; what a step does once for all frames takes as long as so many of them
PIECES_OF_STEP = 2  # the solvers do a step and its normal equations one after the other
REINIT_MAX_ITERATIONS = 5  # steps of a solution from scratch; limits its time, the comparison refines it further
MAX_STARTS = 2  # cameras that `solve_hypotheses` starts from at most; lifted poses leave one
REINIT_COMPONENTS = 20  # base poses of a solution from scratch; limits its time, the comparison uses all of them
COMPARISON_MAX_ITERATIONS = 4  # steps that each hypothesis gets before its evidence is compared; limits the time
SETTLING_ROUNDS = 3  # rounds of `COMPARISON_MAX_ITERATIONS` steps, each under the noise that the last one left
MIN_LEAD_FRAMES = 6  # frames, one each `CHECK_STEP_S`; the noise of fewer says too little about the lead
LEAD_SLACK = 1.1  # factor on the limits of base poses that lead already; keeps the lead from chattering
# Steps on the whole window after a hypothesis of its newest part was adopted. More steps or frames make the
# adoption come later, which costs the newest frame more than it gains.
ADOPTION_MAX_ITERATIONS = 2
ADOPTION_STEP_S = 0.05  # s; one frame of each step is solved then
INITIAL_MAX_ITERATIONS = 6  # steps of a first solution, which checks improve; limits the time of the frame
INITIAL_NOISE = 0.02  # m; image noise of a first solution: large, since a first lifted pose may be far off
EVIDENCE_MARGIN = 10.0  # -2 log evidence, a factor of exp(5) = 150; keeps the choice of a model from chattering
CHECK_STEP_S = 0.1  # s; one frame of each step is checked, for neighbouring frames add more time than evidence
CHECK_SPAN_S = 1.0  # s; newest part of the window that is checked, for the older part may be another motion
CLASSIFICATION_STEP_S = 1 / 15  # s; halves the frames of a 30 Hz stream, and samples a running cycle 10 times
CLASSIFICATION_MAX_ITERATIONS = 8  # steps of the periodic solver, which starts from the solution; limits the time
MIN_RUN_SPEED_M_S = 0.9  # m/s; RMS over the joints about the body's origin: 0.5 to 0.9 in walks, to 1.5 in runs
SPEED_STEP_S = 0.2  # s; over which the speed is taken, long enough for jitter to say little
# s; section of a person who has walked or run shortly before and is expected to go on. Of others such short
# sections are called periodic too often: 0.09 of those with clean points, of 2 s 0.04 (training persons).
RESUMED_SECTION_S = 1.3
OTHER_MODEL_TURNS = 4  # classifications; one of so many tries the model that is less likely by the speed
# 1; smallest repetition of periodic motion. Walks have 0.74 and more with clean points, 0.6 as MediaPipe gives
# them and 0.25 as MoveNet does (training persons); other motion about 0.
MIN_REPETITION = 0.2
PERIODIC_COST = 2.4  # cost of a piece of the periodic solver over one of the joint solver with as many base poses
MIN_SECTION_SHARE = 0.9  # share of a section that must be filled before it is classified; stamps vary
NOISE_RATIO = 0.88  # estimated noise over true image noise, of the base poses alone (CMU walks)
NOISE_RATIO_WITH_LIFTER = 0.76  # the same ratio with the lifter's prior (CMU walks)


def slice_work(work: Stepwise[Result], frames: int, components: int, factor: float = 1.0) -> Slices[Result]:
    """Do the pieces of a solver's work as slices, each `factor` of the cost of one of the joint solver."""
    cost = factor * (STEP_BASE + frames * (components + CAMERA_UNKNOWNS) ** 2) / PIECES_OF_STEP
    while True:
        yield cost
        try:
            next(work)
        except StopIteration as end:
            return end.value


@dataclass(frozen=True, eq=False)
class HypothesisChecker:
    """Initialises tracks, checks them against other hypotheses and classifies their motion."""

    models: Mapping[str, PoseModel]
    config: Config

    def initialise(self, tracks: Sequence[Track], model_names: Sequence[str]) -> list[TrackSolution]:
        """Return the likeliest first solutions of tracks, from few steps of one batch for each model."""
        solver = replace(self.config.solver, max_iterations=INITIAL_MAX_ITERATIONS)
        windows, first_model = [], self.models[model_names[0]]
        for track in tracks:
            window = replace(track.observed.build_solver_window(), noise=INITIAL_NOISE)
            started = start_from_lifted_poses(window, first_model)
            start, _ = choose_initial_values(started, first_model, self.config.solver.start_window)
            windows.append(copy_with(window, unit=float(np.median(start.cameras.scale))))
        by_model = [solve_hypotheses(windows, self.models[name], solver) for name in model_names]
        solutions = []
        for track, *fits in zip(tracks, *by_model, strict=True):
            named = [(name, self.models[name], fit) for name, fit in zip(model_names, fits, strict=True)]
            name, model, fit = min(named, key=lambda n: measure_evidence(n[2], n[1], INITIAL_NOISE))
            frames = np.arange(len(track.stamps_ns))
            solutions.append(TrackSolution.interpolate(fit, track.observed, frames, name, model, None))
        return solutions

    def check(self, track: Track, model_name: str) -> Slices[TrackSolution | None]:
        """Check a solved track against a model; return the solution that replaces its own, or None.

        The hypothesis is the track's own poses under that model, or a solution from scratch if the model is its
        own, the track is new, or the image noise rose. Without a name, the other prior leads in it.
        """
        if not model_name:
            return (yield from self._compare_leads(track))
        own, frames = track.solved, track.select_frames(CHECK_STEP_S, CHECK_SPAN_S)
        observed, start = select_start(track.observed, own, frames)
        window, model = observed.build_solver_window(start, own.noise), self.models[model_name]
        if track.schedule.is_from_scratch(track.age_s) or model_name == own.model_name:
            other, other_noise = yield from self._solve_from_scratch(window, model, own.base_poses_lead)
        else:
            rotation, theta = own.convert_poses(model, frames)
            other = observed.convert_to_initial_values(theta, rotation, own.roots[frames])
            other_noise = own.noise
        solver = replace(self._choose_solver(own.base_poses_lead), max_iterations=COMPARISON_MAX_ITERATIONS)
        fits, noise = [], min(other_noise, own.noise)
        for name, values in ((model_name, other), (own.model_name, start)):
            work = minus_twice_log_evidence_stepwise(
                copy_with(window, start=values), self.models[name], noise, solver
            )
            fits.append((yield from slice_work(work, len(frames), len(self.models[name].std))))
        (evidence, fit), (own_evidence, _) = fits
        margin = EVIDENCE_MARGIN if model_name != own.model_name else 0.0
        if not evidence + margin <= own_evidence:
            return None
        return (yield from self._adopt(track, frames, model_name, fit, own.base_poses_lead))

    def _solve_from_scratch(
        self, window: Window, model: PoseModel, base_poses_lead: bool
    ) -> Slices[tuple[InitialValues, float]]:
        """Return initial values and the image noise in m of a window of which only the points are known."""
        solver = replace(
            self._choose_solver(base_poses_lead),
            max_iterations=REINIT_MAX_ITERATIONS,
            components=REINIT_COMPONENTS,
            noise_floor=MIN_COMPARISON_NOISE,
        )
        work = solve_hypotheses_stepwise([copy_with(window, start=None, unit=None, noise=None)], model, solver)
        starts = MAX_STARTS if window.lifted is None else 1
        (fit,) = yield from slice_work(work, starts * len(window.times), min(REINIT_COMPONENTS, len(model.std)))
        unsolved = max(len(model.std) - fit.theta.shape[1], 0)
        return InitialValues(np.pad(fit.theta, [(0, 0), (0, unsolved)]), fit.cameras), fit.noise

    def _compare_leads(self, track: Track) -> Slices[TrackSolution | None]:
        """Solve a track with either prior in the lead, and return its solution if the other one is to lead."""
        own, frames = track.solved, track.select_frames(CHECK_STEP_S, CHECK_SPAN_S)
        if track.observed.lifted is None or not can_base_poses_lead(own.model_name):
            return None
        if len(frames) < MIN_LEAD_FRAMES:
            return None
        observed, start = select_start(track.observed, own, frames)
        window = observed.build_solver_window(start, own.noise)
        led = yield from self._settle(window, own.model_name, base_poses_lead=True)
        by_lifter = yield from self._settle(window, own.model_name, base_poses_lead=False)
        slack = LEAD_SLACK if own.base_poses_lead else 1.0
        base_poses_lead = explains_as_well(led.misfit, by_lifter.misfit, slack)
        if base_poses_lead == own.base_poses_lead:
            return None
        fit = led if base_poses_lead else by_lifter
        return (yield from self._adopt(track, frames, own.model_name, fit, base_poses_lead))

    def _settle(self, window: Window, model_name: str, *, base_poses_lead: bool) -> Slices[JointReconstruction]:
        """Return the solution of a window with initial values, after some rounds in which its noise settles."""
        model = self.models[model_name]
        solver = replace(self._choose_solver(base_poses_lead), max_iterations=COMPARISON_MAX_ITERATIONS)
        for _ in range(SETTLING_ROUNDS):
            (fit,) = yield from slice_work(
                solve_stepwise([window], model, solver), len(window.times), len(model.std)
            )
            window = copy_with(window, start=InitialValues(fit.theta, fit.cameras), noise=fit.noise)
        return fit

    def _choose_solver(self, base_poses_lead: bool) -> SolverConfig:
        return let_base_poses_lead(self.config.solver) if base_poses_lead else self.config.solver

    def _adopt(
        self,
        track: Track,
        frames: NDArray[np.intp],
        model_name: str,
        reconstruction: JointReconstruction,
        base_poses_lead: bool,
    ) -> Slices[TrackSolution]:
        """Return the solution of a track that follows from a reconstruction of some of its frames, refined."""
        model, observed, earlier = self.models[model_name], track.observed, track.solved
        if earlier.model_name != model_name:
            earlier = earlier.change_model(model_name, model)
        interpolate = partial(TrackSolution.interpolate, base_poses_lead=base_poses_lead)
        solution = interpolate(reconstruction, observed, frames, model_name, model, earlier)
        solver = replace(self._choose_solver(base_poses_lead), max_iterations=ADOPTION_MAX_ITERATIONS)
        frames = track.select_frames(ADOPTION_STEP_S, self.config.tracker.window)
        chosen, start = select_start(observed, solution, frames)
        window = chosen.build_solver_window(start, solution.noise)
        (refined,) = yield from slice_work(solve_stepwise([window], model, solver), len(frames), len(model.std))
        return interpolate(refined, observed, frames, model_name, model, solution)

    def classify_motion(self, track: Track) -> Slices[Motion | None]:
        """Classify the newest section of a solved track as periodic or not (TPAMI 2016, section 4.9).

        None if a section is not almost full yet, or no model is periodic. Motion that repeats itself at no cadence
        is not.
        """
        section_s = min(self._choose_section(track), self.config.tracker.window)
        periodic_names = [n for n in PERIODIC_CATEGORIES if n in self.models]
        if not periodic_names or -track.times_s[0] < MIN_SECTION_SHARE * section_s:
            return None
        # a walk that has just gone on has hardly a cycle to repeat
        times, theta, may_resume = track.observed.times, track.solved.theta, track.schedule.may_resume
        if not may_resume and measure_best_repetition(times, theta) < MIN_REPETITION:
            return classify_as_other(track)
        for name in self._order_periodic_models(track, periodic_names):
            motion = yield from self._fit_periodic_motion(track, name)
            if motion is not None:
                return motion
        return classify_as_other(track)

    def _choose_section(self, track: Track) -> float:
        section_s = self.config.classifier.section
        return min(section_s, RESUMED_SECTION_S) if track.schedule.may_resume else section_s

    def _order_periodic_models(self, track: Track, periodic_names: Sequence[str]) -> list[str]:
        """Return the names of the periodic models to fit, the likeliest first.

        A track that is not periodic gets one a classification: its own or that of its speed, and now and then the
        other.
        """
        schedule, own_name = track.schedule, track.solved.model_name
        by_speed = 'run' if self._measure_speed(track) > MIN_RUN_SPEED_M_S else 'walk'
        before = [schedule.motion.category] if schedule.is_periodic else []
        candidates = [*before, own_name, by_speed, *periodic_names]
        likeliest = next(n for n in candidates if n in periodic_names)
        rest = [n for n in periodic_names if n != likeliest]
        if schedule.is_periodic:
            return [likeliest, *rest]
        is_turn_of_other = schedule.classification_count % OTHER_MODEL_TURNS == OTHER_MODEL_TURNS - 1
        return rest if rest and is_turn_of_other and own_name not in periodic_names else [likeliest]

    def _measure_speed(self, track: Track) -> float:
        solution, times = track.solved, track.times_s
        later = np.arange(times[-1], times[0] + SPEED_STEP_S, -SPEED_STEP_S)
        if len(later) == 0:
            return 0.0
        theta = interpolate_linearly(np.append(later, later[-1] - SPEED_STEP_S), times, solution.theta)
        moved = np.diff(theta, axis=0) / (SPEED_STEP_S * solution.stature_ratio)
        return float(np.sqrt((moved**2).sum(axis=1).mean() / len(solution.model.mean)))

    def _fit_periodic_motion(self, track: Track, name: str) -> Slices[Motion | None]:
        settings = self.config.classifier
        frames = track.select_frames(CLASSIFICATION_STEP_S, self._choose_section(track))
        observed, start = select_start(track.observed, track.solved, frames)
        solver = replace(
            self.config.solver, components=settings.components, max_iterations=CLASSIFICATION_MAX_ITERATIONS
        )
        poses = self._current_poses(track, start)
        try:
            window = observed.build_solver_window()
            work = fit_periodic_stepwise(window, name, self.models[name], solver, poses)
            fit = yield from slice_work(work, len(frames), settings.components, PERIODIC_COST)
        except InputError:
            return None
        if not is_periodic(fit, settings, was_periodic=track.schedule.is_periodic):
            return None
        return Motion(MotionKind.PERIODIC, name, fit.residual, fit.reconstruction.cadence)

    def _current_poses(self, track: Track, start: InitialValues) -> EstimatedPoses:
        """Return the poses of the track's solution, with the bias of its noise estimate removed."""
        has_lifter = track.observed.lifted is not None
        noise = track.solved.noise / (NOISE_RATIO_WITH_LIFTER if has_lifter else NOISE_RATIO)
        joints = track.solved.model.poses(start.theta) @ np.swapaxes(start.cameras.rotation, -1, -2)
        times = track.times_s
        images = track.solved.compute_joints(np.arange(len(times)))[..., :2]
        return EstimatedPoses(joints, start.cameras.scale, noise, measure_jitter(times, images))


def still_repeats(track: Track, motion: Motion) -> bool:
    """Return whether a track's newest motion may be periodic as a classification of it says."""
    if motion.kind is not MotionKind.PERIODIC:
        return True
    repetition = engine.measure_repetition(track.observed.times, track.solved.theta, motion.cadence)
    return not repetition < MIN_REPETITION


def classify_as_other(track: Track) -> Motion:
    """Return the motion of a solved track that is not periodic."""
    return Motion(MotionKind.NON_PERIODIC, track.solved.model_name, track.solved.residual, math.nan)
