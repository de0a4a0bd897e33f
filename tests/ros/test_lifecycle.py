# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The life cycle of the node: starts that fail, deactivation and activation, what is left behind."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap_ros.errors import ConfigError
from tests.support.ros_node import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    Peer,
    StartNode,
    keypoints_at,
    stop_node,
)

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

# Before the first message, and after one.
SILENCE_CAUSES = (
    'its publisher sends nothing, or its QoS is incompatible; check the detector',
    'check that its publisher is still running',
)


@pytest.mark.parametrize(
    ('parameters', 'state', 'reason'),
    [
        (
            ['node.input_type:=std_msgs/msg/String'],
            'unconfigured',
            r"'std_msgs/msg/String' is not supported; .* `ros2 lifecycle set /mocap_node configure`",
        ),
        (
            ['tracker.model:=broken.npz'],
            'unconfigured',
            r'broken\.npz: not a base-pose model .*; the node is not configured: ',
        ),
        (
            ['qos_overrides./camera_info.subscription.reliability:=rubbish'],
            'inactive',
            r'; the node is not activated: .* `ros2 lifecycle set /mocap_node activate`',
        ),
        (
            ['recorder.enabled:=true', f'recorder.folder:={"x" * 300}'],
            'active',
            r'File name too long; nothing is recorded: correct the cause, then set recorder\.enabled again$',
        ),
    ],
)
def test_a_node_that_cannot_start_logs_why_in_one_line_and_keeps_running(
    peer: Peer, start_node: StartNode, tmp_path: Path, parameters: list[str], state: str, reason: str
) -> None:
    from lifecycle_msgs.srv import GetState

    (tmp_path / 'broken.npz').write_bytes(b'PK\3\4 no model')
    process = start_node(*parameters)
    label = peer.call_service(GetState, 'mocap_node/get_state').current_state.label
    line, *more = stop_node(process)
    assert (label, more) == (state, [])
    assert re.search(reason, line), line


def test_a_refused_node_is_reported_in_one_line() -> None:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    from mocap_ros.ros.nodes import create_node

    def refuse() -> None:
        raise rclpy_implementation.RCLError('no permission\nfor it, at /a/b.cpp:4, at /c.c:24')

    with pytest.raises(ConfigError, match=r'^ROS refuses to create the node: no permission for it$'):
        create_node(refuse)


def test_silence_is_logged_with_its_cause_after_activation_and_after_messages(
    peer: Peer, start_node: StartNode
) -> None:
    node = start_node('node.silence_warning:=0.5')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    peer.change_state(DEACTIVATE)
    peer.log.clear()
    peer.change_state(ACTIVATE)
    peer.wait_for_log('no message has arrived')
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(1)
    peer.wait_for_log('still running')
    silences = [line for line in stop_node(node) if 'no message has arrived' in line]
    for line, cause in zip(silences[-2:], SILENCE_CAUSES, strict=True):
        assert re.search(rf'no message has arrived on /keypoints for \d+ s: {cause}$', line), line


@pytest.mark.slow
def test_repeated_transitions_leak_neither_threads_nor_files(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    def count_threads_and_files() -> tuple[int, int]:
        status = Path(f'/proc/{node.pid}/status').read_text()
        threads = int(re.search(r'Threads:\s+(\d+)', status)[1])  # type: ignore[index]
        return threads, len(list(Path(f'/proc/{node.pid}/fd').iterdir()))

    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    first = last = (0, 0)
    for round_number in range(6):
        peer.change_state(DEACTIVATE, CLEAN_UP, CONFIGURE, ACTIVATE)
        peer.wait_for_keypoints_subscription()
        peer.keypoints.publish(keypoints_at(round_number + 1))
        peer.wait_for_frames(round_number + 1)
        last = count_threads_and_files()
        first = first if round_number else last
    assert last[0] <= first[0]
    assert last[1] <= first[1] + 1
    assert [line for line in stop_node(node) if 'no message has arrived' not in line] == []
