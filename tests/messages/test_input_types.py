# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""All accepted message types give the same people, and their faults are refused by field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.messages.foreign_types import OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import ZED38, decode_body, decode_frame
from tests.support.foreign_messages import (
    IMAGE_SIZE,
    LIMITS,
    edit_message,
    encode_body,
    make_header,
    make_inputs,
    make_people,
)


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


def set_keypoint_id(value: int) -> Callable[[Any], None]:
    return lambda m: setattr(m.detections[1].keypoints.data[2], 'id', value)


@pytest.mark.parametrize(
    ('msgtype', 'edit', 'error'),
    [
        (YOLO_DETECTIONS, set_keypoint_id(0), r'detections\[1\].keypoints.data\[2\].id: 0, expected 1 to 17'),
        (YOLO_DETECTIONS, set_keypoint_id(18), r'detections\[1\].keypoints.data\[2\].id: 18, expected'),
        (YOLO_DETECTIONS, set_keypoint_id(17), r'detections\[1\].keypoints.data\[2\].id: 17 twice'),
        (YOLO_DETECTIONS, lambda m: setattr(m.detections[1], 'id', 'b0'), "detections: id 'b0' twice"),
        (
            YOLO_DETECTIONS,
            lambda m: setattr(m.detections[0].keypoints.data[0], 'score', np.inf),
            r'detections\[0\].keypoints: score\[16\]: inf, expected',
        ),
        (ZED_OBJECTS, lambda m: setattr(m.objects[0], 'body_format', 4), r'objects\[0\].body_format: 4, expected'),
        (ZED_OBJECTS, lambda m: setattr(m.header.stamp, 'sec', -1), 'header.stamp: -1 s'),
        (
            OPENPOSE_POSES,
            lambda m: m.pose_key_points_list[1].pose_key_points.pop(),
            r'pose_key_points_list\[1\].pose_key_points: 16 joints, expected 17, 18, 25',
        ),
    ],
)
def test_faults_are_refused_by_field(msgtype: str, edit: Callable[[Any], None], error: str) -> None:
    with pytest.raises(InputError, match=f'^{error}'):
        decode_frame(edit_message(msgtype, edit), msgtype, LIMITS, IMAGE_SIZE)


def test_keypoint_scores_of_the_zed_are_used_if_the_message_has_them() -> None:
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


def test_normalised_coordinates_of_ros4hri_need_the_image_size() -> None:
    (person, _), header = make_people(0), make_header(0)
    with pytest.raises(InputError, match=r'^skeleton: .*node\.image_width'):
        decode_body(encode_body(person, header), person.id, (0, 0), LIMITS)
