# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The interface of all 2D keypoint detectors."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
