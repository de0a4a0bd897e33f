# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle node `mocap_node`: estimate 3D people live from 2D keypoints, publish them and record the run."""

from __future__ import annotations

import gc
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter

from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, parameters, values, with_values
from mocap_ros.errors import MocapError, RecordingError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.diagnostics import DIAGNOSTICS, DIAGNOSTICS_TOPIC, DiagnosticsReporter
from mocap_ros.ros.help import MOCAP_NAME, SERVICES
from mocap_ros.ros.live import LiveRun
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.nodes import ManagedNode, declare_parameters
from mocap_ros.ros.qos import LATCHED_QOS, OUTPUT_QOS, TF_QOS, profile_to_rosbag2
from mocap_ros.ros.subscriptions import InputSubscriptions
from mocap_ros.ros.topics import CameraInfoSearch, Publishers
from mocap_ros.runtime.cpu_setup import release_free_memory
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, build_skeleton_definition, list_switched_outputs
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.units import NS_PER_S

RECORDING_PARAMETER = 'recorder.enabled'  # switched by the service ~/record, too
NOT_ACTIVE = 'the node is not active'  # answer of its services
# ns; the seconds of a stamp are int32, and with use_sim_time anyone sets the time
MAX_STAMP_NS = (2**31 - 1) * NS_PER_S
DIAGNOSTICS_PERIOD_S = 1.0  # s; the usual period of /diagnostics
RELEASE_PERIOD_S = 60.0  # s between two collections of garbage, after which free memory goes back to the system
SILENCE_CHECK_PERIOD_S = 0.5  # s; bounds the delay of the warning that no input arrives


