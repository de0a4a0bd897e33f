# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages as CDR from plain values and back, by the definitions of their types.

A message is a mapping of some of its fields, while the others are zero or empty, or a sequence of all of them; a
std_msgs/Header is a `Header`. A message that holds numbers of one type only, as a pose does, is those numbers, and
a sequence of N such messages of M numbers is an array (N, M). Message objects for some hundred points would take
ten times as long.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import BIG_ENDIAN, CDR_ALIGNMENT_BYTES, ENCAPSULATION, Header, pad, typestore
from mocap_ros.units import NS_PER_S

Order = Literal['<', '>']  # of bytes: little and big endian

_HEADER = 'std_msgs/msg/Header'
_STRUCT_CODES = {'l': 'q', 'L': 'Q'}  # of NumPy's types that have another size in the module struct
_COUNT, _STAMP = struct.Struct('<I'), struct.Struct('<iI')
_NO_HEADER = Header(0, '')
_PADDING = tuple(bytes(count) for count in range(8))


class _Codec(NamedTuple):
    # Appends a value, or where it is None the default, to the fields before; little endian
    write: Callable[[bytearray, Any], None]
    # Reads a value; takes the bytes and its offset, and returns the value and the offset of the next
    read: Callable[[bytes, int], tuple[Any, int]]


def encode_plain(value: Any, msgtype: str) -> bytes:
    """Encode a message of which the fields are given as plain values as CDR."""
    out = bytearray()
    _find_codec((Nodetype.NAME, msgtype)).write(out, value)
    return pad(ENCAPSULATION + bytes(out))


def decode_plain(raw: bytes, msgtype: str) -> SimpleNamespace:
    """Decode CDR as values by the names of fields: texts, numbers, arrays of numbers, lists of messages."""
    data = raw[len(ENCAPSULATION) :]
    try:
        message, end = _find_codec((Nodetype.NAME, msgtype), '>' if raw[:2] == BIG_ENDIAN else '<').read(data, 0)
        if not 0 <= len(data) - end < CDR_ALIGNMENT_BYTES:
            raise ValueError(f'it ends after {end + len(ENCAPSULATION)}')
    except (ValueError, struct.error) as error:
        raise InputError(f'not a {msgtype} ({error}; {len(raw)} bytes)') from None
    return message


@cache
def _find_codec(description: Any, order: Order = '<') -> _Codec:
    """Return the codec of a field of this kind, in which bytes are read in this order."""
    kind, detail = description
    if numbers := _find_numbers(description):
        return _make_number_codec(*numbers, order)
    if kind == Nodetype.BASE:
        return _make_text_codec(order)
    if kind == Nodetype.NAME:
        return _make_message_codec(detail, order)
    if numbers := _find_numbers(detail[0]):
        return _make_number_sequence_codec(*numbers, order)
    return _make_sequence_codec(_find_codec(detail[0], order), order)


@cache
def _find_numbers(description: Any) -> tuple[np.dtype[Any], int] | None:
    """Return type and count of the numbers of which a field is made; None if it is made of anything else."""
    kind, detail = description
    if kind == Nodetype.BASE:
        name = {'byte': 'uint8', 'char': 'uint8'}.get(detail[0], detail[0])
        return None if name == 'string' else (np.dtype(name), 1)
    if kind == Nodetype.SEQUENCE:
        return None
    if kind == Nodetype.ARRAY:
        inner = _find_numbers(detail[0])
        return inner and (inner[0], inner[1] * detail[1])
    parts = [_find_numbers(field) for _, field in typestore().fielddefs[detail][1]]
    known = [part for part in parts if part]
    is_alike = len(known) == len(parts) and len({dtype for dtype, _ in known}) == 1
    return (known[0][0], sum(count for _, count in known)) if is_alike else None


def _make_message_codec(msgtype: str, order: Order) -> _Codec:
    codecs = {name: _find_codec(field, order) for name, field in typestore().fielddefs[msgtype][1]}
    writers, readers = [c.write for c in codecs.values()], [(name, c.read) for name, c in codecs.items()]

    def write(out: bytearray, value: Mapping[str, Any] | Sequence[Any] | None) -> None:
        given = {} if value is None else value
        if isinstance(given, Mapping):
            if not given.keys() <= codecs.keys():
                raise TypeError(f'{msgtype} has no {", ".join(given.keys() - codecs.keys())}')
            given = [given.get(name) for name in codecs]
        for write_field, content in zip(writers, given, strict=True):
            write_field(out, content)

    def write_header(out: bytearray, header: Header | None) -> None:
        out += _PADDING[-len(out) % 4]
        out += _encode_header(header or _NO_HEADER)

    def read(data: bytes, at: int) -> tuple[SimpleNamespace, int]:
        values = {}
        for name, read_field in readers:
            values[name], at = read_field(data, at)
        return SimpleNamespace(**values), at

    return _Codec(write_header if msgtype == _HEADER else write, read)


