# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The record of the figures: what is measured again, what is stale, and tables that were edited by hand."""

from __future__ import annotations

import ast
import json
import os
import time
from pathlib import Path
from typing import Any

import figures
import pytest
from figure_record import (
    RECORD,
    STALE_MARK,
    Benchmark,
    find_differences,
    list_stale,
    list_unmarked,
    load_record,
    write_pages,
)

from tests.support.paths import ROOT

TABLE = '| a | b |\n| --- | --- |\n| 1 | 2 |'
PAGE = 'Before.\n\n<!-- table: one -->\n<!-- end of table -->\n\nAfter.\n'
# A benchmark that measures the number in `measured.txt` and counts its runs; the page shows that of `one.py`.
SCRIPT = """
import json, pathlib, sys
root = pathlib.Path(__file__).parent.parent
value = (root / 'measured.txt').read_text()
if value == 'bad':
    sys.exit('this benchmark fails')
runs = root / 'runs.txt'
runs.write_text(runs.read_text() + sys.argv[0][-6:-3] + ' ' if runs.is_file() else sys.argv[0][-6:-3] + ' ')
(root / 'picture.png').write_text('--quick' if '--quick' in sys.argv else value)
tables = {'one': '| ' + value + ' |'} if sys.argv[0].endswith('one.py') else {}
record = {'machine': 'm', 'pictures': ['picture.png'], 'tables': tables, 'number': value}
pathlib.Path(sys.argv[sys.argv.index('--json') + 1]).write_text(json.dumps(record))
"""
ONE, TWO = (Benchmark(name, f'{name}.py', ('measured.txt',), ('data.txt',)) for name in ('one', 'two'))


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with two benchmarks and a page."""
    root = tmp_path / 'repository'
    for folder in ('benchmarks', 'docs'):
        (root / folder).mkdir(parents=True)
    for name in ('one', 'two'):
        (root / 'benchmarks' / f'{name}.py').write_text(SCRIPT)
    (root / 'measured.txt').write_text('5')
    (root / 'README.md').write_text('No table here.\n')
    (root / 'docs' / 'page.md').write_text(PAGE)
    data = tmp_path / 'shared'
    data.mkdir()
    (data / 'data.txt').write_text('data')
    monkeypatch.setenv('MOCAP_ROS_SHARED', str(data))
    return root


def make_entry(sources: str = 's', **tables: str) -> dict[str, Any]:
    return {'sources': sources, 'tables': tables, 'pictures': {}}


def runs(root: Path) -> list[str]:
    return (root / 'runs.txt').read_text().split()


def write_page_table(root: Path, name: str) -> None:
    page = root / 'docs' / 'page.md'
    marker = f'<!-- table: {name} -->\n'
    page.write_text(page.read_text().replace(marker, f'{marker}\n{TABLE}\n\n'))


def write_measured(root: Path) -> dict[str, Any]:
    record = load_record(root / RECORD)
    write_pages(record, list_stale(record, [ONE, TWO], root), root)
    return record


def test_a_table_edited_by_hand_is_found(root: Path) -> None:
    record, page = {'x': make_entry(one=TABLE)}, root / 'docs' / 'page.md'
    assert find_differences(record, root) == ['docs/page.md: table one differs from the record']
    assert write_pages(record, [], root) == [page]
    assert find_differences(record, root) == []
    assert write_pages(record, [], root) == []
    page.write_text(page.read_text().replace('| 2 |', '| 3 |'))
    assert find_differences(record, root) == ['docs/page.md: table one differs from the record']


SHOWN = f'<!-- table: one -->\n\n{TABLE}\n\n<!-- end of table -->\n'
NO_PARTNER = 'docs/page.md: a marker of a table has no partner, or is not written as it should be'


@pytest.mark.parametrize(
    ('text', 'complaints'),
    [
        (f'{SHOWN}<!-- table: two -->\n<!-- end of table -->', {'docs/page.md: table two is not in the record'}),
        (f'{SHOWN}<!-- table: one -->\n', {NO_PARTNER}),
        (f'{SHOWN}<!-- end of table -->', {NO_PARTNER}),
        (SHOWN.replace('<!-- table', '<!--table'), {NO_PARTNER, 'table one is in the record and on no page'}),
        (f'<!-- table: one -->\n{SHOWN}', {NO_PARTNER, 'docs/page.md: table one differs from the record'}),
        (f'{SHOWN}\n{SHOWN}', {'docs/page.md: table one is also in docs/page.md'}),
        (TABLE, {'table one is in the record and on no page'}),
    ],
)
def test_markers_that_show_no_table_or_a_wrong_one_are_found(root: Path, text: str, complaints: set[str]) -> None:
    page, record = root / 'docs' / 'page.md', {'x': make_entry(one=TABLE)}
    page.write_text(SHOWN)
    assert find_differences(record, root) == []
    page.write_text(text)
    assert set(find_differences(record, root)) == complaints


def test_a_record_is_measured_written_and_found_unchanged(root: Path) -> None:
    assert figures.run_benchmarks([ONE, TWO], root, quick=False) == 0
    record = write_measured(root)
    assert '| 5 |' in (root / 'docs' / 'page.md').read_text()
    assert figures.check([ONE, TWO], root, release=True) == 0
    assert record['one']['results'] == {'number': '5'}
    assert record['one']['data'].keys() == {'data.txt'}
    assert record['one']['versions']['numpy']
    (root / 'picture.png').write_text('drawn by hand')
    assert 'picture.png: this picture differs from the record' in find_differences(record, root)
    (root / 'picture.png').unlink()
    assert 'picture.png: this picture is missing' in find_differences(record, root)


def test_only_what_is_missing_or_stale_is_measured(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures.run_benchmarks([ONE], root, quick=False)  # as if it had been interrupted before the second
    figures.run_benchmarks([ONE, TWO], root, quick=False)
    assert runs(root) == ['one', 'two']
    (root / 'benchmarks' / 'two.py').write_text(SCRIPT + '\nchanged = True\n')
    figures.run_benchmarks([ONE, TWO], root, quick=False)
    assert runs(root) == ['one', 'two', 'two']
    (root.parent / 'shared' / 'data.txt').write_text('other data')
    figures.run_benchmarks([ONE], root, quick=False)
    figures.run_benchmarks([ONE], root, quick=False, again=True)
    assert runs(root)[3:] == ['one', 'one']
    assert '1/2 one: up to date' in capsys.readouterr().out


def test_stale_tables_are_marked_until_they_are_measured_again(root: Path) -> None:
    page = root / 'docs' / 'page.md'
    figures.run_benchmarks([ONE, TWO], root, quick=False)
    write_measured(root)
    (root / 'measured.txt').write_text('6')
    assert figures.check([ONE, TWO], root, release=False) == 0
    assert figures.check([ONE, TWO], root, release=True) == 1
    write_measured(root)
    assert STALE_MARK.search(page.read_text())
    assert '| 5 |' in page.read_text()
    assert figures.check([ONE, TWO], root, release=False) == 0
    figures.run_benchmarks([ONE, TWO], root, quick=False)
    write_measured(root)
    assert not STALE_MARK.search(page.read_text())
    assert '| 6 |' in page.read_text()
    assert figures.check([ONE, TWO], root, release=True) == 0


def test_a_benchmark_that_fails_leaves_the_others_and_the_record(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures.run_benchmarks([ONE], root, quick=False)
    before = load_record(root / RECORD)
    (root / 'benchmarks' / 'one.py').write_text('import sys; sys.exit("this benchmark fails")')
    assert figures.run_benchmarks([ONE, TWO], root, quick=False) == 1
    assert load_record(root / RECORD)['one'] == before['one']
    assert 'two' in load_record(root / RECORD)
    assert 'this benchmark fails' in capsys.readouterr().out


def test_a_short_run_reaches_no_page_and_not_the_record(root: Path) -> None:
    assert figures.run_benchmarks([ONE], root, quick=True) == 0
    assert not (root / RECORD).exists()
    assert load_record(root / figures.QUICK_RECORD)['one']['command'] == 'benchmarks/one.py --quick'


def write_results(root: Path, **results: Any) -> Path:
    """Write what a full run that began just now would write, and return the file."""
    found = {'begun': time.time() + 1, 'command': 'benchmarks/one.py', 'quick': False, 'tables': {'one': '| 7 |'}}
    file = root / 'results.json'
    file.write_text(json.dumps({**found, **results}))
    return file


def test_results_are_entered_and_a_table_that_was_not_measured_again_is_kept(root: Path) -> None:
    (root / 'docs' / 'page.md').write_text(PAGE + PAGE.replace('one', 'other'))
    before = write_results(root, tables={'one': '| 6 |', 'other': '| 8 |'}, records=[0] * 20_000)
    figures.enter(ONE, before, root)
    assert write_measured(root)['one']['results'] == {}  # the records are too long
    assert figures.check([ONE], root, release=True) == 0
    figures.enter(ONE, write_results(root), root)
    record = write_measured(root)
    assert record['one']['tables'] == {'one': '| 7 |'}
    assert record['one']['kept']['other']['text'] == '| 8 |'
    text = (root / 'docs' / 'page.md').read_text()
    assert text.index('| 7 |') < text.index('| 8 |') < STALE_MARK.search(text).start()  # type: ignore[union-attr]
    assert figures.check([ONE], root, release=False) == 0
    assert figures.check([ONE], root, release=True) == 1


def test_results_of_sources_that_changed_meanwhile_are_stale(root: Path) -> None:
    file = write_results(root)
    os.utime(root / 'measured.txt', (time.time() + 10,) * 2)
    figures.enter(ONE, file, root)
    assert list_stale(load_record(root / RECORD), [ONE], root) == ['one']


@pytest.mark.parametrize('results', [{'quick': True}, {'quick': None}])
def test_results_of_a_short_run_are_not_entered(root: Path, results: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r'results\.json: these are not the results of a full run'):
        figures.enter(ONE, write_results(root, **results), root)
    assert not (root / RECORD).exists()


@pytest.mark.parametrize('once', [False, True])
def test_tables_are_entered_by_hand_as_the_pages_show_them(root: Path, once: bool) -> None:
    page = root / 'docs' / 'page.md'
    page.write_text(PAGE.replace('<!-- end', f'\n{TABLE}\n\n<!-- end'))
    figures.keep(['one'], 'benchmarks/one.py --slow', [ONE], root, once=once)
    record = write_measured(root)
    assert record['one']['kept']['one']['command'] == 'benchmarks/one.py --slow'
    assert record['one']['kept']['one']['text'] == TABLE
    assert not STALE_MARK.search(page.read_text())
    (root / 'measured.txt').write_text('6')
    write_measured(root)
    assert (STALE_MARK.search(page.read_text()) is None) == once
    assert list_stale(load_record(root / RECORD), [ONE], root) == ([] if once else ['one'])
    page.write_text(page.read_text().replace('| 2 |', '| 3 |'))
    assert figures.check([], root, release=False) == 1
    with pytest.raises(ValueError, match='no page shows a table between the markers of two'):
        figures.keep(['two'], '', [ONE], root)


def test_a_release_has_no_figures_outside_of_markers(root: Path) -> None:
    figures.run_benchmarks([ONE], root, quick=False)
    (root / 'README.md').write_text(f'Text.\n\n| name | text |\n| --- | --- |\n| a | b 1 |\n\n{TABLE}\n')
    write_measured(root)
    assert list_unmarked(root) == ['README.md:7: these figures are not between markers']
    assert figures.check([ONE], root, release=False) == 0
    assert figures.check([ONE], root, release=True) == 1


def test_every_benchmark_is_registered_with_sources_that_exist() -> None:
    for benchmark in figures.BENCHMARKS:
        assert benchmark.list_sources(ROOT)
    programs = {
        f.name
        for f in (ROOT / 'benchmarks').glob('*.py')
        for n in ast.parse(f.read_text()).body
        if isinstance(n, ast.ImportFrom) and n.module == 'report' and 'run' in [name.name for name in n.names]
    }
    assert programs == {b.script for b in figures.BENCHMARKS}


def test_the_record_of_this_repository_fits_its_pages() -> None:
    assert find_differences(load_record(ROOT / RECORD), ROOT) == []
