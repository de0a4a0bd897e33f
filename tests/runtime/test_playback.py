# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The messages that are played: from a bag of any detector, from a whole bag, and from a sequence file."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import list_input_types
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION
from mocap_ros.runtime.playback import Playback, encode_sequence
from tests.support.bag_writing import DEFINITION
from tests.support.camera_infos import camera_info
from tests.support.foreign_messages import make_hri_inputs
from tests.support.pipeline_inputs import encode_demo_frames

FRAMES = 4


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of keypoints and CameraInfo in a namespace, and of another topic."""
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.declare_topic('/unused', KEYPOINTS)
        recorder.write('/left/camera_info', CAMERA_INFO, camera_info(), 1, 1)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, DEFINITION, 2, 2)
        for frame, raw in enumerate(encode_demo_frames(FRAMES)):
            recorder.write('/left/keypoints', KEYPOINTS, raw, 10 + frame, 10)
    return tmp_path / 'bag'


def test_keypoints_and_their_camera_are_played_on_the_topics_of_the_node(bag: Path) -> None:
    playback = Playback(bag, to='people')
    assert {t.recorded: (t.name, t.type) for t in playback.topics} == {
        '/left/keypoints': ('people', KEYPOINTS),
        '/left/camera_info': ('camera_info', CAMERA_INFO),
    }
    assert playback.count == FRAMES + 1
    expected = [(1, '/left/camera_info', camera_info())]
    expected += [(10 + i, '/left/keypoints', raw) for i, raw in enumerate(encode_demo_frames(FRAMES))]
    for _ in range(2):  # a playback can be repeated
        assert [(m.due_ns, playback.topics[m.topic].recorded, m.raw) for m in playback] == expected


def test_everything_is_played_on_its_recorded_topics(bag: Path) -> None:
    playback = Playback(bag, everything=True)
    recorded = {'/left/keypoints', '/left/camera_info', '/skeleton_definition'}
    assert {t.name for t in playback.topics} == {t.recorded for t in playback.topics} == recorded
    assert playback.count == len(list(playback)) == FRAMES + 2


def test_bodies_of_ros4hri_keep_their_topics(tmp_path: Path) -> None:
    inputs = make_hri_inputs(0)
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for source, raw, topic in inputs:
            recorder.write(topic, list_input_types(HRI_SKELETON)[source], raw, 1, 1)
    playback = Playback(tmp_path / 'bag', to='people')
    assert {t.name for t in playback.topics} == {topic for _, _, topic in inputs}
    assert {m.raw for m in playback} == {raw for _, raw, _ in inputs}


@pytest.mark.parametrize('is_calibrated', [False, True])
def test_a_sequence_file_is_played_at_its_stamps(tmp_path: Path, is_calibrated: bool) -> None:
    sequence = make_recording().sequence(is_calibrated=is_calibrated)
    save_sequence(tmp_path / 'demo.npz', sequence)
    playback = Playback(tmp_path / 'demo.npz')
    topics = [('keypoints', KEYPOINTS), ('camera_info', CAMERA_INFO)][: 1 + is_calibrated]
    assert [(t.name, t.type) for t in playback.topics] == topics
    messages = [*playback]
    assert playback.count == len(messages) == len(sequence) * len(topics)
    keypoints = [(m.due_ns, m.raw) for m in messages if m.topic == 0]
    assert keypoints == [(f.stamp_ns, f.raw) for f in encode_sequence(sequence)]
    for message in messages[:is_calibrated]:  # before the first keypoints
        assert decode_camera_info(message.raw).intrinsics.focal_lengths == pytest.approx([600.0, 600.0])
