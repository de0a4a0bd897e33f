# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What benchmarks share: tables of records, the file of results, and the scale by which poses are compared."""

from __future__ import annotations

import json
from pathlib import Path

import common
import numpy as np
import pytest
import report as reporting
from matplotlib.figure import Figure
from report import Report, cross, group, run, select

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


@pytest.mark.parametrize('quick', [False, True])
def test_a_part_of_a_page_is_what_was_shown_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick: bool
) -> None:
    monkeypatch.setattr(common, 'ROOT', tmp_path)
    report = Report(quick=quick)
    report.text('Before.')
    with report.write_page('page.part'):
        report.text('Two\n    lines.')
        report.table(['a'], [[1]])
        report.paper_figure('drawn', Figure(), 'What it shows')
    report.text('After.')
    table = '| a |\n| --- |\n| 1 |'
    assert report.tables == {'page.part': f'Two lines.\n\n{table}\n\n![What it shows](img/paper/drawn.png)'}
    assert report.pictures == ([] if quick else ['docs/img/paper/drawn.png'])
    assert (tmp_path / 'docs' / 'img' / 'paper' / 'drawn.png').is_file() != quick


def test_the_chosen_sections_are_run_and_their_results_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'bench').mkdir()
    (tmp_path / 'bench' / 'protocol.py').write_text('')
    monkeypatch.setenv('MOCAP_ROS_SHARED', str(tmp_path))
    monkeypatch.setattr(reporting, 'describe_machine', lambda: 'm')
    file = tmp_path / 'found.json'
    monkeypatch.setattr('sys.argv', ['x/y.py', '--quick', '--json', str(file), '--only', 'two', 'none'])
    sections: dict[str, reporting.Section] = {
        'one': lambda _, __: {'first': 1},
        'two': lambda report, quick: {'second': report.quick and quick},
        'none': lambda _, __: None,
    }
    run('', 'Title', sections, one_core=False)
    found = json.loads(file.read_text())
    assert found['command'] == 'benchmarks/y.py --quick --only two none'
    assert found['second'] is True
    assert 'first' not in found
