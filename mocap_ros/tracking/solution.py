"""What was solved of a tracked person: the states of the frames of the window, and how well they fit the image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import estimate_stature
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.tracking.seen_frames import VELOCITY_SPAN_S
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

MIN_VELOCITY_FRAMES = 3  # frames; a line through two frames does not average the noise


@dataclass(frozen=True, eq=False)
class TrackSolution:
    """The solution of the first S frames of a window, S >= 1.

    Attributes:
        model_name: name of the base-pose model.
        theta: (S, K) m, weights of the base poses.
        rotation: (S, 3, 3) rotations from the body to the real camera.
        roots: (S, 3) m, positions of the body's origin in the real camera's frame, before `stature_ratio` is
            applied.
        noise: m, standard deviation of a coordinate of a fully trusted image point, at the body.
        stature_ratio: stature of the solution divided by that of the model.
        joint_std: (J,) m, posterior standard deviations of the newest frame's joints; NaN if they are not known.
        residual: RMS reprojection error of the last solved frames as a fraction of the body's RMS radius.
        frame_residual: px, RMS reprojection error of the newest frame.
    """

    model_name: str
    theta: Array
    rotation: Array
    roots: Array
    noise: float
    stature_ratio: float
    joint_std: Array
    residual: float
    frame_residual: float

    @staticmethod
    def interpolate(
        reconstruction: JointReconstruction,
        observed: ObservedWindow,
        frames: NDArray[np.intp],
        model_name: str,
        model: BasePoses,
        earlier: TrackSolution | None,
    ) -> TrackSolution:
        """Return a solution of all frames, interpolated between some that are solved.

        Args:
            reconstruction: of these frames, in the window's virtual camera.
            observed: the whole window.
            frames: (n,) indices of the frames, increasing; the last is the newest of the window.
            model_name: name of the base poses of the reconstruction.
            model: these base poses.
            earlier: solution under the same model of the frames before the first of `frames`; None if there are
                none.
        """
        camera = observed.virtual_camera
        solved_times = observed.times[frames]
        times = observed.times[frames[0] :]
        rotation = camera.body_rotations(reconstruction.cameras)
        if len(frames) > 1:
            rotation = Slerp(solved_times, Rotation.from_matrix(rotation))(times).as_matrix()
        theta = _interpolate(times, solved_times, reconstruction.theta)
        roots = camera.root_positions(reconstruction.cameras, reconstruction.translation)
        roots = _interpolate(times, solved_times, roots)
        if earlier is not None:
            first = int(frames[0])
            theta = np.concatenate([earlier.theta[:first], theta])
            rotation = np.concatenate([earlier.rotation[:first], rotation])
            roots = np.concatenate([earlier.roots[:first], roots])
        return _make_solution(reconstruction, theta, rotation, roots, reconstruction.noise, model_name, model)

    def refine(
        self,
        reconstruction: JointReconstruction,
        observed: ObservedWindow,
        frames: NDArray[np.intp],
        fixed_frames: int,
        model: BasePoses,
    ) -> TrackSolution:
        """Return the solution of all frames of the window, with new states of some of them.

        After a reconstruction of the newest frames alone, the image noise is averaged over the length of the
        window.

        Args:
            reconstruction: of these frames, in the window's virtual camera.
            observed: the whole window.
            frames: (n,) indices of the frames, increasing; together with the solved ones they are all frames.
            fixed_frames: number of frames at the beginning of `frames` that keep their state.
            model: base poses of the solution.
        """
        camera, count = observed.virtual_camera, len(observed.times)
        theta, rotation = reconstruction.theta, camera.body_rotations(reconstruction.cameras)
        roots = camera.root_positions(reconstruction.cameras, reconstruction.translation)
        if fixed_frames or len(frames) < count:
            changed = frames[fixed_frames:]
            theta = _replace_states(self.theta, theta[fixed_frames:], changed, count)
            rotation = _replace_states(self.rotation, rotation[fixed_frames:], changed, count)
            roots = _replace_states(self.roots, roots[fixed_frames:], changed, count)
        old_share = math.exp(-len(frames) / count) if fixed_frames else 0.0
        noise = math.sqrt(old_share * self.noise**2 + (1 - old_share) * reconstruction.noise**2)
        return _make_solution(reconstruction, theta, rotation, roots, noise, self.model_name, model)

    def drop_oldest(self, frames: int) -> TrackSolution | None:
        """Return the solution without the oldest frames; None if no solved frame is left.

        Args:
            frames: number of frames to drop.
        """
        if frames >= len(self.theta):
            return None
        if frames == 0:
            return self
        return replace(self, theta=self.theta[frames:], rotation=self.rotation[frames:], roots=self.roots[frames:])

    def change_camera(self, old: Intrinsics, new: Intrinsics) -> TrackSolution:
        """Return the solution under other intrinsics: the images of the body's origin stay the same.

        Args:
            old: intrinsics so far.
            new: intrinsics from now on.
        """
        depth = self.roots[:, 2:] * new.focal / old.focal
        rays = new.pixels_to_rays(old.project(self.roots))
        return replace(self, roots=np.concatenate([rays * depth, depth], axis=-1))

    def change_model(self, model: BasePoses, target_name: str, target_model: BasePoses) -> TrackSolution:
        """Return the solution with its poses approximated under another model; its fit is not measured again.

        Args:
            model: base poses of this solution.
            target_name: name of the other base poses.
            target_model: the other base poses.
        """
        rotation, theta = self.convert_poses(model, target_model, np.arange(len(self.theta)))
        return replace(self, model_name=target_name, rotation=rotation, theta=theta)

    def convert_poses(
        self, model: BasePoses, target_model: BasePoses, frames: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Approximate the 3D poses of some frames under another model.

        Args:
            model: base poses of the solution.
            target_model: other base poses.
            frames: (n,) indices of the frames.

        Returns:
            rotation: (n, 3, 3) rotations from the body to the real camera under the other model.
            theta: (n, K) m, weights of the other model.
        """
        joints = self.compute_joints(model, frames)
        rotation = fit_rotation(target_model.mean[None], joints)
        return rotation, target_model.weights(joints @ rotation)

    def compute_joints(self, model: BasePoses, frames: NDArray[np.intp]) -> Array:
        """Return the joints of some frames about the body's origin, (n, J, 3) m in the real camera's axes.

        Args:
            model: base poses of the solution.
            frames: (n,) indices of the frames.
        """
        poses = model.poses(self.theta[frames])
        return np.asarray(poses @ np.swapaxes(self.rotation[frames], -1, -2))

    def estimate_velocity(self, stamps_ns: tuple[int, ...]) -> Array:
        """Return the velocity of the root, (3,) m/s: the slope of a line through the last `VELOCITY_SPAN_S`.

        The velocity is 0 if there are too few frames for a line.

        Args:
            stamps_ns: (S,) ns, stamps of the frames.
        """
        stamps = np.array(stamps_ns)
        is_recent = stamps >= stamps[-1] - VELOCITY_SPAN_S * NS_PER_S
        t = (stamps[is_recent] - stamps[-1]) / NS_PER_S
        if len(t) < MIN_VELOCITY_FRAMES or np.ptp(t) < VELOCITY_SPAN_S / 3:
            return np.zeros(3)
        t = t - t.mean()
        return np.asarray(t @ self.roots[is_recent] / (t @ t))


