# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Assemble the people of each image from the messages of any detector.

Most detectors send one message for each image. ROS4HRI sends one message for each body, each on its own topic, and
the list of tracked bodies on another topic. Such messages are grouped by stamp. An image is complete when every
tracked body has arrived or when a body of a newer image arrives. No clock is read, so that the same messages in
the same order always give the same images.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from mocap_ros.bags.topics import Source, parse_body_id
from mocap_ros.config import NodeConfig
from mocap_ros.errors import FrameDropped
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.input_types import decode_body, decode_frame, decode_ids
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.units import NS_PER_S

# Reason for rejecting a stamp of 0 that repeats, or comes among stamps of a clock: the publisher did not set it.
MISSING_STAMP = "header.stamp is not set: copy the stamp of the detector's image"
# ns; a recording's own time starts near 0 and stays below this (11 days), a clock that counts from 1970 is above
MIN_CLOCK_STAMP_NS = 1_000_000 * NS_PER_S

Frames = list[KeypointsFrame]  # completed images, oldest first


def is_stamp_missing(stamp_ns: int, newest_ns: int) -> bool:
    """Return whether a stamp was not set: it is 0 where the newest of the other stamps is that of a clock."""
    return stamp_ns == 0 and newest_ns >= MIN_CLOCK_STAMP_NS


class FrameAssembler:
    """Decoder of all messages that hold people; it returns an image as soon as the image is complete."""

    def __init__(self) -> None:
        self._tracked_ids: frozenset[str] = frozenset()
        self.reset()

    def reset(self) -> None:
        """Discard the incomplete image and all stamps; the list of bodies, which is sent on changes, stays."""
        self._header: Header | None = None
        self._people: dict[str, Person2D] = {}
        self._newest_complete_ns = -1
        self._restart_ns = 0.0
        self._size = UNKNOWN_SIZE

    def assemble(
        self, source: Source, raw: bytes, topic: str, node: NodeConfig, size: tuple[int, int], restart_after: float
    ) -> Frames:
        """Decode a message of one of `topics.PEOPLE_SOURCES` and return the images that are complete now.

        The topic of a ROS4HRI body contains the body's id. The size in px is that of images whose messages do not
        state it, 0 where unknown. A stamp that is earlier than that of the current image by more than
        `restart_after` s begins a sequence. FrameDropped where a body came after its image was complete, or its
        image has it already.
        """
        if source is Source.KEYPOINTS:
            frame = decode_frame(raw, node.input_type, node, size)
            size = resolve_image_size(stated=(frame.image_width, frame.image_height), configured=size)
            return [replace(frame, people=tuple(person.hide_border(size) for person in frame.people))]
        self._size, self._restart_ns = size, restart_after * NS_PER_S
        if source is Source.TRACKED_BODIES:
            return self._set_tracked_ids(*decode_ids(raw, node))
        header, person = decode_body(raw, parse_body_id(topic), size, node)
        return self._add_body(header, person.hide_border(size))

    def flush(self) -> Frames:
        """Return the current image with the bodies that have arrived, if any, and start without one."""
        header, people = self._header, self._people
        self._header, self._people = None, {}
        if header is None:
            return []
        self._newest_complete_ns = header.stamp_ns
        return [KeypointsFrame(header, *self._size, tuple(people[i] for i in sorted(people)))]

    def _set_tracked_ids(self, header: Header, ids: Collection[str]) -> Frames:
        self._tracked_ids = frozenset(ids)
        if self._tracked_ids:
            return self._flush_if_complete()
        frames = self.flush()
        if self._is_new(header.stamp_ns, self._newest_complete_ns):
            self._newest_complete_ns = header.stamp_ns
            frames.append(KeypointsFrame(header, *self._size, ()))
        return frames

    def _add_body(self, header: Header, person: Person2D) -> Frames:
        stamp, frames = header.stamp_ns, []
        current = self._newest_complete_ns if self._header is None else self._header.stamp_ns
        if self._is_new(stamp, current):
            frames = self.flush()
            self._header = header
        elif self._header is None or stamp < current or person.id in self._people:
            is_late = self._header is None or stamp < current
            what = 'the message came after its image was complete' if is_late else 'a body of this image repeats'
            raise FrameDropped(f'stamp {stamp} ns: {what}' if stamp else MISSING_STAMP)
        self._people[person.id] = person
        return frames + self._flush_if_complete()

    def _is_new(self, stamp_ns: int, current_ns: int) -> bool:
        return stamp_ns > current_ns or current_ns - stamp_ns > self._restart_ns

    def _flush_if_complete(self) -> Frames:
        is_complete = self._header is not None and self._tracked_ids and self._tracked_ids <= self._people.keys()
        return self.flush() if is_complete else []
