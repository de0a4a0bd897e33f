# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints with the depths that a registered depth image has at them: messages in, messages out.

Keypoints wait for the depth image of their stamp, at most `MAX_WAIT_S`. One belongs to them if its stamp is no
further away than half the time from one depth image to the next. Keypoints that have none, or one that cannot be
used, go on without depths, so that none are lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from statistics import median

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.depth_image import sample_depth
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE
from mocap_ros.messages.cdr import read_stamp_ns
from mocap_ros.messages.images import IMAGE, decode_depth_image
from mocap_ros.messages.input_types import decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS, KeypointsFrame, encode_keypoints
from mocap_ros.units import NS_PER_S

MAX_DEPTH_IMAGES = 30  # that are kept: 1 s, as long as a detector may take
MAX_WAIT_S = 0.1  # s; for a depth image that comes later than the keypoints
USUAL_STEP_S = 1 / 30  # s; between depth images, before two have come
REGISTERED = (
    'depth must be registered to the image of the keypoints: realsense2_camera publishes '
    'aligned_depth_to_color/image_raw (align_depth.enable), others depth_registered/image_raw'
)


class DepthPairing:
    """The depth images and the keypoints that have come, and which of them belong together."""

    def __init__(self, keypoints_type: str = KEYPOINTS, depth_type: str = IMAGE) -> None:
        self._keypoints_type, self._depth_type = keypoints_type, depth_type
        self._limits = NodeConfig()
        self._images: deque[tuple[int, bytes]] = deque(maxlen=MAX_DEPTH_IMAGES)  # stamp in ns, and message
        self._waiting: deque[tuple[float, bytes]] = deque()  # time of arrival in s, and message

    def add_depth(self, raw: bytes) -> None:
        """Add a depth image; a stamp that goes back begins a new video."""
        stamp_ns = read_stamp_ns(raw)
        if self._images and stamp_ns < self._images[-1][0]:
            self._images.clear()
        self._images.append((stamp_ns, raw))

    def add_keypoints(self, raw: bytes, now_s: float) -> None:
        """Add keypoints that have come at this time in s."""
        self._waiting.append((now_s, raw))

    def take(self, now_s: float) -> Iterator[tuple[bytes, str]]:
        """Yield the keypoints that wait no longer, with their depths, and in words why they have none.

        Keypoints that cannot be read are yielded as no bytes.
        """
        while self._waiting:
            came_s, raw = self._waiting[0]
            is_newer_there = self._images and self._images[-1][0] >= read_stamp_ns(raw)
            if not is_newer_there and now_s - came_s < MAX_WAIT_S:
                return
            self._waiting.popleft()
            try:
                frame = decode_frame(raw, self._keypoints_type, self._limits, UNKNOWN_SIZE)
            except InputError as error:
                yield b'', str(error)
                continue
            reason = ''
            try:
                frame = self._add_depths(frame)
            except InputError as error:
                reason = f'without depth: {error}'
            size = frame.image_width, frame.image_height
            yield encode_keypoints(frame.header, size, frame.people), reason

    def _add_depths(self, frame: KeypointsFrame) -> KeypointsFrame:
        stamps_ns = [stamp_ns for stamp_ns, _ in self._images]
        steps_ns = [b - a for a, b in pairwise(stamps_ns)]
        half_ns = (median(steps_ns) if steps_ns else USUAL_STEP_S * NS_PER_S) / 2
        own_ns = frame.header.stamp_ns
        nearest_ns, raw = min(self._images, key=lambda image: abs(image[0] - own_ns), default=(0, b''))
        if not raw:
            raise InputError('no depth image has come')
        if abs(nearest_ns - own_ns) > half_ns:
            raise InputError(f'the nearest depth image is {(nearest_ns - own_ns) / NS_PER_S:+.3f} s away')
        header, image, unit_m = decode_depth_image(raw, self._depth_type, self._limits)
        if header.frame_id and frame.header.frame_id not in ('', header.frame_id):
            given = f'the depth image is of {header.frame_id!r}, the keypoints are of {frame.header.frame_id!r}'
            raise InputError(f'{given}; {REGISTERED}')
        size, own_size = image.shape[::-1], (frame.image_width, frame.image_height)
        if all(own_size) and size != own_size:
            given = f'the depth image has {size[0]} x {size[1]} px'
            raise InputError(f'{given}, that of the keypoints {own_size[0]} x {own_size[1]}; {REGISTERED}')
        people = []
        for person in frame.people:
            depth = sample_depth(image, unit_m, person.points)
            people.append(person if np.isnan(depth).all() else replace(person, depth=depth))
        return replace(frame, image_width=size[0], image_height=size[1], people=tuple(people))
