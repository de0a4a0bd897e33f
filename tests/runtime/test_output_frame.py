# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People in the frame of the robot, by a parameter and by transforms, live and replayed; floor and predictions."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.bags.journal import Acceptance
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import RecorderConfig, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.imu import IMU
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.messages.skeletons import decode_skeletons as read_skeletons
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.people import CameraVertical
from mocap_ros.runtime.output_frame import LiveWorld
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.floor import ANKLE_M
from mocap_ros.units import NS_PER_S
from tests.support.bodies import gather, make_person_3d
from tests.support.camera_messages import camera_info, make_imu, make_transforms
from tests.support.pipeline_inputs import (
    FAST_CONFIG,
    STEP_NS,
    decode_skeletons,
    encode_demo_frames,
    make_calibrated,
    process,
    read_messages,
    with_stamp,
    write_keypoints_bag,
)

START_NS = 1_700_000_000_000_000_000  # since the epoch
SPEED_M_S = 2.0  # of the robot along x of map
# The camera on the robot looks along the robot's x, with z of the robot up.
OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
CAMERA = (0.2, 0.0, 1.5)  # m, of the camera in base
PLAIN_CONFIG = with_values(FAST_CONFIG, {'tracker.vertical': 'none'})  # the frame gives the solver no vertical
MAP_CONFIG = with_values(PLAIN_CONFIG, {'node.output_frame': 'map'})
PREDICTED = {'node.publish_predictions': True}


@pytest.fixture(scope='module')
def long_stream() -> list[bytes]:
    return encode_demo_frames(45)


@pytest.fixture(scope='module')
def stream(long_stream: list[bytes]) -> list[bytes]:
    return long_stream[:12]


@pytest.fixture(scope='module')
def in_camera(stream: list[bytes]) -> list[Any]:
    """Return the skeletons of each frame in the camera's optical frame."""
    pipeline = make_calibrated(PLAIN_CONFIG)
    return [decode_skeletons(process(pipeline, raw)) for raw in stream]


def stack(array: Any, field: str = 'joints') -> np.ndarray:
    return np.array([[(p.x, p.y, p.z) for p in getattr(s, field)] for s in array.people])


def stamp_of(array: Any) -> int:
    return int(array.header.stamp.sec * NS_PER_S + array.header.stamp.nanosec)


def feed_transforms(pipeline: Pipeline, source: Source, raw: bytes) -> None:
    result = pipeline.feed(source, raw)
    assert (result.acceptance, result.reason) == (Acceptance.ACCEPTED, '')


def test_a_camera_that_stands_still_by_parameter(stream: list[bytes], in_camera: list[Any]) -> None:
    config = with_values(MAP_CONFIG, {'node.camera_pose': '0.2 0 1.5 0 0 0', 'node.publish_tf': True})
    pipeline = make_calibrated(config)
    for raw, own in zip(stream, in_camera, strict=True):
        outputs = {o.topic: o for o in process(pipeline, raw)}
        placed = decode(outputs['skeletons'].data, SKELETONS)
        expected = OPTICAL.apply(stack(own).reshape(-1, 3)) + CAMERA
        np.testing.assert_allclose(stack(placed).reshape(-1, 3), expected, atol=1e-9)
        assert (placed.header.frame_id, placed.camera_frame_id) == ('map', 'camera')
        velocity = OPTICAL.apply(stack(own, 'joint_velocity').reshape(-1, 3))
        np.testing.assert_allclose(stack(placed, 'joint_velocity').reshape(-1, 3), velocity, atol=1e-9)
        quaternions = ([(q.x, q.y, q.z, q.w) for q in s.people[0].joint_orientation] for s in (own, placed))
        before, after = map(Rotation.from_quat, quaternions)
        assert (after.inv() * OPTICAL * before).magnitude().max() < 1e-6
        matrix = OPTICAL.as_matrix()
        for field in ('root_covariance', 'root_velocity_covariance'):
            before, after = (getattr(s.people[0], field).reshape(3, 3) for s in (own, placed))
            np.testing.assert_allclose(after, matrix @ before @ matrix.T, atol=1e-9)
        (person,) = read_skeletons(outputs['skeletons'].data).people
        np.testing.assert_allclose(person.joints, stack(own)[0], atol=1e-9)
        for topic in ('markers', 'points', '/tf'):
            message = decode(outputs[topic].data, (OUTPUTS | {'/tf': TRANSFORMS})[topic])
            parts = message.markers if topic == 'markers' else message.transforms if topic == '/tf' else [message]
            assert all(p.header.frame_id in ('map', 'body_person_1') for p in parts), topic
        assert decode(outputs['cameras'].data, OUTPUTS['cameras']).header.frame_id == 'camera'


