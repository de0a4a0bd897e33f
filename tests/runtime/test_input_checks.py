# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in keypoints and calibrations are described once, after seconds; of several cameras one is used."""

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import pytest

from mocap_ros.bags.topics import Source
from mocap_ros.config import with_values
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.messages.camera_info import CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.input_camera import SILENCE_S, InputCamera
from mocap_ros.runtime.input_checks import describe_misspelt_joint
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.skeleton import KEYPOINT_LAYOUTS, keypoint_layout
from tests.support.camera_infos import camera_info
from tests.support.message_objects import encode
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


def name_as_h36m(person: Any) -> None:
    person.skeleton, person.joint_names = 'h36m17', []


def move(change: Callable[[Any, Any], Any]) -> Callable[[Any], None]:
    """Return an edit of the points (x, y) of a person."""

    def edit(person: Any) -> None:
        person.x, person.y = change(person.x, person.y)

    return edit


turn_around = move(lambda x, y: (640 - x, 480 - y))


def list_reasons(pipeline: Pipeline, frames: list[bytes]) -> list[str]:
    if pipeline.camera_info is None:  # which would be a problem of its own
        pipeline.set_camera_info(camera_info())
    reasons = []
    for raw in frames:
        reasons.append(pipeline.feed(Source.KEYPOINTS, raw).reason)
        for _ in range(20):  # the readings of a stretch, which are measured one after another
            assert not pipeline.run_deferred_work()
    return reasons


@pytest.mark.parametrize(
    ('edit', 'problem'),
    [
        (name_as_h36m, 'people: these look like coco17, not h36m17: use --layout coco17'),
        (reverse_joints, 'people: these look like coco17, not the given joints'),
        (move(lambda x, y: (y, x)), 'people: (x and y look exchanged|people lie)'),
        (
            move(lambda x, y: (x / 2, y / 2)),
            'people: all points lie in the upper left quarter',
        ),
        (
            move(lambda x, y: (3 * x, 3 * y)),
            r'people: \d+% of the seen keypoints lie outside 640',
        ),
    ],
)
def test_a_mistake_is_kept_until_mended(stream: list[bytes], edit: Callable[[Any], None], problem: str) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    wrong = [edit_people(raw, edit) for raw in stream]
    reasons = list_reasons(pipeline, wrong)
    (made,) = (r for r in reasons if r)
    assert re.match(problem, made)
    assert not any(reasons[: int(1.0 / STEP_S)]), 'not before a second'
    (kept,) = pipeline.checks.warnings
    assert re.match(problem, kept)
    assert pipeline.summary.summarise().grade in ('doubtful', 'wrong')
    later = [with_stamp(raw, round((10 + i * STEP_S) * 1e9)) for i, raw in enumerate(2 * stream)]
    assert [r for r in list_reasons(pipeline, later) if r] == []
    assert pipeline.checks.warnings == ()
    pipeline.reset()
    assert sum(map(bool, list_reasons(pipeline, wrong))) == 1, 'a reset forgets what was reported'
    pipeline.reset()
    assert pipeline.checks.warnings == ()


def test_nothing_is_reported_on_right_points(stream: list[bytes]) -> None:
    assert not any(list_reasons(Pipeline(FAST_CONFIG), stream))


@pytest.mark.parametrize(
    ('edit', 'step_s', 'values', 'problem'),
    [
        (reverse_joints, 0.5, {}, 'people: the points do not fit'),  # too slow for the lifter
        (turn_around, STEP_S, {}, 'people: people lie or are upside down'),
        (turn_around, STEP_S, {'node.output_frame': 'map', 'node.camera_pose': '0 0 1 3.1416 0 0'}, ''),
    ],
)
def test_points_are_judged_at_any_rate_and_by_a_vertical_that_is_given(
    stream: list[bytes], edit: Callable[[Any], None], step_s: float, values: dict[str, object], problem: str
) -> None:
    frames = [with_stamp(edit_people(raw, edit), round((1 + i * step_s) * 1e9)) for i, raw in enumerate(stream)]
    reasons = filter(None, list_reasons(Pipeline(with_values(FAST_CONFIG, values)), frames))
    assert [reason.startswith(problem) for reason in reasons] == [True] * bool(problem)


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
    pipeline = Pipeline(FAST_CONFIG)
    assert pipeline.feed(Source.CAMERA_INFO, encode_camera_info(Header(0, ''), CameraInfo((640, 480), camera)))
    reasons = list_reasons(pipeline, encode_demo_frames(3))
    assert ['distortion of the camera: it cannot be undone' in reason for reason in reasons] == [is_unusable, 0, 0]


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
def test_misspelt_joints_that_are_missing_are_described(wrong: str, right: str, meant: str) -> None:
    names = tuple(wrong if j == right else j for j in SPELT_OUT)
    expected = f'joint_names: {wrong!r} is no known joint and is ignored; is it {meant!r}?' if meant else ''
    assert describe_misspelt_joint(names) == expected
    assert describe_misspelt_joint((*names, right)) == '', 'an extra joint beside the right one'


