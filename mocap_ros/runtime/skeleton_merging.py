# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Merge the `skeletons` of several cameras as they arrive, for the live node and for replays.

The first camera that is alive leads: each of its messages causes outputs, at its stamp. To that stamp the newest
people of the others are carried on with their velocities v, and become less certain,

    x <- x + v dt,    std^2 <- std^2 + (v_std dt)^2,    C_root <- C_root + C_v dt^2

A camera whose newest people are more than the tolerance away from the stamp does not count. The outputs depend on
the messages and their order alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import copy_with
from mocap_ros.bags.journal import Acceptance, Journal, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.config import NodeConfig, RecorderConfig, Value
from mocap_ros.errors import ConfigError, FrameDropped, InputError, SkeletonError
from mocap_ros.geometry.intrinsics import Intrinsics, recover_intrinsics
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.skeletons import SKELETONS, ReceivedSkeletons, decode_skeletons
from mocap_ros.people import CameraVertical, People
from mocap_ros.runtime.outputs import OutputEncoder, build_skeleton_definition
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.merging import CameraView, PeopleMerger
from mocap_ros.units import NS_PER_S

MAX_SILENCE_NS = 500_000_000  # ns; a camera that is behind others for longer does not lead
RESTART_NS = 1_000_000_000  # ns; by which a clock goes back that was set, or of a bag that is played again
JOURNAL_NAME = 'mocap_merge/journal'
PELVIS = CMU15.index('pelvis')


class SkeletonMerger:
    """Merger of the people on topics of Skeleton3DArrays, one for each camera.

    `people` are those of the newest outputs, in the common frame.
    """

    def __init__(self, topics: Sequence[str], tolerance_s: float, node: NodeConfig | None = None) -> None:
        self.people = People.none()
        self._topics = topics
        self._tolerance_s = tolerance_s
        self._node = node or NodeConfig()
        self._frame_id = ''
        self._layout = ''
        self._restart()

    def _restart(self) -> None:
        self._newest: list[ReceivedSkeletons | None] = [None] * len(self._topics)
        self._intrinsics: list[Intrinsics | None] = [None] * len(self._topics)
        self._stamp_ns = -1  # of the newest outputs
        self._merger, self._outputs = PeopleMerger(), OutputEncoder()

    def find_late_topics(self) -> list[str]:
        """Return the topics whose newest people are too far from the newest outputs to count."""
        stamps = (None if newest is None else newest.header.stamp_ns for newest in self._newest)
        return [
            topic
            for topic, stamp_ns in zip(self._topics, stamps, strict=True)
            if stamp_ns is not None and abs(stamp_ns - self._stamp_ns) > self._tolerance_s * NS_PER_S
        ]

    def feed(self, topic: str, raw: bytes) -> tuple[OutputMessage, ...]:
        """Return the messages that a Skeleton3DArray causes.

        Raises:
            InputError: it cannot be decoded, or does not fit those of the other cameras; it names the field.
            FrameDropped: its stamp is not later than that of the message before on this topic.
        """
        camera, received = self._topics.index(topic), decode_skeletons(raw, is_in_camera=False)
        outputs = list(self._check(received))
        stamp_ns, before = received.header.stamp_ns, self._newest[camera]
        if before is not None and stamp_ns <= before.header.stamp_ns:
            if before.header.stamp_ns - stamp_ns < RESTART_NS:
                raise FrameDropped('stamp: not later than that of the message before')
            self._restart()
        self._newest[camera] = received
        if len(received.people):
            self._intrinsics[camera] = _find_intrinsics(received)
        if camera == self._find_leader() and stamp_ns > self._stamp_ns:
            self._stamp_ns = stamp_ns
            outputs += self._merge(camera, received)
        return tuple(outputs)

    def _check(self, received: ReceivedSkeletons) -> list[OutputMessage]:
        """Refuse what cannot be merged; of the first people, return the message that names their joints."""
        frame_id, people = received.header.frame_id, received.people
        if received.camera.frame_id == frame_id:
            raise InputError(
                f'header.frame_id: {frame_id!r} is that of the camera; give its node node.output_frame'
            )
        if self._frame_id not in ('', frame_id):
            raise InputError(f'header.frame_id: {frame_id!r}, but that of other cameras is {self._frame_id!r}')
        self._frame_id = frame_id
        if not len(people):
            return []
        name = people.skeleton.name
        if self._layout not in ('', name):
            raise InputError(f'people: of the layout {name}, but those of other cameras of {self._layout}')
        for field in ('joints', 'joint_std', 'root_covariance'):
            if not np.isfinite(getattr(people, field)).all():
                raise InputError(f'people: {field} that are not finite')
        is_new = not self._layout
        self._layout = name
        return [build_skeleton_definition(name)] if is_new else []

    def _find_leader(self) -> int:
        stamps = [math.nan if newest is None else newest.header.stamp_ns for newest in self._newest]
        limit = np.nanmax(stamps) - MAX_SILENCE_NS
        return next(camera for camera, stamp_ns in enumerate(stamps) if stamp_ns >= limit)

    def _merge(self, leader: int, leading: ReceivedSkeletons) -> tuple[OutputMessage, ...]:
        time_s = leading.header.stamp_ns / NS_PER_S
        near = [self._carry(newest, leading.header.stamp_ns) for newest in self._newest]
        self.people = self._merger.merge(time_s, near).people
        known = [r for r in self._newest if r is not None and r.vertical_std > 0]
        best = min(known, key=lambda r: r.vertical_std, default=None)
        vertical = None if best is None else CameraVertical(best.vertical, best.vertical_std)
        to_camera = CameraPlacement('', None if leading.camera.pose is None else leading.camera.pose.inverse())
        seen = _add_camera(to_camera.place(self.people), self._intrinsics[leader])
        header = Header(leading.header.stamp_ns, self._frame_id)
        in_camera = to_camera.place_vertical(vertical)
        return self._outputs.encode(header, seen, self._node, leading.camera, in_camera)

    def _carry(self, newest: ReceivedSkeletons | None, stamp_ns: int) -> CameraView:
        """Return what a camera sees at a stamp in ns; nobody, if that is too far from its newest message."""
        step_s = math.inf if newest is None else (stamp_ns - newest.header.stamp_ns) / NS_PER_S
        if newest is None or abs(step_s) > self._tolerance_s:
            return CameraView(People.none(), np.zeros(3))
        people = newest.people
        if step_s and len(people):
            velocity = np.nan_to_num(people.joint_velocity)
            drift = step_s * np.nan_to_num(people.joint_velocity_std)
            people = copy_with(
                people,
                joints=people.joints + step_s * velocity,
                joint_std=np.hypot(people.joint_std, drift),
                root_covariance=people.root_covariance
                + step_s**2 * np.nan_to_num(people.root_velocity_covariance),
            )
        return CameraView(people, newest.camera.centre)