@pytest.mark.parametrize('late_ns', [0, 2 * STEP_NS])
def test_velocities_from_a_driving_robot(stream: list[bytes], in_camera: list[Any], late_ns: int) -> None:
    """The robot turns at 0.5 rad/s about its axis and drives along x of map; transforms may come late."""
    pipeline = make_calibrated(MAP_CONFIG)
    mounted = make_transforms(('base', 'camera', 0, CAMERA, OPTICAL.as_quat()))
    feed_transforms(pipeline, Source.STATIC_TRANSFORMS, mounted)
    first_ns = stamp_of(in_camera[0])

    def pose_at(stamp_ns: int) -> tuple[np.ndarray, Rotation]:
        seconds = (stamp_ns - first_ns) / NS_PER_S
        return np.array([SPEED_M_S * seconds, 0.0, 0.0]), Rotation.from_euler('z', 0.5 * seconds)

    def place(points: np.ndarray, stamp_ns: int) -> np.ndarray:
        origin, turn = pose_at(stamp_ns)
        return np.asarray(turn.apply(OPTICAL.apply(points) + CAMERA) + origin)

    for raw, own in zip(stream, in_camera, strict=True):
        stamp_ns = stamp_of(own)
        newest_ns = max(stamp_ns - late_ns, first_ns)
        origin, turn = pose_at(newest_ns)
        transform = make_transforms(('map', 'base', newest_ns, tuple(origin), turn.as_quat()))
        feed_transforms(pipeline, Source.TRANSFORMS, transform)
        placed = decode_skeletons(process(pipeline, raw))
        if newest_ns < first_ns + NS_PER_S // 10:  # the transforms show no motion yet
            continue
        joints, velocity, step_s = stack(own)[0], stack(own, 'joint_velocity')[0], 1e-3
        later = place(joints + step_s * velocity, stamp_ns + round(step_s * NS_PER_S))
        expected = (later - place(joints, stamp_ns)) / step_s
        error = np.abs(stack(placed, 'joint_velocity')[0] - expected)
        turned = 0.5 * late_ns / NS_PER_S  # rad, since the transform that is known
        assert (error <= 0.1 + turned * np.linalg.norm(expected, axis=1, keepdims=True)).all()
        assert np.linalg.norm(expected.mean(axis=0) - velocity.mean(axis=0)) > 0.5


