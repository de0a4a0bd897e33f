"""What is asked of a track now and then: is it another motion, is the camera wrong, is the motion periodic?

Each question costs as much as several frames, so the tracker asks few of them at a time.
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
from mocap_ros.geometry.rotations import rotation_to
from mocap_ros.geometry.virtual_camera import solver_focal
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Motion, MotionKind
from mocap_ros.solvers.classification import (
    LEAST_NOISE,
    PERIODIC_CATEGORIES,
    PeriodicSwitch,
    fit_periodic,
    log_evidence,
)
from mocap_ros.solvers.joint.solver import solve, solve_hypotheses
from mocap_ros.solvers.window import Reconstruction, Start, Window
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.track import NS, Track

Array = NDArray[np.float64]

FRESH_ITERATIONS, FRESH_COMPONENTS = 5, 20
JUDGING_ITERATIONS = 4
ADOPT_ITERATIONS = 3
MODEL_MARGIN = 10.0
THIN_STEP, THIN_SPAN = 0.1, 1.0
MOTION_STEP, MOTION_ITERATIONS = 1 / 15, 8
FULL_SECTION = 0.9
REMEMBER_STEP = 0.25
NOISE_FOUND, NOISE_FOUND_LIFTED = 0.88, 0.76  # share of the true image noise that the solver finds, on CMU


@dataclass(frozen=True, eq=False)
class Rival:
    """An explanation of some frames: a model, where to begin with it, and the noise (m) if it is known."""

    model: str
    start: Start
    noise: float


@dataclass(frozen=True, eq=False)
class Examiner:
    """Asks with these models, by name."""

    models: Mapping[str, BasePoses]
    config: Config

    def window(self, track: Track, camera: Intrinsics, frames: NDArray[np.intp], held: int = 0) -> Window:
        """These frames of a track, the first `held` of them fixed."""
        model = self.models[track.model] if track.model else next(iter(self.models.values()))
        return track.window(camera, solver_focal(camera, self.config.tracker.perspective), frames, held, model)

    def remembered(self, memory: KeyPoseMemory, track: Track, camera: Intrinsics) -> KeyPoseMemory:
        """The memory with some poses of a track that is lost."""
        view, model = track.view(camera), self.models[track.model]
        frames = track.spaced(REMEMBER_STEP, self.config.tracker.window)
        rays, weight = (part[frames] for part in track.right)
        poses = track.joints(model, frames) @ view.turn.T
        for points, seen, pose in zip(view.image(rays), weight, poses, strict=True):
            memory = memory.remember(points, seen, pose)
        return memory

    def begin(self, track: Track, camera: Intrinsics, names: Sequence[str], memory: KeyPoseMemory) -> None:
        """A first solution of a new track; a pose remembered that looks the same is a rival (Loy et al. 2004)."""
        rays, weight = track.right
        recalled = memory.recall(track.view(camera).image(rays)[-1], weight[-1])
        rivals = []
        if recalled is not None:
            model = self.models[names[0]]
            rotation = rotation_to(model.mean[None], recalled.pose[None])
            theta = model.weights(recalled.pose @ rotation)
            rivals.append(Rival(names[0], Start(theta, Cameras(np.array([recalled.scale]), rotation)), math.inf))
        self.start_afresh(track, camera, names, rivals)

    def start_afresh(
        self, track: Track, camera: Intrinsics, names: Iterable[str], rivals: Sequence[Rival] = ()
    ) -> None:
        """Solve from scratch under these models, and take the likeliest, or a rival, if it beats what there is."""
        frames = track.spaced(THIN_STEP, THIN_SPAN) if track.solved else np.arange(len(track.stamps))
        window = self.window(track, camera, frames)
        fresh = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver,
            max_iterations=FRESH_ITERATIONS,
            components=FRESH_COMPONENTS,
            noise_floor=LEAST_NOISE,
        )
        rivals = list(rivals)
        for name in names:
            (fit,) = solve_hypotheses([fresh], self.models[name], solver)
            rest = len(self.models[name].std) - fit.theta.shape[1]
            theta = np.pad(fit.theta, [(0, 0), (0, max(rest, 0))])
            rivals.append(Rival(name, Start(theta, fit.cameras), fit.noise))
        self._compete(track, camera, frames, window, rivals)

    def compare(self, track: Track, camera: Intrinsics, names: Iterable[str]) -> None:
        """Explain the same 3D poses by these models, and take the likeliest over if it beats the one in use."""
        frames = track.spaced(THIN_STEP, THIN_SPAN)
        window = self.window(track, camera, frames)
        rivals = []
        for name in names:
            if name != track.model and window.start is not None:
                rotation, theta = track.reposed(self.models[track.model], self.models[name], frames)
                start = Start(theta, Cameras(window.start.cameras.scale, track.view(camera).turn @ rotation))
                rivals.append(Rival(name, start, track.noise))
        self._compete(track, camera, frames, window, rivals)

    def _compete(
        self, track: Track, camera: Intrinsics, frames: NDArray[np.intp], window: Window, rivals: list[Rival]
    ) -> None:
        """The likeliest of these and of the track's own solution becomes the track's.

        All are judged under the same image noise; another model than the one in use must be likelier by a margin,
        so that the choice does not chatter.
        """
        if window.start is not None:
            rivals = [*rivals, Rival(track.model, window.start, track.noise)]
        noise = min(r.noise for r in rivals)
        unit = float(np.median(rivals[-1].start.cameras.scale))
        solver = replace(self.config.solver, max_iterations=JUDGING_ITERATIONS)
        judged = [
            log_evidence(replace(window, start=r.start, unit=unit), self.models[r.model], noise, solver)
            for r in rivals
        ]
        evidence = [
            e + MODEL_MARGIN * (track.solved and r.model != track.model)
            for r, (e, _) in zip(rivals, judged, strict=True)
        ]
        best = int(np.argmin(evidence))
        if track.solved and best == len(rivals) - 1:
            return
        model = self.models[rivals[best].model]
        if frames[0] > 0:
            track.repose(self.models[track.model], model)
        track.model = rivals[best].model
        track.adopt(judged[best][1], frames, camera)
        if len(frames) < len(track.stamps):
            every = np.arange(len(track.stamps))
            limited = replace(self.config.solver, max_iterations=ADOPT_ITERATIONS)
            (whole,) = solve([self.window(track, camera, every)], self.models[track.model], limited)
            track.take(whole, every, 0, camera)
        track.resize(self.models[track.model])

    def motion(self, track: Track, camera: Intrinsics) -> None:
        """Judge whether the newest section of the window is periodic."""
        settings = self.config.classifier
        names = [n for n in PERIODIC_CATEGORIES if n in self.models]
        length = (track.stamps[-1] - track.stamps[0]) / NS
        if not names or length < FULL_SECTION * min(settings.section, self.config.tracker.window):
            return
        was = track.motion.kind is MotionKind.PERIODIC
        switch = PeriodicSwitch(settings, was)
        likely = [track.periodic_model, track.model, *names]
        first = next(n for n in likely if n in names)
        others = [n for n in names if n != first]
        turn = track.motions % 2 if not was and track.model not in names else 0
        for name in [first, *others][turn : turn + 1] + ([*others] if was else []):
            answer = self._periodic(track, camera, name, switch)
            if answer is not None:
                track.motion, track.periodic_model = answer, name
                break
        else:
            track.motion = Motion(MotionKind.NON_PERIODIC, track.model, track.residual, math.nan)
            track.periodic_model = ''
        track.motions += 1

    def _periodic(self, track: Track, camera: Intrinsics, name: str, switch: PeriodicSwitch) -> Motion | None:
        """The motion as this model's periodic form explains it, or None where it does not."""
        frames = track.spaced(MOTION_STEP, self.config.classifier.section)
        window = self.window(track, camera, frames)
        if window.start is None:
            return None
        plain = replace(window, start=None, unit=None, noise=None)
        solver = replace(
            self.config.solver, components=self.config.classifier.components, max_iterations=MOTION_ITERATIONS
        )
        try:
            fit = fit_periodic(plain, {name: self.models[name]}, solver, self._begun(track, window))
        except InputError:
            return None
        trial = replace(switch)
        if not trial.update(fit):
            return None
        return Motion(MotionKind.PERIODIC, name, fit.residual, fit.reconstruction.cadence)

    def _begun(self, track: Track, window: Window) -> Reconstruction:
        """The track's solution as the start of another solver."""
        start = window.start
        if start is None:
            raise InputError('nothing was solved yet')
        noise = track.noise / (NOISE_FOUND if track.lifted is None else NOISE_FOUND_LIFTED)
        model = self.models[track.model]
        joints = model.poses(start.theta) @ np.swapaxes(start.cameras.rotation, -1, -2)
        shown = start.cameras.scale[:, None, None] * joints[..., :2]
        total = np.maximum(window.weight.sum(axis=1), 1e-12)[:, None]
        translation = (window.weight[..., None] * (window.points - shown)).sum(axis=1) / total
        return Reconstruction(
            joints, start.theta, start.cameras, translation, np.zeros(len(joints)), (0.0,), 0, True, noise,
            np.full(joints.shape[1], np.nan),
        )  # fmt: skip
