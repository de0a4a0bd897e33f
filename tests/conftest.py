"""What several tests share."""

# ruff: noqa: E402
from __future__ import annotations

from mocap_ros.process import prepare

prepare()  # the same sums in the same order as in the node

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mocap_ros.base_poses import BasePoses, load_model

SHARED = Path(os.environ.get('MOCAP_ROS_SHARED', Path(__file__).parents[2] / 'shared'))


def shared(relative: str) -> Path:
    """A file of the evaluation data, or a visible skip: users do not have it."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f'evaluation data not here: shared/{relative}')
    return path


@pytest.fixture(scope='session')
def protocol() -> ModuleType:
    """The measuring protocol behind every accuracy figure."""
    spec = importlib.util.spec_from_file_location('protocol', shared('bench/protocol.py'))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='session')
def walk_model() -> BasePoses:
    return load_model('walk')


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
