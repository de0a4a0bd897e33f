# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Predictions: where the people of an image will be at some times after it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mocap_ros.config import Config
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header
from mocap_ros.messages.plain import encode_plain
from mocap_ros.people import PredictedPerson
from mocap_ros.skeleton import CMU15

PREDICTIONS = MOCAP_ROS_MSGS + 'Predictions'
MAX_TIME_S = 1.0  # s; so far the motion predictor was trained
MAX_TIMES = 20  # more than a planner has use for; bounds what a message costs


class PredictedFrame(NamedTuple):
    """The people at one time after an image.

    Attributes:
        ahead: s after the image.
        people: the people then, in the camera's optical frame.
    """

    ahead: float
    people: Sequence[PredictedPerson]


def read_prediction_times(config: Config) -> tuple[float, ...]:
    """Return the times in s for which the parameters ask for predictions; none if these are not published.

    Raises:
        ConfigError: `node.prediction_times` is not some times up to `MAX_TIME_S`, or there is a `tracker.lag`.
    """
    if not config.node.publish_predictions:
        return ()
    if config.tracker.lag > 0:
        raise ConfigError(
            'node.publish_predictions: needs tracker.lag = 0, as an output with a lag is of the past'
        )
    text = config.node.prediction_times
    try:
        times = tuple(float(word) for word in text.replace(',', ' ').split())
    except ValueError:
        times = ()
    if not 0 < len(times) <= MAX_TIMES or not all(0 < t <= MAX_TIME_S for t in times):
        raise ConfigError(
            f'node.prediction_times = {text!r}: expected one to {MAX_TIMES} times in s, above 0 and up to '
            f'{MAX_TIME_S:g}, separated by blanks or commas, such as 0.2 0.4'
        )
    return times


def encode_predictions(header: Header, frames: Sequence[PredictedFrame], camera: CameraPlacement) -> bytes:
    """Encode predicted people.

    Args:
        header: time of the image, and the frame of the outputs.
        frames: the people at each time, in the frame from which `camera` places them.
        camera: the camera in the frame of the header.
    """
    times = []
    for ahead, people in frames:
        placed = camera.place_predicted(people, ahead)
        times.append((ahead, [(p.id, p.joints, p.std, p.root, p.root_covariance) for p in placed]))
    return encode_plain((header, CMU15.name, times), PREDICTIONS)
