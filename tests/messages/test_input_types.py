# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""All accepted message types give the same people."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.messages.foreign.definitions import OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import decode_frame
from tests.support.foreign_messages import IMAGE_SIZE, LIMITS, make_header, make_inputs, make_people


@pytest.mark.parametrize('msgtype', [YOLO_DETECTIONS, ZED_OBJECTS, OPENPOSE_POSES])
def test_all_types_give_the_same_people(msgtype: str) -> None:
    _, raw, _ = make_inputs(msgtype, 0)[0]
    frame = decode_frame(raw, msgtype, LIMITS, IMAGE_SIZE)
    assert (frame.header, frame.image_width, frame.image_height) == (make_header(0), *IMAGE_SIZE)
    assert len(frame.people) == 2
    for decoded, original in zip(frame.people, make_people(0), strict=True):
        expected, _ = build_joint_map(original.joints).apply(original.points, original.score)
        points, score = build_joint_map(decoded.joints).apply(decoded.points, decoded.score)
        np.testing.assert_allclose(points, expected, atol=1e-3)
        assert ((score > 0) == np.isfinite(expected[:, 0])).all()
    expected_ids = {YOLO_DETECTIONS: ['b0', 'b1'], ZED_OBJECTS: ['0', '1'], OPENPOSE_POSES: ['', '']}
    assert [p.id for p in frame.people] == expected_ids[msgtype]
