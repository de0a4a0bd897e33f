"""A reconstructed person in 3D, and the kind of motion that the person is in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]


class MotionKind(IntEnum):
    """Kinds of motion, numbered as in `mocap_ros_msgs/msg/MotionState`."""

    UNKNOWN = 0
    PERIODIC = 1
    NON_PERIODIC = 2


@dataclass(frozen=True)
class Motion:
    """Classification of the motion in a window of frames.

    Attributes:
        kind: periodic, non-periodic or unknown.
        category: name of the base-pose model in use, e.g. `walk`; empty if unknown.
        residual: RMS 2D residual of the category's model as a fraction of body size; NaN if unknown.
        cadence: Hz, full cycles; NaN for motion that is not periodic.
    """

    kind: MotionKind
    category: str
    residual: float
    cadence: float

    def __str__(self) -> str:
        words = [self.category, self.kind.name.lower().replace('_', '-') + ' motion']
        return ', '.join(w for w in words if w) + (f' of {self.cadence:.2f} Hz' if self.cadence > 0 else '')


@dataclass(frozen=True, eq=False)
class Person3D:
    """One reconstructed person in one frame.

    Attributes:
        id: name of the person, the same in all frames.
        joints: (J, 3) m, joint positions in the camera's optical frame, in the order of `skeleton.CMU15`.
        std: (J,) m, standard deviation of each joint position; NaN if unknown.
        inferred: (J,) True for joints that were not seen and were inferred by the model.
        scale: px/m, scale of the weak-perspective camera.
        rotation: (3, 3) rotation from the body frame to the camera's optical frame.
        translation: (2,) px, image point of the body's origin, which is the mean of its joints.
        motion: classification of the motion up to this frame.
        residual: px, RMS reprojection error over the seen joints; NaN if no joint was seen.
        scale_known: True if the focal length is known and not nominal.
        predicted: True if the person was not detected in this frame.
        tentative: True if the person has been seen too shortly to be sure that there is somebody.
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
    tentative: bool = False

    def __repr__(self) -> str:
        if self.predicted:
            how = 'predicted'
        else:
            how = f'{(~self.inferred).sum()} of {len(self.inferred)} joints seen, residual {self.residual:.1f} px'
        how = f'tentative, {how}' if self.tentative else how
        return f'Person3D {self.id!r}: {self.joints.mean(axis=0)[2]:.1f} m away, {how}, {self.motion}'

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (J,) of the joints."""
        return CMU15.joints
