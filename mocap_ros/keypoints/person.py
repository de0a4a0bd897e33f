"""One person in one image: the keypoints that a detector gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
