"""The record of what the benchmarks measured, and the pages that show it.

`figures.json` holds one entry for each benchmark: its results, the tables and pictures made of them, and what they
were measured with (machine, versions, commit, checksums of the data). A page of `docs` or the README shows a table
between two markers,

    <!-- table: rivals.errors -->
    ...
    <!-- end of table -->

and nobody edits what is between them: `write_pages` writes it, and `find_differences` finds it edited. An entry is
stale when the files that its benchmark measures, `Benchmark.sources`, have changed since. Nothing but the
standard library is needed here, so that the check is quick.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RECORD = Path('benchmarks', 'figures.json')  # from the root of the repository, as all paths in it
STALE_MARK = '*Measured before the last change of what it measures.*'
MARKER = re.compile(r'(?<=<!-- table: )(?P<name>\S+) -->\n(?P<text>.*?)(?=<!-- end of table -->)', re.DOTALL)
CHUNK_BYTES = 1 << 20  # bytes that are read at once for a checksum

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Benchmark:
    """A benchmark and what its results depend on.

    Attributes:
        name: of its entry in the record.
        script: file below `benchmarks`, which has the options --quick and --json.
        sources: files and folders, from the root of the repository, whose change makes its results stale.
        data: files of the evaluation data that it reads, from the data's folder.
        options: further options of the script, such as the section that is to be run.
    """

    name: str
    script: str
    sources: Sequence[str]
    data: Sequence[str] = ()
    options: Sequence[str] = ()

    def list_sources(self, root: Path) -> list[Path]:
        """List the files of `sources`.

        Raises:
            FileNotFoundError: one of them does not exist.
        """
        files: list[Path] = []
        for source in (f'benchmarks/{self.script}', *self.sources):
            path = root / source
            if path.is_dir():
                files += sorted(f for f in path.rglob('*.py') if '__pycache__' not in f.parts)
            elif path.is_file():
                files.append(path)
            else:
                raise FileNotFoundError(f'benchmark {self.name}: there is no {source}')
        return sorted(set(files))

    def hash_sources(self, root: Path) -> str:
        """Return the checksum of the sources with their names."""
        total = hashlib.sha256()
        for file in self.list_sources(root):
            total.update(f'{file.relative_to(root).as_posix()} {hash_file(file)}\n'.encode())
        return total.hexdigest()


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
    """List the entries whose benchmarks measure files that have changed since, or that no benchmark makes."""
    hashes = {b.name: b.hash_sources(root) for b in benchmarks if b.name in record}
    return [name for name, entry in record.items() if entry['sources'] != hashes.get(name)]


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
    for benchmark, entry in record.items():
        for name, table in entry['tables'].items():
            mark = f'{STALE_MARK}\n\n' if benchmark in stale else ''
            yield name, f'\n{table}\n\n{mark}'


def find_differences(record: Mapping[str, Entry], root: Path) -> list[str]:
    """Find what the pages show otherwise than the record says: tables by name, and pictures by checksum."""
    texts = dict(_list_tables(record, []))
    found = []
    for page in list_pages(root):
        text = page.read_text(encoding='utf-8')
        place = page.relative_to(root).as_posix()
        shown = list(MARKER.finditer(text))
        if len(shown) != text.count('<!-- table: ') or len(shown) != text.count('<!-- end of table -->'):
            found.append(f'{place}: a marker of a table has no partner')
        for table in shown:
            name, text_now = table['name'], table['text'].replace(f'{STALE_MARK}\n\n', '')
            if name not in texts:
                found.append(f'{place}: table {name} is not in the record')
            elif text_now != texts[name]:
                found.append(f'{place}: table {name} differs from the record')
    for entry in record.values():
        for picture, checksum in entry['pictures'].items():
            path = root / picture
            if not path.is_file():
                found.append(f'{picture}: this picture is missing')
            elif hash_file(path) != checksum:
                found.append(f'{picture}: this picture differs from the record')
    return found
