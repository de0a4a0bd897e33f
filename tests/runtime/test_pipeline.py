# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pipeline: bytes in, bytes out; bad input is counted and changes nothing."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.topics import Source
from mocap_ros.config import with_values
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.messages.camera_info import decode_camera_info
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import decode_keypoints, encode_keypoints
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.skeleton import CORE_COUNT
from tests.support.camera_messages import camera_info
from tests.support.pipeline_inputs import (
    FAST_CONFIG,
    decode_skeletons,
    encode_demo_frames,
    make_calibrated,
    process,
    reject,
    with_stamp,
)


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(6)


def test_bad_input_is_counted_and_changes_nothing(stream: list[bytes]) -> None:
    clean, disturbed = Pipeline(FAST_CONFIG), Pipeline(FAST_CONFIG)
    for i, raw in enumerate(stream[:6]):
        outputs = process(disturbed, raw)
        assert [o.data for o in process(clean, raw)] == [o.data for o in outputs]
        again = reject(disturbed, raw, Verdict.DROPPED)
        assert ('repeats' if i else 'header.stamp is not set') in again
        assert 'not a mocap_ros_msgs' in reject(disturbed, raw[:50], Verdict.INVALID)
        if i:
            assert 'older' in reject(disturbed, stream[i - 1], Verdict.DROPPED)
    counters = disturbed.counters
    assert (counters.accepted, counters.invalid, counters.dropped['stamp']) == (6, 6, 11)


@pytest.mark.parametrize(('focal', 'is_named'), [(0.0, True), (600.0, False)])
def test_a_nominal_focal_length_is_named_once_after_seconds_of_people(
    focal: float, *, is_named: bool, stream: list[bytes]
) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    if focal:
        pipeline.set_camera_info(camera_info(focal=focal))
    frames = {float(s): with_stamp(stream[0], round(s * 1e9)) for s in np.arange(1, 9, 0.5)}
    reasons = {s: pipeline.feed(Source.KEYPOINTS, raw).reason for s, raw in frames.items()}
    assert [s for s, reason in reasons.items() if 'no CameraInfo' in reason] == ([3.5] if is_named else [])


def test_a_camera_info_that_does_not_fit_is_rejected(stream: list[bytes]) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    with pytest.raises(InputError, match='not calibrated, and width and height are 0'):
        pipeline.set_camera_info(camera_info(0, 0, focal=0))
    assert pipeline.camera_info is None
    pipeline.set_camera_info(camera_info(width=1280))
    reason = reject(pipeline, stream[0], Verdict.INVALID)
    assert 'CameraInfo is for 1280 x 480 px' in reason


# Distortion coefficients of two lenses, by distortion model.
LENSES = {'plumb_bob': (-0.28, 0.07, 0.001, -0.002, 0.0), 'equidistant': (-0.02, 0.004, -0.001, 0.0002)}


@pytest.mark.parametrize('model', LENSES)
def test_the_distortion_of_camera_info_is_removed(model: str, stream: list[bytes]) -> None:
    focal, lens = 600.0, LENSES[model]
    raw = camera_info(focal=focal, model=model, d=lens)
    camera = decode_camera_info(raw).intrinsics
    assert camera.distortion == Distortion(model, lens)
    pinhole = Intrinsics(focal, (320.0, 240.0), is_focal_known=True)
    distorted, undistorted = [], []
    for message in stream[:5]:
        frame = decode_keypoints(message, FAST_CONFIG.node)
        (person,) = frame.people
        seen = camera.distortion.distort(pinhole.pixels_to_rays(person.points)) * focal + np.array(pinhole.center)
        distorted.append(encode_keypoints(frame.header, (640, 480), [replace(person, points=seen)]))
        undistorted.append(encode_keypoints(frame.header, (640, 480), [person]))

    def joints(inputs: list[bytes], info: bytes, **values: object) -> np.ndarray:
        pipeline = Pipeline(with_values(FAST_CONFIG, values))
        pipeline.set_camera_info(info)
        people = [p for raw in inputs for p in decode_skeletons(process(pipeline, raw)).people]
        return np.array([[j.x, j.y, j.z] for person in people for j in person.joints[:CORE_COUNT]])

    expected = joints(undistorted, camera_info(focal=focal))
    np.testing.assert_allclose(joints(distorted, raw), expected, atol=2e-3)
    rectified = {'node.rectified_input': True}
    np.testing.assert_array_equal(joints(undistorted, raw, **rectified), expected)
    projection = (300.0, 0, 320.0, 0, 0, 300.0, 240.0, 0, 0, 0, 1.0, 0)
    half_focal = joints(undistorted, camera_info(model=model, d=lens, p=projection), **rectified)
    assert half_focal[0, 2] == pytest.approx(expected[0, 2] / 2, rel=0.01)  # measured: 0.0023