def _make_solution(
    reconstruction: JointReconstruction,
    theta: Array,
    rotation: Array,
    roots: Array,
    noise: float,
    model_name: str,
    model: BasePoses,
) -> TrackSolution:
    """Return the solution with these states, and with the fit of the reconstruction that ended them."""
    joint_std = reconstruction.joint_std
    if joint_std is None:
        joint_std = np.full(reconstruction.joints.shape[1], np.nan)
    body_radius = np.sqrt((reconstruction.joints[-1, :, :2] ** 2).sum(axis=-1).mean())
    body_radius_px = body_radius * reconstruction.cameras.scale[-1]
    return TrackSolution(
        model_name=model_name,
        theta=theta,
        rotation=rotation,
        roots=roots,
        noise=noise,
        stature_ratio=estimate_stature(model.poses(theta), model.skeleton) / model.stature,
        joint_std=joint_std,
        residual=float(np.sqrt(np.nanmean(reconstruction.residual**2)) / body_radius_px),
        frame_residual=float(reconstruction.residual[-1]),
    )


def _replace_states(old: Array, new: Array, frames: NDArray[np.intp], count: int) -> Array:
    """Return the states of `count` frames: the old ones, and new ones (n, ...) of frames (n,)."""
    states = np.empty((count, *new.shape[1:]))
    states[: len(old)] = old
    states[frames] = new
    return states


def _interpolate(times: Array, sample_times: Array, samples: Array) -> Array:
    """Interpolate samples (n, D) linearly at some times (N,), to (N, D)."""
    return np.stack([np.interp(times, sample_times, s) for s in samples.T], axis=-1)
