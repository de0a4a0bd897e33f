# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How an input is read: what it does not state, and what of it is wanted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from mocap_ros.config import NodeConfig, TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.video import VideoFacts, VideoImage
from mocap_ros.keypoints.image_size import ImageSize

# A function that shows progress while the images are iterated; its second argument is their number, if known.
ShowProgress = Callable[[Iterable[VideoImage], int | None], Iterable[VideoImage]]

HFOV_RANGE_DEG = 1.0, 170.0  # degrees; fields of view of lenses without a distortion that has to be known


class ReadingOptions(NamedTuple):
    """How an input is read.

    The fields up to `camera_info` are options of the command line; `recordings.input_kind` says which kinds of
    input each applies to.
    """

    fps: float | None = None  # frame rate in Hz, or None where unknown
    image_size: ImageSize | None = None  # (width, height) in px, or None where it is not given
    # Name of the keypoint layout, one of `skeleton.LAYOUT_NAMES`; empty where it follows from the number of
    # keypoints
    layout: str = ''
    # File of the model that finds keypoints in a video; None for the one that comes with some versions of
    # MediaPipe
    detector: Path | None = None
    hfov: float | None = None  # degrees, horizontal field of view of the camera, or None where it is not given
    # px, focal length of the camera, or None where it is not given; only one of the two is given
    focal: float | None = None
    video: Path | None = None  # in which the keypoints were detected, or None where it is not given
    normalised: bool = False  # whether the coordinates of a table are shares of the width and height of the image
    person: str | None = None  # id of the person; None for the one who is seen in most frames, or for all
    topic: str | None = None  # topic of the keypoints; needed only for a bag with several
    # Topic of the CameraInfo; None for that of the keypoints' camera (`frame_id`) and namespace
    camera_info: str | None = None
    # Limits on people, joints and text in a message of a bag, and the image size and lens of an input without one
    node: NodeConfig = NodeConfig()
    tracker: TrackerConfig = TrackerConfig()  # parameters by which people are associated
    show_detection: ShowProgress | None = None  # of a detector on a video
    facts: VideoFacts = VideoFacts()  # what `video` states, once it is read


NO_OPTIONS = ReadingOptions()


def find_focal_length(
    image_width: int, hfov: float | None, focal: float | None, name: str = '--focal'
) -> float | None:
    """Return the focal length in px, in images of this width in px; None where nothing gives it.

    `hfov` in degrees and `focal` in px are as in `ReadingOptions`; `name` is that of the latter in errors.
    """
    if hfov is not None:
        return image_width / 2 / math.tan(math.radians(hfov / 2))
    if focal is not None:
        hfov = math.degrees(2 * math.atan2(image_width / 2, focal))
        if not HFOV_RANGE_DEG[0] <= hfov <= HFOV_RANGE_DEG[1]:
            raise InputError(
                f'{name}: {focal:g} px in an image {image_width} px wide are {hfov:.3g} degrees; '
                f'{HFOV_RANGE_DEG[0]:g} to {HFOV_RANGE_DEG[1]:g} expected, and px, not mm'
            )
    return focal
