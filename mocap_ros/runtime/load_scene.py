# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load what the viewers draw from any input or result: bags, sequence files, JSON and results of `reconstruct`.

Skeletons in a bag or a result are drawn as they are. Any other input is reconstructed, each of its people as a
whole sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.journal import JOURNAL, Verdict, decode_entry
from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.topics import Source, find_people_topics, find_people_type
from mocap_ros.config import Config, format_value, load_yaml
from mocap_ros.errors import FrameDropped, InputError, SkeletonError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.npz_arrays import ArrayReader, read_arrays
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations, load_result_file
from mocap_ros.formats.text_files import read_text
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.skeletons import SKELETONS, RecordedPerson, RecordedSkeletons, decode_skeletons
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.people import MotionKind
from mocap_ros.runtime.detection import ShowProgress
from mocap_ros.runtime.frame_assembly import FrameAssembler, is_stamp_missing
from mocap_ros.runtime.input_kind import KEYPOINT_FORMATS, KEYPOINT_KINDS, InputKind, require_kind
from mocap_ros.runtime.load_keypoints import find_camera, load_input, load_people
from mocap_ros.runtime.load_results import holds_result
from mocap_ros.skeleton import CMU15, Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Mark, MarkKind, Scene, SceneKeypoints, ScenePerson

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Row = TypeVar('Row')
# A function that shows progress while the items are iterated; its second argument is their number.
ProgressWrapper = Callable[[Iterable[Any], int], Iterable[Any]]

MAX_PEOPLE = 16  # people who are reconstructed; those who are seen most, since each one takes seconds
VIEWED_FORMATS = f'{KEYPOINT_FORMATS}, or a result (.npz, .mcap)'
VIEWED_KINDS = (*KEYPOINT_KINDS, InputKind.RESULT)
MAX_STAMP_NS = 2**63 - 1  # ns; stamps are int64
STAMP_TOLERANCE_S = 1e-3  # s; times that are written in s since the epoch are exact to 1e-6 s
MAX_KEYFRAMES_BYTES = 16 << 20  # bytes; guards against parsing a huge file as keyframes
CAMERA_KEYS = ('scale', 'translation', 'vertical', 'scale_known')  # of a result file; 0.1 wrote the first two
PERSON_FIELDS = ('joints', 'std', 'inferred', 'residual', 'cadence', 'motion', 'predicted', 'tentative')
MAX_VERTICAL = 2.0  # length of a unit vector, far beyond its rounding; a longer one is damaged


@dataclass(frozen=True)
class SceneOptions:
    """How an input is read and, where it holds no result, reconstructed.

    Attributes:
        config: parameters of tracker, solver and node.
        models: base poses by name.
        video: frame rate, image size and keypoint layout of JSON files; the detector of a video.
        person: id of the only person to show; None for all.
        topic: topic of the keypoints in a bag; None for the only one.
        camera_info: topic of the CameraInfo in a bag; None for the one that belongs to the keypoints.
        show_detection: function that shows the progress of a detector on a video.
        only_one: whether to reconstruct only the person who is seen most.
    """

    config: Config
    models: Mapping[str, BasePoses]
    video: Video = field(default_factory=Video)
    person: str | None = None
    topic: str | None = None
    camera_info: str | None = None
    show_detection: ShowProgress = lambda images, _: images
    only_one: bool = False


