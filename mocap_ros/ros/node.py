"""The live node `mocap_node`: 2D keypoints in, skeletons, cameras and markers out, recorded where wanted.

Provisional: distortion of CameraInfo is not undone; only Keypoints2DArray is taken; no diagnostics, no /tf.
"""

from __future__ import annotations

import re
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import set_logger_level
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions

from mocap_ros.config import Config, Parameter, hint, parameters, with_values
from mocap_ros.errors import ConfigError, MocapError, RecordingError
from mocap_ros.io.messages import CAMERA_INFO, KEYPOINT_TYPES, OutputMessage
from mocap_ros.pipeline import LATCHED_OUTPUTS, OUTPUTS, Pipeline, Source, skeleton_definition
from mocap_ros.ros.live import LiveRun
from mocap_ros.ros.types import interface_class
from mocap_ros.ros.usage import SERVICES

DEPTH = 10
INPUT_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
OUTPUT_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
LARGEST_INTEGER = 2**31 - 1
NAME = 'mocap_node'
BY_RCLPY = 'qos_overrides.'


class MocapNode(LifecycleNode):
    """Runs a `LiveRun` while it is active.

    Raises:
        ConfigError: a parameter was given a value that it cannot take.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        self._pipeline: Pipeline | None = None
        self._run: LiveRun | None = None
        self._outputs: dict[str, Any] = {}
        self._inputs: list[Any] = []
        self._served: list[Any] = []
        self._silence_timer: Any = None
        self._last_input = time.monotonic()
        self._heard = self._told_silence = False
        self._told_qos: set[tuple[str, str]] = set()
        self._config = self._declared()
        self._warn_of_unknown_parameters()
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)

    @property
    def config(self) -> Config:
        """The parameters in force."""
        return self._config

    def _declared(self) -> Config:
        try:
            given: dict[str, object] = {
                p.name: self.declare_parameter(p.name, p.default, _descriptor(p)).value for p in parameters()
            }
        except ParameterException as error:
            raise ConfigError(str(error)) from None
        return with_values(Config(), given)

    def _warn_of_unknown_parameters(self) -> None:
        for name in self._parameter_overrides:
            if not self.has_parameter(name) and not name.startswith(BY_RCLPY):
                known = [p.name for p in parameters()]
                self.get_logger().warning(f'unknown parameter {name!r} has no effect; {hint(name, known)}')

    def _check_parameters(self, changed: list[RosParameter[Any]]) -> SetParametersResult:
        try:
            with_values(self._config, _ours(changed))
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, changed: list[RosParameter[Any]]) -> None:
        config = with_values(self._config, _ours(changed))
        if config == self._config:
            return
        self._config = config
        if self._run is not None:
            self._run.reconfigure(config)
        elif self._pipeline is not None:
            self._pipeline.reconfigure(config)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the model and offer topics and services."""
        try:
            self._configure()
        except MocapError as error:
            self.get_logger().error(str(error))
            self._clean_up()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take input."""
        result = super().on_activate(state)
        self._publish(skeleton_definition())
        self._start()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take no more input; delete the markers and finish the recording."""
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of model, topics and services."""
        result = super().on_cleanup(state)
        self._clean_up()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As deactivation and cleanup."""
        self._stop()
        result = super().on_shutdown(state)
        self._clean_up()
        return result

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As shutdown; the node can be configured again."""
        return self.on_shutdown(state)

    def start(self) -> bool:
        """Configure and activate; returns whether that worked."""
        done = TransitionCallbackReturn.SUCCESS
        return self.trigger_configure() == done and self.trigger_activate() == done

    def close(self) -> None:
        """Stop whatever runs and finish the recording."""
        self._stop()
        self._clean_up()

    def _configure(self) -> None:
        input_type = self._config.node.input_type
        if input_type not in KEYPOINT_TYPES:
            supported = ', '.join(KEYPOINT_TYPES)
            raise ConfigError(f'node.input_type {input_type!r} is not supported; {supported} is')
        interface_class(input_type)
        self._pipeline = Pipeline(self._config)
        for topics, qos in ((OUTPUTS, OUTPUT_QOS), (LATCHED_OUTPUTS, LATCHED_QOS)):
            for topic, msgtype in topics.items():
                self._outputs[topic] = self._advertise(topic, msgtype, qos)
        answers = {'~/reset': self._on_reset, '~/record': self._on_record}
        self._served = [
            self.create_service(interface_class(kind), name, answers[name]) for name, kind in SERVICES.items()
        ]

    def _advertise(self, topic: str, msgtype: str, qos: QoSProfile) -> Any:
        return self.create_lifecycle_publisher(
            interface_class(msgtype),
            topic,
            qos,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=lambda event: self._tell_qos(
                    topic, event.last_policy_kind, 'a subscriber', 'gets nothing'
                )
            ),
        )

    def _start(self) -> None:
        assert self._pipeline is not None  # noqa: S101
        types = {
            Source.KEYPOINTS: self._config.node.input_type,
            Source.CAMERA_INFO: CAMERA_INFO,
        }
        relative = [*(s.value for s in Source), *OUTPUTS, *LATCHED_OUTPUTS]
        names = {name: self.resolve_topic_name(name) for name in relative}
        names['journal'] = self.resolve_topic_name('~/journal')
        self._run = LiveRun(self._pipeline, types, names, self._publish, self.get_logger())
        self._run.start()
        self._inputs = [self._subscribe(source, msgtype) for source, msgtype in types.items()]
        self._last_input = time.monotonic()
        self._heard = self._told_silence = False
        self._tell_topics(names)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._silence_timer = self.create_timer(0.5, self._check_silence, clock=steady)

    def _tell_topics(self, names: Mapping[str, str]) -> None:
        """Say what is listened to and published, under the names it has."""
        heard = ' and '.join(names[source.value] for source in Source)
        said = ', '.join(names[topic] for topic in (*OUTPUTS, *LATCHED_OUTPUTS))
        self.get_logger().info(f'listening on {heard}, publishing {said}, model {self._config.tracker.model}')

    def _subscribe(self, source: Source, msgtype: str) -> Any:
        run = self._run
        assert run is not None  # noqa: S101

        def take(raw: Any, info: Any) -> None:
            run.put(source, raw, info['source_timestamp'])
            if source is Source.KEYPOINTS:
                self._last_input = time.monotonic()
                self._heard, self._told_silence = True, False

        return self.create_subscription(
            interface_class(msgtype),
            source.value,
            take,
            INPUT_QOS,
            raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda event: self._tell_qos(
                    source.value, event.last_policy_kind, 'a publisher', 'is not heard'
                )
            ),
        )

    def _stop(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        if self._silence_timer is not None:
            self.destroy_timer(self._silence_timer)
            self._silence_timer = None
        run, self._run = self._run, None
        if run is not None:
            run.stop()

    def _clean_up(self) -> None:
        for publisher in self._outputs.values():
            self.destroy_lifecycle_publisher(publisher)
        for service in self._served:
            self.destroy_service(service)
        self._outputs, self._served, self._pipeline = {}, [], None

    def _publish(self, output: OutputMessage) -> None:
        self._outputs[output.topic].publish(output.data)

    def _on_reset(self, _: Any, response: Any) -> Any:
        if self._run is None:
            response.message = 'the node is not active'
        else:
            self._run.reset()
            response.success = True
        return response

    def _on_record(self, request: Any, response: Any) -> Any:
        if self._run is None:
            response.message = 'the node is not active'
            return response
        try:
            folder = self._run.record() if request.data else self._run.end_recording()
        except RecordingError as error:
            self.get_logger().error(str(error))
            response.message = str(error)
            return response
        response.success = folder is not None
        response.message = str(folder) if folder else 'there is no recording'
        return response

    def _check_silence(self) -> None:
        silent = time.monotonic() - self._last_input
        if self._told_silence or silent < self._config.node.silence_warning:
            return
        self._told_silence = True
        topic = self.resolve_topic_name(Source.KEYPOINTS.value)
        why = '' if self._heard else f': {self._why(topic)}'
        self.get_logger().warning(f'no message on {topic} for {silent:.0f} s{why}')

    def _why(self, topic: str) -> str:
        """What may be the cause of a topic's silence from the start."""
        wanted = self._config.node.input_type
        publishers = self.get_publishers_info_by_topic(topic)
        others = {p.topic_type for p in publishers} - {wanted}
        if others:
            return f'its publisher sends {", ".join(sorted(others))}, expected {wanted}'
        if publishers:
            return 'its publisher sends nothing, or its QoS does not fit'
        elsewhere = [t for t, kinds in self.get_topic_names_and_types() if wanted in kinds]
        elsewhere = sorted(set(elsewhere) - {topic})
        if elsewhere:
            return f'nobody publishes it; remap keypoints to {" or ".join(elsewhere)}?'
        return 'nobody publishes it'

    def _tell_qos(self, name: str, policy: Any, who: str, effect: str) -> None:
        topic, kind = self.resolve_topic_name(name), qos_policy_name_from_kind(policy)
        if (topic, kind) not in self._told_qos:
            self._told_qos.add((topic, kind))
            self.get_logger().warning(f'{topic}: {who} with incompatible QoS ({kind}) {effect}')


