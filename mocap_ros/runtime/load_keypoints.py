# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load the keypoint sequence of one person from any supported file, folder or bag."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.topics import Source, find_people_topics, find_people_type
from mocap_ros.config import NodeConfig
from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.formats.detections import (
    Detections,
    Video,
    arrange_people,
    associate_people,
    select_person,
)
from mocap_ros.formats.detector_json import load_coco, load_openpose
from mocap_ros.formats.sequence_file import KeypointSequence, load_sequence
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.keypoints.validation import describe_points_outside, describe_transposed_size
from mocap_ros.messages.camera_info import CameraInfo, check_image_size, decode_camera_info
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.runtime.detection import ShowProgress, detect_in_video
from mocap_ros.runtime.frame_assembly import MISSING_STAMP, FrameAssembler, is_stamp_missing
from mocap_ros.runtime.input_doubts import describe_unusable_distortion
from mocap_ros.runtime.input_kind import KEYPOINT_FORMATS, KEYPOINT_KINDS, InputKind, require_kind

Array = NDArray[np.float64]

MIN_FRAMES = 10  # frames; of all people, those who are seen in less are mostly errors of the detector


def load_input(
    path: Path,
    video: Video,
    limits: NodeConfig,
    person: str | None = None,
    topic: str | None = None,
    camera_info: str | None = None,
    show_progress: ShowProgress = lambda images, _: images,
) -> tuple[KeypointSequence, list[str]]:
    """Load one person from a sequence file, a bag, OpenPose files, a JSON file of COCO keypoints or a video.

    Args:
        path: The file or folder.
        video: Frame rate, image size and keypoint layout, which JSON files do not state; the detector of a video.
        limits: Limits on people, joints and text in a message of a bag, and the image size of a bag without one.
        person: Id of the person; by default the person who is seen in most frames.
        topic: Topic of the keypoints; needed only for a bag with several.
        camera_info: Topic of the CameraInfo; by default the one that shares most of the keypoints' namespace.
        show_progress: Function that shows the progress of a detector on a video.

    Returns:
        The sequence, and lines to print about the chosen person, skipped messages and assumptions.

    Raises:
        InputError: The file has none of these formats or is damaged; the error names the place.
    """
    kind = require_kind(path, KEYPOINT_KINDS, KEYPOINT_FORMATS)
    if kind is InputKind.SEQUENCE:
        if person or topic or camera_info or not video.fits_any_input:
            raise InputError(
                f'{path}: --person, --topic, --camera-info, --fps, --image-size, --layout and --detector do not '
                'apply to a sequence file'
            )
        sequence = load_sequence(path)
        lines: list[str] = []
    else:
        detections = load_detections(path, kind, video, limits, topic, camera_info, show_progress)
        try:
            sequence, lines = select_person(detections, person)
            _check_image_size(sequence, video.image_size)
        except InputError as error:
            raise InputError(f'{path}: {error}') from None
    outside = describe_points_outside(*_split_keypoints(sequence), sequence.image_size)
    lines += [f'image size: {outside}'] if outside else []
    try:
        (sequence,), lens_lines = give_focal_length([sequence], video)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    lines += [*lens_lines, *_describe_lens(sequence)]
    return sequence, [f'{path}: {line}' for line in lines]


def load_people(
    path: Path,
    video: Video,
    limits: NodeConfig,
    topic: str | None = None,
    camera_info: str | None = None,
    show_progress: ShowProgress = lambda images, _: images,
) -> tuple[list[KeypointSequence], list[str]]:
    """Load all people from a file that may hold several.

    The arguments are those of `load_input`.

    Returns:
        The sequence of each person who is seen in `MIN_FRAMES` or more, in the order in which they are seen first,
        and lines to print.

    Raises:
        InputError: The file is of another format or damaged, or nobody is seen for so long.
    """
    kind = require_kind(path, KEYPOINT_KINDS, KEYPOINT_FORMATS)
    if kind is InputKind.SEQUENCE:
        raise InputError(f'{path}: a sequence file holds one person; --all-people does not apply')
    detections = load_detections(path, kind, video, limits, topic, camera_info, show_progress)
    tracks = associate_people(detections)
    long_tracks = [track for track in tracks if len(track.detection_by_frame) >= MIN_FRAMES]
    try:
        if not long_tracks:
            raise InputError(f'nobody is seen in {MIN_FRAMES} frames or more')
        sequences, remarks = arrange_people(detections, long_tracks)
        for sequence in sequences:
            _check_image_size(sequence, video.image_size)
        sequences, lens_lines = give_focal_length(sequences, video)
        remarks = (*remarks, *lens_lines, *_describe_lens(sequences[0]))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    left_out = len(tracks) - len(long_tracks)
    lines = [f'{left_out} people are left out, who are seen in less than {MIN_FRAMES} frames'] if left_out else []
    return sequences, [f'{path}: {line}' for line in (*remarks, *lines)]


