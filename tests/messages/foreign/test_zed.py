# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of the ZED wrapper."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.definitions import ZED_OBJECTS
from mocap_ros.messages.input_types import ZED38, decode_frame
from tests.support.foreign_messages import IMAGE_SIZE, LIMITS, edit_message


def test_keypoint_scores_are_used_if_the_message_has_them() -> None:
    def set_scores(message: Any) -> None:
        scores = np.full(70, np.nan, np.float32)
        scores[[ZED38['nose'], ZED38['lknee']]] = 90, 35
        message.objects[0].skeleton_keypoint_confidence = scores
        message.objects[1].skeleton_keypoint_confidence = np.zeros(70, np.float32)  # as a version without scores

    scored, unscored = decode_frame(edit_message(ZED_OBJECTS, set_scores), ZED_OBJECTS, LIMITS, IMAGE_SIZE).people
    assert {j: s for j, s in zip(scored.joints, scored.score, strict=True) if s} == pytest.approx(
        {'nose': 0.9, 'lknee': 0.35}
    )
    assert set(unscored.score) == {0.0, 0.8}


INVALID = {
    'body format': (lambda m: setattr(m.objects[0], 'body_format', 4), r'objects\[0\].body_format: 4, expected'),
    'stamp': (lambda m: setattr(m.header.stamp, 'sec', -1), 'header.stamp: -1 s'),
}


@pytest.mark.parametrize('case', INVALID)
def test_an_invalid_message_is_refused_by_field(case: str) -> None:
    edit, error = INVALID[case]
    with pytest.raises(InputError, match=f'^{error}'):
        decode_frame(edit_message(ZED_OBJECTS, edit), ZED_OBJECTS, LIMITS, IMAGE_SIZE)
