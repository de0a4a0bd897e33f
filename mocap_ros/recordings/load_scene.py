# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load what the viewers draw from any input or result: bags, sequence files, JSON and results of `reconstruct`.

Skeletons in a bag or a result are drawn as they are. Any other input is reconstructed, each of its people as a
whole sequence. The images behind the keypoints are those of a video, or of a bag.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Array32
from mocap_ros.bags.journal import JOURNAL, RESET, Verdict, decode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import PEOPLE_TYPES, find_people_topics
from mocap_ros.config import Config, NodeConfig
from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.npz_arrays import ArrayReader, iterate_arrays
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.formats.video import VideoReader
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.messages.images import IMAGE_TYPES, decode_image
from mocap_ros.messages.skeletons import RecordedPerson, RecordedSkeletons
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import Report, describe_height_faults
from mocap_ros.people import CameraVertical, MotionKind
from mocap_ros.recordings.input_kind import (
    KEYPOINT_FORMATS,
    KEYPOINT_KINDS,
    InputKind,
    find_input_kind,
    require_kind,
)
from mocap_ros.recordings.load_keypoints import InputOptions, load_bag, load_people
from mocap_ros.recordings.load_results import RecordedPeople, find_skeletons_topic, holds_result, load_result
from mocap_ros.recordings.reconstruct import reconstruct_people
from mocap_ros.runtime.frame_assembly import is_stamp_missing
from mocap_ros.runtime.input_camera import KNOWN
from mocap_ros.skeleton import CMU15, Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.summary import WRONG, RunSummary, summarise
from mocap_ros.viewing.overlay import StampedImage
from mocap_ros.viewing.scene import Mark, Scene, SceneKeypoints, ScenePerson

Row = TypeVar('Row')

MAX_PEOPLE = 16  # people who are reconstructed; those who are seen most, since each one takes seconds
VIEWED_FORMATS = f'{KEYPOINT_FORMATS}, or a result (.npz, .mcap)'
VIEWED_KINDS = (*KEYPOINT_KINDS, InputKind.RESULT)
# of a result file; older ones have no contacts, no floor and no grade
CAMERA_KEYS = (
    'scale', 'translation', 'vertical', 'vertical_std', 'scale_known', 'contact', 'world_from_camera', 'floor_std',
    'grade', 'summary',
)  # fmt: skip
# Fields of a `RecordedPerson` that a `ScenePerson` has as well, with their types there.
PERSON_FIELDS = {
    'joints': np.float32,
    'std': np.float32,
    'inferred': np.bool_,
    'residual': np.float32,
    'cadence': np.float32,
    'motion': np.uint8,
    'predicted': np.bool_,
    'tentative': np.bool_,
    'contact': np.float32,
}
MAX_GIVEN_STD = math.radians(2.0)  # rad; verticals that are given have 1 degree, those found 2.5 or more
MAX_VERTICAL = 2.0  # length of a unit vector, far beyond its rounding; a longer one is damaged


class SceneOptions(NamedTuple):
    """How an input is read and, where it holds no result, reconstructed."""

    config: Config  # parameters of tracker, solver and node
    models: Mapping[str, BasePoses]  # base poses by name
    input: InputOptions = InputOptions()  # how the input is read
    only_one: bool = False  # whether to reconstruct only the person who is seen most


def load_scene(path: Path, options: SceneOptions, report: Report = lambda _: None) -> tuple[Scene, list[str]]:
    """Load what is drawn of an input or a result; `report` gets the share of the work after the input is read.

    Returns the scene, and lines for the user about people and messages that were left out. It has no summary for a
    result without one, and a bag without keypoints.
    """
    kind = require_kind(path, VIEWED_KINDS, VIEWED_FORMATS)
    try:
        if kind is InputKind.RESULT:
            return _load_result_scene(path, options.input.person), []
        if kind is InputKind.BAG and holds_result(path):
            return _load_bag_scene(path, options, report)
        reading = options.input._replace(node=options.config.node)
        only_one = bool(reading.person) or options.only_one or kind is InputKind.SEQUENCE
        sequences, lines = load_people(path, reading, only_one=only_one)
        sequences = sorted(sequences, key=lambda s: -int((s.keypoints[..., 2] > 0).any(axis=1).sum()))
        if len(sequences) > MAX_PEOPLE:
            lines.append(f'{path}: {len(sequences) - MAX_PEOPLE} more people are not shown, who are seen less')
        return _reconstruct_people(path, sequences[:MAX_PEOPLE], options, report, lines), lines
    except InputError as error:
        prefix = '' if str(error).startswith(str(path)) else f'{path}: '
        raise InputError(f'{prefix}{error}') from None


