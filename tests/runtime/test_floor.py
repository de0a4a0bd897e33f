# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The floor as a parameter: people are put on it, by a fixed camera as by transforms, and in a replay."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, decode_skeletons, encode_demo_frames, process, with_stamp
from tests.support.transforms import make_transforms

FRAMES = 45
STEP_NS = 33_333_333
POSE = {'node.output_frame': 'map', 'node.camera_pose': '0 0 1.5 0 0 0'}
OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # of a camera that looks along x of map
ANKLES = 11, 14


def read_joints(pipeline: Pipeline, stream: list[bytes]) -> Any:
    """Return the joints (F, 15, 3) of the person in each frame, in map."""
    pipeline.set_camera_info(camera_info())
    found = []
    for raw in stream:
        skeletons = next(o for o in process(pipeline, raw) if o.topic == 'skeletons')
        (person,) = decode(skeletons.data, SKELETONS).people
        found.append([(p.x, p.y, p.z) for p in person.joints])
        pipeline.run_deferred_work()
    return np.array(found)


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(FRAMES)


@pytest.fixture(scope='module')
def without_floor(stream: list[bytes]) -> Any:
    return read_joints(Pipeline(with_values(FAST_CONFIG, POSE)), stream)


def floor_config(without_floor: Any) -> Config:
    """Return the parameters of a floor so low that a person who stands on it must be 15 % taller than assumed."""
    ankle = float(np.median(without_floor[:, ANKLES, 2].min(axis=1)))  # m, z of the lower one
    height = 1.5 - 1.15 * (1.5 - ankle + 0.042 * 1.7)
    return with_values(FAST_CONFIG, {**POSE, 'node.floor_height': f'{height:.3f}'})


def test_people_are_as_large_as_their_feet_on_the_floor_tell(
    tmp_path: Path, stream: list[bytes], without_floor: Any
) -> None:
    config = floor_config(without_floor)
    placed = read_joints(Pipeline(config), stream)
    away, before = (joints[:, :, 0].mean(axis=1) for joints in (placed, without_floor))
    assert 1.04 < np.median(away[-15:] / before[-15:]) < 1.15
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 1, 1)
        for i, raw in enumerate(stream):
            recorder.write('/keypoints', KEYPOINTS, raw, 2 + i * STEP_NS, 2 + i * STEP_NS)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
    with Bag(tmp_path / 'out') as bag:
        replayed = [decode(m.raw, SKELETONS).people[0].joints for m in bag.messages(['/skeletons'])]
    np.testing.assert_allclose([[(p.x, p.y, p.z) for p in joints] for joints in replayed], placed, atol=1e-9)


def test_transforms_tell_the_floor_as_a_fixed_pose_does(stream: list[bytes], without_floor: Any) -> None:
    config = floor_config(without_floor)
    by_transforms = Pipeline(with_values(config, {'node.camera_pose': ''}))
    static = make_transforms(('map', 'camera', 0, (0.0, 0.0, 1.5), OPTICAL.as_quat()))
    by_transforms.feed(Source.STATIC_TRANSFORMS, static)
    one, other = read_joints(Pipeline(config), stream[:20]), read_joints(by_transforms, stream[:20])
    np.testing.assert_allclose(one, other, atol=1e-6)


def list_remarks(pipeline: Pipeline, stream: list[bytes]) -> list[str]:
    """Return what is remarked on each frame, transforms of a level camera in map included."""
    pipeline.feed(
        Source.STATIC_TRANSFORMS, make_transforms(('map', 'camera', 0, (0.0, 0.0, 1.5), OPTICAL.as_quat()))
    )
    return [pipeline.feed(Source.KEYPOINTS, raw).reason for raw in stream]


@pytest.mark.parametrize(
    ('values', 'has_camera_info', 'remark'),
    [
        ({'node.floor_height': 2}, True, r'the camera is at z = 1\.50 m, below it'),
        ({'node.floor_height': 0}, False, r'without a CameraInfo it shows which way is up'),
        ({'node.floor_height': 0, 'tracker.lag': 0.2}, True, r'with tracker\.lag it needs node\.camera_pose'),
        ({'node.floor_height': 0}, True, ''),
    ],
)
def test_a_floor_that_cannot_be_used_is_remarked_once(
    stream: list[bytes], values: dict[str, object], has_camera_info: bool, remark: str
) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.output_frame': 'map', **values}))
    if has_camera_info:
        pipeline.set_camera_info(camera_info())
    first, *others = list_remarks(pipeline, stream[:3])
    assert re.search(remark, first) if remark else not first
    assert others == ['', '']
    pipeline.reset()
    assert list_remarks(pipeline, stream[:1]) == [first]


@pytest.mark.parametrize(
    ('values', 'remark'),
    [
        (
            {'tracker.vertical': '0 1 0'},
            r"tracker\.vertical = '0 1 0': people seem to stand at 1[5-8]\d degrees to it",
        ),
        ({'node.output_frame': 'odom'}, r"node\.output_frame = 'odom', whose z axis .* at 1[5-8]\d degrees to it"),
        ({'tracker.vertical': '0 -1 0'}, ''),
        ({'tracker.vertical': 'none', 'node.output_frame': 'odom'}, ''),
    ],
)
def test_a_vertical_that_people_contradict_is_remarked_once(
    stream: list[bytes], values: dict[str, object], remark: str
) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, values))
    pipeline.set_camera_info(camera_info())
    hanging = make_transforms(('odom', 'camera', 0, (0.0, 0.0, 1.5), (1.0, 0.0, 0.0, 0.0)))
    if remark or 'none' in values.values():  # x to the right, y up, z backwards, and then turned: upside down
        turned = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).as_quat()
        hanging = make_transforms(('odom', 'camera', 0, (0.0, 0.0, 1.5), turned))
    pipeline.feed(Source.STATIC_TRANSFORMS, hanging)
    reasons = [
        pipeline.feed(Source.KEYPOINTS, with_stamp(raw, (1 + i) * 200_000_000)).reason
        for i, raw in enumerate(stream)
    ]
    made = [r for r in reasons if r]
    assert len(made) == (1 if remark else 0)
    assert not made or re.match(remark, made[0])
    assert not any(reasons[:20]), 'not before people have been seen for some seconds'


def test_a_frame_whose_name_says_that_z_is_up_tells_the_vertical_without_a_floor(stream: list[bytes]) -> None:
    for frame, is_told in (('odom', True), ('robot_1/map', True), ('base_link', False)):
        pipeline = Pipeline(with_values(FAST_CONFIG, {**POSE, 'node.output_frame': frame}))
        pipeline.set_camera_info(camera_info())
        skeletons = [decode_skeletons(process(pipeline, raw)) for raw in stream[:6]][-1]
        assert (skeletons.vertical_std < math.radians(1.5)) == is_told
        if is_told:
            v = skeletons.vertical
            np.testing.assert_allclose([v.x, v.y, v.z], [0, 0, 1], atol=1e-9)
