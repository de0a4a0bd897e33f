"""The node as users run it: processes of their own, talking over DDS, ended by signals."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import known_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.markers import DELETE_ALL, MARKERS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, SKELETONS, encode_skeleton_definition
from mocap_ros.ros.help import INPUTS, SERVICES
from mocap_ros.ros.main import main
from mocap_ros.ros.message_types import interface_class
from mocap_ros.runtime.pipeline import OUTPUTS
from mocap_ros.runtime.replay import replay
from mocap_ros.runtime.sequence_messages import sequence_samples
from mocap_ros.skeleton import CMU15, layout
from tests.support import foreign_packages
from tests.support.camera_infos import camera_info
from tests.support.paths import ROOT

rclpy = pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

PATIENCE = 20.0
FRAMES = 60
DOMAINS = count(os.getpid())
RELIABLE = 'qos_overrides./keypoints.subscription.reliability:=reliable'  # or the first ones may be missed
STATE_AFTER = {'configured': 'unconfigured', 'activated': 'inactive'}
FAST = ['tracker.model:=walk', 'tracker.iterations:=1', 'tracker.components:=8']


class Peer:
    """A node in this process: sends keypoints, takes the node's outputs as bytes."""

    def __init__(self, domain: int) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rclpy.signals import SignalHandlerOptions

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.received: dict[str, list[bytes]] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.subscriptions = []
        for topic, msgtype in (*OUTPUTS.items(), ('skeleton_definition', SKELETON_DEFINITION)):
            self.received[topic] = []
            qos = QoSProfile(depth=1000) if topic in OUTPUTS else latched
            take = self.received[topic].append
            kind = interface_class(msgtype)
            self.subscriptions.append(self.node.create_subscription(kind, topic, take, qos, raw=True))
        self.keypoints = self.node.create_publisher(interface_class(KEYPOINTS), 'keypoints', 10)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def wait(self, what: Callable[[], object]) -> None:
        end = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=0.05)

    def wait_for_the_node(self) -> None:
        self.wait(lambda: all(s.get_publisher_count() for s in self.subscriptions))
        self.wait(lambda: self.received['skeleton_definition'])

    def call(self, kind: Any, name: str, **request: object) -> Any:
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.wait(future.done)
        return future.result()

    def cleared(self) -> bool:
        """Whether the last markers delete everything."""
        return bool(decode(self.received['markers'][-1], MARKERS).markers[0].action == DELETE_ALL)

    def stamps(self, topic: str) -> list[int]:
        found = []
        for raw in self.received[topic]:
            message = decode(raw, OUTPUTS[topic])
            if topic == 'markers' and message.markers[0].action == DELETE_ALL:
                continue
            header = message.markers[0].header if topic == 'markers' else message.header
            found.append(header.stamp.sec * 10**9 + header.stamp.nanosec)
        return found


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, str]:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(next(DOMAINS) % 101 + 1))
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    return dict(os.environ)


@pytest.fixture
def peer(env: dict[str, str]) -> Iterator[Peer]:
    peer = Peer(int(env['ROS_DOMAIN_ID']))
    yield peer
    peer.close()


