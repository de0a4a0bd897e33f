# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Choice of the keypoint topics of a bag."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, find_people_topics
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.definitions import HRI_IDS
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, make_keypoints

EMPTY_IDS = bytes([0, 1, 0, 0]) + bytes(24)  # an hri_msgs/IdsList with nobody in it


def test_a_bag_with_several_keypoint_topics_requires_a_choice(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for topic in ('/left', '/right'):
            recorder.write(topic, KEYPOINTS, make_keypoints(0), START_NS, START_NS)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match='choose one: /left, /right'):
            find_people_topics(bag)
        assert find_people_topics(bag, '/right') == {'/right': Source.KEYPOINTS}


def test_a_bag_without_keypoints_is_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.declare_topic('/keypoints', KEYPOINTS)
    with Bag(tmp_path / 'bag') as bag, pytest.raises(InputError, match=r'no topic of .*; the bag has /keypoints'):
        find_people_topics(bag)


def test_bodies_that_the_package_put_out_itself_are_no_input(tmp_path: Path) -> None:
    """`mocap_bridge` publishes a list of bodies, but no keypoints of theirs."""
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
        recorder.write('/humans/bodies/tracked', HRI_IDS, EMPTY_IDS, START_NS, START_NS)
    with Bag(tmp_path / 'bag') as bag:
        assert find_people_topics(bag) == {'/keypoints': Source.KEYPOINTS}
        tracked = '/humans/bodies/tracked'
        assert find_people_topics(bag, tracked) == {tracked: Source.TRACKED_BODIES}
