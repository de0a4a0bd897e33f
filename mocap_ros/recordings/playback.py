# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Read recorded messages and the times at which they are to be published again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Qos

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import Source, find_inputs
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.recordings.load_keypoints import load_sequence_file

DEFAULT_FRAME_ID = 'camera'  # header.frame_id of sequences that do not name their camera
CAMERA_INFO_TOPIC = 'camera_info'  # the name on which the node subscribes to CameraInfo


class PlaybackMessage(NamedTuple):
    """A message as CDR, with the time in ns at which it is due, on the clock of the recording.

    `topic` is the index of its topic in `Playback.topics`.
    """

    due_ns: int
    raw: bytes
    topic: int


def encode_sequence(sequence: KeypointSequence) -> Iterator[PlaybackMessage]:
    """Encode every frame of a sequence as a Keypoints2DArray with the frame's stamp and `DEFAULT_FRAME_ID`."""
    for frame, stamp_ns in enumerate(sequence.stamps_ns):
        people = [sequence.person(frame)]
        raw = encode_keypoints(Header(stamp_ns, DEFAULT_FRAME_ID), sequence.image_size, people)
        yield PlaybackMessage(stamp_ns, raw, 0)


class PlayedTopic(NamedTuple):
    """A topic to publish, with the QoS profiles that the recorded publishers offered and its name in the bag."""

    name: str
    type: str
    qos: Sequence[Qos] = ()
    recorded: str = ''


class Playback:
    """The messages of a bag or a sequence file that are to be published; it can be iterated repeatedly.

    By default these are the keypoints, published on the topic `to`, and the CameraInfo that belongs to them, on
    `camera_info` beside it. A sequence file has one if it states its camera. The topics of ROS4HRI keep their
    recorded names, as do all topics of a bag with `everything`.
    """

    def __init__(
        self,
        path: Path,
        topic: str | None = None,
        to: str = 'keypoints',
        everything: bool = False,
        camera_info: str | None = None,
    ) -> None:
        self._path = path
        self._is_sequence = path.suffix == '.npz'
        beside = to[: to.rfind('/') + 1] + CAMERA_INFO_TOPIC
        if self._is_sequence:
            sequence = load_sequence_file(path)
            self.topics = [PlayedTopic(to, KEYPOINTS)]
            if sequence.is_camera_known:
                self.topics.append(PlayedTopic(beside, CAMERA_INFO))
            self.count = len(sequence) * len(self.topics)
            return
        with Bag(path) as bag:
            published_names: dict[str, str] = {}  # by recorded name
            if everything:
                published_names = {t: t for t in bag.topics if bag.count([t])}
            else:
                found = find_inputs(bag, topic, camera_info)
                for recorded, source in found.people.items():
                    published_names[recorded] = to if source is Source.KEYPOINTS else recorded
                if found.camera_info is not None:
                    published_names[found.camera_info] = beside
            self.topics = [
                PlayedTopic(published, bag.topics[recorded], bag.qos[recorded], recorded)
                for recorded, published in published_names.items()
            ]
            self.count = bag.count(published_names)

    def __iter__(self) -> Iterator[PlaybackMessage]:
        if self._is_sequence:
            sequence = load_sequence_file(self._path)
            camera = CameraInfo(sequence.image_size, sequence.intrinsics(1.0))
            for frame in encode_sequence(sequence):
                if sequence.is_camera_known:
                    raw = encode_camera_info(Header(frame.due_ns, DEFAULT_FRAME_ID), camera)
                    yield PlaybackMessage(frame.due_ns, raw, 1)
                yield frame
            return
        index = {t.recorded: i for i, t in enumerate(self.topics)}
        with Bag(self._path) as bag:
            for message in bag.messages(index):
                yield PlaybackMessage(message.time_ns, message.raw, index[message.topic])
