# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The declaration of kernels, their compilation, and calls that do not fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numba import void
from numba.core.errors import TypingError
from numpy.typing import NDArray

from mocap_ros.compiled import kernel as kernels
from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, INPUT_1D, INT, compile_kernels, kernel

Array = NDArray[np.float64]


@kernel(void(FLOAT, INPUT_1D, FLOATS_1D))
def add_multiple(factor: float, given: Array, out: Array) -> None:
    for i in range(len(out)):
        out[i] += factor * given[i]


@kernel(FLOAT(FLOATS_2D))
def sum_rows(matrix: Array) -> float:
    total = 0.0
    for i in range(len(matrix)):
        sums = np.zeros(matrix.shape[1])
        add_multiple(1.0, matrix[i], sums)
        total += sums.sum()
    return total


@kernel(FLOAT(FLOAT, FLOAT))
def divide(numerator: float, denominator: float) -> float:
    return numerator / denominator


@pytest.fixture
def undeclared_later() -> Iterator[None]:
    """Kernels that the test declares and does not compile are forgotten."""
    yield
    kernels._pending[:] = [pending for pending in kernels._pending if pending[0].__module__ != __name__]


def test_a_kernel_may_call_kernels() -> None:
    assert sum_rows(np.arange(6.0).reshape(2, 3)) == 15.0


def test_a_division_by_zero_is_infinite_as_in_numpy() -> None:
    assert divide(1.0, 0.0) == np.inf


def test_an_array_that_is_only_read_may_be_read_only() -> None:
    given, out = np.ones(3), np.zeros(3)
    given.flags.writeable = False
    add_multiple(2, given, out)
    np.testing.assert_array_equal(out, [2.0, 2.0, 2.0])
    with pytest.raises(TypeError, match='was called with'):
        add_multiple(2.0, out, given)


@pytest.mark.parametrize(
    ('wrong', 'description'),
    [
        (np.zeros(3, np.float32), r'array\(float32, 1d, C\)'),
        (np.zeros((3, 3)), r'array\(float64, 2d, C\)'),
        (np.zeros(6)[::2], r'array\(float64, 1d, A\)'),
        (None, 'none'),
    ],
)
def test_a_call_with_other_types_names_the_kernel_and_what_it_expects(wrong: object, description: str) -> None:
    expected = r'float64, readonly array\(float64, 1d, C\), array\(float64, 1d, C\)'
    message = rf'test_kernel\.add_multiple was called with \(float64, {description}, .* instead of \({expected}\)'
    with pytest.raises(TypeError, match=message):
        add_multiple(1.0, wrong, np.zeros(3))  # type: ignore[arg-type]  # that is the point
    assert len(add_multiple.signatures) == 1  # type: ignore[attr-defined]  # nothing was compiled


def test_the_first_call_compiles_a_kernel_that_nobody_has_compiled() -> None:
    @kernel(FLOAT(FLOATS_1D))
    def take_first(numbers: Array) -> float:
        return numbers[0]

    with pytest.raises(TypeError, match=r'take_first was called with \(array\(int64, 1d, C\)\)'):
        take_first(np.array([3, 4]))
    assert take_first(np.array([3.0, 4.0])) == 3.0
    assert len(take_first.signatures) == 1  # type: ignore[attr-defined]


@pytest.mark.usefixtures('undeclared_later')
def test_a_kernel_cannot_call_one_that_is_declared_after_it() -> None:
    @kernel(INT(INT))
    def call(number: int) -> int:
        return later(number)

    @kernel(INT(INT))
    def later(number: int) -> int:
        return number

    with pytest.raises(TypingError, match='later'):
        compile_kernels()


def test_compilation_is_announced_once() -> None:
    @kernel(INT(INT))
    def triple(number: int) -> int:
        return 3 * number

    lines: list[str] = []
    report = compile_kernels(lines.append)
    assert report.kernels == 1
    assert len(lines) == report.compiled  # 0 if an earlier run of this test has filled the cache
    assert triple(2) == 6
    again = compile_kernels(lines.append)
    assert (again.kernels, again.compiled) == (0, 0)
