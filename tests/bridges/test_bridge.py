# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for robots: what they say of people in known poses, and that an independent decoder reads the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.bridges.bridge import CONSUMERS, Bridge, check_consumers
from mocap_ros.bridges.capsules import MAX_PARTS, compute_capsules, list_body_parts
from mocap_ros.bridges.collision_objects import ADD, REMOVE
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage, decode, encode
from mocap_ros.messages.markers import DELETE
from mocap_ros.messages.skeletons import (
    PREDICTIONS,
    SKELETONS,
    PredictedFrame,
    encode_predictions,
    encode_skeletons,
)
from mocap_ros.people import Person3D, PredictedPerson
from mocap_ros.skeleton import BODY26, CMU15, Skeleton
from tests.support.people import make_person_3d
from tests.support.swinging_body import STANDING

HEADER = Header(12_345_678_901, 'map')


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


def feed(bridge: Bridge, people: Sequence[Person3D], header: Header = HEADER) -> list[OutputMessage]:
    """Return what a bridge makes of people and of where they will be."""
    certain = [p for p in people if not p.tentative]
    ahead = [PredictedFrame(t, [make_predicted(p.id) for p in certain]) for t in (0.25, 1.0)]
    predictions = encode_predictions(header, ahead, CameraPlacement(header.frame_id))
    return bridge.feed_skeletons(encode_skeletons(header, people)) + bridge.feed_predictions(predictions)


def convert(name: str, *people: Person3D) -> Any:
    """Return the only message for a consumer."""
    (output,) = feed(Bridge([name]), people)
    assert (output.topic, output.type, output.stamp_ns) == (*CONSUMERS[name][:2], HEADER.stamp_ns)
    return decode(output.data, output.type)


def test_people_for_costmaps() -> None:
    lost = replace(
        make_walker('bob', (5, 0, 0)), predicted=True, unseen_for=0.5, velocity=np.full((15, 3), np.nan)
    )
    message = convert('people', make_walker(), lost)
    assert (message.header.frame_id, message.header.stamp.nanosec) == ('map', 345_678_901)
    anna, bob = message.people
    assert xyz(anna.position) == pytest.approx(make_walker().root)
    assert xyz(anna.velocity) == [0, 1, 0]
    assert (anna.name, anna.reliability, anna.tagnames, anna.tags) == ('anna', 1.0, ['predicted'], ['false'])
    assert xyz(bob.velocity) == [0, 0, 0]  # unknown; planners take no NaN
    assert (bob.reliability, bob.tags) == (pytest.approx(np.exp(-0.5)), ['true'])


def test_detections_hold_pose_covariance_and_box() -> None:
    person = make_walker()
    (found,) = convert('detections', person).detections
    (result,) = found.results
    assert (found.id, result.hypothesis.class_id, result.hypothesis.score) == ('anna', 'person', 1.0)
    covariance = result.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(covariance[:3, :3], person.root_covariance)
    hips = person.joints[[CMU15.index('lhip'), CMU15.index('rhip')]]
    breadth = np.linalg.norm(hips[0] - hips[1])
    np.testing.assert_allclose(covariance[3:, 3:], np.eye(3) * 4 / 3 * (0.03 / breadth) ** 2, rtol=1e-6)
    low, high = (
        np.array(xyz(found.bbox.center.position)) + s * np.array(xyz(found.bbox.size)) / 2 for s in (-1, 1)
    )
    assert (low + 0.09 < person.joints).all()
    assert (high - 0.09 > person.joints).all()
    unknown = replace(person, std=np.full(15, np.nan))
    (found,) = convert('detections', unknown).detections
    np.testing.assert_allclose(found.results[0].pose.covariance[-1], np.pi**2 / 3)


def test_obstacles_have_ids_that_stay() -> None:
    people = [make_walker(), make_walker('bob')]
    one, other = (convert('obstacles', *p).obstacles for p in (people, people[::-1]))
    assert one[0].uuid.uuid.tolist() == other[1].uuid.uuid.tolist() != one[1].uuid.uuid.tolist()
    assert xyz(one[0].velocity) == [0, 1, 0]
    assert xyz(one[0].size)[2] == pytest.approx(np.ptp(STANDING[:, 2]) + 0.2)