def load_scene(
    path: Path, options: SceneOptions, progress: ProgressWrapper = lambda items, _: items
) -> tuple[Scene, list[str]]:
    """Load what is drawn of an input or a result.

    Args:
        path: the file or folder.
        options: how to read and to reconstruct it.
        progress: function that shows progress.

    Returns:
        The scene, and lines for the user about people and messages that were left out.

    Raises:
        InputError: the input is of no known format, is damaged or shows nobody; the error names the place.
    """
    kind = require_kind(path, VIEWED_KINDS, VIEWED_FORMATS)
    try:
        if kind is InputKind.RESULT:
            return _load_result_scene(path, options.person), []
        if kind is InputKind.BAG and holds_result(path):
            return _load_bag_scene(path, options, progress)
        read = path, options.video, options.config.node
        topics = options.topic, options.camera_info
        if options.person or options.only_one or kind is InputKind.SEQUENCE:
            sequence, lines = load_input(*read, options.person, *topics, options.show_detection)
            sequences = [sequence]
        else:
            sequences, lines = load_people(*read, *topics, options.show_detection)
            sequences = sorted(sequences, key=lambda s: -int((s.keypoints[..., 2] > 0).any(axis=1).sum()))
            if len(sequences) > MAX_PEOPLE:
                lines.append(f'{path}: {len(sequences) - MAX_PEOPLE} more people are not shown, who are seen less')
        return _reconstruct_people(path, sequences[:MAX_PEOPLE], options, progress, lines), lines
    except InputError as error:
        prefix = '' if str(error).startswith(str(path)) else f'{path}: '
        raise InputError(f'{prefix}{error}') from None


def _reconstruct_people(
    path: Path,
    sequences: Sequence[KeypointSequence],
    options: SceneOptions,
    progress: ProgressWrapper,
    lines: list[str],
) -> Scene:
    """Return the scene of some people; `lines` gets one for each person who cannot be reconstructed.

    Raises:
        InputError: nobody can be reconstructed.
    """
    nominal = options.config.tracker.nominal_focal_length
    stamps = np.unique(np.concatenate([sequence.stamps_ns for sequence in sequences]))
    intrinsics = sequences[0].intrinsics(nominal)
    people: list[ScenePerson] = []
    keypoints: dict[Skeleton, list[SceneKeypoints]] = {}
    verticals, skeleton, failures = [], CMU15, []
    for index, sequence in enumerate(progress(sequences, len(sequences))):
        person_id = sequence.person_id or f'person_{index + 1}'
        frames = np.searchsorted(stamps, sequence.stamps_ns)
        try:
            result = reconstruct_sequence(*extract_observations(sequence, nominal), options.models, options.config)
        except (InputError, np.linalg.LinAlgError) as error:
            failures.append(str(error))
            lines.append(f'{path}: person {person_id!r} left out: {error}')
            continue
        skeleton = result.skeleton
        verticals.append(result.vertical)
        people.append(_make_person(person_id, frames, result, result.solution.residual, intrinsics))
        seen, layout = sequence.keypoints[..., 2] > 0, skeleton_from_joints(sequence.joint_names)
        points = np.where(seen[..., None], sequence.keypoints[..., :2], np.nan).astype(np.float32)
        rows = seen.any(axis=1)
        keypoints.setdefault(layout, []).append(SceneKeypoints(layout, frames[rows], points[rows]))
    if not people:
        raise InputError(failures[-1])
    truth = sequences[0].truth if len(sequences) == 1 else None
    return Scene(
        title=path.name,
        stamps_ns=stamps.tolist(),
        people=tuple(people),
        keypoints=tuple(SceneKeypoints.merge(parts) for parts in keypoints.values()),
        image_size=sequences[0].image_size,
        intrinsics=intrinsics,
        truth=None if truth is None else select_true_joints(truth.joints, truth.joint_names, skeleton),
        skeleton=skeleton,
        vertical=average_vertical(np.concatenate(verticals)),
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


def _make_person(person_id: str, frames: Any, result: Any, residual: Array, intrinsics: Intrinsics) -> ScenePerson:
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
    )


