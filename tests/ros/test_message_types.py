"""Messages in the installed version of a type are converted to the fields of this package."""

from __future__ import annotations

from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.foreign.definitions import OPENPOSE_POSES
from mocap_ros.ros import message_types
from tests.support.foreign_messages import encode_openpose


def test_another_version_of_a_type_is_converted(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = {
        'std_msgs/msg/Header': {'stamp': 'builtin_interfaces/Time', 'frame_id': 'string'},
        'builtin_interfaces/msg/Time': {'sec': 'int32', 'nanosec': 'uint32'},
        OPENPOSE_POSES: {
            'header': 'std_msgs/Header',
            'model': 'string<8>',
            'pose_key_points_list': 'sequence<openpose_ros2_msgs/PoseKeyPoints, 30>',
        },
        'openpose_ros2_msgs/msg/PoseKeyPoints': {'pose_key_points': 'openpose_ros2_msgs/PoseKeyPoint[17]'},
        'openpose_ros2_msgs/msg/PoseKeyPoint': {'score': 'float', 'x': 'double', 'y': 'double'},
    }

    def load_installed_class(msgtype: str) -> Any:
        return type('Installed', (), {'get_fields_and_field_types': staticmethod(lambda: fields[msgtype])})

    monkeypatch.setattr(message_types, 'load_interface_class', load_installed_class)
    convert = message_types.build_converter(OPENPOSE_POSES)
    assert convert is not None
    store = get_typestore(Stores.EMPTY)
    for msgtype, text in message_types.interface_definitions(OPENPOSE_POSES, set()):
        store.register(get_types_from_msg(text, msgtype))
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
    assert decode(convert(raw), OPENPOSE_POSES) == expected
    with pytest.raises(InputError, match='not a openpose'):
        convert(raw[:40])
    fields[OPENPOSE_POSES]['header'] = 'wstring?'
    with pytest.raises(ConfigError, match='cannot be read'):
        message_types.build_converter(OPENPOSE_POSES)
