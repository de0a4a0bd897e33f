# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What benchmarks share: tables of records, what a run leaves, and the scale by which poses are compared."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import common
import numpy as np
import pytest
from report import Report, cross, group

RECORDS = [
    {'detector': 'a', 'way': 'live', 'error': 1.0},
    {'detector': 'b', 'way': 'whole', 'error': 2.0},
    {'detector': 'a', 'way': 'live', 'error': 3.0},
]


def test_records_are_grouped_and_crossed_in_the_order_in_which_they_appear() -> None:
    assert list(group(RECORDS, 'detector', 'way')) == [('a', 'live'), ('b', 'whole')]
    names = {'b': 'B', 'detector': 'points'}
    header, rows = cross(RECORDS, 'detector', 'way', lambda r: common.mean_error(r, 'error'), names)
    assert header == ['points', 'live', 'whole']
    assert rows == [['a', 2.0, None], ['B', None, 2.0]]
    assert cross([], 'detector', 'way', len) == (['detector'], [])


def test_a_run_leaves_the_tables_of_pages_and_its_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = Report(argparse.Namespace(json=tmp_path / 'a' / 'found.json'), {'machine': 'm'})
    report.table(['a', 'b'], [[1, 0.5]], 'Title', page='page.one')
    report.rows('Rows', [{'x': 1}, {'y': None}])
    report.quantities({'speed': 2000.0}, {'speed': 'fast'}, page='page.two')
    report.results['number'] = np.float64(3.0)
    report.save()
    assert json.loads((tmp_path / 'a' / 'found.json').read_text()) == {
        'machine': 'm',
        'tables': {
            'page.one': '| a | b |\n| --- | --- |\n| 1 | 0.50 |',
            'page.two': '| quantity | measured | target |\n| --- | --- | --- |\n| speed | 2000 | fast |',
        },
        'results': {'speed': 2000.0, 'number': 3.0},
    }
    assert '## Rows\n\n| x | y |\n| --- | --- |\n| 1 | - |\n| - | - |' in capsys.readouterr().out


def test_poses_are_compared_with_one_scale_of_the_frames_that_were_found(rng: np.random.Generator) -> None:
    truth = rng.normal(size=(5, 15, 3))
    found = 0.5 * truth + rng.normal(size=(5, 1, 3))
    found[2] = np.nan
    aligned, centred = common.align_scale(found, truth)
    known = np.arange(5) != 2
    np.testing.assert_allclose(aligned[known], centred[known], atol=1e-12)
    assert np.isnan(aligned[2]).all()
