# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle node `mocap_merge`: one person a person, from the `skeletons` of several cameras."""

from __future__ import annotations

import time
from functools import partial

from mocap_ros.bags.background import BackgroundRecorder, start_recorder
from mocap_ros.config import RecorderConfig, Value
from mocap_ros.errors import RecordingError
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.diagnostics import DIAGNOSTICS, DIAGNOSTICS_TOPIC, Level
from mocap_ros.ros.help import MERGE_NAME, MERGE_PARAMETERS
from mocap_ros.ros.qos import LATCHED_QOS, OUTPUT_QOS, TF_QOS
from mocap_ros.ros.skeleton_node import WARN_AFTER_S, SkeletonNode
from mocap_ros.ros.topics import SilenceMonitor
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS
from mocap_ros.runtime.skeleton_merging import MergedRun

CHECK_PERIOD_S = 1.0  # s; between two diagnostics
SILENT_AFTER_S = 2.0  # s without messages, after which a camera counts as dead
START_MOCAP_NODE = 'start the mocap_node of that camera, or correct the parameter inputs'


class MergeNode(SkeletonNode):
    """Lifecycle node that feeds a `MergedRun` while it is active."""

    def __init__(self) -> None:
        super().__init__(MERGE_NAME, MERGE_PARAMETERS)
        self._run_parameters: dict[str, Value] = {}
        self._run: MergedRun | None = None  # while active
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()  # so that times of receipt never jump
        self._recorder: BackgroundRecorder | None = None  # while active
        self._silences: dict[str, SilenceMonitor] = {}
        self._silent = set[str]()  # topics on which nothing comes

    def configure(self) -> None:
        """Create the publishers."""
        super().configure()
        topics = [self.resolve_topic_name(name) for name in str(self._values['inputs']).split()]
        prefix = self.get_namespace().rstrip('/') + '/'
        self._run_parameters = self._values | {'inputs': ' '.join(topics), 'prefix': prefix}
        MergedRun(self._run_parameters)
        self._silences = {topic: SilenceMonitor(self, topic, SKELETONS, START_MOCAP_NODE) for topic in topics}
        self._versions.add_input(SKELETONS)
        for topic, msgtype in OUTPUTS.items():
            self._outputs.add(topic, msgtype, OUTPUT_QOS)
        for topic, msgtype in LATCHED_OUTPUTS.items():
            self._outputs.add(topic, msgtype, LATCHED_QOS)
        self._outputs.add_if_installed(DIAGNOSTICS_TOPIC, DIAGNOSTICS, OUTPUT_QOS, 'there are no diagnostics')
        if self._values['publish_tf']:
            self._outputs.add_if_installed('/tf', TRANSFORMS, TF_QOS, 'people are not published on /tf')

    def start_run(self) -> None:
        """Subscribe, and start the recording."""
        run = self._run = MergedRun(self._run_parameters)
        if folder := str(self._values['record']):
            now_ns = self._now_ns()
            self._recorder = start_recorder(now_ns, RecorderConfig(folder=folder))
            self._recorder.put(run.start(now_ns))
        for topic, silence in self._silences.items():
            self.subscribe_to(silence, partial(self._take, run, topic))
        self._timer = self.create_steady_timer(CHECK_PERIOD_S, self._check)
        recorded = f', and records to {self._recorder.folder}' if self._recorder else ''
        published = self.resolve_topic_name('skeletons')
        self.get_logger().info(
            f'the node is active: it merges {", ".join(self._silences)} on {published}{recorded}'
        )

    def stop_run(self) -> None:
        """Unsubscribe, and finish the recording."""
        super().stop_run()
        if self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            try:
                recorder.close()
            except RecordingError as error:
                self.get_logger().error(str(error))

    def _now_ns(self) -> int:
        return time.monotonic_ns() + self._clock_offset_ns

    def _take(self, run: MergedRun, topic: str, raw: bytes) -> None:
        now_ns = self._now_ns()
        merged = run.feed(topic, raw, (now_ns, now_ns))
        for output in merged.outputs:
            self._outputs.publish(self._versions.write_output(output))
        if merged.reason:
            self._log.report(topic, self._counts[topic], merged.reason)
        if self._recorder is not None:
            try:
                if not self._recorder.put(merged.records):
                    run.note_lost()
            except RecordingError as error:
                self.get_logger().error(f'{error}; the recording has ended')
                self._recorder = None

    def _check(self) -> None:
        for silence in self._silences.values():
            silence.check(WARN_AFTER_S)
        silent = {topic for topic, silence in self._silences.items() if silence.silence_s > SILENT_AFTER_S}
        for topic in sorted(silent ^ self._silent):
            if topic in silent and self._counts[topic]:
                self.get_logger().warning(f'nothing has come on {topic} for {SILENT_AFTER_S:g} s; others go on')
            elif topic not in silent:
                self.get_logger().info(f'people come on {topic}')
        self._silent = silent
        problems = [f'nothing on {", ".join(sorted(silent))}'] if silent else []
        if late := [] if self._run is None else self._run.merger.find_late_topics():
            late_topics = ', '.join(late)
            problems.append(f'{late_topics}: other stamps than the first camera, so not merged: set the clocks')
            self.get_logger().warning(problems[-1], throttle_duration_sec=10.0)
        count = 0 if self._run is None else len(self._run.merger.people)
        status = {
            'level': Level.WARN if problems else Level.OK,
            'name': MERGE_NAME,
            'message': '; '.join(problems) or f'{count} people',
            'values': [(topic, str(self._counts[topic])) for topic in self._silences],
        }
        now_ns = self.get_clock().now().nanoseconds
        raw = encode_plain({'header': Header(now_ns, ''), 'status': [status]}, DIAGNOSTICS)
        self._outputs.publish(
            self._versions.write_output(OutputMessage(DIAGNOSTICS_TOPIC, DIAGNOSTICS, now_ns, raw))
        )
