# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""RTMPose (Jiang et al., RTMPose: Real-Time Multi-Person Pose Estimation based on MMPose, 2023), one person.

The network classifies the column and the row of each keypoint among bins that are half a pixel wide (SimCC). With
the responses u_j(a) of the columns a and v_j(b) of the rows b, keypoint j is at

    x_j = argmax_a u_j(a) / 2,    y_j = argmax_b v_j(b) / 2,    score_j = (max_a u_j + max_b v_j) / 2

px of the network's input, a rectangle around the person (`detectors.following`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Image
from mocap_ros.detectors.following import PersonNetwork
from mocap_ros.detectors.onnx_model import OnnxModel
from mocap_ros.detectors.regions import Box, cut_out

OUTPUT_FORM = '(1, J, 2 W) and (1, J, 2 H) of RTMPose'  # in the words of messages, for an input of W x H px
BINS_PER_PX = 2  # bins of SimCC per px of the input, in all published models
MEAN = np.array([123.675, 116.28, 103.53], np.float32)  # of red, green and blue, 0 to 255, in the models' training
STD = np.array([58.395, 57.12, 57.375], np.float32)  # standard deviation of the same
PERSON_FACTOR = 1.25  # size of a person's rectangle over that of the keypoints' (hands, feet, hair, movement)
PADDING = 1.25  # size of the network's rectangle over that of the person's, as in the training


def is_rtmpose(input_size: tuple[int, int], output_shapes: Sequence[tuple[int, ...]]) -> bool:
    """Return whether a network with an input of (width, height) px and these outputs is an RTMPose."""
    expected = [BINS_PER_PX * side for side in input_size]
    return (
        [len(shape) for shape in output_shapes] == [3, 3]
        and [shape[2] for shape in output_shapes] == expected
        and output_shapes[0][:2] == output_shapes[1][:2]
    )


class RtmPose(PersonNetwork):
    """RTMPose with any of its sets of keypoints, of which COCO's come first."""

    min_score = 0.3  # the usual threshold for drawing a keypoint

    def __init__(self, model: OnnxModel) -> None:
        self._model = model
        self.name = f'RTMPose ({model.path.name})'
        self.keypoint_count = model.output_shapes[0][1]
        self._aspect = model.input_size[0] / model.input_size[1]

    def estimate(self, image: Image, region: Box) -> Array:
        """Return keypoints; see `PersonNetwork`."""
        size = self._model.input_size
        columns, rows = self._model.run((cut_out(image, region, size) - MEAN) / STD)
        bins = np.stack([columns[0].argmax(axis=1), rows[0].argmax(axis=1)], axis=1)
        score = (columns[0].max(axis=1) + rows[0].max(axis=1)) / 2
        pixels = bins / BINS_PER_PX + 0.5  # the centre of the first pixel is at 0.5, and its bin is 0
        return np.column_stack([region.place(pixels / size), np.maximum(score, 0.0)])

    def choose_region(self, keypoints: Array) -> Box | None:
        """Return the region of a person; see `PersonNetwork`."""
        seen = keypoints[keypoints[:, 2] >= self.min_score, :2]
        if not len(seen):
            return None
        box = Box.around_points(seen)
        if min(box.width, box.height) > 0:
            box = box.widen(PERSON_FACTOR, box.width / box.height)
        return box.widen(PADDING, self._aspect)
