"""Checks of a track against other hypotheses: another model, a solution from scratch, a periodic motion.

Hypotheses are compared by -2 log evidence of the image points (`classification.minus_twice_log_evidence`), all
under the same image noise. A hypothesis replaces the track's solution if its value is the lowest; one of another
model must be lower by `EVIDENCE_MARGIN`. A check costs as much as several frames, so the tracker makes few of them
at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.virtual_camera import solver_focal
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
from mocap_ros.solvers.joint.solver import solve, solve_hypotheses
from mocap_ros.solvers.window import InitialValues, Reconstruction, Window
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

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
MIN_TOTAL_WEIGHT = 1e-12  # no unit; guards the division by the scores of a frame in which nothing was seen


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
class HypothesisChecker:
    """Initialises tracks, checks them against other hypotheses and classifies their motion.

    Attributes:
        models: base-pose models by name.
        config: all parameters.
    """

    models: Mapping[str, BasePoses]
    config: Config

    def build_window(
        self, track: Track, camera: Intrinsics, frames: NDArray[np.intp], fixed_frames: int = 0
    ) -> Window:
        """Return some frames of a track as the input of a solver.

        Args:
            track: the track.
            camera: intrinsics of the real camera.
            frames: (n,) indices of the frames, increasing.
            fixed_frames: number of frames at the beginning that the solver must not change.
        """
        model = self.models[track.model_name] if track.model_name else next(iter(self.models.values()))
        focal = solver_focal(camera, self.config.tracker.perspective)
        return track.build_window(camera, focal, frames, fixed_frames, model)

    def remember_poses(self, memory: KeyPoseMemory, track: Track, camera: Intrinsics) -> KeyPoseMemory:
        """Return the memory with some poses of a track that is lost.

        Args:
            memory: memory so far.
            track: a solved track.
            camera: intrinsics of the real camera.
        """
        view, model = track.virtual_camera(camera), self.models[track.model_name]
        frames = track.select_frames(KEY_POSE_STEP_S, self.config.tracker.window)
        images = view.project_rays(track.corrected_rays[frames])
        poses = track.compute_joints(model, frames) @ view.rotation.T
        for points, weight, pose in zip(images, track.corrected_weight[frames], poses, strict=True):
            memory = memory.remember(points, weight, pose)
        return memory

    def initialise(
        self, track: Track, camera: Intrinsics, model_names: Sequence[str], memory: KeyPoseMemory
    ) -> None:
        """Find the first solution of a track.

        A remembered pose that looks like the person is a further hypothesis beside a solution from scratch.

        Args:
            track: a track without a solution.
            camera: intrinsics of the real camera.
            model_names: names of the candidate models.
            memory: key poses of people who were lost.
        """
        image = track.virtual_camera(camera).project_rays(track.corrected_rays)[-1]
        recalled = memory.recall(image, track.corrected_weight[-1])
        hypotheses = []
        if recalled is not None:
            model = self.models[model_names[0]]
            rotation = fit_rotation(model.mean[None], recalled.pose[None])
            theta = model.weights(recalled.pose @ rotation)
            start = InitialValues(theta, WeakPerspectiveCameras(np.array([recalled.scale]), rotation))
            hypotheses.append(Hypothesis(model_names[0], start, math.inf))
        self.reinitialise(track, camera, model_names, hypotheses)

    def reinitialise(
        self, track: Track, camera: Intrinsics, model_names: Iterable[str], further: Sequence[Hypothesis] = ()
    ) -> None:
        """Solve a track from scratch under some models, and adopt the likeliest hypothesis.

        Args:
            track: the track.
            camera: intrinsics of the real camera.
            model_names: names of the candidate models.
            further: further hypotheses to compare with.
        """
        frames = self._select_check_frames(track)
        window = self.build_window(track, camera, frames)
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
        self._adopt_likeliest(track, camera, frames, window, hypotheses)

    def compare_models(self, track: Track, camera: Intrinsics, model_names: Iterable[str]) -> None:
        """Convert the poses of a solved track to other models, and adopt the likeliest hypothesis.

        Args:
            track: a solved track.
            camera: intrinsics of the real camera.
            model_names: names of the candidate models.
        """
        frames = self._select_check_frames(track)
        window = self.build_window(track, camera, frames)
        hypotheses = []
        for name in model_names:
            if name != track.model_name and window.start is not None:
                model = self.models[track.model_name]
                rotation, theta = track.convert_poses(model, self.models[name], frames)
                rotation = track.virtual_camera(camera).rotation @ rotation
                cameras = WeakPerspectiveCameras(window.start.cameras.scale, rotation)
                hypotheses.append(Hypothesis(name, InitialValues(theta, cameras), track.noise))
        self._adopt_likeliest(track, camera, frames, window, hypotheses)

    def _select_check_frames(self, track: Track) -> NDArray[np.intp]:
        """Return the indices of the frames that are checked: some of the newest, or all of an unsolved track."""
        if track.is_solved:
            return track.select_frames(CHECK_STEP_S, CHECK_SPAN_S)
        return np.arange(len(track.stamps_ns))

    def _adopt_likeliest(
        self,
        track: Track,
        camera: Intrinsics,
        frames: NDArray[np.intp],
        window: Window,
        hypotheses: list[Hypothesis],
    ) -> None:
        """Replace the track's solution by the likeliest of some hypotheses, unless it is itself the likeliest."""
        if window.start is not None:
            hypotheses = [*hypotheses, Hypothesis(track.model_name, window.start, track.noise)]
        noise = min(h.noise for h in hypotheses)
        unit = float(np.median(hypotheses[-1].start.cameras.scale))
        solver = replace(self.config.solver, max_iterations=COMPARISON_MAX_ITERATIONS)
        evidence, solutions = [], []
        for hypothesis in hypotheses:
            window_of_hypothesis = replace(window, start=hypothesis.start, unit=unit)
            model = self.models[hypothesis.model_name]
            value, solution = minus_twice_log_evidence(window_of_hypothesis, model, noise, solver)
            is_other_model = track.is_solved and hypothesis.model_name != track.model_name
            evidence.append(value + EVIDENCE_MARGIN * is_other_model)
            solutions.append(solution)
        likeliest = int(np.argmin(evidence))
        if track.is_solved and likeliest == len(hypotheses) - 1:
            return
        self._adopt(track, camera, frames, hypotheses[likeliest].model_name, solutions[likeliest])

    def _adopt(
        self,
        track: Track,
        camera: Intrinsics,
        frames: NDArray[np.intp],
        model_name: str,
        solution: Reconstruction,
    ) -> None:
        """Replace the track's solution by one of some of its frames, and refine all frames from there."""
        model = self.models[model_name]
        if frames[0] > 0:
            track.change_model(self.models[track.model_name], model)
        track.model_name = model_name
        track.store_interpolated_solution(solution, frames, camera)
        if len(frames) < len(track.stamps_ns):
            all_frames = np.arange(len(track.stamps_ns))
            solver = replace(self.config.solver, max_iterations=ADOPTION_MAX_ITERATIONS)
            (refined,) = solve([self.build_window(track, camera, all_frames)], model, solver)
            track.store_solution(refined, all_frames, 0, camera)
        track.update_stature_ratio(model)

    def classify_motion(self, track: Track, camera: Intrinsics) -> None:
        """Classify the newest section of a track's window as periodic or not (TPAMI 2016, section 4.9).

        The track's motion does not change before a section is almost full.

        Args:
            track: a solved track.
            camera: intrinsics of the real camera.
        """
        settings = self.config.classifier
        duration_s = (track.stamps_ns[-1] - track.stamps_ns[0]) / NS_PER_S
        periodic_names = [n for n in PERIODIC_CATEGORIES if n in self.models]
        if not periodic_names:
            return
        if duration_s < MIN_SECTION_SHARE * min(settings.section, self.config.tracker.window):
            return
        was_periodic = track.motion.kind is MotionKind.PERIODIC
        switch = PeriodicSwitch(settings, was_periodic)
        for name in self._order_periodic_models(track, periodic_names):
            motion = self._fit_periodic_motion(track, camera, name, switch)
            if motion is not None:
                track.motion, track.periodic_model_name = motion, name
                break
        else:
            track.motion = Motion(MotionKind.NON_PERIODIC, track.model_name, track.residual, math.nan)
            track.periodic_model_name = ''
        track.classification_count += 1

    def _order_periodic_models(self, track: Track, periodic_names: Sequence[str]) -> list[str]:
        """Return the names of the periodic models to fit, the likeliest first.

        A track that is not periodic gets one model a classification, in turn unless its own model is periodic. A
        track that is periodic gets all of them before it counts as not periodic.
        """
        is_periodic = track.motion.kind is MotionKind.PERIODIC
        candidates = [track.periodic_model_name, track.model_name, *periodic_names]
        likeliest = next(n for n in candidates if n in periodic_names)
        rest = [n for n in periodic_names if n != likeliest]
        takes_turns = not is_periodic and track.model_name not in periodic_names
        turn = track.classification_count % 2 if takes_turns else 0
        return [likeliest, *rest][turn : turn + 1] + (rest if is_periodic else [])

    def _fit_periodic_motion(
        self, track: Track, camera: Intrinsics, name: str, switch: PeriodicSwitch
    ) -> Motion | None:
        """Return the motion as one periodic model explains it; None if that model does not explain it."""
        frames = track.select_frames(CLASSIFICATION_STEP_S, self.config.classifier.section)
        window = self.build_window(track, camera, frames)
        if window.start is None:
            return None
        window_without_start = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver,
            components=self.config.classifier.components,
            max_iterations=CLASSIFICATION_MAX_ITERATIONS,
        )
        start = self._current_reconstruction(track, window, window.start)
        try:
            fit = fit_periodic(window_without_start, {name: self.models[name]}, solver, start)
        except InputError:
            return None
        if not replace(switch).update(fit):
            return None
        return Motion(MotionKind.PERIODIC, name, fit.residual, fit.reconstruction.cadence)

    def _current_reconstruction(self, track: Track, window: Window, start: InitialValues) -> Reconstruction:
        """Return the track's solution as a reconstruction, with the bias of its noise estimate removed."""
        noise = track.noise / (NOISE_RATIO if track.lifted is None else NOISE_RATIO_WITH_LIFTER)
        model = self.models[track.model_name]
        joints = model.poses(start.theta) @ np.swapaxes(start.cameras.rotation, -1, -2)
        projected = start.cameras.scale[:, None, None] * joints[..., :2]
        total_weight = np.maximum(window.weight.sum(axis=1), MIN_TOTAL_WEIGHT)[:, None]
        error = window.points - projected
        return Reconstruction(
            joints=joints,
            theta=start.theta,
            cameras=start.cameras,
            translation=(window.weight[..., None] * error).sum(axis=1) / total_weight,
            residual=np.zeros(len(joints)),
            objective=(0.0,),
            iterations=0,
            converged=True,
            noise=noise,
            joint_std=np.full(joints.shape[1], np.nan),
        )
