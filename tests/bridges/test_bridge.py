# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for robots: what they say of people in known poses, and bodies as REP-155 names them."""

import csv
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros import PoseSequence, write
from mocap_ros.bridges.bridge import CONSUMERS, Bridge, check_consumers
from mocap_ros.bridges.capsules import MAX_PARTS, compute_capsules, list_body_parts
from mocap_ros.bridges.collision_objects import ADD, REMOVE
from mocap_ros.bridges.joint_angles import ANGLES, ANGLES_TOPIC, PAST_NS
from mocap_ros.bridges.ros4hri import (
    DESCRIPTION,
    JOINT_STATES,
    JOINTS,
    MOVED_JOINTS,
    TRACKED,
    compute_joint_states,
    describe_body,
    measure_lengths,
)
from mocap_ros.bridges.vmc import Avatar
from mocap_ros.config import Config, with_values
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.vmc import VmcPose, convert_armature
from mocap_ros.geometry.level import build_world
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage, decode
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_POSTURE
from mocap_ros.messages.markers import DELETE
from mocap_ros.messages.skeletons import (
    PREDICTIONS,
    SKELETONS,
    encode_predictions,
    encode_skeletons,
)
from mocap_ros.messages.transforms import TRANSFORMS, FrameNames
from mocap_ros.people import CameraVertical, Person3D, Posture, PredictedPeople
from mocap_ros.runtime.outputs import OutputEncoder
from mocap_ros.skeleton import BODY26, CMU15, Skeleton
from tests.support.bodies import STANDING, gather, make_person_3d, make_standing_person
from tests.support.camera_messages import encode
from tests.support.input_files import make_poses
from tests.support.scenes import INTRINSICS

HEADER = Header(12_345_678_901, 'map')
UNKNOWN = np.full((3, 3), np.nan)


def make_walker(person_id: str = 'anna', shift: tuple[float, float, float] = (2.0, 1.0, 0.0)) -> Person3D:
    """Return a person who stands upright, facing along the x axis or away from it, and moves at 1 m/s along y."""
    return replace(
        make_person_3d(person_id),
        joints=STANDING + shift,
        joint_std=np.full(15, 0.03),
        joint_velocity=np.tile([0.0, 1.0, 0.0], (15, 1)),
        root_covariance=np.diag([0.04, 0.01, 0.02]),
    )


def make_predicted(ahead_s: float, ids: Sequence[str]) -> PredictedPeople:
    """Return where walkers will be in a second, as if that was another time ahead."""
    joints = np.tile(make_walker().joints + [0.0, 1.0, 0.0], (len(ids), 1, 1))
    covariance = np.tile(0.09 * np.eye(3), (len(ids), 1, 1))
    return PredictedPeople(ahead_s, tuple(ids), joints, np.full((len(ids), 15), 0.1), covariance)


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def feed(bridge: Bridge, people: Sequence[Person3D], header: Header = HEADER) -> list[OutputMessage]:
    """Return what a bridge makes of people and of where they will be."""
    ahead = [make_predicted(t, [p.id for p in people if not p.tentative]) for t in (0.25, 1.0)]
    predictions = encode_predictions(header, ahead, CameraPlacement(header.frame_id))
    return bridge.feed_skeletons(encode_skeletons(header, gather(people))) + bridge.feed_predictions(predictions)


def convert(name: str, *people: Person3D) -> Any:
    """Return the only message for a consumer."""
    (output,) = feed(Bridge([name]), people)
    assert (output.topic, output.type, output.stamp_ns) == (*CONSUMERS[name][:2], HEADER.stamp_ns)
    return decode(output.data, output.type)


