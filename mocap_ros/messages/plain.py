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
from functools import cache, lru_cache, partial
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import BIG_ENDIAN, CDR_ALIGNMENT_BYTES, ENCAPSULATION, Header, pad, typestore
from mocap_ros.units import NS_PER_S

Write = Callable[[bytearray, Any], None]  # appends a value, or where it is None the default, to the fields before
Read = Callable[[bytes, int], tuple[Any, int]]  # reads a value; takes its offset, and returns that of the next
Order = Literal['<', '>']  # of bytes: little and big endian

_STRUCT_CODES = {'l': 'q', 'L': 'Q'}  # of NumPy's types that have another size in the module struct
_COUNT, _STAMP = struct.Struct('<I'), struct.Struct('<iI')
_NO_HEADER = Header(0, '')
_PADDING = tuple(bytes(count) for count in range(8))


def encode_plain(value: Any, msgtype: str) -> bytes:
    """Encode a message of which the fields are given as plain values as CDR."""
    out = bytearray()
    _find_writer(msgtype)(out, value)
    return pad(ENCAPSULATION + bytes(out))


@cache
def _find_writer(msgtype: str) -> Write:
    """Return the function that appends a message of this type."""
    if msgtype == 'std_msgs/msg/Header':
        return _write_header
    if numbers := _find_numbers((Nodetype.NAME, msgtype)):
        return _make_number_writer(*numbers)
    writers = {name: _find_field_writer(field) for name, field in typestore().fielddefs[msgtype][1]}

    def write(out: bytearray, value: Mapping[str, Any] | Sequence[Any] | None) -> None:
        given = {} if value is None else value
        if isinstance(given, Mapping):
            if not given.keys() <= writers.keys():
                raise TypeError(f'{msgtype} has no {", ".join(given.keys() - writers.keys())}')
            given = [given.get(name) for name in writers]
        for write_field, content in zip(writers.values(), given, strict=True):
            write_field(out, content)

    return write


def _find_field_writer(description: Any) -> Write:
    kind, detail = description
    if numbers := _find_numbers(description):
        return _make_number_writer(*numbers)
    if kind == Nodetype.BASE:
        return _write_text
    if kind == Nodetype.NAME:
        return _find_writer(detail)
    if numbers := _find_numbers(detail[0]):
        return partial(_write_number_sequence, *numbers)
    return partial(_write_sequence, _find_field_writer(detail[0]))


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


def _make_number_writer(dtype: np.dtype[Any], count: int) -> Write:
    """Return the function that appends numbers of a type, of which one has a faster way."""
    size, pack = dtype.itemsize, struct.Struct('<' + _STRUCT_CODES.get(dtype.char, dtype.char)).pack

    def write_one(out: bytearray, value: Any) -> None:
        out += _PADDING[-len(out) % size]
        out += pack(value or 0)

    def write_many(out: bytearray, value: Any) -> None:
        out += _PADDING[-len(out) % size]
        out += bytes(count * size) if value is None else np.asarray(value, dtype).reshape(count).tobytes()

    return write_one if count == 1 else write_many


def _write_number_sequence(dtype: Any, count: int, out: bytearray, value: Any) -> None:
    numbers = np.asarray(() if value is None else value, dtype).reshape(-1, count)
    _write_count(out, len(numbers))
    if numbers.size:
        out += _PADDING[-len(out) % dtype.itemsize]
        out += numbers.tobytes()


def _write_sequence(write: Write, out: bytearray, value: Any) -> None:
    _write_count(out, len(value or ()))
    for element in value or ():
        write(out, element)


def _write_header(out: bytearray, header: Header | None) -> None:
    out += _PADDING[-len(out) % 4]
    out += _encode_header(header or _NO_HEADER)


def _write_text(out: bytearray, text: str | None) -> None:
    out += _PADDING[-len(out) % 4]
    out += _encode_text(text or '')


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


