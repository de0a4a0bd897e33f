# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The two ways in which a view is reconstructed: as a whole sequence, and frame by frame as the tracker does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import common
import numpy as np
from common import View
from numpy.typing import NDArray

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.people import MotionKind, Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]
Models = Mapping[str, BasePoses]

WAYS = ('whole', 'live')
JOINTS = len(CMU15.joints)  # that the benchmarks compare: those of the core, which come first


@dataclass(frozen=True, eq=False)
class TrackedSequence:
    """The output of the tracker for a sequence of one person; NaN and None in frames without output.

    Attributes:
        joints: (F, 15, 3) m, the newest frame of each update, or with a lag the frame that was put out.
        std: (F, 15) m.
        inferred: (F, 15).
        kinds: (F,) of the motion.
        newest: (F,) the tracker's window that ends with this frame.
    """

    joints: Array
    std: Array
    inferred: NDArray[np.bool_]
    kinds: list[MotionKind]
    newest: list[Track | None]


def list_people(view: View, person_id: str = 'p') -> list[Person2D]:
    """Return the person of a view in each frame."""
    keypoints = view.sequence['keypoints'].astype(float)
    return [Person2D(person_id, view.joint_names, k[:, :2], k[:, 2]) for k in keypoints]


def track_people(
    frames: Sequence[Sequence[Person2D]], times: Array, camera: Intrinsics, models: Models, config: Config
) -> Iterator[tuple[Tracker, tuple[Person3D, ...]]]:
    """Yield the tracker and the people that it puts out, frame by frame."""
    tracker = Tracker(models, config)
    for people, time_s in zip(frames, times, strict=True):
        yield tracker, tracker.update(round(time_s * NS_PER_S) + 1, people, camera)
        tracker.run_deferred_work()


def track(view: View, models: Models, config: Config) -> TrackedSequence:
    """Reconstruct a view frame by frame."""
    times = view.sequence['timestamps']
    stamps = [round(t * NS_PER_S) + 1 for t in times]
    joints = np.full((view.frames, JOINTS, 3), np.nan)
    std, inferred = np.full(joints.shape[:2], np.nan), np.zeros(joints.shape[:2], bool)
    kinds: list[MotionKind] = []
    newest: list[Track | None] = []
    frames = [[p] for p in list_people(view)]
    for tracker, people in track_people(frames, times, view.intrinsics, models, config):
        is_seen = bool(people) and not people[0].predicted
        kinds.append(people[0].motion.kind if people else MotionKind.UNKNOWN)
        newest.append(tracker.tracks[0].copy() if is_seen else None)
        if people:
            at = stamps.index(tracker.output_stamp_ns)
            joints[at], std[at] = people[0].joints[:JOINTS], people[0].std[:JOINTS]
            inferred[at] = people[0].inferred[:JOINTS]
    return TrackedSequence(joints, std, inferred, kinds, newest)


def reconstruct_whole(view: View, models: Models, config: Config, part: slice = slice(None)) -> Array:
    """Return the poses (F, 15, 3) m of a whole sequence, or of a part of it that is solved by itself."""
    keypoints, times = view.sequence['keypoints'][part].astype(float), view.sequence['timestamps'][part]
    found = reconstruct_sequence(keypoints, view.joint_names, times, view.intrinsics, models, config)
    return found.joints[:, :JOINTS]


def reconstruct(way: str, view: View, models: Models, config: Config) -> Array:
    """Return the poses (F, 15, 3) m of one of `WAYS`."""
    return reconstruct_whole(view, models, config) if way == 'whole' else track(view, models, config).joints


def provide_held_out(config: Config | None = None) -> tuple[Models, Config]:
    """Return base poses of all motions and a configuration with a lifter that saw none of the tested people."""
    models = {ALL_MOTIONS: common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)}
    return models, with_values(config or Config(), {'solver.prior': str(common.HELD_OUT_LIFTER)})
