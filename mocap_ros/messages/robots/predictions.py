"""mocap_ros_msgs/Predictions: where the people of an image will be at some times after it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mocap_ros.config import Config
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, CdrWriter, Header
from mocap_ros.people import PredictedPerson
from mocap_ros.skeleton import CMU15

PREDICTIONS = MOCAP_ROS_MSGS + 'Predictions'
MAX_TIME_S = 1.0  # s; so far the motion predictor was trained
PREDICTING = 'publish_predictions', 'publish_prediction_markers'  # fields of `NodeConfig`
MAX_TIMES = 20  # more than a planner has use for; bounds what a message costs
_AHEAD = struct.Struct('<f')


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
    asking = [f for f in PREDICTING if getattr(config.node, f)]
    if not asking:
        return ()
    if config.tracker.lag > 0:
        raise ConfigError(f'node.{asking[0]}: needs tracker.lag = 0, as an output with a lag is of the past')
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
        header: time of the image, and the frame in which the people are put out.
        frames: the people at each time, in the camera's optical frame.
        camera: the camera in the frame of the header.
    """
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_text(CMU15.name)
    writer.add_count(len(frames))
    for ahead, people in frames:
        writer.add(4, _AHEAD.pack(ahead))
        writer.add_count(len(people))
        for person in camera.place_predicted(people, ahead):
            writer.add_text(person.id)
            writer.add_sequence(np.asarray(person.joints, np.float64))
            writer.add_sequence(person.std.astype(np.float32))
            writer.add(8, np.concatenate([person.root, person.root_covariance.ravel()]).tobytes())
    return writer.finish()
