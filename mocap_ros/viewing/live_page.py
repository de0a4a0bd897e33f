# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Serve the page of a live scene to browsers on this machine.

A browser asks for the frame after the one that it has, and gets the newest as soon as there is one. So a slow one
leaves frames out, and none is ever late.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import MocapError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import BODY26, Skeleton
from mocap_ros.viewing.page import LIVE_STEPS, build_page, describe_camera, pack_person, round_to_int16
from mocap_ros.viewing.scene import PERSON_COLOURS, Scene

if TYPE_CHECKING:
    from typing_extensions import Self

HOST = '127.0.0.1'
WAIT_S = 5.0  # s; a request without a new frame is answered after it
VIEWED_S = 10.0  # s; without a request for longer, there is no browser
LEVEL_STEP = 10  # frames; in every tenth one the floor and the vertical are found
KEPT_IMAGES = 3  # of the newest frames; a browser asks for that of its frame at once
LEVEL_FRAMES = 30  # of these frames, from which they are found: 10 s at 30 Hz


class LiveScene:
    """The newest frame of a live scene as JSON, for any number of threads that wait for it.

    `topic` is the name of the topic of the skeletons.
    """

    def __init__(self, title: str, topic: str = '/skeletons') -> None:
        self._title, self._topic = title, topic
        self._number, self._frame, self._asked_s = 0, b'', -VIEWED_S
        self._jpegs: dict[int, bytes] = {}  # images of the newest frames, by their numbers
        self._arrival_s: float | None = None  # steady clock; when the newest skeletons came
        self._changed = threading.Condition()
        self._skeleton = BODY26
        self._verticals: deque[NDArray[np.float64]] = deque(maxlen=LEVEL_FRAMES)
        self._people: deque[PoseSequence] = deque(maxlen=LEVEL_FRAMES)
        self._level: dict[str, Any] = {}

    @property
    def is_viewed(self) -> bool:
        """Whether a browser has asked lately; if not, frames need not be made."""
        return time.monotonic() - self._asked_s < VIEWED_S

    @property
    def age_s(self) -> float | None:
        """Seconds since the newest skeletons came; None before the first."""
        return None if self._arrival_s is None else time.monotonic() - self._arrival_s

    def build_page(self) -> str:
        """Return the page, which asks for the frames."""
        size = 640, 480  # px; the frames have their own
        intrinsics = Intrinsics.from_image_size(*size, 1.0)
        empty = make_nobody(self._skeleton, intrinsics)
        people = (empty,) * len(PERSON_COLOURS)
        scene = Scene(self._title, [0], people, (), size, intrinsics, skeleton=self._skeleton)
        return build_page(scene, live_topic=self._topic)

    def publish(
        self,
        stamp_ns: int,
        ids: Sequence[str],
        people: PoseSequence,
        keypoints: Sequence[tuple[Skeleton, NDArray[np.float64]]],
        image_size: tuple[int, int],
        vertical: NDArray[np.float64],
        skeleton: Skeleton,
        jpeg: bytes = b'',
    ) -> None:
        """Put the next frame in place of the last one, with its image, if there is one.

        The people (P,) of this frame are the frames of one person. Each detection has its layout and points (Jk,
        2) in px. The vertical (3,) is upwards in the optical frame; NaN where it is not known with certainty.
        """
        self._skeleton = skeleton if ids else self._skeleton
        if self._number % LEVEL_STEP == 0 or not self._people:
            self._find_level(people, vertical)
        arrays = pack_person(people, np.arange(len(ids)), np.zeros(len(ids), bool), LIVE_STEPS)
        frame = {
            'stampMs': stamp_ns / 1e6,
            'skeleton': self._skeleton.joints,
            'ids': ids,
            'people': {name: [row.ravel().tolist() for row in array] for name, array in arrays.items()},
            'keypoints': [
                {
                    'names': layout.joints,
                    'bones': layout.bones,
                    'points': round_to_int16(points, LIVE_STEPS.pixel).ravel().tolist(),
                }
                for layout, points in keypoints
            ],
            'camera': describe_camera(image_size, people.intrinsics),
            'hasImage': bool(jpeg),
            **self._level,
        }
        with self._changed:
            self._number += 1
            self._jpegs = {n: j for n, j in self._jpegs.items() if n > self._number - KEPT_IMAGES}
            self._jpegs[self._number] = jpeg
            self._arrival_s = time.monotonic()
            self._frame = json.dumps({'number': self._number, **frame}, separators=(',', ':')).encode()
            self._changed.notify_all()

    def find_image(self, number: int) -> bytes:
        """Return the JPEG of a frame; empty if there is none any more."""
        return self._jpegs.get(number, b'')

    def leave_out(self) -> None:
        """Note skeletons that nobody views, so that there is no frame of them; the last one is out of date."""
        self._arrival_s, self._frame = time.monotonic(), b''

    def _find_level(self, people: PoseSequence, vertical: NDArray[np.float64]) -> None:
        if np.linalg.norm(vertical) > 0:
            self._verticals.append(vertical)
        if len(people):
            self._people.append(people)
        verticals = np.array(self._verticals).reshape(-1, 3)
        known = average_vertical(verticals, np.zeros(len(verticals)))
        intrinsics = people.intrinsics
        scene = Scene(
            '', [0], tuple(self._people), (), (1, 1), intrinsics, skeleton=self._skeleton, vertical=known
        )
        self._level = {'toLevel': scene.to_level.tolist(), 'floorY': scene.floor_y}

    def wait(self, number: int) -> bytes:
        """Return the newest frame when there is one with another number; empty if there is none for `WAIT_S`."""
        self._asked_s = time.monotonic()
        with self._changed:
            self._changed.wait_for(lambda: self._number != number and self._frame, WAIT_S)
            return b'' if self._number == number else self._frame


