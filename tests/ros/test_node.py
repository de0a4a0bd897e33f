# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node and `detector_node` as processes: help, failing starts, life cycle, parameters, services, images."""

import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.cli.main import main as mocap_ros_main
from mocap_ros.config import Config, to_yaml
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import (
    SKELETON_DEFINITION,
    SKELETONS,
    decode_skeletons,
    encode_skeletons,
)
from mocap_ros.ros.main import bridge_main, depth_main, detector_main, main, merge_main
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.replay import replay
from mocap_ros.skeleton import keypoint_layout
from tests.support.blob_people import draw, save_detector, walk
from tests.support.camera_messages import camera_info, encode_pixels, make_compressed
from tests.support.pipeline_inputs import encode_demo_frames, with_stamp
from tests.support.ros_node import (
    TIMEOUT_S,
    Peer,
    StartNode,
    StartProgram,
    keypoints_at,
    stop_node,
    wait_until_discovered,
)
from tests.support.several_cameras import CENTRES, FPS, make_truth, place_camera, see

pytestmark = pytest.mark.ros

SHUT_DOWN_ACTIVE, DEACTIVATE, ACTIVATE, CLEAN_UP, CONFIGURE = 7, 4, 3, 2, 1  # of lifecycle_msgs/Transition


def read_state(peer: Peer) -> str:
    from lifecycle_msgs.srv import GetState

    return str(peer.call_service(GetState, 'mocap_node/get_state').current_state.label)


def reset(peer: Peer) -> Any:
    from std_srvs.srv import Trigger

    return peer.call_service(Trigger, 'mocap_node/reset')


@pytest.mark.parametrize(
    ('parameter', 'place'),
    [
        ('tracker.model:=broken.npz', 'broken.npz: '),
        ('qos_overrides./camera_info.subscription.reliability:=rubbish', 'reliability'),
    ],
)
def test_a_node_that_cannot_start_says_why_in_one_line_and_ends(
    start_node: StartNode, tmp_path: Path, parameter: str, place: str
) -> None:
    (tmp_path / 'broken.npz').write_bytes(b'PK\3\4 no model')
    process = start_node(parameter)
    _, log = process.communicate(timeout=TIMEOUT_S)
    (line,) = log.splitlines()
    assert process.returncode == 1
    assert line.startswith('mocap_node: ')
    assert place in line


