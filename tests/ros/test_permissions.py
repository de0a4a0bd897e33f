# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What node and player publish, read, offer and call on the middleware is what the policies for SROS2 allow."""

import sys
from pathlib import Path
from typing import Any

import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.outputs import SWITCHED_OUTPUTS
from tests.support.camera_infos import camera_info
from tests.support.launch_file import Permissions, read_permissions
from tests.support.ros_node import Peer, StartNode, StartProgram, keypoints_at

pytestmark = pytest.mark.ros

BODIES = '/humans/bodies/*'  # topics of single bodies, with types that are not installed
OF_EVERY_NODE = {'/parameter_events'}  # rclpy subscribes to it only where the time of a simulation is used


def is_installed(kind: str) -> bool:
    try:
        load_interface_class(kind)
    except ConfigError:
        return False
    return True


def find_permissions(node: Any, name: str) -> Permissions:
    """Return what another node has on the middleware, with names as in the policies."""

    def rename(found: list[tuple[str, list[str]]]) -> frozenset[str]:
        allowed = {name for names in read_permissions(name) for name in names}
        own = {topic.replace(f'/{name}/', '~/') for topic, _ in found}
        return frozenset(topic[1:] if topic[1:] in allowed else topic for topic in own)

    return Permissions(
        publish=rename(node.get_publisher_names_and_types_by_node(name, '/')),
        subscribe=rename(node.get_subscriber_names_and_types_by_node(name, '/')),
        reply=rename(node.get_service_names_and_types_by_node(name, '/')),
        request=rename(node.get_client_names_and_types_by_node(name, '/')),
    )


def without(permissions: Permissions, missing: set[str]) -> Permissions:
    """Return the permissions that do not need types that are not installed."""
    return permissions._replace(
        publish=permissions.publish - missing, subscribe=permissions.subscribe - missing - OF_EVERY_NODE
    )


def wait_for_permissions(peer: Peer, name: str, missing: set[str]) -> None:
    """Wait until a node has on the middleware what the policies allow; it must never have more."""
    allowed = read_permissions(name)
    expected = without(allowed, missing)

    def are_reached() -> bool:
        found = find_permissions(peer.node, name) if name in peer.node.get_node_names() else None
        if found is None:
            return False
        for mine, others in zip(found, allowed, strict=True):
            assert mine <= others, 'not allowed'
        return without(found, set()) == expected

    peer.wait_until(are_reached)


def test_the_node_has_what_the_policies_allow(peer: Peer, start_node: StartNode) -> None:
    wanted = dict(SWITCHED_OUTPUTS.values()) | {'/tf_static': TRANSFORMS}
    bodies = {BODIES, '/humans/bodies/tracked'}  # inputs of another type
    missing = {*bodies, *(topic for topic, kind in wanted.items() if not is_installed(kind))}
    assert 'predictions' not in missing
    switches = [f'node.{field}:=true' for field in SWITCHED_OUTPUTS]
    start_node('node.output_frame:=map', 'use_sim_time:=true', *switches)
    wait_for_permissions(peer, 'mocap_node', missing)


def test_the_player_has_what_the_policies_allow(peer: Peer, start: StartProgram, tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 0, 0)
        for i in range(10):
            recorder.write('/keypoints', KEYPOINTS, keypoints_at(i), i * 10**8, i * 10**8)
    start(sys.executable, '-m', 'mocap_ros.cli.main', 'play', tmp_path / 'bag', '--loop', '--clock')
    missing = {BODIES, '/humans/bodies/tracked', '/tf', '/tf_static'}  # they are not in this bag
    wait_for_permissions(peer, 'mocap_player', missing)
