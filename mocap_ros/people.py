"""A person in 3D as the tracker gives them, and the kind of motion they are in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
        inferred: (J,) True where the joint was not seen and the model inferred it.
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
    inferred: NDArray[np.bool_]
    scale: float
    rotation: Array
    translation: Array
    motion: Motion
    residual: float
    scale_known: bool
    predicted: bool
