# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Many messages of one type at once, as arrays with a row for each message.

The bytes of a message have their places from the lengths of its texts and sequences. Messages whose lengths are
all equal therefore hold each field in the same place, and a field of all of them is a column of their bytes. The
places are found once (`_Layout`), by the definition of the type; whether another message has them is one
comparison.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, ENCAPSULATION, decode, encode, typestore
from mocap_ros.units import NS_PER_S

Path = tuple[str | int, ...]  # names of fields and indices in sequences, such as ('people', 0, 'joints')

TEXT = 'string'  # name of the basic type of texts
NUMPY_NAMES = {'byte': 'uint8', 'char': 'uint8'}  # NumPy's names of basic types, where ROS has other names


class _Place(NamedTuple):
    """Where the numbers of a field are.

    Attributes:
        offset: bytes from the beginning of the message.
        dtype: type of the numbers.
        shape: shape of the field's value in one message.
    """

    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]


@dataclass
class _Layout:
    """The places of all fields of a message, and the lengths that make them so.

    Attributes:
        numbers: places of the numbers by path.
        texts: beginning and length of the texts in bytes by path, without the zero at their end.
        lengths: lengths of sequences of messages and of texts by path.
        checks: offsets of all lengths in bytes, and the lengths, as they are in the message.
    """

    numbers: dict[Path, _Place] = field(default_factory=dict)
    texts: dict[Path, tuple[int, int]] = field(default_factory=dict)
    lengths: dict[Path, int] = field(default_factory=dict)
    checks: list[tuple[int, int]] = field(default_factory=list)


class Columns:
    """The fields of N messages whose lengths are equal.

    Attributes:
        rows: (N,) indices of the messages among all those that were given.
    """

    def __init__(self, layout: _Layout, rows: NDArray[np.intp], content: NDArray[np.uint8]) -> None:
        self.rows = rows
        self._layout, self._content = layout, content

    def read(self, *path: str | int) -> NDArray[Any]:
        """Return a field of numbers (N, ...); a point or vector is (N, 3), a sequence of M points (N, M, 3)."""
        offset, dtype, shape = self._layout.numbers[path]
        size = dtype.itemsize * int(np.prod(shape))
        taken = np.ascontiguousarray(self._content[:, offset : offset + size])
        return taken.view(dtype).reshape(len(taken), *shape) if size else np.zeros((len(taken), *shape), dtype)

    def count(self, *path: str | int) -> int:
        """Return the length of a sequence of messages or texts, which is the same in all rows."""
        return self._layout.lengths[path]

    def group_texts(self, *paths: Path) -> Iterator[tuple[tuple[str, ...], NDArray[np.intp]]]:
        """Yield the different values of some texts together, each with the indices (M,) of its rows among the N.

        Raises:
            InputError: a text is not UTF-8.
        """
        places = [self._layout.texts[path] for path in paths]
        content = np.concatenate([self._content[:, start : start + size] for start, size in places], axis=1)
        groups = [(content[:1], np.arange(len(content)))]
        if (content != content[:1]).any():
            values, inverse = np.unique(content, axis=0, return_inverse=True)
            groups = [(values[i : i + 1], np.flatnonzero(inverse.ravel() == i)) for i in range(len(values))]
        ends = np.cumsum([size for _, size in places]).tolist()
        try:
            for value, rows in groups:
                yield tuple(value[0, a:b].tobytes().decode() for a, b in pairwise([0, *ends])), rows
        except UnicodeDecodeError as error:
            raise InputError(f'{".".join(map(str, paths[0]))}: {error.reason}') from None


def read_stamps(columns: Columns) -> NDArray[np.int64]:
    """Return the stamps (N,) in ns of the headers of messages."""
    seconds = columns.read('header', 'stamp', 'sec').astype(np.int64)
    return np.asarray(seconds * NS_PER_S + columns.read('header', 'stamp', 'nanosec'))


