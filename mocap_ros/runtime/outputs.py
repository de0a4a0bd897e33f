# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encode people as the messages of all output topics: for the node, replays and reconstructed sequences.

Tentative people are flagged in the skeletons, have cameras and points, and are drawn grey. They have no
transforms and are in no message for robots, because a robot would act on them, and because a coordinate frame is
remembered after its last message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from mocap_ros.config import NodeConfig
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.foreign.definitions import COLLISION_OBJECT, DETECTIONS_3D, HRI_IDS, OBSTACLES, PEOPLE
from mocap_ros.messages.marker_writer import MarkerSeries
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.point_cloud import POINTS, encode_points
from mocap_ros.messages.robots.bodies import DESCRIPTION, TRACKED, BodiesEncoder, BodyNames
from mocap_ros.messages.robots.capsules import CAPSULES, encode_capsules
from mocap_ros.messages.robots.collision_objects import CollisionObjectEncoder
from mocap_ros.messages.robots.detections import encode_detections
from mocap_ros.messages.robots.obstacles import encode_obstacles
from mocap_ros.messages.robots.people import encode_people
from mocap_ros.messages.robots.poses import POSES, encode_poses
from mocap_ros.messages.robots.predictions import PREDICTIONS, PredictedFrame, encode_predictions
from mocap_ros.messages.robots.robot_markers import encode_capsule_markers, encode_prediction_markers
from mocap_ros.messages.skeletons import (
    CAMERAS,
    SKELETON_DEFINITION,
    SKELETONS,
    encode_cameras,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms, make_suffix
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.skeleton import keypoint_layout

CAPSULE_MARKERS, PREDICTION_MARKERS = 'capsule_markers', 'prediction_markers'  # topics

# Message type of every output that each accepted image causes, by relative topic name.
OUTPUTS = {
    'skeletons': SKELETONS,
    'cameras': CAMERAS,
    'markers': MARKERS,
    'points': POINTS,
}


class SwitchedOutput(NamedTuple):
    """An output that a parameter switches on.

    Attributes:
        topic: Relative topic name.
        type: Message type.
        encode: Encoder of the people in an image; None where the message depends on more than these.
    """

    topic: str
    type: str
    encode: Callable[[Header, Sequence[Person3D]], bytes] | None = None


# The further outputs, by the field of `NodeConfig` that switches them on.
SWITCHED_OUTPUTS = {
    'publish_tf': SwitchedOutput('/tf', TRANSFORMS),
    'publish_people': SwitchedOutput('people', PEOPLE, encode_people),
    'publish_detections': SwitchedOutput('detections', DETECTIONS_3D, encode_detections),
    'publish_obstacles': SwitchedOutput('obstacles', OBSTACLES, encode_obstacles),
    'publish_poses': SwitchedOutput('poses', POSES, encode_poses),
    'publish_capsules': SwitchedOutput('capsules', CAPSULES, encode_capsules),
    'publish_capsule_markers': SwitchedOutput(CAPSULE_MARKERS, MARKERS),
    'publish_collision_objects': SwitchedOutput('collision_object', COLLISION_OBJECT),
    'publish_predictions': SwitchedOutput('predictions', PREDICTIONS),
    'publish_prediction_markers': SwitchedOutput(PREDICTION_MARKERS, MARKERS),
    'publish_bodies': SwitchedOutput(TRACKED, HRI_IDS),  # and the topics of each body
}
# Message type of the output that is published once and kept for late subscribers, by relative topic name.
LATCHED_OUTPUTS = {'skeleton_definition': SKELETON_DEFINITION}
# Types of all latched outputs; those of single bodies have topics that are not known beforehand.
LATCHED_TYPES = frozenset({*LATCHED_OUTPUTS.values(), DESCRIPTION})
_COMMON_TOPICS = frozenset({*OUTPUTS, *LATCHED_OUTPUTS, *(out.topic for out in SWITCHED_OUTPUTS.values())})
# Topics of single bodies that a bag holds. metadata.yaml has a kilobyte for each topic; its readers limit its size
# (`bags.reader.MAX_METADATA_BYTES`); 250 people are there in some hours of a busy place.
MAX_BODY_TOPICS = 500


def list_switched_outputs(node: NodeConfig) -> dict[str, str]:
    """Return the message types of the further outputs that are switched on, by topic."""
    return {out.topic: out.type for field, out in SWITCHED_OUTPUTS.items() if getattr(node, field)}


class RecordedBodies:
    """The topics of single bodies that have got a place in a bag.

    Attributes:
        left_out_count: number of the outputs that had none.
    """

    def __init__(self) -> None:
        self._topics: set[str] = set()
        self.left_out_count = 0

    def admit(self, topic: str) -> bool:
        """Return whether an output with this relative topic name is recorded: all but those of too many bodies."""
        if topic in _COMMON_TOPICS or topic in self._topics:
            return True
        if len(self._topics) >= MAX_BODY_TOPICS:
            self.left_out_count += 1
            return False
        self._topics.add(topic)
        return True


class OutputEncoder:
    """Encoder of the outputs of successive images.

    The markers, the collision objects and the names of bodies and frames depend on those of the image before.
    """

    def __init__(self) -> None:
        self._markers = MarkerEncoder()
        self._shapes = {topic: MarkerSeries() for topic in (CAPSULE_MARKERS, PREDICTION_MARKERS)}
        self._collision_objects = CollisionObjectEncoder()
        self._bodies, self._body_names, self._frame_names = BodiesEncoder(), BodyNames(), BodyNames(make_suffix)
        self._order: dict[str, int] = {}  # places of the people of the image before, by id

    def encode(
        self,
        header: Header,
        people: Sequence[Person3D],
        node: NodeConfig | None = None,
        camera: CameraPlacement | None = None,
        vertical: CameraVertical | None = None,
        predicted: Sequence[PredictedFrame] = (),
    ) -> tuple[OutputMessage, ...]:
        """Encode the people in an image; the result has one message for each of `OUTPUTS`, then those switched on.

        Args:
            header: Time of the image, and the frame in which the people are put out.
            people: All people in the image, in the camera's optical frame, in any order.
            node: Parameters of the outputs; None for the defaults.
            camera: The camera in the frame of the header; None where the header names the optical frame.
            vertical: What is known of the camera's vertical, in its optical frame; None if nothing is.
            predicted: The people at times after the image, in the camera's optical frame.
        """
        node = node or NodeConfig()
        camera = camera or CameraPlacement(header.frame_id)
        placed = stack_people(camera.place(self._keep_order(people)))
        data = {
            'skeletons': encode_skeletons(header, placed, camera.place_vertical(vertical), camera),
            'cameras': encode_cameras(Header(header.stamp_ns, camera.frame_id), placed),
            'markers': self._markers.encode_update(header, placed, node.marker_lifetime),
            'points': encode_points(header, placed),
        }
        outputs = [OutputMessage(topic, OUTPUTS[topic], header.stamp_ns, raw) for topic, raw in data.items()]
        certain = placed
        if any(p.tentative for p in placed):
            certain = stack_people([p for p in placed if not p.tentative])
        numbers, lifetime = self._markers.numbers, node.marker_lifetime
        names = (self._body_names if node.publish_bodies else self._frame_names).assign([p.id for p in certain])
        ahead = [PredictedFrame(time_s, camera.place_predicted(then, time_s)) for time_s, then in predicted]
        here = CameraPlacement(header.frame_id)  # leaves the people of `ahead`, who are in this frame, as they are
        for field, output in SWITCHED_OUTPUTS.items():
            if not getattr(node, field):
                continue
            if output.type == HRI_IDS:
                outputs += self._bodies.encode_update(header, certain, names)
                continue
            if output.topic == CAPSULE_MARKERS:
                series = self._shapes[output.topic]
                messages = [encode_capsule_markers(series, header, certain, numbers, lifetime)]
            elif output.topic == PREDICTION_MARKERS:
                series = self._shapes[output.topic]
                messages = [encode_prediction_markers(series, header, ahead, here, numbers, lifetime)]
            elif output.type == PREDICTIONS:
                messages = [encode_predictions(header, ahead, here)]
            else:
                messages = self._encode_switched(output, header, certain, node.frame_prefix, names)
            outputs += [OutputMessage(output.topic, output.type, header.stamp_ns, raw) for raw in messages]
        return tuple(outputs)

    def _keep_order(self, people: Sequence[Person3D]) -> list[Person3D]:
        """Return the people in the order of the image before, new ones last.

        Detectors change the order from image to image; a message whose order stays is encoded faster.
        """
        ordered = sorted(people, key=lambda p: self._order.get(p.id, len(self._order)))
        self._order = {person.id: place for place, person in enumerate(ordered)}
        return ordered

    def _encode_switched(
        self,
        output: SwitchedOutput,
        header: Header,
        people: Sequence[Person3D],
        frame_prefix: str,
        names: Mapping[str, str],
    ) -> list[bytes]:
        """Encode the messages of a further output for people who are not tentative.

        Args:
            output: the output.
            header: time of the image, and the frame in which the people are.
            people: the people.
            frame_prefix: text before the names of frames on /tf.
            names: names of people as frames by id, which are those of the bodies where these are published.
        """
        if output.encode is not None:
            return [output.encode(header, people)]
        if output.type == TRANSFORMS:
            return [encode_transforms(header, people, frame_prefix, names)]
        return self._collision_objects.encode_update(header, people)

    def encode_clear(self, header: Header) -> tuple[OutputMessage, ...]:
        """Encode the messages that delete all markers, collision objects and bodies, and forget all people."""
        self._body_names, self._frame_names, self._order = BodyNames(), BodyNames(make_suffix), {}
        objects, objects_type, _ = SWITCHED_OUTPUTS['publish_collision_objects']
        cleared = [
            ('markers', MARKERS, self._markers.encode_clear(header)),
            *((topic, MARKERS, raw) for topic, s in self._shapes.items() for raw in s.encode_clear(header)),
            *((objects, objects_type, raw) for raw in self._collision_objects.encode_clear(header)),
        ]
        messages = [OutputMessage(topic, msgtype, header.stamp_ns, raw) for topic, msgtype, raw in cleared]
        return *messages, *self._bodies.encode_clear(header)


def build_skeleton_definition(name: str) -> OutputMessage:
    """Return the latched message that names the joints of the skeletons, which `tracker.skeleton` chooses."""
    data = encode_skeleton_definition(keypoint_layout(name))
    return OutputMessage('skeleton_definition', SKELETON_DEFINITION, 0, data)
