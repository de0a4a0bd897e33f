# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""All accepted message types give the same people, and their faults are refused by field."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.topics import Source
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import decode, encode
from mocap_ros.messages.foreign_types import HRI_SKELETON, OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import ZED38, decode_body, decode_frame
from mocap_ros.runtime.input_checks import MIN_BOX_IMAGES
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.foreign_messages import (
    IMAGE_SIZE,
    LIMITS,
    edit_message,
    encode_body,
    make_config,
    make_header,
    make_inputs,
    make_people,
)


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


def mark_yolo(message: Any, x: float, y: float) -> None:
    keypoint = message.detections[0].keypoints.data[0]
    keypoint.id, keypoint.point.x, keypoint.point.y = 4, x, y  # the left ear, which is absent


# How a keypoint of the first person is set in a message of each type to x and y in px; its score stays.
SET_KEYPOINT: dict[str, Callable[[Any, float, float], None]] = {
    YOLO_DETECTIONS: mark_yolo,
    ZED_OBJECTS: lambda m, *p: setattr(m.objects[0].skeleton_2d.keypoints[ZED38['nose']], 'kp', np.array(p, 'f4')),
    OPENPOSE_POSES: lambda m, x, y: vars(m.pose_key_points_list[0].pose_key_points[0]).update(x=x, y=y),
    HRI_SKELETON: lambda m, x, y: vars(m.skeleton[0]).update(x=x, y=y),
}


@pytest.mark.parametrize('msgtype', SET_KEYPOINT)
@pytest.mark.parametrize('point', [(0, 0), (-1, -1), (np.nan, np.nan), (np.nan, 5)])
def test_what_marks_a_point_as_not_seen_is_the_same_in_all_types(msgtype: str, point: tuple[float, float]) -> None:
    def edit(message: Any) -> None:
        SET_KEYPOINT[msgtype](message, *point)

    if msgtype == HRI_SKELETON:
        raw = encode_body(make_people(0)[0], make_header(0))
        message = decode(raw, HRI_SKELETON)
        edit(message)
        _, person = decode_body(encode(message, HRI_SKELETON), 'b0', IMAGE_SIZE, LIMITS)
    else:
        person = decode_frame(edit_message(msgtype, edit), msgtype, LIMITS, IMAGE_SIZE).people[0]
    joint = person.joints.index('lear' if msgtype == YOLO_DETECTIONS else 'nose')
    assert person.score[joint] == 0
    assert np.isnan(person.points[joint]).all()
    assert (person.score > 0).sum() >= 14


def test_detections_that_are_no_people_are_counted() -> None:
    def edit(message: Any) -> None:
        message.detections[0].class_name = 'dog'
        message.detections[1].keypoints.data = []

    frame = decode_frame(edit_message(YOLO_DETECTIONS, edit), YOLO_DETECTIONS, LIMITS, IMAGE_SIZE)
    assert (frame.people, frame.without_keypoints) == ((), 2)  # a third one has none


@pytest.mark.parametrize(('first', 'count'), [(0, 1), (1, 0)])
def test_a_model_without_keypoints_is_known_by_many_images_and_never_one_that_had_some(
    first: int, count: int
) -> None:
    pipeline, reasons = Pipeline(make_config(YOLO_DETECTIONS)), []
    for image in range(3 * MIN_BOX_IMAGES):
        message = decode(make_inputs(YOLO_DETECTIONS, image)[0][1], YOLO_DETECTIONS)
        message.header.stamp.sec += 1_700_000_000
        for detection in message.detections if image >= first else ():
            detection.keypoints.data = []
        reasons.append(pipeline.feed(Source.KEYPOINTS, encode(message, YOLO_DETECTIONS)).reason)
    assert sum('no keypoints' in reason for reason in reasons[MIN_BOX_IMAGES - 1 :]) == count
    assert not any('no keypoints' in reason for reason in reasons[: MIN_BOX_IMAGES - 1])