def test_no_layout_has_misspelt_joints() -> None:
    assert not any(describe_misspelt_joint(layout.joints) for layout in KEYPOINT_LAYOUTS.values())


PERIOD_S = 1 / 30
SKEW_S = 3.0  # by which the clocks of two cameras differ


def send(camera: InputCamera, name: str, seconds: float) -> str:
    """Offer an image; return 'used', 'replaced' (the camera before it) or 'refused'."""
    header = Header(round(seconds * 1e9), name)
    try:
        restart, calibration = camera.check(header)
    except InputError as error:
        return 'refused' if f'{name!r}, but the people of {camera.name!r}' in str(error) else str(error)
    camera.accept(header, calibration)
    return 'replaced' if restart else 'used'


def send_in_turn(camera: InputCamera, skews: dict[str, float], times: Iterable[float]) -> Counter[tuple[str, str]]:
    """Send an image of each camera at each time; return how often each of them had each result."""
    return Counter((name, send(camera, name, t + skew)) for t in times for name, skew in skews.items())


def make_times(start_s: float, count: int = 90) -> list[float]:
    return [start_s + n * PERIOD_S for n in range(count)]


@pytest.mark.parametrize('skews', [[0, 0.01], [0, -SKEW_S], [0, 1e9], [0, SKEW_S, 2 * SKEW_S]])
def test_of_cameras_that_send_in_turn_the_first_is_used_whatever_their_clocks_say(skews: list[float]) -> None:
    found = send_in_turn(InputCamera(), {str(i): skew for i, skew in enumerate(skews)}, make_times(10.0))
    assert found == {('0', 'used'): 90, **{(str(i), 'refused'): 90 for i in range(1, len(skews))}}


@pytest.mark.parametrize('first_s', [13.0, 2.0])
def test_another_camera_is_used_when_the_first_is_silent(first_s: float) -> None:
    camera = InputCamera()
    send_in_turn(camera, {'front': 0.0, 'back': SKEW_S}, make_times(10.0))
    results = [send(camera, 'back', first_s + n * PERIOD_S) for n in range(40)]
    assert results.index('replaced') == pytest.approx(SILENCE_S / PERIOD_S, abs=1)
    assert set(results[results.index('replaced') + 1 :]) == {'used'}


def test_images_without_a_name_are_of_the_camera_in_use() -> None:
    camera = InputCamera()
    assert [send(camera, name, 1.0) for name in ('', 'front', '')] == ['used'] * 3
    assert send(camera, 'back', 1.5) == 'refused'


def calibrate(name: str, focal: float) -> CameraInfo:
    return CameraInfo((640, 480), Intrinsics(focal, (320.0, 240.0), is_focal_known=True), name)


def test_each_camera_is_used_with_its_own_camera_info() -> None:
    camera = InputCamera()
    front, back = calibrate('front', 500.0), calibrate('back', 900.0)
    for calibration in (back, front):  # before the first image, any camera may be that of the images
        camera.add_calibration(calibration)
    send(camera, 'front', 1.0)
    with pytest.raises(InputError, match="'back', but the people of 'front' are being tracked"):
        camera.add_calibration(back)
    assert [send(camera, 'back', 5.0 + later) for later in (0.0, SILENCE_S)] == ['refused', 'replaced']
    assert camera.calibration is None
    for calibration in (calibrate('', 501.0), back):
        camera.add_calibration(calibration)
        assert camera.calibration is calibration, 'what has no name, or another one, may be of any camera'
    uncalibrated = Intrinsics(480.0, (320.0, 240.0), is_focal_known=False)
    camera.add_calibration(CameraInfo((640, 480), uncalibrated, 'back'))
    assert camera.calibration is back
