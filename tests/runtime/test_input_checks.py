# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joints in another order, and images of another size, are described once, and only after seconds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.topics import Source
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.input_checks import (
    LEAST_S,
    _describe_outside,
    describe_misspelt_joint,
    describe_unusable_distortion,
)
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.skeleton import KEYPOINT_LAYOUTS, keypoint_layout
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, with_stamp

STEP_S = 0.2  # between the frames
CAMERA = Intrinsics.from_image_size(640, 480, 1.2)
COCO17 = keypoint_layout('coco17').joints
SPELT_OUT = tuple(
    {'l': 'left_', 'r': 'right_'}[j[0]] + j[1:] if j != 'nose' else j for j in COCO17
)  # as other packages name them


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    frames = encode_demo_frames(30)
    return [with_stamp(raw, round((1 + i * STEP_S) * 1e9)) for i, raw in enumerate(frames)]


def edit_people(raw: bytes, edit: Callable[[Any], None]) -> bytes:
    message = decode(raw, KEYPOINTS)
    for person in message.people:
        edit(person)
    return encode(message, KEYPOINTS)


def reverse_joints(person: Any) -> None:
    person.skeleton, person.joint_names = '', list(reversed(COCO17))


def enlarge(person: Any) -> None:
    person.x, person.y = person.x * 3, person.y * 3


def list_remarks(pipeline: Pipeline, frames: list[bytes]) -> list[str]:
    if pipeline.camera_info is None:  # of which there would be a remark that is not meant here
        pipeline.set_camera_info(camera_info())
    return [pipeline.feed(Source.KEYPOINTS, raw).reason for raw in frames]


@pytest.mark.parametrize(
    ('edit', 'remark'),
    [
        (reverse_joints, 'people: no person has joints where the points are'),
        (enlarge, r'people: \d+% of the seen keypoints lie outside 640 x 480 px; check that the detector sees'),
    ],
)
def test_a_mistake_is_described_once_and_kept_until_it_is_mended(
    stream: list[bytes], edit: Callable[[Any], None], remark: str
) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    wrong = [edit_people(raw, edit) for raw in stream]
    reasons = list_remarks(pipeline, wrong)
    (made,) = (r for r in reasons if r)
    assert re.match(remark, made)
    assert not any(reasons[: int(LEAST_S / STEP_S)]), 'not before some seconds'
    (kept,) = pipeline.checks.warnings
    assert re.match(remark, kept)
    later = [with_stamp(raw, round((10 + i * STEP_S) * 1e9)) for i, raw in enumerate(stream)]
    assert not any(list_remarks(pipeline, later))
    assert pipeline.checks.warnings == ()
    pipeline.reset()
    assert sum(map(bool, list_remarks(pipeline, wrong))) == 1, 'a reset forgets what was remarked'
    pipeline.reset()
    assert pipeline.checks.warnings == ()


def test_nothing_is_remarked_on_right_points(stream: list[bytes]) -> None:
    assert not any(list_remarks(Pipeline(FAST_CONFIG), stream))


@pytest.mark.parametrize(
    ('xs', 'is_wrong'),
    [
        ([700.0, 700.0, 700.0, 100.0], True),
        ([-1.0, -1.0, -1.0, -1.0, math.nan], True),
        ([700.0, 700.0, 100.0, 100.0], False),  # legs that the image cuts off
        ([0.0, 640.0, 640.0, 0.0], False),  # on the edge
        ([-1.0] * 3, False),  # too few to tell
        ([math.nan] * 4, False),
    ],
)
def test_points_are_outside_the_image_if_most_are(xs: list[float], *, is_wrong: bool) -> None:
    points = np.column_stack([xs, np.full(len(xs), 100.0)])
    person = Person2D('', COCO17[: len(xs)], points, np.where(np.isnan(xs), 0.0, 1.0))
    assert bool(_describe_outside(person, (640, 480))) == is_wrong
    tall = replace(person, points=person.points[:, ::-1])
    assert ('look transposed' in _describe_outside(tall, (1000, 640))) == (xs[:3] == [700.0] * 3)


@pytest.mark.parametrize(
    ('model', 'coefficients', 'focal_in_widths', 'is_unusable'),
    [
        ('plumb_bob', (-5.0, 3.0, 0.0, 0.0, -9.0), 1.2, True),
        ('plumb_bob', (-2.0, 0.0, 0.0, 0.0), 0.8, True),
        ('rational_polynomial', (1e6,) * 4 + (-1e6,) * 4, 1.2, True),
        ('plumb_bob', (), 0.5, False),
        ('plumb_bob', (-0.28, 0.07, 0.0002, 0.00002, 0.0), 0.35, False),
        ('rational_polynomial', (2.0, 1.5, 0.0004, -0.0003, 0.1, 2.3, 2.2, 0.5), 0.35, False),
        ('equidistant', (-0.01, 0.02, -0.02, 0.005), 0.34, False),  # 200 degrees across
        ('equidistant', (-0.01, 0.003, -0.002, 0.0003), 150 / 640, False),  # 180 degrees within the height
    ],
)
def test_a_distortion_that_cannot_be_undone_is_described_once(
    model: str, coefficients: tuple[float, ...], focal_in_widths: float, *, is_unusable: bool
) -> None:
    lens = Distortion.from_coefficients(model, coefficients)
    camera = replace(CAMERA, focal=focal_in_widths * 640, is_focal_known=True, distortion=lens)
    assert bool(describe_unusable_distortion(camera)) == is_unusable
    pipeline = Pipeline(FAST_CONFIG)
    assert pipeline.feed(Source.CAMERA_INFO, encode_camera_info(Header(0, ''), CameraInfo((640, 480), camera)))
    remarks = list_remarks(pipeline, encode_demo_frames(3))
    assert ['distortion of the camera: it cannot be undone' in remark for remark in remarks] == [is_unusable, 0, 0]


@pytest.mark.parametrize(
    ('wrong', 'right', 'meant'),
    [
        ('left_sholder', 'left_shoulder', 'lshoulder'),
        ('LKnees', 'left_knee', 'lknee'),
        ('right ankel', 'right_ankle', 'rankle'),
        ('left_hand_thumb1', 'left_hip', ''),
        ('left_heel', 'left_knee', ''),  # another joint
        ('r', 'right_hip', ''),
        ('', 'right_hip', ''),
    ],
)
def test_misspelt_joints_that_are_missing_are_described(
    stream: list[bytes], wrong: str, right: str, meant: str
) -> None:
    names = [*SPELT_OUT]
    names[names.index(right)] = wrong
    expected = f'joint_names: {wrong!r} is no known joint and is ignored; is it {meant!r}?' if meant else ''
    assert describe_misspelt_joint(tuple(names)) == expected
    assert describe_misspelt_joint((*names, right)) == '', 'an extra joint beside the right one'

    def misspell(person: Any) -> None:
        person.skeleton, person.joint_names = '', names

    if meant:
        pipeline = Pipeline(FAST_CONFIG)
        assert list_remarks(pipeline, [edit_people(raw, misspell) for raw in stream[:3]]) == [expected, '', '']
        assert pipeline.checks.warnings == (expected,)


def test_no_layout_has_misspelt_joints() -> None:
    assert not any(describe_misspelt_joint(layout.joints) for layout in KEYPOINT_LAYOUTS.values())
