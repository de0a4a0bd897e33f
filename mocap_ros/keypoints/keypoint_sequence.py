# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person's keypoints in the images of one camera, and the true 3D joints if known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.units import NS_PER_S


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Measured or generated 3D joints (F, J3, 3) in m in the camera's optical frame, NaN where unknown."""

    joints: Array
    joint_names: tuple[str, ...]

    def __repr__(self) -> str:
        return f'GroundTruth: {len(self.joints)} frames, {len(self.joint_names)} joints'


@dataclass(frozen=True, eq=False)
class KeypointSequence:
    """Keypoints of one person over time.

    Attributes:
        keypoints: (F, J, 3) x to the right and y down in px, confidence score in [0, 1]; where a keypoint was not
            seen, x and y are NaN and the score is 0.
        joint_names: (J,) names of the joints.
        timestamps: (F,) s, strictly increasing.
        image_size: (width, height) in px.
        camera_matrix: (3, 3) px, or None where the camera is unknown.
        distortion: distortion coefficients in OpenCV's order, or None.
        truth: true 3D joints in the same frames, or None.
        person_id: id of the person, or empty.
        frame_id: name of the camera's optical frame, or empty.
        recorded_ns: (F,) timestamps in ns, where they are known more exactly than in s, or empty.
        calibration: intrinsics of the camera, where they are given in another form than `camera_matrix` and
            `distortion`, or None.
        focal_source: where the focal length is from if it is neither a calibration nor nominal, such as `given`.
        notes: lines for the user about the content of the file.
        is_size_assumed: whether the image size is one that holds the keypoints, because it is not known.
        recording_start: s, time of the first image of the recording, which may show somebody else; None where it
            is the first of `timestamps`.
        depth: (F, J) m along the optical axis of the surfaces that are seen at the keypoints, NaN where unknown,
            or None.
    """

    keypoints: Array
    joint_names: tuple[str, ...]
    timestamps: Array
    image_size: tuple[int, int]
    camera_matrix: Array | None = None
    distortion: Array | None = None
    truth: GroundTruth | None = None
    person_id: str = ''
    frame_id: str = ''
    recorded_ns: tuple[int, ...] = ()
    calibration: Intrinsics | None = None
    focal_source: str = ''
    notes: tuple[str, ...] = ()
    is_size_assumed: bool = False
    recording_start: float | None = None
    depth: Array | None = None

    def __len__(self) -> int:
        return len(self.timestamps)

    def __repr__(self) -> str:
        return (
            f'KeypointSequence: {describe_frames(self.timestamps)}, {len(self.joint_names)} joints '
            f'({(self.keypoints[..., 2] > 0).mean():.0%} seen) in {self.image_size[0]} x {self.image_size[1]} px, '
            f'camera {"known" if self.is_camera_known else "unknown"}, '
            f'{"no truth" if self.truth is None else f"truth of {len(self.truth.joint_names)} joints"}'
        )

    @property
    def is_camera_known(self) -> bool:
        """Whether the focal length is known, and not nominal."""
        if self.calibration is not None:
            return self.calibration.is_focal_known
        return self.camera_matrix is not None

    @property
    def stamps_ns(self) -> list[int]:
        """Timestamps (F,) in ns."""
        return list(self.recorded_ns) or [round(float(t) * NS_PER_S) for t in self.timestamps]

    def resample(self, stamps_ns: Sequence[int]) -> KeypointSequence:
        """Return the sequence at other stamps in ns, at which nothing is seen where it has no frame.

        Truth and depth are left out.
        """
        own = {stamp_ns: frame for frame, stamp_ns in enumerate(self.stamps_ns)}
        keypoints = np.full((len(stamps_ns), *self.keypoints.shape[1:]), np.nan)
        keypoints[..., 2] = 0.0
        frames = [frame for frame, stamp_ns in enumerate(stamps_ns) if stamp_ns in own]
        keypoints[frames] = self.keypoints[[own[stamps_ns[frame]] for frame in frames]]
        times = np.array(stamps_ns) / NS_PER_S
        return replace(
            self, keypoints=keypoints, timestamps=times, recorded_ns=tuple(stamps_ns), truth=None, depth=None
        )

    def person(self, frame: int, person_id: str = '') -> Person2D:
        """Return the keypoints in one frame as a person with this id."""
        keypoints = self.keypoints[frame]
        depth = None if self.depth is None else self.depth[frame]
        return Person2D(person_id, self.joint_names, keypoints[:, :2], keypoints[:, 2], depth)

    def intrinsics(self, focal_in_sides: float) -> Intrinsics:
        """Return the intrinsics; an unknown camera has the focal length `focal_in_sides` times the longer side."""
        if self.calibration is not None:
            return self.calibration
        return create_intrinsics(self.image_size, self.camera_matrix, self.distortion, focal_in_sides)


def describe_frames(times: Array) -> str:
    """Return the number and the duration of frames at times (F,) in s, such as `390 frames in 13.0 s`."""
    return f'{len(times)} frames' + (f' in {times[-1] - times[0]:.1f} s' if len(times) > 1 else '')


def create_intrinsics(
    image_size: tuple[int, int], camera_matrix: Array | None, distortion: Array | None, focal_in_sides: float
) -> Intrinsics:
    """Return the intrinsics of a camera matrix or, where there is none, nominal ones for the image size.

    The arguments are the attributes of a `KeypointSequence`, and `focal_in_sides` of its `intrinsics`.
    """
    if camera_matrix is not None:
        return Intrinsics.from_matrix(camera_matrix, create_distortion(distortion), image_size)
    return Intrinsics.from_image_size(*image_size, focal_in_sides)


def create_distortion(coefficients: Array | None) -> Distortion:
    """Return the distortion of coefficients in OpenCV's order; none if they are None."""
    return Distortion.from_coefficients('plumb_bob', () if coefficients is None else tuple(coefficients.tolist()))
