# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of openpose_ros2."""

from __future__ import annotations

from typing import Any

import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.definitions import OPENPOSE_POSES
from mocap_ros.messages.input_types import decode_frame
from tests.support.foreign_messages import IMAGE_SIZE, LIMITS, edit_message


def test_a_number_of_keypoints_without_a_layout_is_refused() -> None:
    def remove_keypoint(message: Any) -> None:
        message.pose_key_points_list[1].pose_key_points.pop()

    error = r'pose_key_points_list\[1\].pose_key_points: 16 joints, expected 17, 18, 25'
    with pytest.raises(InputError, match=f'^{error}'):
        decode_frame(edit_message(OPENPOSE_POSES, remove_keypoint), OPENPOSE_POSES, LIMITS, IMAGE_SIZE)