def decode_plain(raw: bytes, msgtype: str) -> SimpleNamespace:
    """Decode CDR as plain values by the names of the fields: texts, numbers, arrays of numbers, lists of messages.

    Args:
        raw: CDR bytes.
        msgtype: name of the expected message type, which does not consist of numbers of one type alone.

    Raises:
        InputError: the bytes are not a message of that type.
    """
    data = raw[len(ENCAPSULATION) :]
    order: Order = '>' if raw[:2] == BIG_ENDIAN else '<'
    try:
        message, end = _find_reader((Nodetype.NAME, msgtype), order)(data, 0)
        if not 0 <= len(data) - end < CDR_ALIGNMENT_BYTES:
            raise ValueError(f'it ends after {end + len(ENCAPSULATION)}')
    except (ValueError, struct.error) as error:
        raise InputError(f'not a {msgtype} ({error}; {len(raw)} bytes)') from None
    return message


@cache
def _find_reader(description: Any, order: Order) -> Read:
    """Return the function that reads a field of this kind in an order of bytes, `<` or `>`."""
    kind, detail = description
    if numbers := _find_numbers(description):
        return _make_number_reader(numbers[0].newbyteorder(order), numbers[1])
    if kind == Nodetype.BASE:
        return _make_text_reader(order)
    if kind == Nodetype.NAME:
        readers = [(name, _find_reader(field, order)) for name, field in typestore().fielddefs[detail][1]]

        def read_message(data: bytes, at: int) -> tuple[SimpleNamespace, int]:
            values = {}
            for name, read in readers:
                values[name], at = read(data, at)
            return SimpleNamespace(**values), at

        return read_message
    if numbers := _find_numbers(detail[0]):
        return _make_number_sequence_reader(numbers[0].newbyteorder(order), numbers[1], order)
    read_element, unpack_count = _find_reader(detail[0], order), struct.Struct(f'{order}I').unpack_from

    def read_sequence(data: bytes, at: int) -> tuple[list[Any], int]:
        at += -at % 4
        values, (length,) = [], unpack_count(data, at)
        at += 4
        for _ in range(length):
            value, at = read_element(data, at)
            values.append(value)
        return values, at

    return read_sequence


def _make_number_reader(dtype: np.dtype[Any], count: int) -> Read:
    size, code = dtype.itemsize, _STRUCT_CODES.get(dtype.char, dtype.char)
    unpack = struct.Struct(dtype.byteorder.replace('|', '=') + code).unpack_from

    def read_one(data: bytes, at: int) -> tuple[Any, int]:
        at += -at % size
        return unpack(data, at)[0], at + size

    def read_many(data: bytes, at: int) -> tuple[NDArray[Any], int]:
        at += -at % size
        return np.frombuffer(data, dtype, count, at), at + count * size

    return read_one if count == 1 else read_many


def _make_number_sequence_reader(dtype: np.dtype[Any], count: int, order: Order) -> Read:
    """Return the function that reads a sequence (N,) of numbers, or (N, count) of messages of so many numbers."""
    size, unpack_count = dtype.itemsize, struct.Struct(f'{order}I').unpack_from

    def read_numbers(data: bytes, at: int) -> tuple[NDArray[Any], int]:
        at += -at % 4
        (length,) = unpack_count(data, at)
        at += 4
        if not length:
            return np.zeros(0 if count == 1 else (0, count), dtype), at
        at += -at % size
        numbers = np.frombuffer(data, dtype, length * count, at)
        return numbers if count == 1 else numbers.reshape(length, count), at + numbers.nbytes

    return read_numbers


def _make_text_reader(order: Order) -> Read:
    unpack_count = struct.Struct(f'{order}I').unpack_from

    def read_text(data: bytes, at: int) -> tuple[str, int]:
        at += -at % 4
        end = at + 4 + unpack_count(data, at)[0]
        return data[at + 4 : end - 1].decode(), end

    return read_text
