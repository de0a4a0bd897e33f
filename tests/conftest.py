# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures that several tests share."""

# ruff: noqa: E402
from mocap_ros.runtime.cpu_setup import configure_process

configure_process()  # sums then have the same order as in the node

import signal
from types import ModuleType

import numpy as np
import pytest
from hypothesis import settings

from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_poses
from tests.support.paths import ROOT, load_module, shared

# Inputs are the same every time, so that a failure is due to the change; `config/task.sh properties` has random
# ones. A pause of a busy machine is no fault (deadline); what must be quick is measured by benchmarks.
settings.register_profile('fixed', deadline=None, derandomize=True, max_examples=30)
settings.register_profile('random', deadline=None)
settings.load_profile('fixed')

# A shell that starts the tests in the background lets them ignore interrupts, which some tests send to programs.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let files with slow tests begin first, so that no process has one left when the others have ended."""
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: item.path not in slow)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker('ros'):
        pytest.importorskip('rclpy')
        pytest.importorskip('mocap_ros_msgs')


@pytest.fixture(scope='session')
def protocol() -> ModuleType:
    """The measuring protocol with which every accuracy in the documents was measured."""
    return load_module(shared('bench/protocol.py'))


@pytest.fixture(scope='session')
def walk_model() -> PoseModel:
    """Base poses of walks as version 0.1 shipped them: problems made of them stay the same when models do not."""
    return load_base_poses(ROOT / 'tests' / 'data' / 'walk_of_0_1.npz')


@pytest.fixture(scope='session')
def quick_compiler(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables with which a build compiles without optimisation, in half of the time."""
    compiler = tmp_path_factory.mktemp('compiler') / 'cc'
    compiler.write_text('#!/bin/sh\nexec cc "$@" -O0\n', encoding='utf-8')
    compiler.chmod(0o755)
    return {'CC': str(compiler)}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
