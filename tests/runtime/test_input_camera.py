# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Of several cameras on one topic one is used, whatever their clocks say, each with its own CameraInfo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pytest

from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.messages.camera_info import CameraInfo
from mocap_ros.messages.cdr import Header
from mocap_ros.runtime.input_camera import SILENCE_S, Calibration, InputCamera

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


def calibrate(name: str, focal: float) -> Calibration:
    return Calibration(CameraInfo((640, 480), Intrinsics(focal, (320.0, 240.0), is_focal_known=True), name), b'')


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
