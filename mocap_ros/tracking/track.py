"""One person's recent frames and what is known of them: the sliding window and its solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_to, rotation_vector, small_rotation
from mocap_ros.geometry.virtual_camera import View, facing
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.keypoints.association import extent
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import Lifted, histories, joined
from mocap_ros.people import Motion, MotionKind
from mocap_ros.skeleton import stature
from mocap_ros.solvers.window import Older, Reconstruction, Start, Window

Array = NDArray[np.float64]

NS = 1_000_000_000
VELOCITY_SPAN = 0.25
LEAST_SPAN = 0.05
NOISE_TIME = 0.3
EXTRAPOLATED = 0.7
UNKNOWN_MOTION = Motion(MotionKind.UNKNOWN, '', float('nan'), float('nan'))


@dataclass(eq=False)
class Track:
    """A tracked person.

    Arrays run over the frames of the window, in which each has a state once it was solved; all are replaced, never
    written into.

    Attributes:
        id: stable name; given_id: the detector's, or empty.
        born: ns, stamp of the first frame.
        stamps: (F,) ns.
        rays: (F, J, 2) x / z and y / z, labels as the detector gave them; weight: (F, J) its scores.
        right: rays and weights with left and right put right; turn: (3, 3) real to virtual camera, which looks at
            the person, one for the whole window.
        theta: (S, K) m, rotation: (S, 3, 3) body to camera, roots: (S, 3) m, of the first S
            frames, S = F or F - 1.
        lifted: 3D poses of the first frames by the lifter, rays' units, real camera's axes; None before the first.
        model: name of the base poses; '' before the first solution.
        noise: m, of the image points.
        size_ratio: stature of the solution over that of the model.
        swaps: recognises swapped labels.
        swapped: number of frames undone so far.
        spread: (J,) m, posterior standard deviations of the newest frame's joints.
        residual: RMS of the newest frames over the size of the body; frame_residual: px, of the newest frame.
        challenge_at: ns, when the next fresh start is due; challenges: how many there were;
            hurry: how many are to follow soon.
        motion_at: ns, when to ask for the kind of motion again; motions: how often it was asked.
        periodic_model: of which the motion was a periodic one, or empty.
        calm_noise: m, noise after every model had its turn.
    """

    id: str
    given_id: str
    born: int
    swaps: SwapFilter
    stamps: list[int] = field(default_factory=list)
    rays: Array = field(default_factory=lambda: np.empty((0, 0, 2)))
    weight: Array = field(default_factory=lambda: np.empty((0, 0)))
    right: tuple[Array, Array] = field(default_factory=lambda: (np.empty((0, 0, 2)), np.empty((0, 0))))
    turn: Array = field(default_factory=lambda: np.eye(3))
    theta: Array = field(default_factory=lambda: np.empty((0, 0)))
    rotation: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    roots: Array = field(default_factory=lambda: np.empty((0, 3)))
    lifted: Lifted | None = None
    model: str = ''
    noise: float = 0.05
    size_ratio: float = 1.0
    swapped: int = 0
    spread: Array = field(default_factory=lambda: np.empty(0))
    residual: float = float('nan')
    frame_residual: float = float('nan')
    challenge_at: int = 0
    challenges: int = 0
    hurry: int = 0
    motion_at: int = 0
    motions: int = 0
    periodic_model: str = ''
    calm_noise: float = math.inf
    motion: Motion = UNKNOWN_MOTION

    def push(self, stamp: int, rays: Array, weight: Array, length: float) -> None:
        """One frame more; those older than `length` s go."""
        _, size = extent(rays, weight)
        before = self.swaps.verdict
        gone = sum(t < stamp - length * NS for t in self.stamps)
        self.swaps = self.swaps.update((stamp - self.born) / NS, rays, weight, size).forgot(gone)
        self.stamps = [*self.stamps[gone:], stamp]
        self.rays = np.concatenate([self.rays[gone:], rays[None]]) if len(self.rays) else rays[None]
        self.weight = np.concatenate([self.weight[gone:], weight[None]]) if len(self.weight) else weight[None]
        self.theta, self.rotation, self.roots = self.theta[gone:], self.rotation[gone:], self.roots[gone:]
        now = self.swaps.verdict
        self.swapped += int(now[-1])
        relabelled = not np.array_equal(now[:-1], before[gone:])
        if relabelled:
            self.challenge_at = stamp
        if self.lifted is not None:
            self.lifted = None if relabelled else self.lifted.take(slice(gone, None))
        self.look()

    def look(self) -> None:
        """Put left and right right, and turn the virtual camera towards the middle of what was seen."""
        rays, weight, mirror = self.rays, self.weight, self.swaps.mirror
        swapped = self.swaps.verdict
        if swapped.any():
            rays = np.where(swapped[:, None, None], rays[:, mirror], rays)
            weight = np.where(swapped[:, None], weight[:, mirror], weight)
        self.right = rays, weight
        middle = np.einsum('fj,fjd->d', weight, rays) / max(weight.sum(), 1e-12)
        self.turn = facing(middle)

    def to_lift(self, intrinsics: Intrinsics) -> tuple[Array, Array]:
        """Histories of the frames that are not lifted yet, in px of the virtual camera, as `lifter.histories`."""
        first = 0 if self.lifted is None else len(self.lifted.joints)
        rays, weight = self.right
        times = (np.array(self.stamps) - self.stamps[0]) / NS
        return histories(self.view(intrinsics).image(rays), weight, times, np.arange(first, len(times)))

    def add_lifted(self, new: Lifted, intrinsics: Intrinsics) -> None:
        """What a lifter made of the frames `to_lift`."""
        new = Lifted(self.view(intrinsics).to_camera(new.joints), new.spread).times(1 / intrinsics.focal)
        self.lifted = new if self.lifted is None else joined([self.lifted, new])

    @property
    def solved(self) -> bool:
        """Whether there is a solution to go on from."""
        return len(self.theta) > 0

    def expected(self, stamp: int) -> tuple[Array, float, float]:
        """Centre and size in ray units where the person should be seen, and s since the last sight."""
        centre, size = extent(self.rays[-1], self.weight[-1])
        age = (stamp - self.stamps[-1]) / NS
        if len(self.stamps) > 1:
            older = int(np.searchsorted(self.stamps, self.stamps[-1] - VELOCITY_SPAN * NS))
            span = (self.stamps[-1] - self.stamps[older]) / NS
            if span >= LEAST_SPAN:
                there, _ = extent(self.rays[older], self.weight[older])
                centre = centre + (centre - there) * min(age, VELOCITY_SPAN) / span
        return centre, size, age

    def view(self, intrinsics: Intrinsics) -> View:
        """The virtual camera."""
        return View(self.turn, intrinsics)

    def window(
        self, intrinsics: Intrinsics, focal: float, frames: NDArray[np.intp], held: int, model: BasePoses
    ) -> Window:
        """Some frames of the window as the solver wants them.

        Args:
            intrinsics: of the camera.
            focal: px, as the solver is to know it.
            frames: which.
            held: so many of them are to stay as they are.
            model: the base poses of the solution so far.
        """
        view = self.view(intrinsics)
        rays, weight = (part[frames] for part in self.right)
        points = view.image(rays)
        times = np.array([self.stamps[f] - self.stamps[0] for f in frames]) / NS
        lifted = None
        if self.lifted is not None:
            seen = self.lifted.take(frames).times(intrinsics.focal)
            lifted = Lifted(seen.joints @ view.turn.T, seen.spread)
        plain = Window(np.where(weight[..., None] > 0, points, 0.0), weight, times, focal=focal, lifted=lifted)
        if not self.solved:
            return plain
        start = self.start(view, frames, model)
        older = None
        if held:
            first = int(frames[0])
            if first > 0:
                lengths = model.skeleton.bone_lengths(model.poses(self.theta[:first]))
                older = Older(first, lengths.mean(axis=0))
        return Window(
            plain.points,
            weight,
            times,
            start,
            float(np.median(start.cameras.scale)),
            self.noise,
            focal,
            held,
            older,
            lifted,
        )

    def start(self, view: View, frames: NDArray[np.intp], model: BasePoses) -> Start:
        """The solution so far in these frames, in the virtual camera; a new frame goes on from the last ones."""
        known = np.minimum(frames, len(self.theta) - 1)
        theta, rotation, roots = self.theta[known], self.rotation[known], self.roots[known]
        if frames[-1] == len(self.theta):
            theta[-1], rotation[-1], roots[-1] = self.next_state(model)
        depth = (roots @ view.turn.T)[:, 2]
        scale = view.intrinsics.focal / np.maximum(depth, 1e-3)
        return Start(theta, Cameras(scale, view.turn @ rotation))

    def next_state(self, model: BasePoses) -> tuple[Array, Array, Array]:
        """Weights, rotation and root to expect of the new frame: moved on, the pose as the lifter saw it move."""
        theta, rotation, root = self.theta[-1], self.rotation[-1], self.roots[-1]
        last = len(self.theta) - 1
        if last > 0:
            span = max(self.stamps[last] - self.stamps[last - 1], 1)
            share = EXTRAPOLATED * min((self.stamps[-1] - self.stamps[last]) / span, 2.0)
            theta = theta + share * (theta - self.theta[-2])
            root = root + share * (root - self.roots[-2])
            rotation = small_rotation(share * rotation_vector(rotation @ self.rotation[-2].T)) @ rotation
        if self.lifted is not None:
            moved = root[2] * (self.lifted.joints[-1] - self.lifted.joints[last])
            if np.isfinite(moved).all():
                joints = model.poses(self.theta[-1]) @ self.rotation[-1].T + moved
                theta = model.weights(joints @ rotation)
        return theta, rotation, root

    def take(self, solution: Reconstruction, frames: NDArray[np.intp], held: int, intrinsics: Intrinsics) -> None:
        """Replace the state of these frames by a solution of the `window` made of them, the held ones excepted."""
        view = self.view(intrinsics)
        count = len(self.stamps)

        def put(old: Array, new: Array) -> Array:
            if len(frames) == count and not held:
                return new
            out = np.empty((count, *new.shape[1:]))
            out[: len(old)] = old
            out[frames[held:]] = new[held:]
            return out

        self.theta = put(self.theta, solution.theta)
        self.rotation = put(self.rotation, view.rotations(solution.cameras))
        self.roots = put(self.roots, view.roots(solution.cameras, solution.translation))
        self._note(solution)
        blend = math.exp(-len(frames) / count) if held else 0.0
        self.noise = math.sqrt(blend * self.noise**2 + (1 - blend) * solution.noise**2)

    def adopt(self, solution: Reconstruction, frames: NDArray[np.intp], intrinsics: Intrinsics) -> None:
        """Take over a solution of these frames, the newest one of them, interpolated to all since the first."""
        view = self.view(intrinsics)
        roots, rotation = view.roots(solution.cameras, solution.translation), view.rotations(solution.cameras)
        stamps = np.array(self.stamps)
        times, known = (stamps - stamps[0]) / NS, (stamps[frames] - stamps[0]) / NS
        inside = times >= known[0]
        times = times[inside]
        if len(frames) > 1:
            rotation = Slerp(known, Rotation.from_matrix(rotation))(times).as_matrix()
        theta, roots = _interpolated(times, known, solution.theta), _interpolated(times, known, roots)
        if older := int(frames[0]):
            theta = np.concatenate([self.theta[:older], theta])
            rotation = np.concatenate([self.rotation[:older], rotation])
            roots = np.concatenate([self.roots[:older], roots])
        self.theta, self.rotation, self.roots = theta, rotation, roots
        self.noise = solution.noise
        self._note(solution)

    def _note(self, solution: Reconstruction) -> None:
        """Keep what the solution says of its newest frame and of the fit."""
        self.spread = solution.spread
        self.frame_residual = float(solution.residual[-1])
        body = np.sqrt((solution.joints[-1, :, :2] ** 2).sum(axis=-1).mean()) * solution.cameras.scale[-1]
        self.residual = float(np.sqrt(np.nanmean(solution.residual**2)) / body)

    def resize(self, model: BasePoses) -> None:
        """Find the stature of the solution again."""
        self.size_ratio = stature(model.poses(self.theta), model.skeleton) / model.stature

    def spaced(self, step: float, span: float) -> NDArray[np.intp]:
        """Indices of the best seen frame of every `step` s in the newest `span` s; the newest frame is one."""
        stamps = np.array(self.stamps)
        back = (stamps[-1] - stamps) / NS
        part = (back / step + 0.5).astype(int)
        trust = self.weight.sum(axis=1)
        trust[-1] = np.inf
        order = np.lexsort((-trust, part))
        first = np.diff(part[order], prepend=-1) != 0
        chosen = np.sort(order[first])
        return np.asarray(chosen[back[chosen] <= span])

    def reposed(self, model: BasePoses, other: BasePoses, frames: NDArray[np.intp]) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and weights (n, K) that give the same 3D poses under another model than its own."""
        joints = self.joints(model, frames)
        rotation = rotation_to(other.mean[None], joints)
        return rotation, other.weights(joints @ rotation)

    def repose(self, model: BasePoses, other: BasePoses) -> None:
        """The same 3D poses, as near as it can be, under another model."""
        if other is not model:
            self.rotation, self.theta = self.reposed(model, other, np.arange(len(self.theta)))

    def joints(self, model: BasePoses, frames: NDArray[np.intp]) -> Array:
        """(n, J, 3) m about the body's origin, real camera's frame, of these solved frames; `model` is its own."""
        poses = model.poses(self.theta[frames])
        return np.asarray(poses @ np.swapaxes(self.rotation[frames], -1, -2))

    def velocity(self) -> Array:
        """(3,) m/s of the root."""
        stamps = np.array(self.stamps)
        recent = stamps >= stamps[-1] - VELOCITY_SPAN * NS
        t = (stamps[recent] - stamps[-1]) / NS
        if len(t) < 3 or np.ptp(t) < VELOCITY_SPAN / 3:
            return np.zeros(3)
        t = t - t.mean()
        return np.asarray(t @ self.roots[recent] / (t @ t))


def _interpolated(times: Array, known: Array, values: Array) -> Array:
    """Values (n, D) at the times `known`, at other times."""
    return np.stack([np.interp(times, known, v) for v in values.T], axis=-1)
