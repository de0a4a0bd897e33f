# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Message objects from CDR bytes, and the parts that all messages share."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.foreign_types import DEFINITIONS
from mocap_ros.units import NS_PER_S

DEFINITIONS_DISTRO = 'kilted'  # the distribution whose definitions of the standard messages are used
CDR_ALIGNMENT_BYTES = 4  # DDS (RTPS) pads every payload to a multiple of this length
# Guards the time of the decoder, which takes up to a second for so many bytes. A message of 20 people is below
# 100 kB, and the outline of each of them below 20 kB.
MAX_INPUT_BYTES = 4_000_000
MOCAP_ROS_MSGS = 'mocap_ros_msgs/msg/'  # prefix of the type names of this package's own messages
ENCAPSULATION = b'\0\1\0\0'  # the first bytes of a message: CDR, little endian
STAMP_BYTES, LENGTH_BYTES = 8, 4  # of a stamp, and of the number of bytes of a text that follows
BIG_ENDIAN = b'\0\0'  # the first bytes of a message in the other order of bytes


class Header(NamedTuple):
    """The content of a std_msgs/Header."""

    stamp_ns: int  # ROS time in ns; for what was seen in an image, the time at which the image was taken
    frame_id: str  # name of the coordinate frame of the content, mostly the camera's optical frame; may be empty


@dataclass(frozen=True)
class OutputMessage:
    """A message to publish and to record."""

    topic: str
    type: str
    stamp_ns: int  # `header.stamp` in ns
    data: bytes


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return the definitions of all messages that are read or written, of ROS 2 and of other packages."""
    store = get_typestore(Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    for definition in (files('mocap_ros') / 'messages' / 'msg').iterdir():
        if definition.name.endswith('.msg'):
            text = definition.read_text(encoding='utf-8')
            types.update(get_types_from_msg(text, MOCAP_ROS_MSGS + definition.name.removesuffix('.msg')))
    store.register(types)
    return store


def pad(content: bytes) -> bytes:
    """Append zeros up to a multiple of `CDR_ALIGNMENT_BYTES`."""
    return content + bytes(-len(content) % CDR_ALIGNMENT_BYTES)


def decode(raw: bytes, msgtype: str) -> Any:
    """Decode CDR as a message object; InputError if the bytes are not a message of that type."""
    try:
        return typestore().deserialize_cdr(raw, msgtype)
    except Exception as error:  # the bytes may come from anywhere, so the reader may raise anything
        reason = str(error).removeprefix(f"Could not deserialize '{msgtype}': ").rstrip('.')
        raise InputError(f'not a {msgtype} ({reason}; {len(raw)} bytes)') from None


def decode_input(raw: bytes, msgtype: str) -> Any:
    """Decode an input message, as `decode` does, that is not too large: InputError if it is."""
    if len(raw) > MAX_INPUT_BYTES:
        raise InputError(f'{len(raw)} bytes, more than a {msgtype} may have ({MAX_INPUT_BYTES})')
    return decode(raw, msgtype)


def read_stamp_ns(raw: bytes) -> int:
    """Return the stamp in ns of a message that is not decoded for it, and begins with a std_msgs/Header.

    It is 0 where the bytes end before it, as the decoder will report.
    """
    try:
        order = '>' if raw[:2] == BIG_ENDIAN else '<'
        seconds, nanoseconds = struct.unpack_from(f'{order}iI', raw, len(ENCAPSULATION))
    except struct.error:
        return 0
    return int(seconds) * NS_PER_S + int(nanoseconds)


def read_frame_id(raw: bytes) -> str:
    """Return the `frame_id` of such a message, likewise; it is empty where the bytes end before it."""
    try:
        order = '>' if raw[:2] == BIG_ENDIAN else '<'
        (length,) = struct.unpack_from(f'{order}I', raw, len(ENCAPSULATION) + STAMP_BYTES)
    except struct.error:
        return ''
    start = len(ENCAPSULATION) + STAMP_BYTES + LENGTH_BYTES
    return raw[start : start + length].rstrip(b'\0').decode(errors='replace')


def validate_header(header: Any, limits: NodeConfig) -> Header:
    """Return the content of a std_msgs/Header; InputError if its time is not valid or the frame_id too long."""
    return Header(validate_stamp(header.stamp), validate_text(header.frame_id, 'header.frame_id', limits))


def validate_stamp(stamp: Any) -> int:
    """Return the stamp of a header, a builtin_interfaces/Time, in ns; InputError if it is not a valid time."""
    if stamp.sec < 0 or stamp.nanosec >= NS_PER_S:
        raise InputError(f'header.stamp: {stamp.sec} s {stamp.nanosec} ns is not a valid time')
    return read_stamp(stamp)


def read_stamp(stamp: Any) -> int:
    """Return a stamp, a builtin_interfaces/Time, in ns."""
    return int(stamp.sec * NS_PER_S + stamp.nanosec)


def validate_text(text: str, field: str, limits: NodeConfig) -> str:
    """Return the text of a field; InputError if it is longer than `limits.max_text`."""
    if len(text) > limits.max_text:
        raise InputError(f'{field}: {len(text)} characters, more than {limits.max_text}')
    return text
