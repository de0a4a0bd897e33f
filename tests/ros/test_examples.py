# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for robots, the recipe of a detector, the live page and `mocap_bridge`, as programs of their own
over DDS; messages of other packages: YOLO, and bodies of ROS4HRI."""

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bridges.bridge import POSES
from mocap_ros.bridges.capsules import CAPSULES
from mocap_ros.bridges.ros4hri import DESCRIPTION, JOINT_STATES
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.markers import DELETE, MARKERS
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.ros.help import BRIDGE_NAME
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.replay import replay
from mocap_ros.skeleton import keypoint_layout
from tests.support import foreign_packages
from tests.support.bodies import STANDING, gather, make_person_3d
from tests.support.camera_messages import camera_info, encode
from tests.support.paths import ROOT, load_module
from tests.support.pipeline_inputs import read_messages
from tests.support.ros_node import (
    TIMEOUT_S,
    Peer,
    StartNode,
    StartProgram,
    keypoints_at,
    stack_joints,
    stop_node,
    wait_until_discovered,
)

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def make_skeletons(ahead_m: float, left_m: float = 0.0, speed_m_s: float = 0.0, **fields: Any) -> bytes:
    """Return skeletons of a person who stands or moves ahead of the robot, along its x axis."""
    message = decode(encode_skeletons(Header(10**9, 'base_link'), gather([make_person_3d('anna')])), SKELETONS)
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
    from sensor_msgs.msg import Image

    view = start(sys.executable, '-m', 'mocap_ros.cli.main', 'view', '--live', '/robot', '--port', '0')
    assert view.stdout is not None
    line = view.stdout.readline()
    assert '/robot/skeletons' in line
    skeletons, keypoints = (
        peer.node.create_publisher(load_interface_class(msgtype), f'/robot/{topic}', 10)
        for topic, msgtype in (('skeletons', SKELETONS), ('keypoints', KEYPOINTS))
    )
    peer.wait_until(lambda: skeletons.get_subscription_count() and keypoints.get_subscription_count())
    # The images are those that the node which publishes the keypoints looks at
    peer.subscriptions.append(peer.node.create_subscription(Image, '/webcam/rgb', lambda _: None, 10))
    images = peer.node.create_publisher(Image, '/webcam/rgb', 10)
    person, deadline, content = make_recording().sequence().person(0), time.monotonic() + TIMEOUT_S, b''
    connection = http.client.HTTPConnection(urlsplit(line.split()[0]).netloc, timeout=30)
    frame: dict[str, Any] = {}
    for second in range(1, 1000):
        header = Header(second * 10**9, 'camera')
        keypoints.publish(encode_keypoints(header, (640, 480), [person]))
        image = Image(height=2, width=2, encoding='rgb8', step=6, data=bytes(12))
        image.header.stamp.sec = second
        images.publish(image)
        time.sleep(0.05)
        skeletons.publish(encode_skeletons(header, gather([make_person_3d('ann'), make_person_3d('bob', 1.0)])))
        connection.request('GET', '/frame?after=0')
        content = connection.getresponse().read()
        frame = json.loads(content) if content else {}
        if frame.get('keypoints') and frame['hasImage']:
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


# A signal comes while the node is made.
ENDED_AT_THE_START = """
import os, signal, sys
from rclpy.node import Node
from mocap_ros.cli.main import main

