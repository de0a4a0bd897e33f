# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Paths of the repository and of the evaluation data, and Python files that are in no package."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


def load_module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHARED = Path(os.environ.get('MOCAP_ROS_SHARED', ROOT.parent / 'shared'))


def shared(relative: str) -> Path:
    """Return the path of a file of the evaluation data; skip the test if the file is missing."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f'evaluation data is missing: shared/{relative}')
    return path