def _load_result_scene(path: Path, person: str | None) -> Scene:
    """Load the scene of a result file, whose cameras give focal length and principal point."""
    if person is not None:
        raise InputError('--person does not apply to a result of reconstruct')
    result = load_result_file(path)
    if not np.isfinite(result.joints).all(axis=(1, 2)).any():
        raise InputError('no frame has a skeleton')
    arrays, count = ArrayReader(read_arrays(path, CAMERA_KEYS, 'a result of reconstruct')), len(result.times)
    scale, translation = arrays.read_numbers('scale', (count,)), arrays.read_numbers('translation', (count, 2))
    vertical = arrays.read_numbers('vertical', (count, 3)) if 'vertical' in arrays else np.full(3, np.nan)
    is_focal_known = 'scale_known' not in arrays or bool(arrays.read_flags('scale_known', ()))
    intrinsics, size = recover_intrinsics(_average_core(result.joints, result.skeleton), scale, translation)
    intrinsics = replace(intrinsics, is_focal_known=is_focal_known)
    return Scene(
        title=path.name,
        stamps_ns=result.stamps_ns,
        people=(_make_person('person_1', np.arange(count), result, result.residual, intrinsics),),
        keypoints=(),
        image_size=size,
        intrinsics=intrinsics,
        skeleton=result.skeleton,
        vertical=average_vertical(vertical),
    )


