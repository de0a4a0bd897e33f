# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load people in 3D from result files of `reconstruct`, and from bags that hold skeletons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.bags.journal import JOURNAL, RESET, Acceptance, decode_entry, read_run
from mocap_ros.bags.reader import Bag, is_bag
from mocap_ros.bags.topics import PEOPLE_TYPES
from mocap_ros.config import Config
from mocap_ros.errors import InputError, SkeletonError, naming
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.reading_options import NO_OPTIONS, ReadingOptions
from mocap_ros.formats.result_file import UNKNOWN_CAMERA, load_result_file
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size
from mocap_ros.messages.skeletons import SKELETONS, ReceivedSkeletons, decode_skeletons, find_intrinsics
from mocap_ros.offline.whole_sequence import Report
from mocap_ros.people import SHARED_COLUMNS, CameraVertical, People, PoseSequence, TrackedFrame
from mocap_ros.recordings.input_kind import InputKind, check_options
from mocap_ros.recordings.load_keypoints import load_bag
from mocap_ros.recordings.recording import Drop, Recording
from mocap_ros.runtime.input_camera import KNOWN
from mocap_ros.summary import UNKNOWN_SUMMARY, Summary
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.summary import RunSummary

MAX_VERTICAL = 2.0  # length of a unit vector, far beyond its rounding; a longer one is damaged
MAX_GIVEN_STD = math.radians(2.0)  # rad; verticals that are given have 1 degree, those found 2.5 or more


def load_result(path: Path, person: str | None = None) -> PoseSequence:
    """Load the person with this id, or the one with most skeletons, from a result file or a bag.

    In a bag there is a frame for each message of skeletons. InputError where one cannot be read.
    """
    if not is_bag(path):
        return load_recording(path, ReadingOptions(person=person)).people[0]
    recording = _load_bag(path, NO_OPTIONS, Config(), lambda _: None, with_keypoints=False)
    counts = {p.id: int(p.in_sight.sum()) for p in recording.people}
    wanted = max(counts, key=counts.__getitem__) if person is None else person
    if wanted not in counts:
        people = ', '.join(f'{i} ({n})' for i, n in sorted(counts.items(), key=lambda item: -item[1]))
        raise InputError(f'{path}: no person {person!r}; there are {people}')
    return next(p for p in recording.people if p.id == wanted)


def load_recording(
    path: Path,
    reading: ReadingOptions = NO_OPTIONS,
    config: Config | None = None,
    report: Report = lambda _: None,
) -> Recording:
    """Load all people of a result file or a bag of skeletons, or the one whom `reading` names.

    In a bag, what they rest on is judged by the keypoints in it, as in the recorded run. `report` gets the share
    of its messages that were read.
    """
    is_in_bag = is_bag(path)
    check_options(path, reading._asdict(), InputKind.SKELETONS if is_in_bag else InputKind.RESULT)
    if is_in_bag:
        return _load_bag(path, reading, config or Config(), report, with_keypoints=True)
    poses, summary = load_result_file(path)
    if not poses.in_sight.any():
        raise InputError(f'{path}: no frame has a skeleton')
    return Recording((replace(poses, id='person_1'),), summary)


def follow_person(
    person_id: str, stamps_ns: Sequence[int], rows: People, row_stamps_ns: Sequence[int], intrinsics: Intrinsics
) -> PoseSequence:
    """Return one person, who has a row at some of the stamps in ns, over time."""
    frames, count = np.searchsorted(stamps_ns, row_stamps_ns), len(stamps_ns)
    columns: dict[str, Any] = {}
    for name, column in SHARED_COLUMNS.items():
        columns[name] = column.fill(count, len(rows.skeleton.joints))
        columns[name][frames] = getattr(rows, name)
    motion, cadence = np.zeros(count, int), np.full(count, np.nan)
    motion[frames], cadence[frames] = [m.kind for m in rows.motion], [m.cadence for m in rows.motion]
    return PoseSequence(
        id=person_id,
        times=np.array(stamps_ns) / NS_PER_S,
        skeleton=rows.skeleton,
        intrinsics=intrinsics,
        recorded_ns=tuple(stamps_ns),
        motion=motion,
        cadence=cadence,
        **columns,
    )


class _Messages(NamedTuple):
    """What is read of a bag of skeletons."""

    topic: str
    skeletons: list[ReceivedSkeletons]
    drops: list[Drop]
    restarts: set[int]  # numbers of skeletons before resets
    summary: RunSummary  # which has counted what became of the messages of people
    faults: list[str]  # why messages could not be read


