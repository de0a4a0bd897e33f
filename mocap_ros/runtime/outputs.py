# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encode people as the messages of all output topics: for the node, replays and reconstructed sequences.

Tentative people are flagged in the skeletons, have cameras and points, and are drawn grey. They have no
transforms and no predictions, because a robot would act on them, and because a coordinate frame is remembered
after its last message.
"""

from __future__ import annotations

from collections.abc import Sequence

from mocap_ros.config import NodeConfig
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.markers import MARKERS, POINTS, MarkerEncoder, encode_points
from mocap_ros.messages.skeletons import (
    CAMERAS,
    PREDICTIONS,
    SKELETON_DEFINITION,
    SKELETONS,
    compute_cameras,
    encode_cameras,
    encode_predictions,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.messages.transforms import TRANSFORMS, FrameNames, encode_transforms
from mocap_ros.people import CameraVertical, People, PredictedPeople
from mocap_ros.runtime.output_frame import LiveWorld
from mocap_ros.skeleton import keypoint_layout

# Message type of every output that each accepted image causes, by relative topic name.
OUTPUTS = {'skeletons': SKELETONS, 'cameras': CAMERAS, 'markers': MARKERS, 'points': POINTS}
# Topic and type of the further outputs, by the field of `NodeConfig` that switches them on.
SWITCHED_OUTPUTS = {'publish_tf': ('/tf', TRANSFORMS), 'publish_predictions': ('predictions', PREDICTIONS)}
# Message type of the output that is published once and kept for late subscribers, by relative topic name.
LATCHED_OUTPUTS = {'skeleton_definition': SKELETON_DEFINITION}


def list_switched_outputs(node: NodeConfig) -> dict[str, str]:
    """Return the message types of the further outputs that are switched on, by topic."""
    return dict(output for field, output in SWITCHED_OUTPUTS.items() if getattr(node, field))


class OutputEncoder:
    """Encoder of the outputs of successive images; markers and names of frames depend on the image before."""

    def __init__(self) -> None:
        self._markers = MarkerEncoder()
        self.restart()

    def restart(self) -> None:
        """Forget all people and their world; the next image deletes their markers."""
        self._names, self._world = FrameNames(), LiveWorld()
        self._order: dict[str, int] = {}  # positions in the list of the image before, by id

    def encode(
        self,
        header: Header,
        people: People,
        node: NodeConfig | None = None,
        camera: CameraPlacement | None = None,
        vertical: CameraVertical | None = None,
        predicted: Sequence[PredictedPeople] = (),
        camera_height: float | None = None,
    ) -> tuple[OutputMessage, ...]:
        """Encode the people in an image; the result has one message for each of `OUTPUTS`, then those switched on.

        People in any order, vertical and predictions are in the camera's optical frame; `camera` places it in the
        frame of the header, which is the same without one. `camera_height` is in m over the floor; None where not
        known.
        """
        node = node or NodeConfig()
        camera = camera or CameraPlacement(header.frame_id)
        placed, upward = camera.place(self._keep_order(people)), camera.place_vertical(vertical)
        cameras = compute_cameras(placed)
        contents = [
            encode_skeletons(header, placed, upward, camera, cameras),
            encode_cameras(Header(header.stamp_ns, camera.frame_id), placed, cameras),
            self._markers.encode_update(header, placed, node.marker_lifetime),
            encode_points(header, placed),
        ]
        if node.publish_tf:
            certain = placed.certain
            names = self._names.assign(certain.ids)
            world = None
            if header.frame_id == (node.output_frame or camera.frame_id):
                world = self._world.advance(header.stamp_ns, certain, upward, camera, camera_height)
            contents.append(encode_transforms(header, certain, node.frame_prefix, names, world))
        if node.publish_predictions:
            contents.append(encode_predictions(header, predicted, camera))
        types = OUTPUTS | list_switched_outputs(node)
        outputs = zip(types.items(), contents, strict=True)
        return tuple(OutputMessage(topic, msgtype, header.stamp_ns, raw) for (topic, msgtype), raw in outputs)

    def _keep_order(self, people: People) -> People:
        """Return the people in the order of the image before, new ones last; that of detectors changes."""
        rows = sorted(range(len(people)), key=lambda row: self._order.get(people.ids[row], len(self._order)))
        if rows != list(range(len(people))):
            people = people.select(rows)
        self._order = {person_id: number for number, person_id in enumerate(people.ids)}
        return people

    def encode_clear(self, header: Header) -> tuple[OutputMessage, ...]:
        """Encode the message that deletes all markers, and forget all people."""
        self.restart()
        return (OutputMessage('markers', MARKERS, header.stamp_ns, self._markers.encode_clear(header)),)


def build_skeleton_definition(name: str) -> OutputMessage:
    """Return the latched message that names the joints of the skeletons, which `tracker.skeleton` chooses."""
    data = encode_skeleton_definition(keypoint_layout(name))
    return OutputMessage('skeleton_definition', SKELETON_DEFINITION, 0, data)
