# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The record of what the benchmarks measured, and the pages that show it.

`figures.json` holds one entry for each benchmark: its results, the tables and pictures made of them, and what they
were measured with (machine, versions, commit, checksums of the data). A page of `docs` or the README shows a table
between two markers,

    <!-- table: rivals.errors -->
    ...
    <!-- end of table -->

and nobody edits what is between them: `write_pages` writes it, and `find_differences` finds it edited.

An entry is stale when the code that its benchmark measures, `Benchmark.sources`, has changed since; comments,
docstrings and blank lines are no code. The tables
that its last run did not measure, and those that somebody entered by hand, are `kept` with the command, the commit
and the time of their own measurement; they are stale as well, unless they say `once`: measured to choose a
setting, and not to be repeated. Where only files of `benchmarks` have changed, and no result by that, somebody may
say so: `confirm_entry`. Nothing but the standard library is needed here, so that the check is quick.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import re
import tokenize
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

RECORD = Path('benchmarks', 'figures.json')  # from the root of the repository, as all paths in it
STALE_MARK = re.compile(r'\*Measured on \S+ at commit \S+; what it measures has changed since\.\*\n\n')
MARKER = re.compile(r'(?<=<!-- table: )(?P<name>\S+) -->\n(?P<text>.*?)(?=<!-- end of table -->)', re.DOTALL)
BEGIN, END = re.compile(r'<!--\s*table\s*:'), re.compile(r'<!--\s*end of table\s*-->')
NUMBER = re.compile(r'[\s*<±+-]*\d')  # how a cell with a figure begins
LAYOUT = ('report.py', 'panels.py')  # files of `benchmarks` that say how results look, and not what they are
CHUNK_BYTES = 1 << 20  # bytes that are read at once for a checksum

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Benchmark:
    """A benchmark and what its results depend on.

    Attributes:
        name: of its entry in the record.
        script: file below `benchmarks`, which has the options --quick and --json.
        sources: files and folders, from the root of the repository, whose change makes its results stale. The
            script is one of them, and so is what it imports from `benchmarks`, but for `LAYOUT`.
        data: files of the evaluation data that it reads, from the data's folder.
        options: further options of the script, such as the section that is to be run.
        quick_options: options of a short run, where `--quick` alone takes longer than a minute or two.
        part: file below `benchmarks` that holds this section; its imports count instead of the script's.
    """

    name: str
    script: str
    sources: Sequence[str]
    data: Sequence[str] = ()
    options: Sequence[str] = ()
    quick_options: Sequence[str] = ()
    part: str = ''

    def list_sources(self, root: Path) -> list[Path]:
        """List the files of `sources`.

        Raises:
            FileNotFoundError: one of them does not exist.
        """
        folder = root / 'benchmarks'
        files = [folder / self.script, *follow_imports(folder / (self.part or self.script), folder)]
        for source in self.sources:
            path = root / source
            if path.is_dir():
                files += sorted(f for f in path.rglob('*.py') if '__pycache__' not in f.parts)
            elif path.is_file():
                files.append(path)
            else:
                raise FileNotFoundError(f'benchmark {self.name}: there is no {source}')
        return sorted(set(files))

    def hash_sources(self, root: Path, *, only_package: bool = False) -> str:
        """Return the checksum of the sources with their names; of all, or of those outside of `benchmarks`."""
        total = hashlib.sha256()
        for file in self.list_sources(root):
            if not (only_package and file.is_relative_to(root / 'benchmarks')):
                total.update(f'{file.relative_to(root).as_posix()} {_hash_code(file)}\n'.encode())
        return total.hexdigest()


def follow_imports(file: Path, folder: Path) -> set[Path]:
    """Return a file and the files of a folder that it imports, directly or not.

    Raises:
        FileNotFoundError: there is no such file.
    """
    if not file.is_file():
        raise FileNotFoundError(f'there is no {file}')
    found, waiting = set[Path](), {file}
    while waiting:
        found.add(file := waiting.pop())
        names = _list_imports(file.read_text(encoding='utf-8'))
        imported = {folder.joinpath(*name.split('.')).with_suffix('.py') for name in names}
        waiting |= {f for f in imported if f.is_file() and f.relative_to(folder).as_posix() not in LAYOUT} - found
    return found


@cache
def _list_imports(text: str) -> frozenset[str]:
    """Return the names of the modules that a program may import; of what is no module as well."""
    names = set[str]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f'{node.module}.{alias.name}' for alias in node.names)}
    return frozenset(names)