def _load_bag(
    path: Path, reading: ReadingOptions, config: Config, report: Report, *, with_keypoints: bool
) -> Recording:
    detections = Detections([], [])
    if with_keypoints:
        with suppress(*(() if reading.topic or reading.camera_info else (InputError,))):
            detections = load_bag(path, config.node, reading.topic, reading.camera_info)
    read = _read_messages(path, report)
    if read.faults and not with_keypoints:
        raise InputError(f'{path}: {read.faults[0]}')
    everybody = People.concatenate([People.none(), *(array.people for array in read.skeletons)])
    if not len(everybody) or reading.person not in (None, *everybody.ids):
        wanted = 'no person' if reading.person is None else f'no person {reading.person!r}'
        raise InputError(f'{path}: {wanted} is in any message of {read.topic}')
    intrinsics = detections.intrinsics or UNKNOWN_CAMERA
    if with_keypoints and detections.intrinsics is None:
        with naming(f'{path}: {read.topic}'):
            intrinsics = find_intrinsics(everybody)
    size = resolve_image_size(stated=detections.image_size, configured=intrinsics.image_size or UNKNOWN_SIZE)
    ids = [*dict.fromkeys(everybody.ids)] if reading.person is None else [reading.person]
    people = _collect_people(read.skeletons, everybody, ids, replace(intrinsics, image_size=size))
    if not any(person.in_sight.any() for person in people):
        raise InputError(f'{path}: no frame has a skeleton')
    summary = _judge(read, detections, people[0].intrinsics, config) if detections.people else UNKNOWN_SUMMARY
    left_out = [f'{len(read.faults)} messages left out; {read.faults[0]}'] if read.faults else []
    notes = tuple(f'{path}: {note}' for note in (*detections.notes, *left_out))
    return Recording(people, summary, notes, detections, tuple(read.drops))


def _read_messages(path: Path, report: Report) -> _Messages:
    with Bag(path) as bag:
        topic = find_skeletons_topic(bag)
        journals = [name for name in bag.topics_of_type([JOURNAL]) if name.endswith('/journal')]
        read, layouts, newest_ns = _Messages(topic, [], [], set(), RunSummary(), []), set[str](), 0
        count = bag.count([topic, *journals])
        for index, message in enumerate(bag.messages([topic, *journals])):
            report(index / count)
            try:
                if message.topic == topic:
                    array = decode_skeletons(message.raw)
                    together = layouts | {array.people.skeleton.name for _ in array.people.ids}
                    if len(together) > 1:
                        raise InputError(f'skeletons of several layouts: {", ".join(sorted(together))}')
                    layouts, newest_ns = together, array.header.stamp_ns
                    read.skeletons.append(array)
                    continue
                entry = decode_entry(message.raw)
                if entry.kind == RESET:
                    read.restarts.add(len(read.skeletons))
                if entry.acceptance is not Acceptance.ACCEPTED:
                    read.drops.append(Drop(newest_ns, entry.reason))
                if bag.topics.get(entry.topic) in PEOPLE_TYPES:
                    read.summary.count(entry.acceptance)
            except (InputError, SkeletonError) as error:
                read.faults.append(f'{message.topic}: {error}')
    return read


def _collect_people(
    skeletons: Sequence[ReceivedSkeletons], everybody: People, ids: Sequence[str], intrinsics: Intrinsics
) -> tuple[PoseSequence, ...]:
    """Return people with these ids over all stamps, in the order in which they came."""
    by_stamp = {array.header.stamp_ns: array for array in skeletons}
    stamps = sorted(by_stamp)
    directions = np.array([by_stamp[stamp_ns].vertical for stamp_ns in stamps])
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    vertical = np.where((length > 0) & (length < MAX_VERTICAL), directions, np.nan)
    vertical_std = np.array([by_stamp[stamp_ns].vertical_std for stamp_ns in stamps])
    row_stamps = [array.header.stamp_ns for array in skeletons for _ in array.people.ids]
    rows_by_id: dict[str, list[int]] = {}
    for row, person_id in enumerate(everybody.ids):
        rows_by_id.setdefault(person_id, []).append(row)
    people = []
    for person_id in ids:
        rows = rows_by_id[person_id]
        own_stamps = [row_stamps[row] for row in rows]
        person = follow_person(person_id, stamps, everybody.select(rows), own_stamps, intrinsics)
        people.append(replace(person, vertical=vertical, vertical_std=vertical_std))
    return tuple(sorted(people, key=lambda person: int(person.in_sight.argmax())))


def _judge(read: _Messages, detections: Detections, intrinsics: Intrinsics, config: Config) -> Summary:
    """Return what the people of a bag rest on, judged by its keypoints as in the recorded run."""
    seen = dict(zip(detections.stamps_ns, detections.people, strict=True))
    source = 'as recorded' if detections.intrinsics is None else KNOWN
    for number, array in enumerate(read.skeletons):
        if number in read.restarts:
            read.summary.restart()
        std, stamp_ns = array.vertical_std, array.header.stamp_ns
        vertical = CameraVertical(array.vertical, std, is_given=std < MAX_GIVEN_STD) if std > 0 else None
        tracked = TrackedFrame(stamp_ns, array.people, vertical)
        read.summary.add(stamp_ns, seen.get(stamp_ns, ()), tracked, intrinsics, source, config)
        read.summary.advance_judgement()
    return read.summary.summarise()


def find_skeletons_topic(bag: Bag) -> str:
    """Return the topic of skeletons, of `mocap_merge` that of its outputs; InputError unless there is one."""
    topics = bag.topics_of_type([SKELETONS])
    if len(topics) > 1:
        inputs = str(read_run(bag).parameters.get('inputs', '')).split()
        topics = [topic for topic in topics if topic not in inputs]
    if len(topics) != 1:
        found = f'several topics of skeletons: {", ".join(topics)}' if topics else 'no skeletons'
        raise InputError(f'{bag.path}: the bag has {found}')
    return topics[0]
