# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are converted between the installed version of their type and this package's."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from mocap_ros.errors import ConfigError
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.markers import MARKERS
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from tests.support.installed_types import MARKER_TYPES, Fields, describe_as_rclpy, replace_installed_types

MARKER = 'visualization_msgs/msg/Marker'


@pytest.fixture
def fields(monkeypatch: pytest.MonkeyPatch) -> Fields:
    """Return a dictionary of the types that count as installed, to which a test adds its own."""
    installed: Fields = {
        'std_msgs/msg/Header': {'stamp': 'builtin_interfaces/Time', 'frame_id': 'string'},
        'builtin_interfaces/msg/Time': {'sec': 'int32', 'nanosec': 'uint32'},
    }
    replace_installed_types(monkeypatch, installed)
    return installed


def test_an_input_whose_installed_fields_cannot_be_read_is_refused(fields: Fields) -> None:
    fields[OPENPOSE_POSES] = {'header': 'wstring?'}
    with pytest.raises(ConfigError, match=f'fields of {OPENPOSE_POSES} cannot be read'):
        MessageVersions().add_input(OPENPOSE_POSES)


def test_an_output_that_the_installed_version_cannot_hold_is_refused_by_type_and_field(fields: Fields) -> None:
    fields |= describe_as_rclpy(get_typestore(Stores.ROS2_FOXY), *MARKER_TYPES)
    assert f'{MARKER}.mesh_file' in MessageVersions().add_output(MARKERS), 'it is left out'
    fields[MARKER]['points'] = 'sequence<geometry_msgs/Vector3, 8>'
    fields[MARKER]['ns'] = 'int32'
    with pytest.raises(ConfigError) as raised:
        MessageVersions().add_output(MARKERS)
    assert f'of {MARKERS} cannot hold' in str(raised.value)
    assert f'{MARKER}.ns, {MARKER}.points has another type' in str(raised.value)


@pytest.mark.parametrize('kind', ['', '__schemaless__', 'antigravity/x', 'os.path/msg/join', 'a/msg/b/c'])
def test_a_name_in_a_bag_that_names_no_type_is_not_imported(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.message_types.import_module', pytest.fail)
    with pytest.raises(ConfigError, match='is not the name of a type'):
        load_interface_class(kind)
