# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What benchmarks share, the record of the figures, and the campaign of faults in short."""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import common
import figures
import numpy as np
import pytest
from readme import find_numbers
from report import Report, cross, group

from tests.support.paths import ROOT

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


def test_a_run_leaves_tables_of_pages_and_its_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


TABLE = '| method | fixed: walk |\n| --- | --- |\n| this project | 0.25 / 5 |\n| another | - |'
PAGE = 'Before.\n\n<!-- table: one -->\n<!-- end of table -->\n\nAfter.\n'


def leave_run(root: Path, name: str, text: str, date: str = '2026-11-27', *, quick: bool = False) -> None:
    about = {'command': f'benchmarks/{name}.py', 'commit': 'abc', 'date': date, 'machine': 'm', 'quick': quick}
    folder = root / figures.BUILD
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f'{name}.json').write_text(json.dumps({**about, 'tables': {'one': text}, 'results': {}}))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A repository with a page, and a run of a benchmark."""
    for folder in ('benchmarks', 'docs'):
        (tmp_path / folder).mkdir()
    (tmp_path / 'README.md').write_text('No table here.\n')
    (tmp_path / 'docs' / 'page.md').write_text(PAGE)
    leave_run(tmp_path, 'a', TABLE)
    return tmp_path


def test_a_whole_run_is_written_into_its_page_and_the_newest_one_counts(root: Path) -> None:
    leave_run(root, 'b', 'a short one', quick=True)
    leave_run(root, 'c', 'an old one', date='2026-11-26')
    figures.take_in(root)
    figures.write(root)
    page = (root / 'docs' / 'page.md').read_text()
    assert TABLE in page
    assert '`benchmarks/a.py`, 2026-11-27, commit abc' in page
    assert list(figures.find_differences(root)) == []


@pytest.mark.parametrize(
    ('before', 'after', 'words'),
    [
        ('0.25', '0.24', 'differs'),
        ('<!-- end of table -->', '', 'no partner'),
        ('table: one', 'table: two', 'not in the record'),
        ('After.', PAGE, 'also in'),
    ],
)
def test_a_page_that_was_edited_is_found(root: Path, before: str, after: str, words: str) -> None:
    figures.take_in(root)
    figures.write(root)
    page = root / 'docs' / 'page.md'
    page.write_text(page.read_text().replace(before, after))
    assert any(words in line and 'docs/page.md' in line for line in figures.find_differences(root))


def test_numbers_of_the_readme_are_those_of_a_cell(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures.take_in(root)
    monkeypatch.setattr('common.ROOT', root)
    assert find_numbers('one', 'this project', 'fixed: walk') == [0.25, 5.0]
    for table, row in (('two', 'this project'), ('one', 'nobody'), ('one', 'another')):
        with pytest.raises(ValueError, match=f'table {table}, row {row}'):
            find_numbers(table, row, 'fixed: walk')


def test_every_benchmark_has_a_file_and_every_table_a_command() -> None:
    assert all((ROOT / 'benchmarks' / f'{name}.py').is_file() for name in figures.BENCHMARKS)
    for table in figures.load_record(ROOT).values():
        script = table['command'].split()[0]
        assert (ROOT / script).is_file(), script


# Kills one recorder of each kind, and lets some steps of a recording fail in each way.
CAMPAIGN = """
import json, sys
from pathlib import Path
import faults
from report import Report
root = Path(sys.argv[1])
kills = faults.do_all(faults.kill_once, [(kind, 0, root) for kind in faults.KILLS], root, 'kills')
found = faults.measure_steps(root, Report(None, {}), every=9)
Path(sys.argv[2]).write_text(json.dumps({'kills': [k.fault for k in kills], **found}))
"""


def test_bags_survive_kills_and_failing_disks(tmp_path: Path) -> None:
    """In a process of its own, because it forks."""
    found, bags = tmp_path / 'found.json', tmp_path / 'bags'
    bags.mkdir()
    words = [sys.executable, '-c', CAMPAIGN, str(bags), str(found)]
    done = subprocess.run(words, cwd=ROOT / 'benchmarks', capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    results = json.loads(found.read_text())
    assert results['kills'] == [''] * 4, done.stdout
    assert results['steps'] > 30
    assert results['wrong'] == 0, done.stdout
