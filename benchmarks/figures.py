# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the benchmarks, and put their tables into the pages.

Commands:

    run [NAME ...]    run benchmarks one after the other, and write the pages; with --quick in their short forms,
                      which takes minutes and changes no page
    write             take the tables of whole runs in build/figures/ into the record, and write the pages
    check             find pages that differ from the record; with --release, tables that were measured before the
                      last change of the package as well

The record, `figures.json`, holds every table with its command, commit, date and machine. A page shows one between
the marks `<!-- table: NAME -->` and `<!-- end of table -->`; edits between them are overwritten.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path('build', 'figures')
RECORD = Path('benchmarks', 'figures.json')
MARKS = re.compile(r'(?<=<!-- table: )(?P<name>\S+) -->\n(?P<text>.*?)(?=<!-- end of table -->)', re.DOTALL)
MARK = re.compile(r'<!--\s*(?:table\s*:|end of table)')
# The benchmarks, with options of their short form. `readme` comes last, since it shows what others have measured.
BENCHMARKS: Mapping[str, Sequence[str]] = {
    'detectors': ('--detectors', 'mediapipe', '--seeds', '0'),
    'table1': (),
    'paper': (),
    'keyframes': (),
    'robots': (),
    'engine': (),
    'faults': (),
    'verticals': (),
    'stream': (),
    'feet': (),
    'postures': (),
    'depth': (),
    'merging': (),
    'cameras': (),
    'deviations': (),
    'videos': (),
    'readme': (),
}

Table = Mapping[str, str]  # text, command, commit, date and machine


def load_record(root: Path = ROOT) -> dict[str, Table]:
    """Load the tables by their names."""
    path = root / RECORD
    return json.loads(path.read_text(encoding='utf-8')) if path.is_file() else {}


def take_in(root: Path) -> None:
    """Take the tables of whole runs into the record, unless it has newer ones."""
    record = load_record(root)
    for path in sorted((root / BUILD).glob('*.json'), key=lambda p: p.stat().st_mtime):
        found = json.loads(path.read_text(encoding='utf-8'))
        if found['quick']:
            continue
        about = {key: found[key] for key in ('command', 'commit', 'date', 'machine')}
        for name, text in found['tables'].items():
            if found['date'] >= record.get(name, {}).get('date', ''):
                record[name] = {**about, 'text': text}
    (root / RECORD).write_text(json.dumps(record, indent=1, sort_keys=True) + '\n', encoding='utf-8')


def find_cell(table: str, row: str, column: str, root: Path = ROOT) -> str:
    """Return the cell of a table in the record, in the row that begins with a text.

    Raises:
        ValueError: there is no such cell.
    """
    lines = load_record(root).get(table, {}).get('text', '').splitlines()
    header, _, *rows = [[c.strip() for c in line.strip().strip('|').split('|')] for line in lines] or [[], []]
    for cells in rows:
        if column in header and ' | '.join(cells).startswith(row):
            return cells[header.index(column)]
    raise ValueError(f'the record has no cell in table {table}, row {row}, column {column}')


def format_shown(table: Table) -> str:
    """Return what stands between the marks."""
    return f'\n{table["text"]}\n\n*`{table["command"]}`, {table["date"]}, commit {table["commit"]}.*\n\n'


def list_pages(root: Path) -> list[Path]:
    return [root / 'README.md', *sorted((root / 'docs').glob('*.md'))]


def write(root: Path) -> None:
    """Write the tables of the record between their marks, and print which pages changed."""
    record = load_record(root)

    def replace(found: re.Match[str]) -> str:
        table = record.get(found['name'])
        return found[0] if table is None else f'{found["name"]} -->\n{format_shown(table)}'

    for page in list_pages(root):
        before = page.read_text(encoding='utf-8')
        if (after := MARKS.sub(replace, before)) != before:
            page.write_text(after, encoding='utf-8')
            print(f'written: {page.relative_to(root)}')


def find_differences(root: Path) -> Iterator[str]:
    """Yield what pages show otherwise than the record says."""
    record = load_record(root)
    places: dict[str, str] = {}
    for page in list_pages(root):
        text, place = page.read_text(encoding='utf-8'), page.relative_to(root).as_posix()
        shown = list(MARKS.finditer(text))
        if 2 * len(shown) != len(MARK.findall(text)):
            yield f'{place}: a mark of a table has no partner, or is not written as it should be'
        for found in shown:
            name = found['name']
            if name in places:
                yield f'{place}: table {name} is also in {places[name]}'
            if name not in record:
                yield f'{place}: table {name} is not in the record'
            elif found['text'] != format_shown(record[name]):
                yield f'{place}: table {name} differs from the record'
            places[name] = place


def find_old(root: Path) -> Iterator[str]:
    """Yield the tables that were measured before the last change of the package."""
    for name, table in load_record(root).items():
        commit = table['commit'].rstrip('+')
        command = ['git', '-C', str(root), 'diff', '--quiet', commit, '--', 'mocap_ros']
        if subprocess.run(command, capture_output=True, check=False).returncode:
            yield f'{name}: measured at {table["commit"]}, and the package has changed since'


def check(root: Path, *, release: bool) -> int:
    """Print what should be mended; return 1 if there is something."""
    found = [*find_differences(root), *(find_old(root) if release else ())]
    for line in found:
        print(line)
    return int(bool(found))


def run(names: Sequence[str], root: Path, *, quick: bool) -> int:
    """Run benchmarks; return how many failed."""
    (root / BUILD).mkdir(parents=True, exist_ok=True)
    failed = 0
    for name in names:
        log, begun = root / BUILD / f'{name}.log', time.monotonic()
        print(f'{name}: running', flush=True)
        command = [sys.executable, str(root / 'benchmarks' / f'{name}.py')]
        command += ['--quick', *BENCHMARKS[name]] if quick else []
        with log.open('w', encoding='utf-8') as file:
            status = subprocess.run(
                command, stdout=file, stderr=subprocess.STDOUT, cwd=root, check=False
            ).returncode
        failed += bool(status)
        print(
            f'    {time.monotonic() - begun:.0f} s' + f', failed with {status}: {log}' * bool(status), flush=True
        )
        if not quick and not status:
            take_in(root)
            write(root)
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest='command', required=True)
    running = commands.add_parser('run', help='run benchmarks')
    running.add_argument('names', nargs='*', metavar='NAME', help=f'of {", ".join(BENCHMARKS)}; all by default')
    running.add_argument('--quick', action='store_true', help='run the short forms')
    commands.add_parser('write', help='write the pages')
    checking = commands.add_parser('check', help='compare the pages with the record')
    checking.add_argument('--release', action='store_true', help='name also what was measured before a change')
    args = parser.parse_args()
    if args.command == 'run':
        if unknown := set(args.names) - set(BENCHMARKS):
            parser.error(f'there is no benchmark {", ".join(sorted(unknown))}')
        return min(run(args.names or list(BENCHMARKS), ROOT, quick=args.quick), 1)
    if args.command == 'check':
        return check(ROOT, release=args.release)
    take_in(ROOT)
    write(ROOT)
    return 0


if __name__ == '__main__':
    sys.exit(main())
