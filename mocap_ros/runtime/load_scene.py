# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load what the viewers draw from any input or result: bags, sequence files, JSON and results of `reconstruct`.

Skeletons in a bag or a result are drawn as they are. Any other input is reconstructed, each of its people as a
whole sequence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, format_value, load_yaml
from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import (
    Detections,
    Video,
    arrange_people,
    associate_people,
    select_person,
)
from mocap_ros.formats.npz_arrays import ArrayReader, read_arrays
from mocap_ros.formats.result_file import load_result_file
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.formats.text_files import read_text
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import SequenceResult, reconstruct_sequence
from mocap_ros.people import MotionKind
from mocap_ros.runtime.bag_scene import ProgressWrapper, load_bag_scene
from mocap_ros.runtime.detection import ShowProgress
from mocap_ros.runtime.input_kind import KEYPOINT_FORMATS, KEYPOINT_KINDS, InputKind, require_kind
from mocap_ros.runtime.load_keypoints import give_focal_length, load_detections, load_input
from mocap_ros.runtime.load_results import holds_result
from mocap_ros.runtime.scene_rows import recover_intrinsics
from mocap_ros.skeleton import CMU15, Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Mark, MarkKind, Scene, SceneKeypoints, ScenePerson

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

MIN_PERSON_FRAMES = 10  # frames; whoever is seen in fewer is left out, unless nobody is seen in more
MAX_PEOPLE = 16  # people who are reconstructed; those who are seen most, since each one takes seconds
VIEWED_FORMATS = f'{KEYPOINT_FORMATS}, or a result (.npz, .mcap)'
VIEWED_KINDS = (*KEYPOINT_KINDS, InputKind.RESULT)
MAX_STAMP_NS = 2**63 - 1  # ns; stamps are int64
STAMP_TOLERANCE_S = 1e-3  # s; times that are written in s since the epoch are exact to 1e-6 s
MAX_KEYFRAMES_BYTES = 16 << 20  # bytes; guards against parsing a huge file as keyframes
RESULT_CAMERA_KEYS = 'scale', 'translation'  # of a result file: (F,) px/m and (F, 2) px
VERTICAL_KEY = 'vertical'  # of a result file: (F, 3), as `SequenceResult` has it
SCALE_KNOWN_KEY = 'scale_known'  # of a result file: False where the focal length was nominal


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
    """

    config: Config
    models: Mapping[str, BasePoses]
    video: Video = field(default_factory=Video)
    person: str | None = None
    topic: str | None = None
    camera_info: str | None = None
    show_detection: ShowProgress = lambda images, _: images


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
    is_result = kind in (InputKind.RESULT, InputKind.BAG) and holds_result(path)
    if is_result and options.video != Video():
        raise InputError(
            f'{path}: holds a result, which is shown as it is; --fps, --image-size, --hfov, --focal and --layout '
            'apply to keypoints only'
        )
    if kind is InputKind.RESULT:
        return _load_result_scene(path, options), []
    if is_result:
        topics = options.topic, options.camera_info
        return load_bag_scene(path, options.config.node, options.person, *topics, progress)
    try:
        if kind is InputKind.SEQUENCE:
            sequence, lines = load_input(
                path, options.video, options.config.node, options.person, options.topic, options.camera_info
            )
            return _reconstruct_sequences(path.name, [sequence], options, progress), lines
        detections = load_detections(
            path,
            kind,
            options.video,
            options.config.node,
            options.topic,
            options.camera_info,
            options.show_detection,
        )
        sequences, lines = _select_people(detections, options.person)
        sequences, lens_lines = give_focal_length(sequences, options.video)
        lines += lens_lines
        scene = _reconstruct_sequences(path.name, sequences, options, progress, lines)
    except (InputError, SkeletonError, np.linalg.LinAlgError) as error:
        prefix = '' if str(error).startswith(str(path)) else f'{path}: '
        raise InputError(f'{prefix}{error}') from None
    return scene, [f'{path}: {line}' for line in lines]


def _select_people(detections: Detections, person: str | None) -> tuple[list[KeypointSequence], list[str]]:
    """Return the keypoints of every person who is seen long enough, or of one, and lines about the others."""
    if person is not None:
        sequence, lines = select_person(detections, person)
        return [sequence], lines
    tracks = sorted(associate_people(detections), key=lambda track: -len(track.detection_by_frame))
    if not tracks:
        raise InputError('nobody is seen in any frame')
    chosen = [t for t in tracks if len(t.detection_by_frame) >= MIN_PERSON_FRAMES][:MAX_PEOPLE] or tracks[:1]
    sequences, remarks = arrange_people(detections, chosen)
    lines = list(remarks)
    if len(chosen) < len(tracks):
        lines.append(
            f'{len(tracks) - len(chosen)} more people are not shown, who are seen less or in fewer than '
            f'{MIN_PERSON_FRAMES} frames'
        )
    return sequences, lines


def _reconstruct_sequences(
    title: str,
    sequences: Sequence[KeypointSequence],
    options: SceneOptions,
    progress: ProgressWrapper,
    lines: list[str] | None = None,
) -> Scene:
    """Return the scene of some people's keypoints and their reconstructions.

    Args:
        title: title of the scene.
        sequences: the people's keypoints.
        options: options of the scene.
        progress: shows the progress.
        lines: gets a line for each person who cannot be reconstructed and is left out; None raises instead.

    Raises:
        InputError: nobody can be reconstructed.
    """
    config = options.config
    stamps = sorted({stamp for sequence in sequences for stamp in sequence.stamps_ns})
    frame_of = {stamp: frame for frame, stamp in enumerate(stamps)}
    intrinsics = sequences[0].intrinsics(config.tracker.nominal_focal_length)
    people: list[ScenePerson] = []
    keypoints, verticals = [], []
    skeleton = CMU15
    for index, sequence in enumerate(progress(sequences, len(sequences))):
        frames = np.array([frame_of[stamp] for stamp in sequence.stamps_ns])
        observations = extract_observations(sequence, config.tracker.nominal_focal_length)
        person_id = sequence.person_id or f'person_{index + 1}'
        try:
            result = reconstruct_sequence(*observations, options.models, config)
        except InputError as error:
            if lines is None or (not people and index == len(sequences) - 1):
                raise
            lines.append(f'person {person_id!r} left out: {error}')
            continue
        skeleton = result.skeleton
        verticals.append(result.vertical)
        people.append(_make_person(person_id, frames, result, intrinsics))
        is_seen = (sequence.keypoints[..., 2] > 0).any(axis=1)
        keypoints.append(
            SceneKeypoints(
                skeleton=skeleton_from_joints(sequence.joint_names),
                frames=frames[is_seen],
                points=_hide_unseen(sequence.keypoints[is_seen]),
            )
        )
    truth = sequences[0].truth if len(sequences) == 1 else None
    return Scene(
        title=title,
        stamps_ns=stamps,
        people=tuple(people),
        keypoints=tuple(_merge_keypoints(keypoints)),
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
    return np.stack(
        [joints[:, names.index(name)] if name in names else unknown for name in skeleton.joints], axis=1
    ).astype(np.float32)


def _hide_unseen(keypoints: Array) -> Array32:
    """Return the image points (N, J, 2) of keypoints (N, J, 3), NaN where the score is 0."""
    return np.where(keypoints[..., 2:] > 0, keypoints[..., :2], np.nan).astype(np.float32)


def _merge_keypoints(keypoints: Sequence[SceneKeypoints]) -> list[SceneKeypoints]:
    """Return one entry a layout, in the order of the frames."""
    merged = []
    for skeleton in dict.fromkeys(k.skeleton for k in keypoints):
        alike = [k for k in keypoints if k.skeleton.joints == skeleton.joints]
        frames = np.concatenate([k.frames for k in alike])
        order = np.argsort(frames, kind='stable')
        points = np.concatenate([k.points for k in alike])[order]
        merged.append(SceneKeypoints(skeleton, frames[order], points))
    return merged


def _make_person(
    person_id: str, frames: NDArray[np.intp], result: SequenceResult, intrinsics: Intrinsics
) -> ScenePerson:
    """Return a person who was reconstructed over the given frames."""
    has_skeleton = np.isfinite(result.joints).all(axis=(1, 2))
    joints, seen = result.joints[has_skeleton], result.seen[has_skeleton]
    return _make_plain_person(
        person_id, frames[has_skeleton], joints, seen, result.solution.residual[has_skeleton], intrinsics
    )


def _make_plain_person(
    person_id: str,
    frames: NDArray[np.intp],
    joints: Array,
    seen: NDArray[np.bool_],
    residual: Array,
    intrinsics: Intrinsics,
) -> ScenePerson:
    """Return a person of whom only joints (N, J, 3) in m, seen joints (N, J) and residuals (N,) are known."""
    count = len(frames)
    return ScenePerson(
        id=person_id,
        frames=frames,
        joints=joints.astype(np.float32),
        std=np.full(joints.shape[:2], np.nan, np.float32),
        inferred=~seen,
        intrinsics=intrinsics,
        residual=residual.astype(np.float32),
        cadence=np.full(count, np.nan, np.float32),
        motion=np.full(count, MotionKind.UNKNOWN, np.uint8),
        predicted=np.asarray(~seen.any(axis=1)),
        tentative=np.zeros(count, bool),
    )


def load_keyframe_marks(path: Path) -> tuple[list[Mark], int | None]:
    """Load the times of keyframes from the file that `mocap-ros keyframes` writes.

    Returns:
        Marks, whose times in s count from the first frame of the person, and the stamp of that frame in ns; None
        where the file does not tell it, as files of version 0.1.

    Raises:
        InputError: the file cannot be read or holds something else; the error names the place.
    """
    content = load_yaml(read_text(path, max_bytes=MAX_KEYFRAMES_BYTES), str(path))
    entries = content.get('keyframes') if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise InputError(f'{path}: no list of keyframes, as `mocap-ros keyframes` writes it')
    marks = []
    for number, entry in enumerate(entries, 1):
        time = entry.get('time') if isinstance(entry, dict) else None
        if isinstance(time, bool) or not isinstance(time, (int, float)) or not 0 <= time < np.inf:
            raise InputError(f'{path}: keyframe {number}: time: {time!r}, expected s from the beginning')
        marks.append(Mark(float(time), MarkKind.KEYFRAME, f'{entry.get("half", "whole")} body'))
    start_ns = content.get('start_ns')
    if start_ns is None:
        return marks, None
    if isinstance(start_ns, bool) or not isinstance(start_ns, int) or not 0 <= start_ns <= MAX_STAMP_NS:
        raise InputError(f'{path}: start_ns: {format_value(start_ns)}, expected a whole number of ns')
    return marks, start_ns


def place_marks(marks: Sequence[Mark], start_ns: int, stamps_ns: Sequence[int]) -> list[Mark]:
    """Return marks with times from the beginning of a scene, without those that are not within the scene.

    Args:
        marks: marks, whose times in s count from a stamp.
        start_ns: the stamp in ns.
        stamps_ns: (F,) stamps of the frames of the scene in ns.

    Raises:
        InputError: no mark is within the scene.
    """
    duration_s = (stamps_ns[-1] - stamps_ns[0]) / NS_PER_S
    shift_s = (start_ns - stamps_ns[0]) / NS_PER_S
    shifted = [replace(mark, time_s=mark.time_s + shift_s) for mark in marks]
    within = [
        replace(mark, time_s=min(max(mark.time_s, 0.0), duration_s))
        for mark in shifted
        if -STAMP_TOLERANCE_S <= mark.time_s <= duration_s + STAMP_TOLERANCE_S
    ]
    if marks and not within:
        raise InputError(
            f'start_ns: no keyframe is within the recording, which begins at {stamps_ns[0]} ns and ends after '
            f'{duration_s:.1f} s; the keyframes are those of another recording'
        )
    return within


def _load_result_scene(path: Path, options: SceneOptions) -> Scene:
    """Load the scene of a result file, whose cameras tell focal length and principal point."""
    if options.person is not None:
        raise InputError(f'{path}: --person does not apply to a result of reconstruct')
    result = load_result_file(path)
    has_skeleton = np.isfinite(result.joints).all(axis=(1, 2))
    if not has_skeleton.any():
        raise InputError(f'{path}: no frame has a skeleton')
    keys = (*RESULT_CAMERA_KEYS, VERTICAL_KEY, SCALE_KNOWN_KEY)
    arrays = ArrayReader(read_arrays(path, keys, 'a result of reconstruct'))
    try:
        scale = arrays.read_numbers('scale', (len(result.times),))[has_skeleton]
        translation = arrays.read_numbers('translation', (len(result.times), 2))[has_skeleton]
        vertical = np.full(3, np.nan)
        if VERTICAL_KEY in arrays:  # version 0.1 wrote none
            vertical = average_vertical(arrays.read_numbers(VERTICAL_KEY, (len(result.times), 3)))
        is_focal_known = SCALE_KNOWN_KEY not in arrays or bool(arrays.read_flags(SCALE_KNOWN_KEY, ()))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    joints = result.joints[has_skeleton]
    core = [result.skeleton.index(joint) for joint in CMU15.joints]
    intrinsics, image_size = recover_intrinsics(joints[:, core].mean(axis=1), scale, translation)
    intrinsics = replace(intrinsics, is_focal_known=is_focal_known)
    frames = np.flatnonzero(has_skeleton)
    person = _make_plain_person(
        'person_1', frames, joints, result.seen[has_skeleton], result.residual[has_skeleton], intrinsics
    )
    return Scene(
        title=path.name,
        stamps_ns=result.stamps_ns,
        people=(person,),
        keypoints=(),
        image_size=image_size,
        intrinsics=intrinsics,
        skeleton=result.skeleton,
        vertical=vertical,
    )