class MocapNode(ManagedNode):
    """Lifecycle node that runs a `LiveRun` while it is active."""

    def __init__(self) -> None:
        super().__init__(MOCAP_NAME)
        self._versions = MessageVersions()  # of the types in use while the node is configured
        self._outputs = Publishers(self, self._versions)
        self._inputs: InputSubscriptions | None = None  # while configured
        self._pipeline: Pipeline | None = None  # while configured
        self._provided_services: list[Any] = []  # while configured
        self._run: LiveRun | None = None  # while active
        self._reporter: DiagnosticsReporter | None = None  # while active
        self._camera_search = CameraInfoSearch(self)
        self._run_timers: list[Any] = []  # while active
        declared = declare_parameters(self, [*parameters()], '`mocap-ros config --all`')
        self._config = with_values(Config(), declared)
        self.has_autostart = self._config.node.autostart
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)

    def configure(self) -> None:
        """Load the model, and create publishers and services."""
        config = self._config
        self._versions = MessageVersions()
        self._inputs = InputSubscriptions(self, config.node.input_type, self._versions, lambda: self._config.node)
        self._versions.add_output(CAMERA_INFO)  # a recording begins with the CameraInfo in use
        self._pipeline = Pipeline(config)
        self._create_publishers()
        callbacks = {'~/reset': self._on_reset, '~/record': self._on_record}
        self._provided_services = [
            self.create_service(load_interface_class(srvtype), name, callbacks[name])
            for name, srvtype in SERVICES.items()
        ]
        release_free_memory()  # of files that were decoded
        gc.freeze()  # a garbage collection between two frames would take 50 ms to look at all imported libraries

    def _create_publishers(self) -> None:
        """Create the publishers; what a parameter switches on and has no installed type is recorded only."""
        self._outputs = Publishers(self, self._versions)
        for topics, qos in ((OUTPUTS, OUTPUT_QOS), (LATCHED_OUTPUTS, LATCHED_QOS)):
            for topic, msgtype in topics.items():
                self._outputs.add(topic, msgtype, qos)
        self._outputs.add(DIAGNOSTICS_TOPIC, DIAGNOSTICS, OUTPUT_QOS)
        for topic, msgtype in list_switched_outputs(self._config.node).items():
            is_transforms = msgtype == TRANSFORMS
            consequence = f'{"transforms are" if is_transforms else f"{topic} is"} recorded but not published'
            self._outputs.add_if_installed(topic, msgtype, TF_QOS if is_transforms else OUTPUT_QOS, consequence)

    def clean_up(self) -> None:
        """Discard the model and destroy publishers and services."""
        gc.unfreeze()
        self._outputs.destroy()
        for service in self._provided_services:
            self.destroy_service(service)
        self._provided_services = []
        self._pipeline = None
        self._inputs = None

    def start_run(self) -> None:
        """Publish the names of the joints, subscribe to the inputs and process them."""
        definition = build_skeleton_definition(self._config.tracker.skeleton)
        self._outputs.publish(self._versions.write_output(definition))
        assert self._pipeline is not None  # noqa: S101
        assert self._inputs is not None  # noqa: S101
        switched = list_switched_outputs(self._config.node)
        relative_names = [*(s.value for s in Source), *OUTPUTS, *switched, *LATCHED_OUTPUTS]
        names = {name: self.resolve_topic_name(name) for name in relative_names}
        names['journal'] = self.resolve_topic_name('~/journal')
        self._run = LiveRun(
            self._pipeline,
            self._inputs.types,
            names,
            self._outputs.publish,
            self.get_logger(),
            self._find_offered_qos,
            self._versions,
        )
        self._run.start()
        self._inputs.subscribe(self._run)
        outputs = (*OUTPUTS, *switched, *LATCHED_OUTPUTS)
        published = ', '.join(names[topic] for topic in outputs if topic in self._outputs)
        self.get_logger().info(
            f'the node is active: it listens on {" and ".join(self._inputs.topics)}, publishes {published}, '
            f'and uses the model {self._config.tracker.model}'
        )
        self._reporter = DiagnosticsReporter(self.get_fully_qualified_name(), self._pipeline, self._run.statistics)
        self._run_timers = [
            self.create_steady_timer(SILENCE_CHECK_PERIOD_S, self._check_silence),
            self.create_steady_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics),
            self.create_steady_timer(RELEASE_PERIOD_S, release_free_memory),
        ]

    def stop_run(self) -> None:
        """Unsubscribe, delete the markers and finish the recording."""
        run, self._run = self._run, None
        try:
            if self._inputs is not None:
                self._inputs.unsubscribe()
            self._camera_search.advance('')
            for timer in self._run_timers:
                self.destroy_timer(timer)
            self._run_timers = []
            self._reporter = None
        finally:
            if run is not None:
                run.stop()

    def _check_parameters(self, changed: list[RosParameter[Any]]) -> SetParametersResult:
        try:
            config = with_values(self._config, self._select_own(changed))
            if self._pipeline is not None:
                (self._run or self._pipeline).check(config)
        except MocapError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, changed: list[RosParameter[Any]]) -> None:
        changed_values = self._select_own(changed)
        previous, self._config = self._config, with_values(self._config, changed_values)
        if self._run is not None:
            if self._config != previous:
                self._run.reconfigure(self._config)
            if RECORDING_PARAMETER in changed_values:
                self._run.set_recording(self._config.recorder.enabled)
        elif self._pipeline is not None:
            self._pipeline.reconfigure(self._config)

    def _select_own(self, changed: list[RosParameter[Any]]) -> dict[str, object]:
        names = values(self._config)
        return {p.name: p.value for p in changed if p.name in names}

    def _on_reset(self, _: Any, response: Any) -> Any:
        response.success = self._run is not None
        response.message = self._run.reset() if self._run else NOT_ACTIVE
        return response

    def _on_record(self, request: Any, response: Any) -> Any:
        """Answer a call of ~/record; the message of a success is the folder of the bag."""
        if self._run is None:
            response.message = NOT_ACTIVE
            return response
        try:
            folder = self._run.start_recording() if request.data else self._run.finish_recording()
        except RecordingError as error:
            if request.data:
                self.get_logger().error(f'{error}; the service ~/record did not start a recording')
            else:  # the recording has ended nevertheless, and the next activation must not start another one
                self.set_parameters([RosParameter(RECORDING_PARAMETER, value=False)])
            response.message = str(error)
            return response
        response.success = folder is not None
        response.message = str(folder) if folder else 'there is no recording'
        self.set_parameters([RosParameter(RECORDING_PARAMETER, value=bool(request.data))])
        return response

    def _check_silence(self) -> None:
        if self._inputs is not None:
            self._inputs.silence.check(self._config.node.silence_warning)
        if self._pipeline is not None:
            self._camera_search.advance(self._pipeline.missing_camera)

    def _publish_diagnostics(self) -> None:
        run, reporter = self._run, self._reporter
        if run is None or reporter is None:
            return
        now_ns = min(self.get_clock().now().nanoseconds, MAX_STAMP_NS)
        status = reporter.encode_status(run.recorder_state, now_ns, run.recorder_fault)
        output = OutputMessage(DIAGNOSTICS_TOPIC, DIAGNOSTICS, now_ns, status)
        self._outputs.publish(self._versions.write_output(output))

    def _find_offered_qos(self, topic: str) -> list[dict[str, Any]]:
        return [profile_to_rosbag2(p.qos_profile) for p in self.get_publishers_info_by_topic(topic)]