def read_columns(raws: Sequence[bytes], msgtype: str) -> Iterator[Columns]:
    """Yield the messages in groups of equal lengths, in the order of the first message of each group.

    Args:
        raws: CDR bytes of the messages.
        msgtype: name of their type.

    Raises:
        InputError: the bytes are not messages of that type; groups before it were yielded.
    """
    padded = [_pad(raw, msgtype) for raw in raws]
    sizes = np.array([len(raw) for raw in padded], np.intp)
    waiting = np.arange(len(padded))
    while len(waiting):
        first = waiting[0]
        layout = _find_layout(padded[first], msgtype)
        rows = waiting[sizes[waiting] == sizes[first]]
        content = np.frombuffer(b''.join([padded[row] for row in rows.tolist()]), np.uint8).reshape(len(rows), -1)
        offsets, lengths = np.array(layout.checks, np.intp).reshape(-1, 2).T
        alike = (content.view('<u4')[:, offsets // CDR_ALIGNMENT_BYTES] == lengths).all(axis=1)
        yield Columns(layout, rows[alike], content if alike.all() else content[alike])
        waiting = np.setdiff1d(waiting, rows[alike], assume_unique=True)


def _pad(raw: bytes, msgtype: str) -> bytes:
    """Return a message in little endian, as long as a multiple of `CDR_ALIGNMENT_BYTES`."""
    if raw[:2] != ENCAPSULATION[:2]:
        raw = encode(decode(raw, msgtype), msgtype)
    return raw + bytes(-len(raw) % CDR_ALIGNMENT_BYTES)


def _find_layout(raw: bytes, msgtype: str) -> _Layout:
    """Return the layout of a message.

    Raises:
        InputError: the bytes are not a message of that type.
    """
    reader = _LayoutReader(raw)
    try:
        reader.read_message(msgtype, ())
        is_whole = reader.offset <= len(raw) < reader.offset + 2 * CDR_ALIGNMENT_BYTES
    except _TooShort:
        is_whole = False
    if not is_whole:
        decode(raw, msgtype)  # raises an error that says more
        raise InputError(f'not a {msgtype} ({len(raw)} bytes)')
    return reader.layout


class _TooShort(Exception):
    """The bytes end before the message does."""


class _LayoutReader:
    """Walks through a message, field by field, by the definition of its type."""

    def __init__(self, raw: bytes) -> None:
        self.layout = _Layout()
        self.offset = len(ENCAPSULATION)
        self._raw = raw

    def read_message(self, msgtype: str, path: Path) -> None:
        """Read all fields of a message."""
        fields: list[tuple[str, tuple[Nodetype, Any]]] = list(typestore().get_msgdef(msgtype).fields)
        for name, (kind, content) in fields:
            place = (*path, name)
            if kind in (Nodetype.BASE, Nodetype.NAME):
                self._read_value((kind, content), place)
                continue
            element, size = content
            if kind == Nodetype.SEQUENCE:
                size = self._read_length()
            self._read_values(element, size, place)

    def _read_value(self, described: tuple[Nodetype, Any], path: Path) -> None:
        kind, content = described
        alike = _find_common_type(content) if kind == Nodetype.NAME else None
        if alike is not None:
            self._add_numbers(alike[0], (alike[1],), path)
        elif kind == Nodetype.NAME:
            self.read_message(content, path)
        elif content[0] == TEXT:
            size = self._read_length()
            self._move(size)
            self.layout.texts[path] = self.offset - size, max(size - 1, 0)
        else:
            self._add_numbers(_get_dtype(content[0]), (), path)

    def _read_values(self, element: tuple[Nodetype, Any], size: int, path: Path) -> None:
        """Read the elements of an array or of a sequence."""
        kind, content = element
        if kind == Nodetype.BASE and content[0] != TEXT:
            self._add_numbers(_get_dtype(content[0]), (size,), path)
            return
        alike = _find_common_type(content) if kind == Nodetype.NAME else None
        if alike is not None:
            dtype, width = alike
            self._add_numbers(dtype, (size, width), path)
            return
        self.layout.lengths[path] = size
        for index in range(size):
            self._read_value(element, (*path, index))

    def _read_length(self) -> int:
        """Read the length of a text or of a sequence."""
        self._align(CDR_ALIGNMENT_BYTES)
        start = self.offset
        self._move(CDR_ALIGNMENT_BYTES)
        length = int.from_bytes(self._raw[start : self.offset], 'little')
        if length > len(self._raw):
            raise _TooShort
        self.layout.checks.append((start, length))
        return length

    def _add_numbers(self, dtype: np.dtype[Any], shape: tuple[int, ...], path: Path) -> None:
        size = dtype.itemsize * int(np.prod(shape))
        if size:
            self._align(dtype.itemsize)
        self.layout.numbers[path] = _Place(self.offset, dtype, shape)
        self._move(size)

    def _align(self, size: int) -> None:
        self.offset += (len(ENCAPSULATION) - self.offset) % size

    def _move(self, size: int) -> None:
        self.offset += size
        if self.offset > len(self._raw):
            raise _TooShort


def _get_dtype(name: str) -> np.dtype[Any]:
    return np.dtype(NUMPY_NAMES.get(name, name)).newbyteorder('<')


@lru_cache
def _find_common_type(msgtype: str) -> tuple[np.dtype[Any], int] | None:
    """Return the type and the number of a message's fields if all are numbers of one type, as those of a point."""
    fields: list[tuple[Nodetype, Any]] = [described for _, described in typestore().get_msgdef(msgtype).fields]
    names: set[str] = {content[0] if kind == Nodetype.BASE else TEXT for kind, content in fields}
    return None if len(names) != 1 or names == {TEXT} else (_get_dtype(*names), len(fields))