make = Node.__init__
Node.__init__ = lambda *given, **options: os.kill(os.getpid(), signal.SIGTERM) or make(*given, **options)
sys.exit(main(['view', '--live', '--port', '0']))
"""


def test_a_page_that_is_ended_while_it_starts_ends_quietly(start: StartProgram) -> None:
    view = start(sys.executable, '-c', ENDED_AT_THE_START)
    _, errors = view.communicate(timeout=TIMEOUT_S)
    assert (view.returncode, errors) == (0, '')


BRIDGE = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.bridge_main())'


def listen(peer: Peer, topic: str, kind: str, **qos: Any) -> list[bytes]:
    """Subscribe to a topic; return the list of the messages that will arrive."""
    from rclpy.qos import QoSProfile

    received: list[bytes] = []
    subscription = peer.node.create_subscription(
        load_interface_class(kind), topic, received.append, QoSProfile(**{'depth': 100, **qos}), raw=True
    )
    peer.subscriptions.append(subscription)
    return received


def test_started_by_the_launch_file_it_publishes_the_people_of_the_node(
    peer: Peer, start_node: StartNode, start: StartProgram, launch_file: ModuleType
) -> None:
    context = {**dict.fromkeys(launch_file.ARGUMENTS, ''), 'bridge': 'poses capsules prediction_markers'}
    node, bridge = launch_file.create_nodes(context)
    assert (bridge.package, bridge.executable, bridge.name) == ('mocap_ros', BRIDGE_NAME, BRIDGE_NAME)
    node_process = start_node(*(f'{name}:={str(value).lower()}' for name, value in node.parameters[1].items()))
    bridge_process = start(*BRIDGE, '--ros-args', '-p', f'publish:={bridge.parameters[0]["publish"].args[0]}')
    received = {
        topic: listen(peer, topic, kind)
        for topic, kind in (('poses', POSES), ('capsules', CAPSULES), ('prediction_markers', MARKERS))
    }
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    peer.wait_until(lambda: peer.node.count_subscribers('/predictions') == 1)
    for seconds in np.arange(1, 1.4, 0.04):
        peer.keypoints.publish(keypoints_at(float(seconds)))
    peer.wait_until(lambda: all(len(messages) >= 10 for messages in received.values()))
    # On a busy machine, further ones without people may follow.
    for raw, skeletons in zip(received['poses'][:10], peer.received['skeletons'][:10], strict=True):
        poses, people = decode(raw, POSES), decode(skeletons, SKELETONS)
        assert poses.header == people.header
        certain = [p.root for p in people.people if not p.tentative]
        assert [pose.position for pose in poses.poses] == certain
    assert len(decode(received['capsules'][9], CAPSULES).people) == 1
    assert {m.ns for m in decode(received['prediction_markers'][9], MARKERS).markers} >= {'0.2 s', '1 s'}
    # nothing has arrived for a while
    peer.wait_until(lambda: not decode(received['poses'][-1], POSES).poses)
    peer.wait_until(
        lambda: {m.action for m in decode(received['prediction_markers'][-1], MARKERS).markers} == {DELETE}
    )
    assert [line for line in stop_node(bridge_process) if 'no message has arrived' not in line] == []
    assert stop_node(node_process) == []


def test_what_cannot_be_published_is_logged_and_the_others_go_on(peer: Peer, start: StartProgram) -> None:
    poses = listen(peer, 'poses', POSES)
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    bridge = start(*BRIDGE, '--ros-args', '-p', "publish:='people, poses'")
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
    skeletons.publish(b'no message')
    skeletons.publish(encode_skeletons(Header(1, 'camera'), gather([make_person_3d('anna')])))
    peer.wait_until(lambda: poses)
    missing, invalid = stop_node(bridge)
    assert 'people_msgs/msg/People' in missing
    assert '/skeletons: message 1: ' in invalid


def test_bodies_of_ros4hri_have_topics_of_their_own(env: dict[str, str], peer: Peer, start: StartProgram) -> None:
    env.update(foreign_packages.environment(env))
    from rclpy.qos import DurabilityPolicy

    bridge = start(*BRIDGE, '--ros-args', '-p', 'publish:=bodies')
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    states = listen(peer, '/humans/bodies/p7/joint_states', JOINT_STATES)
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    person = replace(make_person_3d('7'), joints=STANDING)

    def publish_until(people: list[Any], condition: Callable[[], object]) -> None:
        def is_reached() -> object:
            skeletons.publish(encode_skeletons(Header(1, 'camera'), gather(people)))
            return condition()

        peer.wait_until(is_reached)

    publish_until([person], lambda: states)
    descriptions = listen(peer, '/humans/bodies/p7/urdf', DESCRIPTION, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publish_until([person], lambda: descriptions)  # kept for late subscribers
    publish_until([], lambda: not peer.node.count_publishers('/humans/bodies/p7/joint_states'))
    assert stop_node(bridge) == []


def test_a_person_moves_an_avatar(peer: Peer, start: StartProgram) -> None:
    osc_bundle = pytest.importorskip('pythonosc.osc_bundle')
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.settimeout(TIMEOUT_S)
        bridge = start(*BRIDGE, '--ros-args', '-p', f'vmc:=127.0.0.1:{receiver.getsockname()[1]}')
        peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
        wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
        skeletons.publish(encode_skeletons(Header(1, 'camera'), gather([make_person_3d('anna')])))
        messages = list(osc_bundle.OscBundle(receiver.recv(65536)))
    assert {m.params[0] for m in messages if m.address == '/VMC/Ext/Bone/Pos'} >= {'Hips', 'Head', 'LeftHand'}
    assert stop_node(bridge) == []


def run_detector(env: dict[str, str], kind: str, frames: list[Any]) -> str:
    done = subprocess.run(
        [sys.executable, '-m', 'tests.support.foreign_detector', kind],
        env=foreign_packages.environment(env),
        cwd=ROOT,
        input=json.dumps(frames),
        capture_output=True,
        text=True,
        check=False,
        timeout=3 * TIMEOUT_S,  # the detector itself waits for one event after the other
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def place_people(frame: int, *names: str) -> dict[str, list[list[float]]]:
    """Return the demo person's (x, y, score) in COCO order under each name, side by side."""
    points = make_recording().keypoints[frame].astype(float)
    return {
        name: [[x + 100 * i, y, s] if s > 0 else [0.0, 0.0, 0.0] for x, y, s in points.tolist()]
        for i, name in enumerate(names)
    }


