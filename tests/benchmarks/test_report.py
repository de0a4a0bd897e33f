# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What benchmarks share: tables of records, the file of results, and the scale by which poses are compared."""

from __future__ import annotations

import json
from pathlib import Path

import common
import numpy as np
import pytest
from report import Report, cross, group, select

RECORDS = [
    {'detector': 'a', 'way': 'live', 'error': 1.0},
    {'detector': 'b', 'way': 'whole', 'error': 2.0},
    {'detector': 'a', 'way': 'live', 'error': 3.0},
]


def test_records_are_grouped_and_crossed_in_the_order_in_which_they_appear() -> None:
    assert list(group(RECORDS, 'detector', 'way')) == [('a', 'live'), ('b', 'whole')]
    assert select(RECORDS, detector='a', way='live') == [RECORDS[0], RECORDS[2]]
    header, rows = cross(
        RECORDS, 'detector', 'way', lambda r: common.mean_error(r, 'error'), {'b': 'B', 'detector': 'points'}
    )
    assert header == ['points', 'live', 'whole']
    assert rows == [['a', 2.0, None], ['B', None, 2.0]]
    assert cross([], 'detector', 'way', len) == (['detector'], [])


def test_the_file_of_results_holds_every_table_of_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = Report(tmp_path / 'found.json', {'machine': 'm'})
    report.table(['a', 'b'], [[1, 0.5]], 'Title', 'Note.', page='page.one')
    report.keep('page.two', ['c'], [[None]])
    report.rows('Rows', [{'x': 1}, {'y': 2}])
    report.add(number=np.float64(3.0))
    assert json.loads((tmp_path / 'found.json').read_text()) == {
        'machine': 'm',
        'number': 3.0,
        'tables': {'page.one': '| a | b |\n| --- | --- |\n| 1 | 0.50 |', 'page.two': '| c |\n| --- |\n| - |'},
        'pictures': [],
    }
    printed = capsys.readouterr().out
    assert printed.startswith('\n## Title\n\nNote.\n\n| a | b |')
    assert '| c |' not in printed
    assert printed.endswith('| x | y |\n| --- | --- |\n| 1 | - |\n| - | 2 |\n')


def test_poses_are_compared_with_one_scale_of_the_frames_that_were_found(rng: np.random.Generator) -> None:
    truth = rng.normal(size=(5, 15, 3))
    found = 0.5 * truth + rng.normal(size=(5, 1, 3))
    found[2] = np.nan
    aligned, centred = common.align_scale(found, truth)
    known = np.arange(5) != 2
    np.testing.assert_allclose(aligned[known], centred[known], atol=1e-12)
    assert np.isnan(aligned[2]).all()
