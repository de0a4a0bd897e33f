"""The tracker: a sliding window for each person, and a reconstruction of it at every new frame.

Pure: no ROS, no clock, no files. Its state depends only on the frames it accepted, in their order, so a
replay of those frames gives the same people.

Provisional: motion is not classified yet (`MotionKind.UNKNOWN`); a person who is not detected is not predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap_ros.base_poses import BasePoses
from mocap_ros.camera import Cameras
from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped
from mocap_ros.nonperiodic import solve, solve_hypotheses
from mocap_ros.people import Intrinsics, Motion, MotionKind, Person2D, Person3D
from mocap_ros.reconstruction import Reconstruction, Start, Window
from mocap_ros.skeleton import joint_map

Array = NDArray[np.float64]

NS = 1_000_000_000
FARTHEST_MATCH = 1.0


def to_model_joints(person: Person2D, min_score: float) -> tuple[Array, Array]:
    """(J, 2) px and (J,) scores of the model's joints; score 0 (point 0) where not seen.

    Raises:
        SkeletonError: the person's joints do not cover enough of the model's.
    """
    score = np.where(person.score >= min_score, person.score, 0.0)
    points, trust = joint_map(person.joints).apply(person.points, score)
    return np.where(trust[:, None] > 0, points, 0.0), trust


def root_position(translation: Array, scale: Array, intrinsics: Intrinsics) -> Array:
    """(..., 3) m, the body's origin in the camera's optical frame: depth = focal length / scale.

    Args:
        translation: (..., 2) px, image of the body's origin.
        scale: (...,) px/m.
        intrinsics: of the camera.
    """
    depth = intrinsics.focal / scale
    ray = (translation - np.array(intrinsics.center)) / intrinsics.focal
    return np.concatenate([ray * depth[..., None], depth[..., None]], axis=-1)


@dataclass(eq=False)
class _Window:
    """The recent frames of one person and the last solution."""

    id: str
    given_id: str
    times: list[int] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    weight: list[Array] = field(default_factory=list)
    solution: Reconstruction | None = None
    fresh_at: int = 0

    def push(self, stamp_ns: int, points: Array, weight: Array, length: float) -> None:
        self.times.append(stamp_ns)
        self.points.append(points)
        self.weight.append(weight)
        gone = sum(t < stamp_ns - length * NS for t in self.times)
        del self.times[:gone], self.points[:gone], self.weight[:gone]
        if self.solution is not None:
            self.solution = replace(
                self.solution,
                theta=self.solution.theta[gone:],
                cameras=Cameras(self.solution.cameras.scale[gone:], self.solution.cameras.rotation[gone:]),
            )

    def warm(self) -> Window:
        """The window as a solver wants it, starting from the last solution with its newest frame repeated."""
        stamps = np.array(self.times)
        plain = Window(np.array(self.points), np.array(self.weight), (stamps - stamps[0]) / NS)
        if self.solution is None or not len(self.solution.theta):
            return plain
        theta, cameras = self.solution.theta, self.solution.cameras
        missing = len(stamps) - len(theta)
        start = Start(
            np.concatenate([theta, np.repeat(theta[-1:], missing, axis=0)]),
            Cameras(
                np.concatenate([cameras.scale, np.repeat(cameras.scale[-1:], missing)]),
                np.concatenate([cameras.rotation, np.repeat(cameras.rotation[-1:], missing, axis=0)]),
            ),
        )
        return replace(
            plain,
            start=start,
            unit=float(np.median(start.cameras.scale)),
            noise=self.solution.noise,
        )

    def where(self) -> tuple[Array, float]:
        """Image centre and size (RMS radius), px, of the newest frame's seen joints."""
        return _extent(self.points[-1], self.weight[-1])


def _extent(points: Array, weight: Array) -> tuple[Array, float]:
    seen = points[weight > 0]
    centre = seen.mean(axis=0)
    return centre, float(np.sqrt(((seen - centre) ** 2).sum(axis=1).mean())) + 1e-6


