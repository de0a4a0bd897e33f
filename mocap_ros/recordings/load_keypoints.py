# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load the keypoint sequences of one person, or of all, from any supported file, folder or bag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from math import inf
from pathlib import Path

import numpy as np

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import InputTopics, Source, find_inputs
from mocap_ros.config import NodeConfig, TrackerConfig
from mocap_ros.errors import FrameDropped, InputError, naming
from mocap_ros.findings import Fault
from mocap_ros.formats.detections import (
    Detections,
    arrange_people,
    associate_people,
    select_person,
)
from mocap_ros.formats.detector_json import load_json_file, load_json_folder
from mocap_ros.formats.reading_options import ReadingOptions, find_focal_length
from mocap_ros.formats.sequence_file import find_longest_gap, load_sequence
from mocap_ros.formats.tables import load_tables
from mocap_ros.formats.video import read_video_facts
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.keypoints.validation import check_places, describe_rate
from mocap_ros.messages.camera_info import (
    CameraInfo,
    check_image_size,
    decode_camera_info,
    describe_other_camera,
    may_be_one_camera,
)
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.offline.whole_sequence import MAX_GAP_S
from mocap_ros.recordings.detect_people import detect_in_video
from mocap_ros.recordings.input_kind import (
    KEYPOINT_FORMATS,
    KEYPOINT_KINDS,
    InputKind,
    check_options,
    require_kind,
)
from mocap_ros.runtime.frame_assembly import MISSING_STAMP, FrameAssembler, is_stamp_missing
from mocap_ros.runtime.input_camera import FROM_VIDEO, GIVEN, find_turns
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.input_faults import find_misspelt_joint, find_unusable_distortion

RESTART_S = 1.0  # s; messages are at most so late, and an older one begins a new run of the clock
MIN_RUN_SHARE = 0.1  # 1; share of the images that the longest run of the clock must have
MAX_COMPARED = 10  # further messages that are compared with the CameraInfo in use; two cameras send in turn
MAX_CAMERA_INFOS = 1000  # messages in which a valid CameraInfo is searched
MIN_SHARE_SEEN = 0.9  # 1; share of a video at whose end mostly somebody is seen
MIN_FRAMES = 10  # frames; of all people, those who are seen in less are mostly errors of the detector
LOADERS = {
    InputKind.OPENPOSE: load_json_folder, InputKind.JSON: load_json_file, InputKind.TABLE: load_tables,
}  # fmt: skip


def load_input(path: Path, options: ReadingOptions) -> tuple[KeypointSequence, list[str]]:
    """Load one person from a sequence file, a bag, OpenPose files, a JSON file of COCO keypoints or a video.

    Returns the sequence, and lines to print about the chosen person, skipped messages and assumptions.
    """
    (sequence,), lines = load_people(path, options, only_one=True)
    return sequence, lines


def load_people(
    path: Path, options: ReadingOptions, *, only_one: bool = False
) -> tuple[list[KeypointSequence], list[str]]:
    """Load all people from a file that may hold several, or one as `load_input`, and return lines to print.

    They are those who are seen in `MIN_FRAMES` or more, in the order in which they are seen first.
    """
    kind, options = require_kind(path, KEYPOINT_KINDS, KEYPOINT_FORMATS), _add_lens(options)
    check_options(path, options._asdict(), kind)
    if options.video is not None:
        facts = read_video_facts(options.video)
        options = options._replace(facts=facts, image_size=options.image_size or facts.size)
    if kind is InputKind.SEQUENCE:
        if not only_one:
            raise InputError(f'{path}: a sequence file holds one person; --all-people does not apply')
        sequence = load_sequence(path)
        return _finish(path, kind, [sequence], options, sequence.notes)
    detections = _load_detections(path, kind, options)
    with naming(path):
        if only_one:
            sequence, lines = select_person(detections, options.person, options.tracker)
            sequences = [sequence]
        else:
            sequences, lines = _select_all(detections, options.tracker)
    return _finish(path, kind, sequences, options, lines)


