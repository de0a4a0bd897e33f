# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Outputs are encoded as the library and ROS 2 read them; invalid keypoints are refused by field and person."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import copy_with
from mocap_ros.config import Config, NodeConfig, with_values
from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import RigidTransform, parse_camera_pose
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, decode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS, decode_keypoints, encode_keypoints
from mocap_ros.messages.markers import MARKERS, POINT_DTYPE, POINTS, MarkerEncoder, encode_points
from mocap_ros.messages.plain import decode_plain
from mocap_ros.messages.skeletons import (
    CAMERAS,
    PREDICTIONS,
    SKELETON_DEFINITION,
    SKELETONS,
    encode_cameras,
    encode_predictions,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.people import Motion, MotionKind, Person3D, Posture, PredictedPeople
from mocap_ros.runtime.outputs import SWITCHED_OUTPUTS, OutputEncoder
from mocap_ros.skeleton import BODY26, CMU15, Skeleton, find_roots, keypoint_layout
from tests.support.bodies import STANDING, gather, make_person_3d, make_standing_person
from tests.support.camera_messages import encode

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
    seen.depth = np.where(np.arange(len(joints)) == 2, np.nan, 1.5)
    frame = decode_keypoints(encode_keypoints(HEADER, SIZE, [seen]), LIMITS)
    assert frame.header == HEADER
    assert (frame.image_width, frame.image_height) == SIZE
    (person,) = frame.people
    assert (person.id, person.joints) == ('anna', joints)
    np.testing.assert_array_equal(person.points[2:], seen.points[2:])
    np.testing.assert_array_equal(person.score, seen.score)
    np.testing.assert_array_equal(np.asarray(person.depth), seen.depth)
    assert np.isnan(person.points[1]).all()


def edit_keypoints(edit: Callable[[Any], None]) -> bytes:
    """Return a message of two people after an edit."""
    message = decode(encode_keypoints(HEADER, SIZE, [make_person_2d('a'), make_person_2d('b')]), KEYPOINTS)
    edit(message)
    return encode(message, KEYPOINTS)


def set_fields(**fields: Any) -> Callable[[Any], None]:
    return lambda message: vars(message.people[1]).update(fields)


def infinite_at(index: int) -> np.ndarray:
    return np.where(np.arange(17) == index, np.inf, 0.5).astype('f4')


NORMALISED = {'x': np.linspace(-0.3, 1.2, 17, dtype='f4'), 'y': np.linspace(0, 1, 17, dtype='f4')}
INVALID = {
    'unequal lengths': (set_fields(y=np.zeros(3, 'f4')), r'people\[1\].x, y, score: unequal lengths 17, 3, 17'),
    'depths': (set_fields(depth=np.ones(3, 'f4')), r'people\[1\].depth: 3 values, x has 17'),
    'unknown layout': (set_fields(skeleton='coco99'), r"people\[1\].skeleton: unknown .* 'coco99'"),
    'joint count': (set_fields(skeleton='body25'), r"people\[1\].skeleton: 'body25' has 25 joints, x has 17"),
    'count of names': (set_fields(joint_names=['neck']), r'people\[1\].joint_names: there are 1 joints, x has 17'),
    'no names': (set_fields(skeleton=''), r'people\[1\].skeleton: empty, and no joint_names'),
    'unknown names': (
        set_fields(skeleton='', joint_names=[f'j{i}' for i in range(17)]),
        r'people\[1\].joint_names: .* fewer than four',
    ),
    'infinite': (set_fields(x=infinite_at(4)), r'people\[1\].x\[4\]: inf'),
    'infinite score': (set_fields(score=infinite_at(2)), r'people\[1\].score\[2\]: inf, expected'),
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
    with pytest.raises(InputError, match=f'^{message}'):
        decode_keypoints(edit_keypoints(edit), LIMITS)


def test_skeletons_and_cameras_hold_the_people() -> None:
    people = [make_person_3d('anna'), replace(make_person_3d('bob', 7.0), tentative=True)]
    skeletons = decode(encode_skeletons(HEADER, gather(people)), SKELETONS)
    cameras = decode(encode_cameras(HEADER, gather(people)), CAMERAS)
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
    anna, bob = make_person_3d('anna'), replace(make_person_3d('bob', 7.0), joint_std=np.linspace(0.1, 0.2, 15))
    cloud = decode(encode_points(HEADER, gather([anna, bob])), POINTS)
    read = np.frombuffer(cloud.data.tobytes(), POINT_DTYPE)
    assert (cloud.width, cloud.height, cloud.row_step) == (30, 1, 30 * cloud.point_step)
    dtypes = POINT_DTYPE.fields
    assert dtypes is not None
    assert [(f.name, f.offset) for f in cloud.fields] == [(name, dtypes[name][1]) for name in dtypes]
    np.testing.assert_array_equal(read['person'], np.repeat([0, 1], 15))
    np.testing.assert_array_equal(read['joint'], np.tile(np.arange(15), 2))
    np.testing.assert_array_equal(read['inferred'], np.concatenate([anna.inferred, bob.inferred]))
    np.testing.assert_allclose(read['std'], np.concatenate([anna.joint_std, bob.joint_std]), rtol=1e-6)
    for axis, name in enumerate('xyz'):
        np.testing.assert_array_equal(read[name], np.concatenate([anna.joints, bob.joints])[:, axis])
    assert decode(encode_points(HEADER, gather([])), POINTS).width == 0


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
    first = decode_markers(
        encoder.encode_update(HEADER, gather([make_person_3d('anna'), make_person_3d('bob')]), 0.5)
    )
    assert {(m.ns, m.type, m.action) for m in first.values()} == {('joints', 7, 0), ('bones', 5, 0)}
    assert first['joints', 0].lifetime.nanosec == 500_000_000
    assert repr(first['joints', 0].color) != repr(first['joints', 1].color)
    joints, bones = first['joints', 0], first['bones', 0]
    assert [c.a < 1 for c in joints.colors] == [i == 2 for i in range(15)]
    assert len(bones.points) == len(bones.colors) == 2 * len(CMU15.bones)

    second = decode_markers(encoder.encode_update(HEADER, gather([make_person_3d('bob')]), 0.5))
    assert {key: m.action for key, m in second.items()} == {
        ('joints', 0): 2, ('bones', 0): 2, ('joints', 1): 0, ('bones', 1): 0,
    }  # fmt: skip
    assert repr(second['joints', 1].color) == repr(first['joints', 1].color)
    assert {m.action for m in decode_markers(encoder.encode_update(HEADER, gather([]), 0.5)).values()} == {2}
    assert decode_markers(encoder.encode_update(HEADER, gather([]), 0.5)) == {}
    assert {m.action for m in decode_markers(encoder.encode_clear(HEADER)).values()} == {3}


@pytest.mark.ros
def test_rclpy_reads_and_writes_the_same_bytes() -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    from mocap_ros.ros.message_types import load_interface_class

    people = [make_person_3d('anna'), replace(make_person_3d('bob'), tentative=True)]
    outputs = {
        KEYPOINTS: edit_keypoints(lambda _: None),
        SKELETONS: encode_skeletons(HEADER, gather(people)),
        CAMERAS: encode_cameras(HEADER, gather(people)),
        MARKERS: MarkerEncoder().encode_update(HEADER, gather(people), 0.5),
        SKELETON_DEFINITION: encode_skeleton_definition(CMU15),
    }
    for msgtype, raw in outputs.items():
        again = serialize_message(deserialize_message(raw, load_interface_class(msgtype)))
        assert encode(decode(again, msgtype), msgtype) == raw, 'but for the bytes between fields'


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def test_predictions_are_put_out_in_the_frame_of_the_outputs() -> None:
    camera = CameraPlacement('camera', parse_camera_pose('0 0 1.5 0 0 1.57', 'test'))
    header, covariance = Header(12_345_678_901, 'map'), np.diag([0.01, 0.04, 0.09])
    joints = STANDING + [2.0, 2.0, 0.0]
    person = PredictedPeople(0.4, ('anna',), joints[None], np.full((1, 15), 0.1), covariance[None])
    nobody = PredictedPeople(0.2, (), joints[None][:0], np.zeros((0, 15)), covariance[None][:0])
    raw = encode_predictions(header, [nobody, person], camera)
    message = decode(raw, PREDICTIONS)
    assert (message.header.frame_id, message.skeleton) == ('map', CMU15.name)
    soon, later = message.times
    assert [soon.ahead, later.ahead] == pytest.approx([0.2, 0.4])
    assert soon.people == []
    (anna,) = later.people
    pose = camera.pose
    assert pose is not None
    np.testing.assert_allclose([xyz(p) for p in anna.joints], pose.apply(joints), atol=1e-12)
    np.testing.assert_allclose(xyz(anna.root), pose.apply(find_roots(joints)), atol=1e-12)
    np.testing.assert_allclose(anna.root_covariance.reshape(3, 3), pose.rotate_covariance(covariance))
    np.testing.assert_allclose(anna.joint_std, 0.1, rtol=1e-6)
    assert anna.id == 'anna'
    driving = camera._replace(before=parse_camera_pose('-0.1 0 1.5 0 0 1.57', 'test'), step_s=0.1)
    raw = encode_predictions(header, [person], driving)
    root = decode(raw, PREDICTIONS).times[0].people[0].root
    np.testing.assert_allclose(np.array(xyz(root)) - xyz(anna.root), [0.4, 0, 0], atol=1e-9)  # at 1 m/s along x


def list_transforms(people: list[Person3D], frame: str = 'camera') -> list[Any]:
    transforms: list[Any] = decode(encode_transforms(Header(1, frame), gather(people)), TRANSFORMS).transforms
    return transforms


def test_links_are_at_the_joints_and_turned_as_their_segments() -> None:
    turns = Rotation.random(15, np.random.default_rng(0))
    person = replace(make_standing_person('anna'), joint_orientation=turns.as_quat())
    body, *links = list_transforms([person])
    pose, *others = (read_transform(t.transform) for t in (body, *links))
    np.testing.assert_allclose(pose.translation, person.root, atol=1e-12)
    standing = Rotation.from_matrix(pose.rotation)
    assert {t.header.frame_id for t in links} == {'body_anna'}
    for link, transform in zip(links, others, strict=True):
        name = link.child_frame_id.removesuffix('_anna').replace('_', '')
        if name != 'torso':
            joint = person.joint_names.index(name)
            np.testing.assert_allclose(pose.apply(transform.translation), person.joints[joint], atol=1e-12)
            turned = standing * Rotation.from_matrix(transform.rotation)
            assert (turned.inv() * turns[joint]).magnitude() < 1e-9
    up = person.joints[[CMU15.index('lshoulder'), CMU15.index('rshoulder')]].mean(axis=0) - person.root
    np.testing.assert_allclose(standing.as_matrix()[:, 2], up / np.linalg.norm(up), atol=1e-12)


def read_transform(transform: Any) -> RigidTransform:
    t, r = transform.translation, transform.rotation
    return RigidTransform.from_numbers((t.x, t.y, t.z, r.x, r.y, r.z, r.w))


def test_people_without_scale_or_extent_and_images_without_frame_have_no_transforms() -> None:
    person = make_standing_person('anna')
    assert list_transforms([replace(person, is_scale_known=False)]) == []
    assert list_transforms([replace(person, joints=np.zeros((15, 3)))]) == []
    assert list_transforms([person], frame='') == []
    assert len(list_transforms([person])) == 15


# Texts of every length modulo 8, and some outside ASCII: what follows a text is padded by its length in bytes.
TEXTS = st.text('aä人', max_size=9)
HEADERS = st.builds(Header, st.integers(0, 2**31 * 10**9 - 1), TEXTS)


@st.composite
def make_person(draw: st.DrawFn, skeleton: Skeleton) -> Person3D:
    rng, count = np.random.default_rng(draw(st.integers(0, 2**32))), len(skeleton.joints)
    joints = STANDING[np.arange(count) % len(STANDING)]
    return Person3D(
        id=draw(TEXTS),
        joints=joints + rng.normal(scale=0.1, size=(count, 3)) + [0, 0, 5],
        joint_std=rng.uniform(0.01, 0.1, count) * draw(st.sampled_from([1.0, np.nan])),
        inferred=rng.random(count) < draw(st.sampled_from([0.0, 0.3, 1.0])),
        scale=rng.uniform(100, 300),
        rotation=Rotation.from_rotvec(rng.normal(size=3)).as_matrix(),
        translation=rng.normal(size=2),
        motion=Motion(draw(st.sampled_from(MotionKind)), draw(TEXTS), 0.1, float('nan')),
        reprojection_residual=rng.uniform(0, 9),
        is_scale_known=True,
        tentative=draw(st.booleans()),
        predicted=draw(st.booleans()),
        joint_velocity=rng.normal(size=(count, 3)),
        joint_velocity_std=rng.uniform(0.1, 1, count),
        root_covariance=rng.normal(size=(3, 3)),
        root_velocity_covariance=rng.normal(size=(3, 3)),
        age=rng.uniform(0, 9),
        unseen_for=rng.uniform(0, 1),
        skeleton=skeleton,
        joint_orientation=Rotation.random(count, rng).as_quat(),
        turn_inferred=rng.random(count) < 0.5,
        contact=rng.random(2) * draw(st.sampled_from([1.0, np.nan])),
        posture=draw(st.sampled_from(Posture)),
        posture_probability=rng.random(),
    )


@st.composite
def make_people(draw: st.DrawFn) -> list[Person3D]:
    """Return people of different ids and one skeleton."""
    skeleton = draw(st.sampled_from([CMU15, BODY26]))
    return [replace(p, id=f'{n}{p.id}') for n, p in enumerate(draw(st.lists(make_person(skeleton), max_size=3)))]


@given(header=HEADERS, people=make_people(), later_ns=st.integers(0, 2**31 * 10**9 - 1))
def test_all_outputs_are_as_the_library_writes_them(header: Header, people: list[Person3D], later_ns: int) -> None:
    people = [replace(p, joint_orientation=p.joint_orientation * np.nan) if n else p for n, p in enumerate(people)]
    node = with_values(Config(), {f'node.{field}': True for field in SWITCHED_OUTPUTS}).node
    is_scale_known, encoder = header.stamp_ns % 2 == 0, OutputEncoder()
    for stamp_ns, shown in ((header.stamp_ns, people), (later_ns, people), (later_ns, people[1:])):
        now = copy_with(gather(shown), is_scale_known=is_scale_known)
        ahead = PredictedPeople(0.2, now.ids, now.core, now.joint_std[:, :15], now.root_covariance)
        known = [ahead] if shown == people else []
        for message in encoder.encode(header._replace(stamp_ns=stamp_ns), now, node, predicted=known):
            decoded = decode(message.data, message.type)
            assert encode(decoded, message.type) == message.data, message.topic
            check_plain(decode_plain(message.data, message.type), decoded)
            swapped = bytes(typestore().serialize_cdr(decoded, message.type, little_endian=False))
            check_plain(decode_plain(swapped, message.type), decoded)


def check_plain(plain: Any, decoded: Any) -> None:
    if isinstance(plain, SimpleNamespace):
        for name, value in vars(plain).items():
            check_plain(value, getattr(decoded, name))
    elif isinstance(plain, list):
        for value, element in zip(plain, decoded, strict=True):
            check_plain(value, element)
    else:
        np.testing.assert_array_equal(np.ravel(plain), np.ravel(list_numbers(decoded)))


def list_numbers(value: Any) -> Any:
    if isinstance(value, list):
        return [list_numbers(element) for element in value]
    if not hasattr(value, '__msgtype__'):
        return value
    return np.concatenate([np.ravel(list_numbers(v)) for name, v in vars(value).items() if name != '__msgtype__'])
