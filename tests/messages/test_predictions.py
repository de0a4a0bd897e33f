# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Predictions as messages: in the frame of the outputs, at the times that the parameters name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.geometry.rigid_transform import parse_camera_pose
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.skeletons import PREDICTIONS, PredictedFrame, encode_predictions, read_prediction_times
from mocap_ros.people import PredictedPerson
from mocap_ros.skeleton import CMU15
from tests.support.swinging_body import STANDING

HEADER = Header(12_345_678_901, 'map')


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def test_predictions_are_put_out_in_the_frame_of_the_outputs() -> None:
    camera = CameraPlacement('camera', parse_camera_pose('0 0 1.5 0 0 1.57', 'test'))
    covariance = np.diag([0.01, 0.04, 0.09])
    person = PredictedPerson('anna', STANDING + [2.0, 2.0, 0.0], np.full(15, 0.1), covariance)
    raw = encode_predictions(HEADER, [PredictedFrame(0.2, []), PredictedFrame(0.4, [person])], camera)
    message = decode(raw, PREDICTIONS)
    assert (message.header.frame_id, message.skeleton) == ('map', CMU15.name)
    soon, later = message.times
    assert [soon.ahead, later.ahead] == pytest.approx([0.2, 0.4])
    assert soon.people == []
    (anna,) = later.people
    pose = camera.pose
    assert pose is not None
    np.testing.assert_allclose([xyz(p) for p in anna.joints], pose.apply(person.joints), atol=1e-12)
    np.testing.assert_allclose(xyz(anna.root), pose.apply(person.root), atol=1e-12)
    np.testing.assert_allclose(anna.root_covariance.reshape(3, 3), pose.rotate_covariance(covariance))
    np.testing.assert_allclose(anna.joint_std, 0.1, rtol=1e-6)
    assert anna.id == 'anna'
    driving = camera._replace(before=parse_camera_pose('-0.1 0 1.5 0 0 1.57', 'test'), step_s=0.1)
    raw = encode_predictions(HEADER, [PredictedFrame(0.4, [person])], driving)
    root = decode(raw, PREDICTIONS).times[0].people[0].root
    np.testing.assert_allclose(np.array(xyz(root)) - xyz(anna.root), [0.4, 0, 0], atol=1e-9)  # at 1 m/s along x


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'node.prediction_times': ''}, r"node\.prediction_times = '': expected one to 20 times in s"),
        ({'node.prediction_times': '0.2 1.5'}, r'up to 1, separated'),
        ({'node.prediction_times': '0.2 soon'}, r'such as 0\.2 0\.4'),
        ({'node.prediction_times': '0.2 nan'}, r'above 0'),
        ({'node.prediction_times': '0.1 ' * 21}, r'one to 20'),
        ({'tracker.lag': 0.2}, r'node\.publish_predict\w+: needs tracker\.lag = 0'),
    ],
)
def test_wrong_prediction_times_are_refused_only_where_they_are_used(
    values: dict[str, object], message: str
) -> None:
    assert read_prediction_times(with_values(Config(), values)) == ()
    with pytest.raises(ConfigError, match=message):
        read_prediction_times(with_values(Config(), {**values, 'node.publish_predictions': True}))