def _select_all(detections: Detections, settings: TrackerConfig) -> tuple[list[KeypointSequence], list[str]]:
    tracks, ignored = associate_people(detections, settings)
    long_tracks = [track for track in tracks if len(track.detection_by_frame) >= MIN_FRAMES]
    if not long_tracks:
        raise InputError(f'no person is seen in {MIN_FRAMES} frames or more')
    sequences, notes = arrange_people(detections, long_tracks)
    left_out = len(tracks) - len(long_tracks)
    few = [f'{left_out} people are left out, who are seen in less than {MIN_FRAMES} frames'] if left_out else []
    return sequences, [*ignored, *notes, *few]


def _add_lens(options: ReadingOptions) -> ReadingOptions:
    node = options.node
    if options.hfov or options.focal:
        return options
    return options._replace(hfov=node.hfov or None, focal=node.focal or None)


def _finish(
    path: Path, kind: InputKind, sequences: list[KeypointSequence], options: ReadingOptions, lines: Iterable[str]
) -> tuple[list[KeypointSequence], list[str]]:
    """Return sequences of one camera with its focal length, and all lines to print, which name the input."""
    size, outside = sequences[0].image_size, ''
    stamps_ns = np.array(sequences[0].stamps_ns)
    with naming(path):
        if options.fps is None and (fault := describe_rate((stamps_ns - stamps_ns[0]) / NS_PER_S)):
            raise InputError(fault)
        with naming('--image-size' if size == options.image_size else 'image size'):
            for keypoints in (sequence.keypoints for sequence in sequences):
                outside = outside or check_places(keypoints[..., :2], keypoints[..., 2], size)
        if kind is InputKind.VIDEO and sequences[0].is_camera_known:
            sequences = [replace(s, focal_source=FROM_VIDEO) for s in sequences]
        is_known, source, share = sequences[0].is_camera_known, GIVEN, options.facts.focal_share
        focal = find_focal_length(size[0], options.hfov, options.focal)
        if focal is None and share is not None:
            focal, source = share * size[0], FROM_VIDEO
        if focal is not None and not is_known:  # the principal point is in the middle, and nothing is distorted
            matrix = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
            sequences = [replace(s, camera_matrix=matrix, focal_source=source) for s in sequences]
    unused = 'has a calibrated camera; --hfov and --focal are not used' if focal is not None and is_known else ''
    # Any focal length will do, because only cameras that are known have a distortion.
    lens = find_unusable_distortion(sequences[0].intrinsics(1.0)).words
    gaps = map(_describe_gap, sequences)
    misspelt = find_misspelt_joint(sequences[0].joint_names).words
    lines = (*lines, misspelt, outside and f'image size: {outside}', unused, lens, *gaps)
    return sequences, [f'{path}: {line}' for line in lines if line]


def _describe_gap(sequence: KeypointSequence) -> str:
    times = sequence.timestamps[(sequence.keypoints[..., 2] > 0).any(axis=1)]
    gap, start = find_longest_gap(times)
    if gap <= MAX_GAP_S:
        return ''
    count, frame = int((np.diff(times) > MAX_GAP_S).sum()), int(np.searchsorted(sequence.timestamps, start))
    name = f'person {sequence.person_id!r}: ' if sequence.person_id else ''
    more = f'; {count - 1} shorter gaps of more than {MAX_GAP_S:g} s' if count > 1 else ''
    return (
        f'{name}a gap of {gap:.1f} s after frame {frame} (at {start - sequence.timestamps[0]:.2f} s): nothing was '
        f'seen for so long, or the clock was set{more}'
    )


