# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that a detector lacks, keypoints that are faulty or not seen, and the size of the image."""

import numpy as np
import pytest

from mocap_ros.errors import SkeletonError
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.validation import find_first_fault, mark_unseen
from mocap_ros.skeleton import CMU15, LAYOUT_NAMES, keypoint_layout


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_every_layout_gives_all_model_joints(name: str) -> None:
    joints = keypoint_layout(name).joints
    rng = np.random.default_rng(0)
    points, score = build_joint_map(joints).apply(rng.normal(size=(len(joints), 2)), np.ones(len(joints)))
    assert np.isfinite(points).all()
    assert (score > 0).all()


def test_missing_joints_are_derived_in_order_of_precision() -> None:
    joints = keypoint_layout('coco17').joints
    points = np.zeros((len(joints), 2))
    score = np.full(len(joints), 0.8)
    at = {n: joints.index(n) for n in joints}
    points[at['lshoulder']], points[at['rshoulder']] = (10, 100), (-10, 100)
    points[at['lear']], points[at['rear']] = (4, 80), (-4, 80)
    points[at['nose']] = (0, 80)
    mapped, mapped_score = build_joint_map(joints).apply(points, score)
    assert mapped[CMU15.index('neck')] == pytest.approx([0, 100])
    assert mapped[CMU15.index('head')] == pytest.approx([0, 74])
    assert mapped_score[CMU15.index('head')] == pytest.approx(0.4)
    score[at['lear']] = 0
    points[at['leye']] = points[at['reye']] = (0, 82)
    mapped, mapped_score = build_joint_map(joints).apply(points, score)
    assert mapped[CMU15.index('head')] == pytest.approx([0, 100 + 1.2 * (82 - 100)])
    score[at['lshoulder']] = 0
    mapped, mapped_score = build_joint_map(joints).apply(points, score)
    assert np.isnan(mapped[CMU15.index('neck')]).all()
    assert mapped_score[CMU15.index('neck')] == 0


def test_too_few_or_repeated_joints_are_refused() -> None:
    with pytest.raises(SkeletonError, match=r'fewer than four .*; known: head, neck, lshoulder, .*nose'):
        build_joint_map(('nose', 'lear', 'rear'))
    with pytest.raises(SkeletonError, match='repeat'):
        build_joint_map(('lknee', 'left_knee', 'rknee', 'lhip', 'rhip', 'lankle'))


def test_joints_of_mediapipe_are_moved_to_where_motion_capture_has_them() -> None:
    joints = keypoint_layout('mediapipe33').joints
    at = {n: joints.index(n) for n in joints}
    points, score = np.zeros((len(joints), 2)), np.full(len(joints), 0.9)
    points[at['lshoulder']], points[at['rshoulder']] = (40, 0), (-40, 0)  # px, seen from behind, y down
    points[at['lhip']], points[at['rhip']] = (20, 120), (-20, 120)
    points[at['lankle']], points[at['lelbow']] = (20, 300), (50, 60)
    score[at['rshoulder']] = 0.1
    joint_map = build_joint_map(joints)
    mapped, mapped_score = joint_map.apply(points, score)
    px_per_m = 120 / 0.51  # of the trunk
    ankle = mapped[CMU15.index('lankle')] - points[at['lankle']]
    assert ankle / px_per_m == pytest.approx([-0.006, 0.024], abs=0.001), (
        'm: MediaPipe sees it higher and outwards'
    )
    elbow = mapped[CMU15.index('lelbow')] - points[at['lelbow']]
    assert elbow / px_per_m == pytest.approx([0.013, 0.014], abs=0.001), 'm: MediaPipe sees it higher and inwards'
    assert mapped_score[CMU15.index('lankle')] == 0.9, 'the trunk decides nothing about its score'
    assert mapped[CMU15.index('lhip')] == pytest.approx(points[at['lhip']])
    points[at['rhip']], score[at['rhip']] = np.nan, 0
    mapped, mapped_score = joint_map.apply(points, score)
    assert mapped[CMU15.index('lankle')] == pytest.approx(points[at['lankle']]), 'without the trunk as it is'
    assert mapped_score[CMU15.index('lankle')] == 0.9


