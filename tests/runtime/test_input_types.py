# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every message type gives the same people, live and from a bag, also among garbage; bodies become images."""

import re
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, list_input_types, make_body_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError
from mocap_ros.formats.detections import Video
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.messages.keypoints import KEYPOINTS
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
    encode_body,
    encode_ids,
    feed_all,
    make_config,
    make_header,
    make_inputs,
    make_people,
)
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
