# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The record of the figures: what is measured again, what is stale, and tables that were edited by hand."""

from __future__ import annotations

import ast
import json
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import figures
import numpy as np
import pytest
from figure_record import (
    RECORD,
    STALE_MARK,
    Benchmark,
    find_cell,
    find_differences,
    follow_imports,
    list_stale,
    list_unmarked,
    load_record,
    save_record,
    write_pages,
)
from hypothesis import given, settings
from hypothesis import strategies as st

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


@settings(max_examples=50)
@given(table=st.text(st.characters(exclude_categories=['C']), max_size=60).filter(lambda t: '<!--' not in t))
def test_any_table_comes_back_from_its_page(tmp_path_factory: pytest.TempPathFactory, table: str) -> None:
    root = tmp_path_factory.mktemp('root')
    (root / 'README.md').write_text(PAGE, encoding='utf-8')
    record = {'x': make_entry(one=table)}
    write_pages(record, [], root)
    assert find_differences(record, root) == []
    assert (root / 'README.md').read_text(encoding='utf-8').startswith('Before.\n')
    assert (root / 'README.md').read_text(encoding='utf-8').endswith('\n\nAfter.\n')
    other = {'x': make_entry(one=f'{table}.')}
    assert find_differences(other, root)


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


def test_a_table_of_two_benchmarks_is_found(root: Path) -> None:
    (root / 'docs' / 'page.md').write_text(SHOWN)
    record = {'x': make_entry(one=TABLE), 'y': make_entry(one=TABLE)}
    assert find_differences(record, root) == ['table one is in the record twice']


def test_cells_are_found_by_the_whole_first_cell_or_by_a_beginning_that_is_unique() -> None:
    rows = '| | a | b |\n| --- | --- | --- |\n| smooth, true | 1 | |\n| smooth | 2 | 3 |\n| other, x | 4 | 5 |'
    record = {'x': make_entry(one=rows)}
    assert find_cell(record, 'one', ('smooth',), 'a') == '2'
    assert find_cell(record, 'one', ('smooth, true',), 'b') == ''
    assert find_cell(record, 'one', ('other', 'absent'), 'b') == '5'
    assert find_cell(record, 'one', ('absent',), 'a') == find_cell(record, 'one', ('other',), 'c') == ''
    with pytest.raises(ValueError, match='one has several rows that begin with smoo'):
        find_cell(record, 'one', ('smoo',), 'a')


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


def test_a_benchmark_that_measures_nothing_is_no_success(root: Path) -> None:
    (root / 'benchmarks' / 'one.py').write_text('print("skipped: no evaluation data")')
    assert figures.run_benchmarks([ONE], root, quick=True) == 1
    assert not (root / figures.QUICK_RECORD).exists()


def test_a_short_run_reaches_no_page_and_not_the_record(root: Path) -> None:
    assert figures.run_benchmarks([ONE], root, quick=True) == 0
    assert not (root / RECORD).exists()
    assert load_record(root / figures.QUICK_RECORD)['one']['command'] == 'benchmarks/one.py --quick'


def test_a_release_is_kept_only_when_nothing_is_stale_or_missing(root: Path) -> None:
    figures.run_benchmarks([ONE], root, quick=False)
    write_measured(root)
    assert figures.keep_release([ONE, TWO], root, '0.3.0') == 1  # the second was never measured
    assert not (root / figures.HISTORY).exists()
    assert figures.keep_release([ONE], root, '0.3.0') == 0
    assert figures.load_history(root / figures.HISTORY) == {'0.3.0': load_record(root / RECORD)}
    assert (root / figures.PICTURE_OF_HISTORY).read_bytes().startswith(b'\x89PNG')


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


def test_a_table_that_was_entered_by_hand_gives_way_to_the_measured_one(root: Path) -> None:
    figures.keep(['one'], 'by hand', [], root, once=True)
    figures.enter(TWO, write_results(root), root)
    record = write_measured(root)
    assert record['one']['kept'] == {}
    assert '| 7 |' in (root / 'docs' / 'page.md').read_text()


def test_results_of_sources_that_changed_meanwhile_are_stale(root: Path) -> None:
    file = write_results(root)
    os.utime(root / 'measured.txt', (time.time() + 10,) * 2)
    figures.enter(ONE, file, root)
    assert list_stale(load_record(root / RECORD), [ONE], root) == ['one']


def test_results_can_be_confirmed_when_only_the_benchmark_was_rewritten_meanwhile(root: Path) -> None:
    for changed, is_confirmed in ((root / 'benchmarks' / 'one.py', True), (root / 'measured.txt', False)):
        file = write_results(root)
        os.utime(changed, (time.time() + 10,) * 2)
        figures.enter(ONE, file, root)
        assert list_stale(load_record(root / RECORD), [ONE], root) == ['one']
        if is_confirmed:
            figures.confirm([ONE], 'a function has another name', root)
        else:
            with pytest.raises(ValueError, match='measure it again'):
                figures.confirm([ONE], 'nobody knows', root)
        assert list_stale(load_record(root / RECORD), [ONE], root) == ([] if is_confirmed else ['one'])
        os.utime(changed, (0, 0))


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