def test_without_transforms_people_are_in_the_camera_frame(stream: list[bytes], in_camera: list[Any]) -> None:
    pipeline = make_calibrated(MAP_CONFIG)
    result = pipeline.feed(Source.KEYPOINTS, stream[0])
    assert result.acceptance is Acceptance.ACCEPTED
    assert result.reason.startswith("no transform from 'camera' to 'map': ")
    skeletons = decode_skeletons(result.outputs)
    assert skeletons.header.frame_id == skeletons.camera_frame_id == 'camera'
    np.testing.assert_array_equal(stack(skeletons), stack(in_camera[0]))


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'node.output_frame': '/map'}, r'node\.output_frame = .*slash'),
        ({'node.imu_pose': '0 0 1'}, r"node\.imu_pose = '0 0 1': expected six"),
        ({'node.camera_pose': '0 0 1', 'node.output_frame': 'map'}, r"node\.camera_pose = '0 0 1': expected six"),
        ({'node.camera_pose': '0 0 nan 0 0 0', 'node.output_frame': 'map'}, r'expected six numbers'),
        ({'node.camera_pose': '0 0 1 0 90 0', 'node.output_frame': 'map'}, r'angles are in rad, not in degrees'),
        ({'node.camera_pose': '2e7 0 1 0 0 0', 'node.output_frame': 'map'}, r'more than 10000 km away'),
        ({'node.floor_height': '0'}, r'node\.floor_height: needs node\.output_frame'),
        ({'node.floor_height': 'x', 'node.output_frame': 'map'}, r"node\.floor_height = 'x': expected a number"),
        ({'node.floor_height': 'nan', 'node.output_frame': 'map'}, r'such as 0'),
        ({'node.hfov': 60.0, 'node.focal': 600.0}, r'node\.focal: node\.hfov is given as well'),
        (
            {**PREDICTED, 'node.prediction_times': ''},
            r"node\.prediction_times = '': expected one to 20 times in s",
        ),
        ({**PREDICTED, 'node.prediction_times': '0.2 1.5'}, r'up to 1, separated'),
        ({**PREDICTED, 'node.prediction_times': '0.2 soon'}, r'such as 0\.2 0\.4'),
        ({**PREDICTED, 'node.prediction_times': '0.2 nan'}, r'above 0'),
        ({**PREDICTED, 'node.prediction_times': '0.1 ' * 21}, r'one to 20'),
        ({**PREDICTED, 'tracker.lag': 0.2}, r'node\.publish_predict\w+: needs tracker\.lag = 0'),
        (
            {'node.floor_height': 2, 'node.output_frame': 'map', 'node.camera_pose': '0 0 1.5 0 0 0'},
            r'node\.floor_height = 2: the camera of node\.camera_pose, at z = 1\.5 m, is not above it',
        ),
    ],
)
def test_parameters_that_cannot_be_used_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Pipeline(with_values(PLAIN_CONFIG, values))
    if PREDICTED.items() <= values.items():
        Pipeline(with_values(PLAIN_CONFIG, {**values, 'node.publish_predictions': False}))  # of no use, nor read


def test_predictions_are_in_the_output_frame_also_in_a_replay(tmp_path: Path, long_stream: list[bytes]) -> None:
    values = {**PREDICTED, 'node.prediction_times': '0.1 0.5', 'node.camera_pose': '0 0 1.5 0 0.1 0'}
    config = with_values(MAP_CONFIG, values)
    stream, pipeline = long_stream[:20], make_calibrated(config)
    write_keypoints_bag(tmp_path / 'bag', stream, camera_info())
    live = []
    for raw in stream:
        outputs = process(pipeline, raw)
        live.append({o.topic: bytes(o.data) for o in outputs}['predictions'])
        pipeline.run_deferred_work()
    message, now = decode(live[-1], PREDICTIONS), decode_skeletons(outputs)
    (person,) = now.people
    assert (message.header.frame_id, message.header.stamp) == ('map', now.header.stamp)
    assert [t.ahead for t in message.times] == pytest.approx([0.1, 0.5])
    root = message.times[0].people[0].root
    moved = np.hypot(root.x - person.root.x, root.y - person.root.y)
    speed = np.hypot(person.root_velocity.x, person.root_velocity.y)
    assert moved == pytest.approx(0.1 * speed, abs=0.1)
    assert [t.people[0].id for t in message.times] == [person.id] * 2
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
        replay(bag, tmp_path / 'plain', ReplayOptions(PLAIN_CONFIG))
    assert read_messages(tmp_path / 'out', '/predictions') == live
    assert not read_messages(tmp_path / 'plain', '/predictions')


FLOOR_POSE = {'node.output_frame': 'map', 'node.camera_pose': '0 0 1.5 0 0 0'}
ANKLES = 11, 14
LEVEL_CAMERA = make_transforms(('map', 'camera', 0, (0.0, 0.0, 1.5), OPTICAL.as_quat()))


