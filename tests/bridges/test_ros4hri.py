# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ROS4HRI bodies: joint states and models put the links where the joints are, and name what the REP names."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.bridges.bridge import Bridge
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
from mocap_ros.config import Config, with_values
from mocap_ros.messages.cdr import Header, OutputMessage, decode
from mocap_ros.messages.foreign_types import HRI_IDS
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.messages.transforms import TRANSFORMS, FrameNames
from mocap_ros.people import Person3D
from mocap_ros.runtime.outputs import OutputEncoder
from mocap_ros.skeleton import CMU15
from tests.support.people import make_person_3d
from tests.support.swinging_body import STANDING

MAX_TOPIC_CHARACTERS = 247  # of the name of a topic, more than which the middleware refuses
HEADER = Header(12_345_678_901, 'map')
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
    """Return the joints (15, 3) of a body with some angles."""
    links = place_links(describe_body('x', OWN_LENGTHS), angles, '_x')
    joints = np.array([links[LINK_OF_JOINT[j]] if j in LINK_OF_JOINT else np.zeros(3) for j in CMU15.joints])
    joints[CMU15.index('neck')] = links['torso']
    return joints


def find_angles(joints: np.ndarray) -> dict[str, float]:
    """Return the angles of a single body (15, 3) by the names of the joints."""
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
    return bridge.feed_skeletons(encode_skeletons(HEADER, people))


def test_each_body_has_topics_of_its_own_and_is_described_once() -> None:
    bridge = Bridge(['bodies'])
    anna, ben = (replace(make_person_3d(name), joints=STANDING) for name in ('anna', '7'))
    first, second = show(bridge, anna, ben), show(bridge, anna)
    assert [o.topic for o in first] == [
        TRACKED,
        *(f'/humans/bodies/{i}/urdf' for i in ('anna', 'p7')),
        *(f'/humans/bodies/{i}/joint_states' for i in ('anna', 'p7')),
    ]
    assert [o.topic for o in second] == [TRACKED, '/humans/bodies/anna/joint_states']
    tracked = decode(first[0].data, HRI_IDS)
    assert (tracked.header.frame_id, tracked.ids) == ('map', ['anna', 'p7'])
    state = decode(first[3].data, JOINT_STATES)
    assert state.name == [f'{name}_anna' for name in MOVED_JOINTS]
    np.testing.assert_allclose(state.position, list(find_angles(STANDING).values()))
    assert (len(state.velocity), len(state.effort), state.header.frame_id) == (0, 0, 'body_anna')
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
    people = [replace(make_person_3d(i), joints=STANDING) for i in ('a.b', 'a-b', '7')]
    node = with_values(Config(), {'node.publish_tf': True}).node
    encoder, bridge = OutputEncoder(), Bridge(['bodies'])
    for seen in (people, people[::-1], people[1:]):
        outputs = {o.type: o.data for o in encoder.encode(HEADER, seen, node)}
        tracked, *_ = bridge.feed_skeletons(next(raw for kind, raw in outputs.items() if 'Skeleton3D' in kind))
        frames = [t.child_frame_id for t in decode(outputs[TRANSFORMS], TRANSFORMS).transforms]
        roots = [frame for frame in frames if frame.startswith('body_')]
        assert roots == [f'body_{i}' for i in decode(tracked.data, HRI_IDS).ids]
        assert set(roots) <= {'body_a_b', 'body_a_b_2', 'body_p7'}
        assert len(set(roots)) == len(seen)


def test_topics_of_bodies_are_not_longer_than_the_middleware_allows() -> None:
    people = [replace(make_person_3d(i), joints=STANDING) for i in ('x' * 1000, 'x' * 1001)]
    topics = [m.topic for m in show(Bridge(['bodies']), *people)]
    assert len(set(topics)) == 5
    assert max(map(len, topics)) <= MAX_TOPIC_CHARACTERS
