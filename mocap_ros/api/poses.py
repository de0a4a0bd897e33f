# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A person's 3D poses over a whole sequence: the result of `mocap_ros.reconstruct`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.formats.sequence_file import KeypointSequence, describe_frames
from mocap_ros.runtime.save_results import ReconstructedSequence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class PoseSequence:
    """One person's 3D poses over time, which `mocap_ros.reconstruct` returns.

    F frames, J = 26 joints of the layout `body26` (15 of `cmu15` with `tracker.skeleton: cmu15`, or by the method
    `keyframes`), K base poses. Coordinates are in metres in the camera's optical frame: x to the right, y down, z
    forward.

    Attributes:
        joints: (F, J, 3) m, positions of the joints; NaN before the first and after the last sight of the person.
        joint_names: (J,) names of the joints.
        parents: (J,) index of each joint's parent, -1 for the root.
        times: (F,) s, times of the frames.
        seen: (F, J) True where the joint was seen in the image, False where the model inferred it.
        orientation: (F, J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the
            optical frame. If a person stands upright with hanging arms, the axes of all segments are x forward, y
            left and z up. Successive quaternions do not change their sign. NaN where the joints are, or with the
            method `keyframes`.
        turn_inferred: (F, J) True where the image does not show how that segment is turned about its own axis z.
        residual: (F,) px, RMS reprojection error over the seen joints; NaN in frames without any.
        success: True if the solver converged.
        message: why the solver stopped, as a sentence.
        iterations: number of iterations of the solver.
        cost: final value of the objective, m^2.
        base_poses: name of the base poses that were used, such as `walk`, or the path of their file.
        weights: (F, K) m, weights of the base poses.
        scale: (F,) px/m, scale of the weak-perspective camera.
        rotation: (F, 3, 3) rotation from the body frame (x forward, y left, z up) to the camera's optical frame.
        translation: (F, 2) px, image point of the mean of the joints.
        vertical: (F, 3) unit vectors upwards in the camera's optical frame; NaN where nothing is known.
        vertical_std: (F,) rad, standard deviations of the direction of `vertical`; NaN where nothing is known.
        is_scale_known: True if the focal length was given; False if it is nominal, and the distances with it.
        sequence: the keypoints that were reconstructed.
    """

    joints: Array
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    times: Array
    seen: NDArray[np.bool_]
    orientation: Array
    turn_inferred: NDArray[np.bool_]
    residual: Array
    success: bool
    message: str
    iterations: int
    cost: float
    base_poses: str
    weights: Array
    scale: Array
    rotation: Array
    translation: Array
    vertical: Array
    vertical_std: Array
    is_scale_known: bool
    sequence: KeypointSequence
    _reconstruction: ReconstructedSequence

    @staticmethod
    def _create(reconstruction: ReconstructedSequence) -> PoseSequence:
        sequence, result = reconstruction.sequence, reconstruction.result
        cameras, translation = result.cameras_in_real_image()
        unknown = np.full((*result.seen.shape, 4), np.nan), np.ones(result.seen.shape, bool)
        return PoseSequence(
            joints=result.joints,
            joint_names=result.skeleton.joints,
            parents=result.skeleton.parents,
            times=sequence.timestamps,
            seen=result.seen,
            orientation=unknown[0] if result.orientation is None else result.orientation,
            turn_inferred=unknown[1] if result.turn_inferred is None else result.turn_inferred,
            residual=result.solution.residual,
            success=result.solution.success,
            message=result.solution.message,
            iterations=result.solution.iterations,
            cost=result.solution.cost,
            base_poses=result.category,
            weights=result.solution.theta,
            scale=cameras.scale,
            rotation=cameras.rotation,
            translation=translation,
            vertical=result.vertical,
            vertical_std=result.vertical_std,
            is_scale_known=result.virtual_camera.intrinsics.is_focal_known,
            sequence=sequence,
            _reconstruction=reconstruction,
        )

    def __len__(self) -> int:
        """Return the number of frames F."""
        return len(self.times)

    def __repr__(self) -> str:
        return (
            f'PoseSequence: {describe_frames(self.times)}, {len(self.joint_names)} joints '
            f'({1 - self.seen.mean():.0%} inferred), base poses {self.base_poses}, '
            f'residual {np.nanmean(self.residual):.2f} px, '
            f'{np.nanmean(self.joints[..., 2]):.1f} m away'
            + ('' if self.is_scale_known else ' by the nominal focal length')
            + ('' if self.success else f'. {self.message}')
        )
