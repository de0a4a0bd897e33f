# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Many messages read as columns, against each of them decoded alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import create_message, decode, encode, typestore
from mocap_ros.messages.columns import read_columns
from mocap_ros.messages.keypoint_columns import read_keypoints
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeleton_columns import read_skeletons
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons

SKELETON, POINT = 'mocap_ros_msgs/msg/Skeleton3D', 'geometry_msgs/msg/Point'
PERSON = 'mocap_ros_msgs/msg/Keypoints2D'
QUATERNION, VECTOR = 'geometry_msgs/msg/Quaternion', 'geometry_msgs/msg/Vector3'
SEEDS = st.integers(0, 2**32 - 1)
TEXTS = ('', 'a', 'anna', 'zoë')
Described = tuple[Nodetype, Any]  # type of a field as rosbags describes it


def make_message(msgtype: str, rng: np.random.Generator) -> Any:
    """Return a message of any type with random numbers, texts and lengths, by its definition."""

    def make(described: Described) -> Any:
        kind, content = described
        if kind == Nodetype.NAME:
            return make_message(content, rng)
        if kind == Nodetype.BASE:
            if content[0] == 'string':
                return str(rng.choice(TEXTS))
            return rng.integers(0, 2).astype(bool) if content[0] == 'bool' else int(rng.integers(0, 100))
        element, size = content
        count = size if kind == Nodetype.ARRAY else int(rng.integers(0, 4))
        values = [make(element) for _ in range(count)]
        is_numbers = element[0] == Nodetype.BASE and element[1][0] != 'string'
        return np.array(values, element[1][0]) if is_numbers else values

    fields = typestore().get_msgdef(msgtype).fields
    return create_message(msgtype, **{name: make(described) for name, described in fields})


