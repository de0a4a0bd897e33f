# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of the tests over DDS: a domain for each test, a peer, and the node."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from mocap_ros.cli.demo import reserve_domain
from tests.support.ros_node import Peer, Process, StartNode, launch_node


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
def start_node(env: dict[str, str], tmp_path: Path) -> Iterator[StartNode]:
    started: list[Process] = []

    def start(*parameters: str, ros: Sequence[str] = ()) -> Process:
        started.append(launch_node(env, tmp_path, parameters, ros))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
