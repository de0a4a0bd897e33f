"""Checks of a track against other hypotheses: another model, a solution from scratch, a periodic motion.

Hypotheses are compared by -2 log evidence of the image points (`classification.minus_twice_log_evidence`), all
under the same image noise. A hypothesis replaces the track's solution if its value is the lowest; one of another
model must be lower by `EVIDENCE_MARGIN`. A check costs as much as several frames, so the tracker makes few of them
at a time.

A check changes nothing: it returns the solution that the track has from now on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.solvers.classification import (
    MIN_COMPARISON_NOISE,
    PERIODIC_CATEGORIES,
    PeriodicSwitch,
    fit_periodic,
    minus_twice_log_evidence,
)
from mocap_ros.solvers.joint.solver import JointReconstruction, solve, solve_hypotheses
from mocap_ros.solvers.periodic.solver import EstimatedPoses
from mocap_ros.solvers.window import InitialValues, Window
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.schedule import Classification
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.solver_input import build_solver_window
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

REINIT_MAX_ITERATIONS = 5  # steps of a solution from scratch; limits its time, the comparison refines it further
REINIT_COMPONENTS = 20  # base poses of a solution from scratch; limits its time, the comparison uses all of them
COMPARISON_MAX_ITERATIONS = 4  # steps that each hypothesis gets before its evidence is compared; limits the time
ADOPTION_MAX_ITERATIONS = 3  # steps on all frames after a hypothesis of some of them was adopted; limits the time
EVIDENCE_MARGIN = 10.0  # -2 log evidence, a factor of exp(5) = 150; keeps the choice of a model from chattering
CHECK_STEP_S = 0.1  # s; one frame of each step is checked, for neighbouring frames add more time than evidence
CHECK_SPAN_S = 1.0  # s; newest part of the window that is checked, for the older part may be another motion
CLASSIFICATION_STEP_S = 1 / 15  # s; halves the frames of a 30 Hz stream, and samples a running cycle 10 times
CLASSIFICATION_MAX_ITERATIONS = 8  # steps of the periodic solver, which starts from the solution; limits the time
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
        model_names: names of the models of the hypotheses that were compared, the track's own last if it has one.
        minus_twice_log_evidence: value of each of these, up to a constant and without `EVIDENCE_MARGIN`.
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

    def initialise(self, track: Track, model_names: Sequence[str], memory: KeyPoseMemory) -> TrackSolution:
        """Return the first solution of a track.

        A remembered pose that looks like the person is a further hypothesis beside a solution from scratch.

        Args:
            track: a track without a solution.
            model_names: names of the candidate models.
            memory: key poses of people who were lost.
        """
        newest = track.seen.observed.select_frames(slice(-1, None))
        recalled = memory.recall(newest.points[0], newest.weight[0])
        hypotheses = []
        if recalled is not None:
            model = self.models[model_names[0]]
            rotation = fit_rotation(model.mean[None], recalled.pose[None])
            theta = model.weights(recalled.pose @ rotation)
            start = InitialValues(theta, WeakPerspectiveCameras(np.array([recalled.scale]), rotation))
            hypotheses.append(Hypothesis(model_names[0], start, math.inf))
        return self.reinitialise(track, model_names, hypotheses).solution

    def reinitialise(
        self, track: Track, model_names: Iterable[str], further: Sequence[Hypothesis] = ()
    ) -> CheckOutcome:
        """Solve a track from scratch under some models, and find the likeliest hypothesis.

        Args:
            track: the track.
            model_names: names of the candidate models.
            further: further hypotheses to compare with.
        """
        frames = self._select_check_frames(track)
        window = self._build_window(track, frames)
        window_without_start = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver,
            max_iterations=REINIT_MAX_ITERATIONS,
            components=REINIT_COMPONENTS,
            noise_floor=MIN_COMPARISON_NOISE,
        )
        hypotheses = list(further)
        for name in model_names:
            (fit,) = solve_hypotheses([window_without_start], self.models[name], solver)
            unsolved = len(self.models[name].std) - fit.theta.shape[1]
            theta = np.pad(fit.theta, [(0, 0), (0, max(unsolved, 0))])
            hypotheses.append(Hypothesis(name, InitialValues(theta, fit.cameras), fit.noise))
        return self._choose_likeliest(track, frames, window, hypotheses)

    def compare_models(self, track: Track, model_names: Iterable[str]) -> CheckOutcome:
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
        return self._choose_likeliest(track, frames, self._build_window(track, frames), hypotheses)

    def _build_window(self, track: Track, frames: NDArray[np.intp]) -> Window:
        """Return some frames of a track as the input of a solver."""
        if track.solution is None:
            return track.seen.observed.select_frames(frames).build_solver_window()
        return build_solver_window(track.seen, track.solution, frames)

    def _select_check_frames(self, track: Track) -> NDArray[np.intp]:
        """Return the indices of the frames that are checked: some of the newest, or all of an unsolved track."""
        if track.solution is not None:
            return track.seen.select_frames(CHECK_STEP_S, CHECK_SPAN_S)
        return np.arange(len(track.seen.stamps_ns))

    def _choose_likeliest(
        self, track: Track, frames: NDArray[np.intp], window: Window, hypotheses: Sequence[Hypothesis]
    ) -> CheckOutcome:
        """Return the likeliest of some hypotheses and the track's own solution, if it has one.

        Args:
            track: the track.
            frames: (n,) indices of the frames to compare by, increasing.
            window: these frames, with the track's own solution as initial values.
            hypotheses: the other hypotheses.
        """
        own = track.solution
        if own is not None and window.start is not None:
            hypotheses = [*hypotheses, Hypothesis(own.model_name, window.start, own.noise)]
        noise = min(h.noise for h in hypotheses)
        unit = float(np.median(hypotheses[-1].start.cameras.scale))
        solver = replace(self.config.solver, max_iterations=COMPARISON_MAX_ITERATIONS)
        fits = [
            minus_twice_log_evidence(
                replace(window, start=h.start, unit=unit), self.models[h.model_name], noise, solver
            )
            for h in hypotheses
        ]
        names = tuple(h.model_name for h in hypotheses)
        evidence = tuple(value for value, _ in fits)
        own_name = own.model_name if own is not None else None
        handicaps = [EVIDENCE_MARGIN if own_name not in (None, name) else 0.0 for name in names]
        likeliest = int(np.argmin(np.add(evidence, handicaps)))
        if own is not None and likeliest == len(hypotheses) - 1:
            return CheckOutcome(own, False, names, evidence)
        solution = self._adopt(track, frames, names[likeliest], fits[likeliest][1])
        return CheckOutcome(solution, own is not None, names, evidence)

    def _adopt(
        self, track: Track, frames: NDArray[np.intp], model_name: str, reconstruction: JointReconstruction
    ) -> TrackSolution:
        """Return the solution of a track that a reconstruction of some of its frames gives, refined on all."""
        model, seen = self.models[model_name], track.seen
        earlier = track.solution if frames[0] > 0 else None
        if earlier is not None and earlier.model_name != model_name:
            earlier = earlier.change_model(self.models[earlier.model_name], model_name, model)
        solution = TrackSolution.interpolate(reconstruction, seen.observed, frames, model_name, model, earlier)
        if len(frames) == len(seen.stamps_ns):
            return solution
        all_frames = np.arange(len(seen.stamps_ns))
        solver = replace(self.config.solver, max_iterations=ADOPTION_MAX_ITERATIONS)
        (refined,) = solve([build_solver_window(seen, solution, all_frames)], model, solver)
        return solution.refine(refined, seen.observed, 0, 0, model)

    def classify_motion(self, track: Track) -> Classification | None:
        """Classify the newest section of a track's window as periodic or not (TPAMI 2016, section 4.9).

        Args:
            track: a solved track.

        Returns:
            The kind of motion; None if a section is not almost full yet, or no model is periodic.
        """
        settings, solution, stamps_ns = self.config.classifier, track.solved, track.seen.stamps_ns
        duration_s = (stamps_ns[-1] - stamps_ns[0]) / NS_PER_S
        periodic_names = [n for n in PERIODIC_CATEGORIES if n in self.models]
        if not periodic_names:
            return None
        if duration_s < MIN_SECTION_SHARE * min(settings.section, self.config.tracker.window):
            return None
        for name in self._order_periodic_models(track, periodic_names):
            motion = self._fit_periodic_motion(track, name)
            if motion is not None:
                return Classification(motion, name)
        motion = Motion(MotionKind.NON_PERIODIC, solution.model_name, solution.residual, math.nan)
        return Classification(motion, '')

    def _order_periodic_models(self, track: Track, periodic_names: Sequence[str]) -> list[str]:
        """Return the names of the periodic models to fit, the likeliest first.

        A track that is not periodic gets one model a classification, in turn unless its own model is periodic. A
        track that is periodic gets all of them before it counts as not periodic.
        """
        schedule, own_name = track.schedule, track.solved.model_name
        is_periodic = schedule.classification.motion.kind is MotionKind.PERIODIC
        candidates = [schedule.classification.periodic_model_name, own_name, *periodic_names]
        likeliest = next(n for n in candidates if n in periodic_names)
        rest = [n for n in periodic_names if n != likeliest]
        takes_turns = not is_periodic and own_name not in periodic_names
        turn = schedule.classification_count % 2 if takes_turns else 0
        return [likeliest, *rest][turn : turn + 1] + (rest if is_periodic else [])

    def _fit_periodic_motion(self, track: Track, name: str) -> Motion | None:
        """Return the motion as one periodic model explains it; None if that model does not explain it."""
        settings = self.config.classifier
        frames = track.seen.select_frames(CLASSIFICATION_STEP_S, settings.section)
        window = self._build_window(track, frames)
        if window.start is None:
            return None
        window_without_start = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver, components=settings.components, max_iterations=CLASSIFICATION_MAX_ITERATIONS
        )
        poses = self._current_poses(track, window.start)
        try:
            fit = fit_periodic(window_without_start, {name: self.models[name]}, solver, poses)
        except InputError:
            return None
        was_periodic = track.schedule.classification.motion.kind is MotionKind.PERIODIC
        if not PeriodicSwitch(settings, was_periodic).update(fit):
            return None
        return Motion(MotionKind.PERIODIC, name, fit.residual, fit.reconstruction.cadence)

    def _current_poses(self, track: Track, start: InitialValues) -> EstimatedPoses:
        """Return the poses of the track's solution, with the bias of its noise estimate removed."""
        has_lifter = track.seen.observed.lifted is not None
        noise = track.solved.noise / (NOISE_RATIO_WITH_LIFTER if has_lifter else NOISE_RATIO)
        model = self.models[track.solved.model_name]
        joints = model.poses(start.theta) @ np.swapaxes(start.cameras.rotation, -1, -2)
        return EstimatedPoses(joints, start.cameras.scale, noise)