def test_people_for_costmaps() -> None:
    unknown = np.full((15, 3), np.nan)
    lost = replace(make_walker('bob', (5, 0, 0)), predicted=True, unseen_for=0.5, joint_velocity=unknown)
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
    np.testing.assert_allclose(covariance[3:, 3:], np.eye(3) * 0.4 * (0.03 / breadth) ** 2, rtol=1e-6)
    center, size = (np.array(xyz(v)) for v in (found.bbox.center.position, found.bbox.size))
    assert (np.abs(person.joints - center) < size / 2 - 0.09).all()
    unknown = replace(person, joint_std=np.full(15, np.nan))
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
def test_joints_are_inside_capsules_also_where_the_root_is_off_by_a_deviation(
    seed: int, std: float, skeleton: Skeleton
) -> None:
    rng, count = np.random.default_rng(seed), len(skeleton.joints)
    body = STANDING[np.arange(count) % len(STANDING)] + rng.normal(scale=0.1, size=(count, 3))
    off = rng.normal(scale=0.2, size=3)
    start, end, radius = compute_capsules(body, np.full(count, std), np.outer(off, off), skeleton)
    axis = end - start
    true = body + off
    along = np.einsum('jpk,pk->jp', true[:, None] - start, axis) / np.maximum((axis**2).sum(axis=1), 1e-12)
    nearest = start + np.clip(along, 0, 1)[..., None] * axis
    clearance = (radius - np.linalg.norm(true[:, None] - nearest, axis=2)).max(axis=1)
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
    *_, radius = compute_capsules(STANDING, np.full(15, np.nan), UNKNOWN, CMU15)  # as thick as the body
    assert radius == pytest.approx([p.half_thickness_m for p in list_body_parts(CMU15)])
    *_, wider = compute_capsules(STANDING, np.where(np.array(CMU15.joints) == 'lwrist', 0.3, 0.0), UNKNOWN, CMU15)
    assert [p.end for p, r in zip(list_body_parts(CMU15), wider - radius, strict=True) if r > 0.01] == ['lwrist']


def test_collision_objects_hold_the_capsules_and_leave_the_scene_with_the_person() -> None:
    bridge, person = Bridge(['collision_objects']), make_walker()

    def show(*people: Person3D) -> list[Any]:
        return [decode(o.data, o.type) for o in feed(bridge, people)]

    (added,) = show(person)
    assert (added.id, added.operation, added.header.frame_id) == ('person_anna', ADD, 'map')
    capsules = compute_capsules(person.joints, person.joint_std.astype(np.float32), person.root_covariance, CMU15)
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
            zip(
                *compute_capsules(
                    person.joints, person.joint_std.astype(np.float32), person.root_covariance, CMU15
                ),
                strict=True,
            )
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
    ends = make_predicted(1.0, ['anna']).joints[0, np.array(CMU15.bone_ends).T.ravel()]
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
        ('joints', [], r'people\[0\]: 0 joints, .* cmu15 has 15'),
        ('joint_std', np.zeros(3, np.float32), r'people\[0\]: 15 joints, .* 3 joint_std'),
    ],
)
def test_skeletons_that_cannot_be_used_are_refused(field: str, value: Any, message: str) -> None:
    skeletons = decode(encode_skeletons(HEADER, gather([make_walker()])), SKELETONS)
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
def test_unusable_predictions_are_refused(ahead: float, first_x: float, count: int, message: str) -> None:
    frames = [make_predicted(0.25, ['anna'])]
    predictions = decode(encode_predictions(HEADER, frames, CameraPlacement('camera')), PREDICTIONS)
    (then,) = predictions.times
    (person,) = then.people
    then.ahead, person.joints = ahead, person.joints[:count]
    person.joints[0].x = first_x
    with pytest.raises(InputError, match=message):
        Bridge(['prediction_markers']).feed_predictions(encode(predictions, PREDICTIONS))


MAX_TOPIC_CHARACTERS = 247  # of the name of a topic, more than which the middleware refuses
OWN_LENGTHS = np.array([0.5, 0.25, 0.18, 0.1, 0.3, 0.26, 0.42, 0.4])  # m, in the order of `LENGTHS`
# Joints of REP-155's model, as hri_fullbody and human_description name them.
REP_JOINTS = {
    *('waist', 'r_head', 'y_head', 'p_head'),
    *(f'{s}_{j}' for s in 'lr' for j in ('y_shoulder', 'p_shoulder', 'r_shoulder', 'elbow')),
    *(f'{s}_{j}' for s in 'lr' for j in ('y_hip', 'p_hip', 'r_hip', 'knee')),
}
LINK_OF_JOINT = {j: f'{j[0]}_{j[1:]}' for j in CMU15.joints if j[0] in 'lr'} | {'head': 'head', 'pelvis': 'body'}


