# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Obstacles of a scene are what Nav2's kf_hungarian_tracker takes, which itself does not run on today's NumPy.

It matches obstacles of successive messages whose places differ by less than 1 m, takes the differences of stamps
as time, and drops what is not between -2 and 2 m high (its parameters cost_filter and height_filter).
"""

from __future__ import annotations

import uuid

import numpy as np

from mocap_ros.bridges.bridge import Bridge
from mocap_ros.config import with_values
from mocap_ros.messages.cdr import decode, read_stamp
from mocap_ros.messages.foreign_types import OBSTACLES
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, process

MAX_STEP_M = 1.0  # cost_filter
MAX_HEIGHT_M = 2.0  # height_filter
PARAMETERS = {'node.output_frame': 'map', 'node.camera_pose': '0 0 1.2 0 0 0'}


def test_obstacles_are_matched_from_message_to_message() -> None:
    bridge, pipeline = Bridge(['obstacles']), Pipeline(with_values(FAST_CONFIG, PARAMETERS))
    pipeline.set_camera_info(camera_info())
    stamps, places, ids = [], [], set()
    for raw in encode_demo_frames(30):
        outputs = process(pipeline, raw)
        (output,) = bridge.feed_skeletons(outputs[0].data)
        message = decode(output.data, OBSTACLES)
        stamps.append(read_stamp(message.header.stamp))
        for obstacle in message.obstacles:
            places.append([obstacle.position.x, obstacle.position.y, obstacle.position.z])
            ids.add(uuid.UUID(bytes=bytes(obstacle.uuid.uuid.tolist())))
            assert min(obstacle.size.x, obstacle.size.y, obstacle.size.z) > 0.1
            assert message.header.frame_id == 'map'
    assert len(ids) == 1
    assert len(places) >= 27, 'all but the first frames, in which the person is tentative'
    assert (np.diff(stamps) > 0).all()
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < MAX_STEP_M / 4
    assert np.abs(np.array(places)[:, 2]).max() < MAX_HEIGHT_M