def _reconstruct_people(
    path: Path, sequences: Sequence[KeypointSequence], options: SceneOptions, report: Report, lines: list[str]
) -> Scene:
    """Return the scene of some people; `lines` gets one for each who fails."""
    config = options.config
    stamps = np.unique(np.concatenate([sequence.stamps_ns for sequence in sequences]))
    intrinsics = sequences[0].intrinsics(config.tracker.nominal_focal_length)
    people: list[ScenePerson] = []
    keypoints: dict[Skeleton, list[SceneKeypoints]] = {}
    report(0.0)
    found, left_out = reconstruct_people(sequences, options.models, config, report)
    shown, results = [person.sequence for person in found], [person.result for person in found]
    lines.extend(f'{path}: {line}' for line in left_out)
    lines.extend(f'{path}: tracker.camera_height {fault}' for fault in describe_height_faults(results))
    for _, sequence, person_id, result in found:
        frames = np.searchsorted(stamps, sequence.stamps_ns)
        people.append(
            _make_person(person_id, frames, result, result.solution.residual, intrinsics, result.foot_contact)
        )
        part = _make_keypoints(sequence, frames)
        keypoints.setdefault(part.skeleton, []).append(part)
    truth = sequences[0].truth if len(sequences) == 1 else None
    skeleton, summary = results[0].skeleton, summarise(shown, results, config)
    world = results[0].world_from_camera
    height = None if all(r.floor is None for r in results) else float(world[2, 3])
    vertical = average_vertical(
        np.concatenate([r.vertical for r in results]), np.concatenate([r.vertical_std for r in results])
    )
    return Scene(
        title=path.name,
        stamps_ns=stamps.tolist(),
        people=tuple(people),
        keypoints=tuple(SceneKeypoints.merge(parts) for parts in keypoints.values()),
        image_size=sequences[0].image_size,
        intrinsics=intrinsics,
        truth=None if truth is None else select_true_joints(truth.joints, truth.joint_names, skeleton),
        skeleton=skeleton,
        vertical=vertical if height is None else world[2, :3],
        camera_height=height,
        summary=str(summary),
        is_wrong=summary.is_wrong,
    )


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


def _make_person(
    person_id: str, frames: Any, result: Any, residual: Array, intrinsics: Intrinsics, contact: Array
) -> ScenePerson:
    """Return the person of a `SequenceResult` or `StoredResult`, in those of its frames that have a skeleton."""
    rows = np.isfinite(result.joints).all(axis=(1, 2))
    joints, seen = result.joints[rows].astype(np.float32), result.seen[rows]
    return ScenePerson(
        id=person_id,
        frames=frames[rows],
        joints=joints,
        std=np.full(joints.shape[:2], np.nan, np.float32),
        inferred=~seen,
        intrinsics=intrinsics,
        residual=residual[rows].astype(np.float32),
        cadence=np.full(len(joints), np.nan, np.float32),
        motion=np.full(len(joints), MotionKind.UNKNOWN, np.uint8),
        predicted=np.asarray(~seen.any(axis=1)),
        tentative=np.zeros(len(joints), bool),
        contact=contact[rows].astype(np.float32),
    )


def _load_result_scene(path: Path, person: str | None) -> Scene:
    """Load the scene of a result file; in one without camera, the cameras of the frames give its intrinsics."""
    result, _ = load_result(path, person)
    arrays, count = (
        ArrayReader(dict(iterate_arrays(path, CAMERA_KEYS, 'a result of reconstruct'))),
        len(result.times),
    )
    scale, translation = arrays.read_numbers('scale', (count,)), arrays.read_numbers('translation', (count, 2))
    vertical = arrays.read_numbers('vertical', (count, 3)), arrays.read_numbers('vertical_std', (count,))
    is_focal_known = arrays.read_flags('scale_known', ())
    contact = arrays.read_numbers('contact', (count, 2)) if 'contact' in arrays else np.full((count, 2), np.nan)
    upward, height = average_vertical(*vertical), None
    if 'floor_std' in arrays and np.isfinite(arrays.read_numbers('floor_std', ())):
        world = arrays.read_numbers('world_from_camera', (4, 4))
        upward, height = world[2, :3], float(world[2, 3])
    if result.sequence is not None and result.sequence.is_camera_known:
        intrinsics, size = result.sequence.intrinsics(1.0), result.sequence.image_size
    else:
        intrinsics, size = recover_intrinsics(average_core(result.joints, result.skeleton), scale, translation)
    intrinsics, frames = replace(intrinsics, is_focal_known=bool(is_focal_known)), np.arange(count)
    grade, summary = (arrays.read_texts(k, ())[0] if k in arrays else '' for k in ('grade', 'summary'))
    return Scene(
        title=path.name,
        stamps_ns=result.stamps_ns,
        people=(_make_person('person_1', frames, result, result.residual, intrinsics, contact),),
        keypoints=() if result.sequence is None else (_make_keypoints(result.sequence, frames),),
        image_size=size,
        intrinsics=intrinsics,
        skeleton=result.skeleton,
        vertical=upward,
        camera_height=height,
        summary=summary,
        is_wrong=grade == WRONG,
    )