def track_joints(pipeline: Pipeline, long_stream: list[bytes]) -> Any:
    pipeline.set_camera_info(camera_info())
    found = []
    for raw in long_stream:
        skeletons = next(o for o in process(pipeline, raw) if o.topic == 'skeletons')
        (person,) = decode(skeletons.data, SKELETONS).people
        found.append([(p.x, p.y, p.z) for p in person.joints])
        pipeline.run_deferred_work()
    return np.array(found)


@pytest.fixture(scope='module')
def without_floor(long_stream: list[bytes]) -> Any:
    return track_joints(Pipeline(with_values(FAST_CONFIG, FLOOR_POSE)), long_stream)


def test_people_are_as_large_as_their_feet_on_the_floor_show(long_stream: list[bytes], without_floor: Any) -> None:
    ankle = float(np.median(without_floor[:, ANKLES, 2].min(axis=1)))  # m, z of the lower one
    height = 1.5 - 1.15 * (1.5 - ankle + 0.042 * 1.7)  # m; who stands so low is 15 % taller than assumed
    config = with_values(FAST_CONFIG, {**FLOOR_POSE, 'node.floor_height': f'{height:.3f}'})
    by_pose = track_joints(Pipeline(config), long_stream)
    away, before = (joints[:, :, 0].mean(axis=1) for joints in (by_pose, without_floor))
    assert 1.04 < np.median(away[-15:] / before[-15:]) < 1.15
    by_transforms = Pipeline(with_values(config, {'node.camera_pose': ''}))
    by_transforms.feed(Source.STATIC_TRANSFORMS, LEVEL_CAMERA)
    np.testing.assert_allclose(track_joints(by_transforms, long_stream[:20]), by_pose[:20], atol=1e-6)


def list_reasons(pipeline: Pipeline, long_stream: list[bytes]) -> list[str]:
    pipeline.feed(Source.STATIC_TRANSFORMS, LEVEL_CAMERA)
    return [pipeline.feed(Source.KEYPOINTS, raw).reason for raw in long_stream]


@pytest.mark.parametrize(
    ('values', 'has_camera_info', 'reason'),
    [
        ({'node.floor_height': 2}, True, r'the camera is at z = 1\.50 m, below it'),
        ({'node.floor_height': 0}, False, r'without a CameraInfo it shows which way is up'),
        ({'node.floor_height': 0, 'tracker.lag': 0.2}, True, r'with tracker\.lag it needs node\.camera_pose'),
        ({'node.floor_height': 0}, True, ''),
        ({'tracker.camera_height': 1.5}, True, r'tracker\.camera_height = 1\.5 is not used: node\.output_frame'),
    ],
)
def test_an_unusable_floor_is_named_once(
    long_stream: list[bytes], values: dict[str, object], has_camera_info: bool, reason: str
) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.output_frame': 'map', **values}))
    if has_camera_info:
        pipeline.set_camera_info(camera_info())
    first, *others = list_reasons(pipeline, long_stream[:3])
    assert re.search(reason, first) if reason else not first
    assert others == ['', '']
    pipeline.reset()
    assert list_reasons(pipeline, long_stream[:1]) == [first]


