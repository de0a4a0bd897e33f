# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for robots: what they say of people in known poses, and that an independent decoder reads the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic

from mocap_ros.config import Config, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.geometry.rigid_transform import parse_camera_pose
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, decode, encode, typestore
from mocap_ros.messages.foreign.definitions import COLLISION_OBJECT, DETECTIONS_3D, OBSTACLES, PEOPLE
from mocap_ros.messages.marker_writer import ADD as ADD_MARKER
from mocap_ros.messages.marker_writer import DELETE, MARKERS
from mocap_ros.messages.robots.capsules import (
    CAPSULES,
    MAX_PARTS,
    compute_capsules,
    encode_capsules,
    list_body_parts,
)
from mocap_ros.messages.robots.collision_objects import ADD, REMOVE, CollisionObjectEncoder
from mocap_ros.messages.robots.detections import encode_detections
from mocap_ros.messages.robots.obstacles import encode_obstacles
from mocap_ros.messages.robots.people import encode_people
from mocap_ros.messages.robots.poses import POSES, encode_poses
from mocap_ros.messages.robots.predictions import (
    PREDICTIONS,
    PredictedFrame,
    encode_predictions,
    read_prediction_times,
)
from mocap_ros.people import Person3D, PredictedPerson
from mocap_ros.runtime.outputs import OUTPUTS, SWITCHED_OUTPUTS, OutputEncoder
from mocap_ros.skeleton import BODY26, CMU15, Skeleton
from tests.support.people import make_person_3d
from tests.support.swinging_body import STANDING

HEADER = Header(12_345_678_901, 'map')
ENCODERS: dict[str, Callable[[Header, Sequence[Person3D]], bytes]] = {
    PEOPLE: encode_people,
    DETECTIONS_3D: encode_detections,
    OBSTACLES: encode_obstacles,
    POSES: encode_poses,
    CAPSULES: encode_capsules,
    PREDICTIONS: lambda header, people: encode_predictions(
        header,
        [PredictedFrame(0.5, [make_predicted(p.id) for p in people]), PredictedFrame(1.0, [])],
        CameraPlacement(header.frame_id),
    ),
    COLLISION_OBJECT: lambda header, people: CollisionObjectEncoder().encode_update(header, people)[0],
}


def make_walker(person_id: str = 'anna', shift: tuple[float, float, float] = (2.0, 1.0, 0.0)) -> Person3D:
    """Return a person who stands upright, facing along the x axis or away from it, and moves at 1 m/s along y."""
    return replace(
        make_person_3d(person_id),
        joints=STANDING + shift,
        std=np.full(15, 0.03),
        velocity=np.tile([0.0, 1.0, 0.0], (15, 1)),
        root_covariance=np.diag([0.04, 0.01, 0.02]),
    )


def make_predicted(person_id: str = 'anna') -> PredictedPerson:
    """Return where the walker will be in a second."""
    walker = make_walker(person_id)
    return PredictedPerson(person_id, walker.joints + [0.0, 1.0, 0.0], np.full(15, 0.1), 0.09 * np.eye(3))


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def test_people_for_costmaps() -> None:
    lost = replace(
        make_walker('bob', (5, 0, 0)), predicted=True, unseen_for=0.5, velocity=np.full((15, 3), np.nan)
    )
    message = decode(encode_people(HEADER, [make_walker(), lost]), PEOPLE)
    assert (message.header.frame_id, message.header.stamp.nanosec) == ('map', 345_678_901)
    anna, bob = message.people
    assert xyz(anna.position) == pytest.approx(make_walker().root)
    assert xyz(anna.velocity) == [0, 1, 0]
    assert (anna.name, anna.reliability, anna.tagnames, anna.tags) == ('anna', 1.0, ['predicted'], ['false'])
    assert xyz(bob.velocity) == [0, 0, 0]  # unknown; planners take no NaN
    assert (bob.reliability, bob.tags) == (pytest.approx(np.exp(-0.5)), ['true'])


