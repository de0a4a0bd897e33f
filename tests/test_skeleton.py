# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vocabulary: keypoint layouts, spellings of joint names, and errors of one printable line."""

import pickle
import re

import numpy as np
import pytest

from mocap_ros import skeleton as module
from mocap_ros.errors import MAX_MESSAGE_CHARACTERS, InputError, SkeletonError
from mocap_ros.skeleton import CMU15, LAYOUT_NAMES, canonical_joint_names, keypoint_layout


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_layout_is_a_forest_with_left_and_right(name: str) -> None:
    skeleton = keypoint_layout(name)
    assert len(set(skeleton.joints)) == len(skeleton.joints)
    assert len(skeleton.outward_bones()) == len(skeleton.bones)
    mirror = np.array(skeleton.mirror)
    assert (mirror[mirror] == np.arange(len(mirror))).all()
    for left, right in skeleton.left_right_pairs:
        assert mirror[left] == right
        assert re.sub('^l|_l$', '', skeleton.joints[left]) == re.sub('^r|_r$', '', skeleton.joints[right])
        assert skeleton.joints[left] != re.sub('^l|_l$', '', skeleton.joints[left])
    assert {'lshoulder', 'rankle'} <= set(skeleton.joints)


def test_unknown_layout_error_lists_known_layouts() -> None:
    with pytest.raises(SkeletonError, match=r"'xyz'.*coco17.*mediapipe33"):
        keypoint_layout('xyz')
    with pytest.raises(SkeletonError, match=r"'coc17'; did you mean 'coco17'\?$"):
        keypoint_layout('coc17')
    with pytest.raises(SkeletonError, match=r"'coco'; did you mean 'coco17' or 'coco18'\?$"):
        keypoint_layout('coco')


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_canonical_names_are_unchanged_and_other_spellings_converted(name: str) -> None:
    joints = keypoint_layout(name).joints
    assert canonical_joint_names(joints) == joints
    sides = {'l': 'left', 'r': 'right'}
    pairs = {
        joints[i]
        for pair in keypoint_layout(name).left_right_pairs
        for i in pair
        if not joints[i].endswith(('_l', '_r'))
    }
    for spell in (
        lambda side, rest: f'{sides[side]}_{rest}',
        lambda side, rest: f'{sides[side]}-{rest}'.upper(),
        lambda side, rest: f'{side}_{rest}',
        lambda side, rest: sides[side].title() + rest.title().replace('_', ''),
        lambda side, rest: side.upper() + rest.title(),
    ):
        assert canonical_joint_names([spell(j[0], j[1:]) if j in pairs else j for j in joints]) == joints


def test_names_of_well_known_detectors_are_converted() -> None:
    given = ['leftEyeInner', 'left eye (outer)', 'mouth_left', 'MidHip', 'RBigToe', 'left_foot_index', 'Tail']
    canonical = ('leye_inner', 'leye_outer', 'mouth_l', 'pelvis', 'rbigtoe', 'lfoot_index', 'Tail')
    assert canonical_joint_names(given) == canonical


def test_the_stature_follows_from_the_mean_lengths_of_the_bones(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(20, 15, 3))
    mean_lengths = CMU15.bone_lengths(poses).mean(axis=0)
    assert mean_lengths @ CMU15.stature_per_bone == pytest.approx(module.estimate_stature(poses, CMU15))
    with pytest.raises(SkeletonError, match="layout '' has no bone from lhip to lknee"):
        _ = module.skeleton_from_joints(CMU15.joints[::-1]).stature_per_bone


@pytest.mark.parametrize(
    ('message', 'shown'),
    [
        ('a.npz: Zoë: 5 px', 'a.npz: Zoë: 5 px'),
        ('a\n  b\tc', 'a b c'),
        ('\x1b[2Ja\x07\u202eb\ud800', r'\x1b[2Ja\x07\u202eb\ud800'),
    ],
)
def test_a_message_is_one_printable_line(message: str, shown: str) -> None:
    error = InputError(message)
    assert str(error) == shown
    assert str(pickle.loads(pickle.dumps(error))) == shown


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    for fill in ('x', '\x00'):
        text = str(InputError(f'a.json: {fill * 10**6} is no name'))
        assert len(text) <= MAX_MESSAGE_CHARACTERS
        assert text.startswith('a.json: ')
    assert str(InputError(f'a.json: {"x" * 10**6} is no name')).endswith('x is no name')
