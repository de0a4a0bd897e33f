# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bit-exact comparison of dataclasses that hold arrays."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def list_values(value: Any, path: str = '') -> dict[str, object]:
    """Return every value in nested dataclasses and tuples by its path; arrays as bytes, floats as hexadecimals."""
    if is_dataclass(value):
        parts = {f'{path}.{f.name}': getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, tuple):
        parts = {f'{path}[{i}]': part for i, part in enumerate(value)}
    elif isinstance(value, np.ndarray):
        return {path: (value.dtype.str, value.shape, value.tobytes())}
    elif isinstance(value, float):
        return {path: value.hex()}
    else:
        assert value is None or isinstance(value, (int, str)), f'{path}: {type(value)} may be mutable'
        return {path: value}
    return {path: len(parts)} | {k: v for p, part in parts.items() for k, v in list_values(part, p).items()}
