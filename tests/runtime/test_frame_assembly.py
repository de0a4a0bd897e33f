# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies of ROS4HRI are assembled into images; late and repeated bodies are dropped and counted."""

from __future__ import annotations

import pytest

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.topics import Source, make_body_topic
from mocap_ros.config import with_values
from mocap_ros.errors import FrameDropped
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.runtime.frame_assembly import FrameAssembler
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from tests.support.foreign_messages import (
    HRI_IDS_TOPIC,
    IMAGE_SIZE,
    STEP_NS,
    decode_skeletons,
    encode_body,
    encode_ids,
    feed_all,
    make_config,
    make_header,
    make_hri_inputs,
    make_people,
)


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
    (nobody,) = decode_skeletons([pipeline.feed(Source.TRACKED_BODIES, encode_ids(3), HRI_IDS_TOPIC)])
    assert nobody.people == [], 'two frames are too few to predict anybody'
    assert pipeline.counters.dropped['stamp'] == 2


def add_ids(assembler: FrameAssembler, frame: int, *ids: str) -> list[int]:
    """Add a list of tracked bodies; return the frames that are complete then."""
    return assemble(assembler, Source.TRACKED_BODIES, encode_ids(frame, *ids))


def add_body(assembler: FrameAssembler, frame: int) -> list[int]:
    """Add the first body of a frame; return the frames that are complete then."""
    return assemble(assembler, Source.BODY, encode_body(make_people(0)[0], make_header(frame)))


def assemble(assembler: FrameAssembler, source: Source, raw: bytes) -> list[int]:
    topic = make_body_topic(HRI_IDS_TOPIC, 'b0')
    frames = assembler.assemble(source, raw, topic, make_config(HRI_SKELETON).node, IMAGE_SIZE, 1.0)
    return [round(f.header.stamp_ns / STEP_NS) - 1 for f in frames]


def test_a_late_body_is_dropped_and_after_time_went_back_far_a_sequence_begins() -> None:
    assembler = FrameAssembler()
    add_ids(assembler, 0, 'b0')
    assert add_body(assembler, 1) == [1]
    with pytest.raises(FrameDropped, match='after its image was complete'):
        add_body(assembler, 1)
    assert [add_body(assembler, frame) for frame in (300, 1)] == [[300], [1]], 'a bag that loops'
    assert [add_ids(assembler, frame) for frame in (300, 297, 1)] == [[300], [], [1]], 'lists of nobody, likewise'


def test_the_list_of_bodies_outlives_a_reset() -> None:
    assembler = FrameAssembler()
    add_ids(assembler, 0, 'b0')
    assembler.reset()
    assert add_body(assembler, 1) == [1], 'a publisher sends it on changes'


def test_normalised_coordinates_without_an_image_size_are_invalid() -> None:
    pipeline = Pipeline(with_values(make_config(HRI_SKELETON), {'node.image_width': 0}))
    result = feed_all(pipeline, make_hri_inputs(0))[1]
    assert result.verdict is Verdict.INVALID
    assert 'node.image_width' in result.reason