def recover_intrinsics(roots: Array, scale: Array, translation: Array) -> tuple[Intrinsics, tuple[int, int]]:
    """Return the camera, without distortion, of which weak-perspective cameras are known, and an image size in px.

        f = median s z,  c = median (t - f (x, y) / z)

    of roots (N, 3) m, means (x, y, z) of the joints, scales s (N,) px/m and translations t (N, 2) px. The
    principal point is in the middle of that image.
    """
    is_known = np.isfinite(np.column_stack([roots, scale, translation])).all(axis=1)
    if not is_known.any():
        raise InputError('scale, translation: not finite in any frame')
    roots, scale, translation = roots[is_known], scale[is_known], translation[is_known]
    focal = float(np.median(scale * roots[:, 2]))
    x, y = np.median(translation - focal * roots[:, :2] / roots[:, 2:], axis=0).tolist()
    if not (np.isfinite([focal, x, y]).all() and focal >= 1):
        raise InputError('scale, translation: not those of a camera')
    return Intrinsics(focal, (x, y), is_focal_known=False), (max(round(2 * x), 1), max(round(2 * y), 1))


def average_core(joints: NDArray[Any], skeleton: Skeleton) -> Array:
    """Return the means (N, 3) of the finite joints of `CMU15` among joints (N, J, 3); NaN where there is none."""
    core = joints[:, [skeleton.index(joint) for joint in CMU15.joints]].astype(np.float64)
    count = np.isfinite(core).sum(axis=1)
    return np.asarray(np.nan_to_num(core, posinf=0, neginf=0).sum(axis=1) / np.where(count, count, np.nan))


def _load_bag_scene(path: Path, options: SceneOptions, report: Report) -> tuple[Scene, list[str]]:
    """Load the scene of a bag of skeletons, with its keypoints if it has any, and the inputs that it dropped.

    What its people rest on is judged by these keypoints, as in the recorded run.
    """
    reading, detections, run = options.input, Detections([], []), RunSummary()
    with suppress(*(() if reading.topic or reading.camera_info else (InputError,))):
        detections = load_bag(path, options.config.node, reading.topic, reading.camera_info)
    people, arrays, drops, faults, newest_ns = RecordedPeople(), list[RecordedSkeletons](), [], [], 0
    restarts: set[int] = set()  # numbers of skeletons before resets
    with Bag(path) as bag:
        journals = [t for t in bag.topics_of_type([JOURNAL]) if t.endswith('/journal')]
        topics = [find_skeletons_topic(bag), *journals]
        count = bag.count(topics)
        for index, message in enumerate(bag.messages(topics)):
            report(index / count)
            try:
                if message.topic not in journals:
                    array = people.add(message.raw)
                    newest_ns = array.stamp_ns
                    arrays.append(array)
                    continue
                entry = decode_entry(message.raw)
                if entry.kind == RESET:
                    restarts.add(len(arrays))
                if entry.verdict is not Verdict.ACCEPTED:
                    drops.append((newest_ns, entry.reason))  # at the time of the skeletons before
                if bag.topics.get(entry.topic) in PEOPLE_TYPES:
                    run.count(entry.verdict)
            except (InputError, SkeletonError) as error:
                faults.append(f'{message.topic}: {error}')
    verticals = [[*a.vertical, a.vertical_std] for a in arrays if 0 < np.linalg.norm(a.vertical) < MAX_VERTICAL]
    known = np.array(verticals).reshape(-1, 4)
    vertical = average_vertical(known[:, :3], known[:, 3])
    scene = _build_bag_scene(people, reading.person, detections, drops)
    notes = [*detections.notes, *([f'{len(faults)} messages left out; {faults[0]}'] if faults else [])]
    scene = replace(scene, title=path.name, vertical=vertical)
    if seen := dict(zip(detections.stamps_ns, detections.people, strict=True)):
        camera = replace(scene.intrinsics, image_size=scene.image_size)
        source = KNOWN if camera.is_focal_known else 'as recorded'
        for number, (stamp_ns, shown, upward, std) in enumerate(arrays):
            if number in restarts:
                run.restart()
            found = CameraVertical(upward, std, is_given=std < MAX_GIVEN_STD) if std > 0 else None
            run.add(stamp_ns, seen.get(stamp_ns, ()), shown, camera, source, found, options.config)
            run.advance_judgement(options.config)
        summary = run.summarise()
        scene = replace(scene, summary=str(summary), is_wrong=summary.is_wrong)
    return scene, [f'{path}: {note}' for note in notes]


