# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A person's 3D poses over a whole sequence: the result of `mocap_ros.reconstruct`."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_ros.formats.sequence_file import KeypointSequence, describe_frames
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.runtime.save_results import ReconstructedSequence

Array = NDArray[np.float64]


class PoseSequence:
    """One person's 3D poses over time, which `mocap_ros.reconstruct` returns.

    F frames, J = 26 joints of the layout `body26` (15 of `cmu15` with `tracker.skeleton: cmu15`, or by
    the method `keyframes`), K base poses.
    Coordinates are in metres in the camera's optical frame: x to the right, y down, z forward.
    """

    def __init__(self, reconstruction: ReconstructedSequence) -> None:
        self._reconstruction = reconstruction

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

    @property
    def joints(self) -> Array:
        """(F, J, 3) m, positions of the joints; NaN before the first and after the last sight of the person."""
        return self._reconstruction.result.joints

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(J,) names of the joints."""
        return self._reconstruction.result.skeleton.joints

    @property
    def parents(self) -> tuple[int, ...]:
        """(J,) index of each joint's parent, -1 for the root."""
        return self._reconstruction.result.skeleton.parents

    @property
    def times(self) -> Array:
        """(F,) s, times of the frames."""
        return self.sequence.timestamps

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(F, J) True where the joint was seen in the image, False where the model inferred it."""
        return self._reconstruction.result.seen

    @property
    def orientation(self) -> Array:
        """(F, J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the optical frame.

        Of somebody who stands upright with hanging arms, the axes of all segments are x forward, y left and z up.
        Successive quaternions do not change their sign. NaN where the joints are, or with the method of keyframes.
        """
        found = self._reconstruction.result.orientation
        return np.full((*self.seen.shape, 4), np.nan) if found is None else found

    @property
    def turn_inferred(self) -> NDArray[np.bool_]:
        """(F, J) True where nothing in the image tells how that segment is turned about its own axis z."""
        found = self._reconstruction.result.turn_inferred
        return np.ones(self.seen.shape, bool) if found is None else found

    @property
    def residual(self) -> Array:
        """(F,) px, RMS reprojection error over the seen joints; NaN in frames without any."""
        return self._reconstruction.result.solution.residual

    @property
    def success(self) -> bool:
        """True if the solver converged."""
        return self._reconstruction.result.solution.success

    @property
    def message(self) -> str:
        """Why the solver stopped, as a sentence."""
        return self._reconstruction.result.solution.message

    @property
    def iterations(self) -> int:
        """Number of iterations of the solver."""
        return self._reconstruction.result.solution.iterations

    @property
    def cost(self) -> float:
        """Final value of the objective, m^2."""
        return self._reconstruction.result.solution.cost

    @property
    def base_poses(self) -> str:
        """Name of the base poses that were used, such as `walk`, or the path of their file."""
        return self._reconstruction.result.category

    @property
    def weights(self) -> Array:
        """(F, K) m, weights of the base poses."""
        return self._reconstruction.result.solution.theta

    @property
    def scale(self) -> Array:
        """(F,) px/m, scale of the weak-perspective camera."""
        return self._cameras[0].scale

    @property
    def rotation(self) -> Array:
        """(F, 3, 3) rotation from the body frame (x forward, y left, z up) to the camera's optical frame."""
        return self._cameras[0].rotation

    @property
    def translation(self) -> Array:
        """(F, 2) px, image point of the mean of the joints."""
        return self._cameras[1]

    @property
    def vertical(self) -> Array:
        """(F, 3) unit vectors upwards in the camera's optical frame; NaN where nothing is known."""
        return self._reconstruction.result.vertical

    @property
    def vertical_std(self) -> Array:
        """(F,) rad, standard deviations of the direction of `vertical`; NaN where nothing is known."""
        return self._reconstruction.result.vertical_std

    @property
    def is_scale_known(self) -> bool:
        """True if the focal length was given; False if it is nominal, and the distances with it."""
        return self._reconstruction.result.virtual_camera.intrinsics.is_focal_known

    @property
    def sequence(self) -> KeypointSequence:
        """The keypoints that were reconstructed."""
        return self._reconstruction.sequence

    @cached_property
    def _cameras(self) -> tuple[WeakPerspectiveCameras, Array]:
        return self._reconstruction.result.cameras_in_real_image()
