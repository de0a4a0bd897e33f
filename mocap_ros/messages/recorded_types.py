# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Definitions of message types from bags, with limits: rosbags generates code from them and trusts them."""

from __future__ import annotations

import re
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.errors import InputError

IDL_HEADING = re.compile(r'^={80}\nIDL: .*\n', re.MULTILINE)  # separates the types in a definition in IDL
MAX_DEFINITION_CHARACTERS = 50_000  # of a type and those of its fields, parsed in 1 s; ROS has up to 20,000
SHIFT = '<<'  # an operator in constants of IDL, which definitions of messages do without
MAX_UNROLLED = 10_000  # elements that are no numbers in arrays of fixed length, for each of which code is made
MAX_DEPTH = 30  # types within types; those of ROS have up to 8

Fields = list[tuple[str, tuple[Nodetype, Any]]]


def load_recorded_types(text: str, msgtype: str, *, is_idl: bool) -> Typestore:
    """Return the message types of a definition of a type and of the types of its fields.

    Raises:
        InputError: the definition is too long, does not define the type or that of a field, or messages of the
            type could be huge although their bytes are few.
        Exception: the parser raises almost any exception for damaged text.
    """
    if len(text) > MAX_DEFINITION_CHARACTERS:
        raise InputError(f'{len(text)} characters, more than {MAX_DEFINITION_CHARACTERS}')
    store = get_typestore(Stores.EMPTY)
    if is_idl and SHIFT in text:  # the parser computes constants, and 1 << 9999999999 fills the memory
        raise InputError(f'a constant with {SHIFT}')
    if is_idl:
        for part in IDL_HEADING.split(text):
            store.register(get_types_from_idl(part) if part.strip() else {})
    else:
        store.register(get_types_from_msg(text, msgtype))
    _LimitCheck(store).measure(msgtype)
    return store


class _LimitCheck:
    """The limits of the types of a store."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._size_by_type: dict[str, int] = {}
        self._unrolled = 0

    def measure(self, msgtype: str, depth: int = 0) -> int:
        """Return a lower bound of the bytes of a message; InputError if a limit is exceeded."""
        if depth > MAX_DEPTH:
            raise InputError(f'{msgtype}: types within types, more than {MAX_DEPTH} levels')
        if msgtype not in self._size_by_type:
            if msgtype not in self._store.fielddefs:
                raise InputError(f'{msgtype} is not defined')
            fields: Fields = list(self._store.fielddefs[msgtype][1])
            self._size_by_type[msgtype] = sum(self._measure_field(content, depth) for _, content in fields)
        return self._size_by_type[msgtype]

    def _measure_field(self, field: tuple[Nodetype, Any], depth: int) -> int:
        kind, content = field
        if kind == Nodetype.BASE:
            return 1
        if kind == Nodetype.NAME:
            return self.measure(content, depth + 1)
        element, count = content
        size = self._measure_field(element, depth)
        if not size:
            raise InputError('a sequence or array of elements without content')
        if kind == Nodetype.SEQUENCE:
            return 1
        is_number = element[0] == Nodetype.BASE and 'string' not in element[1][0]
        self._unrolled += 0 if is_number else count
        if self._unrolled > MAX_UNROLLED:
            raise InputError(f'arrays of fixed length with more than {MAX_UNROLLED} elements')
        return size * int(count)
