# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load what the viewers draw from a bag that holds skeletons, message by message."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

from mocap_ros.bags.journal import JOURNAL, decode_entry
from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.topics import Source, find_people_topics, find_people_type
from mocap_ros.config import NodeConfig
from mocap_ros.errors import FrameDropped, InputError, SkeletonError
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.messages.camera_info import CameraInfo
from mocap_ros.messages.cdr import ENCAPSULATION
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.frame_assembly import FrameAssembler
from mocap_ros.runtime.load_keypoints import find_camera
from mocap_ros.runtime.scene_rows import SceneRows
from mocap_ros.viewing.scene import Scene

# A function that shows progress while the items are iterated; its second argument is their number.
ProgressWrapper = Callable[[Iterable[Any], int], Iterable[Any]]


class _BagReader:
    """Collects skeletons, keypoints and drops of a bag."""

    def __init__(
        self, bag: Bag, limits: NodeConfig, person: str | None, topic: str | None, camera_info: str | None
    ) -> None:
        self._bag = bag
        skeletons = bag.topics_of_type([SKELETONS])
        if len(skeletons) != 1:
            raise InputError(f'the bag has several topics of skeletons: {", ".join(skeletons)}')
        self.rows = SceneRows(person)
        self._journals = [t for t in bag.topics_of_type([JOURNAL]) if t.endswith('/journal')]
        self._sources: dict[str, Source] = {}
        self._node = limits
        self.camera: CameraInfo | None = None
        with suppress(InputError):  # without keypoints the skeletons are drawn nevertheless
            self._sources = find_people_topics(bag, topic)
            self._node = replace(self._node, input_type=find_people_type(bag, self._sources))
            self.camera, remark = find_camera(bag, next(iter(self._sources)), self._node, camera_info)
            self.rows.faults += filter(None, [remark])
        if topic is not None and not self._sources:
            find_people_topics(bag, topic)  # raises the error
        if camera_info is not None and self.camera is None:
            bag.find_camera_info_topic('', camera_info)  # likewise
        self._size = resolve_image_size(
            camera=self.camera.size if self.camera else None,
            configured=(self._node.image_width, self._node.image_height),
        )
        self._assembler = FrameAssembler()
        self.topics = [*skeletons, *self._journals, *self._sources]

    def read(self, progress: ProgressWrapper) -> None:
        """Read all messages."""
        for message in progress(self._bag.messages(self.topics), self._bag.count(self.topics)):
            if message.topic in self._sources:
                self._read_keypoints(message)
            elif message.topic in self._journals:
                self._read_journal(message)
            else:
                self.rows.add_skeletons(message.raw)
        for frame in self._assembler.flush(self._size):
            self.rows.add_keypoints_frame(frame)

    def _read_keypoints(self, message: BagMessage) -> None:
        if message.type == KEYPOINTS:
            self.rows.add_keypoints(message.raw)
            return
        try:
            frames = self._assembler.assemble(
                self._sources[message.topic], message.raw, message.topic, self._node, self._size, inf
            )
        except (InputError, SkeletonError, FrameDropped) as error:
            self.rows.faults.append(f'{message.topic}: {error}')
            return
        for frame in frames:
            self.rows.add_keypoints_frame(frame)

    def _read_journal(self, message: BagMessage) -> None:
        """Note why an input was dropped; the journal's entries of accepted inputs have level 0, the first byte."""
        first = len(ENCAPSULATION)
        if len(message.raw) > first and message.raw[first]:
            with suppress(InputError):
                self.rows.add_drop(decode_entry(message.raw).reason)


def load_bag_scene(
    path: Path,
    limits: NodeConfig,
    person: str | None,
    topic: str | None,
    camera_info: str | None,
    progress: ProgressWrapper,
) -> tuple[Scene, list[str]]:
    """Load the scene of a bag that holds skeletons.

    Args:
        path: the bag.
        limits: limits on the content of a message of keypoints.
        person: id of the only person to show; None for all.
        topic: topic of the keypoints; None for the only one.
        camera_info: topic of the CameraInfo; None for the one that belongs to the keypoints.
        progress: function that shows progress.

    Returns:
        The scene, and lines for the user about messages that were left out.

    Raises:
        InputError: the bag is damaged or shows nobody; the error names the place.
    """
    with Bag(path) as bag:
        try:
            reader = _BagReader(bag, limits, person, topic, camera_info)
            reader.read(progress)
        except InputError as error:
            prefix = '' if str(error).startswith(str(path)) else f'{path}: '
            raise InputError(f'{prefix}{error}') from None
    if not reader.rows.has_people:
        wanted = f'no person {person!r}' if person is not None else 'nobody'
        raise InputError(f'{path}: {wanted} is in any message of skeletons')
    try:
        scene = reader.rows.build(path.name, reader.camera)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    lines = []
    if reader.rows.faults:
        lines.append(f'{path}: {len(reader.rows.faults)} messages left out; {reader.rows.faults[0]}')
    return scene, lines