class Tracker:
    """Turns 2D keypoints, frame by frame, into 3D people.

    Args:
        model: base poses.
        config: of solver and tracker.

    Attributes:
        went_back: s by which the stamp of the last accepted frame went back, so that it started afresh; else 0.
    """

    def __init__(self, model: BasePoses, config: Config) -> None:
        self.config = config
        self.model = model.rescaled(config.tracker.body_height / model.stature)
        self.went_back = 0.0
        self._windows: list[_Window] = []
        self._newest: int | None = None
        self._born = 0

    def reset(self) -> None:
        """Forget everybody and every stamp."""
        self._windows = []
        self._newest = None
        self._born = 0

    def update(self, stamp_ns: int, people: Sequence[Person2D], intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        """One new frame; where its stamp is older than the newest by more than `restart_after`, the first one.

        Args:
            stamp_ns: time of the image, ns.
            people: everyone detected in it, possibly nobody.
            intrinsics: of the camera.

        Returns:
            Everyone reconstructed in this frame, in the order of `people`; people with fewer than `min_joints`
            seen joints who are not known from earlier frames are left out.

        Raises:
            FrameDropped: the stamp repeats the newest or is a little older; nothing has changed then.
            SkeletonError: joints that do not fit the model; nothing has changed then.
        """
        settings = self.config.tracker
        back_ns = 0 if self._newest is None else self._newest - stamp_ns
        restart = back_ns > settings.restart_after * NS
        if self._newest is not None and back_ns >= 0 and not restart:
            what = 'is older than' if back_ns else 'repeats'
            raise FrameDropped(f'stamp {stamp_ns} ns {what} the newest accepted, {self._newest} ns')
        seen = [(p.id, *to_model_joints(p, settings.min_score)) for p in people]
        if restart:
            self.reset()
        self.went_back = back_ns / NS if restart else 0.0
        self._newest = stamp_ns
        keep = stamp_ns - settings.forget_after * NS
        self._windows = [w for w in self._windows if w.times[-1] >= keep]

        tracked = [
            (window, points, weight)
            for window, (_, points, weight) in zip(self._associate(seen), seen, strict=True)
            if window is not None
        ]
        for window, points, weight in tracked:
            window.push(stamp_ns, points, weight, settings.window)
        windows = [window for window, _, _ in tracked]
        return tuple(
            self._person(window, solution, intrinsics)
            for window, solution in zip(windows, self._solve(windows), strict=True)
        )

    def _associate(self, seen: Sequence[tuple[str, Array, Array]]) -> list[_Window | None]:
        """The window of each detection: by the detector's id, else by position and size, else new."""
        enough = [(weight > 0).sum() >= self.config.tracker.min_joints for _, _, weight in seen]
        found: list[_Window | None] = [None] * len(seen)
        by_id = {w.given_id: w for w in self._windows if w.given_id}
        for i, (given, _, _) in enumerate(seen):
            if given and enough[i]:
                found[i] = by_id.pop(given, None) or self._new_window(given)
        nameless = [i for i, (given, _, _) in enumerate(seen) if not given and enough[i]]
        free = [w for w in self._windows if not w.given_id]
        if nameless and free:
            distance = np.empty((len(nameless), len(free)))
            for row, i in enumerate(nameless):
                centre, size = _extent(seen[i][1], seen[i][2])
                for column, window in enumerate(free):
                    old_centre, old_size = window.where()
                    apart = np.linalg.norm(centre - old_centre) / max(size, old_size)
                    distance[row, column] = apart + abs(np.log(size / old_size))
            for row, column in zip(*linear_sum_assignment(distance), strict=True):
                if distance[row, column] < FARTHEST_MATCH:
                    found[nameless[row]] = free[column]
        for i in nameless:
            if found[i] is None:
                found[i] = self._new_window('')
        return found

    def _new_window(self, given_id: str) -> _Window:
        name = given_id
        taken = {w.id for w in self._windows}
        while not name or name in taken:
            self._born += 1
            name = f'person_{self._born}'
        window = _Window(name, given_id)
        self._windows.append(window)
        return window

    def _solve(self, windows: Sequence[_Window]) -> list[Reconstruction]:
        """Everybody's reconstruction as one batch: warm from the last one, now and then also from scratch."""
        settings, solver = self.config.tracker, self.config.solver
        components = min(settings.components, solver.components)
        started = [(w, w.warm()) for w in windows if w.solution is not None]
        due = [w for w in windows if w.solution is None or w.times[-1] - w.fresh_at >= settings.fresh_every * NS]
        fresh = [(w, replace(w.warm(), start=None)) for w in due]
        best: dict[str, Reconstruction] = {}
        for batch, iterations, how in (
            (started, settings.warm_iterations, solve),
            (fresh, settings.fresh_iterations, solve_hypotheses),
        ):
            limited = replace(solver, max_iterations=iterations, components=components)
            solutions = how([b for _, b in batch], self.model, limited) if batch else ()
            for (window, _), solution in zip(batch, solutions, strict=True):
                rival = best.get(window.id)
                if rival is None or solution.objective[-1] < rival.objective[-1]:
                    best[window.id] = solution
        for window in due:
            window.fresh_at = window.times[-1]
        for window in windows:
            window.solution = best[window.id]
        return [best[window.id] for window in windows]

    def _person(self, window: _Window, solution: Reconstruction, intrinsics: Intrinsics) -> Person3D:
        scale = solution.cameras.scale[-1:]
        root = root_position(solution.translation[-1:], scale, intrinsics)[0]
        joints = len(self.model.mean)
        size = _extent(solution.joints[-1, :, :2], np.ones(joints))[1] * scale[0]
        residual = float(np.sqrt(np.nanmean(solution.residual**2)))
        return Person3D(
            id=window.id,
            joints=solution.joints[-1] + root,
            std=np.full(joints, np.nan),
            filled=window.weight[-1] == 0,
            scale=float(scale[0]),
            rotation=solution.cameras.rotation[-1],
            translation=solution.translation[-1],
            motion=Motion(MotionKind.UNKNOWN, self.model.name, residual / size, float('nan')),
            residual=float(solution.residual[-1]),
            scale_known=intrinsics.known,
            predicted=False,
        )