@pytest.fixture
def start_node(env: dict[str, str], tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def start(*parameters: str, ros: Sequence[str] = ()) -> subprocess.Popen[str]:
        options = [word for p in (*FAST, RELIABLE, *parameters) for word in ('-p', p)]
        command = [sys.executable, '-m', 'mocap_ros.ros.main', '--ros-args', *options, *ros]
        process = subprocess.Popen(
            command, env=env, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def end(process: subprocess.Popen[str], by: signal.Signals) -> list[str]:
    """End the node; returns what it logged as warnings and errors."""
    return [line for line in all_lines(process, by) if not line.startswith('[INFO]')]


def all_lines(process: subprocess.Popen[str], by: signal.Signals) -> list[str]:
    """End the node; returns all that it logged."""
    asked = time.monotonic()
    process.send_signal(by)
    _, log = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert time.monotonic() - asked < 2.0
    return log.splitlines()


def mocap_ros(env: dict[str, str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'mocap_ros.cli.main', *map(str, arguments)]
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=60)


def joints(skeletons: list[bytes]) -> np.ndarray:
    people = [decode(raw, SKELETONS).people for raw in skeletons]
    return np.array([[p.x, p.y, p.z] for frame in people for person in frame for p in person.joints])


def test_live_run_is_received_recorded_and_replayed(
    env: dict[str, str], peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    sequence = make_recording().sequence()
    samples = list(islice(sequence_samples(sequence), FRAMES))
    with Recorder(tmp_path / 'played', RecorderConfig()) as recorder:
        for sample in samples:
            recorder.write('/detections', KEYPOINTS, sample.raw, sample.due_ns, sample.due_ns)

    patient = ('node.silence_warning:=60.0', 'node.queue:=100')  # the machine may be busy
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags', *patient)
    peer.wait_for_the_node()
    started = time.monotonic()
    player = subprocess.Popen(
        [sys.executable, '-m', 'mocap_ros.cli.main', 'play', str(tmp_path / 'played')],
        env=env,
        stdout=subprocess.PIPE,
        text=True,
    )
    peer.wait(lambda: all(len(peer.received[t]) >= FRAMES for t in OUTPUTS))
    assert time.monotonic() - started > (FRAMES - 1) / 30
    out, _ = player.communicate(timeout=PATIENCE)
    assert out == f'{tmp_path}/played: {FRAMES} messages published on keypoints\n'
    warnings = end(node, signal.SIGTERM)
    peer.wait(peer.cleared)

    assert warnings == []
    for topic in OUTPUTS:
        assert peer.stamps(topic) == sequence.stamps_ns[:FRAMES]
    (definition,) = peer.received['skeleton_definition']
    assert decode(definition, SKELETON_DEFINITION).name == 'cmu15'

    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        recorded = {t: [m.raw for m in bag.messages(['/' + t])] for t in (*peer.received, 'keypoints')}
        times = [m.time_ns for m in bag.messages(bag.topics)]
    assert recorded.pop('keypoints') == [s.raw for s in samples]
    markers = peer.received['markers']
    del markers[: len(markers) - FRAMES - 1]  # the recording begins after everything was deleted
    assert recorded == peer.received
    assert times == sorted(times)
    assert abs(times[-1] - time.time_ns()) < 60e9
    with (bag_folder / f'{bag_folder.name}_0.mcap').open('rb') as file:
        read: dict[str, list[bytes]] = {}
        for _, channel, message in make_reader(file).iter_messages():
            read.setdefault(channel.topic, []).append(message.data)
            assert abs(message.publish_time - message.log_time) < 1e9
    assert {t: read['/' + t] for t in recorded} == recorded

    done = mocap_ros(env, 'replay', bag_folder, '-o', tmp_path / 'again')
    assert (done.returncode, done.stderr) == (0, '')
    with Bag(tmp_path / 'again') as again:
        replayed = [m.raw for m in again.messages(['/skeletons'])]
    assert len(replayed) == FRAMES
    np.testing.assert_allclose(joints(replayed), joints(recorded['skeletons']), atol=1e-9, rtol=0)


def stamped(seconds: float, **change: Any) -> bytes:
    """A good message, or one with something changed in its person."""
    names = layout('coco17').joints
    points = make_recording().keypoints[0]
    person = Person2D('', names, np.nan_to_num(points[:, :2]), points[:, 2])
    raw = encode_keypoints(Header(round(seconds * 1e9), 'camera'), (640, 480), [person])
    message = decode(raw, KEYPOINTS)
    for field, value in change.items():
        setattr(message.people[0], field, value)
    return encode(message, KEYPOINTS)


X = np.arange(17, dtype='f4')
BAD_STREAM = {
    stamped(10, x=np.where(X == 3, np.inf, X)): r'people\[0\]\.x\[3\]: inf',
    stamped(10, score=np.full(17, 1.5, 'f4')): r'people\[0\]\.score\[0\]: 1\.5',
    stamped(10, score=np.full(17, -1, 'f4')): r'people\[0\]\.score\[0\]: -1',
    stamped(10, y=X[:5]): r'people\[0\]\.x, y, score: unequal lengths 17, 5, 17',
    stamped(10, skeleton='coco99'): r"people\[0\]\.skeleton: unknown keypoint layout 'coco99'; known: .*coco17",
    stamped(10, skeleton='body25'): r"people\[0\]\.skeleton: 'body25' has 25 joints, x has 17",
    stamped(10)[:-6]: 'not a mocap_ros_msgs/msg/Keypoints2DArray',
    b'\0\1\0\0rubbish': 'not a mocap_ros_msgs/msg/Keypoints2DArray',
    stamped(27.5): 'stamp 27500000000 ns is older than',
}


def test_bad_input_is_said_once_each_and_the_stream_goes_on(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]]
) -> None:
    node = start_node()
    peer.wait_for_the_node()
    peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
    sent = []
    for i, bad in enumerate(BAD_STREAM):
        sent.append(20 + i)
        peer.keypoints.publish(stamped(20 + i))
        peer.wait(lambda: len(peer.received['skeletons']) == len(sent))
        peer.keypoints.publish(bad)
    unseen = stamped(50, x=np.full(17, np.nan, 'f4'))
    nobody = encode_keypoints(Header(51 * 10**9, 'camera'), (640, 480), [])
    for last in (unseen, nobody, stamped(52)):
        peer.keypoints.publish(last)
    peer.wait(lambda: len(peer.received['skeletons']) == len(sent) + 3)
    complaints = end(node, signal.SIGINT)

    assert peer.stamps('skeletons') == [s * 10**9 for s in (*sent, 50, 51, 52)]
    assert len(complaints) == len(BAD_STREAM)
    for number, (line, reason) in enumerate(zip(complaints, BAD_STREAM.values(), strict=True)):
        assert re.search(rf': /keypoints: message {2 * number + 2}: {reason}', line), line


def test_services_parameters_and_lifecycle(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    from lifecycle_msgs.srv import ChangeState
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter
    from std_srvs.srv import SetBool, Trigger

    def set_parameter(name: str, value: object) -> Any:
        request = [Parameter(name, value=value).to_parameter_msg()]
        return peer.call(SetParameters, 'mocap_node/set_parameters', parameters=request).results[0]

    node = start_node(f'recorder.folder:={tmp_path}/bags', 'node.silence_warning:=0.5')
    peer.wait_for_the_node()
    assert set_parameter('tracker.min_score', 0.2).successful
    assert not set_parameter('tracker.min_score', 1.5).successful
    assert 'squared, frobenius' in set_parameter('solver.norm', 'none').reason
    assert not set_parameter('recorder.folder', '/').successful

    assert peer.call(SetBool, 'mocap_node/record', data=True).success
    assert 'already' in peer.call(SetBool, 'mocap_node/record', data=True).message
    peer.keypoints.publish(stamped(1))
    peer.wait(lambda: peer.received['skeletons'])
    assert peer.call(Trigger, 'mocap_node/reset').success
    peer.keypoints.publish(stamped(1))
    peer.wait(lambda: len(peer.received['skeletons']) == 2)
    done = peer.call(SetBool, 'mocap_node/record', data=False)
    assert done.success
    with Bag(done.message) as bag:
        assert bag.count(['/skeletons']) == 2
        replay(bag, tmp_path / 'again')

    for transition in (4, 3):  # deactivate, activate
        request = ChangeState.Request()
        request.transition.id = transition
        assert peer.call(ChangeState, 'mocap_node/change_state', transition=request.transition).success
    time.sleep(1.2)
    peer.keypoints.publish(stamped(1))
    peer.wait(lambda: len(peer.received['skeletons']) == 3)
    time.sleep(1.2)
    silences = [line for line in end(node, signal.SIGTERM) if 'no message on /keypoints' in line]
    assert silences[-2].endswith('s: its publisher sends nothing, or its QoS does not fit')
    assert silences[-1].endswith('no message on /keypoints for 1 s')


def test_the_node_says_what_it_listens_to_and_which_parameters_it_does_not_know(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    (tmp_path / 'p.yaml').write_text('mocap_node: {ros__parameters: {tracker: {windw: 2.0}, queue: 3}}')
    node = start_node('use_sim_time:=false', 'trackr.model:=walk', ros=['--params-file', f'{tmp_path}/p.yaml'])
    peer.wait_for_the_node()
    peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
    for second in (1, 2):
        peer.keypoints.publish(stamped(second))
    peer.wait(lambda: len(peer.received['skeletons']) == 2)
    lines = [line.partition('[mocap_node]: ')[2] for line in all_lines(node, signal.SIGINT)]

    unknown, said = lines[:3], lines[3:]
    assert sorted(unknown) == [
        "unknown parameter 'queue' has no effect; did you mean 'node.queue'?",
        "unknown parameter 'tracker.windw' has no effect; did you mean 'tracker.window'?",
        "unknown parameter 'trackr.model' has no effect; did you mean 'tracker.model'?",
    ]
    topics = (
        '/keypoints and /camera_info, publishing /skeletons, /cameras, /markers, /points, /skeleton_definition'
    )
    assert said == [f'listening on {topics}, model walk', '/keypoints: first message accepted']


def test_help_tells_arguments_topics_and_the_services_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(['--help'])
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    for word in (
        '-p tracker.window:=',
        '--params-file FILE',
        *OUTPUTS.values(),
        KEYPOINTS,
        *SERVICES.values(),
    ):
        assert word in said
    for kind in (*INPUTS.values(), *SERVICES.values()):
        assert interface_class(kind)


@pytest.mark.parametrize(
    ('arguments', 'code', 'reason'),
    [
        (['--ros-args', '--params-file', 'none.yaml'], 1, 'none.yaml'),
        (['--ros-args', '--params-file', 'bad.yaml'], 1, 'bad.yaml'),
        (['--ros-args', '--frobnicate'], 1, '--frobnicate'),
        (['tracker.window:=2.0'], 2, 'unrecognized arguments: tracker.window:=2.0'),
    ],
)
def test_wrong_arguments_are_said_without_a_traceback(
    env: dict[str, str], tmp_path: Path, arguments: list[str], code: int, reason: str
) -> None:
    (tmp_path / 'bad.yaml').write_text('{')
    command = [sys.executable, '-m', 'mocap_ros.ros.main', *arguments]
    done = subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, text=True, check=False)
    *usage, line = done.stderr.splitlines()
    assert (done.returncode, len(usage)) == (code, code - 1)
    assert line.startswith('mocap_node: ')
    assert reason in line


def test_without_ros_the_node_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, 'mocap_ros.ros.node', raising=False)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main([]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('mocap_node: needs ROS 2')


def test_a_parameter_out_of_range_is_one_line(start_node: Callable[..., subprocess.Popen[str]]) -> None:
    process = start_node('tracker.min_score:=2.0')
    _, log = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    (line,) = log.splitlines()
    assert 'tracker.min_score' in line


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        (['node.input_type:=std_msgs/msg/String'], r"'std_msgs/msg/String' is not supported; .* not configured"),
        (['tracker.model:=broken.npz'], r'broken\.npz: not a base-pose model .*; the node is not configured'),
        (['qos_overrides./camera_info.subscription.reliability:=rubbish'], r'; the node is not activated'),
        (['recorder.enabled:=true', f'recorder.folder:={"x" * 300}'], r'File name too long; nothing is recorded'),
    ],
)
def test_a_node_that_cannot_start_says_why_in_one_line_and_lives(
    peer: Peer,
    start_node: Callable[..., subprocess.Popen[str]],
    tmp_path: Path,
    parameters: list[str],
    reason: str,
) -> None:
    from lifecycle_msgs.srv import GetState

    (tmp_path / 'broken.npz').write_bytes(b'PK\3\4 no model')
    process = start_node(*parameters)
    state = peer.call(GetState, 'mocap_node/get_state').current_state.label
    line, *more = end(process, signal.SIGTERM)
    assert (state, more) == (STATE_AFTER.get(reason.rpartition('not ')[2], 'active'), [])
    assert re.search(reason, line)


