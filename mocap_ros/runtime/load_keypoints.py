"""Whatever holds keypoints, as the sequence of one person."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path

from mocap_ros.bags.reader import Bag, BagMessage, is_bag
from mocap_ros.bags.topics import people_topics, people_type
from mocap_ros.config import NodeConfig
from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.formats.coco_json import load_coco
from mocap_ros.formats.detections import Detections, Video, sequence_of
from mocap_ros.formats.openpose_json import load_openpose
from mocap_ros.formats.sequence_file import Sequence, load_sequence
from mocap_ros.messages.camera_info import CameraInfo, check_size, decode_camera_info, image_size
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.runtime.frame_assembly import PeopleReader


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
    """Everyone in the messages of people of a bag; messages that cannot be used are left out and counted.

    Everything that `replay` takes is taken, in the same way; but the order of stamps does not matter, and the
    first CameraInfo holds from the beginning.

    Args:
        path: of the bag.
        limits: most people, joints and text in a message; the size of the image where nothing else says it.
        topic: of the keypoints, where there are several.

    Raises:
        InputError: no bag, no keypoints in it, or none that can be used; names the first reason.
    """
    frames: dict[int, KeypointsFrame] = {}
    reader, first_reason, unusable = PeopleReader(), '', 0
    with Bag(path) as bag:
        topics = people_topics(bag, topic)
        node = replace(limits, input_type=people_type(bag, topics))
        camera = _camera(bag, next(iter(topics)), node)
        size = image_size(camera, node)

        def take(message: BagMessage) -> str:
            """Why the message cannot be used, or nothing."""
            try:
                for frame in reader.read(topics[message.topic], message.raw, message.topic, node, size, inf):
                    if camera is not None:
                        check_size(frame, camera)
                    if frames.setdefault(frame.header.stamp_ns, frame) is not frame:
                        return 'its stamp is that of an earlier message'
            except (InputError, FrameDropped) as error:
                return str(error)
            return ''

        for number, message in enumerate(bag.messages(topics), 1):
            if reason := take(message):
                unusable += 1
                first_reason = first_reason or f'{message.topic}: message {number}: {reason}'
        for frame in reader.rest(size):
            frames.setdefault(frame.header.stamp_ns, frame)
    if not frames:
        raise InputError(f'{path}: {first_reason or "no keypoints"}')
    stamps = sorted(frames)
    last = frames[stamps[-1]]
    said = last.image_width, last.image_height
    return Detections(
        people=[frames[s].people for s in stamps],
        stamps_ns=stamps,
        image_size=said if all(said) else size if all(size) else None,
        intrinsics=camera.intrinsics if camera else None,
        frame_id=next((f.header.frame_id for f in frames.values() if f.header.frame_id), ''),
        remarks=(f'{unusable} messages left out; {first_reason}',) if unusable else (),
    )


def _camera(bag: Bag, keypoints: str, node: NodeConfig) -> CameraInfo | None:
    """The first CameraInfo that goes with these keypoints and can be used; None where there is none."""
    topic = bag.camera_info_topic(keypoints)
    for message in bag.messages([topic] if topic else []):
        with suppress(InputError):
            return decode_camera_info(message.raw, rectified=node.rectified_input)
    return None
