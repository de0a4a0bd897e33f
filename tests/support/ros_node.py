# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node as its users run it, a process of its own, and a peer in this process that talks to it over DDS."""

import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.markers import DELETE_ALL, MARKERS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, SKELETONS
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.outputs import OUTPUTS
from tests.support.pipeline_inputs import encode_demo_frames, with_stamp

TIMEOUT_S = 60.0  # s; far above what anything here takes on a busy machine
ANSWER_S = 1.0  # s; an answer that takes longer is lost, because the server had not discovered the client
# The machine may pause for longer than the silence of which the node warns by default.
PATIENT = 'node.silence_warning:=60.0'
WAITLESS = 'node.camera_info_wait:=0.0'
FAST_PARAMETERS = ('tracker.model:=walk', 'tracker.iterations:=1', 'tracker.components:=8', WAITLESS, PATIENT)
# A best-effort subscription may miss the first messages.
RELIABLE_INPUT = 'qos_overrides./keypoints.subscription.reliability:=reliable'

Process = subprocess.Popen[str]
StartProgram = Callable[..., Process]  # a command's words


class StartNode(Protocol):
    """The fixture that starts the node with these parameters and further ROS arguments."""

    def __call__(self, *parameters: str, ros: Sequence[str] = ()) -> Process: ...


def wait_until_discovered(node: Any, executor: Any, by: str) -> None:
    """Wait until another node has discovered all publishers, subscriptions and clients that a node here has.

    What is sent to or from an entity before the other side has discovered it is lost, and each side discovers the
    other by itself. Discovery keeps the order in which a process makes its entities, so that a node that answers
    the newest client knows all before it. The request changes nothing, so that it can be repeated.

    Args:
        node: node of this process.
        executor: executor of that node.
        by: name of the other node; when it answers, it has also taken what was sent since an earlier call.
    """
    from rcl_interfaces.srv import GetParameters

    client = node.create_client(GetParameters, f'{by}/get_parameters')
    deadline = time.monotonic() + TIMEOUT_S
    future = None
    while future is None or not future.done():
        assert time.monotonic() < deadline, f'{by} does not answer'
        if client.service_is_ready():
            future = client.call_async(GetParameters.Request())
            executor.spin_until_future_complete(future, timeout_sec=ANSWER_S)
        else:
            executor.spin_once(timeout_sec=0.05)
    node.destroy_client(client)


