# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Transforms of several people: names that do not repeat, and people who have none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from tests.support.people import make_person_3d
from tests.support.swinging_body import STANDING


def make_standing_person(person_id: str) -> Person3D:
    return replace(make_person_3d(person_id), joints=STANDING + [0, 0, 4])


def list_transforms(people: list[Person3D], frame: str = 'camera') -> list[Any]:
    transforms: list[Any] = decode(encode_transforms(Header(1, frame), people), TRANSFORMS).transforms
    return transforms


def test_links_are_at_the_joints_and_turned_as_their_segments() -> None:
    turns = Rotation.random(15, np.random.default_rng(0))
    person = replace(make_standing_person('anna'), orientation=turns.as_quat())
    body, *links = list_transforms([person])
    pose, *others = (read_transform(t.transform) for t in (body, *links))
    np.testing.assert_allclose(pose.translation, person.root, atol=1e-12)
    standing = Rotation.from_matrix(pose.rotation)
    assert {t.header.frame_id for t in links} == {'body_anna'}
    for link, transform in zip(links, others, strict=True):
        name = link.child_frame_id.removesuffix('_anna').replace('_', '')
        if name != 'torso':
            joint = person.joint_names.index(name)
            np.testing.assert_allclose(pose.apply(transform.translation), person.joints[joint], atol=1e-12)
            turned = standing * Rotation.from_matrix(transform.rotation)
            assert (turned.inv() * turns[joint]).magnitude() < 1e-9
    up = person.joints[[CMU15.index('lshoulder'), CMU15.index('rshoulder')]].mean(axis=0) - person.root
    np.testing.assert_allclose(standing.as_matrix()[:, 2], up / np.linalg.norm(up), atol=1e-12)


def read_transform(transform: Any) -> RigidTransform:
    t, r = transform.translation, transform.rotation
    return RigidTransform.from_numbers((t.x, t.y, t.z, r.x, r.y, r.z, r.w))


def test_people_whose_ids_differ_only_in_invalid_characters_have_frames_of_their_own() -> None:
    found = list_transforms([make_standing_person(i) for i in ('a/b', 'a b', 'a_b_2')])
    bodies = [t.child_frame_id for t in found if t.header.frame_id == 'camera']
    assert bodies == ['body_a_b', 'body_a_b_2', 'body_a_b_2_2']
    assert len({t.child_frame_id for t in found}) == len(found) == 3 * 15


def test_people_without_scale_or_extent_and_images_without_frame_have_no_transforms() -> None:
    person = make_standing_person('anna')
    assert list_transforms([replace(person, scale_known=False)]) == []
    assert list_transforms([replace(person, joints=np.zeros((15, 3)))]) == []
    assert list_transforms([person], frame='') == []
    assert len(list_transforms([person])) == 15