@pytest.mark.parametrize(
    ('change', 'restarts'),
    [
        ({'tracker.min_score': 0.5}, True),
        ({'solver.max_iterations': 5}, True),
        ({'node.marker_lifetime': 2.0}, False),
    ],
)
def test_parameters_restart_the_tracker(stream: list[bytes], change: dict[str, object], restarts: bool) -> None:
    changed_config = with_values(FAST_CONFIG, change)
    pipeline, fresh, unchanged = (Pipeline(c) for c in (FAST_CONFIG, changed_config, FAST_CONFIG))
    for raw in stream[:3]:
        process(pipeline, raw)
        process(unchanged, raw)
    assert pipeline.reconfigure(changed_config) == restarts
    skeletons, expected = (process(p, stream[3])[0] for p in (pipeline, fresh if restarts else unchanged))
    assert skeletons.topic == 'skeletons'
    assert skeletons == expected


@pytest.mark.parametrize(
    ('values', 'came_at', 'published', 'is_restarted'),
    [
        ({}, 0, 6, False),
        ({}, 3, 3, False),
        ({}, None, 0, False),
        ({'node.camera_info_wait': 0.1}, None, 3, False),
        ({'node.camera_info_wait': 0.1}, 5, 3, True),
        ({'node.hfov': 60.0}, None, 6, False),
        ({'node.focal': 600.0}, None, 6, False),
    ],
)
def test_people_wait_for_the_first_calibration_unless_a_focal_length_is_given(
    stream: list[bytes], values: dict[str, float], came_at: int | None, published: int, *, is_restarted: bool
) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.camera_info_wait': 1.0, **values}))
    results = []
    for number, raw in enumerate(stream):
        if number == came_at:
            pipeline.set_camera_info(camera_info())
        results.append(pipeline.feed(Source.KEYPOINTS, raw))
    assert all(result.verdict is Verdict.ACCEPTED for result in results)
    assert sum(bool(result.outputs) for result in results) == published
    assert any('CameraInfo came late' in result.reason for result in results) == is_restarted
    assert len({person.scale_known for person in pipeline.people}) == (published > 0)


@pytest.mark.parametrize(
    ('stamp_ns', 'reason'), [(0, 'header.stamp is not set'), (7_000_000_000, 'stamp 7000000000 ns repeats')]
)
def test_stamps_that_stand_still_are_told_while_waiting(stream: list[bytes], stamp_ns: int, reason: str) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.camera_info_wait': 1.0}))
    assert process(pipeline, with_stamp(stream[0], stamp_ns)) == ()
    for raw in stream[1:]:
        assert reason in reject(pipeline, with_stamp(raw, stamp_ns), Verdict.DROPPED)
    assert process(pipeline, with_stamp(stream[0], stamp_ns + 1_000_000_000))


def test_tentative_people_are_flagged_and_have_no_transforms(stream: list[bytes]) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, {'node.publish_tf': True}))
    shown = []
    for raw in stream:
        outputs = {o.topic: decode(o.data, o.type) for o in process(pipeline, raw)}
        (person,) = outputs['skeletons'].people
        assert list(outputs['cameras'].ids) == [person.id] == ['person_1']
        assert (len(outputs['markers'].markers), outputs['points'].width) == (2, 26)
        color = outputs['markers'].markers[0].color
        shown.append((person.tentative, color.r == color.g == color.b, len(outputs['/tf'].transforms)))
    assert shown == [(True, True, 0)] * 2 + [(False, False, 26)] * 4