@pytest.mark.parametrize(
    ('values', 'problem'),
    [
        ({'tracker.vertical': '0 1 0'}, r"tracker\.vertical = '0 1 0': people seem .* at 1[5-8]\d degrees to it"),
        ({'node.output_frame': 'odom'}, r"node\.output_frame = 'odom', whose z axis .* at 1[5-8]\d degrees to it"),
        ({'tracker.vertical': '0 -1 0'}, ''),
        ({'tracker.vertical': 'none', 'node.output_frame': 'odom'}, ''),
    ],
)
def test_a_wrong_vertical_is_named(long_stream: list[bytes], values: dict[str, object], problem: str) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, values))
    hanging = make_transforms(('odom', 'camera', 0, (0.0, 0.0, 1.5), (1.0, 0.0, 0.0, 0.0)))
    if problem or 'none' in values.values():  # x to the right, y up, z backwards, and then turned: upside down
        turned = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).as_quat()
        hanging = make_transforms(('odom', 'camera', 0, (0.0, 0.0, 1.5), turned))
    pipeline.feed(Source.STATIC_TRANSFORMS, hanging)
    slow = [with_stamp(raw, (1 + i) * 200_000_000) for i, raw in enumerate(long_stream)]
    reasons = [pipeline.feed(Source.KEYPOINTS, raw).reason for raw in slow]
    made = [r for r in reasons if r]
    assert [bool(re.match(problem, r)) for r in made] == [True] * bool(problem)
    assert not any(reasons[:20]), 'not before people have been seen for some seconds'


@pytest.mark.parametrize('values', [{}, FLOOR_POSE, {**FLOOR_POSE, 'node.floor_height': '0.1'}])
def test_the_world_on_tf_is_level(tmp_path: Path, long_stream: list[bytes], values: dict[str, str]) -> None:
    config = with_values(FAST_CONFIG, {**values, 'node.publish_tf': True, 'node.frame_prefix': 'left_'})
    pipeline = make_calibrated(config)
    write_keypoints_bag(tmp_path / 'bag', long_stream, camera_info())
    live, worlds = [], []
    for raw in long_stream:
        outputs = process(pipeline, raw)
        live.append({o.topic: bytes(o.data) for o in outputs}['/tf'])
        pipeline.run_deferred_work()
        found = [t for t in decode(live[-1], TRANSFORMS).transforms if t.child_frame_id == 'left_mocap_world']
        for frame in found:
            assert frame.header.frame_id == (values.get('node.output_frame') or 'camera')
            place, turn = frame.transform.translation, frame.transform.rotation
            world = np.array([place.x, place.y, place.z]), Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
            worlds.append((decode_skeletons(outputs), *world))
    assert 5 < len(worlds) < len(long_stream)  # the vertical takes a second to be found
    for (_, place, turn), (_, next_place, next_turn) in pairwise(worlds):
        assert np.linalg.norm(next_place - place) < 0.01
        assert (turn.inv() * next_turn).magnitude() < 0.005
    skeletons, place, turn = worlds[-1]
    in_world = turn.inv().apply(stack(skeletons)[0] - place)
    assert in_world[CMU15.index('neck'), 2] > in_world[CMU15.index('pelvis'), 2] + 0.3
    if 'node.floor_height' in values:
        assert place[2] == pytest.approx(0.1, abs=1e-6)
        assert turn.apply([0, 0, 1]) == pytest.approx([0, 0, 1], abs=1e-6)
    else:
        assert in_world[:, 2].min() == pytest.approx(0.0, abs=0.1)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
    assert read_messages(tmp_path / 'out', '/tf') == live


def test_a_frame_whose_name_says_that_z_is_up_gives_the_vertical_without_a_floor(long_stream: list[bytes]) -> None:
    for frame, is_known in (('odom', True), ('robot_1/map', True), ('base_link', False)):
        pipeline = make_calibrated(with_values(FAST_CONFIG, {**FLOOR_POSE, 'node.output_frame': frame}))
        skeletons = [decode_skeletons(process(pipeline, raw)) for raw in long_stream[:6]][-1]
        assert (skeletons.vertical_std < math.radians(1.5)) == is_known
        if is_known:
            v = skeletons.vertical
            np.testing.assert_allclose([v.x, v.y, v.z], [0, 0, 1], atol=1e-9)


def test_a_world_begins_anew_where_tracking_does(long_stream: list[bytes]) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, {'node.publish_tf': True}))

    def find_transforms(raw: bytes) -> bytes:
        return next(bytes(o.data) for o in process(pipeline, raw) if o.topic == '/tf')

    first, second = ([*map(find_transforms, long_stream)] for _ in range(2))  # a bag in a loop
    assert first == second
    assert b'mocap_world' in first[-1]
    pipeline.reconfigure(with_values(pipeline.config, {'tracker.body_height': 1.8}))
    assert b'mocap_world' not in find_transforms(with_stamp(long_stream[0], START_NS))


