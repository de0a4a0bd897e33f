# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of one image as arrays, and what several messages need to know of them, computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.people import HIPS, Person3D
from mocap_ros.skeleton import CMU15, Skeleton

Array = NDArray[np.float64]
Result = TypeVar('Result')


class StackedPeople(tuple[Person3D, ...]):  # noqa: SLOT001, it keeps what was computed
    """The N people of an image, who all have the same J joints."""

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple([p.id for p in self])

    @property
    def skeleton(self) -> Skeleton:
        """Names and order of their joints; the core where there is nobody."""
        return self[0].skeleton if self else CMU15

    @cached_property
    def joints(self) -> Array:
        """(N, J, 3) m."""
        return np.array([p.joints for p in self]).reshape(len(self), len(self.skeleton.joints), 3)

    @cached_property
    def std(self) -> Array:
        """(N, J) m."""
        return np.array([p.std for p in self]).reshape(len(self), len(self.skeleton.joints))

    @cached_property
    def roots(self) -> Array:
        """(N, 3) m."""
        return np.asarray((self.joints[:, HIPS[0]] + self.joints[:, HIPS[1]]) / 2)

    @cached_property
    def known_velocities(self) -> Array:
        """(N, 3) m/s of the roots; 0 where unknown, as consumers take no NaN."""
        return np.nan_to_num(np.array([p.root_velocity for p in self]).reshape(-1, 3))

    @cached_property
    def _results(self) -> dict[Callable[..., Any], Any]:
        return {}

    def share(self, compute: Callable[[StackedPeople], Result]) -> Result:
        """Return what a function finds of these people, which is called once."""
        if compute not in self._results:
            self._results[compute] = compute(self)
        result: Result = self._results[compute]
        return result


def stack_people(people: Sequence[Person3D]) -> StackedPeople:
    """Return the people of an image for all messages; those that are stacked already stay so."""
    return people if isinstance(people, StackedPeople) else StackedPeople(people)