def make_nobody(skeleton: Skeleton, intrinsics: Intrinsics) -> PoseSequence:
    """Return a person without frames."""
    count = len(skeleton.joints)
    return PoseSequence(
        id='',
        times=np.zeros(0),
        skeleton=skeleton,
        joints=np.zeros((0, count, 3)),
        inferred=np.zeros((0, count), bool),
        reprojection_residual=np.zeros(0),
        intrinsics=intrinsics,
    )


class PageServer(ThreadingHTTPServer):
    """Server of a live scene at `address` on this machine, in threads of its own, which the context ends."""

    daemon_threads = True

    def __init__(self, scene: LiveScene, port: int) -> None:
        self.scene = scene
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise MocapError(f'--port {port}: {error.strerror}; choose another') from None
        port = self.server_address[1]
        self.hosts = {f'{HOST}:{port}', f'localhost:{port}'}
        self.address = f'http://{HOST}:{port}/'
        self._thread = threading.Thread(target=self.serve_forever, name='page', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that has gone; anything else is a fault of the program, and is printed."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers `/` with the page, `/frame?after=N` with the newest frame, and `/image?of=N` with the image of one.

    With a frame goes the age of the newest skeletons.
    """

    server: PageServer
    protocol_version = 'HTTP/1.1'
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        """Answer a request from this machine; other names of it, and other pages, are refused."""
        origin = self.headers.get('Origin')
        if self.headers.get('Host') not in self.server.hosts or (
            origin is not None and origin.removeprefix('http://') not in self.server.hosts
        ):
            return self._answer(403, 'text/plain', b'only for pages of this server')
        url = urlsplit(self.path)
        if url.path == '/':
            return self._answer(200, 'text/html; charset=utf-8', self.server.scene.build_page().encode())
        of_image = parse_qs(url.query).get('of', [''])[0]
        if url.path == '/image' and of_image.isdecimal() and of_image.isascii():
            jpeg = self.server.scene.find_image(int(of_image[:18]))
            return self._answer(200 if jpeg else 404, 'image/jpeg', jpeg)
        number = parse_qs(url.query).get('after', [''])[0]
        if url.path == '/frame' and number.isdecimal() and number.isascii():
            frame = self.server.scene.wait(int(number[:18]))
            return self._answer(200 if frame else 204, 'application/json', frame, self.server.scene.age_s)
        return self._answer(404, 'text/plain', b'not found')

    def _answer(self, status: int, kind: str, content: bytes, age_s: float | None = None) -> None:
        self.send_response(status)
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(len(content)))
        self.send_header('Cache-Control', 'no-store')
        self.send_header('X-Content-Type-Options', 'nosniff')
        if age_s is not None:
            self.send_header('Age', str(int(age_s)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Log nothing."""
