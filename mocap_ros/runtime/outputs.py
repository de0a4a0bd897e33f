"""Encode people as the messages of all output topics: for the node, replays and reconstructed sequences.

Tentative people are flagged in the skeletons, have cameras and points, and are drawn grey. They have no
transforms, because a robot would act on them, and because a coordinate frame is remembered after its last message.
"""

from __future__ import annotations

from collections.abc import Sequence

from mocap_ros.messages.cameras import CAMERAS, encode_cameras
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.point_cloud import POINTS, encode_points
from mocap_ros.messages.skeletons import (
    SKELETON_DEFINITION,
    SKELETONS,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

# Message type of every output that each accepted image causes, by relative topic name.
OUTPUTS = {
    'skeletons': SKELETONS,
    'cameras': CAMERAS,
    'markers': MARKERS,
    'points': POINTS,
}
# The further output if the parameter node.publish_tf is set.
TF_OUTPUT = {'/tf': TRANSFORMS}
# Message type of the output that is published once and kept for late subscribers, by relative topic name.
LATCHED_OUTPUTS = {'skeleton_definition': SKELETON_DEFINITION}


class OutputEncoder:
    """Encoder of the outputs of successive images; the markers of an image depend on those of the image before."""

    def __init__(self) -> None:
        self._markers = MarkerEncoder()

    def encode(
        self,
        header: Header,
        people: Sequence[Person3D],
        marker_lifetime_s: float,
        transforms_prefix: str | None = None,
    ) -> tuple[OutputMessage, ...]:
        """Encode the people in an image; the result has one message for each of `OUTPUTS`.

        Args:
            header: Time and frame of the image.
            people: All people in the image.
            marker_lifetime_s: Time in s after which a viewer removes the markers by itself, 0 for never.
            transforms_prefix: Text before the name of every coordinate frame of the message of `TF_OUTPUT`; None
                for no such message.
        """
        data = {
            'skeletons': encode_skeletons(header, people),
            'cameras': encode_cameras(header, people),
            'markers': self._markers.encode_update(header, people, marker_lifetime_s),
            'points': encode_points(header, people),
        }
        if transforms_prefix is not None:
            certain = [p for p in people if not p.tentative]
            data['/tf'] = encode_transforms(header, certain, transforms_prefix)
        types = OUTPUTS | TF_OUTPUT
        return tuple(OutputMessage(topic, types[topic], header.stamp_ns, raw) for topic, raw in data.items())

    def encode_clear(self, header: Header) -> OutputMessage:
        """Encode the message that deletes all markers, and forget all people."""
        return OutputMessage('markers', MARKERS, header.stamp_ns, self._markers.encode_clear(header))


def build_skeleton_definition() -> OutputMessage:
    """Return the latched message that names the joints of the skeletons."""
    return OutputMessage('skeleton_definition', SKELETON_DEFINITION, 0, encode_skeleton_definition(CMU15))
