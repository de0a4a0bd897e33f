# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of a track against other hypotheses: another model, a solution from scratch, a periodic motion.

Hypotheses are compared by -2 log evidence of the image points (`classification.minus_twice_log_evidence`), all
under the same image noise. A hypothesis replaces the track's solution if its value is the lowest; one of another
model must be lower by `EVIDENCE_MARGIN`. A check costs as much as several frames, so it is made in slices
(`slices`), one or a few after each frame.

Where there are lifted poses, the evidence does not tell which prior is to lead; the image noise does, with either
in the lead (`leading_prior`).

A check changes nothing: it returns the solution that the track, as it was at the beginning, has from now on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.interpolation import interpolate_linearly
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.solvers.classification import (
    MIN_COMPARISON_NOISE,
    PERIODIC_CATEGORIES,
    PeriodicSwitch,
    fit_periodic_stepwise,
    measure_evidence,
    measure_tremble,
    minus_twice_log_evidence_stepwise,
)
from mocap_ros.solvers.joint.solver import (
    JointReconstruction,
    solve,
    solve_hypotheses,
    solve_hypotheses_stepwise,
    solve_stepwise,
    start_from_lifted_poses,
)
from mocap_ros.solvers.leading_prior import (
    can_base_poses_lead,
    explains_as_well,
    let_base_poses_lead,
)
from mocap_ros.solvers.periodic.repetition import measure_best_repetition, measure_repetition
from mocap_ros.solvers.periodic.solver import EstimatedPoses
from mocap_ros.solvers.window import InitialValues, Window, choose_initial_values
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.schedule import Classification
from mocap_ros.tracking.slices import Slices, compute_piece_cost, do_in_slices
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.solver_input import build_solver_window
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

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
INITIAL_MAX_ITERATIONS = (
    6  # steps of a first solution, which the first checks improve; limits the time of the frame
)
INITIAL_NOISE = 0.02  # m; image noise of a first solution: large, since a first lifted pose may be far off
EVIDENCE_MARGIN = 10.0  # -2 log evidence, a factor of exp(5) = 150; keeps the choice of a model from chattering
CHECK_STEP_S = 0.1  # s; one frame of each step is checked, for neighbouring frames add more time than evidence
CHECK_SPAN_S = 1.0  # s; newest part of the window that is checked, for the older part may be another motion
CLASSIFICATION_STEP_S = 1 / 15  # s; halves the frames of a 30 Hz stream, and samples a running cycle 10 times
CLASSIFICATION_MAX_ITERATIONS = 8  # steps of the periodic solver, which starts from the solution; limits the time
MIN_RUN_SPEED_M_S = 0.9  # m/s; RMS over the joints about the body's origin: 0.5 to 0.9 in walks, to 1.5 in runs
SPEED_STEP_S = 0.2  # s; over which the speed is taken, long enough for tremble to say little
# s; section of somebody who has walked or run shortly before and is expected to go on. Of others such short
# sections are called periodic too often: 0.09 of those with clean points, of 2 s 0.04 (training persons).
RESUMED_SECTION_S = 1.3
OTHER_MODEL_TURNS = 4  # classifications; one of so many tries the model that is less likely by the speed
# 1; smallest repetition of periodic motion. Walks have 0.74 and more with clean points, 0.6 as MediaPipe gives
# them and 0.25 as MoveNet does (training persons); other motion about 0.
MIN_REPETITION = 0.2
PERIODIC_COST = 2.4  # cost of a piece of the periodic solver over one of the joint solver with as many base poses
MIN_SECTION_SHARE = 0.9  # share of a section that must be filled before it is classified; stamps vary
KEY_POSE_STEP_S = 0.25  # s; poses nearer in time look the same to the memory of key poses
NOISE_RATIO = 0.88  # estimated noise over true image noise, of the base poses alone (CMU walks, docs/solvers.md)
NOISE_RATIO_WITH_LIFTER = 0.76  # the same ratio with the lifter's prior (CMU walks, docs/solvers.md)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A candidate explanation of some frames of a track.

    Attributes:
        model_name: name of the base-pose model.
        start: initial values of its solution.
        noise: m, image noise of its solution; infinite if it was not estimated.
    """

    model_name: str
    start: InitialValues
    noise: float


@dataclass(frozen=True, eq=False)
class CheckOutcome:
    """Result of a hypothesis check.

    Attributes:
        solution: solution of the track from now on; its own if that is the likeliest.
        is_replaced: whether a hypothesis replaced the track's own solution.
        model_names: names of the models of the hypotheses that were compared, the track's own last.
        minus_twice_log_evidence: value of each of these, up to a constant and without `EVIDENCE_MARGIN`; empty
            where leading priors were compared.
    """

    solution: TrackSolution
    is_replaced: bool
    model_names: tuple[str, ...]
    minus_twice_log_evidence: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class HypothesisChecker:
    """Initialises tracks, checks them against other hypotheses and classifies their motion.

    Attributes:
        models: base-pose models by name.
        config: all parameters.
    """

    models: Mapping[str, BasePoses]
    config: Config

    def remember_poses(self, memory: KeyPoseMemory, track: Track) -> KeyPoseMemory:
        """Return the memory with some poses of a track that is lost.

        Args:
            memory: memory so far.
            track: a solved track.
        """
        frames = track.seen.select_frames(KEY_POSE_STEP_S, self.config.tracker.window)
        observed = track.seen.observed.select_frames(frames)
        joints = track.solved.compute_joints(self.models[track.solved.model_name], frames)
        poses = observed.virtual_camera.to_virtual_camera(joints)
        for points, weight, pose in zip(observed.points, observed.weight, poses, strict=True):
            memory = memory.remember(points, weight, pose)
        return memory

    def initialise(
        self, tracks: Sequence[Track], model_names: Sequence[str], memory: KeyPoseMemory
    ) -> list[TrackSolution]:
        """Return the first solutions of tracks, from few steps of one batch for each model.

        The hypotheses are a solution from scratch under each model and, for a person who looks like a remembered
        pose, that pose under the first model. All are compared under the same image noise.

        Args:
            tracks: tracks without a solution, at least one.
            model_names: names of the candidate models.
            memory: key poses of people who were lost.
        """
        solver = replace(self.config.solver, max_iterations=INITIAL_MAX_ITERATIONS)
        first_model = self.models[model_names[0]]
        windows = [self._build_first_window(t, first_model) for t in tracks]
        fits: list[list[tuple[str, JointReconstruction]]] = [[] for _ in tracks]
        for name in model_names:
            for own_fits, fit in zip(fits, solve_hypotheses(windows, self.models[name], solver), strict=True):
                own_fits.append((name, fit))
        starts = [self._recall_start(t, memory, first_model) for t in tracks]
        recalled = [i for i, start in enumerate(starts) if start is not None]
        if recalled:
            started = [replace(windows[i], start=starts[i]) for i in recalled]
            for i, fit in zip(recalled, solve(started, first_model, solver), strict=True):
                fits[i].append((model_names[0], fit))
        solutions = []
        for track, own_fits in zip(tracks, fits, strict=True):
            evidence = [measure_evidence(fit, self.models[name], INITIAL_NOISE) for name, fit in own_fits]
            name, fit = own_fits[int(np.argmin(evidence))]
            frames, observed = np.arange(len(track.seen.stamps_ns)), track.seen.observed
            solutions.append(TrackSolution.interpolate(fit, observed, frames, name, self.models[name], None))
        return solutions

    def _build_first_window(self, track: Track, model: BasePoses) -> Window:
        """Return the frames of a new track as the input of a solver, with the same unit for all hypotheses."""
        window = replace(track.seen.observed.build_solver_window(), noise=INITIAL_NOISE)
        start, _ = choose_initial_values(
            start_from_lifted_poses(window, model), model, self.config.solver.start_window
        )
        return replace(window, unit=float(np.median(start.cameras.scale)))

    def _recall_start(self, track: Track, memory: KeyPoseMemory, model: BasePoses) -> InitialValues | None:
        """Return the remembered pose that a new track's newest frame looks like, for all its frames; or None."""
        newest, count = track.seen.observed.select_frames(slice(-1, None)), len(track.seen.stamps_ns)
        recalled = memory.recall(newest.points[0], newest.weight[0])
        if recalled is None:
            return None
        rotation = fit_rotation(model.mean, recalled.pose)
        theta = model.weights(recalled.pose @ rotation)
        cameras = WeakPerspectiveCameras(np.full(count, recalled.scale), np.tile(rotation, (count, 1, 1)))
        return InitialValues(np.tile(theta, (count, 1)), cameras)

    def reinitialise(self, track: Track, model_names: Iterable[str]) -> Slices[CheckOutcome]:
        """Solve a track from scratch under some models, and find the likeliest hypothesis.

        Args:
            track: a solved track.
            model_names: names of the candidate models.
        """
        frames = self._select_check_frames(track)
        window = self._build_window(track, frames)
        window_without_start = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self._choose_solver(track),
            max_iterations=REINIT_MAX_ITERATIONS,
            components=REINIT_COMPONENTS,
            noise_floor=MIN_COMPARISON_NOISE,
        )
        hypotheses = []
        for name in model_names:
            model = self.models[name]
            solution = solve_hypotheses_stepwise([window_without_start], model, solver)
            starts = MAX_STARTS if window.lifted is None else 1
            cost = compute_piece_cost(starts * len(frames), min(REINIT_COMPONENTS, len(model.std)))
            (fit,) = yield from do_in_slices(solution, cost)
            unsolved = len(model.std) - fit.theta.shape[1]
            theta = np.pad(fit.theta, [(0, 0), (0, max(unsolved, 0))])
            hypotheses.append(Hypothesis(name, InitialValues(theta, fit.cameras), fit.noise))
        return (yield from self._choose_likeliest(track, frames, window, hypotheses))

    def compare_models(self, track: Track, model_names: Iterable[str]) -> Slices[CheckOutcome]:
        """Convert the poses of a solved track to other models, and find the likeliest hypothesis.

        Args:
            track: a solved track.
            model_names: names of the candidate models; the track's own is compared in any case.
        """
        solution = track.solved
        frames = self._select_check_frames(track)
        observed = track.seen.observed.select_frames(frames)
        model = self.models[solution.model_name]
        hypotheses = []
        for name in model_names:
            if name != solution.model_name:
                rotation, theta = solution.convert_poses(model, self.models[name], frames)
                start = observed.convert_to_initial_values(theta, rotation, solution.roots[frames])
                hypotheses.append(Hypothesis(name, start, solution.noise))
        return (yield from self._choose_likeliest(track, frames, self._build_window(track, frames), hypotheses))

    def compare_leads(self, track: Track) -> Slices[CheckOutcome]:
        """Solve a track with either prior in the lead, from its own solution, and find out which is to lead.

        Args:
            track: a solved track.
        """
        own, frames = track.solved, self._select_check_frames(track)
        kept = CheckOutcome(own, False, (own.model_name,), ())
        if track.seen.observed.lifted is None or not can_base_poses_lead(own.model_name):
            return kept
        if len(frames) < MIN_LEAD_FRAMES:
            return kept
        name, window = own.model_name, self._build_window(track, frames)
        led = yield from self._settle(window, name, self._lead(base_poses_lead=True))
        by_lifter = yield from self._settle(window, name, self._lead(base_poses_lead=False))
        slack = LEAD_SLACK if own.base_poses_lead else 1.0
        base_poses_lead = explains_as_well(led.noise, by_lifter.noise, slack)
        if base_poses_lead == own.base_poses_lead:
            return kept
        fit = led if base_poses_lead else by_lifter
        solution = yield from self._adopt(track, frames, name, fit, base_poses_lead=base_poses_lead)
        return CheckOutcome(solution, True, (name,), ())

    def _settle(self, window: Window, model_name: str, solver: SolverConfig) -> Slices[JointReconstruction]:
        """Return the solution of a window with initial values, after some rounds in which its noise settles."""
        model, solver = self.models[model_name], replace(solver, max_iterations=COMPARISON_MAX_ITERATIONS)
        cost = compute_piece_cost(len(window.times), len(model.std))
        for _ in range(SETTLING_ROUNDS):
            (fit,) = yield from do_in_slices(solve_stepwise([window], model, solver), cost)
            window = replace(window, start=InitialValues(fit.theta, fit.cameras), noise=fit.noise)
        return fit

    def _lead(self, *, base_poses_lead: bool) -> SolverConfig:
        """Return the parameters of the solver with one or the other prior in the lead."""
        solver = self.config.solver
        return let_base_poses_lead(solver) if base_poses_lead else solver

    def _choose_solver(self, track: Track) -> SolverConfig:
        """Return the parameters of the solver with the prior in the lead that leads in the track's solution."""
        return self._lead(base_poses_lead=track.solved.base_poses_lead)

    def _build_window(self, track: Track, frames: NDArray[np.intp]) -> Window:
        """Return some frames of a solved track as the input of a solver."""
        return build_solver_window(track.seen, track.solved, frames)

    def _select_check_frames(self, track: Track) -> NDArray[np.intp]:
        """Return the indices of the frames that are checked, some of the newest."""
        return track.seen.select_frames(CHECK_STEP_S, CHECK_SPAN_S)

    def _choose_likeliest(
        self, track: Track, frames: NDArray[np.intp], window: Window, others: Sequence[Hypothesis]
    ) -> Slices[CheckOutcome]:
        """Return the likeliest of some hypotheses and the track's own solution.

        Args:
            track: a solved track.
            frames: (n,) indices of the frames to compare by, increasing.
            window: these frames, with the track's own solution as initial values.
            others: the other hypotheses.
        """
        own, start = track.solved, window.start
        if start is None:
            raise ValueError(f'track {track.id}: the window has no initial values')
        hypotheses = [*others, Hypothesis(own.model_name, start, own.noise)]
        noise = min(h.noise for h in hypotheses)
        solver = replace(self._choose_solver(track), max_iterations=COMPARISON_MAX_ITERATIONS)
        fits = []
        for h in hypotheses:
            model, started = self.models[h.model_name], replace(window, start=h.start)
            comparison = minus_twice_log_evidence_stepwise(started, model, noise, solver)
            fit = yield from do_in_slices(comparison, compute_piece_cost(len(frames), len(model.std)))
            fits.append(fit)
        names = tuple(h.model_name for h in hypotheses)
        evidence = tuple(value for value, _ in fits)
        handicaps = [EVIDENCE_MARGIN if own.model_name != name else 0.0 for name in names]
        likeliest = int(np.argmin(np.add(evidence, handicaps)))
        if likeliest == len(others):
            return CheckOutcome(own, False, names, evidence)
        lead = own.base_poses_lead
        solution = yield from self._adopt(
            track, frames, names[likeliest], fits[likeliest][1], base_poses_lead=lead
        )
        return CheckOutcome(solution, True, names, evidence)

    def _adopt(
        self,
        track: Track,
        frames: NDArray[np.intp],
        model_name: str,
        reconstruction: JointReconstruction,
        *,
        base_poses_lead: bool,
    ) -> Slices[TrackSolution]:
        """Return the solution of a track that follows from a reconstruction of some of its frames, refined."""
        model, seen, earlier = self.models[model_name], track.seen, track.solved
        if earlier.model_name != model_name:
            earlier = earlier.change_model(self.models[earlier.model_name], model_name, model)
        interpolate = partial(TrackSolution.interpolate, base_poses_lead=base_poses_lead)
        solution = interpolate(reconstruction, seen.observed, frames, model_name, model, earlier)
        solver = replace(self._lead(base_poses_lead=base_poses_lead), max_iterations=ADOPTION_MAX_ITERATIONS)
        frames = seen.select_frames(ADOPTION_STEP_S, self.config.tracker.window)
        window = build_solver_window(seen, solution, frames)
        refinement = solve_stepwise([window], model, solver)
        (refined,) = yield from do_in_slices(refinement, compute_piece_cost(len(frames), len(model.std)))
        return interpolate(refined, seen.observed, frames, model_name, model, solution)

    def classify_motion(self, track: Track) -> Slices[Classification | None]:
        """Classify the newest section of a track's window as periodic or not (TPAMI 2016, section 4.9).

        Args:
            track: a solved track.

        Returns:
            The kind of motion; None if a section is not almost full yet, or no model is periodic. Motion that
            does not repeat itself at any cadence is not periodic, whatever a model would say.
        """
        section_s, stamps_ns = self._choose_section(track), track.seen.stamps_ns
        duration_s = (stamps_ns[-1] - stamps_ns[0]) / NS_PER_S
        periodic_names = [n for n in PERIODIC_CATEGORIES if n in self.models]
        if not periodic_names:
            return None
        if duration_s < MIN_SECTION_SHARE * min(section_s, self.config.tracker.window):
            return None
        if not track.schedule.may_resume:  # a walk that has just gone on has hardly a cycle to repeat
            repetition = measure_best_repetition(track.seen.times_s, track.solved.theta)
            if repetition < MIN_REPETITION:
                return classify_as_other(track)
        for name in self._order_periodic_models(track, periodic_names):
            motion = yield from self._fit_periodic_motion(track, name)
            if motion is not None:
                return Classification(motion, name)
        return classify_as_other(track)

    def _choose_section(self, track: Track) -> float:
        """Return the length in s of the newest section of a track's window that is to be classified."""
        section_s = self.config.classifier.section
        return min(section_s, RESUMED_SECTION_S) if track.schedule.may_resume else section_s

    def _order_periodic_models(self, track: Track, periodic_names: Sequence[str]) -> list[str]:
        """Return the names of the periodic models to fit, the likeliest first.

        A track that is not periodic gets one model a classification: its own, or else that of people who move as
        fast, and now and then the other. A periodic track gets all of them before it counts as not periodic.
        """
        schedule, own_name = track.schedule, track.solved.model_name
        by_speed = 'run' if self._measure_speed(track) > MIN_RUN_SPEED_M_S else 'walk'
        candidates = [schedule.classification.periodic_model_name, own_name, by_speed, *periodic_names]
        likeliest = next(n for n in candidates if n in periodic_names)
        rest = [n for n in periodic_names if n != likeliest]
        if schedule.is_periodic:
            return [likeliest, *rest]
        is_turn_of_other = schedule.classification_count % OTHER_MODEL_TURNS == OTHER_MODEL_TURNS - 1
        return rest if rest and is_turn_of_other and own_name not in periodic_names else [likeliest]

    def _measure_speed(self, track: Track) -> float:
        """Return the RMS speed in m/s of a track's joints about the body's origin, over its window."""
        solution, model = track.solved, self.models[track.solved.model_name]
        times = track.seen.times_s
        later = np.arange(times[-1], times[0] + SPEED_STEP_S, -SPEED_STEP_S)
        if len(later) == 0:
            return 0.0
        theta = interpolate_linearly(np.append(later, later[-1] - SPEED_STEP_S), times, solution.theta)
        moved = np.diff(theta, axis=0) / (SPEED_STEP_S * solution.stature_ratio)
        return float(np.sqrt((moved**2).sum(axis=1).mean() / len(model.mean)))

    def _fit_periodic_motion(self, track: Track, name: str) -> Slices[Motion | None]:
        """Return the motion as one periodic model explains it; None if that model does not explain it."""
        settings = self.config.classifier
        frames = track.seen.select_frames(CLASSIFICATION_STEP_S, self._choose_section(track))
        window = self._build_window(track, frames)
        if window.start is None:
            return None
        window_without_start = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver, components=settings.components, max_iterations=CLASSIFICATION_MAX_ITERATIONS
        )
        poses = self._current_poses(track, window.start)
        try:
            fitting = fit_periodic_stepwise(window_without_start, {name: self.models[name]}, solver, poses)
            fit = yield from do_in_slices(
                fitting, PERIODIC_COST * compute_piece_cost(len(frames), settings.components)
            )
        except InputError:
            return None
        if not PeriodicSwitch(settings, track.schedule.is_periodic).update(fit):
            return None
        return Motion(MotionKind.PERIODIC, name, fit.residual, fit.reconstruction.cadence)

    def still_repeats(self, track: Track, classification: Classification) -> bool:
        """Return whether a track's newest motion may be periodic as a classification says, as far as one can tell.

        Args:
            track: a solved track.
            classification: of its motion up to this frame or shortly before it.
        """
        if classification.motion.kind is not MotionKind.PERIODIC:
            return True
        times = track.seen.times_s
        return not measure_repetition(times, track.solved.theta, classification.motion.cadence) < MIN_REPETITION

    def _current_poses(self, track: Track, start: InitialValues) -> EstimatedPoses:
        """Return the poses of the track's solution, with the bias of its noise estimate removed."""
        has_lifter = track.seen.observed.lifted is not None
        noise = track.solved.noise / (NOISE_RATIO_WITH_LIFTER if has_lifter else NOISE_RATIO)
        model = self.models[track.solved.model_name]
        joints = model.poses(start.theta) @ np.swapaxes(start.cameras.rotation, -1, -2)
        times = track.seen.times_s
        images = track.solved.compute_joints(model, np.arange(len(times)))[..., :2]
        return EstimatedPoses(joints, start.cameras.scale, noise, measure_tremble(times, images))


def classify_as_other(track: Track) -> Classification:
    """Return the classification of a solved track whose motion is not periodic."""
    solution = track.solved
    return Classification(Motion(MotionKind.NON_PERIODIC, solution.model_name, solution.residual, math.nan), '')
