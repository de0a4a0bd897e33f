# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Read the images behind the keypoints: those of a video, or of a bag."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import find_people_topics
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.video import VideoReader
from mocap_ros.messages.images import IMAGE_TYPES, decode_image
from mocap_ros.runtime.input_kind import InputKind, find_input_kind
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.overlay import StampedImage


def read_images(path: Path, limits: NodeConfig, topic: str | None, notes: list[str]) -> Iterator[StampedImage]:
    """Yield the images of a video or a bag; none of any other input. `notes` gets a line about those left out.

    Of several cameras in a bag it is that of this topic of keypoints.
    """
    kind = find_input_kind(path)
    if kind is InputKind.VIDEO:
        with VideoReader(path) as reader:
            for image, time_s in reader:
                yield StampedImage(round(time_s * NS_PER_S), image)
    elif kind is InputKind.BAG:
        with Bag(path) as bag:
            yield from _read_bag_images(bag, limits, topic, notes)


def _read_bag_images(bag: Bag, limits: NodeConfig, topic: str | None, notes: list[str]) -> Iterator[StampedImage]:
    """Yield the images of the topic whose name begins most like that of the keypoints, of several cameras."""
    keypoints = topic or '/'
    with suppress(InputError):
        keypoints = next(iter(find_people_topics(bag, topic)))
    candidates = [name for name in bag.topics_of_type(IMAGE_TYPES) if 'depth' not in name]
    if not candidates:
        return
    chosen = max(candidates, key=lambda name: len(os.path.commonpath([name, keypoints])))
    faults: list[str] = []
    for message in bag.messages([chosen]):
        try:
            header, image = decode_image(message.raw, bag.topics[chosen], limits)
        except InputError as error:
            faults.append(str(error))
            continue
        yield StampedImage(header.stamp_ns, image)
    if faults:
        notes.append(f'{bag.path}: {chosen}: {len(faults)} images left out; {faults[0]}')
