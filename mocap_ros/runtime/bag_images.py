# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The images of a bag as JPEG or PNG, one at a time, for the viewers that draw the 2D input over them."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath

from PIL import Image as Pillow

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import find_people_topics
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import decode, validate_header
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE_TYPES, decode_image
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import SceneImage

JPEG_QUALITY = 75  # of 100; for a picture behind skeletons
MEDIA_TYPES = {b'\xff\xd8': 'image/jpeg', b'\x89P': 'image/png'}  # by the first bytes of a compressed image


def find_image_topic(bag: Bag, limits: NodeConfig, topic: str | None = None) -> str | None:
    """Return the topic of images that shares most of its namespace with the keypoints.

    Of several that share equally much of it, the first is taken that can be drawn; images of depth, which have
    `depth` in the name of their topic (REP 118), come last.

    Args:
        bag: the bag.
        limits: limits on the length of a text.
        topic: topic of the keypoints; needed only for a bag with several.

    Returns:
        The topic; None where there is none that can be drawn.
    """
    reference = {*PurePosixPath(topic or _find_topic_of_people(bag)).parents}
    shared = {n: len(reference & {*PurePosixPath(n).parents}) for n in bag.topics_of_type(IMAGE_TYPES)}
    nearest = [name for name, count in shared.items() if count == max(shared.values())]
    ordered = sorted(nearest, key=lambda name: 'depth' in name)
    return next((name for name in ordered if _has_picture(bag, name, limits)), None)


def _find_topic_of_people(bag: Bag) -> str:
    """Return the topic of keypoints, or where a bag has none or several, of skeletons; empty without both."""
    with suppress(InputError):
        return next(iter(find_people_topics(bag)))
    return next(iter(bag.topics_of_type([SKELETONS])), '')


def _has_picture(bag: Bag, topic: str, limits: NodeConfig) -> bool:
    """Return whether the first image of a topic can be drawn."""
    message = next(bag.messages([topic]))
    with suppress(InputError):
        return _read_image(message.raw, message.type, limits)[1][:2] in MEDIA_TYPES
    return False


def read_images(
    path: Path, stamps_ns: Sequence[int], limits: NodeConfig, topic: str | None = None
) -> Iterator[SceneImage]:
    """Yield the images of a bag that belong to a scene; images that cannot be read are left out.

    Args:
        path: the bag.
        stamps_ns: times of the frames of the scene in ns; images before the first and after the last are left out.
        limits: limits on the length of a text.
        topic: topic of the keypoints; needed only for a bag with several.

    Raises:
        InputError: the bag is damaged.
    """
    with Bag(path) as bag:
        images = find_image_topic(bag, limits, topic)
        for message in bag.messages([images] if images else []):
            try:
                stamp_ns, data = _read_image(message.raw, message.type, limits)
            except InputError:
                continue
            media_type = MEDIA_TYPES.get(data[:2])
            if media_type and stamps_ns[0] <= stamp_ns <= stamps_ns[-1]:
                yield SceneImage((stamp_ns - stamps_ns[0]) / NS_PER_S, data, media_type)


def _read_image(raw: bytes, msgtype: str, limits: NodeConfig) -> tuple[int, bytes]:
    """Return the stamp in ns and the compressed image.

    Raises:
        InputError: the message is not valid, or JPEG cannot hold its image, as one with a side above 65,500 px.
    """
    if msgtype == COMPRESSED_IMAGE:
        message = decode(raw, msgtype)
        return validate_header(message.header, limits).stamp_ns, message.data.tobytes()
    header, pixels = decode_image(raw, msgtype, limits)
    stream = io.BytesIO()
    try:
        Pillow.fromarray(pixels).save(stream, 'JPEG', quality=JPEG_QUALITY)
    except OSError as error:
        raise InputError(f'the image cannot be written as JPEG ({error})') from None
    return header.stamp_ns, stream.getvalue()