def test_detections_hold_pose_covariance_and_box() -> None:
    person = make_walker()
    (found,) = decode(encode_detections(HEADER, [person]), DETECTIONS_3D).detections
    (result,) = found.results
    assert (found.id, result.hypothesis.class_id, result.hypothesis.score) == ('anna', 'person', 1.0)
    covariance = result.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(covariance[:3, :3], person.root_covariance)
    hips = person.joints[[CMU15.index('lhip'), CMU15.index('rhip')]]
    breadth = np.linalg.norm(hips[0] - hips[1])
    np.testing.assert_allclose(covariance[3:, 3:], np.eye(3) * 4 / 3 * (0.03 / breadth) ** 2)
    low, high = (
        np.array(xyz(found.bbox.center.position)) + s * np.array(xyz(found.bbox.size)) / 2 for s in (-1, 1)
    )
    assert (low + 0.09 < person.joints).all()
    assert (high - 0.09 > person.joints).all()
    unknown = replace(person, std=np.full(15, np.nan))
    (found,) = decode(encode_detections(HEADER, [unknown]), DETECTIONS_3D).detections
    np.testing.assert_allclose(found.results[0].pose.covariance[-1], np.pi**2 / 3)


def test_obstacles_have_ids_that_stay() -> None:
    people = [make_walker(), make_walker('bob')]
    one, other = (decode(encode_obstacles(HEADER, p), OBSTACLES).obstacles for p in (people, people[::-1]))
    assert one[0].uuid.uuid.tolist() == other[1].uuid.uuid.tolist() != one[1].uuid.uuid.tolist()
    assert xyz(one[0].velocity) == [0, 1, 0]
    assert xyz(one[0].size)[2] == pytest.approx(np.ptp(STANDING[:, 2]) + 0.2)


def test_poses_face_ahead() -> None:
    person = make_walker()
    (pose,) = decode(encode_poses(HEADER, [person]), POSES).poses
    assert xyz(pose.position) == pytest.approx(person.root)
    q = pose.orientation
    left = person.joints[CMU15.index('lhip')] - person.joints[CMU15.index('rhip')]
    y_axis = np.array([2 * (q.x * q.y - q.w * q.z), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z + q.w * q.x)])
    assert y_axis @ left / np.linalg.norm(left) == pytest.approx(1, abs=1e-3)


@given(st.integers(0, 2**31), st.floats(0.0, 0.2), st.sampled_from([CMU15, BODY26]))
def test_joints_are_inside_capsules_that_grow_with_what_their_places_may_be_off(
    seed: int, std: float, skeleton: Skeleton
) -> None:
    rng, count = np.random.default_rng(seed), len(skeleton.joints)
    body = STANDING[np.arange(count) % len(STANDING)] + rng.normal(scale=0.1, size=(count, 3))
    person = replace(make_walker(), joints=body, std=np.full(count, std), skeleton=skeleton)
    start, end, radius = compute_capsules(person)
    axis = end - start
    along = np.einsum('jpk,pk->jp', body[:, None] - start, axis) / np.maximum((axis**2).sum(axis=1), 1e-12)
    nearest = start + np.clip(along, 0, 1)[..., None] * axis
    clearance = (radius - np.linalg.norm(body[:, None] - nearest, axis=2)).max(axis=1)
    of_parts = {j for p in list_body_parts(skeleton) for j in (p.start, p.end)}
    held = [j in of_parts for j in skeleton.joints]
    outside = {j for j, is_held in zip(skeleton.joints, held, strict=True) if not is_held}
    assert outside <= {'nose', 'leye', 'reye', 'lear', 'rear'}
    assert (clearance[held] >= 0.05 + 0.2 * std - 1e-9).all()