def test_poses_face_ahead() -> None:
    person = make_walker()
    (pose,) = convert('poses', person).poses
    assert xyz(pose.position) == pytest.approx(person.root)
    q = pose.orientation
    left = person.joints[CMU15.index('lhip')] - person.joints[CMU15.index('rhip')]
    y_axis = np.array([2 * (q.x * q.y - q.w * q.z), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z + q.w * q.x)])
    assert y_axis @ left / np.linalg.norm(left) == pytest.approx(1, abs=1e-3)


@given(st.integers(0, 2**31), st.floats(0.0, 0.2), st.sampled_from([CMU15, BODY26]))
def test_joints_are_inside_capsules_that_grow_with_the_deviation_of_the_joints(
    seed: int, std: float, skeleton: Skeleton
) -> None:
    rng, count = np.random.default_rng(seed), len(skeleton.joints)
    body = STANDING[np.arange(count) % len(STANDING)] + rng.normal(scale=0.1, size=(count, 3))
    person = replace(make_walker(), joints=body, std=np.full(count, std), skeleton=skeleton)
    start, end, radius = compute_capsules(body, person.std, skeleton)
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
    *_, radius = compute_capsules(STANDING, np.full(15, np.nan), CMU15)  # as thick as the body
    assert radius == pytest.approx([p.half_thickness_m for p in list_body_parts(CMU15)])


def test_collision_objects_hold_the_capsules_and_leave_the_scene_with_the_person() -> None:
    bridge, person = Bridge(['collision_objects']), make_walker()

    def show(*people: Person3D) -> list[Any]:
        return [decode(o.data, o.type) for o in feed(bridge, people)]

    (added,) = show(person)
    assert (added.id, added.operation, added.header.frame_id) == ('person_anna', ADD, 'map')
    capsules = compute_capsules(person.joints, person.std.astype(np.float32), CMU15)
    for shape, pose, start, end, radius in zip(added.primitives, added.primitive_poses, *capsules, strict=True):
        height, cylinder_radius = shape.dimensions
        assert (shape.type, cylinder_radius) == (shape.CYLINDER, pytest.approx(radius))
        q = pose.orientation
        z_axis = np.array([2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)])
        top = np.array(xyz(pose.position)) + z_axis * (height / 2 - radius)
        np.testing.assert_allclose(top, end, atol=1e-9)
        assert height == pytest.approx(np.linalg.norm(end - start) + 2 * radius)
    (moved, new) = show(make_walker('bob'))
    assert [(m.id, m.operation) for m in (moved, new)] == [('person_anna', REMOVE), ('person_bob', ADD)]
    (removed,) = (decode(o.data, o.type) for o in bridge.clear())
    assert (removed.id, removed.operation, removed.primitives) == ('person_bob', REMOVE, [])
    assert bridge.clear() == []


def show_markers(bridge: Bridge, people: Sequence[Person3D], header: Header = HEADER) -> dict[Any, Any]:
    """Return the markers of the only topic of a bridge by namespace and number."""
    (output,) = feed(bridge, people, header)
    message = decode(output.data, output.type)
    assert len({(m.ns, m.id) for m in message.markers}) == len(message.markers)
    return {(m.ns, m.id): m for m in message.markers}


def test_markers_of_capsules_have_their_ends_and_radii() -> None:
    frame_id = 'aä人'
    people = [make_walker('anna'), make_walker('bob', (0.0, 3.0, 1.0))]
    markers = show_markers(Bridge(['capsule_markers']), people, Header(7, frame_id))
    assert len(markers) == 2 * 2 * len(list_body_parts(CMU15))
    for number, person in enumerate(people):
        for part, (start, end, radius) in enumerate(
            zip(*compute_capsules(person.joints, person.std.astype(np.float32), CMU15), strict=True)
        ):
            ball, rod = (markers[ns, number * MAX_PARTS + part] for ns in ('ends', 'cylinders'))
            np.testing.assert_array_equal([xyz(p) for p in ball.points], [start, end])
            np.testing.assert_allclose(xyz(ball.scale), 2 * radius)
            np.testing.assert_allclose(xyz(rod.scale), [2 * radius, 2 * radius, np.linalg.norm(end - start)])
            np.testing.assert_allclose(xyz(rod.pose.position), (start + end) / 2)
            assert (ball.header.frame_id, rod.header.frame_id, ball.pose.orientation.w) == (frame_id, frame_id, 1)
            assert 0 < rod.color.a < 1


