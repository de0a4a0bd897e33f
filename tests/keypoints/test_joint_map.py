# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint maps use the joints that a detector has and derive the others."""

import numpy as np
import pytest

from mocap_ros.errors import SkeletonError
from mocap_ros.keypoints.joint_map import build_joint_map
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