class MergedRun:
    """A run of a merger, of which each input with its outputs and journal is recorded, so that it can be repeated.

    `parameters` are the topics `inputs`, separated by blanks, the `tolerance` in s and `publish_tf`; `prefix` is
    put before the names of outputs that are not absolute.
    """

    def __init__(self, parameters: Mapping[str, Value], prefix: str) -> None:
        self.parameters = {name: parameters[name] for name in ('inputs', 'tolerance', 'publish_tf')}
        self.topics = str(parameters['inputs']).split()
        if len(set(self.topics)) < max(len(self.topics), 2):
            raise ConfigError('inputs: expected two different topics of skeletons or more, separated by blanks')
        node = NodeConfig(publish_tf=bool(parameters['publish_tf']))
        self.merger = SkeletonMerger(self.topics, float(parameters['tolerance']), node)
        self._prefix = prefix
        self._journal = Journal(f'{prefix}{JOURNAL_NAME}')

    def start(self, time_ns: int) -> list[RecordedMessage]:
        """Return the records with which a recording begins."""
        return [self._journal.make_parameters_record(self.parameters, time_ns)]

    def feed(self, topic: str, raw: bytes, times_ns: tuple[int, int]) -> MergedInput:
        """Return what a message causes, and its records; times in ns are those of receipt and of sending."""
        outputs: tuple[OutputMessage, ...] = ()
        acceptance, reason = Acceptance.ACCEPTED, ''
        try:
            outputs = self.merger.feed(topic, raw)
        except (InputError, SkeletonError) as error:
            acceptance, reason = Acceptance.INVALID, str(error)
        except FrameDropped as error:
            acceptance, reason = Acceptance.DROPPED, str(error)
        records = self._journal.make_input_records(topic, SKELETONS, raw, times_ns, acceptance, reason)
        for output in outputs:
            name = output.topic if output.topic.startswith('/') else self._prefix + output.topic
            records.append(RecordedMessage(name, output.type, output.data, times_ns[0], times_ns[0]))
        return MergedInput(outputs, records, reason)


class MergedInput(NamedTuple):
    """What a message of skeletons causes."""

    outputs: tuple[OutputMessage, ...]
    records: list[RecordedMessage]
    reason: str  # why it was not accepted; else empty


def holds_merged_run(bag: Bag) -> bool:
    """Return whether a bag was recorded by `mocap_merge`."""
    return 'inputs' in read_run(bag).parameters


def replay_merging(bag: Bag, out: Path) -> int:
    """Merge the inputs of a recorded run again, into another bag, and return their number."""
    run = MergedRun(read_run(bag).parameters, '/')
    count = 0
    with Recorder(out, RecorderConfig(), name=out.name) as recorder:
        for count, message in enumerate(bag.messages(run.topics), 1):
            records = run.start(message.time_ns) if count == 1 else []
            records += run.feed(message.topic, message.raw, (message.time_ns, message.time_ns)).records
            for record in records:
                recorder.write(*record)
    return count


def _find_intrinsics(received: ReceivedSkeletons) -> Intrinsics:
    """Return the camera that shows people, by their own weak-perspective cameras."""
    people, pose = received.people, received.camera.pose
    middles = people.core.mean(axis=1)
    seen = middles if pose is None else pose.inverse().apply(middles)
    return recover_intrinsics(seen, people.scale, people.translation)


def _add_camera(people: People, intrinsics: Intrinsics | None) -> People:
    """Return people in the optical frame of a camera with their weak-perspective cameras, if it is known."""
    if intrinsics is None or not len(people):
        return people
    middles = people.core.mean(axis=1)
    turns = [RigidTransform(np.zeros(3), tuple(turn)).rotation for turn in people.joint_orientation[:, PELVIS]]
    return copy_with(
        people,
        scale=intrinsics.focal / middles[:, 2],
        translation=intrinsics.project(middles),
        rotation=np.array(turns),
    )
