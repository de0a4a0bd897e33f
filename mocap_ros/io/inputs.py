"""Whatever holds keypoints, as the sequence of one person."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.io.bags import Bag, is_bag
from mocap_ros.io.coco_json import load_coco
from mocap_ros.io.detections import Detections, Video, sequence_of
from mocap_ros.io.messages import decode_camera_info, decode_keypoints
from mocap_ros.io.openpose_json import load_openpose
from mocap_ros.io.sequence import Sequence, load_sequence
from mocap_ros.people import Intrinsics, Person2D


def load_input(
    path: Path,
    video: Video,
    limits: NodeConfig,
    person: str | None = None,
    topic: str | None = None,
) -> tuple[Sequence, list[str]]:
    """A sequence file, a bag, a folder of OpenPose or a JSON file of COCO keypoints.

    Args:
        path: of the file or folder.
        video: what JSON does not say.
        limits: most people, joints and text in a message of a bag; the size of the image where it has none.
        person: id of the person; the one seen most by default.
        topic: of the keypoints, where a bag has several.

    Returns:
        The sequence, and lines to print: who was chosen, what was left out or assumed.

    Raises:
        InputError: none of these, or broken; names the place.
    """
    if is_bag(path):
        detections = load_bag(path, limits, topic)
    elif path.is_dir():
        detections = load_openpose(path, video)
    elif path.suffix == '.json':
        detections = load_coco(path, video)
    else:
        if person or topic or video != Video():
            raise InputError(
                f'{path}: a sequence file; --person, --topic, --fps, --image-size, --layout are for others'
            )
        return load_sequence(path), []
    try:
        sequence, lines = sequence_of(detections, person)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    return sequence, [f'{path}: {line}' for line in lines]


def load_bag(path: Path, limits: NodeConfig, topic: str | None = None) -> Detections:
    """Everyone in the keypoint messages of a bag; messages that cannot be used are left out and counted.

    Raises:
        InputError: no bag, no keypoints in it, or none that can be used; names the first reason.
    """
    frames: dict[int, tuple[Person2D, ...]] = {}
    size = limits.image_width, limits.image_height
    frame_id, first_reason, unusable = '', '', 0
    with Bag(path) as bag:
        wanted = bag.keypoints_topic(topic)
        for number, message in enumerate(bag.messages([wanted]), 1):
            try:
                frame = decode_keypoints(message.raw, limits)
                if frame.header.stamp_ns in frames:
                    raise InputError('its stamp is that of an earlier message')
            except InputError as error:
                unusable += 1
                first_reason = first_reason or f'{wanted}: message {number}: {error}'
                continue
            frames[frame.header.stamp_ns] = frame.people
            frame_id = frame_id or frame.header.frame_id
            if frame.image_width and frame.image_height:
                size = frame.image_width, frame.image_height
        intrinsics, camera_size = _camera(bag, wanted)
    if not frames:
        raise InputError(f'{path}: {first_reason or "no keypoints"}')
    stamps = sorted(frames)
    known = size if all(size) else camera_size
    remarks = (f'{unusable} messages left out; {first_reason}',) if unusable else ()
    return Detections([frames[s] for s in stamps], stamps, known, intrinsics, frame_id, remarks)


def _camera(bag: Bag, keypoints: str) -> tuple[Intrinsics | None, tuple[int, int] | None]:
    """Of the first CameraInfo that goes with these keypoints; None where there is none, or it says nothing."""
    topic = bag.camera_info_topic(keypoints)
    for message in bag.messages([topic] if topic else []):
        try:
            info = decode_camera_info(message.raw)
        except InputError:
            continue
        return info.intrinsics, (info.width, info.height) if info.width and info.height else None
    return None, None
