# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which camera's images are used where messages of several cameras arrive on one topic.

A camera is known by the `frame_id` of its images. Another camera takes over where the one in use has been silent
for `SILENCE_S`: at once if its own stamps are that much later or earlier, which is all that can be known of a
camera that is seen for the first time. A camera that was in use before has a known clock: with t its stamp, t_0
the last one with which it was in use, and a the time for which other cameras have sent since, it takes over if

    (t - t_0) - a >= SILENCE_S

so that two cameras whose clocks differ do not displace each other at each image. Only stamps count, no time of
arrival, so that a replay decides alike.
"""

from __future__ import annotations

from typing import NamedTuple

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import Header
from mocap_ros.units import NS_PER_S

SILENCE_S = 1.0  # s; without images of one camera, before those of another are taken as a move of the input
SILENCE_NS = round(SILENCE_S * NS_PER_S)
MAX_DISPLACED = 16  # cameras whose clocks are remembered, the last ones; guards memory against ever new names


class _Moment(NamedTuple):
    """When a camera was displaced: its own stamp, and the `CameraSwitch._sent_ns` of that time, both in ns."""

    stamp_ns: int
    sent_ns: int


class CameraSwitch:
    """Decides for each image whether it is of the camera in use, displaces that camera, or is refused.

    Attributes:
        name: The last `frame_id` of the camera in use that was not empty; empty before the first.
    """

    def __init__(self) -> None:
        self.name = ''
        self._stamp_ns = 0  # of the last image
        self._sent_ns = 0  # for which images have been used, without the gaps between them
        self._displaced: dict[str, _Moment] = {}

    def check(self, header: Header) -> str:
        """Return a remark where another camera takes over, so that tracking must be restarted; otherwise ''.

        A message without a `frame_id` is of the camera in use.

        Raises:
            InputError: Two cameras send in turn.
        """
        name = header.frame_id
        if not self.name or name in ('', self.name):
            return ''
        if not self._is_silent_for(header):
            raise InputError(
                f'header.frame_id: {name!r}, but the people of {self.name!r} are being tracked; '
                'run a node for each camera'
            )
        return f'the camera {self.name!r} is called {name!r} now or is another one, so tracking was restarted'

    def accept(self, header: Header) -> None:
        """Note that an image is used."""
        name = header.frame_id or self.name
        if name == self.name:
            elapsed_ns = header.stamp_ns - self._stamp_ns
            self._sent_ns += elapsed_ns if 0 < elapsed_ns < SILENCE_NS else 0
        elif self.name:
            self._displaced.pop(name, None)
            self._displaced[self.name] = _Moment(self._stamp_ns, self._sent_ns)
            if len(self._displaced) > MAX_DISPLACED:
                del self._displaced[next(iter(self._displaced))]
        self.name, self._stamp_ns = name, header.stamp_ns

    def _is_silent_for(self, header: Header) -> bool:
        """Return whether the camera in use is silent, as far as an image of another camera tells."""
        if abs(header.stamp_ns - self._stamp_ns) < SILENCE_NS:
            return False
        moment = self._displaced.get(header.frame_id)
        if moment is None:
            return True
        elapsed_ns = header.stamp_ns - moment.stamp_ns
        if elapsed_ns < 0:  # its clock was set back; what follows is compared with this image
            self._displaced[header.frame_id] = _Moment(header.stamp_ns, self._sent_ns)
            return False
        return elapsed_ns - (self._sent_ns - moment.sent_ns) >= SILENCE_NS