def load_detections(
    path: Path,
    kind: InputKind,
    video: Video,
    limits: NodeConfig,
    topic: str | None = None,
    camera_info: str | None = None,
    show_progress: ShowProgress = lambda images, _: images,
) -> Detections:
    """Load all people from an input of a kind that may hold several; see `load_input`."""
    if video.detector and kind is not InputKind.VIDEO:
        raise InputError(f'{path}: --detector applies to a video only')
    if kind is InputKind.BAG:
        return load_bag(path, limits, topic, camera_info)
    if kind is InputKind.VIDEO:
        if topic or camera_info or not replace(video, detector=None).fits_any_input:
            raise InputError(
                f'{path}: --topic, --camera-info, --fps, --image-size and --layout do not apply to a video'
            )
        return detect_in_video(path, video.detector, show_progress=show_progress)
    detections = load_openpose(path, video) if kind is InputKind.OPENPOSE else load_coco(path, video)
    if not all(detections.image_size) and (video.hfov or video.focal):
        raise InputError(f'{path}: --hfov and --focal need --image-size, as the input does not state it')
    return detections


def give_focal_length(sequences: list[KeypointSequence], video: Video) -> tuple[list[KeypointSequence], list[str]]:
    """Return the sequences of a camera with the focal length of `video` or, if they have another, with a line.

    The principal point is then in the middle of the image, and the lens has no distortion.

    Raises:
        InputError: the focal length of `video` is none in px.
    """
    width, height = sequences[0].image_size
    focal = video.find_focal_length(width)
    if focal is None:
        return sequences, []
    if sequences[0].is_camera_known:
        return sequences, ['has a calibrated camera; --hfov and --focal are not used']
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return [replace(sequence, camera_matrix=matrix) for sequence in sequences], []


def _split_keypoints(sequence: KeypointSequence) -> tuple[Array, Array]:
    """Return the image points (F, J, 2) in px and the scores (F, J) of a sequence."""
    return sequence.keypoints[..., :2], sequence.keypoints[..., 2]


def _describe_lens(sequence: KeypointSequence) -> list[str]:
    """Return a line about the lens of the camera, if its distortion cannot be used."""
    # Any focal length will do, because only cameras that are known have a distortion.
    return list(filter(None, [describe_unusable_distortion(sequence.intrinsics(1.0))]))


def _check_image_size(sequence: KeypointSequence, option: tuple[int, int] | None) -> None:
    """Refuse the size of an image whose width and height are exchanged.

    Args:
        sequence: The keypoints and the size of their image.
        option: Value of `--image-size`, (width, height) in px, or None.

    Raises:
        InputError: The size looks transposed; the error names the option or `image size`.
    """
    fault = describe_transposed_size(*_split_keypoints(sequence), sequence.image_size)
    if fault:
        name = '--image-size' if sequence.image_size == option else 'image size'
        raise InputError(f'{name}: {fault}')


def load_sequence_file(path: str | Path) -> KeypointSequence:
    """Load a sequence file; refuse anything else with an error that says what it is and what was expected.

    Raises:
        InputError: The path is something else, or not a valid sequence file; the error names the place.
    """
    require_kind(Path(path), [InputKind.SEQUENCE], 'a sequence file (.npz)')
    return load_sequence(path)


def load_bag(
    path: Path, limits: NodeConfig, topic: str | None = None, camera_info: str | None = None
) -> Detections:
    """Load all people from the keypoint messages of a bag; skip and count the messages that cannot be used.

    The accepted messages are those that `replay` accepts, with these differences: the stamps may come in any
    order, the first CameraInfo applies to the whole bag, all images have the size that most of them state, only
    images of the camera (`frame_id`) of the first image count, and images that the recorded run skipped count too.

    Args:
        path: The bag.
        limits: Limits on people, joints and text in a message, and the image size if nothing else states it.
        topic: Topic of the keypoints; needed only for a bag with several.
        camera_info: Topic of the CameraInfo; by default the one that shares most of the keypoints' namespace.

    Raises:
        InputError: The path is no bag, or the bag has no keypoints that can be used; the error names the first
            reason.
    """
    with Bag(path) as bag:
        topics = find_people_topics(bag, topic)
        node = replace(limits, input_type=find_people_type(bag, topics))
        camera, camera_remark = find_camera(bag, next(iter(topics)), node, camera_info)
        camera_size, configured = camera.size if camera else None, (node.image_width, node.image_height)
        size = resolve_image_size(camera=camera_size, configured=configured)
        frames, skipped_count, first_reason = _decode_frames(bag, topics, node, camera, size)
    if not frames:
        raise InputError(f'{path}: {first_reason or "no keypoints"}')
    if (other_count := _leave_out_other_sizes(frames)) > 0:
        skipped_count += other_count
        first_reason = (
            first_reason or f'{next(iter(topics))}: {other_count} images have another size than the others'
        )
    skipped = f'{skipped_count} messages left out; {first_reason}' if skipped_count else ''
    stamps = sorted(frames)
    last = frames[stamps[-1]]
    stated = (last.image_width, last.image_height)
    return Detections(
        people=[frames[s].people for s in stamps],
        stamps_ns=stamps,
        image_size=resolve_image_size(stated=stated, camera=camera_size, configured=configured),
        intrinsics=camera.intrinsics if camera else None,
        frame_id=next((f.header.frame_id for f in frames.values() if f.header.frame_id), ''),
        remarks=tuple(filter(None, (skipped, camera_remark))),
    )


