# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of the tests over DDS: a domain for each test, a peer, and the node."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from mocap_ros.cli.demo import reserve_domain
from tests.support.paths import ROOT, load_module
from tests.support.ros_node import FAST_PARAMETERS, RELIABLE_INPUT, Peer, Process, StartNode, StartProgram


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[dict[str, str]]:
    """Environment of the node: this machine only, and a domain that no other test or demo has at the same time."""
    with reserve_domain() as variables:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
        # A server that answers before it has discovered the client's reader warns of it; the peer asks again.
        monkeypatch.setenv('PYTHONWARNINGS', 'ignore:failed to send response:RuntimeWarning')
        yield dict(os.environ)


@pytest.fixture
def peer(env: dict[str, str]) -> Iterator[Peer]:
    peer = Peer(int(env['ROS_DOMAIN_ID']))
    yield peer
    peer.close()


@pytest.fixture
def start(env: dict[str, str], tmp_path: Path) -> Iterator[StartProgram]:
    """Start programs in a folder of their own, which are killed when the test ends."""
    started: list[Process] = []

    def start_program(*command: object) -> Process:
        pipes: Any = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True}
        started.append(subprocess.Popen([*map(str, command)], env=env, cwd=tmp_path, **pipes))
        return started[-1]

    yield start_program
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def start_node(start: StartProgram) -> StartNode:
    def start_with(*parameters: str, ros: Sequence[str] = ()) -> Process:
        options = [word for p in (*FAST_PARAMETERS, RELIABLE_INPUT, *parameters) for word in ('-p', p)]
        return start(sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', *options, *ros)

    return start_with


class Recorded(SimpleNamespace):
    """What a class of `launch` was created with; it substitutes for all of them."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(args=args, **options)

    def perform(self, context: dict[str, str]) -> str:
        return context[self.args[0]]


class RecordingModule(ModuleType):
    """A module that has every class."""

    def __getattr__(self, name: str) -> type[Recorded]:
        return Recorded


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the launch file, with substitutes for the packages that it imports."""
    for part in ('', '.actions', '.conditions', '.substitutions', '.parameter_descriptions'):
        for package in ('launch', 'launch_ros'):
            monkeypatch.setitem(sys.modules, package + part, RecordingModule(package + part))
    return load_module(ROOT / 'config' / 'launch' / 'mocap.launch.py')
