# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The camera whose images are used, where messages of several cameras arrive on one topic, and its CameraInfo.

A camera is known by the `frame_id` of its images. Another camera replaces the one in use once it has sent for
`SILENCE_S` by its own stamps while the one in use was silent. No clock is read, so that a replay decides alike.
"""

from __future__ import annotations

from typing import Literal

from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.messages.camera_info import CameraInfo
from mocap_ros.messages.cdr import Header
from mocap_ros.units import NS_PER_S

# By a calibration, by the user, by what a telephone writes into a video, or assumed
FocalSource = Literal['known', 'given', 'from the video', 'nominal']
KNOWN: FocalSource = 'known'
GIVEN: FocalSource = 'given'
FROM_VIDEO: FocalSource = 'from the video'
NOMINAL: FocalSource = 'nominal'
SILENCE_S = 1.0  # s; without images of one camera, before those of another are taken as a move of the input


class InputCamera:
    """Decides for each image whether it is of the camera in use, replaces that camera, or is refused.

    `name` is the last `frame_id` of the camera in use that was not empty; empty before the first.
    `calibration` is the CameraInfo in use, if any.
    """

    def __init__(self) -> None:
        self.calibration: CameraInfo | None = None
        self.reset()

    def reset(self) -> None:
        """Take the next image as the first; only the CameraInfo in use stays, with which a recording begins."""
        self.name = ''
        self._rival: tuple[str, int] | None = None  # another camera, and its first stamp since the last image used

    def add_calibration(self, given: CameraInfo) -> None:
        """Use a CameraInfo for all following images, unless only the one in use is calibrated, for the same size.

        InputError if it is of another camera than the images, whose own is known.
        """
        name, held, other = self.name, self.calibration, given.frame_id
        if held and name and held.frame_id == name and other not in ('', name):
            raise InputError(
                f'header.frame_id: {other!r}, but the people of {name!r} are being tracked, whose CameraInfo is '
                'known; run a node for each camera'
            )
        is_calibrated, was_calibrated = (c.intrinsics.is_focal_known if c else False for c in (given, held))
        if is_calibrated or not was_calibrated or (held and held.size != given.size):
            self.calibration = given

    def check(self, header: Header) -> tuple[str, CameraInfo | None]:
        """Return why tracking must be restarted for an image, usually '', and the CameraInfo to use with it.

        A message without a `frame_id` is of the camera in use. The CameraInfo in use is used for another camera as
        well, unless it is of the camera that is replaced. InputError where two cameras send in turn.
        """
        name, held = header.frame_id, self.calibration
        if not self.name or name in ('', self.name):
            return '', held
        if self._rival is None or self._rival[0] != name or header.stamp_ns < self._rival[1]:
            self._rival = name, header.stamp_ns
        if header.stamp_ns - self._rival[1] < SILENCE_S * NS_PER_S:
            raise InputError(
                f'header.frame_id: {name!r}, but the people of {self.name!r} are being tracked; '
                'run a node for each camera'
            )
        reason = f'the camera {self.name!r} is called {name!r} now or is another one, so tracking was restarted'
        return reason, None if held and held.frame_id == self.name else held

    def accept(self, header: Header, calibration: CameraInfo | None) -> None:
        """Note that an image is used, with the CameraInfo that `check` has returned."""
        self.name, self._rival = header.frame_id or self.name, None
        self.calibration = calibration


class CalibrationWait:
    """Waits for the first CameraInfo, so that people do not change their size and distance when it comes.

    Images are left out until it comes or `node.camera_info_wait` has passed by their stamps; then the wait
    `is_over`. If it comes still later, tracking is restarted.
    """

    def __init__(self, *, is_over: bool = False) -> None:
        self.is_over = is_over
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._source: FocalSource | None = None

    def is_waiting(self, stamp_ns: int, wait_s: float) -> bool:
        """Return whether an image is left out, for which there is no CameraInfo yet.

        FrameDropped where its stamp repeats that of the image before, so that no time passes by the stamps.
        """
        if self.is_over:
            return False
        if stamp_ns == self._last_ns:
            raise FrameDropped(f'stamp {stamp_ns} ns repeats that of the image before')
        self._last_ns = stamp_ns
        if self._first_ns is None or stamp_ns < self._first_ns:
            self._first_ns = stamp_ns
        return stamp_ns - self._first_ns < wait_s * NS_PER_S

    def find_restart(self, source: FocalSource) -> str:
        """Note where the focal length of an image is from; return why tracking must be restarted, usually ''."""
        before, self._source, self.is_over = self._source, source, True
        if before == NOMINAL and source == KNOWN:
            return 'the first CameraInfo came late and changes all distances, so tracking was restarted'
        return ''
