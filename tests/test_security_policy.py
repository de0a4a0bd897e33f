"""The policies for SROS2 allow what node and player do, and nothing else."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from mocap_ros.bags.topics import Source
from mocap_ros.ros.help import SERVICES
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS

PATH = Path(__file__).parents[1] / 'config' / 'mocap_ros.policy.xml'
POLICY = ET.parse(PATH)
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


def read_names(node: str, kind: str, permission: str) -> set[str]:
    """Return the topics or services for which a node has a permission."""
    lists = POLICY.findall(f'.//profile[@node="{node}"]/{kind}s[@{permission}="ALLOW"]/{kind}')
    return {element.text or '' for element in lists}


def test_node() -> None:
    outputs = {*OUTPUTS, *LATCHED_OUTPUTS, *(output.topic for output in SWITCHED_OUTPUTS.values())}
    assert read_names('mocap_node', 'topic', 'publish') == {
        *outputs, *NODE_TOPICS, '/diagnostics', BODIES, '~/transition_event'
    }  # fmt: skip
    assert read_names('mocap_node', 'topic', 'subscribe') == {*INPUTS, BODIES, '/clock', '/parameter_events'}
    assert read_names('mocap_node', 'service', 'reply') == {*SERVICES, *PARAMETER_SERVICES, *LIFECYCLE_SERVICES}
    assert not read_names('mocap_node', 'service', 'request')


def test_player() -> None:
    assert read_names('mocap_player', 'topic', 'publish') == {*INPUTS, *NODE_TOPICS, BODIES, '/clock'}
    assert not read_names('mocap_player', 'topic', 'subscribe')
    assert read_names('mocap_player', 'service', 'reply') == PARAMETER_SERVICES


def test_the_operator_calls_services_of_the_node() -> None:
    services = {name.replace('~', '/mocap_node') for name in read_names('mocap_node', 'service', 'reply')}
    assert read_names('operator', 'service', 'request') <= services
    assert not read_names('operator', 'service', 'reply')


def test_sros2_finds_nothing_but_enclaves() -> None:
    """Its command fails at a comment between enclaves."""
    enclaves = ET.parse(PATH, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))).find('enclaves')
    assert enclaves is not None
    assert [element.tag for element in enclaves] == ['enclave'] * 3
