# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.keypoints.extremities import Extremities
from mocap_ros.skeleton import BODY26
from mocap_ros.solvers.contacts import HEELS_AND_TOES, find_contacts
from mocap_ros.solvers.extremities import ANCHORS
from mocap_ros.solvers.footing import Footing

UPWARD = np.array([0.0, -1.0, 0.0])
FEET = ('lheel', 'ltoe', 'rheel', 'rtoe')


def walk(rate_hz: float = 30.0, seconds: float = 4.5) -> tuple[NDArray[Any], ...]:
    """Joints (F, 26, 3) m, 4 m away: the right foot stands, the left one stands for 1 s and swings for 0.5 s."""
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    joints = np.zeros((len(times), 26, 3)) + [0.0, 0.0, 4.0]
    time = times % 1.5
    phase = (time - 1.0).clip(0) * 2
    swung = np.floor(times / 1.5) + phase
    for joint, x in (('lankle', 0.0), ('lheel', -0.05), ('ltoe', 0.2)):
        lift = -0.15 * np.sin(np.pi * phase)
        joints[:, BODY26.index(joint)] = np.stack([x + 0.6 * swung, 1.0 + lift, 0 * times + 4], axis=1)
    for joint, x in (('rankle', 0.3), ('rheel', 0.25), ('rtoe', 0.5)):
        joints[:, BODY26.index(joint)] = [x, 1.0, 4.0]
    return joints, times, (phase > 0.2) & (phase < 0.8), (time > 0.2) & (time < 0.8)


@pytest.mark.parametrize('rate_hz', [10.0, 30.0, 120.0])
@pytest.mark.parametrize('count', [26, 15])
def test_a_foot_that_swings_does_not_stand(rate_hz: float, count: int) -> None:
    joints, times, swings, stands = walk(rate_hz)
    joints = joints[:, :count]
    contact = find_contacts(joints[..., :2] / joints[..., 2:], np.ones(joints.shape[:2]), joints, UPWARD, times)
    assert contact.shape == (len(times), 4)
    assert contact[:, 2:].min() > 0.7
    assert contact[swings, :2].max() < 0.3
    assert contact[stands, :2].min() > 0.7


def test_points_of_detectors_and_points_that_are_not_seen() -> None:
    joints, times, swings, stands = walk()
    rays = joints[..., :2] / joints[..., 2:]
    rays = rays + np.random.default_rng(0).normal(0, 0.01, rays.shape) / 4  # 1 cm at the body
    weight = np.ones(joints.shape[:2])
    weight[40:50, HEELS_AND_TOES[2]] = 0  # the heel of the foot that stands is hidden
    contact = find_contacts(rays, weight, joints, UPWARD, times)
    assert contact[40:50, 2].min() > 0.7
    assert contact[swings, :2].mean() < 0.3
    assert contact[stands, :2].mean() > 0.7


def test_nothing_is_known_of_a_person_who_is_not_seen() -> None:
    joints, times, _, _ = walk()
    rays, weight = joints[..., :2] / joints[..., 2:], np.ones(joints.shape[:2])
    weight[10:, HEELS_AND_TOES[2:]] = 0  # behind a table from then on
    contact = find_contacts(rays, weight, joints, UPWARD, times)
    assert np.isfinite(contact[:, :2]).all()
    assert np.isfinite(contact[:30, 2:]).all()
    assert np.isnan(contact[110:, 2:]).all()
    contact = find_contacts(0 * joints[..., :2], 0 * joints[..., 0], joints * np.nan, UPWARD * np.nan, times)
    assert np.isnan(contact).all()
    single = find_contacts(np.zeros((1, 26, 2)), np.ones((1, 26)), joints[:1], UPWARD, times[:1])
    assert np.isnan(single).all()


@pytest.mark.parametrize('rate_hz', [10.0, 15.0, 20.0, 30.0])
def test_what_is_known_live_is_what_the_newest_frame_shows(rate_hz: float) -> None:
    joints, times, swings, stands = walk(rate_hz)
    rays, weight, footing = joints[..., :2] / joints[..., 2:], np.ones(joints.shape[:2]), None
    offsets = joints[:, 15:] - joints[:, ANCHORS]
    found, expected = np.empty((2, len(times), 2))
    for frame, time_s in enumerate(times):
        until = slice(frame + 1)
        cut = rays[until], weight[until], times[until]
        others = Extremities(cut[0][:, 15:].copy(), cut[1][:, 15:].copy())
        observed: Any = SimpleNamespace(
            times=cut[2], rays=cut[0][:, :15].copy(), weight=cut[1][:, :15].copy(), extremities=others
        )
        core = joints[frame, :15].copy()
        footing = Footing.advance(footing, time_s, core, offsets[frame], observed, frame, UPWARD, 0.01)
        found[frame] = footing.contact
        newest = find_contacts(*cut[:2], joints[until], UPWARD, cut[2])[-1]
        expected[frame] = np.fmax(newest[::2], newest[1::2])
    assert np.isnan(found[:2]).all()
    assert np.nanmean(np.abs(found - expected)) < 0.06
    assert found[10:, 1].min() > 0.9
    assert found[swings, 0].mean() < 0.3 < 0.7 < found[stands, 0].mean()
    observed.weight, observed.extremities = 0 * observed.weight, None  # behind a table from then on
    is_forgotten = np.zeros(150, bool)
    for ago in range(150):
        footing = Footing.advance(footing, times[-1] + ago, core, offsets[-1], observed, frame, UPWARD, 0.01)
        is_forgotten[ago] = np.isnan(footing.contact[1])
    assert np.argmax(is_forgotten) / rate_hz == pytest.approx(2.92, abs=0.05)


def test_without_the_vertical_the_speed_alone_counts() -> None:
    joints, times, swings, stands = walk()
    rays, weight = joints[..., :2] / joints[..., 2:], np.ones(joints.shape[:2])
    contact = find_contacts(rays, weight, joints, np.full(3, np.nan), times)
    assert contact[swings, :2].max() < 0.3 < 0.7 < contact[stands, :2].min()