def test_a_hand_and_a_foot_have_capsules_where_they_are_known() -> None:
    names = {skeleton.name: [p.name for p in list_body_parts(skeleton)] for skeleton in (CMU15, BODY26)}
    assert len(set(names['cmu15'])) == len(names['cmu15']) == 12
    assert set(names['body26']) - set(names['cmu15']) == {'l_hand', 'r_hand', 'l_foot', 'r_foot'}
    assert len(names['body26']) == MAX_PARTS


def test_capsules_of_unknown_deviation_are_as_thick_as_the_body() -> None:
    message = decode(encode_capsules(HEADER, [replace(make_walker(), std=np.full(15, np.nan))]), CAPSULES)
    (person,) = message.people
    parts = list_body_parts(CMU15)
    assert person.radius == pytest.approx([p.half_thickness_m for p in parts])
    assert person.names == [p.name for p in parts]
    assert len(person.start) == len(person.end) == len(parts)


def test_predictions_are_put_out_in_the_frame_of_the_outputs() -> None:
    camera = CameraPlacement('camera', parse_camera_pose('0 0 1.5 0 0 1.57', 'test'))
    covariance = np.diag([0.01, 0.04, 0.09])
    person = replace(make_predicted(), root_covariance=covariance)
    raw = encode_predictions(HEADER, [PredictedFrame(0.2, []), PredictedFrame(0.4, [person])], camera)
    message = decode(raw, PREDICTIONS)
    assert (message.header.frame_id, message.skeleton) == ('map', CMU15.name)
    soon, later = message.times
    assert [soon.ahead, later.ahead] == pytest.approx([0.2, 0.4])
    assert soon.people == []
    (anna,) = later.people
    pose = camera.pose
    assert pose is not None
    np.testing.assert_allclose([xyz(p) for p in anna.joints], pose.apply(person.joints), atol=1e-12)
    np.testing.assert_allclose(xyz(anna.root), pose.apply(person.root), atol=1e-12)
    np.testing.assert_allclose(anna.root_covariance.reshape(3, 3), pose.rotate_covariance(covariance))
    np.testing.assert_allclose(anna.joint_std, 0.1, rtol=1e-6)
    assert anna.id == 'anna'
    driving = camera._replace(before=parse_camera_pose('-0.1 0 1.5 0 0 1.57', 'test'), step_s=0.1)
    raw = encode_predictions(HEADER, [PredictedFrame(0.4, [person])], driving)
    root = decode(raw, PREDICTIONS).times[0].people[0].root
    np.testing.assert_allclose(np.array(xyz(root)) - xyz(anna.root), [0.4, 0, 0], atol=1e-9)  # at 1 m/s along x


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'node.prediction_times': ''}, r"node\.prediction_times = '': expected one to 20 times in s"),
        ({'node.prediction_times': '0.2 1.5'}, r'up to 1, separated'),
        ({'node.prediction_times': '0.2 soon'}, r'such as 0\.2 0\.4'),
        ({'node.prediction_times': '0.2 nan'}, r'above 0'),
        ({'node.prediction_times': '0.1 ' * 21}, r'one to 20'),
        ({'tracker.lag': 0.2}, r'node\.publish_predict\w+: needs tracker\.lag = 0'),
    ],
)
def test_wrong_prediction_times_are_refused_only_where_they_are_used(
    values: dict[str, object], message: str
) -> None:
    assert read_prediction_times(with_values(Config(), values)) == ()
    for switch in ('node.publish_predictions', 'node.publish_prediction_markers'):
        with pytest.raises(ConfigError, match=message):
            read_prediction_times(with_values(Config(), {**values, switch: True}))


