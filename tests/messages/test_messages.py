# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are encoded as a ROS 2 subscriber reads them, and invalid input is refused by field and person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode, encode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS, decode_keypoints, encode_keypoints
from mocap_ros.messages.markers import MARKERS, POINT_DTYPE, POINTS, MarkerEncoder, encode_points
from mocap_ros.messages.skeletons import (
    CAMERAS,
    SKELETON_DEFINITION,
    SKELETONS,
    encode_cameras,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.skeleton import CMU15, keypoint_layout
from tests.support.people import make_person_3d

LIMITS = NodeConfig()
HEADER = Header(12_345_678_901, 'camera')
SIZE = (640, 480)


def make_person_2d(person_id: str = '', joints: tuple[str, ...] = keypoint_layout('coco17').joints) -> Person2D:
    points = np.arange(2.0 * len(joints)).reshape(-1, 2)
    return Person2D(person_id, joints, points, np.full(len(joints), 0.5))


@pytest.mark.parametrize('joints', [keypoint_layout('coco17').joints, ('neck', 'pelvis', 'lknee', 'rknee')])
def test_keypoints_round_trip(joints: tuple[str, ...]) -> None:
    seen = make_person_2d('anna', joints)
    seen.score[1] = 0
    frame = decode_keypoints(encode_keypoints(HEADER, SIZE, [seen]), LIMITS)
    assert frame.header == HEADER
    assert (frame.image_width, frame.image_height) == SIZE
    (person,) = frame.people
    assert (person.id, person.joints) == ('anna', joints)
    np.testing.assert_array_equal(person.points[2:], seen.points[2:])
    np.testing.assert_array_equal(person.score, seen.score)
    assert np.isnan(person.points[1]).all()


def edit_keypoints(edit: Callable[[Any], None]) -> bytes:
    """Return a message of two people after an edit."""
    message = decode(encode_keypoints(HEADER, SIZE, [make_person_2d('a'), make_person_2d('b')]), KEYPOINTS)
    edit(message)
    return encode(message, KEYPOINTS)


def set_element(field: str, index: int, value: float) -> Callable[[Any], None]:
    """Return an edit of one element of an array of the second person."""

    def edit(message: Any) -> None:
        values = getattr(message.people[1], field).copy()
        values[index] = value
        setattr(message.people[1], field, values)

    return edit


def set_fields(**fields: Any) -> Callable[[Any], None]:
    """Return an edit of fields of the second person."""

    def edit(message: Any) -> None:
        for field, value in fields.items():
            setattr(message.people[1], field, value)

    return edit


NORMALISED = {'x': np.linspace(-0.3, 1.2, 17, dtype='f4'), 'y': np.linspace(0, 1, 17, dtype='f4')}
INVALID = {
    'unequal lengths': (set_fields(y=np.zeros(3, 'f4')), r'people\[1\].x, y, score: unequal lengths 17, 3, 17'),
    'unknown layout': (
        set_fields(skeleton='coco99'),
        r"people\[1\].skeleton: unknown .* 'coco99'; known: .*coco17",
    ),
    'joint count': (set_fields(skeleton='body25'), r"people\[1\].skeleton: 'body25' has 25 joints, x has 17"),
    'count of names': (set_fields(joint_names=['neck']), r'people\[1\].joint_names: there are 1 joints, x has 17'),
    'no names': (set_fields(skeleton=''), r'people\[1\].skeleton: empty, and no joint_names'),
    'unknown names': (
        set_fields(skeleton='', joint_names=[f'j{i}' for i in range(17)]),
        r'people\[1\].joint_names: .* fewer than four',
    ),
    'infinite': (set_element('x', 4, np.inf), r'people\[1\].x\[4\]: inf'),
    'infinite score': (set_element('score', 2, np.inf), r'people\[1\].score\[2\]: inf, expected'),
    'normalised coordinates': (set_fields(**NORMALISED), r'people\[1\].x, y: looks normalised; px expected'),
    'same id twice': (set_fields(id='a'), "people: id 'a' twice"),
    'long id': (set_fields(id='x' * 101), r'people\[1\].id: 101 characters, more than 100'),
    'negative stamp': (lambda m: setattr(m.header.stamp, 'sec', -1), 'header.stamp: -1 s'),
    'impossible stamp': (lambda m: setattr(m.header.stamp, 'nanosec', 10**9), 'header.stamp: 12 s 1000000000 ns'),
    'too many people': (lambda m: setattr(m, 'people', m.people * 31), 'people: 62, more than 60'),
}


@pytest.mark.parametrize('case', INVALID)
def test_invalid_keypoints_are_refused_by_field_and_person(case: str) -> None:
    edit, message = INVALID[case]
    with pytest.raises(InputError, match=f'^{message}') as caught:
        decode_keypoints(edit_keypoints(edit), LIMITS)
    assert '\n' not in str(caught.value)


VALID = encode_keypoints(HEADER, SIZE, [make_person_2d('a'), make_person_2d('b')])


def test_skeletons_and_cameras_hold_the_people() -> None:
    people = [make_person_3d('anna'), replace(make_person_3d('bob', 7.0), tentative=True)]
    skeletons = decode(encode_skeletons(HEADER, people), SKELETONS)
    cameras = decode(encode_cameras(HEADER, people), CAMERAS)
    assert (skeletons.header.stamp.sec, skeletons.header.stamp.nanosec) == (12, 345678901)
    assert skeletons.header.frame_id == cameras.header.frame_id == 'camera'
    assert cameras.ids == [p.id for p in skeletons.people] == ['anna', 'bob']
    body = np.array([0.3, -0.2, 1.1])
    for person, message, camera in zip(people, skeletons.people, cameras.cameras, strict=True):
        np.testing.assert_array_equal([[p.x, p.y, p.z] for p in message.joints], person.joints)
        np.testing.assert_array_equal(message.inferred, person.inferred)
        assert message.skeleton == 'cmu15'
        assert message.motion.state == message.motion.UNKNOWN
        assert message.scale_source == message.SCALE_KNOWN
        q = camera.rotation
        rotated = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(body)
        expected = camera.scale * rotated[:2] + camera.translation
        np.testing.assert_allclose(camera.matrix.reshape(2, 4) @ [*body, 1], expected, atol=1e-9)
        assert repr(message.camera) == repr(camera)


def test_every_point_names_its_person_and_joint() -> None:
    anna, bob = make_person_3d('anna'), replace(make_person_3d('bob', 7.0), std=np.linspace(0.1, 0.2, 15))
    cloud = decode(encode_points(HEADER, [anna, bob]), POINTS)
    read = np.frombuffer(cloud.data.tobytes(), POINT_DTYPE)
    assert (cloud.width, cloud.height, cloud.row_step) == (30, 1, 30 * cloud.point_step)
    dtypes = POINT_DTYPE.fields
    assert dtypes is not None
    assert [(f.name, f.offset) for f in cloud.fields] == [(name, dtypes[name][1]) for name in dtypes]
    np.testing.assert_array_equal(read['person'], np.repeat([0, 1], 15))
    np.testing.assert_array_equal(read['joint'], np.tile(np.arange(15), 2))
    np.testing.assert_array_equal(read['inferred'], np.concatenate([anna.inferred, bob.inferred]))
    np.testing.assert_allclose(read['std'], np.concatenate([anna.std, bob.std]), rtol=1e-6)
    for axis, name in enumerate('xyz'):
        np.testing.assert_array_equal(read[name], np.concatenate([anna.joints, bob.joints])[:, axis])
    assert decode(encode_points(HEADER, []), POINTS).width == 0


def test_skeleton_definition_names_the_joints() -> None:
    raw = encode_skeleton_definition(CMU15)
    message = decode(raw, SKELETON_DEFINITION)
    assert tuple(message.joint_names) == CMU15.joints
    assert tuple(message.parents) == CMU15.parents
    assert tuple(map(tuple, message.bones.reshape(-1, 2))) == CMU15.bones


def decode_markers(raw: bytes) -> dict[tuple[str, int], Any]:
    """Return the markers by namespace and number, which no two markers share."""
    markers = decode(raw, MARKERS).markers
    assert len({(m.ns, m.id) for m in markers}) == len(markers)
    return {(m.ns, m.id): m for m in markers}


def test_people_keep_number_and_colour_and_markers_of_others_are_deleted() -> None:
    encoder = MarkerEncoder()
    first = decode_markers(encoder.encode_update(HEADER, [make_person_3d('anna'), make_person_3d('bob')], 0.5))
    assert {(m.ns, m.type, m.action) for m in first.values()} == {('joints', 7, 0), ('bones', 5, 0)}
    assert first['joints', 0].lifetime.nanosec == 500_000_000
    assert repr(first['joints', 0].color) != repr(first['joints', 1].color)
    joints, bones = first['joints', 0], first['bones', 0]
    assert [c.a < 1 for c in joints.colors] == [i == 2 for i in range(15)]
    assert len(bones.points) == len(bones.colors) == 2 * len(CMU15.bones)

    second = decode_markers(encoder.encode_update(HEADER, [make_person_3d('bob')], 0.5))
    assert {key: m.action for key, m in second.items()} == {
        ('joints', 0): 2, ('bones', 0): 2, ('joints', 1): 0, ('bones', 1): 0,
    }  # fmt: skip
    assert repr(second['joints', 1].color) == repr(first['joints', 1].color)
    assert {m.action for m in decode_markers(encoder.encode_update(HEADER, [], 0.5)).values()} == {2}
    assert decode_markers(encoder.encode_update(HEADER, [], 0.5)) == {}
    assert {m.action for m in decode_markers(encoder.encode_clear(HEADER)).values()} == {3}


@pytest.mark.ros
def test_rclpy_decodes_the_same_content() -> None:
    pytest.importorskip('rclpy')
    from rclpy.serialization import deserialize_message

    from mocap_ros.ros.message_types import load_interface_class

    people = [make_person_3d('anna'), replace(make_person_3d('bob'), tentative=True)]
    outputs = {
        KEYPOINTS: VALID,
        SKELETONS: encode_skeletons(HEADER, people),
        CAMERAS: encode_cameras(HEADER, people),
        MARKERS: MarkerEncoder().encode_update(HEADER, people, 0.5),
        SKELETON_DEFINITION: encode_skeleton_definition(CMU15),
    }
    for msgtype, raw in outputs.items():
        own_message, ros_message = decode(raw, msgtype), deserialize_message(raw, load_interface_class(msgtype))
        assert flatten_message(own_message) == flatten_message(ros_message)


def flatten_message(value: Any) -> Any:
    """Return a message of either library as nested lists, with floats as text."""
    if hasattr(value, 'get_fields_and_field_types'):
        return [flatten_message(getattr(value, f)) for f in value.get_fields_and_field_types()]
    if hasattr(value, '__msgtype__'):
        _, fields = typestore().fielddefs[value.__msgtype__]
        return [flatten_message(getattr(value, name)) for name, _ in fields]
    if isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return repr(float(np.float32(value)))
    if isinstance(value, np.generic):
        return flatten_message(value.item())
    return [flatten_message(v) for v in value]
