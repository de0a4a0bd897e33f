# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of yolo_ros."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.definitions import YOLO_DETECTIONS
from mocap_ros.messages.input_types import decode_frame
from tests.support.foreign_messages import IMAGE_SIZE, LIMITS, edit_message


def set_keypoint_id(value: int) -> Callable[[Any], None]:
    return lambda m: setattr(m.detections[1].keypoints.data[2], 'id', value)


INVALID = {
    'keypoint id 0': (set_keypoint_id(0), r'detections\[1\].keypoints.data\[2\].id: 0, expected 1 to 17'),
    'keypoint id 18': (set_keypoint_id(18), r'detections\[1\].keypoints.data\[2\].id: 18, expected'),
    'keypoint id twice': (set_keypoint_id(17), r'detections\[1\].keypoints.data\[2\].id: 17 twice'),
    'person id twice': (lambda m: setattr(m.detections[1], 'id', 'b0'), "detections: id 'b0' twice"),
    'score': (
        lambda m: setattr(m.detections[0].keypoints.data[0], 'score', 700.0),
        r'detections\[0\].keypoints: score\[16\]: 700, expected',
    ),
}


@pytest.mark.parametrize('case', INVALID)
def test_an_invalid_message_is_refused_by_field(case: str) -> None:
    edit, error = INVALID[case]
    with pytest.raises(InputError, match=f'^{error}'):
        decode_frame(edit_message(YOLO_DETECTIONS, edit), YOLO_DETECTIONS, LIMITS, IMAGE_SIZE)
