# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MAX_NOISE_RATIO: float

class Term:
    order: int

class Reprojection(Term):
    robust_scale: float
    def __init__(self, robust_scale: float) -> None: ...

class LiftedPoses(Term):
    weight: float
    robust_scale: float
    def __init__(self, weight: float, robust_scale: float) -> None: ...

class BoneLengths(Term):
    weight: float
    def __init__(self, weight: float, arrays: Any, components: int) -> None: ...

class Prior(Term):
    weight: Array
    def __init__(self, weight: Array) -> None: ...

class Level(Term):
    weight: float
    def __init__(self, weight: float) -> None: ...

class FiniteDifference(Term):
    weight: Array

class Velocity(FiniteDifference):
    def __init__(self, weight: Array) -> None: ...

class Acceleration(FiniteDifference):
    typical: float
    activity: Array | None
    def __init__(self, weight: Array, typical: float = 1, activity: Array | None = None) -> None: ...