def test_parameters_are_checked_and_unknown_ones_named(peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    (tmp_path / 'p.yaml').write_text('mocap_node: {ros__parameters: {tracker: {windw: 2.0}, queue: 3}}')
    given = 'tracker.min_score:=0', 'tracker.window:=3', 'node.publish_predictions:=true', 'trackr.model:=walk'
    node = start_node(*given, ros=['--params-file', f'{tmp_path}/p.yaml'])
    peer.wait_for_node()
    assert peer.get_parameter('tracker.window') == 3
    for name, value in (('tracker.window', 4), ('tracker.min_score', 0.2), ('tracker.body_heights', 'anna=1.65')):
        assert peer.set_parameter(name, value).successful
    for name, wrong, reason in (
        ('tracker.window', 'four', ''),
        ('tracker.min_score', 1.5, 'tracker.min_score'),
        ('solver.method', 'none', 'joint, alternation'),
        ('recorder.folder', '/', ''),
        ('tracker.body_heights', 'anna', 'anna'),
        ('tracker.lag', 0.2, 'tracker.lag = 0'),  # there are no predictions then
    ):
        answer = peer.set_parameter(name, wrong)
        assert (answer.successful, reason in answer.reason) == (False, True), answer.reason
    unknown = [re.findall("'(.*?)'", line) for line in stop_node(node)]
    known = ['queue', 'node.queue'], ['tracker.windw', 'tracker.window'], ['trackr.model', 'tracker.model']
    assert sorted(unknown) == [*known]


def test_a_node_without_autostart_obeys(peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    silence = 'node.silence_warning:=0.5'
    given = 'node.autostart:=false', 'use_sim_time:=true', silence, f'recorder.folder:={tmp_path}/bags'
    node = start_node(*given)
    assert read_state(peer) == 'unconfigured'
    peer.change_state(CONFIGURE)
    assert read_state(peer) == 'inactive'
    for answer in (reset(peer), peer.record(True), peer.record(False)):
        assert (answer.success, answer.message) == (False, 'the node is not active')
    assert peer.set_parameter('tracker.min_score', 1.0).successful  # no person is seen as well as that

    peer.wait_for_log('nothing has arrived on /clock')
    peer.change_state(ACTIVATE, DEACTIVATE, ACTIVATE)
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    peer.wait_for_log('or its QoS is incompatible')
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(1)
    peer.wait_for_log('check that its publisher is still running')
    assert decode(peer.received['skeletons'][0], SKELETONS).people == []

    peer.wait_for_log(reset(peer).message or 'no message')
    bag_folder = Path(peer.record(True).message)
    assert 'already' in peer.record(True).message
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(2)
    peer.change_state(SHUT_DOWN_ACTIVE)
    assert read_state(peer) == 'finalized'
    with Bag(bag_folder) as bag:
        assert bag.count(['/keypoints']) == bag.count(['/skeletons']) == 1
        replay(bag, tmp_path / 'again')
    lines = [line for line in stop_node(node) if 'no message has arrived' not in line]
    assert [('use_sim_time' in line, '~/record' in line) for line in lines] == [(True, False), (False, True)]


def test_the_topic_of_the_right_camera_info_is_named(peer: Peer, start_node: StartNode) -> None:
    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    infos = {'camera_info': camera_info(focal=385.0, frame_id='depth'), 'color/camera_info': camera_info()}
    publishers = {t: peer.node.create_publisher(load_interface_class(CAMERA_INFO), t, 10) for t in infos}
    peer.wait_until(publishers['camera_info'].get_subscription_count)
    wait_until_discovered(peer.node, peer.executor, 'mocap_node')
    seconds = count(1)

    def is_named() -> bool:
        for topic, publisher in publishers.items():
            publisher.publish(infos[topic])
        peer.keypoints.publish(keypoints_at(next(seconds)))
        return any("/color/camera_info has the CameraInfo of 'camera'" in line for line in peer.log)

    peer.wait_until(is_named)
    peer.wait_until(lambda: publishers['color/camera_info'].get_subscription_count() == 0)
    lines = stop_node(node)
    for words in ("'camera', but the CameraInfo on /camera_info is of 'depth'", 'remap camera_info to it'):
        assert sum(words in line for line in lines) == 1


@pytest.mark.slow
def test_transitions_leak_neither_threads_nor_files(peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    def count_threads_and_files() -> tuple[int, int]:
        status = Path(f'/proc/{node.pid}/status').read_text()
        threads = int(re.search(r'Threads:\s+(\d+)', status)[1])  # type: ignore[index]
        return threads, len(list(Path(f'/proc/{node.pid}/fd').iterdir()))

    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    counts = []
    for round_number in range(1, 5):
        peer.change_state(DEACTIVATE, CLEAN_UP)
        counts.append(count_threads_and_files())  # a recording has as many threads as its disk is slow
        peer.change_state(CONFIGURE, ACTIVATE)
        peer.wait_for_keypoints_subscription()
        peer.keypoints.publish(keypoints_at(round_number))
        peer.wait_for_frames(round_number)
    for of_one_kind in zip(*counts, strict=True):  # a leak has more in each of the later rounds
        assert min(of_one_kind[2:]) <= max(of_one_kind[:2])
    assert [line for line in stop_node(node) if 'no message has arrived' not in line] == []


def request_unknown_type(peer: Peer) -> Callable[[], object]:
    """Return a function that calls set_parameters with a value of a type that rclpy does not know."""
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    client: Any = peer.node.create_client(SetParameters, 'mocap_node/set_parameters')
    peer.wait_until(client.service_is_ready)
    request = SetParameters.Request(parameters=[Parameter(name='tracker.lag', value=ParameterValue(type=200))])
    return lambda: client.call_async(request)


def publish_negative_time(peer: Peer) -> Callable[[], object]:
    """Let the node take its time from /clock, and return a function that sends a time that rclpy refuses."""
    from rosgraph_msgs.msg import Clock

    assert peer.set_parameter('use_sim_time', True).successful
    publisher = peer.node.create_publisher(Clock, '/clock', 10)
    clock = Clock()
    clock.clock.sec = -5
    return lambda: publisher.publish(clock)


def test_messages_for_which_rclpy_raises_an_error_do_not_end_the_node(peer: Peer, start_node: StartNode) -> None:
    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    for prepare in (request_unknown_type, publish_negative_time):
        attack = prepare(peer)
        peer.log.clear()

        def is_logged(attack: Callable[[], object] = attack) -> bool:
            attack()
            return any('an internal error occurred, and the node continues' in line for line in peer.log)

        peer.wait_until(is_logged)
    for number, frame in enumerate(encode_demo_frames(3), 1):
        peer.keypoints.publish(with_stamp(frame, number * 10**9 // 30 + 10**9))
        peer.wait_for_frames(number)
    peer.keypoints.publish(keypoints_at(9)[:50])
    assert peer.get_parameter('tracker.lag') is not None, 'its services answer'
    for key, value in (('accepted', '3'), ('invalid', '1'), ('recorder', 'off')):
        peer.wait_for_diagnostics(key, value)
    lines = stop_node(node, signal.SIGINT)
    assert len([line for line in lines if 'an internal error' in line]) == 2


@pytest.mark.filterwarnings('ignore:Deprecated in favor of:DeprecationWarning')  # rclpy's own log calls
def test_peers_with_an_incompatible_qos_are_logged_once(peer: Peer, start_node: StartNode) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    node = start_node()  # subscribes to keypoints as reliable, by a parameter
    peer.wait_for_node()
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for _ in range(2):
        peer.node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', best_effort)
        peer.node.create_subscription(load_interface_class(SKELETONS), 'skeletons', print, latched)
        peer.wait_for_log('a weaker RELIABILITY policy')
        peer.wait_for_log('a stricter DURABILITY policy')
    publisher, subscriber = sorted(line.partition('[mocap_node]: ')[2] for line in stop_node(node))
    assert publisher.startswith('/keypoints: ')
    assert subscriber.startswith('/skeletons: ')


FRAME_NS = 33_333_333
# The detector takes the newest image only, if nothing else is said.
TAKE_ALL_IMAGES = 'qos_overrides./image.subscription.depth:=10'
# Found when they are declared, by the reader of a text, and when the node is configured.
WRONG_VALUES = 'tracker.lag:=9.0', 'tracker.vertical:=up', 'node.camera_pose:=1 2', 'node.input_type:=x/msg/Y'
DETECTOR = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.detector_main())'


@pytest.mark.parametrize(
    ('program', 'arguments', 'code', 'reason'),
    [
        (main, ['--ros-args', '--params-file', 'bad.yaml'], 1, 'bad.yaml'),
        (main, ['--ros-args', '--frobnicate'], 1, '--frobnicate'),
        (main, ['--ros-args', '-r', '__ns:=/left', '--params-file', 'p.yaml'], 1, 'tracker.body_height'),
        *((main, ['--ros-args', '-p', wrong], 1, wrong.partition(':')[0]) for wrong in WRONG_VALUES),
        (main, ['tracker.window:=2.0'], 2, 'tracker.window:=2.0'),
        (bridge_main, ['--ros-args', '-p', 'publish:=nobody'], 1, 'nobody'),
        (detector_main, ['--ros-args', '-p', 'model:=none.onnx'], 1, 'none.onnx'),
        (detector_main, ['--ros-args', '-p', 'image_type:=std_msgs/msg/String'], 1, 'image_type'),
        (depth_main, ['--ros-args', '-p', 'depth_type:=std_msgs/msg/String'], 1, 'depth_type'),
        (merge_main, ['--ros-args', '-p', 'inputs:=/left/skeletons'], 1, 'inputs'),
    ],
)
def test_wrong_arguments_are_reported_in_one_line(
    env: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    program: Callable[..., int],
    arguments: list[str],
    code: int,
    reason: str,
) -> None:
    assert env['ROS_DOMAIN_ID']
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('mocap_ros.ros.nodes.signal.signal', lambda *_: None)  # the handlers of pytest stay
    (tmp_path / 'bad.yaml').write_text('{')
    wrong = to_yaml(Config()).replace('body_height: 1.7\n', 'body_height: 9.0\n')
    (tmp_path / 'p.yaml').write_text(wrong)
    try:
        found = program(arguments)
    except SystemExit as stopped:
        found = int(stopped.code or 0)
    *usage, line = capfd.readouterr().err.splitlines()
    assert (found, len(usage)) == (code, code - 1)
    assert line.startswith(('mocap_node: ', 'mocap_bridge: ', 'detector_node: ', 'depth_node: ', 'mocap_merge: '))
    assert reason in line


def test_a_missing_ros_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name in [name for name in sys.modules if name.startswith('mocap_ros.ros.')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main([]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('mocap_node: needs ROS 2')


@pytest.mark.parametrize(
    ('program', 'end'),
    [('mocap_ros.ros.main', (0, '')), ('mocap_ros.cli.main', (130, 'mocap-ros: interrupted\n'))],
)
def test_an_interrupted_start_gives_no_traceback(env: dict[str, str], program: str, end: tuple[int, str]) -> None:
    code = (
        'import _thread, builtins, sys; real = builtins.__import__\n'
        'def slow(name, *rest):\n'
        "    if name.startswith('mocap_ros.messages'): _thread.interrupt_main()\n"
        '    return real(name, *rest)\n'
        f'from {program} import main\n'
        "builtins.__import__ = slow; sys.exit(main(['replay', 'x', '-o', 'y']))"
    )
    done = subprocess.run([sys.executable, '-c', code], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == end


@pytest.fixture
def start_detector(start: StartProgram, tmp_path: Path) -> StartProgram:
    """Start `detector_node` with a network that finds people made of blobs, and further parameters."""
    model = save_detector(tmp_path / 'detector.onnx')

    def start_with(*parameters: str) -> subprocess.Popen[str]:
        options = [word for p in (f'model:={model}', TAKE_ALL_IMAGES, *parameters) for word in ('-p', p)]
        return start(*DETECTOR, '--ros-args', *options)

    return start_with


class Camera:
    """Publisher of images, which waits for the keypoints of each."""

    def __init__(self, peer: Peer, msgtype: str = IMAGE) -> None:
        self.peer = peer
        self.received: list[Any] = []
        self.message_class = load_interface_class(msgtype)
        peer.node.create_subscription(load_interface_class(KEYPOINTS), 'keypoints', self.received.append, 10)
        self.publisher = peer.node.create_publisher(self.message_class, 'image', 10)
        peer.wait_until(self.publisher.get_subscription_count)
        wait_until_discovered(peer.node, peer.executor, 'detector_node')

    def send(self, stamp_ns: int, **fields: Any) -> None:
        message = self.message_class(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.header.frame_id = 'optical'
        self.publisher.publish(message)

    def show(self, stamp_ns: int, **fields: Any) -> Any:
        before = len(self.received)
        self.send(stamp_ns, **fields)
        self.peer.wait_until(lambda: len(self.received) > before)
        return self.received[-1]


def test_images_of_several_encodings_become_skeletons_and_bad_ones_are_logged(
    peer: Peer, start_detector: StartProgram, start_node: StartNode
) -> None:
    node, detector = start_node(), start_detector()
    peer.wait_for_node()
    camera = Camera(peer)
    empty, first_stamps_ns = encode_pixels(draw([]), 'mono8'), count(10**9, FRAME_NS)
    # Until the nodes have discovered each other.
    peer.wait_until(lambda: camera.show(next(first_stamps_ns), **empty) and peer.received['skeletons'])
    people = walk(6)
    encodings = ['rgb8', 'bgra8', 'yuv422_yuy2', 'bgr8', 'uyvy', 'bayer_rggb8']
    stamps_ns = [10**12 + frame * FRAME_NS for frame in range(6)]
    for stamp_ns, person, encoding in zip(stamps_ns, people, encodings, strict=True):
        message = camera.show(stamp_ns, **encode_pixels(draw([person]), encoding, padding=7))
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(stamp_ns, 10**9)
        assert message.header.frame_id == 'optical'
        assert (message.image_width, message.image_height) == (640, 480)
        (found,) = message.people
        assert found.skeleton == 'coco17'
        seen = np.array(found.score) > 0.5
        errors = np.hypot(np.array(found.x) - person[:, 0], np.array(found.y) - person[:, 1])[seen]
        assert np.nanmedian(errors) < 1.5, encoding
    peer.wait_until(lambda: set(stamps_ns) <= set(peer.received_stamps('skeletons')))
    (skeleton,) = decode(peer.received['skeletons'][-1], SKELETONS).people
    assert len(skeleton.joints) == 26
    stop_node(node)
    assert len(camera.show(2 * 10**12, **empty).people) == 0
    good = encode_pixels(draw([people[0]]), 'rgb8')
    for number, fault in enumerate([{'encoding': 'mono2'}] * 2 + [{'step': 3}]):
        camera.send(2 * 10**12 + number, **{**good, **fault})
    assert len(camera.show(3 * 10**12, **good).people) == 1
    camera.send(3 * 10**12, **good)
    assert len(camera.show(10**9, **good).people) == 1  # a bag that is played again
    lines = stop_node(detector)
    places = ': encoding: ', ': step: ', ': header.stamp: ', 'the detector starts anew'
    assert [[place in line for line in lines].count(True) for place in places] == [1] * len(lines) == [1] * 4


def test_inputs_are_reliable_until_a_publisher_is_not(
    peer: Peer, start_detector: StartProgram, start_node: StartNode
) -> None:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    topics = '/image', '/keypoints'

    def request(reliability: ReliabilityPolicy) -> bool:
        found = [peer.node.get_subscriptions_info_by_topic(topic) for topic in topics]
        return all(len(s) == 1 and s[0].qos_profile.reliability == reliability for s in found)

    node = start_node('qos_overrides./keypoints.subscription.reliability:=best_available')
    peer.wait_for_node()
    detector = start_detector()
    peer.wait_until(lambda: request(ReliabilityPolicy.RELIABLE))
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    classes = load_interface_class(IMAGE), load_interface_class(KEYPOINTS)
    for message_class, topic in zip(classes, topics, strict=True):
        peer.node.create_publisher(message_class, topic, best_effort)
    peer.wait_until(lambda: request(ReliabilityPolicy.BEST_EFFORT))
    camera, stamps_ns = Camera(peer), count(10**9, FRAME_NS)
    image = encode_pixels(draw([walk(1)[0]]), 'rgb8')

    def is_answered() -> object:
        camera.send(next(stamps_ns), **image)
        return camera.received and peer.received['skeletons']

    peer.wait_until(is_answered)
    assert stop_node(detector) == stop_node(node) == []


def test_compressed_images_are_taken(peer: Peer, start_detector: StartProgram) -> None:
    detector = start_detector(f'image_type:={COMPRESSED_IMAGE}')
    camera = Camera(peer, COMPRESSED_IMAGE)
    for stamp_ns, kind in enumerate(['PNG', 'JPEG'], 1):
        (found,) = camera.show(stamp_ns, **make_compressed(draw([walk(1)[0]]), kind)).people
        assert max(found.score) > 0.5
    assert stop_node(detector) == []


def test_keypoints_get_the_depths_of_a_registered_image(peer: Peer, start: StartProgram) -> None:
    node = start(*DETECTOR[:2], DETECTOR[2].replace('detector_main', 'depth_main'))
    received: list[Any] = []
    keypoints_class, image_class = load_interface_class(KEYPOINTS), load_interface_class(IMAGE)
    peer.node.create_subscription(keypoints_class, 'keypoints_depth', received.append, 10)
    topics = (keypoints_class, 'keypoints'), (image_class, 'depth')
    points, depth = (peer.node.create_publisher(*topic, 10) for topic in topics)
    peer.wait_until(lambda: points.get_subscription_count() and depth.get_subscription_count())
    wait_until_discovered(peer.node, peer.executor, 'depth_node')
    coco17 = keypoint_layout('coco17').joints
    seen = Person2D('a', coco17, np.tile([[9.0, 7.0]], (17, 1)) + np.arange(17)[:, None], np.ones(17))

    def send(stamp_ns: int, frame_id: str) -> Any:
        plane = np.full((48, 64), 2500, '<u2')
        fields = {'height': 48, 'width': 64, 'step': 128, 'encoding': '16UC1', 'data': plane.tobytes()}
        image = image_class(**fields)
        image.header.frame_id, image.header.stamp.nanosec = frame_id, stamp_ns
        depth.publish(image)
        before = len(received)
        points.publish(encode_keypoints(Header(stamp_ns, 'optical'), (64, 48), [seen]))
        peer.wait_until(lambda: len(received) > before)
        return received[-1].people[0].depth

    np.testing.assert_allclose(send(1000, 'optical'), 2.5)
    assert len(send(2000, 'another')) == 0
    (line,) = stop_node(node)
    assert 'aligned_depth_to_color' in line


def test_people_of_two_cameras_are_merged_and_recorded(peer: Peer, start: StartProgram, tmp_path: Path) -> None:
    """One camera is lost for a while, and its tracker comes back with other ids."""
    topics = ('/left/skeletons', '/right/skeletons')
    options = (f'inputs:={" ".join(topics)}', f'record:={tmp_path / "bags"}', 'publish_tf:=true')
    words = [word for option in options for word in ('-p', option)]
    node = start(*DETECTOR[:2], DETECTOR[2].replace('detector_main', 'merge_main'), '--ros-args', *words)
    publishers = [peer.node.create_publisher(load_interface_class(SKELETONS), topic, 10) for topic in topics]
    peer.wait_until(lambda: all(p.get_subscription_count() for p in publishers))
    wait_until_discovered(peer.node, peer.executor, 'mocap_merge')
    frames, rng = 60, np.random.default_rng(0)
    cameras = [see(make_truth(frames), centre, 1.03, rng, 'ab') for centre in CENTRES[:2]]
    for frame in range(frames):
        for number, (publisher, seen) in enumerate(zip(publishers, cameras, strict=True)):
            if number == 0 or not 20 <= frame < 40:
                people = replace(seen[frame], ids=('new',)) if number and frame >= 40 else seen[frame]
                header = Header(10**9 + frame * round(1e9 / FPS), 'map')
                publisher.publish(encode_skeletons(header, people, None, place_camera(CENTRES[number])))
        peer.wait_until(lambda: len(peer.received['skeletons']) == frame + 1)  # noqa: B023 # called at once
    merged = [decode_skeletons(raw, is_in_camera=False).people for raw in peer.received['skeletons']]
    assert {people.ids for people in merged} == {('1',)}
    assert decode(peer.received['skeleton_definition'][0], SKELETON_DEFINITION).name == 'cmu15'
    assert stop_node(node) == []
    (folder,) = (tmp_path / 'bags').iterdir()
    assert mocap_ros_main(['replay', str(folder), '-o', str(tmp_path / 'again')]) == 0
    with Bag(tmp_path / 'again') as bag:
        assert [m.raw for m in bag.messages(['/skeletons'])] == peer.received['skeletons']