def test_collision_objects_hold_the_capsules_and_leave_the_scene_with_the_person() -> None:
    encoder, person = CollisionObjectEncoder(), make_walker()
    (added,) = (decode(raw, COLLISION_OBJECT) for raw in encoder.encode_update(HEADER, [person]))
    assert (added.id, added.operation, added.header.frame_id) == ('person_anna', ADD, 'map')
    capsules = compute_capsules(person)
    for shape, pose, start, end, radius in zip(added.primitives, added.primitive_poses, *capsules, strict=True):
        height, cylinder_radius = shape.dimensions
        assert (shape.type, cylinder_radius) == (shape.CYLINDER, radius)
        q = pose.orientation
        z_axis = np.array([2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)])
        top = np.array(xyz(pose.position)) + z_axis * (height / 2 - radius)
        np.testing.assert_allclose(top, end, atol=1e-9)
        assert height == pytest.approx(np.linalg.norm(end - start) + 2 * radius)
    (moved, new) = (decode(raw, COLLISION_OBJECT) for raw in encoder.encode_update(HEADER, [make_walker('bob')]))
    assert [(m.id, m.operation) for m in (moved, new)] == [('person_anna', REMOVE), ('person_bob', ADD)]
    (removed,) = (decode(raw, COLLISION_OBJECT) for raw in encoder.encode_clear(HEADER))
    assert (removed.id, removed.operation, removed.primitives) == ('person_bob', REMOVE, [])
    assert encoder.encode_clear(HEADER) == []


def flatten(value: Any) -> Any:
    """Return a decoded message as nested lists of its fields, whichever decoder it comes from."""
    if isinstance(value, (str, bool, int, float, np.generic)):
        return str(float(value)) if isinstance(value, (float, np.floating)) else str(value)
    if isinstance(value, (bytes, list, tuple, np.ndarray)):
        return [flatten(v) for v in value]
    names = [
        n for n in getattr(value, '__slots__', None) or vars(value) if not n.startswith('_') and not n.isupper()
    ]
    return [flatten(getattr(value, name)) for name in names]


@pytest.mark.parametrize('msgtype', [*ENCODERS])
def test_an_independent_decoder_reads_the_same(msgtype: str) -> None:
    people = [make_walker('anna ä'), replace(make_walker('bob'), std=np.full(15, np.nan), predicted=True)]
    raw = ENCODERS[msgtype](HEADER, people)
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    decoders = generate_dynamic(msgtype.replace('/msg/', '/'), text)
    read = decoders.get(msgtype) or decoders[msgtype.replace('/msg/', '/')]
    assert flatten(read(raw)) == flatten(decode(raw, msgtype))


def show(
    encoder: OutputEncoder, topic: str, people: Sequence[Person3D], header: Header = HEADER
) -> dict[Any, Any]:
    """Return the markers of a topic by namespace and number."""
    node = with_values(Config(), {f'node.publish_{topic}': True}).node
    ahead = [PredictedFrame(t, [make_predicted(p.id) for p in people]) for t in (0.25, 1.0)]
    outputs = encoder.encode(header, people, node, predicted=ahead)
    (raw,) = (o.data for o in outputs if o.topic == topic)
    message = decode(raw, MARKERS)
    assert encode(message, MARKERS) == raw, 'the bytes are those that the library writes'
    assert len({(m.ns, m.id) for m in message.markers}) == len(message.markers)
    return {(m.ns, m.id): m for m in message.markers}


@given(st.text('aä人', max_size=9))
@settings(max_examples=20)
def test_markers_of_capsules_have_their_ends_and_radii(frame_id: str) -> None:
    people = [make_walker('anna'), make_walker('bob', (0.0, 3.0, 1.0))]
    markers = show(OutputEncoder(), 'capsule_markers', people, Header(7, frame_id))
    assert len(markers) == 2 * 2 * len(list_body_parts(CMU15))
    for number, person in enumerate(people):
        for part, (start, end, radius) in enumerate(zip(*compute_capsules(person), strict=True)):
            ball, rod = (markers[ns, number * MAX_PARTS + part] for ns in ('ends', 'cylinders'))
            np.testing.assert_array_equal([xyz(p) for p in ball.points], [start, end])
            np.testing.assert_allclose(xyz(ball.scale), 2 * radius)
            np.testing.assert_allclose(xyz(rod.scale), [2 * radius, 2 * radius, np.linalg.norm(end - start)])
            np.testing.assert_allclose(xyz(rod.pose.position), (start + end) / 2)
            assert (ball.header.frame_id, rod.header.frame_id, ball.pose.orientation.w) == (frame_id, frame_id, 1)
            assert 0 < rod.color.a < 1


