# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""MoveNet (Votel and Li, Next-Generation Pose Detection with MoveNet, 2021), for one person or for six.

The single-pose model sees a square around the person (`detectors.following`): centred between the hips, with half
a side of the larger of 1.9 times the greatest distance of a joint of the trunk from there and 1.2 times that of
any joint, as its authors' tutorial has it; where no hips are seen, it is about all points. The multi-pose model
sees the whole image, the longer side of which becomes 256 px. It is less exact, but finds the people.

The score of a keypoint is the network's. A keypoint is 0.01 or less where there is no person.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Image
from mocap_ros.detectors.following import PersonNetwork, is_seen
from mocap_ros.detectors.onnx_model import OnnxModel
from mocap_ros.detectors.regions import Box, cut_out
from mocap_ros.skeleton import keypoint_layout

OUTPUT_FORM = '(1, 1, 17, 3) or (1, 6, 56) of MoveNet'  # in the words of messages
COCO = keypoint_layout('coco17')
KEYPOINTS = len(COCO.joints)
PERSON_NUMBERS = 3 * KEYPOINTS + 5  # y, x and score of each keypoint; y and x of two corners; score of the person
MIN_SCORE = 0.2  # score of a keypoint that is probably right, that of the authors' tutorial
MIN_PERSON_SCORE = 0.2  # score of a person in the multi-pose model, likewise
TRUNK_FACTOR, BODY_FACTOR = 1.9, 1.2  # half a side of the square over the distances above, from the tutorial
HALF_BODY_FACTOR = 1.5  # side of the square over the extent of the points, where the hips are not seen
# px of the input, by which keypoints are too far left and up: of Lightning 0.30 and 0.19, of Thunder 0.19 and
# 0.40, of MultiPose 0.23 and 0.31, each to 0.1, as found with mirrored and with turned images of real people
SHIFT = 0.25
SIZE_STEP = 32  # px; both sides of the input of the multi-pose model are multiples of it
HIPS = [COCO.index('lhip'), COCO.index('rhip')]
TRUNK = [*HIPS, COCO.index('lshoulder'), COCO.index('rshoulder')]


def is_single_pose(output_shapes: Sequence[tuple[int, ...]]) -> bool:
    """Return whether a network with these outputs is MoveNet for one person."""
    return list(output_shapes) == [(1, 1, KEYPOINTS, 3)]


def is_multi_pose(output_shapes: Sequence[tuple[int, ...]]) -> bool:
    """Return whether a network with these outputs is MoveNet for several people."""
    return [(len(s), s[-1]) for s in output_shapes] == [(3, PERSON_NUMBERS)]


class SinglePoseMoveNet(PersonNetwork):
    """MoveNet Lightning or Thunder."""

    keypoint_count = KEYPOINTS
    min_score = MIN_SCORE

    def __init__(self, model: OnnxModel) -> None:
        self._model = model
        self.name = f'MoveNet ({model.path.name})'

    def estimate(self, image: Image, region: Box) -> Array:
        """Return keypoints; see `PersonNetwork`."""
        size = self._model.input_size
        (output,) = self._model.run(cut_out(image, region, size))
        return _place_keypoints(output[0, 0], region, size)

    def choose_region(self, keypoints: Array) -> Box | None:
        """Return the region of a person; see `PersonNetwork`."""
        seen = keypoints[:, 2] >= MIN_SCORE
        if not seen.any():
            return None
        points = keypoints[:, :2]
        if not (seen[HIPS].any() and seen[TRUNK[2:]].any()):  # as of somebody at a desk
            box = Box.around_points(points[seen])
            return box.widen(HALF_BODY_FACTOR, 1.0)
        hips = points[HIPS][seen[HIPS]].mean(axis=0)
        distance = np.where(seen, np.abs(points - hips).max(axis=1), 0.0)
        half = max(TRUNK_FACTOR * distance[TRUNK].max(), BODY_FACTOR * distance.max(), 1.0)
        return Box(hips[0] - half, hips[1] - half, 2 * half, 2 * half)


class MultiPoseMoveNet:
    """MoveNet for up to six people."""

    def __init__(self, model: OnnxModel, max_people: int) -> None:
        self.name = f'MoveNet for several people ({model.path.name})'
        self._model = model
        self._max_people = max_people

    def detect(self, image: Image, time_s: float) -> Array:  # noqa: ARG002 - the network takes no time
        """Find the people; see `Detector`."""
        height, width = image.shape[:2]
        size = self._model.input_size
        if self._model.takes_any_size:
            scale = max(size) / max(width, height)
            size = _round_up(width * scale), _round_up(height * scale)
        region = Box.around_image(image).widen(1.0, size[0] / size[1])
        (output,) = self._model.run(cut_out(image, region, size))
        people = [
            _place_keypoints(numbers[: 3 * KEYPOINTS].reshape(KEYPOINTS, 3), region, size)
            for numbers in sorted(output[0], key=lambda numbers: -numbers[-1])[: self._max_people]
            if numbers[-1] >= MIN_PERSON_SCORE
        ]
        return np.array([person for person in people if is_seen(person, MIN_SCORE)]).reshape(-1, KEYPOINTS, 3)

    def close(self) -> None:
        """Release nothing; the network goes with the object."""


def _round_up(side: float) -> int:
    return max(int(np.ceil(side / SIZE_STEP - 1e-6)), 1) * SIZE_STEP


def _place_keypoints(output: NDArray[np.float32], region: Box, size: tuple[int, int]) -> Array:
    """Return x, y in px and the score (17, 3) of y, x in shares of the region and the score (17, 3)."""
    shares = output[:, 1::-1] + SHIFT / np.array(size)
    return np.column_stack([region.place(shares), np.clip(output[:, 2], 0.0, 1.0)])
