# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The policies for SROS2 allow what node and player do, and nothing else."""

from __future__ import annotations

from mocap_ros.bags.topics import Source
from mocap_ros.bridges.bridge import CONSUMERS
from mocap_ros.ros.help import SERVICES
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS
from tests.support.security_policy import read_permissions

INPUTS = {source.value for source in Source if source is not Source.BODY}
BODIES = f'{Source.BODY.value}/*'  # the topics of the bodies
# Topics and services of every node, and of lifecycle nodes, which rclpy creates.
NODE_TOPICS = {'/parameter_events', '/rosout'}
PARAMETER_SERVICES = {
    f'~/{name}'
    for name in (
        'describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters', 'set_parameters',
        'set_parameters_atomically', 'get_type_description',
    )
}  # fmt: skip
LIFECYCLE_SERVICES = {
    f'~/{name}'
    for name in (
        'change_state', 'get_available_states', 'get_available_transitions', 'get_state', 'get_transition_graph'
    )
}  # fmt: skip
# What an operator needs to record, to forget people, to stop the node and to change its parameters.
OPERATED = {
    'record', 'reset', 'change_state', 'get_state', 'describe_parameters', 'get_parameter_types', 'get_parameters',
    'list_parameters', 'set_parameters',
}  # fmt: skip


def test_node() -> None:
    node = read_permissions('mocap_node')
    outputs = {*OUTPUTS, *LATCHED_OUTPUTS, *(topic for topic, _ in SWITCHED_OUTPUTS.values())}
    assert node.publish == {*outputs, *NODE_TOPICS, '/diagnostics', '~/transition_event'}
    assert node.subscribe == {*INPUTS, BODIES, '/clock', '/parameter_events'}
    assert node.reply == {*SERVICES, *PARAMETER_SERVICES, *LIFECYCLE_SERVICES}
    assert not node.request


def test_bridge() -> None:
    bridge = read_permissions('mocap_bridge')
    topics = {consumer.topic for consumer in CONSUMERS.values()}
    assert bridge.publish == {*topics, *NODE_TOPICS, BODIES, '~/transition_event'}
    assert bridge.subscribe == {'skeletons', 'predictions', '/clock', '/parameter_events'}
    assert bridge.reply == {*PARAMETER_SERVICES, *LIFECYCLE_SERVICES}
    assert not bridge.request


def test_player() -> None:
    player = read_permissions('mocap_player')
    assert player.publish == {*INPUTS, *NODE_TOPICS, BODIES, '/clock'}
    assert player.reply == PARAMETER_SERVICES
    assert not player.subscribe
    assert not player.request


def test_the_operator_calls_services_of_the_node_and_reads_what_it_says() -> None:
    operator, node = read_permissions('operator'), read_permissions('mocap_node')
    assert operator.request == {f'/mocap_node/{name}' for name in OPERATED}
    assert operator.request <= {name.replace('~', '/mocap_node') for name in node.reply}
    assert operator.subscribe == {'/diagnostics', 'skeletons', '/parameter_events'}
    assert operator.publish == NODE_TOPICS
    assert not operator.reply
