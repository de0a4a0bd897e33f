# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node compiles its kernels while it is configured, and never later."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.ros_node import (
    FAST_PARAMETERS,
    RELIABLE_INPUT,
    TIMEOUT_S,
    Peer,
    StartNode,
    keypoints_at,
    stop_node_and_read_log,
)

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

# Runs the node and prints what was left to compile when it became active, and what was compiled after that.
WATCHED_NODE = """
import json, sys
from mocap_ros.runtime.cpu_setup import configure_process
configure_process()
from numba.core.event import install_recorder
from mocap_ros.compiled import kernel
from mocap_ros.ros import node
from mocap_ros.ros.nodes import run_node

left = []

class WatchedNode(node.MocapNode):
    def on_activate(self, state):
        left.append(len(kernel._pending))
        return super().on_activate(state)

with install_recorder('numba:compile') as compiled:
    kernel.compile_kernels()  # all that the imports above declare
    before = len(compiled.buffer)
    run_node(sys.argv[1:], WatchedNode)
print(json.dumps({'left': left, 'pending': len(kernel._pending), 'compiled': len(compiled.buffer) - before}))
"""


def test_nothing_is_compiled_once_the_node_is_active(peer: Peer, env: dict[str, str], tmp_path: Path) -> None:
    options = [word for p in (*FAST_PARAMETERS, RELIABLE_INPUT) for word in ('-p', p)]
    command = [sys.executable, '-c', WATCHED_NODE, '--ros-args', *options]
    process = subprocess.Popen(command, env=env, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        peer.wait_for_node()
        peer.wait_for_keypoints_subscription()
        for number in range(40):
            peer.keypoints.publish(keypoints_at(number / 30))
            peer.wait_for_frames(number + 1)
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
    assert json.loads(output) == {'left': [0], 'pending': 0, 'compiled': 0}


def test_a_warm_start_says_how_many_functions_came_from_the_cache(peer: Peer, start_node: StartNode) -> None:
    process = start_node()
    peer.wait_for_node()
    log = '\n'.join(stop_node_and_read_log(process))
    assert 'compiled functions are ready after' in log
    assert 'compiling' not in log


@pytest.mark.parametrize('by', [signal.SIGINT, signal.SIGTERM])
def test_a_cold_start_says_that_it_compiles_and_can_be_stopped_at_once(
    env: dict[str, str], start_node: StartNode, tmp_path: Path, by: signal.Signals
) -> None:
    env['NUMBA_CACHE_DIR'] = str(tmp_path / 'cache')
    process = start_node()
    assert process.stderr is not None
    line = process.stderr.readline()
    assert 'compiling' in line
    assert 'once after installation or an update; this takes one to two minutes' in line
    process.send_signal(by)
    _, log = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, log) == (0, '')
