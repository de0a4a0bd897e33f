# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The consumers by name, and the conversion of successive messages for some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from mocap_ros.bridges.capsules import CAPSULES, convert_capsule_markers, convert_capsules
from mocap_ros.bridges.collision_objects import Content, convert_collision_objects
from mocap_ros.bridges.detections_3d import convert_detections
from mocap_ros.bridges.joint_angles import ANGLES_TOPIC, AnglesConverter
from mocap_ros.bridges.obstacles import convert_obstacles
from mocap_ros.bridges.people import convert_people
from mocap_ros.bridges.poses import convert_poses
from mocap_ros.bridges.prediction_markers import convert_prediction_markers
from mocap_ros.bridges.ros4hri import JOINT_STATES, TRACKED, BodiesConverter
from mocap_ros.bridges.seen import Predictions, SeenPeople, read_people, read_predictions, show_nobody
from mocap_ros.bridges.vmc import Avatar
from mocap_ros.errors import ConfigError, suggest
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.foreign_types import COLLISION_OBJECT, DETECTIONS_3D, HRI_IDS, OBSTACLES, PEOPLE
from mocap_ros.messages.markers import MARKERS, PersonNumbers
from mocap_ros.messages.plain import encode_plain

POSES = 'geometry_msgs/msg/PoseArray'


class Consumer(NamedTuple):
    """What some consumers take in."""

    topic: str  # relative name; the topics of single bodies come besides
    type: str  # message type
    # Function of what is seen now and in the message before that returns the content of one message, or of several
    convert: Callable[[Any, Any], Content | list[Content]]
    reads_predictions: bool = False  # whether it is made from predictions, and not from skeletons


CONSUMERS = {
    'people': Consumer('people', PEOPLE, lambda now, _: convert_people(now)),
    'detections': Consumer('detections', DETECTIONS_3D, lambda now, _: convert_detections(now)),
    'obstacles': Consumer('obstacles', OBSTACLES, lambda now, _: convert_obstacles(now)),
    'poses': Consumer('poses', POSES, lambda now, _: convert_poses(now)),
    'capsules': Consumer('capsules', CAPSULES, lambda now, _: convert_capsules(now)),
    'capsule_markers': Consumer('capsule_markers', MARKERS, convert_capsule_markers),
    'collision_objects': Consumer('collision_object', COLLISION_OBJECT, convert_collision_objects),
    'prediction_markers': Consumer(
        'prediction_markers', MARKERS, convert_prediction_markers, reads_predictions=True
    ),
    # made by `FOLLOWERS`
    'joint_angles': Consumer(ANGLES_TOPIC, JOINT_STATES, lambda *_: []),
    'bodies': Consumer(TRACKED, HRI_IDS, lambda *_: []),
}
# Those of the consumers that need more than the message before, or have topics that come and go.
FOLLOWERS: dict[str, type[AnglesConverter | BodiesConverter]] = {
    'joint_angles': AnglesConverter,
    'bodies': BodiesConverter,
}


def check_consumers(names: Sequence[str]) -> list[str]:
    """Return the names of consumers, each once."""
    unknown = [name for name in names if name not in CONSUMERS]
    if unknown or not names:
        fault = f'there is no {unknown[0]!r}' if unknown else 'nothing is named'
        raise ConfigError(f'publish: {fault}; {suggest("".join(unknown[:1]), [*CONSUMERS])}')
    return [*dict.fromkeys(names)]


class Bridge:
    """Converter of successive messages for some consumers, keys of `CONSUMERS`, and for an avatar."""

    def __init__(self, names: Sequence[str], avatar: Avatar | None = None) -> None:
        self._avatar = avatar
        self._consumers = [CONSUMERS[name] for name in names]
        self._followers = [follower() for name, follower in FOLLOWERS.items() if name in names]
        self._numbers = PersonNumbers()
        self._people = show_nobody(Header(0, ''))
        self._predictions = Predictions(Header(0, ''))

    def feed_skeletons(self, raw: bytes) -> list[OutputMessage]:
        """Return the messages that a Skeleton3DArray causes."""
        return self._convert_people(read_people(raw, self._numbers))

    def feed_predictions(self, raw: bytes) -> list[OutputMessage]:
        """Return the messages that a Predictions message causes; the errors are those of `feed_skeletons`."""
        return self._convert_predictions(read_predictions(raw, self._numbers))

    def clear(self) -> list[OutputMessage]:
        """Return the messages that say that all people are gone, if there were any."""
        outputs: list[OutputMessage] = []
        if self._people.ids:
            outputs += self._convert_people(show_nobody(self._people.header))
        if any(then.numbers for then in self._predictions.times):
            outputs += self._convert_predictions(Predictions(self._predictions.header))
        self._numbers.keep([])
        return outputs

    def _convert_people(self, people: SeenPeople) -> list[OutputMessage]:
        before, self._people = self._people, people
        outputs = self._convert(people, before, reads_predictions=False)
        for follower in self._followers:
            for topic, msgtype, content in follower.convert(people):
                raw = encode_plain(content, msgtype)
                outputs.append(OutputMessage(topic, msgtype, people.header.stamp_ns, raw))
        if self._avatar is not None:
            self._avatar.show(people)
        return outputs

    def _convert_predictions(self, predictions: Predictions) -> list[OutputMessage]:
        before, self._predictions = self._predictions, predictions
        return self._convert(predictions, before, reads_predictions=True)

    def _convert(self, now: Any, before: Any, *, reads_predictions: bool) -> list[OutputMessage]:
        outputs = []
        for topic, msgtype, convert, reads in self._consumers:
            found = convert(now, before) if reads is reads_predictions else []
            for content in found if isinstance(found, list) else [found]:
                raw = content if isinstance(content, bytes) else encode_plain(content, msgtype)
                outputs.append(OutputMessage(topic, msgtype, now.header.stamp_ns, raw))
        return outputs
