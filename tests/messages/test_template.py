# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Templates give the bytes that a writer gives, whatever the lengths of texts and sequences, image after image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocap_ros.messages.cdr import CdrWriter, Header
from mocap_ros.messages.template import BYTE, DOUBLE, SINGLE, TemplateWriter
from tests.messages.test_outputs_as_objects import HEADERS, TEXTS

Array = NDArray[np.float64]
PEOPLE = st.lists(st.tuples(TEXTS, st.integers(0, 3)), max_size=4)  # a text, and the number of some places


def write(header: Header, people: Sequence[tuple[str, int]], numbers: Array) -> bytes:
    """Return a message with a header for each person, field by field."""
    writer, rest = CdrWriter(), numbers
    for text, count in people:
        writer.add_header(header)
        writer.add_text(text)
        places, rest = np.split(rest, [3 * count])
        writer.add_sequence(places.reshape(-1, 3))
        writer.add(1, bytes([count]))
        writer.add(4, np.array([count, -count], np.float32).tobytes())
    return writer.finish()


@given(HEADERS, PEOPLE, st.integers(0, 2**31 * 10**9 - 1))
def test_the_bytes_are_those_of_a_writer(header: Header, people: list[tuple[str, int]], later_ns: int) -> None:
    writer, counts = TemplateWriter(), [count for _, count in people]
    for text, count in people:
        writer.add_stamped(header.frame_id)
        writer.add_text(text)
        writer.add_number_sequence('places', DOUBLE, count, 3)
        writer.add_numbers('flag', BYTE, 1)
        writer.add_numbers('pair', SINGLE, 2)
    template = writer.finish_template()
    numbers = np.random.default_rng(0).normal(size=3 * sum(counts))
    for stamp_ns, factor in ((header.stamp_ns, 1.0), (later_ns, -2.0), (header.stamp_ns, 1.0)):
        raw = template.fill(
            stamp_ns, places=factor * numbers, flag=counts, pair=np.array([(c, -c) for c in counts])
        )
        assert raw == write(header._replace(stamp_ns=stamp_ns), people, factor * numbers)


@given(HEADERS, PEOPLE)
def test_a_series_is_each_message_alone(header: Header, people: list[tuple[str, int]]) -> None:
    series, alone, numbers = TemplateWriter(), [], np.random.default_rng(0).normal(size=30)
    for number, (text, count) in enumerate(people):
        single = TemplateWriter()
        for writer in (series, single):
            writer.add_stamped(text)
            writer.add_numbers('flag', BYTE, count)
            writer.add_numbers('place', DOUBLE, 1)
            writer.add_text(text)
        series.end_message()
        alone.append(single.finish_template().fill(header.stamp_ns, place=numbers[number], flag=[7] * count))
    flags = [7] * sum(count for _, count in people)
    assert series.finish_series().fill(header.stamp_ns, place=numbers[: len(people)], flag=flags) == alone


def test_numbers_that_are_too_many_are_refused() -> None:
    writer = TemplateWriter()
    writer.add_numbers('pair', DOUBLE, 2)
    template = writer.finish_template()
    with pytest.raises(ValueError, match='shape mismatch'):
        template.fill(0, pair=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match='shape mismatch'):
        template.fill(0, other=[1.0, 2.0])