def _load_detections(path: Path, kind: InputKind, options: ReadingOptions) -> Detections:
    if kind is InputKind.BAG:
        width, height = options.image_size or (options.node.image_width, options.node.image_height)
        node = replace(options.node, image_width=width, image_height=height)
        return load_bag(path, node, options.topic, options.camera_info)
    if kind is InputKind.VIDEO:
        found = detect_in_video(path, options.detector, show_progress=options.show_detection)
        return replace(found, intrinsics=None) if options.hfov or options.focal else found
    detections = _stretch(LOADERS[kind](path, options), options.facts.pixel_aspect)
    if not all(detections.image_size) and (options.hfov or options.focal):
        raise InputError(f'{path}: --hfov and --focal need --image-size, as the input does not state it')
    end_s, length_s = detections.stamps_ns[-1] / NS_PER_S, max(options.facts.times_s, default=0.0)
    if end_s < MIN_SHARE_SEEN * length_s:
        line = (
            f'the keypoints end after {end_s:.1f} s, and {options.video} after {length_s:.1f} s; is it that video?'
        )
        return replace(detections, notes=(*detections.notes, line))
    return detections


def _stretch(detections: Detections, pixel_aspect: float) -> Detections:
    """Return detections in the stored pixels of a video in those of its images as players show them."""
    if pixel_aspect == 1.0:
        return detections
    people = [[replace(p, points=p.points * [pixel_aspect, 1.0]) for p in image] for image in detections.people]
    width, height = detections.image_size
    return replace(detections, people=people, image_size=(round(width * pixel_aspect), height))


def load_sequence_file(path: str | Path) -> KeypointSequence:
    """Load a sequence file; refuse anything else with an error that says what it is and what was expected."""
    require_kind(Path(path), [InputKind.SEQUENCE], 'a sequence file (.npz)')
    return load_sequence(path)


def load_bag(
    path: Path, limits: NodeConfig, topic: str | None = None, camera_info: str | None = None
) -> Detections:
    """Load all people from the keypoint messages of a bag; topics are those of `ReadingOptions`.

    Messages that cannot be used are counted.

    The accepted messages are those that `replay` accepts, with these differences: messages may be late, and where
    the clock goes back, its longest run counts; the first CameraInfo applies to the whole bag; all images have the
    size that most of them state; only images of the camera (`frame_id`) of the first image count; and images that
    the recorded run skipped count too.
    """
    with Bag(path) as bag:
        inputs = find_inputs(bag, topic, camera_info)
        topics, node = inputs.people, replace(limits, input_type=inputs.keypoints_type)
        camera, camera_note = find_camera(bag, inputs, node)
        known = camera.size if camera else None
        size = resolve_image_size(camera=known, configured=(node.image_width, node.image_height))
        frames, reasons, images, clock_note = _assemble_frames(bag, topics, node, camera, size)
    if len(frames) < MIN_RUN_SHARE * images:
        raise InputError(f'{path}: {clock_note}; its stamps are of several clocks')
    if not frames or (set(frames) == {0} and reasons):
        raise InputError(f'{path}: {reasons[0] if reasons else "no keypoints"}')
    reasons += [f'{next(iter(topics))}: {reason}' for reason in _leave_out_others(frames)]
    if not any(frame.people for frame in frames.values()) and any(f.without_keypoints for f in frames.values()):
        raise InputError(f'{path}: {Fault.NO_KEYPOINTS.describe()}')
    stamps = sorted(frames)
    last = frames[stamps[-1]]
    skipped = f'{len(reasons)} messages left out; {reasons[0]}' if reasons else ''
    return Detections(
        people=[frames[s].people for s in stamps],
        stamps_ns=stamps,
        image_size=resolve_image_size(stated=(last.image_width, last.image_height), configured=size),
        intrinsics=camera.intrinsics if camera and camera.intrinsics.is_focal_known else None,
        frame_id=next((f.header.frame_id for f in frames.values() if f.header.frame_id), ''),
        notes=tuple(filter(None, (skipped, clock_note, camera_note))),
    )


