# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Types of arrays, and copies of immutable objects and of numbers of strangers."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Instance = TypeVar('Instance')


def copy_with(instance: Instance, **changes: Any) -> Instance:
    """Return a copy of a frozen dataclass with other values of some attributes.

    It takes a sixth of the time of `dataclasses.replace`, because it does not call the constructor. So neither the
    names of the changes nor the new object are checked, and the class must have no cached properties.
    """
    copy = object.__new__(type(instance))
    vars(copy).update(vars(instance), **changes)
    return copy


def copy_as_float64(numbers: ArrayLike) -> Array:
    """Return numbers as a new array of float64.

    NumPy warns of a signalling NaN of float32, which only damaged inputs hold; here it becomes NaN as any other.
    """
    with np.errstate(invalid='ignore'):
        return np.array(numbers, np.float64)
