"""What the tracker is given and what it gives back: one person in one frame, in 2D and in 3D."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.lens import NO_DISTORTION, Distortion

Array = NDArray[np.float64]

LARGEST_PX = 1e6


@dataclass(frozen=True, eq=False)
class Person2D:
    """Keypoints of one person in one image.

    Attributes:
        id: name given by the detector, or empty.
        joints: (J,) joint names, any known to `skeleton.joint_map`.
        points: (J, 2) px, x right and y down; NaN where not seen.
        score: (J,) in [0, 1]; 0 where not seen.
    """

    id: str
    joints: tuple[str, ...]
    points: Array
    score: Array


@dataclass(frozen=True)
class Intrinsics:
    """A camera.

    Attributes:
        focal: px, geometric mean of both focal lengths.
        center: (cx, cy) px.
        known: False where the focal length is only nominal.
        aspect: fy / fx.
        distortion: of the lens.
    """

    focal: float
    center: tuple[float, float]
    known: bool
    aspect: float = 1.0
    distortion: Distortion = NO_DISTORTION

    def rays(self, points: Array) -> Array:
        """(..., 2) px -> (..., 2) x / z and y / z of the ray through each point, distortion undone."""
        fx, fy = self.focal / self.aspect**0.5, self.focal * self.aspect**0.5
        return self.distortion.undistort((points - np.array(self.center)) / np.array([fx, fy]))

    def project(self, points: Array) -> Array:
        """(..., 3) m, optical frame, z > 0 -> (..., 2) px."""
        fx, fy = self.focal / self.aspect**0.5, self.focal * self.aspect**0.5
        seen = self.distortion.distort(points[..., :2] / points[..., 2:])
        return np.asarray(seen * np.array([fx, fy]) + np.array(self.center))

    @staticmethod
    def nominal(width: int, height: int, focal_in_widths: float) -> Intrinsics:
        """A guess from the image size alone."""
        return Intrinsics(focal_in_widths * width, (width / 2, height / 2), known=False)

    @staticmethod
    def from_matrix(matrix: Array, distortion: Distortion = NO_DISTORTION) -> Intrinsics:
        """From a (3, 3) camera matrix in px and the distortion of the lens.

        Raises:
            InputError: a focal length outside 1 to `LARGEST_PX`, or a principal point beyond it.
        """
        focal_lengths, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if not ((focal_lengths >= 1) & (focal_lengths <= LARGEST_PX)).all():
            raise InputError(f'focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px')
        if not (np.abs(centre) <= LARGEST_PX).all():
            raise InputError(f'principal point {centre[0]:g}, {centre[1]:g} px')
        focal = float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
        aspect = float(matrix[1, 1] / matrix[0, 0])
        return Intrinsics(focal, (float(matrix[0, 2]), float(matrix[1, 2])), True, aspect, distortion)


class MotionKind(IntEnum):
    """As in `mocap_ros_msgs/msg/MotionState`."""

    UNKNOWN = 0
    PERIODIC = 1
    NON_PERIODIC = 2


@dataclass(frozen=True)
class Motion:
    """What kind of motion a window holds.

    Attributes:
        kind: periodic, not, or not known.
        category: name of the base-pose model used.
        residual: 2D residual as a fraction of body size; NaN where unknown.
        cadence: Hz, full cycles; NaN where not periodic.
    """

    kind: MotionKind
    category: str
    residual: float
    cadence: float


@dataclass(frozen=True, eq=False)
class Person3D:
    """One reconstructed person in one frame.

    Attributes:
        id: stable name of the person.
        joints: (J, 3) m in the camera's optical frame, in the order of `skeleton.CMU15`.
        std: (J,) m, standard deviation of each joint; NaN where unknown.
        filled: (J,) True where the joint was not seen and the model filled it in.
        scale: px/m of the weak-perspective camera.
        rotation: (3, 3) body to camera.
        translation: (2,) px, image of the body's origin (mean of its joints).
        motion: kind of motion of the window.
        residual: px, RMS reprojection error over the seen joints; NaN where none was.
        scale_known: True where a real focal length was given.
        predicted: True where the person was not detected in this frame.
    """

    id: str
    joints: Array
    std: Array
    filled: NDArray[np.bool_]
    scale: float
    rotation: Array
    translation: Array
    motion: Motion
    residual: float
    scale_known: bool
    predicted: bool
