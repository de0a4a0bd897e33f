# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Of several cameras on one topic one is used, whatever their clocks say."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import Header
from mocap_ros.runtime.camera_switch import MAX_DISPLACED, SILENCE_S, CameraSwitch

PERIOD_S = 1 / 30
SKEW_S = 3.0  # by which the clocks of two cameras differ


def send(switch: CameraSwitch, camera: str, seconds: float) -> str:
    """Offer an image; return 'used', 'taken over' or 'refused'."""
    header = Header(round(seconds * 1e9), camera)
    try:
        remark = switch.check(header)
    except InputError as error:
        return 'refused' if f'{camera!r}, but the people of {switch.name!r}' in str(error) else str(error)
    switch.accept(header)
    return 'taken over' if remark else 'used'


def send_in_turn(
    switch: CameraSwitch, skews: dict[str, float], times: Iterable[float]
) -> Counter[tuple[str, str]]:
    """Send an image of each camera at each time; return how often each of them had each result."""
    return Counter((name, send(switch, name, t + skew)) for t in times for name, skew in skews.items())


def make_times(start_s: float, count: int = 90) -> list[float]:
    return [start_s + n * PERIOD_S for n in range(count)]


@pytest.mark.parametrize('skew', [SKEW_S, -SKEW_S, 1e9])
def test_cameras_whose_clocks_differ_displace_each_other_once(skew: float) -> None:
    found = send_in_turn(CameraSwitch(), {'front': 0.0, 'back': skew}, make_times(10.0))
    assert found == {
        ('front', 'used'): 1,
        ('back', 'taken over'): 1,
        ('front', 'refused'): 89,
        ('back', 'used'): 89,
    }


def test_three_cameras_whose_clocks_differ_displace_each_other_once() -> None:
    found = send_in_turn(CameraSwitch(), {'a': 0.0, 'b': SKEW_S, 'c': 2 * SKEW_S}, make_times(10.0))
    assert sum(n for (_, result), n in found.items() if result == 'taken over') == 2
    assert found['c', 'used'] == 89


def test_a_camera_that_was_displaced_takes_over_when_the_other_is_silent() -> None:
    switch = CameraSwitch()
    send_in_turn(switch, {'front': 0.0, 'back': SKEW_S}, times := make_times(10.0))
    results = [send(switch, 'front', times[-1] + n * PERIOD_S) for n in range(1, 40)]
    assert results.index('taken over') == pytest.approx(SILENCE_S / PERIOD_S, abs=1)
    assert set(results[results.index('taken over') + 1 :]) == {'used'}


def test_a_pause_of_the_camera_in_use_is_no_time_in_which_it_sends() -> None:
    switch = CameraSwitch()
    send_in_turn(switch, {'front': 0.0, 'back': SKEW_S}, make_times(10.0))
    assert send(switch, 'back', 500.0) == 'used'
    assert send(switch, 'front', 498.0) == 'taken over'


def test_a_displaced_camera_whose_clock_was_set_back_takes_over_a_second_later() -> None:
    switch = CameraSwitch()
    send_in_turn(switch, {'front': 0.0, 'back': SKEW_S}, make_times(10.0))
    results = [send(switch, 'front', 2.0 + n * PERIOD_S) for n in range(40)]
    assert results.index('taken over') == pytest.approx(SILENCE_S / PERIOD_S, abs=1)


def test_images_without_a_name_are_of_the_camera_in_use() -> None:
    switch = CameraSwitch()
    assert [send(switch, name, 1.0) for name in ('', 'front', '')] == ['used'] * 3
    assert send(switch, 'back', 1.5) == 'refused'


def test_ever_new_cameras_cost_no_memory() -> None:
    switch = CameraSwitch()
    for n in range(5 * MAX_DISPLACED):
        assert send(switch, f'camera {n}', 10.0 * n) == ('taken over' if n else 'used')
    assert len(switch._displaced) == MAX_DISPLACED
