"""The floor as a parameter: people are put on it, by a fixed camera as by transforms, and in a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, process
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


def test_without_a_transform_there_is_no_floor_and_people_are_put_out_nevertheless(
    stream: list[bytes], without_floor: Any
) -> None:
    pipeline = Pipeline(with_values(floor_config(without_floor), {'node.camera_pose': ''}))
    own = read_joints(pipeline, stream[:20])
    expected = OPTICAL.inv().apply((without_floor[:20] - [0, 0, 1.5]).reshape(-1, 3)).reshape(own.shape)
    np.testing.assert_allclose(own, expected, atol=1e-9)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'node.floor_height': '0'}, r'node\.floor_height: needs node\.output_frame'),
        (
            {'node.floor_height': 'low', 'node.output_frame': 'map'},
            r"node\.floor_height = 'low': expected a number",
        ),
        ({'node.floor_height': 'nan', 'node.output_frame': 'map'}, r'such as 0'),
    ],
)
def test_a_wrong_height_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Pipeline(with_values(FAST_CONFIG, values))
