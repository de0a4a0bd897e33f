# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What was solved of a tracked person.

A solution that a check has found of the person as it was some frames ago goes on in a newer frame i from its last
frame o as the person has moved since then:

    P_i = P_o + M_i - M_o                      joints about the body's origin, in the axes of the real camera
    R_i = T_i T_o^T R_o                        rotation from body to camera
    r_i = r_o + (t_i - t_o) z(r_o) / z(t_o)    position of the body's origin

with T and t the rotations and positions of the person's solution so far, and M its poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, copy_with
from mocap_ros.engine import motion as engine
from mocap_ros.geometry.interpolation import interpolate_linearly, interpolate_rotations
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.joint_std import expect_stature
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import InitialValues

_STATES = 'theta', 'rotation', 'roots', 'bone_lengths', 'frame_residuals'  # attributes with a row a frame


@dataclass(eq=False)
class TrackSolution:
    """The solution of the first S frames of a window, S >= 1, which never changes."""

    model_name: str
    model: PoseModel
    theta: Array  # (S, K) m, weights of the base poses
    rotation: Array  # (S, 3, 3) rotations from the body to the real camera
    # (S, 3) m, positions of the body's origin in the real camera's frame, before `stature_ratio` is applied
    roots: Array
    bone_lengths: Array  # (S, B) m, lengths of the bones of the model's skeleton
    # (S,) px, RMS reprojection error of each frame; NaN where nothing is seen, and interpolated between the frames
    # that a check solved
    frame_residuals: Array
    noise: float  # m, standard deviation of a coordinate of a fully trusted image point, at the body
    stature_ratio: float  # stature of the solution divided by that of the model
    # (J,) m, posterior standard deviations of the newest frame's joints; NaN if they are not known
    joint_std: Array
    residual: float  # RMS reprojection error of the last solved frames as a fraction of the body's RMS radius
    base_poses_lead: bool = False  # whether the base poses lead and not the lifted poses (`solvers.leading_prior`)

    @staticmethod
    def interpolate(
        reconstruction: JointReconstruction,
        observed: ObservedWindow,
        frames: NDArray[np.intp],
        model_name: str,
        model: PoseModel,
        earlier: TrackSolution | None,
        *,
        base_poses_lead: bool = False,
    ) -> TrackSolution:
        """Return a solution of all frames, interpolated between some that are solved.

        The last of these (n,) is the newest; `earlier` is a solution under the same model of the frames before the
        first.
        """
        camera, first = observed.virtual_camera, int(frames[0])
        solved_times, times = observed.times[frames], observed.times[first:]
        rotation = camera.body_rotations(reconstruction.cameras)
        if len(frames) > 1:
            rotation = interpolate_rotations(times, solved_times, rotation)
        theta = interpolate_linearly(times, solved_times, reconstruction.theta)
        roots = camera.root_positions(reconstruction.cameras, reconstruction.translation)
        roots = interpolate_linearly(times, solved_times, roots)
        residuals = interpolate_linearly(times, solved_times, reconstruction.residual)
        lengths = model.skeleton.bone_lengths(model.poses(theta))
        if earlier is not None:
            newest = zip(_STATES, (theta, rotation, roots, lengths, residuals), strict=True)
            theta, rotation, roots, lengths, residuals = (
                np.concatenate([getattr(earlier, n)[:first], s]) for n, s in newest
            )
        stature = expect_stature(lengths, model.skeleton, observed.lifted, camera.measure_depth(roots))
        joint_std, image = reconstruction.joint_std, reconstruction.joints[-1, :, :2].ravel()
        if joint_std is None:
            joint_std = np.full(len(image) // 2, np.nan)
        radius_px = math.sqrt(2 * (image @ image) / len(image)) * float(reconstruction.cameras.scale[-1])
        errors = [error for error in reconstruction.residual.tolist() if not math.isnan(error)]
        rms_error = math.sqrt(sum(error * error for error in errors) / len(errors)) if errors else math.nan
        fit = reconstruction.noise, stature / model.stature, joint_std, rms_error / radius_px, base_poses_lead
        return TrackSolution(model_name, model, theta, rotation, roots, lengths, residuals, *fit)

    @property
    def hidden_share(self) -> float:
        """Share of the stature that `models.joint_std` expects in depth that the poses do not have."""
        seen = engine.measure_stature(self.bone_lengths, self.model.skeleton.stature_per_bone)
        return max(self.stature_ratio * self.model.stature / seen - 1, 0.0)

    def drop_oldest(self, frames: int) -> TrackSolution | None:
        """Return the solution without so many of the oldest frames; None if no solved frame is left."""
        if frames >= len(self.theta):
            return None
        return copy_with(self, **{n: getattr(self, n)[frames:] for n in _STATES}) if frames else self

    def follow(self, own: TrackSolution) -> TrackSolution:
        """Return this solution with states of newer frames as the person has moved (end of the module's text)."""
        last = len(self.theta) - 1
        if last + 1 == len(own.theta):
            return self
        frames, newer = np.arange(last, len(own.theta)), slice(last + 1, None)
        rotation = own.rotation[newer] @ own.rotation[last].T @ self.rotation[-1]
        roots = self.roots[-1] + (own.roots[newer] - own.roots[last]) * (self.roots[-1, 2] / own.roots[last, 2])
        joints = own.compute_joints(frames)
        joints = self.compute_joints(np.array([last])) + joints[1:] - joints[0]
        theta = self.model.weights(joints @ rotation)
        lengths = self.model.skeleton.bone_lengths(self.model.poses(theta))
        newest = theta, rotation, roots, lengths, np.full(len(theta), self.frame_residuals[-1])
        states = zip(_STATES, newest, strict=True)
        return copy_with(self, **{n: np.concatenate([getattr(self, n), s]) for n, s in states})

    def change_camera(self, old: Intrinsics, new: Intrinsics) -> TrackSolution:
        """Return the solution under other intrinsics: images of the body's origin stay the same, or resized."""
        old = old.resize_like(new)
        depth = self.roots[:, 2:] * new.focal / old.focal
        rays = new.pixels_to_rays(old.project(self.roots))
        return copy_with(self, roots=np.concatenate([rays * depth, depth], axis=-1))

    def change_model(self, target_name: str, target_model: PoseModel) -> TrackSolution:
        """Return the solution with its poses approximated under another model; its fit is not measured again."""
        rotation, theta = self.convert_poses(target_model, np.arange(len(self.theta)))
        lengths = target_model.skeleton.bone_lengths(target_model.poses(theta))
        new = {'model_name': target_name, 'model': target_model, 'rotation': rotation, 'theta': theta}
        return copy_with(self, **new, bone_lengths=lengths)

    def convert_poses(self, target_model: PoseModel, frames: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return rotations (n, 3, 3) and weights (n, K) m under another model of the poses of n frames."""
        joints = self.compute_joints(frames)
        rotation = fit_rotation(target_model.mean[None], joints)
        return rotation, target_model.weights(joints @ rotation)

    def compute_joints(self, frames: NDArray[np.intp]) -> Array:
        """Return the joints of some frames about the body's origin, (n, J, 3) m in the real camera's axes."""
        poses = self.model.poses(self.theta[frames])
        return np.asarray(poses @ np.swapaxes(self.rotation[frames], -1, -2))


def select_start(
    observed: ObservedWindow, solution: TrackSolution, frames: NDArray[np.intp]
) -> tuple[ObservedWindow, InitialValues]:
    """Return some frames of a window, (n,) increasing indices, and their solution as a solver's initial values."""
    chosen = observed.select_frames(frames)
    states = solution.theta[frames], solution.rotation[frames], solution.roots[frames]
    return chosen, chosen.convert_to_initial_values(*states)
