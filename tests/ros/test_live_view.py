# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The live view: what a node publishes is drawn, with the keypoints of the same image, and people who leave go."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.skeleton import CMU15
from tests.support.people import make_person_3d
from tests.support.recording_of_rerun import count_rows
from tests.support.ros_node import TIMEOUT_S, Peer

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

PERIOD_S = 1 / 30  # s, of the messages
FRAMES = 15  # that are drawn at least
FRAMES_OF_BOTH = 4  # that are drawn at least before one of two people leaves


def test_people_are_drawn_as_they_come_and_go(peer: Peer, env: dict[str, str], tmp_path: Path) -> None:
    rerun = pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from mocap_ros.ros.live_view import LiveView
    from mocap_ros.viewing.rerun_recording import LiveDrawing

    recording = rerun.RecordingStream('test', send_properties=False)
    recording.save(tmp_path / 'live.rrd')
    context = rclpy.Context()
    rclpy.init(
        context=context, domain_id=int(env['ROS_DOMAIN_ID']), signal_handler_options=SignalHandlerOptions.NO
    )
    view = LiveView(LiveDrawing(recording), context=context)
    has_ended = Event()
    thread = Thread(target=view.run, args=(lambda: not has_ended.is_set(),))
    thread.start()
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    publishers = (skeletons, peer.keypoints)
    try:
        peer.wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers))
        deadline = time.monotonic() + TIMEOUT_S
        sent = 0
        while view.frame_count < FRAMES and time.monotonic() < deadline:
            header = Header(round(sent * PERIOD_S * 1e9), 'camera')
            names = ('a', 'b') if view.frame_count < FRAMES_OF_BOTH else ('a',)
            people = [make_person_3d(name) for name in names]
            for person in people:
                person.joints[:, 2] += 3  # m, in front of the camera
            keypoints = Person2D('', CMU15.joints, np.full((15, 2), 100.0), np.ones(15))
            peer.keypoints.publish(encode_keypoints(header, (640, 480), [keypoints]))
            skeletons.publish(encode_skeletons(header, people))
            sent += 1
            time.sleep(PERIOD_S)
    finally:
        has_ended.set()
        thread.join()
        rclpy.shutdown(context=context)
        recording.flush()
        recording.disconnect()
    rows = count_rows(tmp_path, tmp_path / 'live.rrd')
    static = 3  # at most: the rows of what does not change, which are sent again for each new person
    assert view.frame_count <= rows['world/people/a/joints'] <= view.frame_count + static + 1
    assert 1 < rows['world/people/b/joints'] < rows['world/people/a/joints']
    assert rows['states/b/detection'] >= 2 + 1
    assert rows['world/camera/input/0_0'] > 1
    assert len(view.delays_s) == view.frame_count
    assert min(view.delays_s) < TIMEOUT_S
