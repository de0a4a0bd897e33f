"""Recorded messages to be published again, each with the time at which it is due."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Qos

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import Source, people_topics
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.sequence_messages import sequence_samples

CAMERA_INFO_TOPIC = 'camera_info'


class Due(NamedTuple):
    """A message as CDR, when it is due, ns on any clock, and the number of its topic."""

    due_ns: int
    raw: bytes
    topic: int


@dataclass(frozen=True)
class PlayedTopic:
    """A topic to publish.

    Attributes:
        name: to publish on.
        type: of the messages.
        qos: profiles that the recorded publishers offered.
        recorded: name in the bag.
    """

    name: str
    type: str
    qos: Sequence[Qos] = ()
    recorded: str = ''


class Playback:
    """The keypoints of a bag or a sequence file, and what else of a bag is wanted; may be gone through repeatedly.

    Args:
        path: bag, or sequence file (.npz).
        topic: of the keypoints, where a bag has several.
        to: topic to publish the keypoints on, but those of ROS4HRI, which keep their names; CameraInfo goes to
            `camera_info`.
        everything: every topic of a bag, each on its own name, instead.

    Attributes:
        topics: to publish.
        count: number of messages.

    Raises:
        InputError: the file is neither, or broken.
    """

    def __init__(
        self, path: Path, topic: str | None = None, to: str = 'keypoints', everything: bool = False
    ) -> None:
        self._path = path
        self._is_sequence = path.suffix == '.npz'
        if self._is_sequence:
            self.topics = [PlayedTopic(to, KEYPOINTS)]
            self.count = len(load_sequence(path))
            return
        with Bag(path) as bag:
            names: dict[str, str] = {}
            if everything:
                names = {t: t for t in bag.topics if bag.count([t])}
            else:
                found = people_topics(bag, topic)
                names = {t: to if source is Source.KEYPOINTS else t for t, source in found.items()}
                camera_info = bag.camera_info_topic(next(iter(names)))
                if camera_info:
                    names[camera_info] = CAMERA_INFO_TOPIC
            self.topics = [PlayedTopic(new, bag.topics[old], bag.qos[old], old) for old, new in names.items()]
            self.count = bag.count(names)

    def __iter__(self) -> Iterator[Due]:
        if self._is_sequence:
            for sample in sequence_samples(load_sequence(self._path)):
                yield Due(sample.due_ns, sample.raw, 0)
            return
        number = {t.recorded: n for n, t in enumerate(self.topics)}
        with Bag(self._path) as bag:
            for message in bag.messages(number):
                yield Due(message.time_ns, message.raw, number[message.topic])
