# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shots end at cuts and after absences, not where left and right are swapped; sections cover a sequence once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.config import TrackerConfig
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.offline.keyframes.keyframe_method import observe_shots
from mocap_ros.offline.keyframes.shots import find_shots, split_into_sections
from mocap_ros.skeleton import CMU15
from tests.support.swinging_body import make_swinging_body

Array = NDArray[np.float64]

CAMERA = Intrinsics(900.0, (640.0, 360.0), is_focal_known=True)
MIRROR = list(CMU15.mirror)
FRAMES = 90


def make_rays(frames: int = FRAMES) -> tuple[Array, Array, Array]:
    """Return rays (F, 15, 2), weights (F, 15) and times (F,) s of a person who moves without a cut."""
    poses, times = make_swinging_body(frames)
    joints = poses + [0.2, 0.0, 4.0]
    return joints[..., :2] / joints[..., 2:], np.ones((frames, 15)), times


def list_starts(shots: list[slice]) -> list[int]:
    assert shots[-1].stop == FRAMES
    assert [s.stop for s in shots[:-1]] == [s.start for s in shots[1:]]
    return [s.start for s in shots]


@pytest.mark.parametrize('unit', [1.0, 900.0], ids=['rays', 'px'])
def test_a_jump_of_the_body_is_a_cut_and_swapped_sides_are_none(unit: float) -> None:
    rays, weight, times = make_rays()
    rays[20:24] = rays[20:24][:, MIRROR]
    rays[40, 3] += 0.5  # one joint is misplaced
    assert list_starts(find_shots(unit * rays, weight, times)) == [0]
    rays[50:] += 0.2
    assert list_starts(find_shots(unit * rays, weight, times)) == [0, 50]


def test_swapped_sides_are_put_right_in_each_shot() -> None:
    rays, weight, times = make_rays()
    rays[50:] += 0.2
    keypoints = np.concatenate([CAMERA.focal * rays + CAMERA.center, weight[..., None]], axis=-1)
    swapped = keypoints.copy()
    for frames in (slice(20, 24), slice(60, 63)):
        swapped[frames] = keypoints[frames][:, MIRROR]
    observed = observe_shots(swapped, CMU15.joints, times, CAMERA, TrackerConfig())
    assert observed.rays == pytest.approx(rays, abs=1e-9)


@pytest.mark.parametrize(('max_seconds', 'count'), [(60.0, 1), (1.0, 3), (0.5, 6)])
def test_sections_cover_each_frame_once_and_their_margins(max_seconds: float, count: int) -> None:
    times = np.arange(FRAMES) / 30
    sections = split_into_sections(times, max_seconds, margin=0.2)
    assert len(sections) == count
    assert np.concatenate([np.arange(FRAMES)[inner] for _, inner in sections]).tolist() == list(range(FRAMES))
    for padded, inner in sections:
        assert padded.start == max(inner.start - 6, 0)
        assert inner.stop <= padded.stop <= inner.stop + 6
