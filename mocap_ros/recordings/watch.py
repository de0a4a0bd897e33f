# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People before a camera, in 3D and at once, without ROS: images, detector, tracker, and the page of a live scene.

Only the newest image counts: those that come while the detector works are skipped. A video takes the place of a
camera at its own pace. Stamps are of the clock, so that the page can say how late it is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from mocap_ros.config import Config
from mocap_ros.detectors.detector import Detector, Image
from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.reading_options import find_focal_length
from mocap_ros.formats.video import VideoReader
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.recordings.detect_people import check_image, detect_people, name_people
from mocap_ros.recordings.live_frame import show_people
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.live_page import LiveScene
from mocap_ros.viewing.overlay import encode_jpeg

if TYPE_CHECKING:
    from typing_extensions import Self

WAIT_S = 0.1  # s; for the next image, after which the end is looked for


class Shot(NamedTuple):
    """An image, and when it was taken, in ns of the clock."""

    image: Image
    stamp_ns: int


class NewestImage:
    """The newest image of a camera or a video, which another thread reads; a context manager that ends it."""

    def __init__(self, reader: VideoReader) -> None:
        self._reader = reader
        self._newest: Shot | None = None
        self._error: Exception | None = None
        self._changed, self._is_closed = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._read, name='camera', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_closed.set()
        self._thread.join(1.0)

    def take(self) -> Shot | None:
        """Return the newest image once, None if there is none for `WAIT_S`; EOFError at the end of a video."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._error, WAIT_S)
            shot, self._newest = self._newest, None
        if shot is None and self._error is not None:
            raise self._error
        return shot

    def _read(self) -> None:
        start_ns, started_ns = time.time_ns(), time.monotonic_ns()  # the clock may be set meanwhile
        try:
            for image, time_s in self._reader:
                now_ns, due_ns = start_ns + time.monotonic_ns() - started_ns, start_ns + round(time_s * NS_PER_S)
                if not self._reader.is_live and self._is_closed.wait(max(due_ns - now_ns, 0) / NS_PER_S):
                    return
                with self._changed:
                    self._newest = Shot(image, now_ns if self._reader.is_live else due_ns)
                    self._changed.notify_all()
                if self._is_closed.is_set():
                    return
            raise EOFError
        except Exception as error:  # it is raised in the thread that takes the images
            with self._changed:
                self._error = error
                self._changed.notify_all()


class Watch:
    """Detects and tracks the people in images, and shows them on a live scene."""

    def __init__(
        self,
        detector: Detector,
        models: Mapping[str, PoseModel],
        config: Config,
        scene: LiveScene,
        *,
        hfov: float | None = None,
        focal: float | None = None,
        is_recorded: bool = False,
    ) -> None:
        self._detector, self._config, self._scene = detector, config, scene
        self._tracker, self._lens = PeopleTracker(models, config), (hfov, focal)
        self._is_recorded = is_recorded
        self._people: list[list[Person2D]] = []
        self._stamps_ns: list[int] = []
        self._size, self._start_ns = UNKNOWN_SIZE, -1
        self._waiting: dict[int, tuple[list[Person2D], bytes]] = {}  # by stamp; the tracker may answer later

    def show(self, shot: Shot, focal_px: float | None = None) -> None:
        """Show the people in an image; `focal_px` is the focal length that a video states."""
        self._size = size = check_image(shot.image, len(self._people), self._size)
        self._start_ns = shot.stamp_ns if self._start_ns < 0 else self._start_ns
        people = detect_people(self._detector, shot.image, (shot.stamp_ns - self._start_ns) / NS_PER_S)
        with suppress(FrameDropped):
            camera = self._find_camera(focal_px)
            people = [person.hide_border(size) for person in people]
            tracked = self._tracker.update(shot.stamp_ns, people, camera)
            if self._is_recorded:
                self._people.append(people)
                self._stamps_ns.append(shot.stamp_ns)
            self._waiting[shot.stamp_ns] = people, encode_jpeg(shot.image) if self._scene.is_viewed else b''
            self._waiting = {s: waiting for s, waiting in self._waiting.items() if s >= tracked.stamp_ns}
            if self._scene.is_viewed:
                seen, jpeg = self._waiting.get(tracked.stamp_ns, ([], b''))
                show_people(
                    self._scene, tracked.stamp_ns, tracked.people, seen, camera, size, tracked.vertical, jpeg
                )
            else:
                self._scene.leave_out()
            self._tracker.run_deferred_work()

    @property
    def has_people(self) -> bool:
        """Whether somebody was recorded."""
        return any(self._people)

    def collect(self) -> Detections:
        """Return all that was recorded; InputError where nobody was."""
        if not self.has_people:
            raise InputError(f'no person was seen ({len(self._people)} images)')
        start_ns = self._stamps_ns[0]
        stamps_ns = [stamp_ns - start_ns for stamp_ns in self._stamps_ns]
        return name_people(Detections(self._people, stamps_ns, self._size))[0]

    def _find_camera(self, focal_px: float | None) -> Intrinsics:
        focal = find_focal_length(self._size[0], *self._lens) or focal_px
        if focal is None:
            return Intrinsics.from_image_size(*self._size, self._config.tracker.nominal_focal_length)
        return Intrinsics.centred(focal, self._size)
