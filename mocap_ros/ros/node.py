"""The live node `mocap_node`: 2D keypoints in, skeletons, cameras and markers out, recorded where wanted."""

from __future__ import annotations

import re
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
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

from mocap_ros.bags.topics import Source, body_topic, input_types
from mocap_ros.config import Config, Parameter, hint, parameters, with_values
from mocap_ros.errors import ConfigError, InputError, MocapError, RecordingError
from mocap_ros.messages.accepted import KEYPOINT_TYPES
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.foreign.definitions import BODY
from mocap_ros.messages.foreign.hri import decode_ids
from mocap_ros.ros.diagnostics import DIAGNOSTICS, Doctor
from mocap_ros.ros.help import SERVICES
from mocap_ros.ros.live import LiveRun
from mocap_ros.ros.message_types import Convert, converter, interface_class
from mocap_ros.ros.qos import recorded_profile
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, OUTPUTS, TF_OUTPUT, Pipeline, skeleton_definition

DEPTH = 10
INPUT_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
OUTPUT_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
TF_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
LARGEST_INTEGER = 2**31 - 1
NAME = 'mocap_node'
BY_RCLPY = 'qos_overrides.'
DIAGNOSTICS_TOPIC = '/diagnostics'
DIAGNOSTICS_PERIOD = 1.0
SILENCE_PERIOD = 0.5
TOPIC_WORD = re.compile(r'(?!\w*__)[A-Za-z_][A-Za-z0-9_]*')
RECORDING = 'recorder.enabled'


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
        self._bodies: dict[str, Any] = {}
        self._served: list[Any] = []
        self._timers_running: list[Any] = []
        self._doctor: Doctor | None = None
        self._last_input = time.monotonic()
        self._heard = self._told_silence = False
        self._told_qos: set[tuple[str, str]] = set()
        self._types: dict[Source, str] = {}
        self._converters: dict[Source, Convert | None] = {}
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
        ours = _ours(changed)
        before, self._config = self._config, with_values(self._config, ours)
        if self._run is not None:
            if self._config != before:
                self._run.reconfigure(self._config)
            if RECORDING in ours:
                self._run.want_recording(self._config.recorder.enabled)
        elif self._pipeline is not None:
            self._pipeline.reconfigure(self._config)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the model and offer topics and services."""
        try:
            self._configure()
        except Exception as error:
            self._tell_failure('configured', error)
            self._clean_up()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take input."""
        result = super().on_activate(state)
        try:
            self._publish(skeleton_definition())
            self._start()
        except Exception as error:
            self._tell_failure('activated', error)
            self._stop()
            super().on_deactivate(state)
            return TransitionCallbackReturn.FAILURE
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

    def start(self) -> None:
        """Configure and activate; where that fails, the node has said why and can be told to try again."""
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def close(self) -> None:
        """Stop whatever runs and finish the recording."""
        self._stop()
        self._clean_up()

    def _tell_failure(self, what: str, error: Exception) -> None:
        """Say in one line why the node could not be `what`."""
        reason = str(error) if isinstance(error, MocapError) else f'{type(error).__name__}: {error}'
        self.get_logger().error(f'{" ".join(reason.split())}; the node is not {what}')

    def _configure(self) -> None:
        self._types = input_types(self._config.node.input_type)
        self._converters = {source: converter(kind) for source, kind in self._types.items()}
        self._pipeline = Pipeline(self._config)
        for topics, qos in ((OUTPUTS, OUTPUT_QOS), (LATCHED_OUTPUTS, LATCHED_QOS)):
            for topic, msgtype in topics.items():
                self._outputs[topic] = self._advertise(topic, msgtype, qos)
        self._outputs[DIAGNOSTICS_TOPIC] = self._advertise(DIAGNOSTICS_TOPIC, DIAGNOSTICS, OUTPUT_QOS)
        if self._config.node.publish_tf:
            self._advertise_frames()
        answers = {'~/reset': self._on_reset, '~/record': self._on_record}
        self._served = [
            self.create_service(interface_class(kind), name, answers[name]) for name, kind in SERVICES.items()
        ]

    def _advertise_frames(self) -> None:
        ((topic, msgtype),) = TF_OUTPUT.items()
        try:
            self._outputs[topic] = self._advertise(topic, msgtype, TF_QOS)
        except ConfigError as error:
            self.get_logger().warning(f'node.publish_tf: {error}; frames are recorded, not published')

    def _advertise(self, topic: str, msgtype: str, qos: QoSProfile) -> Any:
        return self.create_lifecycle_publisher(
            interface_class(msgtype),
            topic,
            qos,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=lambda event: self._tell_qos(
                    topic, event.last_policy_kind, 'a subscriber', 'gets nothing; it must ask for less'
                )
            ),
        )

    def _start(self) -> None:
        assert self._pipeline is not None  # noqa: S101
        relative = [*(s.value for s in Source), *OUTPUTS, *TF_OUTPUT, *LATCHED_OUTPUTS]
        names = {name: self.resolve_topic_name(name) for name in relative}
        names['journal'] = self.resolve_topic_name('~/journal')
        self._run = LiveRun(
            self._pipeline, self._types, names, self._publish, self.get_logger(), self._offered_qos
        )
        self._run.start()
        self._inputs = [self._subscribe(s, s.value) for s in self._types if s is not Source.BODY]
        self._last_input = time.monotonic()
        self._heard = self._told_silence = False
        self._tell_topics(names)
        self._doctor = Doctor(self.get_fully_qualified_name(), self._config.node.silence_warning)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timers_running = [
            self.create_timer(SILENCE_PERIOD, self._check_silence, clock=steady),
            self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=steady),
        ]

    def _offered_qos(self, topic: str) -> list[dict[str, Any]]:
        """What the publishers of a topic offer, for its bag."""
        return [recorded_profile(p.qos_profile) for p in self.get_publishers_info_by_topic(topic)]

    def _tell_topics(self, names: Mapping[str, str]) -> None:
        """Say what is listened to and published, under the names it has."""
        heard = ' and '.join(names[s.value] for s in self._types if s is not Source.BODY)
        said = ', '.join(names[topic] for topic in (*OUTPUTS, *LATCHED_OUTPUTS))
        self.get_logger().info(f'listening on {heard}, publishing {said}, model {self._config.tracker.model}')

    def _subscribe(self, source: Source, topic: str) -> Any:
        run, convert = self._run, self._converters[source]
        assert run is not None  # noqa: S101
        resolved = self.resolve_topic_name(topic)

        def take(raw: Any, info: Any) -> None:
            if convert is not None:
                with suppress(InputError):  # which the pipeline finds in what is left as it was
                    raw = convert(raw)
            run.put(source, raw, info['source_timestamp'], resolved)
            if source is not Source.CAMERA_INFO:
                self._last_input = time.monotonic()
                self._heard, self._told_silence = True, False
            if source is Source.TRACKED:
                self._follow(raw)

        overridable = None if source is Source.BODY else QoSOverridingOptions.with_default_policies()
        return self.create_subscription(
            interface_class(self._types[source]),
            topic,
            take,
            INPUT_QOS,
            raw=True,
            qos_overriding_options=overridable,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda event: self._tell_qos(
                    topic,
                    event.last_policy_kind,
                    'a publisher',
                    f'is not heard; offer what fits there, or set qos_overrides.{resolved}.subscription here',
                )
            ),
        )

    def _follow(self, raw: bytes) -> None:
        """Listen to the bodies that are tracked, and no more to those that are gone."""
        try:
            _, ids = decode_ids(raw, self._config.node)
        except InputError:  # which the run says
            return
        beside = self.resolve_topic_name(Source.TRACKED.value)
        wanted = {body_topic(beside, i) for i in ids if TOPIC_WORD.fullmatch(i)}
        for topic in self._bodies.keys() - wanted:
            self.destroy_subscription(self._bodies.pop(topic))
        for topic in wanted - self._bodies.keys():
            self._bodies[topic] = self._subscribe(Source.BODY, topic)

    def _diagnose(self) -> None:
        run, pipeline, doctor = self._run, self._pipeline, self._doctor
        if run is None or pipeline is None or doctor is None:
            return
        now_ns = self.get_clock().now().nanoseconds
        status = doctor.examine(pipeline, run.pulse, run.recorder_state, now_ns)
        self._outputs[DIAGNOSTICS_TOPIC].publish(status)

    def _stop(self) -> None:
        for subscription in (*self._inputs, *self._bodies.values()):
            self.destroy_subscription(subscription)
        self._inputs, self._bodies = [], {}
        for timer in self._timers_running:
            self.destroy_timer(timer)
        self._timers_running = []
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
        publisher = self._outputs.get(output.topic)
        if publisher is not None:
            publisher.publish(output.data)

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
            if request.data:
                self.get_logger().error(str(error))
            response.message = str(error)
            return response
        response.success = folder is not None
        response.message = str(folder) if folder else 'there is no recording'
        self.set_parameters([RosParameter(RECORDING, value=bool(request.data))])
        return response

    def _check_silence(self) -> None:
        silent = time.monotonic() - self._last_input
        if self._told_silence or silent < self._config.node.silence_warning:
            return
        self._told_silence = True
        topic = self.resolve_topic_name(self._people_source.value)
        why = '' if self._heard else f': {self._why(topic)}'
        self.get_logger().warning(f'no message on {topic} for {silent:.0f} s{why}')

    @property
    def _people_source(self) -> Source:
        return next(iter(self._types))

    def _why(self, topic: str) -> str:
        """What may be the cause of a topic's silence from the start."""
        wanted = self._types[self._people_source]
        publishers = self.get_publishers_info_by_topic(topic)
        others = {p.topic_type for p in publishers} - {wanted}
        if others:
            said = ', '.join(sorted(others))
            fits = sorted(others & {*KEYPOINT_TYPES, BODY})
            advice = f'; start the node with -p node.input_type:={fits[0]}' if fits else ''
            return f'its publisher sends {said}, expected {wanted}{advice}'
        if publishers:
            return 'its publisher sends nothing, or its QoS does not fit'
        elsewhere = [t for t, kinds in self.get_topic_names_and_types() if wanted in kinds]
        elsewhere = sorted(set(elsewhere) - {topic})
        if elsewhere:
            return f'nobody publishes it; remap {self._people_source.value} to {" or ".join(elsewhere)}?'
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


def run(arguments: Sequence[str]) -> None:
    """Run the node until SIGINT or SIGTERM.

    Args:
        arguments: of the command line, for rclpy.

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
            if node.config.node.autostart:
                node.start()
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.1)
        finally:
            node.close()
            executor.shutdown()
            node.destroy_node()
    finally:
        rclpy.shutdown()


def _initialise(arguments: Sequence[str]) -> None:
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        said = re.sub(r', at \S+:\d+', '', str(error).removeprefix('failed to initialize rcl: '))
        raise ConfigError(f'ROS does not take these arguments: {said}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)