def _hash_code(path: Path) -> str:
    """Return the checksum of a source file: of a Python program without comments, docstrings and blank lines."""
    if path.suffix != '.py':
        return hash_file(path)
    lines = path.read_text(encoding='utf-8').splitlines()
    for token in tokenize.generate_tokens(io.StringIO('\n'.join(lines)).readline):
        if token.type == tokenize.COMMENT:
            line, column = token.start
            lines[line - 1] = lines[line - 1][:column]
    for node in ast.walk(ast.parse('\n'.join(lines))):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                lines[line - 1] = ''
    code = [line.rstrip() for line in lines if line.strip()]
    return hashlib.sha256('\n'.join(code).encode()).hexdigest()


def hash_file(path: Path) -> str:
    """Return the SHA-256 checksum of a file."""
    total = hashlib.sha256()
    with path.open('rb') as file:
        while chunk := file.read(CHUNK_BYTES):
            total.update(chunk)
    return total.hexdigest()


def load_record(path: Path) -> dict[str, Any]:
    """Load a record: entries by the names of their benchmarks; empty if there is no file."""
    return json.loads(path.read_text(encoding='utf-8')) if path.is_file() else {}


def save_record(record: Mapping[str, Entry], path: Path) -> None:
    """Save a record, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix('.part')
    temporary.write_text(json.dumps(record, indent=1, sort_keys=True) + '\n', encoding='utf-8')
    temporary.replace(path)


def list_pages(root: Path) -> list[Path]:
    """List the pages that may show tables."""
    return [root / 'README.md', *sorted((root / 'docs').glob('*.md'))]


def list_stale(record: Mapping[str, Entry], benchmarks: Iterable[Benchmark], root: Path) -> list[str]:
    """List the tables whose benchmarks measure files that have changed since, or that no benchmark makes.

    A benchmark without tables is listed by its own name.
    """
    hashes = {b.name: b.hash_sources(root) for b in benchmarks}
    changed = {n: e['tables'] for n, e in record.items() if 'sources' in e and e['sources'] != hashes.get(n)}
    stale = [t for name, tables in changed.items() for t in tables or [name]]
    kept = {name: table for e in record.values() for name, table in e.get('kept', {}).items()}
    return [*stale, *(name for name, table in kept.items() if _is_stale(table, hashes))]


def _is_stale(kept: Entry, hashes: Mapping[str, str]) -> bool:
    """Return whether a table that is kept was measured before the last change of one of its benchmarks."""
    sources = kept.get('sources', {})
    return not kept.get('once') and (not sources or any(hashes.get(n) != h for n, h in sources.items()))


def put_entry(record: Mapping[str, Entry], name: str, measured: Entry) -> dict[str, Entry]:
    """Return the record with a new entry, in which the tables that were not measured again are `kept`."""
    before = record.get(name, {})
    about = {k: before.get(k, '') for k in ('command', 'commit', 'finished')}
    kept = before.get('kept', {}) | {t: {**about, 'text': text} for t, text in before.get('tables', {}).items()}
    entries = {**record, name: {**measured, 'kept': kept}}
    return {n: {**e, 'kept': _drop(e.get('kept', {}), measured['tables'])} for n, e in entries.items()}


def confirm_entry(entry: Entry, benchmark: Benchmark, root: Path) -> dict[str, Any]:
    """Return an entry, or a table that is kept, as up to date though files of `benchmarks` have changed since.

    Raises:
        ValueError: the package has changed since, or nobody knows whether it has.
    """
    now = {'sources': benchmark.hash_sources(root), 'package': benchmark.hash_sources(root, only_package=True)}
    if isinstance(entry['sources'], Mapping):  # of a table that is kept, for several benchmarks
        new: dict[str, Any] = {k: {**entry.get(k, {}), benchmark.name: v} for k, v in now.items()}
    else:
        new = dict(now)
    if entry.get('package') != new['package']:
        raise ValueError(f'{benchmark.name}: the package that it measures has changed since; measure it again')
    return {**entry, **new}


def _drop(kept: Entry, names: Iterable[str]) -> dict[str, Any]:
    return {name: table for name, table in kept.items() if name not in set(names)}


def write_pages(record: Mapping[str, Entry], stale: Sequence[str], root: Path) -> list[Path]:
    """Write the tables of the record between their markers, the stale ones with a mark; list the changed pages."""
    texts = dict(_list_tables(record, stale))
    changed = []
    for page in list_pages(root):
        before = page.read_text(encoding='utf-8')

        def replace(found: re.Match[str]) -> str:
            text = texts.get(found['name'])
            return found[0] if text is None else f'{found["name"]} -->\n{text}'

        after = MARKER.sub(replace, before)
        if after != before:
            page.write_text(after, encoding='utf-8')
            changed.append(page)
    return changed


def _list_tables(record: Mapping[str, Entry], stale: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the name and the text between the markers of every table."""
    for entry in record.values():
        measured = {name: {**entry, 'text': text} for name, text in entry.get('tables', {}).items()}
        for name, table in {**entry.get('kept', {}), **measured}.items():
            day, commit = table.get('finished', '')[:10] or '-', table.get('commit', '')[:7] or '-'
            when = f'*Measured on {day} at commit {commit}; what it measures has changed since.*\n\n'
            mark = when if name in stale else ''
            yield name, f'\n{table["text"]}\n\n{mark}'