def test_ghosts_stand_where_people_will_be_and_are_paler_the_later() -> None:
    encoder = OutputEncoder()
    markers = show(encoder, 'prediction_markers', [make_walker()])
    assert set(markers) == {('0.25 s', 0), ('1 s', 0)}
    soon, late = markers['0.25 s', 0], markers['1 s', 0]
    ends = make_predicted().joints[np.array(CMU15.bone_ends).T.ravel()]
    np.testing.assert_array_equal([xyz(p) for p in soon.points], ends)
    assert 0 < late.color.a < soon.color.a < 1
    assert {m.action for m in show(encoder, 'prediction_markers', []).values()} == {DELETE}
    assert show(encoder, 'prediction_markers', []) == {}


def test_shapes_of_people_who_are_gone_are_deleted_and_others_keep_number_and_colour() -> None:
    encoder = OutputEncoder()
    before = show(encoder, 'capsule_markers', [make_walker('anna'), make_walker('bob')])
    after = show(encoder, 'capsule_markers', [make_walker('bob')])
    parts = len(list_body_parts(CMU15))
    assert {key[1] for key, m in after.items() if m.action == DELETE} == set(range(parts))
    assert {key[1] for key, m in after.items() if m.action == ADD_MARKER} == {MAX_PARTS + i for i in range(parts)}
    bob = 'ends', MAX_PARTS
    assert repr(after[bob].color) == repr(before[bob].color) != repr(before['ends', 0].color)
    (skeletons, shapes) = encoder.encode_clear(HEADER)
    assert (skeletons.topic, shapes.topic, len(decode(shapes.data, MARKERS).markers)) == (
        'markers', 'capsule_markers', 1,
    )  # fmt: skip
    assert len(encoder.encode_clear(HEADER)) == 1


def test_a_reset_takes_people_out_of_viewers_and_planning_scenes() -> None:
    node = with_values(Config(), {'node.publish_collision_objects': True}).node
    encoder = OutputEncoder()
    encoder.encode(HEADER, [make_walker('anna'), make_walker('bob')], node)
    markers, *objects = encoder.encode_clear(HEADER)
    assert (markers.topic, [o.topic for o in objects]) == ('markers', ['collision_object'] * 2)
    removed = [decode(o.data, o.type) for o in objects]
    assert [(o.id, o.operation) for o in removed] == [('person_anna', REMOVE), ('person_bob', REMOVE)]
    assert len(encoder.encode_clear(HEADER)) == 1, 'nobody is left'


def test_every_switch_adds_its_topics_and_tentative_people_are_in_none_of_them() -> None:
    tentative = replace(make_walker('nobody'), tentative=True)
    for field, switched in SWITCHED_OUTPUTS.items():
        node = with_values(Config(), {f'node.{field}': True}).node
        outputs = OutputEncoder().encode(
            HEADER, [make_walker(), tentative], node, predicted=[PredictedFrame(0.4, [make_predicted()])]
        )
        added = {o.topic: o.type for o in outputs if o.topic not in OUTPUTS}
        own = {topic: kind for topic, kind in added.items() if '/anna/' not in topic}  # those of a body besides
        assert own == {switched.topic: switched.type}
        for output in outputs:
            if output.topic in added:
                assert b'anna' in output.data or output.type in (OBSTACLES, POSES, MARKERS)
                assert b'nobody' not in output.data
                assert decode(output.data, output.type)
    assert [o.topic for o in OutputEncoder().encode(HEADER, [make_walker()])] == list(OUTPUTS)
