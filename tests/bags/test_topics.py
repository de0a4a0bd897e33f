"""Choice of the keypoint topics of a bag."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, find_people_topics
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, make_keypoints


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
