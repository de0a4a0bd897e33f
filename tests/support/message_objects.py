# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages as objects of rosbags, as others write them; the package writes its own from plain values."""

from __future__ import annotations

from typing import Any

from mocap_ros.messages.cdr import Header, pad, typestore
from mocap_ros.units import NS_PER_S


def create_message(msgtype: str, **values: Any) -> Any:
    return typestore().types[msgtype](**values)


def create_header(header: Header) -> Any:
    seconds, nanoseconds = divmod(header.stamp_ns, NS_PER_S)
    stamp = create_message('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)
    return create_message('std_msgs/msg/Header', stamp=stamp, frame_id=header.frame_id)


def encode(message: Any, msgtype: str) -> bytes:
    return pad(bytes(typestore().serialize_cdr(message, msgtype)))
