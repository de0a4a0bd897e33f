# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Transforms of several people: names that do not repeat, and people who have none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.people import Person3D
from tests.support.people import make_person_3d
from tests.support.swinging_body import STANDING


def make_standing_person(person_id: str) -> Person3D:
    return replace(make_person_3d(person_id), joints=STANDING + [0, 0, 4])


def list_transforms(people: list[Person3D], frame: str = 'camera') -> list[Any]:
    transforms: list[Any] = decode(encode_transforms(Header(1, frame), people), TRANSFORMS).transforms
    return transforms


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