UPRIGHT = np.zeros((len(CMU15.joints), 3)) + [5.0, 0.0, 1.0]  # m, in map
UPRIGHT[CMU15.index('lhip'), 1], UPRIGHT[CMU15.index('rhip'), 1] = 0.1, -0.1
UPRIGHT[ANKLES, 2] = ANKLE_M


@pytest.mark.parametrize(
    ('seconds', 'gap_s', 'heights', 'expected', 'tolerance'),
    [
        (1, 40, (-1.5,), 0.0, 0.1),  # one frame after a gap
        (15, 0, (0.8,), 0.0, 0.3),  # who climbs
        (15, 0, (0.0, 0.8), 0.0, 0.01),  # beside another who stands on a table
        (15, 0, (0.0, math.nan), 0.0, 0.01),
        (60, 0, (-0.8,), -0.7, 0.1),  # who stood on a table at first
    ],
)
def test_the_world_rests_on_the_floor(
    seconds: int, gap_s: int, heights: tuple[float, ...], expected: float, tolerance: float
) -> None:
    world, camera = LiveWorld(), CameraPlacement('camera')
    upward = np.array([0.0, 0.0, 1.0])

    def find_floor(frames: int, begin_s: float, heights: tuple[float, ...]) -> float:
        people = gather(
            [
                replace(
                    make_person_3d(str(i)), joints=UPRIGHT + [0, 0, h], contact=np.ones(2), is_scale_known=True
                )
                for i, h in enumerate(heights)
            ]
        )
        for frame in range(frames):
            stamp_ns = START_NS + round((begin_s + frame / 30) * NS_PER_S)
            found = world.advance(stamp_ns, people, CameraVertical(upward, 0.05), camera, None)
        assert found is not None
        return float(found.translation[2])

    assert find_floor(150, 0.0, (0.0,)) == pytest.approx(0.0, abs=0.01)
    frames = 1 if gap_s else 30 * seconds
    assert find_floor(frames, 5.0 + gap_s, heights) == pytest.approx(expected, abs=tolerance)


PITCH = 0.2  # rad, by which the camera looks down
IMU_OF_CAMERA = make_transforms(('camera', 'imu_link', 0, (0.0, 0.0, 0.0), OPTICAL.inv().as_quat()))
BY_TF: dict[str, object] = {}
BY_POSE = {'node.imu_pose': '0 0 0 0 0 0'}
BY_CAMERA = {'node.camera_pose': f'0 0 1.5 0 {PITCH} 0'}
TILTED = 9.81 * np.array([-math.sin(PITCH), 0.0, math.cos(PITCH)])  # m/s^2; x forward, z up


def feed_imu(pipeline: Pipeline, raw: bytes, long_stream: list[bytes]) -> list[str]:
    """Feed an Imu before each of three images; return the reasons that are given."""
    reasons = []
    for frame in long_stream[:3]:
        reasons += [pipeline.feed(Source.IMU, raw).reason, pipeline.feed(Source.KEYPOINTS, frame).reason]
    return [reason for reason in reasons if reason]


