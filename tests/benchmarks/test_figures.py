# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The record of the figures: runs are taken in, pages are written, and pages edited by hand are found."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import figures
import pytest
from readme import find_numbers

from tests.support.paths import ROOT

TABLE = '| method | fixed: walk |\n| --- | --- |\n| this project | 0.25 / 5 |\n| another | - |'
PAGE = 'Before.\n\n<!-- table: one -->\n<!-- end of table -->\n\nAfter.\n'


def leave_run(root: Path, name: str, text: str, date: str = '2026-11-27', *, quick: bool = False) -> None:
    """Leave what a benchmark leaves."""
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


def test_tables_that_were_measured_before_a_change_of_the_package_are_listed(root: Path) -> None:
    def git(*words: str) -> str:
        who = ('-c', 'user.name=n', '-c', 'user.email=e')
        return subprocess.run(['git', *who, *words], cwd=root, capture_output=True, text=True, check=True).stdout

    (root / 'mocap_ros').mkdir()
    (root / 'mocap_ros' / 'code.py').write_text('1')
    git('init', '-q')
    git('add', '.')
    git('commit', '-qm', 'one')
    figures.take_in(root)
    record = figures.load_record(root)
    commit = git('rev-parse', '--short', 'HEAD').strip()
    (root / figures.RECORD).write_text(json.dumps({'one': {**record['one'], 'commit': commit}}))
    assert list(figures.find_old(root)) == []
    (root / 'mocap_ros' / 'code.py').write_text('2')
    assert [line.partition(':')[0] for line in figures.find_old(root)] == ['one']


def test_numbers_of_the_readme_are_those_of_a_cell(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures.take_in(root)
    monkeypatch.setattr('common.ROOT', root)
    assert find_numbers('one', 'this project', 'fixed: walk') == [0.25, 5.0]
    for cell in (
        ('two', 'this project', 'fixed: walk'),
        ('one', 'nobody', 'fixed: walk'),
        ('one', 'another', 'fixed: walk'),
    ):
        with pytest.raises(ValueError, match=f'table {cell[0]}, row {cell[1]}'):
            find_numbers(*cell)


def test_every_benchmark_has_a_file_and_every_table_a_command() -> None:
    assert all((ROOT / 'benchmarks' / f'{name}.py').is_file() for name in figures.BENCHMARKS)
    for table in figures.load_record(ROOT).values():
        script = table['command'].split()[0]
        assert (ROOT / script).is_file(), script