def place_links(urdf: str, angles: dict[str, float], suffix: str) -> dict[str, np.ndarray]:
    """Return the origin of each link of a URDF with some angles, by a program that knows only URDF."""
    robot = ET.fromstring(urdf)
    origins, turns = {f'body{suffix}': np.zeros(3)}, {f'body{suffix}': Rotation.identity()}
    waiting = list(robot.findall('joint'))
    while waiting:
        joint = waiting.pop(0)
        parent, child = (str(joint.find(end).get('link')) for end in ('parent', 'child'))  # type: ignore[union-attr]
        if parent not in origins:
            waiting.append(joint)
            continue
        origin = np.array([float(v) for v in joint.find('origin').get('xyz').split()])  # type: ignore[union-attr]
        origins[child] = origins[parent] + turns[parent].apply(origin)
        turn = Rotation.identity()
        if joint.get('type') == 'revolute':
            axis = np.array([float(v) for v in joint.find('axis').get('xyz').split()])  # type: ignore[union-attr]
            turn = Rotation.from_rotvec(axis * angles[str(joint.get('name')).removesuffix(suffix)])
        turns[child] = turns[parent] * turn
    return {name.removesuffix(suffix): origin for name, origin in origins.items()}


def make_body(angles: dict[str, float]) -> np.ndarray:
    links = place_links(describe_body('x', OWN_LENGTHS), angles, '_x')
    joints = np.array([links[LINK_OF_JOINT[j]] if j in LINK_OF_JOINT else np.zeros(3) for j in CMU15.joints])
    joints[CMU15.index('neck')] = links['torso']
    return joints


def find_angles(joints: np.ndarray) -> dict[str, float]:
    (angles,), (is_known,) = compute_joint_states(joints[None])
    assert is_known
    return dict(zip(MOVED_JOINTS, angles.tolist(), strict=True))


