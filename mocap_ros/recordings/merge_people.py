# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Merge the people of recordings of several cameras, in the optical frame and at the times of the first one.

The recordings are merged twice: the second time the sizes of people, and who is who, are known from the start.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array, Indices, Mask
from mocap_ros.errors import InputError, naming
from mocap_ros.geometry.interpolation import find_covered, find_nearest, interpolate_linearly
from mocap_ros.geometry.level import average_vertical, build_world
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.offline.whole_sequence import Report
from mocap_ros.people import People, PoseSequence
from mocap_ros.recordings.load_results import follow_person
from mocap_ros.solvers.merging import CameraView, MergedPeople, PeopleMerger
from mocap_ros.units import NS_PER_S

PASSES = 2  # of the merging
# Columns of people at a time between two frames, and those that have the value of the nearest one
INTERPOLATED = 'joints', 'joint_std', 'root_covariance', 'contact'
NOT_INTERPOLATED = 'inferred', 'turn_inferred', 'posture', 'posture_probability', 'predicted', 'tentative'
MIN_FRAMES = 10  # frames; who is there for less is a mistake of a camera


def merge_recordings(
    recordings: Sequence[Sequence[PoseSequence]],
    poses: Array,
    offsets: Array,
    report: Report = lambda _: None,
) -> tuple[MergedPerson, ...]:
    """Return the people whom C cameras saw, in the optical frame and at the times of the first camera.

    `poses` (C, 4, 4) take the optical frame of each camera to a common frame; `offsets` (C,) s are added to the
    times of each. Who is seen by the first camera has the keypoints of that.

    Raises:
        InputError: a person has no deviations, or nobody of a recording is there at the times of the first one; it
            begins with the number of the recording.
    """
    first = recordings[0]
    stamps = sorted({stamp for person in first for stamp in person.stamps_ns})
    times = np.array(stamps) / NS_PER_S
    cameras = [
        CameraPlacement('', RigidTransform.from_matrix(matrix)) for matrix in np.linalg.inv(poses[0]) @ poses
    ]
    layouts = {person.skeleton.name for people in recordings for person in people}
    if len(layouts) > 1:
        raise InputError(f'people of several layouts: {", ".join(sorted(layouts))}')
    sampled = []
    for number, (people, offset, camera) in enumerate(zip(recordings, offsets, cameras, strict=True), 1):
        with naming(f'recording {number}'):
            own = [_sample(p, times + offsets[0] - offset, camera) for p in people if p.in_sight.any()]
            if not any(person.is_known.any() for person in own):
                raise InputError('nobody is seen at any time of the first recording')
            sampled.append(own)
    merger, frames = PeopleMerger(is_recording=True), list[MergedPeople]()
    for turn in range(PASSES):
        merger.rewind()
        frames = []
        for frame, time_s in enumerate(times.tolist()):
            report((turn + frame / len(times)) / PASSES)
            views = [
                CameraView(_show(people, frame), camera.centre)
                for camera, people in zip(cameras, sampled, strict=True)
            ]
            frames.append(merger.merge(time_s, views))
    return _collect(frames, first, stamps)


class MergedPerson(NamedTuple):
    """A person whom several cameras saw."""

    poses: PoseSequence
    shared: int  # frames in which two cameras or more see the person


class _Sampled(NamedTuple):
    """A person whom a camera sees, in the frame of the first camera, at the times of the first recording."""

    people: People  # a row a frame in which the person is known
    is_known: Mask  # (F,) whether the person is known in a frame
    row: Indices  # (F,) the row of a frame in which the person is known


def _sample(person: PoseSequence, times: Array, camera: CameraPlacement) -> _Sampled:
    """Return a person at times (F,) in s, interpolated between frames that are not too far apart."""
    seen = person.in_sight
    is_positive = (person.joint_std[seen] > 0).all() and np.isfinite(person.root_covariance[seen]).all()
    if not (is_positive and (np.linalg.eigvalsh(person.root_covariance[seen]) > 0).all()):
        raise InputError(f'person {person.id!r} has no standard deviations: reconstruct the recording anew')
    own = person.select(seen)
    is_known = find_covered(times, own.times)
    at = times[is_known]
    nearest = find_nearest(at, own.times)

    turns = interpolate_linearly(at, own.times, own.joint_orientation)
    columns: dict[str, Any] = {
        **{name: interpolate_linearly(at, own.times, getattr(own, name)) for name in INTERPOLATED},
        **{name: getattr(own, name)[nearest] for name in NOT_INTERPOLATED},
    }
    people = People(
        ids=(person.id,) * len(at),
        skeleton=person.skeleton,
        joint_orientation=turns / np.linalg.norm(turns, axis=-1, keepdims=True),
        is_scale_known=person.is_scale_known,
        **columns,
    )
    return _Sampled(camera.place(people), is_known, np.cumsum(is_known) - 1)


def _show(people: Sequence[_Sampled], frame: int) -> People:
    """Return those of a camera's people who are known in a frame."""
    rows = [p.people.select([int(p.row[frame])]) for p in people if p.is_known[frame]]
    return People.concatenate(rows) if rows else People.none()


def _collect(
    frames: Sequence[MergedPeople], first: Sequence[PoseSequence], stamps: Sequence[int]
) -> tuple[MergedPerson, ...]:
    """Return the merged people over time, those first whom the first camera sees, in its order."""
    rows: dict[str, list[People]] = {}
    row_stamps: dict[str, list[int]] = {}
    names: dict[str, Counter[str]] = {}
    shared = Counter[str]()
    for stamp_ns, frame in zip(stamps, frames, strict=True):
        for number, person_id in enumerate(frame.people.ids):
            rows.setdefault(person_id, []).append(frame.people.select([number]))
            row_stamps.setdefault(person_id, []).append(stamp_ns)
            shared[person_id] += len(frame.tracks[number]) > 1
            if (shown := frame.tracks[number].get(0)) is not None:
                names.setdefault(person_id, Counter())[shown] += 1
    people = []
    for person_id, own_rows in rows.items():
        if len(own_rows) < min(MIN_FRAMES, max(map(len, rows.values()))):
            continue
        own_id = max(names[person_id], key=names[person_id].__getitem__) if person_id in names else None
        own = next((person for person in first if person.id == own_id), None)
        merged = follow_person(
            f'person_{person_id}', stamps, People.concatenate(own_rows), row_stamps[person_id], first[0].intrinsics
        )
        poses = _add_first_camera(merged, own or first[0], is_seen=own is not None)
        people.append(MergedPerson(poses, shared[person_id]))
    return tuple(people)


def _add_first_camera(merged: PoseSequence, own: PoseSequence, *, is_seen: bool) -> PoseSequence:
    """Return a merged person with what the first camera shows: vertical, floor and, if it sees them, keypoints."""
    nearest = find_nearest(merged.times, own.times)
    upward = average_vertical(own.vertical, own.vertical_std)
    sequence = own.sequence
    if sequence is not None and is_seen and sequence.stamps_ns != merged.stamps_ns:
        sequence = sequence.resample(merged.stamps_ns)
    return replace(
        merged,
        vertical=own.vertical[nearest],
        vertical_std=own.vertical_std[nearest],
        world_from_camera=build_world(merged.joints, upward, own.camera_height),
        floor_std=own.floor_std,
        body_height=own.body_height,
        sequence=sequence if is_seen else None,
    )