def recover_intrinsics(roots: Array, scale: Array, translation: Array) -> tuple[Intrinsics, tuple[int, int]]:
    """Return the camera whose weak-perspective cameras these are, without lens distortion.

    f = median s z,  c = median (t - f (x, y) / z)

    Args:
        roots: (N, 3) m, means (x, y, z) of the joints.
        scale: (N,) px/m, s.
        translation: (N, 2) px, t.

    Returns:
        The intrinsics, and the image size in px if the principal point is in its middle.
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


def _average_core(joints: NDArray[Any], skeleton: Skeleton) -> Array:
    """Return the means (N, 3) of the finite joints of `CMU15` among joints (N, J, 3); NaN where there is none."""
    core = joints[:, [skeleton.index(joint) for joint in CMU15.joints]].astype(np.float64)
    count = np.isfinite(core).sum(axis=1)
    return np.asarray(np.nan_to_num(core, posinf=0, neginf=0).sum(axis=1) / np.where(count, count, np.nan))


def _load_bag_scene(path: Path, options: SceneOptions, progress: ProgressWrapper) -> tuple[Scene, list[str]]:
    """Load the scene of a bag that holds skeletons."""
    with Bag(path) as bag:
        recording = _Recording(bag, options)
        for message in progress(bag.messages(recording.topics), bag.count(recording.topics)):
            recording.add(message)
    scene, faults = recording.build(path.name), recording.faults
    return scene, [f'{path}: {len(faults)} messages left out; {faults[0]}'] if faults else []


class _Recording:
    """The skeletons, keypoints and dropped inputs of a bag.

    Attributes:
        topics: topics of the messages to add.
        faults: why messages could not be used.
    """

    def __init__(self, bag: Bag, options: SceneOptions) -> None:
        skeletons = bag.topics_of_type([SKELETONS])
        if len(skeletons) != 1:
            raise InputError(f'the bag has several topics of skeletons: {", ".join(skeletons)}')
        self.faults: list[str] = []
        self._person, self._node, self._camera = options.person, options.config.node, None
        self._journals = [t for t in bag.topics_of_type([JOURNAL]) if t.endswith('/journal')]
        self._sources: dict[str, Source] = {}
        try:
            self._sources = find_people_topics(bag, options.topic)
            self._node = replace(self._node, input_type=find_people_type(bag, self._sources))
            first = next(iter(self._sources))
            self._camera, remark = find_camera(bag, first, self._node, options.camera_info)
            self.faults += filter(None, [remark])
        except InputError:
            if options.topic or options.camera_info:
                raise  # otherwise the skeletons are drawn without keypoints
        self.topics = [*skeletons, *self._journals, *self._sources]
        self._assembler, self._size = FrameAssembler(), (self._node.image_width, self._node.image_height)
        self._size = resolve_image_size(camera=self._camera.size if self._camera else None, configured=self._size)
        self._stated_size = UNKNOWN_SIZE
        self._skeleton = CMU15
        self._people: dict[str, dict[int, RecordedPerson]] = {}  # by stamps in ns
        self._detections: dict[tuple[str, ...], list[tuple[int, Array]]] = {}  # stamps in ns and points by joints
        self._stamps: set[int] = set()
        self._verticals: list[Array] = []
        self._drops: list[tuple[int, str]] = []
        self._newest_ns = 0

    def add(self, message: BagMessage) -> None:
        """Add a message, or note why it cannot be used."""
        topic, raw = message.topic, message.raw
        try:
            if topic in self._sources:
                self._add_frames(
                    self._assembler.assemble(self._sources[topic], raw, topic, self._node, self._size, inf)
                )
            elif topic in self._journals:
                entry = decode_entry(raw)
                if entry.verdict is not Verdict.ACCEPTED:
                    self._drops.append((self._newest_ns, entry.reason))
            else:
                self._add_skeletons(decode_skeletons(raw))
        except (InputError, SkeletonError, FrameDropped) as error:
            self.faults.append(f'{topic}: {error}')

    def _add_frames(self, frames: Iterable[KeypointsFrame]) -> None:
        for frame in frames:
            if frame.image_width:
                self._stated_size = frame.image_width, frame.image_height
            self._stamps.add(frame.header.stamp_ns)
            for person in frame.people:
                self._detections.setdefault(person.joints, []).append((frame.header.stamp_ns, person.points))

    def _add_skeletons(self, array: RecordedSkeletons) -> None:
        self._newest_ns = array.stamp_ns
        self._stamps.add(self._newest_ns)
        if 0 < np.linalg.norm(array.vertical) < MAX_VERTICAL:
            self._verticals.append(array.vertical)
        for person in array.people:
            if self._person not in (None, person.id):
                continue
            if self._people and person.skeleton != self._skeleton:
                raise InputError(f'{person.id}: joints of {person.skeleton.name}, others of {self._skeleton.name}')
            self._skeleton = person.skeleton
            self._people.setdefault(person.id, {})[self._newest_ns] = person

    def build(self, title: str) -> Scene:
        """Return the scene of all messages that were added.

        Raises:
            InputError: nobody is in any message, or the skeletons' cameras are not valid.
        """
        self._add_frames(self._assembler.flush())
        if not self._people:
            wanted = 'nobody' if self._person is None else f'no person {self._person!r}'
            raise InputError(f'{wanted} is in any message of skeletons')
        stamps = np.array(sorted(self._stamps))
        stamps = stamps[int(is_stamp_missing(stamps[0], stamps[-1])) :]
        person_type = _make_person_type(len(self._skeleton.joints))
        found = {i: _sort(own.items(), stamps) for i, own in self._people.items()}
        rows_of = {
            i: np.array([tuple(getattr(p, name) for name in person_type.names or ()) for p in own], person_type)
            for i, (_, own) in found.items()
        }
        rows = np.concatenate(list(rows_of.values()))
        roots = _average_core(rows['joints'], self._skeleton)
        intrinsics, implied_size = recover_intrinsics(roots, rows['scale'], rows['translation'])
        camera_size = None
        if self._camera is not None:
            intrinsics, camera_size = self._camera.intrinsics, self._camera.size
        drops = np.searchsorted(stamps, [stamp for stamp, _ in self._drops]).clip(max=len(stamps) - 1)
        times = ((stamps[drops] - stamps[0]) / NS_PER_S).tolist()
        return Scene(
            title=title,
            stamps_ns=stamps.tolist(),
            people=tuple(
                ScenePerson(i, frames, intrinsics=intrinsics, **{name: rows_of[i][name] for name in PERSON_FIELDS})
                for i, (frames, _) in sorted(found.items(), key=lambda item: item[1][0].tolist()[:1])
                if len(frames)
            ),
            keypoints=tuple(
                SceneKeypoints(skeleton_from_joints(joints), frames, np.array(points, np.float32))
                for joints, detections in self._detections.items()
                for frames, points in [_sort(detections, stamps)]
            ),
            image_size=resolve_image_size(stated=self._stated_size, camera=camera_size, configured=implied_size),
            intrinsics=intrinsics,
            marks=tuple(Mark(t, MarkKind.DROP, why) for t, (_, why) in zip(times, self._drops, strict=True)),
            skeleton=self._skeleton,
            vertical=average_vertical(np.array(self._verticals)),
        )


def _sort(rows: Iterable[tuple[int, Row]], stamps: NDArray[np.int64]) -> tuple[NDArray[np.intp], list[Row]]:
    """Return the frames and the rows whose stamps are among the stamps of the frames, in their order."""
    kept = sorted((row for row in rows if row[0] >= stamps[0]), key=lambda row: row[0])
    return np.searchsorted(stamps, [stamp for stamp, _ in kept]), [row for _, row in kept]


def _make_person_type(count: int) -> np.dtype[Any]:
    """Return the type of what is kept of a `RecordedPerson`, by its names, which are those of `ScenePerson`."""
    joints = [('joints', 'f4', (count, 3)), ('std', 'f4', count), ('inferred', '?', count)]
    states = [('motion', 'u1'), ('predicted', '?'), ('tentative', '?')]
    camera = [('scale', 'f8'), ('translation', 'f8', 2)]
    return np.dtype([*joints, ('residual', 'f4'), ('cadence', 'f4'), *states, *camera])


def load_keyframe_marks(path: Path) -> tuple[list[Mark], int | None]:
    """Load the times of keyframes from the file that `mocap-ros keyframes` writes.

    Returns:
        Marks, whose times in s count from the first frame of the person, and the stamp of that frame in ns; None
        where the file does not state it, as files of version 0.1.

    Raises:
        InputError: the file cannot be read or holds something else; the error names the place.
    """
    content = load_yaml(read_text(path, max_bytes=MAX_KEYFRAMES_BYTES), str(path))
    if not isinstance(content, dict) or not isinstance(content.get('keyframes'), list):
        raise InputError(f'{path}: no list of keyframes, as `mocap-ros keyframes` writes it')
    marks = []
    for number, entry in enumerate(content['keyframes'], 1):
        time: Any = entry.get('time') if isinstance(entry, dict) else None
        if isinstance(time, bool) or not isinstance(time, int | float) or not 0 <= time < np.inf:
            raise InputError(f'{path}: keyframe {number}: time: {time!r}, expected s from the beginning')
        marks.append(Mark(float(time), MarkKind.KEYFRAME, f'{entry.get("half", "whole")} body'))
    start_ns = content.get('start_ns')
    if start_ns is not None and (
        isinstance(start_ns, bool) or not isinstance(start_ns, int) or not 0 <= start_ns <= MAX_STAMP_NS
    ):
        raise InputError(f'{path}: start_ns: {format_value(start_ns)}, expected a whole number of ns')
    return marks, start_ns


def place_marks(marks: Sequence[Mark], start_ns: int, stamps_ns: Sequence[int]) -> list[Mark]:
    """Return those of some marks that are within a scene, with times from its beginning.

    Args:
        marks: marks, whose times in s count from a stamp.
        start_ns: the stamp in ns.
        stamps_ns: (F,) stamps of the frames of the scene in ns.

    Raises:
        InputError: no mark is within the scene.
    """
    duration_s, shift_s = ((t - stamps_ns[0]) / NS_PER_S for t in (stamps_ns[-1], start_ns))
    within = [
        replace(mark, time_s=min(max(mark.time_s + shift_s, 0.0), duration_s))
        for mark in marks
        if -STAMP_TOLERANCE_S <= mark.time_s + shift_s <= duration_s + STAMP_TOLERANCE_S
    ]
    if marks and not within:
        raise InputError(
            f'start_ns: no keyframe is within the recording, which begins at {stamps_ns[0]} ns and ends after '
            f'{duration_s:.1f} s; the keyframes are those of another recording'
        )
    return within
