# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The interface of all 2D keypoint detectors, and the choice of the one that a model file is for."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import ModelError

Image = NDArray[np.uint8]  # (H, W, 3) red, green, blue


class Detector(Protocol):
    """A detector of people's keypoints in the images of one video, which it gets in the order of time.

    A detector may follow people from image to image. It therefore serves one video; another one needs another.
    """

    name: str  # name of the detector and its model, for messages to the user

    def detect(self, image: Image, time_s: float) -> Array:
        """Find the people in the next image (H, W, 3), whose time is later than that of the image before.

        Returns (P, J, 3) x to the right and y down in px, and the score, at least 0, of the J keypoints of P
        people. Their layout follows from their number, as for the files of detectors
        (`formats.detections.LAYOUT_BY_KEYPOINT_COUNT`).
        """

    def close(self) -> None:
        """Release the model."""


MEDIAPIPE_SUFFIX = '.task'  # of the model bundles of MediaPipe's Tasks API
ONNX_SUFFIX = '.onnx'
# in the words of messages
MODEL_FORMATS = "MediaPipe's pose landmarker (.task), or YOLO-pose, RTMPose or MoveNet (.onnx)"
SHIPPED = Path(__file__).parent / 'shipped'
SHIPPED_MODEL = SHIPPED / 'movenet_thunder.onnx'  # that looks at each person, where no other is given
FINDER = SHIPPED / 'movenet_multipose.onnx'  # that finds the people
MAX_PEOPLE = 6  # in an image, if nothing else is said; those of MoveNet for several people


def load_detector(model: Path | None, max_people: int | None = None) -> Detector:
    """Load a model, by default the MoveNet that comes with the package.

    `max_people` is the largest number of people to find in an image, by default `MAX_PEOPLE`, of MediaPipe one,
    which is slow where it looks for more. Networks that see one person in a rectangle follow people whom MoveNet
    for several people finds.
    """
    model = model or SHIPPED_MODEL
    if not model.is_file():
        raise ModelError(f'{model}: no such file; expected {MODEL_FORMATS}')
    if model.suffix.lower() == MEDIAPIPE_SUFFIX:
        from mocap_ros.detectors.mediapipe import MediaPipe

        return MediaPipe(model, max_people or 1)
    max_people = max_people or MAX_PEOPLE
    if model.suffix.lower() != ONNX_SUFFIX:
        raise ModelError(f'{model}: unknown file type; expected {MODEL_FORMATS}')

    from mocap_ros.detectors import movenet, rtmpose, yolo_pose
    from mocap_ros.detectors.following import FollowingDetector, PersonNetwork
    from mocap_ros.detectors.onnx_model import OnnxModel

    network = OnnxModel(model)
    shapes = network.output_shapes
    if movenet.is_multi_pose(shapes):
        return movenet.MultiPoseMoveNet(network, max_people)
    if yolo_pose.is_yolo_pose(shapes):
        return yolo_pose.YoloPose(network, max_people)
    of_one: PersonNetwork
    if rtmpose.is_rtmpose(network.input_size, shapes):
        of_one = rtmpose.RtmPose(network)
    elif movenet.is_single_pose(shapes):
        of_one = movenet.SinglePoseMoveNet(network)
    else:
        found = ' and '.join(str(shape) for shape in shapes)
        forms = ', or '.join(module.OUTPUT_FORM for module in (yolo_pose, rtmpose, movenet))
        raise ModelError(f'{model}: gives arrays of the form {found}; expected {forms}')
    finder = movenet.MultiPoseMoveNet(OnnxModel(FINDER), MAX_PEOPLE)
    return FollowingDetector(of_one, finder, max_people)
