"""ROS messages as CDR bytes: what all of them share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.definitions import DEFINITIONS

Array = NDArray[np.float64]


ROS_DISTRO = 'kilted'


NS = 1_000_000_000


WORD = 4


OWN = 'mocap_ros_msgs/msg/'


class Header(NamedTuple):
    """Time of an image in ns and the camera's optical frame."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True)
class OutputMessage:
    """A message to publish and to record.

    Attributes:
        topic: relative name.
        type: such as `visualization_msgs/msg/MarkerArray`.
        stamp_ns: header.stamp.
        data: CDR.
    """

    topic: str
    type: str
    stamp_ns: int
    data: bytes


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """The standard messages of ROS 2, those of mocap_ros_msgs, and the foreign ones that are taken as input."""
    store = get_typestore(Stores.ROS2_KILTED)
    own: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        own.update(get_types_from_msg(text, name))
    for definition in (files('mocap_ros') / 'messages' / 'msg').iterdir():
        if definition.name.endswith('.msg'):
            text = definition.read_text(encoding='utf-8')
            own.update(get_types_from_msg(text, OWN + definition.name.removesuffix('.msg')))
    store.register(own)
    return store


def new(msgtype: str, **values: Any) -> Any:
    """A message object of that type."""
    return typestore().types[msgtype](**values)


def encode(message: Any, msgtype: str) -> bytes:
    """A message object as CDR, padded to whole words as DDS does it: what is recorded is what is received."""
    raw = bytes(typestore().serialize_cdr(message, msgtype))
    return raw + bytes(-len(raw) % WORD)


def decode(raw: bytes, msgtype: str) -> Any:
    """CDR as a message object.

    Raises:
        InputError: not a message of that type.
    """
    try:
        return typestore().deserialize_cdr(raw, msgtype)
    except Exception as error:  # bytes of a stranger: any reader error ends up here
        reason = str(error).removeprefix(f"Could not deserialize '{msgtype}': ").rstrip('.')
        raise InputError(f'not a {msgtype} ({reason}; {len(raw)} bytes)') from None


def checked_header(header: Any, limits: NodeConfig) -> Header:
    """A std_msgs/Header, checked.

    Raises:
        InputError: a stamp that is no time, or a frame_id that is too long.
    """
    seconds, nanoseconds = header.stamp.sec, header.stamp.nanosec
    if seconds < 0 or nanoseconds >= NS:
        raise InputError(f'header.stamp: {seconds} s {nanoseconds} ns is no time')
    return Header(seconds * NS + nanoseconds, checked_text(header.frame_id, 'header.frame_id', limits))


def checked_text(text: str, field: str, limits: NodeConfig) -> str:
    """The text, where it is not too long.

    Raises:
        InputError: it is; names the field.
    """
    if len(text) > limits.max_text:
        raise InputError(f'{field}: {len(text)} characters, more than {limits.max_text}')
    return text


def new_header(header: Header) -> Any:
    """As std_msgs/Header."""
    seconds, nanoseconds = divmod(header.stamp_ns, NS)
    stamp = new('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)
    return new('std_msgs/msg/Header', stamp=stamp, frame_id=header.frame_id)


def new_points(positions: Array) -> list[Any]:
    """(N, 3) m as geometry_msgs/Point."""
    point = typestore().types['geometry_msgs/msg/Point']
    return [point(*p) for p in positions.tolist()]