@pytest.mark.parametrize(
    ('values', 'std'),
    [
        (BY_TF, 0.03),
        (BY_POSE, 0.03),
        ({**BY_TF, 'node.output_frame': 'base_link'}, 0.03),  # it is placed nowhere
        (BY_CAMERA, math.radians(1)),
        ({**BY_CAMERA, 'tracker.camera_height': 1.5}, math.radians(1)),
    ],
)
def test_up_is_what_an_imu_or_the_pose_of_the_camera_shows(
    long_stream: list[bytes], values: dict[str, object], std: float
) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, values))
    pipeline.feed(Source.STATIC_TRANSFORMS, IMU_OF_CAMERA)
    raw = make_imu(Header(STEP_NS, 'imu_link'), TILTED)
    reasons = feed_imu(pipeline, raw, long_stream) if std > 0.02 else list_reasons(pipeline, long_stream[:3])
    assert [r for r in reasons if r and 'frame of the camera' not in r] == []
    vertical = pipeline._tracker.vertical
    assert vertical is not None
    assert vertical.direction == pytest.approx([0, -math.cos(PITCH), -math.sin(PITCH)], abs=1e-6)
    assert vertical.is_given
    assert vertical.std == pytest.approx(std, rel=0.1)
    pipeline.reset()
    pipeline.feed(Source.KEYPOINTS, long_stream[0])
    assert (pipeline._tracker.vertical is not None) == ('node.camera_pose' in values), (
        'accelerations are forgotten'
    )


@pytest.mark.parametrize(
    ('imu', 'values', 'reason'),
    [
        (make_imu(Header(STEP_NS, 'other'), TILTED), {}, "imu .* no transform from 'other' to 'camera'"),
        (make_imu(Header(STEP_NS, ''), TILTED), {}, "imu .* no transform from '' to 'camera'"),
        (make_imu(Header(60 * NS_PER_S, 'imu_link'), TILTED), {}, r'imu .* 60\.0 s away from the image'),
        (make_imu(Header(STEP_NS, 'imu_link'), TILTED / 9.81), {}, r'imu .* linear_acceleration is 1\.00 m/s\^2'),
        (
            make_imu(Header(STEP_NS, 'imu_link'), TILTED, -1),
            {},
            r'imu .* linear_acceleration_covariance\[0\] is -1',
        ),
        (make_imu(Header(STEP_NS, 'other'), TILTED), BY_POSE, ''),
        (make_imu(Header(STEP_NS, 'other'), TILTED), {'tracker.vertical': '10'}, ''),
    ],
)
def test_an_imu_that_shows_nothing_is_named_once(
    long_stream: list[bytes], imu: bytes, values: dict[str, object], reason: str
) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, values))
    pipeline.feed(Source.STATIC_TRANSFORMS, IMU_OF_CAMERA)
    reasons = feed_imu(pipeline, imu, long_stream)
    assert [bool(re.search(reason, r)) for r in reasons] == [True] * bool(reason)
    assert len(pipeline.people) == 1


@pytest.mark.parametrize('raw', [b'', make_imu(Header(0, 'imu_link'), TILTED * math.nan)])
def test_an_imu_that_cannot_be_read_is_refused(long_stream: list[bytes], raw: bytes) -> None:
    pipeline = make_calibrated()
    assert len(feed_imu(pipeline, raw, long_stream)) == 3
    assert (pipeline.counters.invalid, pipeline.counters.accepted) == (3, 3)


@pytest.mark.parametrize('topics', [('/cam/imu',), ('/cam/imu', '/base/imu')])
def test_a_replay_takes_the_only_imu_of_a_bag(
    tmp_path: Path, stream: list[bytes], topics: tuple[str, ...]
) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 0, 0)
        recorder.write('/tf_static', TRANSFORMS, IMU_OF_CAMERA, 0, 0)
        for number, raw in enumerate(stream):
            for topic in topics:
                imu = make_imu(Header(number * STEP_NS, 'imu_link'), TILTED)
                recorder.write(topic, IMU, imu, number * STEP_NS, number * STEP_NS)
            recorder.write('/keypoints', KEYPOINTS, raw, number * STEP_NS + 1, number * STEP_NS + 1)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out')
    last = decode(read_messages(tmp_path / 'out', '/skeletons')[-1], SKELETONS)
    is_shown = last.vertical_std < math.radians(2.0)
    assert is_shown == (len(topics) == 1), 'which of several is unknown'
    assert not is_shown or last.vertical.z == pytest.approx(-math.sin(PITCH), abs=1e-6)
