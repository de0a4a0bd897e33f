# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every message type gives the same people, live and from a bag; faults are refused by field."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, list_input_types, make_body_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.formats.detections import Video
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.foreign_types import HRI_SKELETON, OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import ZED38, decode_body, decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.input_checks import MIN_BOX_IMAGES
from mocap_ros.runtime.load_keypoints import InputOptions, load_bag, load_input
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.foreign_messages import (
    BASE_CONFIG,
    HRI_IDS_TOPIC,
    IMAGE_SIZE,
    INPUT_TYPES,
    LIMITS,
    decode_skeletons,
    edit_message,
    encode_body,
    encode_ids,
    feed_all,
    make_config,
    make_header,
    make_inputs,
    make_people,
)
from tests.support.message_objects import encode
from tests.support.pipeline_inputs import read_messages

FRAMES = 10


@pytest.mark.parametrize('msgtype', INPUT_TYPES)
def test_every_input_type_gives_the_same_people_live_and_from_a_bag(msgtype: str, tmp_path: Path) -> None:
    pipeline, reference = Pipeline(make_config(msgtype)), Pipeline(make_config(KEYPOINTS))
    inputs = [i for frame in range(FRAMES) for i in make_inputs(msgtype, frame)]
    results = feed_all(pipeline, inputs)
    assert [o.reason for o in results if o.verdict is not Verdict.ACCEPTED] == []
    skeletons = decode_skeletons(results)
    expected = decode_skeletons(feed_all(reference, [i for f in range(FRAMES) for i in make_inputs(KEYPOINTS, f)]))
    assert [len(s.people) for s in skeletons] == [2] * FRAMES
    for skeleton, reference_skeleton in zip(skeletons, expected, strict=True):
        assert skeleton.header == reference_skeleton.header
        for pair in zip(skeleton.people, reference_skeleton.people, strict=True):
            joints = np.array([[[j.x, j.y, j.z] for j in person.joints] for person in pair])
            # m; measured: 1e-7, as the types round coordinates and scores differently
            assert np.linalg.norm(joints[0] - joints[1], axis=-1).max() < (1e-9 if msgtype == KEYPOINTS else 1e-5)

    types = list_input_types(msgtype)
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate(inputs):
            recorder.write(topic, types[source], raw, number + 1, number + 1)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(RecordingError, match='exists already'):
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'same', ReplayOptions(config=BASE_CONFIG))
    raws = read_messages(tmp_path / 'same', '/skeletons')
    assert raws == [o.data for c in results for o in c.outputs if o.topic == 'skeletons']


@pytest.mark.parametrize('msgtype', INPUT_TYPES)
def test_a_bag_of_any_detector_is_a_sequence(msgtype: str, tmp_path: Path) -> None:
    inputs = [i for frame in range(FRAMES) for i in make_inputs(msgtype, frame)]
    last = make_inputs(msgtype, FRAMES)
    if msgtype == HRI_SKELETON:
        last = last[::2]  # the body b1 is tracked, but its message is missing
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate([*inputs, *last, inputs[-1]], 1):
            recorder.write(topic, list_input_types(msgtype)[source], raw, number, number)
    detections = load_bag(tmp_path / 'bag', LIMITS)
    assert list(detections.stamps_ns) == [make_header(frame).stamp_ns for frame in range(FRAMES + 1)]
    assert [len(p) for p in detections.people] == [2] * FRAMES + [1 if msgtype == HRI_SKELETON else 2]
    (note,) = detections.notes
    assert re.match(r'1 messages left out; /\S+: message \d\d: (its )?stamp ', note)
    sequence, _ = load_input(tmp_path / 'bag', InputOptions(Video(), LIMITS))
    assert (len(sequence), sequence.image_size, sequence.frame_id) == (FRAMES + 1, IMAGE_SIZE, 'camera')
    for frame in (0, FRAMES - 1):
        expected, points = (
            build_joint_map(p.joints).apply(p.points, p.score)[0]
            for p in (make_people(frame)[0], sequence.person(frame))
        )
        np.testing.assert_allclose(points, expected, atol=1e-3)


def test_images_are_complete_when_all_tracked_bodies_have_arrived() -> None:
    pipeline = Pipeline(make_config(HRI_SKELETON))
    first, second = make_people(0)

    def feed_body(person: Person2D, frame: int) -> ProcessingResult:
        return pipeline.feed(
            Source.BODY, encode_body(person, make_header(frame)), make_body_topic(HRI_IDS_TOPIC, person.id)
        )

    assert pipeline.feed(Source.TRACKED_BODIES, encode_ids(0, 'b0', 'b1'), HRI_IDS_TOPIC).outputs == ()
    assert feed_body(first, 0).outputs == ()
    assert feed_body(first, 0).verdict is Verdict.DROPPED  # the body repeats in the image
    assert feed_body(first, 1).outputs[0].stamp_ns == make_header(0).stamp_ns  # the next image ends it without b1
    assert feed_body(second, 0).verdict is Verdict.DROPPED  # the image has ended
    assert feed_body(second, 1).outputs[0].stamp_ns == make_header(1).stamp_ns  # complete at once
    assert pipeline.feed(Source.TRACKED_BODIES, encode_ids(2, 'b1'), HRI_IDS_TOPIC).outputs == ()
    assert feed_body(second, 2).outputs[0].stamp_ns == make_header(2).stamp_ns
    (empty,) = decode_skeletons([pipeline.feed(Source.TRACKED_BODIES, encode_ids(3), HRI_IDS_TOPIC)])
    assert empty.people == [], 'two frames are too few to predict a person'
    assert pipeline.counters.dropped['stamp'] == 2


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
def test_a_model_without_keypoints_is_known_by_many_images(first: int, count: int) -> None:
    pipeline, reasons = Pipeline(make_config(YOLO_DETECTIONS)), []
    for image in range(3 * MIN_BOX_IMAGES):
        message = decode(make_inputs(YOLO_DETECTIONS, image)[0][1], YOLO_DETECTIONS)
        message.header.stamp.sec += 1_700_000_000
        for detection in message.detections if image >= first else ():
            detection.keypoints.data = []
        reasons.append(pipeline.feed(Source.KEYPOINTS, encode(message, YOLO_DETECTIONS)).reason)
    assert sum('no keypoints' in reason for reason in reasons[MIN_BOX_IMAGES - 1 :]) == count
    assert not any('no keypoints' in reason for reason in reasons[: MIN_BOX_IMAGES - 1])
