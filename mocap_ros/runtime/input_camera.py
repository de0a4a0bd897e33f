# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The camera whose images are used, where messages of several cameras arrive on one topic, and its CameraInfo.

A camera is known by the `frame_id` of its images. Another camera replaces the one in use once it has sent for
`SILENCE_S` by its own stamps while the one in use was silent. No clock is read, so that a replay decides alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Literal, TypeVar

from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.messages.camera_info import CameraInfo, describe_other_camera, may_be_one_camera
from mocap_ros.messages.cdr import Header
from mocap_ros.units import NS_PER_S

V = TypeVar('V')

# By a calibration, by the user, by what a telephone writes into a video, or assumed
FocalSource = Literal['known', 'given', 'from the video', 'nominal']
KNOWN: FocalSource = 'known'
GIVEN: FocalSource = 'given'
FROM_VIDEO: FocalSource = 'from the video'
NOMINAL: FocalSource = 'nominal'
MAX_FOCUS_RATIO = 1.05  # 1; of the focal lengths of a lens that is focused near and far
SILENCE_S = 1.0  # s; without images of one camera, before those of another are taken as a move of the input


class Turns(Generic[V]):
    """Notices a value that comes back soon after it was replaced, as where two cameras send in turn."""

    def __init__(self, value: V | None = None) -> None:
        self.value, self._used_ns = value, 0
        self._replaced: tuple[V | None, int] = None, 0  # the value before it, and when that was last sent

    def is_back(self, value: V, now_ns: int) -> bool:
        """Return whether a value is the one before, and both were sent within `SILENCE_S`."""
        before, before_ns = self._replaced
        if value in (self.value, None) or value != before:
            return False
        self._replaced = before, now_ns
        return all(0 <= now_ns - ns < SILENCE_S * NS_PER_S for ns in (before_ns, self._used_ns))

    def use(self, value: V, now_ns: int) -> None:
        """Use a value from now on."""
        if value != self.value:
            self._replaced = self.value, self._used_ns
        self.value, self._used_ns = value, now_ns


def find_turns(cameras: Iterable[CameraInfo]) -> str:
    """Return that successive CameraInfo are of two cameras in turn, in words; empty if they are not."""
    turns = Turns[CameraInfo]()
    for camera in cameras:
        if turns.value and not are_alike(turns.value, camera) and turns.is_back(camera, 0):
            return describe_turns(camera, turns.value)
        turns.use(camera, 0)
    return ''


def are_alike(first: CameraInfo, second: CameraInfo) -> bool:
    """Return whether two CameraInfo may be of one camera, whose autofocus changes the focal length a little."""
    ratio = first.intrinsics.focal / second.intrinsics.focal
    return first.size == second.size and max(ratio, 1 / ratio) <= MAX_FOCUS_RATIO


def describe_turns(first: CameraInfo, second: CameraInfo) -> str:
    """Return in words that two CameraInfo come in turn, as of two cameras."""
    both = (f'{c.intrinsics.focal:.0f} px for {c.size[0]} x {c.size[1]} px' for c in (first, second))
    return f'focal lengths of {" and ".join(both)} come in turn, as of two cameras; run a node for each camera'


class InputCamera:
    """Decides for each image whether it is of the camera in use, replaces that camera, or is refused.

    `name` is the last `frame_id` of the camera in use that was not empty; empty before the first.
    """

    def __init__(self) -> None:
        self._calibrations, self._topic = Turns[CameraInfo](), ''  # the topic of the newest
        self.reset()

    def reset(self) -> None:
        """Take the next image as the first; only the CameraInfo in use stays, with which a recording begins."""
        self.name, self._newest_ns = '', 0
        self._calibrations = Turns(self._calibrations.value)
        self._rival: tuple[str, int] | None = None  # another camera, and its first stamp since the last image used
        self._sizes = Turns[ImageSize]()

    @property
    def calibration(self) -> CameraInfo | None:
        """The newest CameraInfo that was accepted, if any; it may be of another camera."""
        return self._calibrations.value

    def find_calibration(self, frame_id: str) -> CameraInfo | None:
        """Return the CameraInfo for the images of a `frame_id`; None if there is none, or of another camera."""
        held = self.calibration
        return held if held and may_be_one_camera(held.frame_id, frame_id or self.name) else None

    def describe_other(self, frame_id: str) -> str:
        """Return why the CameraInfo is not used for the images of a `frame_id`, in words; empty if it is."""
        held = self.calibration
        if held is None or self.find_calibration(frame_id):
            return ''
        return describe_other_camera(frame_id or self.name, held, self._topic)

    def add_calibration(self, given: CameraInfo, topic: str) -> None:
        """Use a CameraInfo for all following images, unless only the one in use is calibrated, for the same size.

        InputError if it is of another camera than the images, whose own is known, or if two are sent in turn.
        """
        name, held = self.name, self.find_calibration('')
        if held and not may_be_one_camera(given.frame_id, name):
            raise InputError(
                f'header.frame_id: {given.frame_id!r}, but the people of {name!r} are being tracked, whose '
                'CameraInfo is known; run a node for each camera'
            )
        is_known_time = self._newest_ns > 0
        if (
            held
            and is_known_time
            and self._calibrations.is_back(given, self._newest_ns)
            and not are_alike(given, held)
        ):
            raise InputError(describe_turns(given, held))
        is_calibrated, was_calibrated = (c.intrinsics.is_focal_known if c else False for c in (given, held))
        if is_calibrated or not was_calibrated or (held and held.size != given.size):
            self._calibrations.use(given, self._newest_ns)
            self._topic = topic

    def check(self, header: Header, size: ImageSize) -> str:
        """Return why tracking must be restarted for an image of a size in px, usually ''.

        A message without a `frame_id` is of the camera in use. InputError where two cameras send in turn.
        """
        name, stamp_ns = header.frame_id, header.stamp_ns
        if all(size) and self._sizes.is_back(size, stamp_ns):
            sizes = ' and '.join(f'{width} x {height} px' for width, height in (size, self._sizes.value or size))
            raise InputError(
                f'image_width, image_height: images of {sizes} come in turn, as of two cameras; '
                'run a node for each camera'
            )
        if not self.name or name in ('', self.name):
            return ''
        if self._rival is None or self._rival[0] != name or stamp_ns < self._rival[1]:
            self._rival = name, stamp_ns
        if stamp_ns - self._rival[1] < SILENCE_S * NS_PER_S:
            raise InputError(
                f'header.frame_id: {name!r}, but the people of {self.name!r} are being tracked; '
                'run a node for each camera'
            )
        return f'the camera {self.name!r} is called {name!r} now or is another one, so tracking was restarted'

    def accept(self, header: Header, size: ImageSize) -> None:
        """Note that an image that was checked is used."""
        self.name, self._rival = header.frame_id or self.name, None
        self._newest_ns = header.stamp_ns
        if all(size):
            self._sizes.use(size, header.stamp_ns)


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
