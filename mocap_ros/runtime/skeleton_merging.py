# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Merge the `skeletons` of several cameras as they arrive, for the live node and for replays.

The first camera that is alive leads: each of its messages causes outputs, at its stamp. To that stamp the people
of the others, in the messages nearest to it, are carried with their velocities v, and become less certain,

    x <- x + v dt,    std^2 <- std^2 + (v_std dt)^2,    C_root <- C_root + C_v dt^2

A camera without a message within the tolerance does not count. The outputs depend on the messages and their order
alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import copy_with
from mocap_ros.bags.journal import JOURNAL, Acceptance, Journal, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import ONE_FILE, RecordedMessage, Recorder
from mocap_ros.bags.rosbag2 import Topic, make_topic
from mocap_ros.config import NodeConfig, Value
from mocap_ros.errors import ConfigError, FrameDropped, InputError, SkeletonError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rigid_transform import MAX_DISTANCE_M, RigidTransform
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.skeletons import SKELETONS, ReceivedSkeletons, decode_skeletons, find_intrinsics
from mocap_ros.people import CameraVertical, People
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OutputEncoder, build_skeleton_definition
from mocap_ros.runtime.replay import ProgressWrapper
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.merging import CameraView, PeopleMerger
from mocap_ros.units import NS_PER_S

MAX_SILENCE = 15  # messages of every other camera, half a second; who is silent for longer does not lead
MAX_RECENT = 60  # messages of a camera; a second or two, by which nodes may be slower than others
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
        self._outputs, self._count = OutputEncoder(), 0  # number of messages so far
        self._recent = [deque[ReceivedSkeletons](maxlen=MAX_RECENT) for _ in self._topics]
        self._intrinsics: list[Intrinsics | None] = [None] * len(self._topics)
        self._heard = [-math.inf] * len(self._topics)  # number of the newest message of each
        self._unmatched = [0] * len(self._topics)  # messages of each since one was near enough to outputs
        self._stamp_ns = -1  # of the newest outputs
        self._is_defined = False  # whether the joints have been named
        self._merger = PeopleMerger()

    def find_late_topics(self) -> list[str]:
        """Return the topics that send, but of which no message is near enough to the outputs to count."""
        counts = zip(self._topics, self._unmatched, strict=True)
        return [topic for topic, count in counts if count > MAX_SILENCE]

    def feed(self, topic: str, raw: bytes) -> tuple[OutputMessage, ...]:
        """Return the messages that a Skeleton3DArray causes.

        Raises:
            InputError: it cannot be decoded, or does not fit those of the other cameras; it names the field.
            FrameDropped: its stamp is not later than that of the message before on this topic.
        """
        camera, received = self._topics.index(topic), decode_skeletons(raw, is_in_camera=False)
        self._check(camera, received)
        stamp_ns, outputs = received.header.stamp_ns, list[OutputMessage]()
        recent = self._recent[camera]
        if recent and stamp_ns <= recent[-1].header.stamp_ns:
            if recent[-1].header.stamp_ns - stamp_ns < RESTART_NS:
                raise FrameDropped('stamp: not later than that of the message before')
            recent.clear()
        recent.append(received)
        self._count += 1
        self._heard[camera] = self._count
        self._unmatched[camera] += 1
        if camera != self._find_leader():
            return ()
        if stamp_ns <= self._stamp_ns - RESTART_NS:  # its clock was set, or was behind that of the leader before
            outputs += self._outputs.encode_clear(received.header)
            self._stamp_ns, self._merger = -1, PeopleMerger()
        if stamp_ns > self._stamp_ns:
            self._stamp_ns = stamp_ns
            outputs += self._merge(camera, received)
        return tuple(outputs)

    def _check(self, camera: int, received: ReceivedSkeletons) -> None:
        """Refuse what cannot be merged with the newest messages of the other cameras."""
        frame_id, people = received.header.frame_id, received.people
        if received.camera.frame_id == frame_id:
            raise InputError(
                f'header.frame_id: {frame_id!r} is that of the camera; give its node node.output_frame'
            )
        others = [recent[-1] for number, recent in enumerate(self._recent) if recent and number != camera]
        frames = {other.header.frame_id for other in others}
        if frames and frame_id not in frames:
            raise InputError(f'header.frame_id: {frame_id!r}, but that of other cameras is {frames.pop()!r}')
        if not len(people):
            return
        layouts = {other.people.skeleton.name for other in others if len(other.people)}
        if layouts and people.skeleton.name not in layouts:
            raise InputError(
                f'people: of the layout {people.skeleton.name}, but those of other cameras of {layouts.pop()}'
            )
        if len(set(people.ids)) < len(people):
            raise InputError('people: two have one id')
        is_sound = (np.abs(people.joints) < MAX_DISTANCE_M).all() and (people.joint_std > 0).all()
        covariance = people.root_covariance
        if not (is_sound and np.isfinite(covariance).all() and (np.linalg.eigvalsh(covariance) > 0).all()):
            raise InputError('people: joints, joint_std or root_covariance that are not finite or not positive')

    def _find_leader(self) -> int:
        limit = self._count - MAX_SILENCE * (len(self._topics) - 1)
        return next(camera for camera, heard in enumerate(self._heard) if heard >= limit)

    def _merge(self, leader: int, leading: ReceivedSkeletons) -> list[OutputMessage]:
        stamp_ns = leading.header.stamp_ns
        near = [self._find_nearest(recent, stamp_ns) for recent in self._recent]
        self._unmatched = [0 if seen else count for seen, count in zip(near, self._unmatched, strict=True)]
        self.people = self._merger.merge(stamp_ns / NS_PER_S, [_carry(seen, stamp_ns) for seen in near]).people
        known = [seen for seen in near if seen is not None and seen.vertical_std > 0]
        best = min(known, key=lambda seen: seen.vertical_std, default=None)
        vertical = None if best is None else CameraVertical(best.vertical, best.vertical_std)
        to_camera = leading.camera.invert()
        if len(leading.people):
            with suppress(InputError):  # of people without cameras of their own
                self._intrinsics[leader] = find_intrinsics(to_camera.place(leading.people))
        shown = _add_camera(to_camera.place(self.people), self._intrinsics[leader])
        in_camera = to_camera.place_vertical(vertical)
        outputs = self._outputs.encode(leading.header, shown, self._node, leading.camera, in_camera)
        if not len(shown) or self._is_defined:
            return [*outputs]
        self._is_defined = True
        return [build_skeleton_definition(shown.skeleton.name), *outputs]

    def _find_nearest(self, recent: Sequence[ReceivedSkeletons], stamp_ns: int) -> ReceivedSkeletons | None:
        """Return the message that is nearest to a stamp in ns; None if it is further than the tolerance."""
        nearest = min(recent, key=lambda seen: abs(seen.header.stamp_ns - stamp_ns), default=None)
        is_near = nearest is not None and abs(nearest.header.stamp_ns - stamp_ns) <= self._tolerance_s * NS_PER_S
        return nearest if is_near else None


