# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Predictions: where the people of an image will be at some times after it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.config import Config
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, SINGLE, MessageTemplate, TemplateWriter
from mocap_ros.people import HIPS, PredictedPerson
from mocap_ros.skeleton import CMU15

PREDICTIONS = MOCAP_ROS_MSGS + 'Predictions'
MAX_TIME_S = 1.0  # s; so far the motion predictor was trained
PREDICTING = 'publish_predictions', 'publish_prediction_markers'  # fields of `NodeConfig`
MAX_TIMES = 20  # more than a planner has use for; bounds what a message costs
_ROOT_NUMBERS = 3 + 9  # place and covariance


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
        frames: the people at each time, in the frame from which `camera` places them.
        camera: the camera in the frame of the header.
    """
    placed = [camera.place_predicted(people, ahead) for ahead, people in frames]
    everybody = [person for people in placed for person in people]
    template = _lay_out(header.frame_id, tuple([tuple([p.id for p in people]) for people in placed]))
    numbers: dict[str, ArrayLike] = {'ahead': [ahead for ahead, _ in frames]}
    if everybody:
        joints = np.array([p.joints for p in everybody])
        numbers |= {
            'joints': joints,
            'std': np.array([p.std for p in everybody]),
            'roots': np.concatenate(
                [
                    (joints[:, HIPS[0]] + joints[:, HIPS[1]]) / 2,
                    np.array([p.root_covariance for p in everybody]).reshape(-1, 9),
                ],
                axis=1,
            ),
        }
    return template.fill(header.stamp_ns, **numbers)


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[tuple[str, ...], ...]) -> MessageTemplate:
    """Return the template for people with some ids at each time."""
    writer, joints = TemplateWriter(), len(CMU15.joints)
    writer.add_stamped(frame_id)
    writer.add_text(CMU15.name)
    writer.add_count(len(ids))
    for of_time in ids:
        writer.add_numbers('ahead', SINGLE, 1)
        writer.add_count(len(of_time))
        for person_id in of_time:
            writer.add_text(person_id)
            writer.add_number_sequence('joints', DOUBLE, joints, 3)
            writer.add_number_sequence('std', SINGLE, joints)
            writer.add_numbers('roots', DOUBLE, _ROOT_NUMBERS)
    return writer.finish_template()
