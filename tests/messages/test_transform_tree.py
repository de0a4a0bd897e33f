# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The place of a camera from /tf and /tf_static: chains, times between two messages, and what must not count."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.transform_tree import HISTORY_S, MAX_FRAMES, TransformTree, is_of_people_only
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from tests.support.camera_infos import SECOND_NS, make_transforms
from tests.support.message_objects import encode
from tests.support.people import make_standing_person

CAMERA = np.array([0.1, 0.0, 0.4])  # m, of the camera in base
TURN = Rotation.from_euler('z', 90, degrees=True)  # of odom in map


def make_tree() -> TransformTree:
    """Return map -> odom (static, turned) -> base (drives along x at 1 m/s) -> camera, and map -> dock."""
    tree = TransformTree()
    tree.add(
        make_transforms(('map', 'odom', 0, (5, 0, 0), TURN.as_quat()), ('map', 'dock', 0, (0, 7, 0))),
        is_static=True,
    )
    tree.add(make_transforms(('base', 'camera', 0, CAMERA)), is_static=True)
    for tenth in range(11):
        tree.add(make_transforms(('odom', 'base', tenth * SECOND_NS // 10, (tenth / 10, 0, 0))), is_static=False)
    return tree


@given(st.integers(0, SECOND_NS))
def test_a_moving_camera_is_where_it_was_at_the_time_of_the_image(stamp_ns: int) -> None:
    x = stamp_ns / SECOND_NS
    found = make_tree().find('map', 'camera', stamp_ns, 0.0)
    np.testing.assert_allclose(found.translation, [5, x + 0.1, 0.4], atol=1e-9)
    np.testing.assert_allclose(found.rotation, TURN.as_matrix(), atol=1e-9)


def test_the_way_leads_up_and_down_and_slashes_of_old_names_do_not_count() -> None:
    found = make_tree().find('/dock', '/base', SECOND_NS // 2, 0.0)
    np.testing.assert_allclose(found.translation, [5, 0.5 - 7, 0], atol=1e-9)
    assert make_tree().find('odom', 'odom', 7, 0.0).translation.tolist() == [0, 0, 0]


def test_an_image_after_the_newest_transform_is_placed_only_within_the_tolerance() -> None:
    tree = make_tree()
    late_ns = SECOND_NS + SECOND_NS // 20
    np.testing.assert_allclose(tree.find('odom', 'base', late_ns, 0.1).translation, [1, 0, 0])
    with pytest.raises(InputError, match=r'the newest transform of base is 0\.05 s older than the image'):
        tree.find('odom', 'base', late_ns, 0.04)
    with pytest.raises(InputError, match=r'the oldest transform of base is 0\.20 s newer than the image'):
        tree.find('odom', 'base', -SECOND_NS // 5, 0.1)


def test_frames_without_a_way_between_them_are_named() -> None:
    tree = make_tree()
    tree.add(make_transforms(('other', 'arm', 0, (0, 0, 0))), is_static=True)
    with pytest.raises(InputError, match="from 'camera' to 'arm': they are not connected"):
        tree.find('arm', 'camera', 0, 0.0)
    with pytest.raises(InputError, match="from 'eye' to 'map': no transform names 'eye'"):
        tree.find('map', 'eye', 0, 0.0)


def test_old_transforms_are_forgotten_and_time_that_goes_back_begins_anew() -> None:
    tree = make_tree()
    later_ns = round((HISTORY_S + 1.5) * SECOND_NS)
    tree.add(make_transforms(('odom', 'base', later_ns, (9, 0, 0))), is_static=False)
    with pytest.raises(InputError, match='oldest'):
        tree.find('odom', 'base', SECOND_NS // 2, 0.0)
    tree.add(make_transforms(('odom', 'base', 5, (2, 0, 0))), is_static=False)
    np.testing.assert_allclose(tree.find('odom', 'base', 5, 0.0).translation, [2, 0, 0])


@pytest.mark.parametrize(
    ('transform', 'message'),
    [
        (('map', '', 0, (0, 0, 0)), r"transforms\[1\]: child_frame_id '' in header.frame_id 'map'"),
        (('map', '/map', 0, (0, 0, 0)), r"transforms\[1\]: child_frame_id 'map' in header.frame_id 'map'"),
        (('map', 'b', -SECOND_NS, (0, 0, 0)), r'transforms\[1\]: header.stamp: -1 s'),
        (('map', 'b', 0, (0, np.inf, 0)), r'transforms\[1\]: .*not finite'),
        (('map', 'b', 0, (0, 0, 0), (0, 0, 0, 0)), r'transforms\[1\]: .*unit length'),
    ],
)
def test_a_message_with_an_invalid_transform_adds_nothing(transform: Any, message: str) -> None:
    tree = TransformTree()
    with pytest.raises(InputError, match=message):
        tree.add(make_transforms(('map', 'good', 0, (0, 0, 0)), transform), is_static=False)
    assert not tree._links


def test_names_that_never_end_fill_no_memory() -> None:
    tree = TransformTree()
    for second in range(0, 60, 20):  # people who come and go
        names = [f'body_{second}_{i}' for i in range(MAX_FRAMES // 2)]
        tree.add(make_transforms(*(('map', n, second * SECOND_NS, (0, 0, 0)) for n in names)), is_static=False)
    with pytest.raises(InputError, match=f'more than {MAX_FRAMES} frames'):
        tree.add(make_transforms(*(('map', f'c{i}', 0, (0, 0, 0)) for i in range(MAX_FRAMES + 1))), is_static=True)


def test_transforms_of_people_are_known_by_their_names() -> None:
    people = [make_standing_person(i) for i in ('anna', 'b/ob')]
    own = encode_transforms(Header(1, 'camera'), people, 'left_')
    assert is_of_people_only(own, 'left_')
    assert not is_of_people_only(own, '')
    nobody = encode_transforms(Header(1, 'camera'), [])
    assert is_of_people_only(nobody, 'left_')
    world = encode_transforms(Header(1, 'camera'), [], 'left_', None, RigidTransform.identity())
    assert is_of_people_only(world, 'left_')
    assert not is_of_people_only(world, '')
    assert not is_of_people_only(nobody[:-1], 'left_')
    message = decode(own, TRANSFORMS)
    message.transforms[3].child_frame_id = 'base'
    assert not is_of_people_only(encode(message, TRANSFORMS), 'left_')
    assert not is_of_people_only(b'no message', '')


@pytest.mark.parametrize('child', ['head_camera', 'torso_lift_link', 'body_camera', 'l_hand_camera'])
def test_frames_of_robots_are_none_of_people_though_their_names_begin_as_those_do(child: str) -> None:
    robot = make_transforms(('base', child, 1, (0, 0, 1)))
    assert not is_of_people_only(robot, '')
    message = decode(encode_transforms(Header(1, 'camera'), [make_standing_person('anna')]), TRANSFORMS)
    message.transforms += decode(robot, TRANSFORMS).transforms
    assert not is_of_people_only(encode(message, TRANSFORMS), '')


def test_a_time_before_a_late_transform_is_that_before_the_newest_of_each_frame() -> None:
    tree = TransformTree()
    for stamp_ns in range(0, SECOND_NS + 1, SECOND_NS // 10):
        seconds = stamp_ns / SECOND_NS
        tree.add(make_transforms(('map', 'odom', stamp_ns // 2, (seconds, 0, 0))), is_static=False)
        tree.add(make_transforms(('odom', 'base', stamp_ns, (0, seconds, 0))), is_static=False)
    image = 'map', 'base', SECOND_NS, 0.5
    np.testing.assert_allclose(tree.find(*image).translation, [1, 1, 0])
    np.testing.assert_allclose(tree.find(*image, 0.2).translation, [1 - 0.4, 1 - 0.2, 0])
    with pytest.raises(InputError, match=r'oldest transform of odom is 0\.10 s newer'):
        tree.find(*image, 0.6)
    with pytest.raises(InputError, match=r'newest transform of base is 0\.80 s older'):
        tree.find('odom', 'base', 2 * SECOND_NS, 0.5, 0.2)
