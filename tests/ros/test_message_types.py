# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are converted between the installed version of their type and this package's."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from mocap_ros.errors import ConfigError
from mocap_ros.messages.cdr import Header, OutputMessage, decode
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.ros.message_types import MessageVersions, load_installed_types, load_interface_class
from tests.support.foreign_messages import encode_openpose
from tests.support.installed_types import MARKER_TYPES, Fields, describe_as_rclpy, replace_installed_types
from tests.support.people import make_person_3d

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


def test_another_version_of_an_input_is_converted(fields: Fields) -> None:
    fields |= {
        OPENPOSE_POSES: {
            'header': 'std_msgs/Header',
            'model': 'string<8>',
            'pose_key_points_list': 'sequence<openpose_ros2_msgs/PoseKeyPoints, 30>',
        },
        'openpose_ros2_msgs/msg/PoseKeyPoints': {'pose_key_points': 'openpose_ros2_msgs/PoseKeyPoint[17]'},
        'openpose_ros2_msgs/msg/PoseKeyPoint': {'score': 'float', 'x': 'double', 'y': 'double'},
    }
    versions = MessageVersions()
    versions.add_input(OPENPOSE_POSES)
    store = load_installed_types(OPENPOSE_POSES)
    expected = decode(encode_openpose(0), OPENPOSE_POSES)
    installed = store.types[OPENPOSE_POSES](
        header=expected.header,
        model='body17',
        pose_key_points_list=[
            store.types['openpose_ros2_msgs/msg/PoseKeyPoints'](pose_key_points=p.pose_key_points)
            for p in expected.pose_key_points_list
        ],
    )
    raw = bytes(store.serialize_cdr(installed, OPENPOSE_POSES))
    assert decode(versions.read(OPENPOSE_POSES, raw), OPENPOSE_POSES) == expected
    assert versions.read(OPENPOSE_POSES, raw[:40]) == raw[:40]
    definition = versions.definitions[OPENPOSE_POSES]
    assert definition.type_hash == store.hash_rihs01(OPENPOSE_POSES)
    assert 'string<=8 model' in definition.text
    fields[OPENPOSE_POSES]['header'] = 'wstring?'
    with pytest.raises(ConfigError, match=f'fields of {OPENPOSE_POSES} cannot be read'):
        MessageVersions().add_input(OPENPOSE_POSES)


@pytest.fixture
def foxy(fields: Fields) -> Fields:
    """Return descriptions by which the markers of ROS 2 Foxy are installed."""
    fields |= describe_as_rclpy(get_typestore(Stores.ROS2_FOXY), *MARKER_TYPES)
    return fields


@pytest.mark.usefixtures('foxy')
def test_outputs_become_those_of_another_distribution() -> None:
    store = get_typestore(Stores.ROS2_FOXY)
    versions = MessageVersions()
    left_out = versions.add_output(MARKERS)
    assert f'{MARKER}.mesh_file' in left_out
    raw = MarkerEncoder().encode_update(Header(5, 'camera'), [make_person_3d('anna')], 0.5)
    written = versions.write_output(OutputMessage('markers', MARKERS, 5, raw))
    assert (written.topic, written.type, written.stamp_ns) == ('markers', MARKERS, 5)
    joints, bones = store.deserialize_cdr(written.data, MARKERS).markers  # type: ignore[attr-defined]
    own_joints, own_bones = decode(raw, MARKERS).markers
    assert (joints.ns, bones.ns, joints.lifetime.nanosec) == ('joints', 'bones', 500_000_000)
    assert [repr(p) for p in joints.points] == [repr(p) for p in own_joints.points]
    assert [repr(c) for c in bones.colors] == [repr(c) for c in own_bones.colors]
    assert versions.definitions[MARKERS].type_hash == store.hash_rihs01(MARKERS)


def test_an_output_that_the_installed_version_cannot_hold_is_refused_by_type_and_field(foxy: Fields) -> None:
    foxy[MARKER]['points'] = 'sequence<geometry_msgs/Vector3, 8>'
    foxy[MARKER]['ns'] = 'int32'
    with pytest.raises(ConfigError) as raised:
        MessageVersions().add_output(MARKERS)
    assert f'of {MARKERS} cannot hold' in str(raised.value)
    assert f'{MARKER}.ns, {MARKER}.points has another type' in str(raised.value)


@pytest.mark.ros
def test_the_installed_ros_has_the_outputs_of_this_package() -> None:
    pytest.importorskip('rclpy')
    pytest.importorskip('mocap_ros_msgs')
    versions = MessageVersions()
    raw = MarkerEncoder().encode_update(Header(5, 'camera'), [make_person_3d('anna')], 0.5)
    assert (versions.add_output(MARKERS), versions.definitions) == ([], {})
    assert versions.write(MARKERS, raw) is raw


@pytest.mark.parametrize('kind', ['', '__schemaless__', 'antigravity/x', 'os.path/msg/join', 'a/msg/b/c'])
def test_a_name_in_a_bag_that_names_no_type_is_not_imported(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.message_types.import_module', pytest.fail)
    with pytest.raises(ConfigError, match='is not the name of a type'):
        load_interface_class(kind)