def _make_number_codec(dtype: np.dtype[Any], count: int, order: Order) -> _Codec:
    size, code = dtype.itemsize, _STRUCT_CODES.get(dtype.char, dtype.char)
    pack, unpack = struct.Struct('<' + code).pack, struct.Struct(order + code).unpack_from
    stored = dtype.newbyteorder(order)

    def write_one(out: bytearray, value: Any) -> None:
        out += _PADDING[-len(out) % size]
        out += pack(value or 0)

    def write_many(out: bytearray, value: Any) -> None:
        out += _PADDING[-len(out) % size]
        out += bytes(count * size) if value is None else np.asarray(value, dtype).reshape(count).tobytes()

    def read_one(data: bytes, at: int) -> tuple[Any, int]:
        at += -at % size
        return unpack(data, at)[0], at + size

    def read_many(data: bytes, at: int) -> tuple[NDArray[Any], int]:
        at += -at % size
        return np.frombuffer(data, stored, count, at), at + count * size

    return _Codec(write_one, read_one) if count == 1 else _Codec(write_many, read_many)


def _make_number_sequence_codec(dtype: np.dtype[Any], count: int, order: Order) -> _Codec:
    """Return the codec of a sequence (N,) of numbers, or (N, count) of messages of so many numbers."""
    size, unpack_count = dtype.itemsize, struct.Struct(f'{order}I').unpack_from
    stored = dtype.newbyteorder(order)

    def write(out: bytearray, value: Any) -> None:
        numbers = np.asarray(() if value is None else value, dtype).reshape(-1, count)
        _write_count(out, len(numbers))
        if numbers.size:
            out += _PADDING[-len(out) % size]
            out += numbers.tobytes()

    def read(data: bytes, at: int) -> tuple[NDArray[Any], int]:
        at += -at % 4
        (length,) = unpack_count(data, at)
        at += 4
        if not length:
            return np.zeros(0 if count == 1 else (0, count), stored), at
        at += -at % size
        numbers = np.frombuffer(data, stored, length * count, at)
        return numbers if count == 1 else numbers.reshape(length, count), at + numbers.nbytes

    return _Codec(write, read)


def _make_sequence_codec(element: _Codec, order: Order) -> _Codec:
    write_element, read_element = element
    unpack_count = struct.Struct(f'{order}I').unpack_from

    def write(out: bytearray, value: Any) -> None:
        _write_count(out, len(value or ()))
        for content in value or ():
            write_element(out, content)

    def read(data: bytes, at: int) -> tuple[list[Any], int]:
        at += -at % 4
        values, (length,) = [], unpack_count(data, at)
        at += 4
        for _ in range(length):
            value, at = read_element(data, at)
            values.append(value)
        return values, at

    return _Codec(write, read)


def _make_text_codec(order: Order) -> _Codec:
    unpack_count = struct.Struct(f'{order}I').unpack_from

    def write(out: bytearray, text: str | None) -> None:
        out += _PADDING[-len(out) % 4]
        out += _encode_text(text or '')

    def read(data: bytes, at: int) -> tuple[str, int]:
        at += -at % 4
        end = at + 4 + unpack_count(data, at)[0]
        return data[at + 4 : end - 1].decode(), end

    return _Codec(write, read)


def _write_count(out: bytearray, count: int) -> None:
    out += _PADDING[-len(out) % 4]
    out += _COUNT.pack(count)


@lru_cache(maxsize=64)
def _encode_header(header: Header) -> bytes:
    return _STAMP.pack(*divmod(header.stamp_ns, NS_PER_S)) + _encode_text(header.frame_id)


@lru_cache(maxsize=4096)  # names of people and frames, which are in every image
def _encode_text(text: str) -> bytes:
    content = text.encode()
    return _COUNT.pack(len(content) + 1) + content + b'\0'
