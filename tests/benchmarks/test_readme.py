# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The README's table: figures that other benchmarks have measured are read from the record."""

from __future__ import annotations

from pathlib import Path

import common
import pytest
from figure_record import RECORD, save_record
from readme import find_numbers, list_rivals

TABLE = """\
| method | fixed: walk | fixed: run |
| --- | --- | --- |
| this project, joint solver | 0.25 / 5 | 0.66 / 8 |
| Algorithm 1, best | 1.00 / 21 | 1.54 / 23 |
| Somebody 2000 | 9.80 / 207 | 14.31 / 186 |
| Somebody 2015 | 0.9 / 12 | - |"""


@pytest.fixture(autouse=True)
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(common, 'ROOT', tmp_path)
    save_record({'table1': {'tables': {'rivals.errors': TABLE}}}, tmp_path / RECORD)


def test_numbers_are_those_of_the_cell() -> None:
    assert find_numbers('rivals.errors', 'this project, joint', 'fixed: run') == [0.66, 8.0]
    assert list_rivals(['fixed: walk']) == [207.0, 12.0]


@pytest.mark.parametrize(
    ('table', 'row', 'column'),
    [
        ('rivals', 'this project', 'fixed: walk'),
        ('rivals.errors', 'nobody', 'fixed: walk'),
        ('rivals.errors', 'this project', 'fixed: jump'),
        ('rivals.errors', 'Somebody 2015', 'fixed: run'),
    ],
)
def test_a_figure_that_was_not_measured_is_named(table: str, row: str, column: str) -> None:
    with pytest.raises(ValueError, match=f'{table} has no numbers in the row {row} and the column {column}'):
        find_numbers(table, row, column)
