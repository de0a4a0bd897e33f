# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the pictures draw: the view from the side, and the error over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.skeleton import CMU15
from mocap_ros.viewing import plots
from tests.support.swinging_body import make_swinging_body

FRAMES = 30


@pytest.fixture
def data() -> plots.PlotData:
    poses, times = make_swinging_body(FRAMES)
    truth = poses + [0.3, 0.1, 4.0]
    return plots.PlotData(
        times=times,
        keypoints=np.concatenate([truth[..., :2] * 100, np.ones((FRAMES, 15, 1))], axis=-1),
        keypoint_skeleton=CMU15,
        joints=truth,
        seen=np.ones((FRAMES, 15), bool),
        skeleton=CMU15,
        truth=truth,
    )


def read_errors_mm(data: plots.PlotData) -> np.ndarray:
    figure = plots.draw_poses_figure(data, [0, 10], 'title', ['a', 'b'])
    (line, *_) = figure.axes[-2].lines
    return np.asarray(line.get_ydata())


def test_the_error_is_that_of_the_centred_joints(data: plots.PlotData) -> None:
    assert read_errors_mm(replace(data, joints=data.joints + [0.5, 0, 1])) == pytest.approx(0, abs=1e-9)
    joints = data.joints.copy()
    joints[3, 0] += [0.15, 0, 0]  # the other 14 joints move by -10 mm with the centre
    errors = read_errors_mm(replace(data, joints=joints))
    assert errors[3] == pytest.approx((140 + 14 * 10) / 15)
    assert np.delete(errors, 3) == pytest.approx(0, abs=1e-9)


def test_the_share_of_joints_that_were_not_seen_is_filled(data: plots.PlotData) -> None:
    seen = data.seen.copy()
    seen[5:9, :3] = False
    figure = plots.draw_poses_figure(replace(data, seen=seen), [0], 'title', ['a'])
    (band,) = figure.axes[-1].collections
    vertices = np.asarray(band.get_paths()[0].vertices)
    assert vertices[:, 1].max() == pytest.approx(3 / 15)
    filled = vertices[vertices[:, 1] > 0, 0]
    assert [filled.min(), filled.max()] == pytest.approx([data.times[5], data.times[8]])