def _ours(changed: Sequence[RosParameter[Any]]) -> dict[str, object]:
    known = {p.name for p in parameters()}
    return {p.name: p.value for p in changed if p.name in known}


def _descriptor(p: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=p.doc,
        additional_constraints=f'one of {", ".join(p.choices)}' if p.choices else '',
        read_only=p.read_only,
    )
    if p.kind is float and (p.low is not None or p.high is not None):
        low = -sys.float_info.max if p.low is None else float(p.low)
        high = sys.float_info.max if p.high is None else float(p.high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    if p.kind is int and (p.low is not None or p.high is not None):
        bottom = -LARGEST_INTEGER if p.low is None else int(p.low)
        top = LARGEST_INTEGER if p.high is None else int(p.high)
        descriptor.integer_range = [IntegerRange(from_value=bottom, to_value=top, step=1)]
    return descriptor


def run(arguments: Sequence[str]) -> bool:
    """Run the node until SIGINT or SIGTERM.

    Args:
        arguments: of the command line, for rclpy.

    Returns:
        Whether it could start; the node has said why where it could not.

    Raises:
        ConfigError: wrong arguments or parameters.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    _initialise(arguments)
    executor = SingleThreadedExecutor()
    try:
        node = MocapNode()
        executor.add_node(node)
        try:
            if node.config.node.autostart and not node.start():
                return False
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.1)
        finally:
            node.close()
            executor.shutdown()
            node.destroy_node()
    finally:
        rclpy.shutdown()
    return True


def _initialise(arguments: Sequence[str]) -> None:
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        said = re.sub(r', at \S+:\d+', '', str(error).removeprefix('failed to initialize rcl: '))
        raise ConfigError(f'ROS does not take these arguments: {said}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)
