# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""YOLO-pose (Maji et al., YOLO-Pose, CVPR workshops 2022), as Ultralytics export it, for several people.

The network sees the whole image on a grey ground. Each of its N candidates is a box, the score of a person in it,
and x, y and score of 17 keypoints, in px of the input. YOLOv8 and YOLO11 give several candidates for a person, of
which the best is kept: one whose box overlaps that of no better candidate by more than `MAX_OVERLAP`, in the
intersection over the union. YOLO26 gives one each, with corners in place of the centre and the size of the box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Image
from mocap_ros.detectors.onnx_model import OnnxModel
from mocap_ros.detectors.regions import Box, cut_out
from mocap_ros.skeleton import keypoint_layout

OUTPUT_FORM = '(1, 56, N) or (1, N, 57) of YOLO-pose'  # in the words of messages
KEYPOINTS = len(keypoint_layout('coco17').joints)
MANY_NUMBERS = 5 + 3 * KEYPOINTS  # of a candidate of YOLOv8 and YOLO11: box, score, keypoints
ONE_NUMBERS = 6 + 3 * KEYPOINTS  # of YOLO26: box, score, class, keypoints
DEFAULT_SIDE = 640  # px, of the input of a network that takes any size
GREY = 114  # of 0 to 255, of the ground
MIN_SCORE = 0.25  # of a person, Ultralytics' default
MAX_OVERLAP = 0.7  # likewise


def is_yolo_pose(output_shapes: Sequence[tuple[int, ...]]) -> bool:
    """Return whether a network with these outputs is YOLO-pose."""
    ((*_, rows, columns),) = output_shapes if [len(s) for s in output_shapes] == [3] else [(0, 0)]
    return rows == MANY_NUMBERS or columns == ONE_NUMBERS


class YoloPose:
    """YOLO-pose for any number of people."""

    def __init__(self, model: OnnxModel, max_people: int) -> None:
        self.name = f'YOLO-pose ({model.path.name})'
        self._model = model
        self._max_people = max_people
        self._size = (DEFAULT_SIDE, DEFAULT_SIDE) if model.takes_any_size else model.input_size

    def detect(self, image: Image, time_s: float) -> Array:  # noqa: ARG002 - the network takes no time
        """Find the people; see `Detector`."""
        region = Box.around_image(image).widen(1.0, self._size[0] / self._size[1])
        (output,) = self._model.run(cut_out(image, region, self._size, GREY) / np.float32(255))
        boxes, scores, keypoints = _read_candidates(output[0].astype(float))
        found = keypoints[_choose_people(boxes, scores, self._max_people)]
        points = region.place(found[..., :2] / self._size)
        return np.concatenate([points, np.clip(found[..., 2:], 0.0, 1.0)], axis=-1)

    def close(self) -> None:
        """Release nothing; the network goes with the object."""


def _read_candidates(output: Array) -> tuple[Array, Array, Array]:
    """Return corners (N, 4), scores (N,) and keypoints (N, 17, 3) of the candidates, in px of the input."""
    rows = output if output.shape[1] == ONE_NUMBERS else output.T
    boxes, keypoints = rows[:, :4], rows[:, -3 * KEYPOINTS :].reshape(-1, KEYPOINTS, 3)
    if rows.shape[1] == MANY_NUMBERS:
        boxes = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])
    return boxes, rows[:, 4], keypoints


def _choose_people(boxes: Array, scores: Array, max_people: int) -> list[int]:
    chosen: list[int] = []
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    for index in np.argsort(-scores, kind='stable').tolist():
        if scores[index] < MIN_SCORE or len(chosen) == max_people:
            break
        others = boxes[chosen]
        corners = np.minimum(boxes[index, 2:], others[:, 2:]) - np.maximum(boxes[index, :2], others[:, :2])
        common = np.prod(np.maximum(corners, 0.0), axis=1)
        if (common <= MAX_OVERLAP * (area[index] + area[chosen] - common)).all():
            chosen.append(index)
    return chosen
