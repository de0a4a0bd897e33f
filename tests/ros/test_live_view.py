# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view --live`: skeletons of a topic and the keypoints of their image reach the page."""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
import time
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.ros.message_types import load_interface_class
from tests.support.people import make_person_3d
from tests.support.ros_node import TIMEOUT_S, Peer

pytestmark = pytest.mark.ros


def test_the_page_gets_the_newest_people_with_their_keypoints(env: dict[str, str], peer: Peer) -> None:
    command = [sys.executable, '-m', 'mocap_ros.cli.main', 'view', '--live', '/robot', '--port', '0']
    view = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert view.stdout is not None
        line = view.stdout.readline()
        assert '/robot/skeletons' in line
        skeletons, keypoints = (
            peer.node.create_publisher(load_interface_class(msgtype), f'/robot/{topic}', 10)
            for topic, msgtype in (('skeletons', SKELETONS), ('keypoints', KEYPOINTS))
        )
        peer.wait_until(lambda: skeletons.get_subscription_count() and keypoints.get_subscription_count())
        person, deadline, content = make_recording().sequence().person(0), time.monotonic() + TIMEOUT_S, b''
        connection = http.client.HTTPConnection(urlsplit(line.split()[0]).netloc, timeout=30)
        frame: dict[str, Any] = {}
        for second in range(1, 1000):
            header = Header(second * 10**9, 'camera')
            keypoints.publish(encode_keypoints(header, (640, 480), [person]))
            time.sleep(0.05)
            skeletons.publish(encode_skeletons(header, [make_person_3d('ann'), make_person_3d('bob', 1.0)]))
            connection.request('GET', '/frame?after=0')
            content = connection.getresponse().read()
            frame = json.loads(content) if content else {}
            if frame.get('keypoints'):
                break
            assert time.monotonic() < deadline
        assert frame['ids'] == ['ann', 'bob']
        joints = np.array(frame['people']['joints']).reshape(2, 15, 3) / 1000
        assert joints[0] == pytest.approx(np.minimum(make_person_3d('ann').joints, 32.767))
        assert len(frame['keypoints']) == 1
        assert frame['keypoints'][0]['points'][0] / 8 == pytest.approx(person.points[0, 0], abs=0.1)
        assert frame['camera']['imageSize'] == [640, 480]
    finally:
        view.send_signal(2)
        _, errors = view.communicate(timeout=TIMEOUT_S)
    assert (view.returncode, errors) == (0, '')