def test_recording_by_parameter_and_a_folder_that_is_removed(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter
    from std_srvs.srv import SetBool

    def switch(on: bool) -> None:
        request = [Parameter('recorder.enabled', value=on).to_parameter_msg()]
        answer = peer.call(SetParameters, 'mocap_node/set_parameters', parameters=request)
        assert answer.results[0].successful

    node = start_node(f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_the_node()
    peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
    switch(True)
    peer.keypoints.publish(stamped(1))
    peer.wait(lambda: peer.received['skeletons'])
    switch(False)
    (first,) = (tmp_path / 'bags').iterdir()
    with Bag(first) as bag:
        assert bag.count(['/keypoints']) == 1
        assert [q.history.name for q in bag.qos['/keypoints']] == ['UNKNOWN']  # as discovery tells it

    assert not peer.call(SetBool, 'mocap_node/record', data=False).success
    switch(True)
    peer.wait(lambda: len(list((tmp_path / 'bags').iterdir())) == 2)
    (second,) = set((tmp_path / 'bags').iterdir()) - {first}
    shutil.rmtree(second)
    time.sleep(0.8)
    assert not peer.call(SetBool, 'mocap_node/record', data=False).success
    peer.keypoints.publish(stamped(2))
    peer.wait(lambda: len(peer.received['skeletons']) == 2)
    (line,) = end(node, signal.SIGTERM)
    assert re.search(r'removed or moved while it was written; recording ends here', line)


@pytest.mark.parametrize('program', ['mocap_ros.ros.main', 'mocap_ros.cli.main'])
def test_an_interrupt_while_it_starts_is_no_traceback(env: dict[str, str], program: str) -> None:
    code = (
        'import _thread, builtins, sys; real = builtins.__import__\n'
        'def slow(name, *rest):\n'
        "    if name.startswith('mocap_ros.messages'): _thread.interrupt_main()\n"
        '    return real(name, *rest)\n'
        f'from {program} import main\n'
        "builtins.__import__ = slow; sys.exit(main(['replay', 'x', '-o', 'y']))"
    )
    done = subprocess.run([sys.executable, '-c', code], env=env, capture_output=True, text=True, check=False)
    assert 'Traceback' not in done.stderr


def test_playing_to_nobody_fails_in_one_line(env: dict[str, str], tmp_path: Path) -> None:
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    done = mocap_ros(env, 'play', tmp_path / 'demo.npz', '--wait', '0.3')
    assert (done.returncode, done.stderr) == (1, 'mocap-ros: nobody subscribed to /keypoints within 0.3 s\n')


def test_playing_everything_in_a_loop_with_its_clock_and_qos(
    env: dict[str, str], peer: Peer, tmp_path: Path
) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    bag, start = tmp_path / 'bag', 5 * 10**9
    best_effort = known_topic('/keypoints', KEYPOINTS).qos[0] | {'reliability': 'best_effort'}
    definition = encode_skeleton_definition(CMU15)
    with Recorder(bag, RecorderConfig()) as recorder:
        recorder.add(known_topic('/keypoints', KEYPOINTS, qos=[best_effort]))
        recorder.announce('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, definition, start, start)
        for i in range(10):
            recorder.write('/keypoints', KEYPOINTS, stamped(i), start + i * 10**8, start)

    received: list[bytes] = []
    times: list[Any] = []
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    for kind, topic, take in (
        ('rosgraph_msgs/msg/Clock', '/clock', times.append),
        (KEYPOINTS, '/keypoints', received.append),
    ):
        raw = topic == '/keypoints'
        peer.subscriptions.append(peer.node.create_subscription(interface_class(kind), topic, take, qos, raw=raw))
    command = [
        sys.executable,
        '-m',
        'mocap_ros.cli.main',
        'play',
        bag,
        '--all',
        '--loop',
        '--clock',
        '--rate',
        '2',
    ]
    player = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    peer.wait(lambda: len(received) > 25 and len({t.clock.nanosec for t in times}) > 10)
    offered = peer.node.get_publishers_info_by_topic('/keypoints')
    reliability = {p.qos_profile.reliability for p in offered if p.node_name == 'mocap_player'}
    (latched,) = peer.node.get_publishers_info_by_topic('/skeleton_definition')
    player.send_signal(signal.SIGINT)
    out, err = player.communicate(timeout=PATIENCE)

    assert (player.returncode, err) == (0, '')
    assert re.search(r'\d+ messages published on /keypoints, /skeleton_definition\n', out)
    assert reliability == {ReliabilityPolicy.BEST_EFFORT}
    assert latched.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert peer.received['skeleton_definition'][0] == definition
    assert {stamped(i) for i in range(10)} >= set(received)
    told = [t.clock.sec + t.clock.nanosec / 1e9 for t in times]
    assert min(told) >= 5.0
    assert max(told) <= 5.9
    assert len(set(told)) > 10


SENDER = """
import json, sys, time
import rclpy
from rclpy.qos import QoSProfile
from hri_msgs.msg import IdsList, NormalizedPointOfInterest2D, Skeleton2D
from yolo_msgs.msg import Detection, DetectionArray, KeyPoint2D
from tf2_msgs.msg import TFMessage

kind, frames = sys.argv[1], json.loads(sys.stdin.read())
rclpy.init()
node = rclpy.create_node('detector')
seen_tf = []
node.create_subscription(TFMessage, '/tf', seen_tf.append, 1000)

def wait(what):
    end = time.monotonic() + 15
    while not what():
        assert time.monotonic() < end
        rclpy.spin_once(node, timeout_sec=0.02)

def stamped(message, stamp):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = 'camera'
    return message

if kind == 'yolo':
    publisher = node.create_publisher(DetectionArray, 'keypoints', 100)
    wait(publisher.get_subscription_count)
    for stamp, people in frames:
        array = stamped(DetectionArray(), stamp)
        for name, points in people.items():
            detection = Detection(id=name)
            for i, (x, y, score) in enumerate(points):
                if score > 0:
                    keypoint = KeyPoint2D(id=i + 1, score=score)
                    keypoint.point.x, keypoint.point.y = x, y
                    detection.keypoints.data.append(keypoint)
            array.detections.append(detection)
        publisher.publish(array)
else:
    tracked = node.create_publisher(IdsList, '/humans/bodies/tracked', 100)
    wait(tracked.get_subscription_count)
    bodies = {}
    for stamp, people in frames:
        for name in people.keys() - bodies.keys():
            tracked.publish(stamped(IdsList(ids=list(people)), stamp - 1))
            bodies[name] = node.create_publisher(Skeleton2D, f'/humans/bodies/{name}/skeleton2d', 100)
            wait(bodies[name].get_subscription_count)
        for name in bodies.keys() - people.keys():
            tracked.publish(stamped(IdsList(ids=list(people)), stamp - 1))
            wait(lambda: not bodies[name].get_subscription_count())
            node.destroy_publisher(bodies.pop(name))
        for name, points in people.items():
            message = stamped(Skeleton2D(), stamp)
            for place, (x, y, score) in zip(message.skeleton, points):
                place.x, place.y, place.c = x, y, score
            bodies[name].publish(message)
        time.sleep(0.03)
if 'tf' in sys.argv:
    wait(lambda: len(seen_tf) >= len(frames))
    print(json.dumps([[(t.header.frame_id, t.child_frame_id) for t in m.transforms] for m in seen_tf]))
time.sleep(0.3)
node.destroy_node()
rclpy.shutdown()
"""


@pytest.fixture(scope='module')
def foreign() -> None:
    foreign_packages.build()


def send(env: dict[str, str], kind: str, frames: list[Any], *more: str) -> str:
    done = subprocess.run(
        [sys.executable, '-c', SENDER, kind, *more],
        env=foreign_packages.environment(env),
        input=json.dumps(frames),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def coco_people(frame: int, *names: str) -> dict[str, list[list[float]]]:
    points = make_recording().keypoints[frame].astype(float)
    return {
        name: [[x + 100 * i, y, s] if s > 0 else [0.0, 0.0, 0.0] for x, y, s in points.tolist()]
        for i, name in enumerate(names)
    }


@pytest.mark.slow
@pytest.mark.usefixtures('foreign')
def test_yolo_over_dds_with_frames_on_tf(
    env: dict[str, str], peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=yolo_msgs/msg/DetectionArray',
        'node.publish_tf:=true',
        'node.frame_prefix:=left_',
        'node.silence_warning:=60.0',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_the_node()
    info = peer.node.create_publisher(interface_class(CAMERA_INFO), 'camera_info', 1)
    peer.wait(info.get_subscription_count)
    time.sleep(0.3)
    info.publish(camera_info())
    time.sleep(0.3)
    frames = [[(f + 1) * 10**8, coco_people(f, 'anna', 'b/ob')] for f in range(8)]
    told = json.loads(send(env, 'yolo', frames, 'tf'))
    peer.wait(lambda: len(peer.received['skeletons']) == len(frames))
    assert end(node, signal.SIGTERM) == []
    for raw in peer.received['skeletons']:
        assert [p.id for p in decode(raw, SKELETONS).people] == ['anna', 'b/ob']
    parents = {tuple(t) for m in told for t in m}
    assert ('camera', 'left_body_anna') in parents
    assert ('left_body_b_ob', 'left_l_shoulder_b_ob') in parents
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        assert bag.topics['/keypoints'] == 'yolo_msgs/msg/DetectionArray'
        assert bag.count(['/tf']) == len(frames)
        replay(bag, tmp_path / 'again')
    with Bag(tmp_path / 'again') as again:
        replayed = [m.raw for m in again.messages(['/skeletons'])]
    np.testing.assert_allclose(joints(replayed), joints(peer.received['skeletons']), atol=1e-9, rtol=0)


@pytest.mark.slow
@pytest.mark.usefixtures('foreign')
def test_bodies_of_ros4hri_come_and_go_over_dds(
    env: dict[str, str], peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=hri_msgs/msg/Skeleton2D',
        'node.image_width:=640',
        'node.image_height:=480',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_the_node()
    names = [['b1'], ['b1', 'b2'], ['b1', 'b2'], ['b2']]
    order = [layout('coco17').joints.index(j) if j != 'neck' else -1 for j in layout('hri18').joints]
    frames = []
    for i, present in enumerate(names):
        people = {
            n: [[p[j][0] / 640, p[j][1] / 480, p[j][2]] if j >= 0 else [0.0, 0.0, 0.0] for j in order]
            for n, p in coco_people(i, *present).items()
        }
        frames.append([(i + 1) * 10**8, people])
    send(env, 'hri', frames)
    peer.wait(lambda: len(peer.received['skeletons']) >= len(frames))
    assert [line for line in end(node, signal.SIGTERM) if 'no message' not in line] == []
    seen = [[p.id for p in decode(raw, SKELETONS).people if not p.predicted] for raw in peer.received['skeletons']]
    assert seen == names
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        replay(bag, tmp_path / 'again')
    with Bag(tmp_path / 'again') as again:
        replayed = [m.raw for m in again.messages(['/skeletons'])]
    np.testing.assert_allclose(joints(replayed), joints(peer.received['skeletons']), atol=1e-9, rtol=0)


def test_diagnostics_say_how_the_node_is_doing(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]]
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    told: list[Any] = []
    peer.subscriptions.append(peer.node.create_subscription(DiagnosticArray, '/diagnostics', told.append, 10))
    node = start_node()
    peer.wait_for_the_node()
    peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
    peer.keypoints.publish(stamped(1))
    peer.keypoints.publish(stamped(1))
    peer.keypoints.publish(stamped(2)[:50])
    peer.wait(lambda: told and 'invalid in the last second' in told[-1].status[0].message)
    said = {v.key: v.value for v in told[-1].status[0].values}
    assert told[-1].status[0].name == '/mocap_node'
    assert (said['accepted'], said['invalid'], said['dropped: stamp'], said['people']) == ('1', '1', '1', '1')
    assert float(said['solve time p99 (ms)']) > 0
    assert said['recorder'] == 'off'
    end(node, signal.SIGTERM)


@pytest.mark.slow
def test_ended_at_any_moment_the_bag_is_whole(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    for trial in range(4):
        folder = tmp_path / f'bags{trial}'
        node = start_node('recorder.enabled:=true', f'recorder.folder:={folder}')
        peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
        stop = time.monotonic() + rng.uniform(0, 0.8)
        frame = 0
        while time.monotonic() < stop:
            frame += 1
            peer.keypoints.publish(stamped(frame / 30))
            time.sleep(0.01)
        asked = time.monotonic()
        node.send_signal(signal.SIGTERM if trial % 2 else signal.SIGINT)
        assert node.wait(PATIENCE) == 0
        assert time.monotonic() - asked < 2.0  # 1 s where nothing else is running
        for bag_folder in folder.iterdir():
            with Bag(bag_folder) as bag:
                assert bag.count(['/skeletons']) <= bag.count(['/keypoints']) <= frame
        peer.wait(lambda: peer.keypoints.get_subscription_count() == 0)


@pytest.mark.slow
def test_lifecycle_again_and_again_leaks_nothing(
    peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    from lifecycle_msgs.srv import ChangeState

    def change(transition: int) -> None:
        request = ChangeState.Request()
        request.transition.id = transition
        assert peer.call(ChangeState, 'mocap_node/change_state', transition=request.transition).success

    def held() -> tuple[int, int]:
        status = Path(f'/proc/{node.pid}/status').read_text()
        threads = int(re.search(r'Threads:\s+(\d+)', status)[1])  # type: ignore[index]
        return threads, len(list(Path(f'/proc/{node.pid}/fd').iterdir()))

    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_the_node()
    before = after = (0, 0)
    for round_number in range(6):
        for transition in (4, 2, 1, 3):  # deactivate, clean up, configure, activate
            change(transition)
        peer.wait(lambda: peer.keypoints.get_subscription_count() == 1)
        peer.keypoints.publish(stamped(round_number + 1))
        peer.wait(lambda: len(peer.received['skeletons']) == round_number + 1)  # noqa: B023
        after = held()
        before = before if round_number else after
    assert after[0] <= before[0]
    assert after[1] <= before[1] + 1
    assert [line for line in end(node, signal.SIGTERM) if 'no message' not in line] == []


def test_the_recipe_of_the_documentation_runs(
    env: dict[str, str], peer: Peer, start_node: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    from sensor_msgs.msg import Image

    text = (ROOT / 'docs' / 'detectors.md').read_text()
    (recipe,) = re.findall(r'<!-- recipe:.*?-->\n```python\n(.*?)```', text, re.DOTALL)
    (tmp_path / 'detector.py').write_text(recipe)
    node = start_node()
    detector = subprocess.Popen([sys.executable, str(tmp_path / 'detector.py')], env=env)
    try:
        peer.wait_for_the_node()
        images = peer.node.create_publisher(Image, 'image', 10)
        peer.wait(images.get_subscription_count)
        image = Image(width=640, height=480)
        image.header.frame_id = 'camera'
        while not peer.received['skeletons']:
            image.header.stamp.sec += 1
            images.publish(image)
            peer.executor.spin_once(timeout_sec=0.2)
            assert image.header.stamp.sec < 100
    finally:
        detector.kill()
        detector.wait()
    (person,) = decode(peer.received['skeletons'][-1], SKELETONS).people
    assert len(person.joints) == 15
    end(node, signal.SIGTERM)
