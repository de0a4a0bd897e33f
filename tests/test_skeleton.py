"""Layouts are consistent trees; maps take joints where they can be had and derive the others."""

import numpy as np
import pytest

from mocap_ros.errors import SkeletonError
from mocap_ros.skeleton import CMU15, LAYOUT_NAMES, joint_map, layout, own_names


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_layout_is_a_forest_with_left_and_right(name: str) -> None:
    skeleton = layout(name)
    assert len(set(skeleton.joints)) == len(skeleton.joints)
    assert len(skeleton.outward()) == len(skeleton.bones)
    mirror = np.array(skeleton.mirror)
    assert (mirror[mirror] == np.arange(len(mirror))).all()
    for left, right in skeleton.pairs:
        assert skeleton.joints[left] != skeleton.joints[right]
    assert {'lshoulder', 'rankle'} <= set(skeleton.joints)


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_every_layout_gives_every_model_joint(name: str) -> None:
    joints = layout(name).joints
    rng = np.random.default_rng(0)
    points, score = joint_map(joints).apply(rng.normal(size=(len(joints), 2)), np.ones(len(joints)))
    assert np.isfinite(points).all()
    assert (score > 0).all()


def test_unknown_layout_lists_the_known_ones() -> None:
    with pytest.raises(SkeletonError, match=r"'coco99'.*coco17.*mediapipe33"):
        layout('coco99')


def test_derived_joints_and_their_fallbacks() -> None:
    joints = layout('coco17').joints
    points = np.zeros((len(joints), 2))
    score = np.full(len(joints), 0.8)
    at = {n: joints.index(n) for n in joints}
    points[at['lshoulder']], points[at['rshoulder']] = (10, 100), (-10, 100)
    points[at['lear']], points[at['rear']] = (4, 80), (-4, 80)
    points[at['nose']] = (0, 80)
    mapped, trust = joint_map(joints).apply(points, score)
    assert mapped[CMU15.index('neck')] == pytest.approx([0, 100])
    assert mapped[CMU15.index('head')] == pytest.approx([0, 74])
    assert trust[CMU15.index('head')] == pytest.approx(0.4)
    score[at['lear']] = 0
    points[at['leye']] = points[at['reye']] = (0, 82)
    mapped, trust = joint_map(joints).apply(points, score)
    assert mapped[CMU15.index('head')] == pytest.approx([0, 100 + 1.2 * (82 - 100)])
    score[at['lshoulder']] = 0
    mapped, trust = joint_map(joints).apply(points, score)
    assert np.isnan(mapped[CMU15.index('neck')]).all()
    assert trust[CMU15.index('neck')] == 0


def test_joints_that_cannot_carry_a_body_are_refused() -> None:
    with pytest.raises(SkeletonError, match=r'fewer than four .*; known: head, neck, lshoulder, .*nose'):
        joint_map(('nose', 'lear', 'rear'))
    with pytest.raises(SkeletonError, match='repeat'):
        joint_map(('lknee', 'left_knee', 'rknee', 'lhip', 'rhip', 'lankle'))


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_own_names_are_kept_and_other_spellings_understood(name: str) -> None:
    joints = layout(name).joints
    assert own_names(joints) == joints
    sides = {'l': 'left', 'r': 'right'}
    pairs = {joints[i] for pair in layout(name).pairs for i in pair if not joints[i].endswith(('_l', '_r'))}
    for spell in (
        lambda side, rest: f'{sides[side]}_{rest}',
        lambda side, rest: f'{sides[side]}-{rest}'.upper(),
        lambda side, rest: f'{side}_{rest}',
        lambda side, rest: sides[side].title() + rest.title().replace('_', ''),
        lambda side, rest: side.upper() + rest.title(),
    ):
        assert own_names([spell(j[0], j[1:]) if j in pairs else j for j in joints]) == joints


def test_names_of_well_known_detectors() -> None:
    given = ['leftEyeInner', 'left eye (outer)', 'mouth_left', 'MidHip', 'RBigToe', 'left_foot_index', 'Tail']
    own = ('leye_inner', 'leye_outer', 'mouth_l', 'pelvis', 'rbigtoe', 'lfoot_index', 'Tail')
    assert own_names(given) == own
