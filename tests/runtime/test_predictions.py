# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Predictions of people as a topic: on by a parameter, in the frame of the outputs, and the same in a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, process

FRAMES = 20
STEP_NS = 33_333_333
CONFIG = with_values(
    FAST_CONFIG,
    {
        'node.publish_predictions': True,
        'node.prediction_times': '0.1 0.5',
        'node.output_frame': 'map',
        'node.camera_pose': '0 0 1.5 0 0.1 0',
    },
)


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(FRAMES)


def find(outputs: Any, topic: str) -> bytes:
    return next(bytes(o.data) for o in outputs if o.topic == topic)


def test_the_topic_is_the_same_in_a_replay(tmp_path: Path, stream: list[bytes]) -> None:
    pipeline = Pipeline(CONFIG)
    pipeline.set_camera_info(camera_info())
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 1, 1)
        for i, raw in enumerate(stream):
            recorder.write('/keypoints', KEYPOINTS, raw, 2 + i * STEP_NS, 2 + i * STEP_NS)
    live = []
    for raw in stream:
        outputs = process(pipeline, raw)
        live.append(find(outputs, 'predictions'))
        pipeline.run_deferred_work()
    message, now = decode(live[-1], PREDICTIONS), decode(find(outputs, 'skeletons'), SKELETONS)
    (person,) = now.people
    assert (message.header.frame_id, message.header.stamp) == ('map', now.header.stamp)
    assert [t.ahead for t in message.times] == pytest.approx([0.1, 0.5])
    root = message.times[0].people[0].root
    moved = np.hypot(root.x - person.root.x, root.y - person.root.y)
    speed = np.hypot(person.root_velocity.x, person.root_velocity.y)
    assert moved == pytest.approx(0.1 * speed, abs=0.1)
    assert [t.people[0].id for t in message.times] == [person.id] * 2
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(CONFIG))
        replay(bag, tmp_path / 'plain', ReplayOptions(FAST_CONFIG))
    with Bag(tmp_path / 'out') as bag:
        assert [bytes(m.raw) for m in bag.messages(['/predictions'])] == live
    with Bag(tmp_path / 'plain') as bag:
        assert not list(bag.messages(['/predictions']))


def test_wrong_times_stop_the_pipeline_before_it_starts() -> None:
    with pytest.raises(ConfigError, match=r'node\.prediction_times'):
        Pipeline(with_values(CONFIG, {'node.prediction_times': '2'}))
