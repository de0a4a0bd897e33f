# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that differ from the one before in their numbers alone, written at once.

The bytes of a message have their places from its texts and from the lengths of its sequences, as the ids of the
people and the number of their joints. As long as these stay, the message is a copy of a template into which the
numbers of each image are put, one assignment for each field of all people.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, ENCAPSULATION, CdrWriter
from mocap_ros.units import NS_PER_S

KEPT_TEMPLATES = 16  # of each kind of message: one for the people who are seen, and those of others before

# Types of numbers in messages.
DOUBLE, SINGLE, INT, BYTE = (np.dtype(name) for name in ('<f8', '<f4', '<i4', 'u1'))
_STAMP = 'stamp'  # name of the field that holds the stamps of all headers
_STAMP_NUMBERS = 2  # seconds and nanoseconds


class _Field(NamedTuple):
    """Where the numbers of a field are.

    Attributes:
        dtype: their type.
        places: (N,) their offsets behind the encapsulation, in units of the size of one.
    """

    dtype: np.dtype[Any]
    places: NDArray[np.intp]


_NOWHERE = _Field(BYTE, np.zeros(0, np.intp))  # of a field of each person where there is nobody


class MessageTemplate:
    """A message without its numbers.

    Args:
        content: the message as CDR, with zeros for the numbers.
        fields: where these are, by name.
    """

    def __init__(self, content: bytes, fields: Mapping[str, _Field]) -> None:
        body = content[len(ENCAPSULATION) :]
        self._bytes = len(body)
        self._body = np.frombuffer(body + bytes(-len(body) % DOUBLE.itemsize), np.uint8)
        self._fields = fields

    def fill(self, stamp_ns: int, **numbers: ArrayLike) -> bytes:
        """Return the message with a stamp in ns in all headers, and with the numbers of each other field."""
        body = self._body.copy()
        stamps = self._fields.get(_STAMP, _NOWHERE).places.reshape(-1, _STAMP_NUMBERS)
        body.view(INT)[stamps] = divmod(stamp_ns, NS_PER_S)
        for name, values in numbers.items():
            field = self._fields.get(name, _NOWHERE)
            body.view(field.dtype)[field.places] = np.ravel(values)
        return ENCAPSULATION + body[: self._bytes].tobytes()


class SeriesTemplate(NamedTuple):
    """Several messages without their numbers, which are filled in the time of one.

    Attributes:
        template: the messages behind one another, as one.
        spans: where each begins and ends in it, in bytes.
    """

    template: MessageTemplate
    spans: Sequence[tuple[int, int]]

    def fill(self, stamp_ns: int, **numbers: ArrayLike) -> list[bytes]:
        """Return the messages; the arguments are those of `MessageTemplate.fill`."""
        raw = self.template.fill(stamp_ns, **numbers)
        return [ENCAPSULATION + raw[begin:end] for begin, end in self.spans]


class TemplateWriter(CdrWriter):
    """Writer of a template, which appends the fields of the message in their order."""

    def __init__(self) -> None:
        super().__init__()
        self._spans: list[tuple[int, int]] = []
        self._begun = len(self._data)  # where the message begins
        self._places: dict[str, tuple[np.dtype[Any], list[int]]] = {}

    def add_numbers(self, field: str, dtype: np.dtype[Any], count: int) -> None:  # type: ignore[override]
        """Append some numbers of a field, which may have others elsewhere."""
        _, places = self._places.setdefault(field, (dtype, []))
        if count:
            size = count * dtype.itemsize
            self.add(dtype.itemsize, bytes(size))
            first = (len(self._data) - len(ENCAPSULATION) - size) // dtype.itemsize
            places.extend(range(first, first + count))

    def add_number_sequence(self, field: str, dtype: np.dtype[Any], count: int, width: int = 1) -> None:
        """Append a sequence of numbers, or of messages of some numbers each."""
        self.add_count(count)
        self.add_numbers(field, dtype, count * width)

    def add_stamped(self, frame_id: str) -> None:
        """Append a std_msgs/Header."""
        self.add_numbers(_STAMP, INT, _STAMP_NUMBERS)
        self.add_text(frame_id)

    def end_message(self) -> None:
        """End a message of a series; what is appended then belongs to the next."""
        self.add(CDR_ALIGNMENT_BYTES, b'')
        self._spans.append((self._begun, len(self._data)))
        self.add(DOUBLE.itemsize, b'')
        self._begun = len(self._data)

    def finish_series(self) -> SeriesTemplate:
        """Return the template of the messages that were ended."""
        return SeriesTemplate(self.finish_template(), self._spans)

    def finish_template(self) -> MessageTemplate:
        """Return the template."""
        fields = {name: _Field(dtype, np.array(p, np.intp)) for name, (dtype, p) in self._places.items()}
        return MessageTemplate(self.finish(), fields)
