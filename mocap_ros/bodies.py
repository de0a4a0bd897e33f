"""People of one image who come one by one, each on a topic of their own, gathered by stamp.

An image is complete when everybody who is tracked has come, or a newer one begins; the clock has no say in it, so
that the same messages in the same order give the same images.
"""

from __future__ import annotations

from collections.abc import Collection

from mocap_ros.errors import FrameDropped
from mocap_ros.io.messages import NS, Header, KeypointsFrame
from mocap_ros.people import Person2D

Frames = list[KeypointsFrame]


class BodyGroups:
    """The image that is being gathered, and who is expected in it."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the image, who is tracked, and every stamp."""
        self._tracked: frozenset[str] = frozenset()
        self._header: Header | None = None
        self._people: dict[str, Person2D] = {}
        self._newest = -1

    def track(self, header: Header, ids: Collection[str], size: tuple[int, int]) -> Frames:
        """Take who is tracked from now on.

        Args:
            header: of the image in which they are.
            ids: of everybody.
            size: of the image, px.

        Returns:
            The images that are complete now; where nobody is tracked, one without people.
        """
        self._tracked = frozenset(ids)
        if self._tracked:
            return self._complete(size)
        frames = self._finished(size)
        if header.stamp_ns > self._newest:
            self._newest = header.stamp_ns
            frames.append(KeypointsFrame(header, *size, ()))
        return frames

    def add(self, header: Header, person: Person2D, size: tuple[int, int], restart_after: float) -> Frames:
        """Take a person.

        Args:
            header: of the person's image.
            person: with a name.
            size: of the image, px.
            restart_after: s that a stamp must go back to begin anew.

        Returns:
            The images that are complete now.

        Raises:
            FrameDropped: the image was complete already, or the person is in it.
        """
        stamp, frames = header.stamp_ns, []
        current = self._newest if self._header is None else self._header.stamp_ns
        restart = current - stamp > restart_after * NS
        if self._header is None or stamp > current or restart:
            if self._header is None and stamp <= current and not restart:
                raise FrameDropped(f'stamp {stamp} ns comes after its image was complete')
            frames = self._finished(size)
            self._header = header
        elif stamp < current:
            raise FrameDropped(f'stamp {stamp} ns comes after its image was complete')
        elif person.id in self._people:
            raise FrameDropped(f'stamp {stamp} ns repeats that of the message before')
        self._people[person.id] = person
        return frames + self._complete(size)

    def _complete(self, size: tuple[int, int]) -> Frames:
        whole = self._header is not None and self._tracked and self._tracked <= self._people.keys()
        return self._finished(size) if whole else []

    def _finished(self, size: tuple[int, int]) -> Frames:
        header, people = self._header, self._people
        self._header, self._people = None, {}
        if header is None:
            return []
        self._newest = header.stamp_ns
        return [KeypointsFrame(header, *size, tuple(people[i] for i in sorted(people)))]
