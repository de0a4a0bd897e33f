# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for robots, the recipe of a detector and the live page, as programs of their own over DDS."""

import http.client
import json
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.ros.message_types import load_interface_class
from tests.support.bodies import make_person_3d
from tests.support.message_objects import encode
from tests.support.paths import ROOT, load_module
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, StartProgram, stop_node

pytestmark = pytest.mark.ros


def make_skeletons(ahead_m: float, left_m: float = 0.0, speed_m_s: float = 0.0, **fields: Any) -> bytes:
    """Return skeletons of a person who stands or moves ahead of the robot, along its x axis."""
    message = decode(encode_skeletons(Header(10**9, 'base_link'), [make_person_3d('anna')]), SKELETONS)
    message.camera_frame_id = fields.pop('camera_frame_id', 'camera')
    (person,) = message.people
    vars(person).update({'tentative': False, 'unseen_for': 0.0, 'root_covariance': np.zeros(9), **fields})
    for point in (person.root, *person.joints):
        point.x, point.y, point.z = ahead_m, left_m, 1.0
    for velocity in (person.root_velocity, *person.joint_velocity):
        velocity.x, velocity.y, velocity.z = speed_m_s, 0.0, 0.0
    return encode(message, SKELETONS)


IN_CAMERA = {'camera_frame_id': 'base_link'}  # people in the frame of the camera, where no transform is known
TENTATIVE = {'tentative': True}


@pytest.mark.parametrize(
    ('place', 'fields', 'expected'),  # whether the robot stops, its speed and turn, and where discs are
    [
        ((3.0, 0.0, 0.0), {}, (False, (0.6, 0.0), [3.0] * 5)),
        ((3.0, 0.0, -5.0), {}, (True, (0.0, 0.0), [3.0, 1.75, 0.5, -0.75, -2.0])),  # comes towards it
        ((3.0, 0.0, 4.0), {}, (False, (0.6, 0.0), [3.0, 4.0, 5.0, 6.0, 7.0])),
        ((0.9, 0.0, 0.0), {}, (True, (0.0, 0.0), [0.9] * 5)),
        ((3.0, 3.0, 0.0), {}, (False, (0.6, pytest.approx(0.8 * np.pi / 4)), [3.0] * 5)),  # to the left
        ((3.0, 0.0, 0.0), {'unseen_for': 1.0}, (False, (0.0, 0.0), [3.0] * 5)),
        ((0.9, 0.0, 0.0), TENTATIVE, (False, (0.0, 0.0), [])),
        ((3.0, 0.0, 0.0), IN_CAMERA, (True, (0.0, 0.0), [])),
    ],
)
def test_what_the_examples_decide(place: tuple[float, ...], fields: dict[str, Any], expected: Any) -> None:
    names = 'stop_when_near', 'follow_person', 'people_layer'
    stop, follow, layer = (load_module(ROOT / 'examples' / f'{name}.py') for name in names)
    skeletons = decode(make_skeletons(*place, **fields), SKELETONS)
    points = np.array(layer.list_points(skeletons)).reshape(-1, layer.POINTS_PER_DISC, 3)
    command = follow.choose_command(follow.choose_person(skeletons))
    discs = points[..., 0].mean(axis=1)
    assert (stop.must_stop(skeletons), command, pytest.approx(discs, abs=1e-9)) == expected


@pytest.mark.parametrize(
    ('name', 'topic', 'kind', 'is_free'),
    [
        ('stop_when_near', 'stop', 'std_msgs/msg/Bool', lambda m: not m.data),
        ('follow_person', 'cmd_vel', 'geometry_msgs/msg/Twist', lambda m: m.linear.x > 0),
        ('people_layer', 'people_points', 'sensor_msgs/msg/PointCloud2', lambda m: m.width > 0),
    ],
)
def test_an_example_acts_on_a_person_far_away_and_is_safe_when_nothing_is_heard_or_it_ends(
    peer: Peer, start: StartProgram, name: str, topic: str, kind: str, is_free: Callable[[Any], bool]
) -> None:
    received: list[Any] = []
    peer.node.create_subscription(load_interface_class(kind), topic, received.append, 10)
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    example = start(sys.executable, ROOT / 'examples' / f'{name}.py')

    def publish_until(ahead_m: float, condition: Callable[[Any], bool]) -> None:
        def is_as_expected() -> bool:
            skeletons.publish(make_skeletons(ahead_m))
            return bool(received) and condition(received[-1])

        peer.wait_until(is_as_expected)

    peer.wait_until(lambda: peer.node.count_subscribers('skeletons') == 2)  # the peer has one of its own
    publish_until(5.0, is_free)
    if name == 'people_layer':
        cloud = received[-1]
        assert (cloud.header.frame_id, [field.name for field in cloud.fields]) == ('base_link', ['x', 'y', 'z'])
        points = np.frombuffer(cloud.data.tobytes(), '<f4').reshape(cloud.width, 3)
        assert points[:, :2].mean(axis=0) == pytest.approx([5.0, 0.0], abs=1e-5)
    else:
        publish_until(0.5, lambda message: not is_free(message))
        publish_until(5.0, is_free)
        peer.wait_until(lambda: not is_free(received[-1]))  # nothing is heard any more
        publish_until(5.0, is_free)
    example.send_signal(signal.SIGINT)
    assert example.wait(TIMEOUT_S) == 0
    peer.wait_until(lambda: name == 'people_layer' or not is_free(received[-1]))


def test_the_programs_of_docs_run(peer: Peer, start: StartProgram, start_node: StartNode, tmp_path: Path) -> None:
    from sensor_msgs.msg import Image

    text = (ROOT / 'docs' / 'detectors.md').read_text()
    ((tested_by, recipe),) = re.findall(r'<!-- recipe: (\S+) .*?-->\n```python\n(.*?)```', text, re.DOTALL)
    assert (ROOT / tested_by).samefile(__file__)
    (tmp_path / 'detector.py').write_text(recipe)
    node = start_node(f'recorder.folder:={tmp_path}/bags')
    detector = start(sys.executable, tmp_path / 'detector.py')
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
    (person,) = decode(peer.received['skeletons'][-1], SKELETONS).people
    assert len(person.joints) == 26
    (program,) = re.findall(
        r'```python\n(import rclpy\n.*?)```', (ROOT / 'docs/recording.md').read_text(), re.DOTALL
    )
    (tmp_path / 'record.py').write_text(program)
    answer, _ = start(sys.executable, tmp_path / 'record.py').communicate(timeout=TIMEOUT_S)
    assert answer.split() == ['True', *map(str, (tmp_path / 'bags').iterdir())]
    stop_node(node)


def test_the_page_gets_the_newest_people_with_their_keypoints(start: StartProgram, peer: Peer) -> None:
    view = start(sys.executable, '-m', 'mocap_ros.cli.main', 'view', '--live', '/robot', '--port', '0')
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
    view.send_signal(signal.SIGINT)
    _, errors = view.communicate(timeout=TIMEOUT_S)
    assert (view.returncode, errors) == (0, '')
