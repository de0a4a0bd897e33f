"""The people in each image, from messages of any type.

People who come one by one, each on a topic of their own, are gathered by stamp. Their image is complete when
everybody who is tracked has come, or a newer one begins; the clock has no say in it, so that the same messages in
the same order give the same images.
"""

from __future__ import annotations

from collections.abc import Collection

from mocap_ros.bags.topics import Source, body_of
from mocap_ros.config import NodeConfig
from mocap_ros.errors import FrameDropped
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.accepted import decode_frame
from mocap_ros.messages.cdr import NS, Header
from mocap_ros.messages.foreign.hri import decode_body, decode_ids
from mocap_ros.messages.keypoints import KeypointsFrame

NO_STAMP = 'header.stamp is not set'

Frames = list[KeypointsFrame]


class PeopleReader:
    """What every run and every reader of a bag makes of the messages of people."""

    def __init__(self) -> None:
        self._bodies = BodyGroups()

    def reset(self) -> None:
        """Forget what is being gathered."""
        self._bodies.reset()

    def read(
        self, source: Source, raw: bytes, topic: str, node: NodeConfig, size: tuple[int, int], restart_after: float
    ) -> Frames:
        """Take a message.

        Args:
            source: what it is; one of `sources.PEOPLE_SOURCES`.
            raw: CDR.
            topic: on which it came; that of a body names it.
            node: the type of keypoints, and the most that a message may hold.
            size: of images whose messages do not say it, px; 0 where unknown.
            restart_after: s that a stamp must go back for bodies to begin anew.

        Returns:
            The images that are complete now.

        Raises:
            InputError: the message cannot be used; names the field.
            FrameDropped: its image was complete already, or the person is in it.
        """
        if source is Source.KEYPOINTS:
            return [decode_frame(raw, node.input_type, node, size)]
        if source is Source.TRACKED:
            return self._bodies.track(*decode_ids(raw, node), size)
        return self._bodies.add(*decode_body(raw, body_of(topic), size, node), size, restart_after)

    def rest(self, size: tuple[int, int]) -> Frames:
        """The image that was not complete when no more messages came."""
        return self._bodies.rest(size)


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
        frames = self.rest(size)
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
        if stamp > current or current - stamp > restart_after * NS:
            frames = self.rest(size)
            self._header = header
        elif self._header is None or stamp < current:
            raise FrameDropped(f'stamp {stamp} ns comes after its image was complete' if stamp else NO_STAMP)
        elif person.id in self._people:
            raise FrameDropped(f'stamp {stamp} ns repeats that of the message before' if stamp else NO_STAMP)
        self._people[person.id] = person
        return frames + self._complete(size)

    def _complete(self, size: tuple[int, int]) -> Frames:
        whole = self._header is not None and self._tracked and self._tracked <= self._people.keys()
        return self.rest(size) if whole else []

    def rest(self, size: tuple[int, int]) -> Frames:
        """The image that is being gathered, as it is."""
        header, people = self._header, self._people
        self._header, self._people = None, {}
        if header is None:
            return []
        self._newest = header.stamp_ns
        return [KeypointsFrame(header, *size, tuple(people[i] for i in sorted(people)))]
