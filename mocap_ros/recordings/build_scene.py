# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Make the scene of a recording, which the viewers draw, and read the images behind it, of a video or a bag."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Array32
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import find_people_topics
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.video import VideoReader
from mocap_ros.geometry.level import average_vertical
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.messages.images import IMAGE_TYPES, decode_image
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.input_kind import InputKind, find_input_kind
from mocap_ros.recordings.recording import Recording
from mocap_ros.runtime.frame_assembly import is_stamp_missing
from mocap_ros.skeleton import CMU15, Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.overlay import StampedImage
from mocap_ros.viewing.scene import Mark, Scene, SceneKeypoints


def build_scene(title: str, recording: Recording) -> Scene:
    """Return what is drawn of a recording: its people where they are in sight, and their keypoints."""
    people, detections = recording.people, recording.detections or Detections([], [])
    sequences = [person.sequence for person in people if person.sequence is not None]
    stamps = np.unique(
        np.concatenate([detections.stamps_ns, *(person.stamps_ns for person in people)]).astype(int)
    )
    stamps = stamps[int(is_stamp_missing(stamps[0], stamps[-1])) :]
    parts = [_make_keypoints(s, np.searchsorted(stamps, s.stamps_ns)) for s in sequences]
    parts += _collect_detections(detections, stamps)
    by_layout: dict[Skeleton, list[SceneKeypoints]] = {}
    for part in parts:
        by_layout.setdefault(part.skeleton, []).append(part)
    dropped = np.searchsorted(stamps, [drop.stamp_ns for drop in recording.drops]).clip(max=len(stamps) - 1)
    times = ((stamps[dropped] - stamps[0]) / NS_PER_S).tolist()
    first, truth = people[0], sequences[0].truth if len(people) == len(sequences) == 1 else None
    if first.camera_height is None:
        vertical = average_vertical(
            np.concatenate([p.vertical for p in people]), np.concatenate([p.vertical_std for p in people])
        )
    else:
        vertical = first.world_from_camera[2, :3]
    return Scene(
        title=title,
        stamps_ns=stamps.tolist(),
        people=tuple(shown for shown in (_select_shown(p, int(stamps[0])) for p in people) if len(shown)),
        keypoints=tuple(SceneKeypoints.merge(own) for own in by_layout.values()),
        image_size=sequences[0].image_size if sequences else first.intrinsics.image_size or (1, 1),
        intrinsics=first.intrinsics,
        marks=tuple(Mark(time_s, drop.reason) for time_s, drop in zip(times, recording.drops, strict=True)),
        truth=None if truth is None else select_true_joints(truth.joints, truth.joint_names, first.skeleton),
        skeleton=first.skeleton,
        vertical=vertical,
        camera_height=first.camera_height,
        summary=str(recording.summary),
        is_wrong=recording.summary.is_wrong,
    )


def _select_shown(person: PoseSequence, first_ns: int) -> PoseSequence:
    """Return a person in the frames that have a skeleton, from the stamp of the first frame of the scene on."""
    return person.select(person.in_sight & (np.array(person.stamps_ns) >= first_ns))


def select_true_joints(joints: Array, names: Sequence[str], skeleton: Skeleton = CMU15) -> Array32 | None:
    """Return the joints (F, J, 3) of a skeleton among true joints (F, J3, 3), NaN for those that are not there.

    None if a joint of `CMU15` is missing.
    """
    if not set(CMU15.joints) <= set(names):
        return None
    unknown = np.full((len(joints), 3), np.nan)
    found = [joints[:, names.index(name)] if name in names else unknown for name in skeleton.joints]
    return np.stack(found, axis=1).astype(np.float32)


def _make_keypoints(sequence: KeypointSequence, frames: NDArray[np.intp]) -> SceneKeypoints:
    seen, layout = sequence.keypoints[..., 2] > 0, skeleton_from_joints(sequence.joint_names)
    points = np.where(seen[..., None], sequence.keypoints[..., :2], np.nan).astype(np.float32)
    rows = seen.any(axis=1)
    return SceneKeypoints(layout, frames[rows], points[rows])


def _collect_detections(detections: Detections, stamps: NDArray[np.int64]) -> list[SceneKeypoints]:
    """Return the detections whose stamps are among those in ns of the frames, by their joints."""
    by_joints: dict[tuple[str, ...], list[tuple[int, Array]]] = {}
    for stamp_ns, people in zip(detections.stamps_ns, detections.people, strict=True):
        for person in people if stamp_ns >= stamps[0] else ():
            by_joints.setdefault(person.joints, []).append((stamp_ns, person.points))
    return [
        SceneKeypoints(
            skeleton_from_joints(joints),
            np.searchsorted(stamps, [stamp_ns for stamp_ns, _ in own]),
            np.array([points for _, points in own], np.float32),
        )
        for joints, own in by_joints.items()
    ]


def read_images(path: Path, limits: NodeConfig, topic: str | None, notes: list[str]) -> Iterator[StampedImage]:
    """Yield the images of a video or a bag; none of any other input. `notes` gets a line about those left out.

    Of several cameras in a bag it is that of the keypoints on `topic`.
    """
    kind = find_input_kind(path)
    if kind is InputKind.VIDEO:
        with VideoReader(path) as reader:
            for image, time_s in reader:
                yield StampedImage(round(time_s * NS_PER_S), image)
    elif kind is InputKind.BAG:
        with Bag(path) as bag:
            yield from _read_bag_images(bag, limits, topic, notes)


def _read_bag_images(bag: Bag, limits: NodeConfig, topic: str | None, notes: list[str]) -> Iterator[StampedImage]:
    """Yield the images of the topic whose name begins most like that of the keypoints, of several cameras."""
    keypoints = topic or '/'
    with suppress(InputError):
        keypoints = next(iter(find_people_topics(bag, topic)))
    candidates = [name for name in bag.topics_of_type(IMAGE_TYPES) if 'depth' not in name]
    if not candidates:
        return
    chosen = max(candidates, key=lambda name: len(os.path.commonpath([name, keypoints])))
    faults: list[str] = []
    for message in bag.messages([chosen]):
        try:
            header, image = decode_image(message.raw, bag.topics[chosen], limits)
        except InputError as error:
            faults.append(str(error))
            continue
        yield StampedImage(header.stamp_ns, image)
    if faults:
        notes.append(f'{bag.path}: {chosen}: {len(faults)} images left out; {faults[0]}')