def _carry(seen: ReceivedSkeletons | None, stamp_ns: int) -> CameraView:
    """Return what a camera sees at a stamp in ns, by the message that is nearest to it; nobody without one."""
    if seen is None:
        return CameraView(People.none(), np.zeros(3))
    people, step_s = seen.people, (stamp_ns - seen.header.stamp_ns) / NS_PER_S
    if step_s and len(people):
        drift = step_s * np.nan_to_num(people.joint_velocity_std)
        people = copy_with(
            people,
            joints=people.joints + step_s * np.nan_to_num(people.joint_velocity),
            joint_std=np.hypot(people.joint_std, drift),
            root_covariance=people.root_covariance + step_s**2 * np.nan_to_num(people.root_velocity_covariance),
        )
    return CameraView(people, seen.camera.centre)


class MergedRun:
    """A run of a merger, of which each input with its outputs and journal is recorded, so that it can be repeated.

    `parameters` are the topics `inputs`, separated by blanks, the `tolerance` in s, `publish_tf`, and the `prefix`
    of the names of outputs that are not absolute.
    """

    def __init__(self, parameters: Mapping[str, Value]) -> None:
        self._parameters = {name: parameters[name] for name in ('inputs', 'tolerance', 'publish_tf', 'prefix')}
        self.topics = str(parameters['inputs']).split()
        self._prefix = str(parameters['prefix'])
        if len(set(self.topics)) < max(len(self.topics), 2):
            raise ConfigError('inputs: expected two different topics of skeletons or more, separated by blanks')
        if f'{self._prefix}skeletons' in self.topics:
            raise ConfigError(f'inputs: {self._prefix}skeletons is the topic of the output; remap one of them')
        node = NodeConfig(publish_tf=bool(parameters['publish_tf']))
        self.merger = SkeletonMerger(self.topics, float(parameters['tolerance']), node)
        self._journal = Journal(f'{self._prefix}{JOURNAL_NAME}')

    def start(self, time_ns: int) -> list[RecordedMessage | Topic]:
        """Return the records with which a recording begins."""
        latched = [make_topic(self._prefix + name, kind, latched=True) for name, kind in LATCHED_OUTPUTS.items()]
        return [*latched, self._journal.make_parameters_record(self._parameters, time_ns)]

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

    def note_lost(self) -> None:
        """Count the newest input as lost, as the disk is too slow for its records."""
        self._journal.mark_last_input_lost()


class MergedInput(NamedTuple):
    """What a message of skeletons causes."""

    outputs: tuple[OutputMessage, ...]
    records: list[RecordedMessage]
    reason: str  # why it was not accepted; else empty


def holds_merged_run(bag: Bag) -> bool:
    """Return whether a bag was recorded by `mocap_merge`."""
    return any(topic.endswith(f'/{JOURNAL_NAME}') for topic in bag.topics_of_type([JOURNAL]))


def replay_merging(bag: Bag, out: Path, progress: ProgressWrapper) -> int:
    """Merge the inputs of a recorded run again, into another bag, and return their number."""
    run = MergedRun(read_run(bag).parameters)
    count = 0
    with Recorder(out, ONE_FILE, name=out.name) as recorder:
        for count, message in enumerate(progress(bag.messages(run.topics), bag.count(run.topics)), 1):
            first = run.start(message.time_ns) if count == 1 else []
            merged = run.feed(message.topic, message.raw, (message.time_ns, message.time_ns))
            recorder.write_all([*first, *merged.records])
    return count


def _add_camera(people: People, intrinsics: Intrinsics | None) -> People:
    """Return people in the optical frame of a camera with their weak-perspective cameras, if it is known."""
    if intrinsics is None or not len(people):
        return people
    middles = people.core.mean(axis=1)
    middles[middles[:, 2] <= 0] = np.nan  # behind the camera
    turns = [RigidTransform(np.zeros(3), tuple(turn)).rotation for turn in people.joint_orientation[:, PELVIS]]
    return copy_with(
        people,
        scale=intrinsics.focal / middles[:, 2],
        translation=intrinsics.project(middles),
        rotation=np.array(turns),
    )