def read_table(name: str, root: Path) -> str:
    """Return the table that a page now shows between the markers of a name.

    Raises:
        ValueError: no page shows it.
    """
    for page in list_pages(root):
        for found in MARKER.finditer(page.read_text(encoding='utf-8')):
            if found['name'] == name:
                return STALE_MARK.sub('', found['text']).strip('\n')
    raise ValueError(f'no page shows a table between the markers of {name}')


def find_cell(record: Mapping[str, Entry], table: str, rows: Sequence[str], column: str) -> str:
    """Return a cell of a table in the record; empty where there is none.

    Args:
        record: entries by the names of their benchmarks.
        table: name of the table.
        rows: beginnings of the row, in small letters, of which one is enough. A row whose first cell is one of
            them comes before rows that begin with them.
        column: header of the column.

    Raises:
        ValueError: several rows begin so.
    """
    found: dict[bool, list[str]] = {True: [], False: []}  # by whether the first cell is what was asked for
    for entry in record.values():
        text = entry.get('tables', {}).get(table) or entry.get('kept', {}).get(table, {}).get('text', '')
        header: list[str] = []
        for line in text.splitlines():
            cells = [c.strip() for c in line.strip().removeprefix('|').removesuffix('|').split('|')]
            header = cells if column in cells else header
            if header and ' | '.join(cells).casefold().startswith(tuple(rows)):
                found[cells[0].casefold() in rows].append(cells[header.index(column)])
    best = found[True] or found[False]
    if len(best) > 1:
        raise ValueError(f'{table} has several rows that begin with {" or ".join(rows)}')
    return best[0] if best else ''


def find_differences(record: Mapping[str, Entry], root: Path) -> list[str]:
    """Find what the pages show otherwise than the record says: tables by name, and pictures by checksum.

    Whether a table is marked as stale makes no difference: each change of the code would make one.
    """
    return [*_find_other_tables(record, root), *_find_other_pictures(record, root)]


def _find_other_tables(record: Mapping[str, Entry], root: Path) -> list[str]:
    texts, places = dict[str, str](), dict[str, str]()
    found = []
    for name, text in _list_tables(record, []):
        if name in texts:
            found.append(f'table {name} is in the record twice')
        texts[name] = text
    for page in list_pages(root):
        text = page.read_text(encoding='utf-8')
        place = page.relative_to(root).as_posix()
        shown = list(MARKER.finditer(text))
        if not len(shown) == len(BEGIN.findall(text)) == len(END.findall(text)):
            found.append(f'{place}: a marker of a table has no partner, or is not written as it should be')
        for table in shown:
            name = table['name']
            if name in places:
                found.append(f'{place}: table {name} is also in {places[name]}')
            places[name] = place
            if name not in texts:
                found.append(f'{place}: table {name} is not in the record')
            elif STALE_MARK.sub('', table['text']) != texts[name]:
                found.append(f'{place}: table {name} differs from the record')
    return [*found, *(f'table {name} is in the record and on no page' for name in texts if name not in places)]


def _find_other_pictures(record: Mapping[str, Entry], root: Path) -> list[str]:
    found = []
    for entry in record.values():
        for picture, checksum in entry.get('pictures', {}).items():
            path = root / picture
            if not path.is_file():
                found.append(f'{picture}: this picture is missing')
            elif hash_file(path) != checksum:
                found.append(f'{picture}: this picture differs from the record')
    return found


def list_unmarked(root: Path) -> list[str]:
    """List the tables of pages that stand between no markers though most of their cells begin with a number."""
    found = []
    for page in list_pages(root):
        text = MARKER.sub(lambda m: '\n' * m[0].count('\n'), page.read_text(encoding='utf-8'))
        for table in re.finditer(r'^\|(?P<header>.*)\|\n\|[ |:-]+\|\n(?P<rows>(\|.*\|\n)+)', text, re.MULTILINE):
            cells = [c for row in table['rows'].splitlines() for c in row.split('|')[2:-1] if c.strip()]
            if 2 * sum(bool(NUMBER.match(c)) for c in cells) > len(cells):
                line = text.count('\n', 0, table.start()) + 1
                found.append(f'{page.relative_to(root).as_posix()}:{line}: these figures are not between markers')
    return found