def draw_angles(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    drawn = {j.name: float(rng.uniform(*j.limits)) for j in JOINTS if j.axis}
    for side in 'lr':  # of a straight limb, the axis is unknown
        drawn[f'{side}_knee'] = float(rng.uniform(-2.5, -0.1))
        drawn[f'{side}_elbow'] = float(rng.uniform(0.1, 2.5))
        drawn[f'{side}_p_shoulder'] = float(rng.uniform(0.1, 3.0))
    return drawn | {'waist': 0.0, 'y_head': 0.0}


@given(st.integers(0, 2**31))
@settings(max_examples=50)
def test_the_model_puts_the_links_where_the_joints_are(seed: int) -> None:
    body = make_body(draw_angles(seed))
    turn = Rotation.random(random_state=np.random.default_rng(seed))
    turned = turn.apply(body) + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(make_body(find_angles(turned)), body, atol=1e-6)
    (lengths,) = measure_lengths(turned[None])
    np.testing.assert_allclose(lengths, OWN_LENGTHS, atol=1e-3)
    many, _ = compute_joint_states(np.stack([STANDING, turned]))
    np.testing.assert_allclose(many[1], [*find_angles(turned).values()], atol=1e-12)


def test_angles_of_well_known_poses() -> None:
    zero = find_angles(make_body(dict.fromkeys(MOVED_JOINTS, 0.0)))
    assert zero == pytest.approx(dict.fromkeys(MOVED_JOINTS, 0.0), abs=1e-6)
    raised = make_body(dict.fromkeys(MOVED_JOINTS, 0.0) | {'l_p_shoulder': np.pi / 2, 'r_knee': -np.pi / 2})
    left, right = (raised[CMU15.index(j)] for j in ('lelbow', 'rankle'))
    assert left[1] > 0.4, 'the left arm is held out to the left'
    assert right[0] < -0.3, 'the right shin is bent backwards'
    angles = find_angles(raised)
    assert angles['l_p_shoulder'] == pytest.approx(np.pi / 2, abs=1e-6)
    assert angles['r_knee'] == pytest.approx(-np.pi / 2, abs=1e-6)


def test_the_model_has_the_joints_of_the_rep_and_the_frames_that_are_on_tf() -> None:
    assert set(MOVED_JOINTS) == REP_JOINTS
    robot = ET.fromstring(describe_body('anna', OWN_LENGTHS))
    links = {link.get('name') for link in robot.findall('link')}
    assert {'body_anna', 'torso_anna', 'head_anna', 'l_wrist_anna', 'r_ankle_anna'} <= links
    children = [j.find('child').get('link') for j in robot.findall('joint')]  # type: ignore[union-attr]
    assert len(set(children)) == len(children) == len(links) - 1, 'a tree'


def show(bridge: Bridge, *people: Person3D) -> list[OutputMessage]:
    return bridge.feed_skeletons(encode_skeletons(HEADER, gather(people)))


def test_each_body_has_topics_of_its_own_and_is_described_once() -> None:
    bridge = Bridge(['bodies'])
    anna, ben = map(make_standing_person, ('anna', '7'))
    anna = replace(anna, posture=Posture.LYING)
    first, second = show(bridge, anna, ben), show(bridge, anna)
    assert [o.topic for o in first] == [
        TRACKED,
        *(f'/humans/bodies/{i}/urdf' for i in ('anna', 'p7')),
        *(f'/humans/bodies/{i}/{topic}' for i in ('anna', 'p7') for topic in ('joint_states', 'posture')),
    ]
    assert [o.topic for o in second] == [
        TRACKED,
        *(f'/humans/bodies/anna/{t}' for t in ('joint_states', 'posture')),
    ]
    tracked = decode(first[0].data, HRI_IDS)
    assert (tracked.header.frame_id, tracked.ids) == ('map', ['anna', 'p7'])
    state = decode(first[3].data, JOINT_STATES)
    assert state.name == [f'{name}_anna' for name in MOVED_JOINTS]
    np.testing.assert_allclose(state.position, list(find_angles(STANDING).values()))
    assert (len(state.velocity), len(state.effort), state.header.frame_id) == (0, 0, 'body_anna')
    posture = decode(first[4].data, HRI_POSTURE)
    assert (posture.header.frame_id, posture.posture) == ('map', 4), 'LAYING'
    assert 'l_elbow_p7' in decode(first[2].data, DESCRIPTION).data
    grown = replace(anna, joints=STANDING * 1.2)
    assert '/humans/bodies/anna/urdf' in [o.topic for o in show(bridge, grown)]
    (cleared,) = bridge.clear()
    assert decode(cleared.data, HRI_IDS).ids == []
    assert bridge.clear() == []


def test_a_body_without_a_trunk_is_left_out() -> None:
    flat = replace(make_person_3d('flat'), joints=np.zeros((15, 3)))
    assert [o.topic for o in show(Bridge(['bodies']), flat)] == [TRACKED]


@given(st.lists(st.lists(st.text('a.-_2é', min_size=1, max_size=3), unique=True, max_size=6), max_size=6))
def test_two_people_never_have_one_name_nor_change_it_while_present(frames: list[list[str]]) -> None:
    names, before = FrameNames(), dict[str, str]()
    for ids in frames:
        assigned = names.assign(ids)
        assert set(assigned) == set(ids)
        assert len(set(assigned.values())) == len(ids)
        assert all(assigned[i] == before[i] for i in ids if i in before)
        before = assigned


def test_people_whose_ids_make_one_name_are_two_bodies_with_the_same_names_on_tf() -> None:
    people = [*map(make_standing_person, ('a.b', 'a-b', '7'))]
    node = with_values(Config(), {'node.publish_tf': True}).node
    encoder, bridge = OutputEncoder(), Bridge(['bodies'])
    for seen in (people, people[::-1], people[1:]):
        outputs = {o.type: o.data for o in encoder.encode(HEADER, gather(seen), node)}
        tracked, *_ = bridge.feed_skeletons(next(raw for kind, raw in outputs.items() if 'Skeleton3D' in kind))
        frames = [t.child_frame_id for t in decode(outputs[TRANSFORMS], TRANSFORMS).transforms]
        roots = [frame for frame in frames if frame.startswith('body_')]
        assert roots == [f'body_{i}' for i in decode(tracked.data, HRI_IDS).ids]
        assert set(roots) <= {'body_a_b', 'body_a_b_2', 'body_p7'}
        assert len(set(roots)) == len(seen)


def test_topics_of_bodies_are_not_longer_than_the_middleware_allows() -> None:
    people = [make_standing_person('x' * length) for length in (1000, 1001)]
    topics = [m.topic for m in show(Bridge(['bodies']), *people)]
    assert len(set(topics)) == 7
    assert max(map(len, topics)) <= MAX_TOPIC_CHARACTERS


TO_OPTICAL = np.diag([-1.0, -1.0, 1.0])  # from the axes of animation: x left, y up, z ahead
TO_ROBOT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x ahead, y left, z up


@pytest.mark.parametrize('frame', [TO_OPTICAL, TO_ROBOT], ids=['optical', 'robot'])
def test_an_avatar_turns_as_the_bvh_and_stands_on_the_floor(frame: np.ndarray) -> None:
    poses = make_poses()[:10]
    expected = list(convert_armature(build_armature(poses, 30.0)))
    sent: list[tuple[VmcPose, float]] = []
    bridge = Bridge([], Avatar(lambda pose, time_s: sent.append((pose, time_s))))
    for number, joints in enumerate(poses):
        person = replace(make_person_3d('ann'), joints=joints @ frame.T)
        header = Header((number + 1) * 10**8, 'frame')
        vertical = CameraVertical(frame[:, 1], 0.05)
        bridge.feed_skeletons(encode_skeletons(header, gather([person]), vertical=vertical))
    lowest = np.minimum.accumulate(poses[..., 1].min(axis=1))
    hips, own = [pose.quaternions[0] for pose, _ in sent], [pose.quaternions[0] for pose in expected]
    assert Rotation.from_quat(hips[0]).apply([0, 0, 1]) @ [0, 0, 1] > 0.9, 'looks ahead first'
    assert sent[0][0].positions[0, [0, 2]] == pytest.approx([0, 0], abs=1e-6)
    for number, (pose, time_s) in enumerate(sent):
        assert time_s == pytest.approx(number / 10)
        same = np.abs((pose.quaternions * expected[number].quaternions).sum(axis=1))[1:]
        assert same == pytest.approx(np.ones(len(same)), abs=1e-6)
        turns = [(Rotation.from_quat(q[0]).inv() * Rotation.from_quat(q[number])).as_matrix() for q in (hips, own)]
        assert turns[0] == pytest.approx(turns[1], abs=1e-5)
        assert pose.positions[0, 1] == pytest.approx(expected[number].positions[0, 1] - lowest[number], abs=1e-4)
    assert len(sent) == 10


def read_angles(path: Path, joints: np.ndarray, times: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Return the angles (F, A) in rad of the table that a result becomes."""
    unseen, residual = np.zeros(joints.shape[:2], bool), np.zeros(len(times))
    result = PoseSequence('ann', times, CMU15, joints, unseen, residual, INTRINSICS, world_from_camera=world)
    write(path, result)
    with path.open(newline='') as file:
        rows = [*csv.DictReader(file)]
    return np.radians([[float(row[f'{name}_deg']) for name in ANGLES] for row in rows])


def test_live_angles_are_those_of_the_table_of_the_same_skeletons(tmp_path: Path) -> None:
    joints, upward = make_poses(), np.array([0.0, 0.0, 1.0])
    times = np.arange(len(joints)) / 30
    world, vertical = build_world(joints[:1], upward, None), CameraVertical(upward, 0.05)
    bridge, live = Bridge(['joint_angles']), []
    for now, time_s in zip(joints, times, strict=True):
        header = Header(round(time_s * 1e9), 'camera')
        person = replace(make_person_3d('7'), joints=now)
        (output,) = bridge.feed_skeletons(encode_skeletons(header, gather([person]), vertical=vertical))
        state = decode(output.data, JOINT_STATES)
        assert (output.topic, output.type, state.header.frame_id) == (ANGLES_TOPIC, JOINT_STATES, 'body_p7')
        assert tuple(state.name) == ANGLES
        live.append(state.position)
    found = np.array(live)
    first = read_angles(tmp_path / 'x.angles.csv', joints[:1], times[:1], world)
    heading = ANGLES.index('pelvis_rotation')  # which a table counts from the mean of the first frames
    found[:, heading] += first[0, heading] - found[0, heading]
    for frame in (0, 10, 25, 39):
        past = (times <= times[frame]) & (times > times[frame] - PAST_NS / 1e9)
        expected = read_angles(tmp_path / 'x.angles.csv', joints[past], times[past], world)[-1]
        np.testing.assert_allclose(found[frame], expected, atol=1e-6)
    whole = read_angles(tmp_path / 'x.angles.csv', joints, times, world)
    off = (found - whole + np.pi) % (2 * np.pi) - np.pi
    for limb in (f'{name}_{side}' for name in ('knee_angle', 'elbow_flex') for side in 'lr'):
        end = ANGLES.index(limb) + 1
        is_bent = np.minimum(whole[:, end - 1], np.roll(whole[:, end - 1], -1)) > 0.3
        assert is_bent.sum() > 5
        np.testing.assert_allclose(off[is_bent, end - 4 : end], 0, atol=1e-6)
