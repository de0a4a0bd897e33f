# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Face, feet and hands: split from the core, joined to it, and exchanged with the part that they belong to."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.extremities import convert_body_to_rays, exchange_body_sides, join_body, split_body
from mocap_ros.keypoints.left_right import PARTS
from mocap_ros.skeleton import BODY26, CORE_COUNT, keypoint_layout

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)


def make_body(rng: np.random.Generator, frames: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.normal(size=(frames, len(BODY26.joints), 2)), rng.uniform(0.1, 1, (frames, len(BODY26.joints)))


@pytest.mark.parametrize(
    ('part', 'exchanged'),
    [
        ('legs', {'lhip', 'lknee', 'lankle', 'ltoe', 'lheel'}),
        ('arms', {'lelbow', 'lwrist', 'lhand'}),
        ('shoulders', {'lshoulder', 'leye', 'lear'}),
    ],
)
def test_feet_go_with_legs_hands_with_arms_and_the_face_with_the_shoulders(
    part: str, exchanged: set[str], rng: np.random.Generator
) -> None:
    points, weight = make_body(rng, 3)
    is_swapped = np.zeros((3, len(PARTS)), bool)
    is_swapped[1, PARTS.index(part)] = True
    new_points, new_weight = join_body(*exchange_body_sides(*split_body(points, weight), is_swapped))
    assert (new_points[[0, 2]] == points[[0, 2]]).all()
    for i, (joint, twin) in enumerate(zip(BODY26.joints, BODY26.mirror, strict=True)):
        source = twin if 'l' + joint[1:] in exchanged and joint[0] in 'lr' else i
        assert (new_points[1, i] == points[1, source]).all(), joint
        assert new_weight[1, i] == weight[1, source]


@pytest.mark.parametrize(
    ('layout', 'toe', 'hand'), [('body25', 'lbigtoe', None), ('mediapipe33', 'lfoot_index', ('lindex', 'lpinky'))]
)
def test_detectors_name_feet_and_hands_differently(
    layout: str, toe: str, hand: tuple[str, str] | None, rng: np.random.Generator
) -> None:
    names = keypoint_layout(layout).joints
    points = rng.uniform(280, 320, (len(names), 2))
    points[names.index('rhip')] = 0  # px; the person is large
    _, _, found = convert_body_to_rays(points, np.ones(len(names)), names, CAMERA, 0.1)
    rays = dict(zip(BODY26.joints[CORE_COUNT:], found.rays, strict=True))
    seen = dict(zip(BODY26.joints[CORE_COUNT:], found.weight > 0, strict=True))
    assert rays['ltoe'] == pytest.approx((points[names.index(toe)] - [320, 240]) / 500)
    assert seen['nose']
    assert seen['rear']
    assert seen['lhand'] == (hand is not None)
    if hand is not None:
        middle = (points[names.index(hand[0])] + points[names.index(hand[1])]) / 2
        assert rays['lhand'] == pytest.approx((middle - [320, 240]) / 500)


@pytest.mark.parametrize(
    ('name', 'joint'), [('lbigtoe', 'ltoe'), ('rheel', 'rheel'), ('nose', 'nose'), ('lear', 'lear')]
)
def test_a_point_far_from_its_body_does_not_count_as_seen(name: str, joint: str, rng: np.random.Generator) -> None:
    names = keypoint_layout('body25').joints
    points = 300 + 10 * rng.standard_normal((len(names), 2))
    points[names.index('neck'), 1], points[names.index('pelvis'), 1] = 240, 400  # px; how large the person is
    index, wrong = BODY26.index(joint) - CORE_COUNT, names.index(name)
    _, _, near = convert_body_to_rays(points, np.ones(len(names)), names, CAMERA, 0.1)
    points[wrong] = 0
    _, _, far = convert_body_to_rays(points, np.ones(len(names)), names, CAMERA, 0.1)
    assert near.weight[index] > 0
    assert far.weight[index] == 0
    assert (np.delete(far.weight, index) == np.delete(near.weight, index)).all()