@pytest.mark.parametrize(
    ('name', 'index', 'value', 'fault'),
    [
        ('points', (3, 1), 1e10, ('y', (3,))),
        ('points', (2, 0), -1e10, ('x', (2,))),
        ('score', (1,), np.inf, ('score', (1,))),
        ('score', (1,), 9.7, None),  # as a SimCC head has them
    ],
)
def test_numbers_that_no_detector_means_are_faults(
    name: str, index: tuple[int, ...], value: float, fault: tuple[str, tuple[int, ...]] | None
) -> None:
    arrays = {'points': np.full((5, 2), 100.0), 'score': np.ones(5)}
    arrays[name][index] = value
    found = find_first_fault(**arrays)
    assert (found and (found.field, found.index)) == fault


@pytest.mark.parametrize('point', [(0, 0), (-1, -1), (np.nan, 5), (5, np.inf)])
def test_what_detectors_write_for_a_point_that_they_do_not_see_is_not_seen_whatever_its_score(
    point: tuple[float, float],
) -> None:
    points, score = mark_unseen(np.array([point, (0.0, 5.0), (5.0, -1.0)]), np.array([0.4, 0.5, 0.6]))
    assert np.isnan(points[0]).all()
    np.testing.assert_array_equal(points[1:], [(0, 5), (5, -1)])
    np.testing.assert_array_equal(score, [0, 0.5, 0.6])


def test_scores_of_a_person_are_divided_by_the_largest_of_those_seen_if_it_exceeds_one() -> None:
    points = np.full((3, 4, 2), 50.0)
    points[2, 3] = 0.0
    given = np.array([[0.2, 0.9, 1.0, np.nan], [0.5, 2.0, 4.0, -1e-4], [0.5, 1.0, 2.0, 8.0]])
    expected = [[0.2, 0.9, 1.0, 0], [0.125, 0.5, 1.0, 0], [0.25, 0.5, 1.0, 0]]
    np.testing.assert_array_equal(mark_unseen(points, given)[1], expected)


STATED, CAMERA, CONFIGURED = (1920, 1080), (640, 480), (1280, 720)


def make_keypoints(*points: tuple[float, float]) -> np.ndarray:
    """Return seen keypoints (1, J, 3) at these places, and one far outside that is not seen."""
    return np.array([[*((x, y, 0.9) for x, y in points), (9000.0, 9000.0, 0.0)]])


def test_the_order_is_message_camera_user_and_then_the_keypoints() -> None:
    keypoints = make_keypoints((2000, 100))
    order = {'stated': STATED, 'camera': CAMERA, 'configured': CONFIGURED}
    for name, size in order.items():
        known = {n: s for n, s in order.items() if list(order).index(n) >= list(order).index(name)}
        assert resolve_image_size(**known, keypoints=keypoints) == size
    assert resolve_image_size(keypoints=keypoints) == (2560, 1440)
    assert resolve_image_size() == UNKNOWN_SIZE


@pytest.mark.parametrize('unknown', [None, (0, 0), (640, 0), (0, 480)])
def test_a_size_without_both_sides_is_unknown(unknown: tuple[int, int] | None) -> None:
    assert resolve_image_size(stated=unknown, camera=unknown, configured=CONFIGURED) == CONFIGURED
    assert resolve_image_size(stated=unknown, camera=unknown, configured=unknown) == UNKNOWN_SIZE


@pytest.mark.parametrize(
    ('point', 'size'),
    [
        ((640, 480), (640, 480)),
        ((641, 10), (1280, 720)),
        ((10, 481), (1280, 720)),
        ((1920, 1080), (1920, 1080)),
        ((8000, 10), (7680, 4320)),
    ],
)
def test_the_smallest_common_size_that_holds_the_seen_keypoints_is_assumed(
    point: tuple[float, float], size: tuple[int, int]
) -> None:
    assert resolve_image_size(keypoints=make_keypoints(point)) == size