class Peer:
    """A node in this process that sends keypoints and keeps the outputs of `mocap_node` as bytes.

    Attributes:
        received: Messages by the relative names of their topics.
        log: Lines that `mocap_node` has logged, without time and name.
    """

    def __init__(self, domain: int) -> None:
        import rclpy
        from rcl_interfaces.msg import Log
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rclpy.signals import SignalHandlerOptions

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.log: list[str] = []
        self.node.create_subscription(Log, '/rosout', self._keep_line, QoSProfile(depth=1000))
        self.received: dict[str, list[bytes]] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.subscriptions = []
        for topic, msgtype in (*OUTPUTS.items(), ('skeleton_definition', SKELETON_DEFINITION)):
            self.received[topic] = []
            qos = QoSProfile(depth=1000) if topic in OUTPUTS else latched
            keep = self.received[topic].append
            message_class = load_interface_class(msgtype)
            self.subscriptions.append(self.node.create_subscription(message_class, topic, keep, qos, raw=True))
        self.keypoints = self.node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', 10)

    def _keep_line(self, line: Any) -> None:
        if line.name == 'mocap_node':
            self.log.append(line.msg)

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def wait_until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.05)

    def wait_for_node(self) -> None:
        """Wait until the node publishes its outputs."""
        self.wait_until(lambda: all(s.get_publisher_count() for s in self.subscriptions))
        self.wait_until(lambda: self.received['skeleton_definition'])

    def wait_for_keypoints_subscription(self) -> None:
        self.wait_until(lambda: self.keypoints.get_subscription_count() == 1)

    def wait_for_frames(self, count: int) -> None:
        self.wait_until(lambda: len(self.received['skeletons']) >= count)
        assert len(self.received['skeletons']) == count

    def wait_for_log(self, words: str) -> None:
        self.wait_until(lambda: any(words in line for line in self.log))

    def wait_for_diagnostics(self, key: str, value: str) -> None:
        """Wait until a value in the diagnostics that the node sends from now on is this one."""
        from diagnostic_msgs.msg import DiagnosticArray

        received: list[Any] = []
        subscription = self.node.create_subscription(DiagnosticArray, '/diagnostics', received.append, 10)
        wanted = (key, value)
        self.wait_until(lambda: received and wanted in {(v.key, v.value) for v in received[-1].status[0].values})
        self.node.destroy_subscription(subscription)

    def call_service(self, service_class: Any, name: str, **request: object) -> Any:
        """Call a service of the node once, when the node has discovered the client, and return the answer."""
        client: Any = self.node.create_client(service_class, name)
        self.wait_until(client.service_is_ready)
        wait_until_discovered(self.node, self.executor, 'mocap_node')
        future = client.call_async(service_class.Request(**request))
        self.wait_until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def set_parameter(self, name: str, value: Any) -> Any:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = [Parameter(name, value=value).to_parameter_msg()]
        return self.call_service(SetParameters, 'mocap_node/set_parameters', parameters=request).results[0]

    def get_parameter(self, name: str) -> Any:
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        (value,) = self.call_service(GetParameters, 'mocap_node/get_parameters', names=[name]).values
        return parameter_value_to_python(value)

    def record(self, is_wanted: bool) -> Any:
        from std_srvs.srv import SetBool

        return self.call_service(SetBool, 'mocap_node/record', data=is_wanted)

    def change_state(self, *transitions: int) -> None:
        from lifecycle_msgs.srv import ChangeState

        for transition in transitions:
            request = ChangeState.Request()
            request.transition.id = transition
            answer = self.call_service(ChangeState, 'mocap_node/change_state', transition=request.transition)
            assert answer.success

    def are_markers_deleted(self) -> bool:
        return bool(decode(self.received['markers'][-1], MARKERS).markers[0].action == DELETE_ALL)

    def wait_for_end(self) -> None:
        """Wait for all outputs of a node that has published people and has ended."""

        def has_ended() -> bool:
            """Return whether the last markers are here, which delete all, and as many skeletons as markers."""
            skeletons, markers = self.received_stamps('skeletons'), self.received_stamps('markers')
            return skeletons == markers != [] and self.are_markers_deleted()

        self.wait_until(has_ended)

    def received_stamps(self, topic: str) -> list[int]:
        """Return the stamps in ns of the messages received on a topic, without those that delete all markers."""
        stamps = []
        for raw in self.received[topic]:
            message = decode(raw, OUTPUTS[topic])
            if topic == 'markers' and message.markers[0].action == DELETE_ALL:
                continue
            header = message.markers[0].header if topic == 'markers' else message.header
            stamps.append(header.stamp.sec * 10**9 + header.stamp.nanosec)
        return stamps


def stop_node(process: Process, by: signal.Signals = signal.SIGTERM) -> list[str]:
    """Stop the node; return the warnings and errors that it logged."""
    process.send_signal(by)
    _, log = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0
    return [line for line in log.splitlines() if not line.startswith('[INFO]')]


def stack_joints(skeletons: Sequence[bytes]) -> np.ndarray:
    """Return the joints (N, 3) in m of all people in these messages."""
    people = [decode(raw, SKELETONS).people for raw in skeletons]
    return np.array([[p.x, p.y, p.z] for frame in people for person in frame for p in person.joints])


def keypoints_at(seconds: float) -> bytes:
    return with_stamp(encode_demo_frames(1)[0], round(seconds * 1e9))