def assert_replay_gives_the_same(bag_folder: Path, out: Path, skeletons: list[bytes]) -> None:
    with Bag(bag_folder) as bag:
        replay(bag, out)
    replayed = read_messages(out, '/skeletons')
    np.testing.assert_allclose(stack_joints(replayed), stack_joints(skeletons), atol=1e-9, rtol=0)


def test_yolo_with_transforms(env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=yolo_msgs/msg/DetectionArray',
        'node.publish_tf:=true',
        'node.output_frame:=map',
        'node.frame_prefix:=left_',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_node()
    info = peer.node.create_publisher(load_interface_class(CAMERA_INFO), 'camera_info', 1)
    peer.wait_until(info.get_subscription_count)
    wait_until_discovered(peer.node, peer.executor, 'mocap_node')
    info.publish(camera_info())
    peer.wait_for_diagnostics('focal length', 'known')
    frames: list[Any] = [[(f + 1) * 10**8, place_people(f, 'anna', 'b/ob')] for f in range(20)]
    transforms = json.loads(run_detector(env, 'yolo', frames))
    peer.wait_for_frames(len(frames))
    assert stop_node(node) == []
    for raw, (stamp_ns, _) in zip(peer.received['skeletons'], frames, strict=True):
        skeletons = decode(raw, SKELETONS)
        assert [p.id for p in skeletons.people] == ['anna', 'b/ob']
        assert (skeletons.header.frame_id, skeletons.camera_frame_id) == ('map', 'camera')
        assert skeletons.camera_pose.position.x == pytest.approx(stamp_ns / 1e9 + 0.5)
    parents_and_children = {tuple(t) for message in transforms for t in message}
    assert ('map', 'left_body_anna') in parents_and_children
    assert ('left_body_b_ob', 'left_l_shoulder_b_ob') in parents_and_children
    assert ('map', 'left_mocap_world') in parents_and_children
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        assert bag.topics['/keypoints'] == 'yolo_msgs/msg/DetectionArray'
        own = [m for m in bag.messages(['/tf']) if is_of_people_only(m.raw, 'left_')]
        assert len(own) == len(frames)  # what the node heard of itself is no input
    assert_replay_gives_the_same(bag_folder, tmp_path / 'again', peer.received['skeletons'])


def test_bodies_that_come_and_go(env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=hri_msgs/msg/Skeleton2D',
        'node.image_width:=640',
        'node.image_height:=480',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_node()
    ids = [['b1'], ['b1', 'b2'], ['b1', 'b2'], ['b2']]  # of the bodies in each frame
    coco_joints = keypoint_layout('coco17').joints
    order = [coco_joints.index(j) if j != 'neck' else -1 for j in keypoint_layout('hri18').joints]
    frames = []
    for i, present in enumerate(ids):
        people = {
            name: [[p[j][0] / 640, p[j][1] / 480, p[j][2]] if j >= 0 else [0.0, 0.0, 0.0] for j in order]
            for name, p in place_people(i, 'b1', 'b2').items()
            if name in present
        }
        frames.append([(i + 1) * 10**8, people])
    run_detector(env, 'hri', frames)
    peer.wait_for_frames(len(frames))
    assert stop_node(node) == []
    people_seen = [decode(raw, SKELETONS).people for raw in peer.received['skeletons']]
    assert [[p.id for p in people if not p.predicted] for people in people_seen] == ids
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    assert_replay_gives_the_same(bag_folder, tmp_path / 'again', peer.received['skeletons'])