def test_results_are_confirmed_when_only_their_benchmark_changed(root: Path) -> None:
    figures.run_benchmarks([ONE], root, quick=False)
    (root / 'docs' / 'page.md').write_text(PAGE + PAGE.replace('one', 'one.other'))
    write_page_table(root, 'one.other')
    figures.keep(['one.other'], 'by hand', [ONE], root)
    (root / 'benchmarks' / 'one.py').write_text(SCRIPT + '\nanother_name = True\n')
    assert list_stale(load_record(root / RECORD), [ONE], root) == ['one', 'one.other']
    figures.confirm([ONE], 'the same results of a short run', root)
    assert list_stale(load_record(root / RECORD), [ONE], root) == []
    assert load_record(root / RECORD)['one']['confirmed'][0]['because'] == 'the same results of a short run'
    (root / 'measured.txt').write_text('6')
    with pytest.raises(ValueError, match='one: the package that it measures has changed since; measure it again'):
        figures.confirm([ONE], 'nobody knows', root)
    assert list_stale(load_record(root / RECORD), [ONE], root) == ['one', 'one.other']


def test_a_release_has_no_figures_outside_of_markers(root: Path) -> None:
    figures.run_benchmarks([ONE], root, quick=False)
    (root / 'README.md').write_text(f'Text.\n\n| name | text |\n| --- | --- |\n| a | b 1 |\n\n{TABLE}\n')
    write_measured(root)
    assert list_unmarked(root) == ['README.md:7: these figures are not between markers']
    assert figures.check([ONE], root, release=False) == 0
    assert figures.check([ONE], root, release=True) == 1


def test_headlines_are_found_in_any_release() -> None:
    rows = [
        '| row | now | mean |',
        '| --- | --- | --- |',
        '| OpenPose | 1 | 2 |',
        '| OpenPose, both | 3 | **64** |',
    ]
    text = '\n'.join(rows)
    for record in ({'x': {'tables': {'t': text}}}, {'x': {'kept': {'t': {'text': text}}}}):
        assert figures.find_headline(record, 't', ('openpose, both',), 'mean') == 64
    for table, row, column in (('u', 'openpose', 'mean'), ('t', 'other', 'mean'), ('t', 'openpose', 'then')):
        assert np.isnan(figures.find_headline(record, table, (row,), column))


def test_releases_are_in_the_order_of_their_versions(tmp_path: Path) -> None:
    for version in ('0.10.0', '0.2.0', '0.9.1'):
        save_record({}, tmp_path / f'{version}.json')
    assert list(figures.load_history(tmp_path)) == ['0.2.0', '0.9.1', '0.10.0']


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


@pytest.mark.parametrize('sources', [figures.SOLVERS, figures.TRACKER], ids=['solvers', 'tracker'])
def test_what_solvers_and_tracker_use_of_the_geometry_is_a_source(sources: Sequence[str]) -> None:
    files = {f for s in sources for f in ((ROOT / s).rglob('*.py') if (ROOT / s).is_dir() else [ROOT / s])}
    geometry = ROOT / 'mocap_ros' / 'geometry'
    used = {u for f in files for u in follow_imports(f, ROOT) if u.is_relative_to(geometry)}
    assert geometry / 'rotations.py' in used
    assert used - files == set()


def test_every_section_of_the_paper_is_measured_from_its_module() -> None:
    tree = ast.parse((ROOT / 'benchmarks' / 'paper.py').read_text())
    (sections,) = (n.value for n in tree.body if isinstance(n, ast.AnnAssign) and isinstance(n.value, ast.Dict))
    modules = {
        ast.literal_eval(key): value.value.id
        for key, value in zip(sections.keys, sections.values, strict=True)
        if isinstance(key, ast.Constant) and isinstance(value, ast.Attribute) and isinstance(value.value, ast.Name)
    }
    assert {**modules, 'targets': 'targets'} == figures.PAPER_SECTIONS


def test_what_a_benchmark_imports_is_a_source_but_for_the_layout(root: Path) -> None:
    folder = root / 'benchmarks'
    (folder / 'parts').mkdir()
    (folder / 'one.py').write_text('import report\nfrom parts import first')
    (folder / 'parts' / 'first.py').write_text('def f() -> None:\n    import parts.second')
    for name in ('parts/second.py', 'parts/third.py', 'report.py'):
        (folder / name).write_text('')
    names = {f.relative_to(folder).as_posix() for f in ONE.list_sources(root) if f.is_relative_to(folder)}
    assert names == {'one.py', 'parts/first.py', 'parts/second.py'}
    part = replace(ONE, part='parts/third.py')
    names = {f.relative_to(folder).as_posix() for f in part.list_sources(root) if f.is_relative_to(folder)}
    assert names == {'one.py', 'parts/third.py'}


@pytest.mark.parametrize(
    ('text', 'is_same'),
    [
        ('"""Other."""\n\n\ndef f(x):\n    """New\n    text."""\n    return x + "# 1"\n', True),
        ('def f(x):\n    # why\n    return x + "# 1"', True),
        ('def f(x):\n    return x + "# 2"', False),
        ('def f(x):\n    return x', False),
    ],
    ids=['docstrings', 'comments', 'text', 'code'],
)
def test_comments_and_docstrings_make_no_figure_stale(root: Path, text: str, is_same: bool) -> None:
    file = root / 'benchmarks' / 'one.py'
    file.write_text('"""One."""\ndef f(x):  # what\n    return x + "# 1"\n')
    before = ONE.hash_sources(root)
    file.write_text(text)
    assert (ONE.hash_sources(root) == before) is is_same


def test_a_source_that_does_not_exist_is_named(root: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r'benchmark one: there is no gone\.txt'):
        Benchmark('one', 'one.py', ('gone.txt',)).hash_sources(root)


def test_the_record_of_this_repository_fits_its_pages() -> None:
    assert find_differences(load_record(ROOT / RECORD), ROOT) == []
