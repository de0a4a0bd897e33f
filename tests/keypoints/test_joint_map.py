"""Joint maps use the joints that a detector has and derive the others."""

import numpy as np
import pytest

from mocap_ros.errors import SkeletonError
from mocap_ros.keypoints.joint_map import build_joint_map, map_to_model_joints
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


def test_a_keypoint_whose_score_reaches_the_least_counts_as_seen() -> None:
    names = CMU15.joints
    score = np.where(np.arange(15) % 2, 0.3, 0.3 - 1e-9)
    points, weight = map_to_model_joints(np.full((15, 2), 7.0), score, names, min_score=0.3)
    is_seen = np.arange(15) % 2 == 1
    assert weight.tolist() == np.where(is_seen, 0.3, 0.0).tolist()
    assert points.tolist() == [[7.0 * seen] * 2 for seen in is_seen]


def test_too_few_or_repeated_joints_are_refused() -> None:
    with pytest.raises(SkeletonError, match=r'fewer than four .*; known: head, neck, lshoulder, .*nose'):
        build_joint_map(('nose', 'lear', 'rear'))
    with pytest.raises(SkeletonError, match='repeat'):
        build_joint_map(('lknee', 'left_knee', 'rknee', 'lhip', 'rhip', 'lankle'))