def _assemble_frames(
    bag: Bag, topics: Mapping[str, Source], node: NodeConfig, camera: CameraInfo | None, size: tuple[int, int]
) -> tuple[dict[int, KeypointsFrame], list[str], int, str]:
    """Return the images of a bag by stamp in ns, why each other message is left out, and a note on the clock.

    A stamp that goes back by more than `RESTART_S` begins a run of the clock. The longest is returned, and the
    number of images of all.
    """
    assembler, reasons, name, jump, newest_ns = FrameAssembler(), [], '', '', 0
    runs: list[dict[int, KeypointsFrame]] = [{}]
    for number, message in enumerate(bag.messages(topics), 1):
        place, source = f'{message.topic}: message {number}', topics[message.topic]
        try:
            for frame in assembler.assemble(source, message.raw, message.topic, node, size, inf):
                frame_id, stamp_ns = frame.header.frame_id, frame.header.stamp_ns
                name = name or frame_id
                if frame_id not in ('', name):
                    raise InputError(f'header.frame_id: {frame_id!r}, but the images before are of {name!r}')
                if camera is not None:
                    check_image_size(frame, camera)
                back_s = (newest_ns - stamp_ns) / NS_PER_S
                if back_s > RESTART_S and not is_stamp_missing(stamp_ns, newest_ns):
                    jump = jump or f'{place}: the stamp goes back by {back_s:.1f} s'
                    runs.append({})
                    newest_ns = 0
                newest_ns = max(newest_ns, stamp_ns)
                if runs[-1].setdefault(stamp_ns, frame) is not frame:
                    raise FrameDropped('its stamp is that of an earlier message' if stamp_ns else MISSING_STAMP)
        except (InputError, FrameDropped) as error:
            reasons.append(f'{place}: {error}')
    for frame in assembler.flush():
        runs[-1].setdefault(frame.header.stamp_ns, frame)
    longest = max(runs, key=len)
    used = f'of {len(runs)} runs of the clock the longest, of {len(longest)} images, is used'
    return longest, reasons, sum(map(len, runs)), f'{jump}; {used}' if jump else ''


def _leave_out_others(frames: dict[int, KeypointsFrame]) -> list[str]:
    """Remove images without a stamp, and those of another size in px than most; return why, for each of them."""
    reasons = []
    if is_stamp_missing(min(frames), max(frames)):
        del frames[0]
        reasons.append(MISSING_STAMP)
    sizes = {s: (f.image_width, f.image_height) for s, f in frames.items() if f.image_width and f.image_height}
    usual = Counter(sizes.values()).most_common(1)
    others = [stamp for stamp, size in sizes.items() if size != usual[0][0]]
    for stamp in others:
        del frames[stamp]
    return reasons + [f'{len(others)} images have another size than the others'] * len(others)


def find_camera(bag: Bag, inputs: InputTopics, node: NodeConfig) -> tuple[CameraInfo | None, str]:
    """Find the first valid CameraInfo of the camera of the keypoints.

    Returns the CameraInfo, else the first of which more than the others can be used, or None if there is none; and
    why it is not the first, or what of it is not used, or an empty text.
    """
    topic, first = inputs.camera_info, next(iter(inputs.people))
    frame_id = bag.find_frame_id(inputs.people)
    found: CameraInfo | None = None
    reason, other = '', ''
    messages = enumerate(islice(bag.messages([topic] if topic else []), MAX_CAMERA_INFOS), 1)
    for number, message in messages:
        try:
            camera = decode_camera_info(message.raw, rectified=node.rectified_input)
        except InputError as error:
            reason = reason or f'{topic}: message {number} cannot be used: {error}'
            continue
        if not may_be_one_camera(frame_id, camera.frame_id):
            other = other or f'{first}: {describe_other_camera(frame_id, camera, str(topic))}'
            continue
        if not camera.note:
            cameras = [camera]
            for _, following in islice(messages, MAX_COMPARED):
                with suppress(InputError):
                    cameras.append(decode_camera_info(following.raw, rectified=node.rectified_input))
            turns = find_turns(c for c in cameras if may_be_one_camera(frame_id, c.frame_id))
            reason = reason and f'{reason}; instead, message {number} is used'
            return camera, '; '.join(filter(None, (reason, turns and f'{topic}: {turns}')))
        if found is None or camera.intrinsics.is_focal_known > found.intrinsics.is_focal_known:
            found, reason = camera, f'{topic}: message {number}: {camera.note}'
    return found, reason if found else reason or other