def _leave_out_other_sizes(frames: dict[int, KeypointsFrame]) -> int:
    """Remove the images that state another size in px than most of them, and return their number."""
    size_by_stamp = {
        s: (f.image_width, f.image_height) for s, f in frames.items() if f.image_width and f.image_height
    }
    if not size_by_stamp:
        return 0
    ((usual_size, _),) = Counter(size_by_stamp.values()).most_common(1)
    others = [stamp for stamp, size in size_by_stamp.items() if size != usual_size]
    for stamp in others:
        del frames[stamp]
    return len(others)


def _decode_frames(
    bag: Bag, topics: dict[str, Source], node: NodeConfig, camera: CameraInfo | None, size: tuple[int, int]
) -> tuple[dict[int, KeypointsFrame], int, str]:
    """Decode the images of a bag.

    Returns:
        The images by stamp, ns; the number of skipped messages; and why the first of these was skipped.
    """
    frames: dict[int, KeypointsFrame] = {}
    assembler = FrameAssembler()
    skipped_count, first_reason, camera_name = 0, '', ''

    def add_message(message: BagMessage) -> str:
        """Add the images that a message completes; return why the message cannot be used, or an empty string."""
        nonlocal camera_name
        try:
            for frame in assembler.assemble(topics[message.topic], message.raw, message.topic, node, size, inf):
                camera_name = camera_name or frame.header.frame_id
                _check_camera(frame, camera, camera_name)
                stamp_ns = frame.header.stamp_ns
                if frames.setdefault(stamp_ns, frame) is not frame:
                    return 'its stamp is that of an earlier message' if stamp_ns else MISSING_STAMP
        except (InputError, FrameDropped) as error:
            return str(error)
        return ''

    for number, message in enumerate(bag.messages(topics), 1):
        if reason := add_message(message):
            skipped_count += 1
            first_reason = first_reason or f'{message.topic}: message {number}: {reason}'
    for frame in assembler.flush(size):
        frames.setdefault(frame.header.stamp_ns, frame)
    if frames and is_stamp_missing(min(frames), max(frames)):
        del frames[0]
        skipped_count += 1
        first_reason = first_reason or f'{next(iter(topics))}: {MISSING_STAMP}'
    return frames, skipped_count, first_reason


def _check_camera(frame: KeypointsFrame, camera: CameraInfo | None, name: str) -> None:
    """Refuse an image of another camera than `name`, or of another size than that of the CameraInfo.

    Raises:
        InputError: It is one.
    """
    if frame.header.frame_id not in ('', name):
        raise InputError(f'header.frame_id: {frame.header.frame_id!r}, but the images before are of {name!r}')
    if camera is not None:
        check_image_size(frame, camera)


def find_camera(
    bag: Bag, keypoints_topic: str, node: NodeConfig, camera_info: str | None = None
) -> tuple[CameraInfo | None, str]:
    """Find the first usable CameraInfo that belongs to a topic of keypoints.

    Args:
        bag: The bag.
        keypoints_topic: Topic of the keypoints.
        node: How the keypoints were found in the image.
        camera_info: Topic of the CameraInfo; by default the one that shares most of the keypoints' namespace.

    Returns:
        The CameraInfo, or None if there is none, and a remark on the first that cannot be used, or an empty text.

    Raises:
        InputError: There is no such topic, or several topics share equally much of the namespace.
    """
    topic = bag.find_camera_info_topic(keypoints_topic, camera_info)
    reason = ''
    for number, message in enumerate(bag.messages([topic] if topic else []), 1):
        try:
            return decode_camera_info(message.raw, rectified=node.rectified_input), reason
        except InputError as error:  # noqa: PERF203
            reason = reason or f'{topic}: message {number} cannot be used: {error}'
    return None, reason
