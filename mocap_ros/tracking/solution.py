# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What was solved of a tracked person: the states of the frames of the window, and how well they fit the image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.compiled.kernel import (
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_INTS_1D,
    kernel,
)
from mocap_ros.copying import copy_with
from mocap_ros.geometry.interpolation import interpolate_linearly
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TrackSolution:
    """The solution of the first S frames of a window, S >= 1.

    Attributes:
        model_name: name of the base-pose model.
        theta: (S, K) m, weights of the base poses.
        rotation: (S, 3, 3) rotations from the body to the real camera.
        roots: (S, 3) m, positions of the body's origin in the real camera's frame, before `stature_ratio` is
            applied.
        bone_lengths: (S, B) m, lengths of the bones of the model's skeleton.
        noise: m, standard deviation of a coordinate of a fully trusted image point, at the body.
        stature_ratio: stature of the solution divided by that of the model.
        joint_std: (J,) m, posterior standard deviations of the newest frame's joints; NaN if they are not known.
        residual: RMS reprojection error of the last solved frames as a fraction of the body's RMS radius.
        frame_residuals: (S,) px, RMS reprojection error of each frame; NaN where nothing is seen, and interpolated
            between the frames that a hypothesis check solved.
        base_poses_lead: whether the base poses lead and not the lifted poses (`solvers.leading_prior`).
    """

    model_name: str
    theta: Array
    rotation: Array
    roots: Array
    bone_lengths: Array
    noise: float
    stature_ratio: float
    joint_std: Array
    residual: float
    frame_residuals: Array
    base_poses_lead: bool = False

    def __post_init__(self) -> None:
        if len(self.bone_lengths) != len(self.theta):
            raise ValueError(f'{len(self.bone_lengths)} frames with bone lengths, {len(self.theta)} with weights')

    @staticmethod
    def interpolate(
        reconstruction: JointReconstruction,
        observed: ObservedWindow,
        frames: NDArray[np.intp],
        model_name: str,
        model: BasePoses,
        earlier: TrackSolution | None,
        *,
        base_poses_lead: bool = False,
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
            base_poses_lead: whether the base poses led in the reconstruction.
        """
        camera = observed.virtual_camera
        solved_times = observed.times[frames]
        times = observed.times[frames[0] :]
        rotation = camera.body_rotations(reconstruction.cameras)
        if len(frames) > 1:
            rotation = Slerp(solved_times, Rotation.from_matrix(rotation))(times).as_matrix()
        theta = interpolate_linearly(times, solved_times, reconstruction.theta)
        roots = camera.root_positions(reconstruction.cameras, reconstruction.translation)
        roots = interpolate_linearly(times, solved_times, roots)
        lengths = model.skeleton.bone_lengths(model.poses(theta))
        residuals = interpolate_linearly(times, solved_times, reconstruction.residual[:, None])[:, 0]
        if earlier is not None:
            first = int(frames[0])
            residuals = np.concatenate([earlier.frame_residuals[:first], residuals])
            theta = np.concatenate([earlier.theta[:first], theta])
            rotation = np.concatenate([earlier.rotation[:first], rotation])
            roots = np.concatenate([earlier.roots[:first], roots])
            lengths = np.concatenate([earlier.bone_lengths[:first], lengths])
        states = (theta, rotation, roots, lengths, residuals)
        return _make_solution(
            reconstruction, *states, reconstruction.noise, model_name, model, base_poses_lead=base_poses_lead
        )

    def refine(
        self,
        reconstruction: JointReconstruction,
        observed: ObservedWindow,
        first: int,
        fixed_frames: int,
        model: BasePoses,
    ) -> TrackSolution:
        """Return the solution of all frames of the window, with new states of the newest ones.

        After a reconstruction of the newest frames alone, the image noise is averaged over the length of the
        window.

        Args:
            reconstruction: of the frames from `first` to the newest, in the window's virtual camera.
            observed: the whole window.
            first: index of the first frame of the reconstruction, at most S.
            fixed_frames: number of frames at the beginning of the reconstruction that keep their state.
            model: base poses of the solution.
        """
        camera, count, kept = observed.virtual_camera, len(observed.times), first + fixed_frames
        rotation = camera.body_rotations(reconstruction.cameras)
        roots = camera.root_positions(reconstruction.cameras, reconstruction.translation)
        lengths = _measure_bones(reconstruction.joints, *model.skeleton.bone_ends)
        old_share = math.exp((first - count) / count) if fixed_frames else 0.0
        return _make_solution(
            reconstruction,
            np.concatenate([self.theta[:kept], reconstruction.theta[fixed_frames:]]),
            np.concatenate([self.rotation[:kept], rotation[fixed_frames:]]),
            np.concatenate([self.roots[:kept], roots[fixed_frames:]]),
            np.concatenate([self.bone_lengths[:kept], lengths[fixed_frames:]]),
            np.concatenate([self.frame_residuals[:first], reconstruction.residual]),
            math.sqrt(old_share * self.noise**2 + (1 - old_share) * reconstruction.noise**2),
            self.model_name,
            model,
            base_poses_lead=self.base_poses_lead,
        )

    def append_states(self, theta: Array, rotation: Array, roots: Array, model: BasePoses) -> TrackSolution:
        """Return the solution with states of n further frames; its fit is not measured again.

        Args:
            theta: (n, K) m.
            rotation: (n, 3, 3).
            roots: (n, 3) m.
            model: base poses of the solution.
        """
        lengths = model.skeleton.bone_lengths(model.poses(theta))
        return copy_with(
            self,
            theta=np.concatenate([self.theta, theta]),
            rotation=np.concatenate([self.rotation, rotation]),
            roots=np.concatenate([self.roots, roots]),
            bone_lengths=np.concatenate([self.bone_lengths, lengths]),
            frame_residuals=np.concatenate([self.frame_residuals, np.full(len(theta), self.frame_residuals[-1])]),
        )

    def drop_oldest(self, frames: int) -> TrackSolution | None:
        """Return the solution without the oldest frames; None if no solved frame is left.

        Args:
            frames: number of frames to drop.
        """
        if frames >= len(self.theta):
            return None
        if frames == 0:
            return self
        return copy_with(
            self,
            theta=self.theta[frames:],
            rotation=self.rotation[frames:],
            roots=self.roots[frames:],
            bone_lengths=self.bone_lengths[frames:],
            frame_residuals=self.frame_residuals[frames:],
        )

    def change_camera(self, old: Intrinsics, new: Intrinsics) -> TrackSolution:
        """Return the solution under other intrinsics: the images of the body's origin stay the same, or resized.

        Args:
            old: intrinsics so far.
            new: intrinsics from now on.
        """
        old = old.resize_like(new)
        depth = self.roots[:, 2:] * new.focal / old.focal
        rays = new.pixels_to_rays(old.project(self.roots))
        return copy_with(self, roots=np.concatenate([rays * depth, depth], axis=-1))

    def change_model(self, model: BasePoses, target_name: str, target_model: BasePoses) -> TrackSolution:
        """Return the solution with its poses approximated under another model; its fit is not measured again.

        Args:
            model: base poses of this solution.
            target_name: name of the other base poses.
            target_model: the other base poses.
        """
        rotation, theta = self.convert_poses(model, target_model, np.arange(len(self.theta)))
        lengths = target_model.skeleton.bone_lengths(target_model.poses(theta))
        return copy_with(self, model_name=target_name, rotation=rotation, theta=theta, bone_lengths=lengths)

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

    def locate_joints(self, frame: int, model: BasePoses) -> Array:
        """Return the joints (J, 3) m of a person of the assumed size in the real camera's frame.

        Args:
            frame: index of the frame.
            model: base poses of the solution.
        """
        state = self.theta[frame], self.rotation[frame], self.roots[frame]
        return _locate_joints(*state, model.mean, model.components, 1 / self.stature_ratio)

    def sample_joints(self, model: BasePoses, times: Array, wanted: Array) -> Array:
        """Return the joints (T, J, 3) m of a person of the assumed size, interpolated between frames.

        Args:
            model: base poses of the solution.
            times: (S,) s, times of the frames.
            wanted: (T,) s, times of the joints, not after the last frame; NaN is returned before the first.
        """
        theta, rotation, roots = (np.ascontiguousarray(v) for v in (self.theta, self.rotation, self.roots))
        size = 1 / self.stature_ratio
        return _sample_joints(wanted, times, theta, rotation, roots, model.mean, model.components, size)


def _make_solution(
    reconstruction: JointReconstruction,
    theta: Array,
    rotation: Array,
    roots: Array,
    bone_lengths: Array,
    frame_residuals: Array,
    noise: float,
    model_name: str,
    model: BasePoses,
    *,
    base_poses_lead: bool,
) -> TrackSolution:
    """Return the solution with these states, and with the fit of the reconstruction that ended them."""
    joint_std, newest = reconstruction.joint_std, reconstruction.joints[-1, :, :2].ravel()
    if joint_std is None:
        joint_std = np.full(len(newest) // 2, np.nan)
    body_radius_px = math.sqrt(2 * (newest @ newest) / len(newest)) * float(reconstruction.cameras.scale[-1])
    errors = [error for error in reconstruction.residual.tolist() if not math.isnan(error)]
    rms_error = math.sqrt(sum(error * error for error in errors) / len(errors)) if errors else math.nan
    return TrackSolution(
        model_name=model_name,
        theta=theta,
        rotation=rotation,
        roots=roots,
        bone_lengths=bone_lengths,
        noise=noise,
        stature_ratio=float(average_rows(bone_lengths) @ model.skeleton.stature_per_bone) / model.stature,
        joint_std=joint_std,
        residual=rms_error / body_radius_px,
        frame_residuals=frame_residuals,
        base_poses_lead=base_poses_lead,
    )


@kernel(FLOATS_2D(INPUT_1D, INPUT_2D, INPUT_1D, INPUT_2D, INPUT_3D, FLOAT))
def _locate_joints(
    theta: Array, rotation: Array, root: Array, mean: Array, components: Array, size: float
) -> Array:
    """Return the joints (J, 3) m of a pose: size (R (Q_0 + sum_k theta_k Q_k) + root).

    Args:
        theta: (K,) m.
        rotation: (3, 3) R.
        root: (3,) m.
        mean: (J, 3) m, Q_0.
        components: (K or more, J, 3), Q_k.
        size: of the person over that of the solution.
    """
    pose = mean.copy()
    for k in range(len(theta)):
        for j in range(len(pose)):
            for i in range(3):
                pose[j, i] += theta[k] * components[k, j, i]
    out = np.empty(pose.shape)
    for j in range(len(pose)):
        x, y, z = pose[j, 0], pose[j, 1], pose[j, 2]
        for i in range(3):
            turned = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z
            out[j, i] = size * (turned + root[i])
    return out


@kernel(FLOATS_3D(INPUT_1D, INPUT_1D, INPUT_2D, INPUT_3D, INPUT_2D, INPUT_2D, INPUT_3D, FLOAT))
def _sample_joints(
    wanted: Array,
    times: Array,
    theta: Array,
    rotation: Array,
    roots: Array,
    mean: Array,
    components: Array,
    size: float,
) -> Array:
    """Return what `TrackSolution.sample_joints` does; the arguments are its own and those of `_locate_joints`."""
    out = np.full((len(wanted), *mean.shape), np.nan)
    for n in range(len(wanted)):
        if not wanted[n] >= times[0]:
            continue
        last = max(np.searchsorted(times, wanted[n]), 1)
        first = last - 1
        share = (wanted[n] - times[first]) / (times[last] - times[first])
        before = _locate_joints(theta[first], rotation[first], roots[first], mean, components, size)
        after = _locate_joints(theta[last], rotation[last], roots[last], mean, components, size)
        out[n] = before + share * (after - before)
    return out


@kernel(FLOATS_2D(INPUT_3D, INPUT_INTS_1D, INPUT_INTS_1D))
def _measure_bones(joints: Array, parents: NDArray[np.intp], children: NDArray[np.intp]) -> Array:
    """Return the lengths (F, B) of the bones between the given joints, (B,) each, of poses (F, J, 3)."""
    out = np.empty((len(joints), len(parents)))
    for frame in range(out.shape[0]):
        for bone in range(out.shape[1]):
            squared = 0.0
            for d in range(3):
                squared += (joints[frame, children[bone], d] - joints[frame, parents[bone], d]) ** 2
            out[frame, bone] = math.sqrt(squared)
    return out


@kernel(FLOATS_1D(INPUT_2D))
def average_rows(values: Array) -> Array:
    """Return the mean (D,) of values (n, D), n >= 1."""
    out = np.zeros(values.shape[1])
    for n in range(values.shape[0]):
        for d in range(values.shape[1]):
            out[d] += values[n, d]
    return out / len(values)
