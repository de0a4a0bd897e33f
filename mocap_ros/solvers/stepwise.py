# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Solvers that can be interrupted between two steps.

A stepwise function is a generator: it yields None after each piece of its work (one step of Levenberg-Marquardt,
or something that takes about as long) and returns the result at its end. Each of them has a plain function that
runs it to its end.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias, TypeVar

import numpy as np

Result = TypeVar('Result')

Stepwise: TypeAlias = Generator[None, None, Result]


def run_to_end(work: Stepwise[Result]) -> Result:
    """Do all pieces of the work, and return its result."""
    try:
        while True:
            next(work)
    except StopIteration as end:
        return end.value


def ignore_overflow(work: Stepwise[Result]) -> Stepwise[Result]:
    """Do the work without NumPy's warnings of overflow and the like; between its pieces they are as before."""
    while True:
        with np.errstate(all='ignore'):
            try:
                next(work)
            except StopIteration as end:
                return end.value
        yield