@pytest.mark.parametrize('msgtype', [SKELETONS, KEYPOINTS])
@given(seed=SEEDS)
@settings(max_examples=20)
def test_columns_are_what_each_message_says(msgtype: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    some = [make_message(msgtype, rng) for _ in range(4)] * 2
    seen = []
    for columns in read_columns([encode(message, msgtype) for message in some], msgtype):
        for row, number in enumerate(columns.rows.tolist()):
            message = some[number]
            seen.append(number)
            assert columns.read('header', 'stamp', 'nanosec')[row] == message.header.stamp.nanosec
            assert columns.count('people') == len(message.people)
            for index, person in enumerate(message.people):
                texts = list(columns.group_texts(('people', index, 'id'), ('people', index, 'skeleton')))
                assert [t for t, rows in texts if row in rows] == [(person.id, person.skeleton)]
                if msgtype == KEYPOINTS:
                    assert columns.count('people', index, 'joint_names') == len(person.joint_names)
                    assert columns.read('people', index, 'score')[row].tolist() == person.score.tolist()
                    continue
                joints = [[point.x, point.y, point.z] for point in person.joints]
                assert columns.read('people', index, 'joints')[row].tolist() == joints
                assert columns.read('people', index, 'inferred')[row].tolist() == person.inferred.tolist()
                assert columns.read('people', index, 'camera', 'scale')[row] == person.camera.scale
                assert columns.read('people', index, 'unseen_for')[row] == person.unseen_for
            if msgtype == SKELETONS:  # the last field
                q = message.camera_pose.orientation
                assert columns.read('camera_pose', 'orientation')[row].tolist() == [q.x, q.y, q.z, q.w]
    assert sorted(seen) == list(range(len(some)))


def is_refused(read: Callable[[bytes], object], raw: bytes) -> bool:
    try:
        read(raw)
    except InputError:
        return True
    return False


@given(seed=SEEDS)
@settings(max_examples=50)
def test_bytes_that_are_cut_off_or_no_message_are_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    raw = encode(make_message(SKELETONS, rng), SKELETONS)
    cut = raw[: int(rng.integers(0, len(raw) - 3))]
    noise = raw[:4] + rng.bytes(len(raw) - 4)
    for damaged in (cut, noise):
        assert is_refused(lambda raw: list(read_columns([raw], SKELETONS)), damaged) == is_refused(
            lambda raw: decode(raw, SKELETONS), damaged
        )


def test_messages_in_big_endian_are_read_too() -> None:
    message = make_message(KEYPOINTS, np.random.default_rng(1))
    raw = bytes(typestore().serialize_cdr(message, KEYPOINTS, little_endian=False))
    (columns,) = read_columns([raw], KEYPOINTS)
    assert columns.read('image_width').tolist() == [message.image_width]


def test_joints_are_in_the_optical_frame_whatever_frame_they_were_put_out_in() -> None:
    rng = np.random.default_rng(3)
    raws = []
    for turned in (True, False, True):
        array = make_message(SKELETONS, rng)
        array.people = [make_message(SKELETON, rng) for _ in range(2)]
        for person in array.people:
            person.id, person.skeleton = 'anna', 'cmu15'
            person.joints = [make_message(POINT, rng) for _ in range(15)]
            person.inferred, person.joint_std = np.zeros(15, bool), np.full(15, 0.5, np.float32)
        array.camera_pose.orientation = create_message(
            QUATERNION, x=0.6 * turned, y=0.0, z=0.0, w=0.8 if turned else 1.0
        )
        array.vertical = create_message(VECTOR, x=0.0, y=0.0, z=1.0)
        raws.append(encode(array, SKELETONS))
    expected = [decode_skeletons(raw) for raw in raws]
    count = 0
    for messages in read_skeletons(raws):
        for person in messages.people:
            for row, joints in zip(person.rows, person.joints, strict=True):
                number = int(messages.rows[row])
                found = [np.array([[p.x, p.y, p.z] for p in other.joints]) for other in expected[number].people]
                assert any(np.allclose(joints, other, atol=1e-9) for other in found)
                count += 1
        angle = 2 * np.arctan2(0.6, 0.8)
        for row, vertical in zip(messages.rows.tolist(), messages.vertical, strict=True):
            upward = [0, np.sin(angle), np.cos(angle)] if row != 1 else [0, 0, 1]
            assert vertical == pytest.approx(upward)
    assert count == 6


def make_skeletons(**changes: Any) -> Any:
    """Return skeletons of one person, some of whose fields are changed."""
    rng = np.random.default_rng(5)
    array = make_message(SKELETONS, rng)
    person = make_message(SKELETON, rng)
    person.id, person.skeleton = 'anna', 'cmu15'
    person.joints = [make_message(POINT, rng) for _ in range(15)]
    person.inferred, person.joint_std = np.arange(15) == 3, np.full(15, 0.5, np.float32)
    array.people = [person]
    array.camera_pose.orientation = create_message(QUATERNION, x=0.0, y=0.0, z=0.0, w=1.0)
    for name, value in changes.items():
        setattr(person, name, value)
    return array


def test_people_in_one_place_of_messages_of_one_form_are_told_apart() -> None:
    raws = [encode(make_skeletons(id=name), SKELETONS) for name in ('anna', 'bert', 'anna', 'carl')]
    (messages,) = read_skeletons(raws)
    found = {person.id: messages.rows[person.rows].tolist() for person in messages.people}
    assert found == {'anna': [0, 2], 'bert': [1], 'carl': [3]}


def test_messages_of_0_1_tell_neither_deviations_nor_what_was_inferred() -> None:
    raw = encode(make_skeletons(joint_std=np.zeros(0, np.float32), inferred=np.zeros(0, bool)), SKELETONS)
    ((person,),) = (messages.people for messages in read_skeletons([raw]))
    assert np.isnan(person.std).all()
    assert not person.inferred.any()
    assert person.std.shape == person.inferred.shape == (1, 15)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'skeleton': 'body27'}, "skeleton: unknown keypoint layout 'body27'"),
        ({'skeleton': 'body26'}, '15 joints and 15 flags, body26 has 26'),
        ({'inferred': np.zeros(14, bool)}, '15 joints and 14 flags, cmu15 has 15'),
    ],
)
def test_skeletons_that_are_none_are_refused(changes: dict[str, Any], message: str) -> None:
    raws = [encode(make_skeletons(), SKELETONS), encode(make_skeletons(**changes), SKELETONS)]
    with pytest.raises(InputError, match=message):
        list(read_skeletons(raws))


def test_a_camera_pose_that_is_none_is_refused() -> None:
    array = make_skeletons()
    array.camera_pose.orientation.w = 2.0
    with pytest.raises(InputError, match=r'^camera_pose: '):
        list(read_skeletons([encode(array, SKELETONS)]))


def test_a_text_that_is_not_utf_8_is_refused() -> None:
    raw = encode(make_skeletons(id='berta'), SKELETONS)
    assert raw.count(b'berta') == 1
    with pytest.raises(InputError, match=r'people.*id.*: invalid start byte'):
        list(read_skeletons([raw.replace(b'berta', b'\xfferta')]))


@pytest.mark.parametrize(
    ('layout', 'count', 'message'),
    [
        ('coco99', 17, "people: unknown keypoint layout 'coco99'"),
        ('body25', 17, 'people: 17 keypoints, expected 25'),
    ],
)
def test_keypoints_that_are_none_are_refused(layout: str, count: int, message: str) -> None:
    array = make_message(KEYPOINTS, np.random.default_rng(2))
    person = create_message(
        PERSON,
        id='',
        skeleton=layout,
        joint_names=[],
        **{name: np.zeros(count, np.float32) for name in ('x', 'y', 'score')},
    )
    array.people = [person]
    with pytest.raises(InputError, match=message):
        list(read_keypoints([encode(array, KEYPOINTS)]))