def test_ghosts_stand_where_people_will_be_and_are_paler_the_later() -> None:
    bridge = Bridge(['prediction_markers'])
    markers = show_markers(bridge, [make_walker()])
    assert set(markers) == {('0.25 s', 0), ('1 s', 0)}
    soon, late = markers['0.25 s', 0], markers['1 s', 0]
    ends = make_predicted().joints[np.array(CMU15.bone_ends).T.ravel()]
    np.testing.assert_array_equal([xyz(p) for p in soon.points], ends)
    assert 0 < late.color.a < soon.color.a < 1
    assert {m.action for m in show_markers(bridge, []).values()} == {DELETE}
    assert show_markers(bridge, []) == {}


def test_people_who_are_tentative_are_in_none_of_the_messages() -> None:
    tentative = replace(make_walker('ghost'), tentative=True)
    outputs = feed(Bridge([*CONSUMERS]), [tentative, make_walker()])
    assert {c.topic for c in CONSUMERS.values()} <= {o.topic for o in outputs}
    assert all(b'ghost' not in o.data for o in outputs)
    alone = feed(Bridge([*CONSUMERS]), [tentative])
    assert all(b'anna' not in o.data and b'ghost' not in o.data for o in alone)


@pytest.mark.parametrize(('names', 'message'), [([], 'publish: '), (['people', 'peple'], "publish: .*'peple'")])
def test_unknown_consumers_are_named(names: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_consumers(names)
    assert check_consumers(['poses', 'people', 'poses']) == ['poses', 'people']


@pytest.mark.parametrize(
    ('field', 'value', 'message'),
    [
        ('skeleton', 'body7', r'people\[0\]\.skeleton: .*body7'),
        ('joints', [], r'people\[0\]: 0 joints, 15 joint_std; expected 15'),
        ('joint_std', np.zeros(3, np.float32), r'people\[0\]: 15 joints, 3 joint_std; expected 15'),
    ],
)
def test_skeletons_that_cannot_be_used_are_refused(field: str, value: Any, message: str) -> None:
    skeletons = decode(encode_skeletons(HEADER, [make_walker()]), SKELETONS)
    setattr(skeletons.people[0], field, value)
    bridge = Bridge(['people'])
    with pytest.raises(InputError, match=message):
        bridge.feed_skeletons(encode(skeletons, SKELETONS))
    with pytest.raises(InputError, match='not a mocap_ros_msgs'):
        bridge.feed_skeletons(b'no message')
    assert len(feed(bridge, [make_walker()])) == 1, 'the next one is used'


@pytest.mark.parametrize(
    ('ahead', 'first_x', 'count', 'message'),
    [
        (0.0, 0.0, 15, r'times\[0\]\.ahead: 0 s, expected more than 0'),
        (np.nan, 0.0, 15, r'times\[0\]\.ahead: nan s'),
        (0.25, np.nan, 15, r'times\[0\]: joints that are not finite'),
        (0.25, 0.0, 14, r'times\[0\]: people with other than 15 joints'),
    ],
)
def test_predictions_that_cannot_be_used_are_refused(
    ahead: float, first_x: float, count: int, message: str
) -> None:
    frames = [PredictedFrame(0.25, [make_predicted()])]
    predictions = decode(encode_predictions(HEADER, frames, CameraPlacement('camera')), PREDICTIONS)
    (then,) = predictions.times
    (person,) = then.people
    then.ahead, person.joints = ahead, person.joints[:count]
    person.joints[0].x = first_x
    with pytest.raises(InputError, match=message):
        Bridge(['prediction_markers']).feed_predictions(encode(predictions, PREDICTIONS))
