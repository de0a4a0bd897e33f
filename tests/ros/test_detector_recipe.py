# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The detector node that docs/detectors.md gives as a recipe."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mocap_ros.messages.cdr import decode
from mocap_ros.messages.skeletons import SKELETONS
from tests.support.paths import ROOT
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def test_the_recipe_of_the_documentation_runs(
    env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    from sensor_msgs.msg import Image

    text = (ROOT / 'docs' / 'detectors.md').read_text()
    ((tested_by, recipe),) = re.findall(r'<!-- recipe: (\S+) .*?-->\n```python\n(.*?)```', text, re.DOTALL)
    assert (ROOT / tested_by).samefile(__file__)
    (tmp_path / 'detector.py').write_text(recipe)
    node = start_node()
    detector = subprocess.Popen(
        [sys.executable, str(tmp_path / 'detector.py')], env=env, stderr=subprocess.PIPE, text=True
    )
    try:
        peer.wait_for_node()
        images = peer.node.create_publisher(Image, 'image', 10)
        peer.wait_until(images.get_subscription_count)
        image = Image(width=640, height=480)
        image.header.frame_id = 'camera'
        while not peer.received['skeletons']:
            image.header.stamp.sec += 1
            images.publish(image)
            peer.executor.spin_once(timeout_sec=0.2)
            assert image.header.stamp.sec < 100
        detector.send_signal(signal.SIGINT)
        _, complaints = detector.communicate(timeout=TIMEOUT_S)
        assert (detector.returncode, complaints) == (0, ''), 'Ctrl-C does not end it in peace'
    finally:
        detector.kill()
        detector.wait()
    (person,) = decode(peer.received['skeletons'][-1], SKELETONS).people
    assert len(person.joints) == 26
    stop_node(node)
