# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Conversion of messages from one version of their type to another.

Fields are matched by their names. A field that only the target has is zero or empty, and a field that only the
source has is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.convert.converter import migrate_bytes, migrate_message
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import pad

# A function that converts a message, as CDR, from one version of its type to another.
Convert = Callable[[bytes], bytes]

FieldType = Any  # type of a field as rosbags describes it: (kind, content), where the content depends on the kind
Fields = dict[str, FieldType]

FLOATS = {'float32', 'float64'}  # types of which each can hold the values of the other, rounded
NUMPY_NAMES = {'byte': 'uint8', 'char': 'uint8'}  # NumPy's names of basic types, where ROS has other names


class VersionConverter:
    """Converter of messages of one type.

    The library would also match fields of different names if their types are equal. It is therefore given messages
    in which only the fields that both versions have are left.

    Args:
        source: definitions of the messages that are converted.
        target: definitions of the converted messages.
        msgtype: name of the message type, which both define.

    Attributes:
        left_out: fields of the source that the target does not have, such as `std_msgs/msg/Header.seq`.
        unconvertible: descriptions of the fields of both versions whose content may not fit into the target, such
            as `std_msgs/msg/Header.stamp is int32 instead of builtin_interfaces/msg/Time`.
    """

    def __init__(self, source: Typestore, target: Typestore, msgtype: str) -> None:
        self._source, self._target, self._type = source, target, msgtype
        self.left_out: list[str] = []
        self.unconvertible: list[str] = []
        self._shared = get_typestore(Stores.EMPTY)
        selected = self._select_shared_fields()
        self._shared.register({name: ([], list(fields.items())) for name, fields in selected.items()})
        self._to_shared_cache: dict[str, object] = {}
        self._to_target_cache: dict[str, object] = {}

    def __call__(self, raw: bytes) -> bytes:
        """Convert a message.

        Args:
            raw: the message as CDR of the source's version.

        Raises:
            InputError: the bytes are not such a message.
        """
        kind = self._type
        try:
            message: object = self._source.deserialize_cdr(raw, kind)
            message = migrate_message(self._source, self._shared, kind, kind, self._to_shared_cache, message)
            message = migrate_message(self._shared, self._target, kind, kind, self._to_target_cache, message)
            data = self._target.serialize_cdr(message, kind)
        except Exception as error:  # the decoder raises many types of errors for invalid bytes
            raise InputError(f'not a {kind} ({error})') from None
        return pad(bytes(data))

    def _select_shared_fields(self) -> dict[str, Fields]:
        """Return the fields of every type of the source that the target has too; note all other differences."""
        selected: dict[str, Fields] = {}
        pending, visited = [(self._type, self._type)], set()
        while pending:
            pair = source_type, target_type = pending.pop()
            if pair in visited:
                continue
            visited.add(pair)
            target_fields = dict(self._target.fielddefs[target_type][1])
            shared = {}
            for name, field_type in self._source.fielddefs[source_type][1]:
                if name not in target_fields:
                    self.left_out.append(f'{source_type}.{name}')
                    continue
                if not _fits(field_type, target_fields[name]):
                    was, now = _describe(field_type), _describe(target_fields[name])
                    self.unconvertible.append(f'{source_type}.{name} is {now} instead of {was}')
                nested = _get_nested_type(field_type), _get_nested_type(target_fields[name])
                if nested[0] and nested[1]:
                    pending.append((nested[0], nested[1]))
                if bool(nested[0]) == bool(nested[1]):
                    shared[name] = field_type
            previous = selected.get(source_type, shared)
            selected[source_type] = {name: f for name, f in shared.items() if name in previous}
        return selected


def convert_or_keep(convert: Convert) -> Convert:
    """Return a function that converts messages, and that returns bytes that are no such message as they are.

    A live run and a replay treat such bytes alike: the decoder of the messages reports them, and the run goes on.
    """

    def convert_if_valid(raw: bytes) -> bytes:
        try:
            return convert(raw)
        except InputError:
            return bytes(raw)

    return convert_if_valid


def make_ros1_converter(source: Typestore, target: Typestore, msgtype: str) -> Convert:
    """Return a function that converts messages of ROS 1 to CDR of ROS 2.

    A field whose name only the target has takes the first field of equal type whose name only the source has,
    because ROS 2 renamed fields such as `D` of CameraInfo. The function raises InputError for bytes that are no
    such message.

    Args:
        source: definitions of the messages of ROS 1.
        target: definitions of the converted messages.
        msgtype: name of the message type, which both define.
    """
    cache: dict[str, object] = {}

    def convert(raw: bytes) -> bytes:
        try:
            return pad(
                bytes(migrate_bytes(source, target, msgtype, msgtype, cache, raw, src_is2=False, dst_is2=True))
            )
        except Exception as error:  # the decoder raises many types of errors for invalid bytes
            raise InputError(f'not a {msgtype} ({error})') from None

    return convert


def _get_nested_type(field_type: FieldType) -> str:
    """Return the message type of a field or of its elements; an empty string where they are of a basic type."""
    kind, content = field_type
    if kind in (Nodetype.SEQUENCE, Nodetype.ARRAY):
        return _get_nested_type(content[0])
    return str(content) if kind == Nodetype.NAME else ''


def _fits(source: FieldType, target: FieldType) -> bool:
    """Return whether a field of the target can hold every value of a field of the source, up to rounding."""
    (source_kind, content), (target_kind, target_content) = source, target
    if Nodetype.NAME in (source_kind, target_kind):
        return bool(source_kind == target_kind)
    if Nodetype.BASE in (source_kind, target_kind):
        return bool(source_kind == target_kind) and _basic_type_fits(content, target_content)
    (element, length), (target_element, target_length) = content, target_content
    if target_kind == Nodetype.ARRAY:
        length_fits = source_kind == target_kind and length == target_length
    else:
        length_fits = not target_length or 0 < length <= target_length
    return bool(length_fits) and _fits(element, target_element)


def _basic_type_fits(source: tuple[str, int], target: tuple[str, int]) -> bool:
    """Return whether a basic type, given as its name and the largest length of a string, can hold another."""
    (name, length), (target_name, target_length) = source, target
    if 'string' in name or 'string' in target_name:
        return name == target_name and (not target_length or 0 < length <= target_length)
    if {name, target_name} <= FLOATS:
        return True
    return np.can_cast(NUMPY_NAMES.get(name, name), NUMPY_NAMES.get(target_name, target_name))


def _describe(field_type: FieldType) -> str:
    """Return the type of a field as .msg files name it."""
    kind, content = field_type
    if kind == Nodetype.BASE:
        name, length = content
        return f'{name}<={length}' if length else str(name)
    if kind == Nodetype.NAME:
        return str(content)
    element, length = content
    bound = f'<={length}' if kind == Nodetype.SEQUENCE and length else length or ''
    return f'{_describe(element)}[{bound}]'
