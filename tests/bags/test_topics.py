# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The topics of a bag that hold people."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, find_people_topics, list_input_types
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, YOLO_DETECTIONS
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, make_keypoints
from tests.support.foreign_messages import HRI_IDS_TOPIC, make_hri_inputs, make_inputs

EMPTY_IDS = bytes([0, 1, 0, 0]) + bytes(24)  # an hri_msgs/IdsList with nobody in it


def test_a_bag_of_several_detectors_requires_a_choice(tmp_path: Path) -> None:
    other_topic = '/other/bodies/tracked'
    other_inputs = [(source, raw, topic.replace('/humans', '/other')) for source, raw, topic in make_hri_inputs(0)]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for msgtype, inputs in (
            (YOLO_DETECTIONS, make_inputs(YOLO_DETECTIONS, 0)),
            (HRI_SKELETON, make_hri_inputs(0)),
            (HRI_SKELETON, other_inputs),
        ):
            for source, raw, topic in inputs:
                recorder.write(topic, list_input_types(msgtype)[source], raw, 1, 1)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match=f'choose one: /keypoints, {HRI_IDS_TOPIC}, {other_topic}$'):
            find_people_topics(bag)
        assert find_people_topics(bag, '/keypoints') == {'/keypoints': Source.KEYPOINTS}
        assert find_people_topics(bag, other_topic) == {topic: source for source, _, topic in other_inputs}
        with pytest.raises(
            InputError, match=r'no topic /yolo of .*hri_msgs/msg/Skeleton2D; the bag has /keypoints'
        ):
            find_people_topics(bag, '/yolo')


def test_bodies_that_the_package_published_itself_are_no_input(tmp_path: Path) -> None:
    """`mocap_bridge` publishes a list of bodies, but no keypoints of theirs."""
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
        recorder.write('/humans/bodies/tracked', HRI_IDS, EMPTY_IDS, START_NS, START_NS)
    with Bag(tmp_path / 'bag') as bag:
        assert find_people_topics(bag) == {'/keypoints': Source.KEYPOINTS}
        tracked = '/humans/bodies/tracked'
        assert find_people_topics(bag, tracked) == {tracked: Source.TRACKED_BODIES}


def test_an_unknown_type_is_refused() -> None:
    with pytest.raises(ConfigError, match='yolo_msgs/msg/DetectionArray'):
        list_input_types('std_msgs/msg/String')
