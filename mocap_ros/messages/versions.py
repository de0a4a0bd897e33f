# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Conversion of messages from one version of their type to another.

Fields are matched by their names, without regard to upper case, in which ROS 1 has those of CameraInfo. A field
that only the target has is zero or empty, as is one of another kind; a field that only the source has is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import pad

# A function that converts a message, as CDR, from one version of its type to another.
Convert = Callable[[bytes], bytes]

FieldType = Any  # type of a field as rosbags describes it: (kind, content), where the content depends on the kind
IDL_HEADING = re.compile(r'^={80}\nIDL: .*\n', re.MULTILINE)  # separates the types in a definition in IDL
MAX_DEFINITION_CHARACTERS = 50_000  # of a type and those of its fields, parsed in 1 s; ROS has up to 20,000


def load_recorded_types(text: str, msgtype: str, *, is_idl: bool) -> Typestore:
    """Return the message types of a definition, from a bag, of a type and of the types of its fields.

    InputError if it is too long, as a program is made of it; the parser raises almost anything for damaged text.
    """
    if len(text) > MAX_DEFINITION_CHARACTERS:
        raise InputError(f'{len(text)} characters, more than {MAX_DEFINITION_CHARACTERS}')
    store = get_typestore(Stores.EMPTY)
    if is_idl:
        for part in IDL_HEADING.split(text):
            store.register(get_types_from_idl(part) if part.strip() else {})
    else:
        store.register(get_types_from_msg(text, msgtype))
    return store


def make_converter(
    source: Typestore, target: Typestore, msgtype: str, new_type: str = '', *, is_ros1: bool = False
) -> Convert:
    """Return a function that converts messages of a type, which `source` defines, to CDR of another version of it.

    It raises InputError for bytes that are no such message; with `is_ros1` these are in the encoding of ROS 1.
    `new_type` is the name of the type in `target`, if it is another.
    """
    new_type = new_type or msgtype

    def convert(raw: bytes) -> bytes:
        try:
            message = (source.deserialize_ros1 if is_ros1 else source.deserialize_cdr)(raw, msgtype)
            converted = _convert(message, (Nodetype.NAME, new_type), target)
            return pad(bytes(target.serialize_cdr(converted, new_type)))
        except Exception as error:  # the decoder raises many types of errors for invalid bytes
            raise InputError(f'not a {msgtype} ({error})') from None

    return convert


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


def compare_versions(source: Typestore, target: Typestore, msgtype: str) -> tuple[list[str], list[str]]:
    """Return the fields, such as `std_msgs/msg/Header.seq`, that the target lacks, and those of other types."""
    left_out, changed, types = [], [], [msgtype]
    for name in types:
        target_fields = dict(target.fielddefs[name][1])
        for field, field_type in source.fielddefs[name][1]:
            if field not in target_fields:
                left_out.append(f'{name}.{field}')
            elif field_type != target_fields[field]:
                changed.append(f'{name}.{field}')
            else:
                nested = _get_nested_type(field_type)
                types += [nested] if nested and nested not in types else []
    return left_out, changed


def _get_nested_type(field_type: FieldType) -> str:
    kind, content = field_type
    if kind in (Nodetype.SEQUENCE, Nodetype.ARRAY):
        return _get_nested_type(content[0])
    return str(content) if kind == Nodetype.NAME else ''


def _convert(value: Any, field_type: FieldType, store: Typestore) -> Any:
    """Return a value as one of a type of a store; zero or empty where it is of another kind."""
    kind, content = field_type
    if kind == Nodetype.BASE:
        default: str | int = '' if 'string' in content[0] else 0
        return value if isinstance(value, str) == isinstance(default, str) and np.isscalar(value) else default
    if kind == Nodetype.NAME:
        given = vars(value) if hasattr(value, '__msgtype__') else {}
        given = {name.lower(): v for name, v in given.items()} | given
        return store.types[content](
            *(_convert(given.get(name), field, store) for name, field in store.fielddefs[content][1])
        )
    element, length = content
    elements = value if isinstance(value, list | np.ndarray) else []
    values = elements[:length] if length else elements
    missing = length - len(values) if kind == Nodetype.ARRAY else 0
    if element[0] != Nodetype.BASE or 'string' in element[1][0]:
        return [_convert(v, element, store) for v in [*values, *[None] * missing]]
    dtype = np.dtype({'byte': 'uint8', 'char': 'uint8'}.get(element[1][0], element[1][0]))
    numbers = values if isinstance(values, np.ndarray) else np.zeros(0)
    return np.concatenate([numbers.astype(dtype), np.zeros(length - len(numbers) if missing else 0, dtype)])
