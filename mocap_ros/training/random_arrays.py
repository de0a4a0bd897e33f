# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Random arrays in single precision, for training examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


class RandomArrays:
    """Random numbers from a seed; the same seed and calls give the same numbers."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.Generator(np.random.SFC64(seed))

    def to_state(self) -> dict[str, Any]:
        """Return the state of the generator as plain values."""
        state = dict(self.rng.bit_generator.state)
        return {**state, 'state': {name: value.tolist() for name, value in state['state'].items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of `to_state`."""
        words = {name: np.array(value, np.uint64) for name, value in state['state'].items()}
        self.rng.bit_generator.state = {**state, 'state': words}

    def chance(self, count: int, share: float, *, axes: int = 0) -> NDArray[np.bool_]:
        """Return an array (count, 1, ...) with `axes` axes of length 1, true for a random share of examples."""
        return (self.rng.random(count) < share).reshape(count, *(1,) * axes)

    def choose(self, count: int, share: float, value: float, otherwise: float, *, axes: int = 0) -> Array:
        """Return `value` for a random share of examples and `otherwise` for the rest; shape as `chance`."""
        return np.where(self.chance(count, share, axes=axes), np.float32(value), np.float32(otherwise))

    def uniform(self, low: float, high: float, *shape: int) -> Array:
        """Return numbers that are uniformly distributed between `low` and `high`."""
        return np.float32(low) + np.float32(high - low) * self.rng.random(shape, dtype=np.float32)

    def normal(self, *shape: int) -> Array:
        """Return numbers with the standard normal distribution."""
        return self.rng.standard_normal(shape, dtype=np.float32)