def _build_bag_scene(
    recorded: RecordedPeople, person_id: str | None, detections: Detections, drops: Sequence[tuple[int, str]]
) -> Scene:
    """Return the scene of recorded people, or of one; `drops` are stamps in ns and reasons."""
    by_id, skeleton = recorded.by_id, recorded.skeleton
    if person_id is not None:
        by_id = {person_id: by_id[person_id]} if person_id in by_id else {}
    if not by_id:
        wanted = 'no person' if person_id is None else f'no person {person_id!r}'
        raise InputError(f'{wanted} is in any message of skeletons')
    stamps = np.array(sorted({*detections.stamps_ns, *recorded.stamps_ns}))
    stamps = stamps[int(is_stamp_missing(stamps[0], stamps[-1])) :]
    found = {i: _sort(own.items(), stamps) for i, own in by_id.items()}
    rows = [row for _, own in found.values() for row in own]
    scale, translation = (np.array([getattr(row, name) for row in rows]) for name in ('scale', 'translation'))
    roots = average_core(np.array([row.joints for row in rows]), skeleton)
    intrinsics, implied_size = recover_intrinsics(roots, scale, translation)
    intrinsics = detections.intrinsics or intrinsics
    people = [make_scene_person(i, frames, own, intrinsics) for i, (frames, own) in found.items() if own]
    points: dict[tuple[str, ...], list[tuple[int, Array]]] = {}  # stamps in ns and points by joints
    for stamp_ns, seen in zip(detections.stamps_ns, detections.people, strict=True):
        for person in seen:
            points.setdefault(person.joints, []).append((stamp_ns, person.points))
    dropped = np.searchsorted(stamps, [stamp for stamp, _ in drops]).clip(max=len(stamps) - 1)
    times = ((stamps[dropped] - stamps[0]) / NS_PER_S).tolist()
    return Scene(
        title='',
        stamps_ns=stamps.tolist(),
        people=tuple(sorted(people, key=lambda person: person.frames[0])),
        keypoints=tuple(
            SceneKeypoints(skeleton_from_joints(joints), frames, np.array(own, np.float32))
            for joints, (frames, own) in ((joints, _sort(own, stamps)) for joints, own in points.items())
        ),
        image_size=resolve_image_size(stated=detections.image_size, configured=implied_size),
        intrinsics=intrinsics,
        marks=tuple(Mark(t, why) for t, (_, why) in zip(times, drops, strict=True)),
        skeleton=skeleton,
    )


def make_scene_person(
    person_id: str, frames: NDArray[np.intp], rows: Sequence[RecordedPerson], intrinsics: Intrinsics
) -> ScenePerson:
    """Return recorded people, one or more, as the frames of one person."""
    fields: dict[str, Any] = {
        name: np.array([getattr(row, name) for row in rows], t) for name, t in PERSON_FIELDS.items()
    }
    return ScenePerson(person_id, frames, intrinsics=intrinsics, **fields)


def _sort(rows: Iterable[tuple[int, Row]], stamps: NDArray[np.int64]) -> tuple[NDArray[np.intp], list[Row]]:
    """Return the frames and the rows whose stamps are among the stamps of the frames, in their order."""
    kept = sorted((row for row in rows if row[0] >= stamps[0]), key=lambda row: row[0])
    return np.searchsorted(stamps, [stamp for stamp, _ in kept]), [row for _, row in kept]


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
