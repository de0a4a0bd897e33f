# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""a b + c for kernels that multiply matrices of single precision, which SciPy's routines for kernels do not."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.extending import intrinsic, overload


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, as one operation with one rounding on a processor that has it."""
    return a * b + c


@overload(multiply_add)
def _compile_multiply_add(a: Any, b: Any, c: Any) -> Any:  # noqa: ARG001, types
    def implementation(a: Any, b: Any, c: Any) -> Any:
        return _multiply_add(a, b, c)

    return implementation


@intrinsic
def _multiply_add(_typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c by LLVM's instruction `fmuladd`, for three numbers of one type."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = context.get_value_type(signature.return_type)
        function = builder.module.declare_intrinsic(
            'llvm.fmuladd', [number], ir.FunctionType(number, [number] * 3)
        )
        return builder.call(function, arguments)

    return a(a, b, c), generate
