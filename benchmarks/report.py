"""What a benchmark prints and writes: its text, tables and pictures, and the JSON file that the record takes in.

A benchmark is a function that takes the command line and a `Report`; `run` calls it. Tables that a page shows have
the name that stands between the page's markers (see `figure_record`).
"""

from __future__ import annotations

import common

# isort: split
import argparse
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]
Records = Sequence[Record]


@dataclass
class Report:
    """What one run of a benchmark has found so far.

    Attributes:
        file: JSON file that is written after each `add`, or None.
        results: figures and records, by name.
        tables: Markdown of the tables that pages show, by the names between their markers.
        pictures: files that were drawn for the pages, from the root of the repository.
    """

    file: Path | None = None
    results: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    pictures: list[str] = field(default_factory=list)

    def add(self, **results: Any) -> None:
        """Add results, and write the file, so that a run that is interrupted leaves what it has."""
        self.results |= results
        common.write_json(self.file, {**self.results, 'tables': self.tables, 'pictures': self.pictures})

    def text(self, *paragraphs: str) -> None:
        """Print paragraphs, an empty line before each."""
        for paragraph in paragraphs:
            print(f'\n{paragraph}', flush=True)

    def table(
        self, header: Sequence[str], rows: Iterable[Sequence[object]], title: str = '', *notes: str, page: str = ''
    ) -> None:
        """Print a table below its title and notes, and keep it for a page if that has a name for it."""
        text = common.format_table(header, rows)
        self.text(*([f'## {title}'] if title else []), *notes, text)
        if page:
            self.tables[page] = text

    def rows(self, title: str, records: Sequence[Record], page: str = '') -> None:
        """Print records as a table with a column for each of their keys."""
        header = list(dict.fromkeys(k for r in records for k in r))
        self.table(header, ([r.get(k) for k in header] for r in records), title, page=page)

    def quantities(
        self, results: Mapping[str, float], targets: Mapping[str, str], page: str, digits: int = 3
    ) -> None:
        """Print quantities as the rows of a table beside their targets, and add them to the results."""
        rows = [
            (k, f'{v:.{digits}g}' if abs(v) < 1000 else f'{v:.0f}', targets.get(k)) for k, v in results.items()
        ]
        self.table(['quantity', 'measured', 'target'], rows, page=page)
        self.add(**results)

    def picture(self, figure: Any, path: str) -> None:
        """Save a Matplotlib figure for a page, at a path from the root of the repository."""
        (common.ROOT / path).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(common.ROOT / path, dpi=110, metadata={'Software': None})
        self.pictures.append(path)

    def choose(
        self, args: argparse.Namespace, sections: Iterable[str], needing_lifter: Iterable[str] = ()
    ) -> list[str]:
        """Return the sections to run; train the held-out lifter that some need, but skip them in a short run."""
        chosen = [s for s in sections if not args.only or s in args.only]
        needing = [s for s in chosen if s in set(needing_lifter)]
        if needing and not (args.quick and not common.HELD_OUT_LIFTER.is_file()):
            common.provide_held_out_lifter()
        elif needing:
            self.text(f'skipped: {", ".join(needing)}, which need {common.HELD_OUT_LIFTER}; run without --quick')
            chosen = [s for s in chosen if s not in needing]
        return chosen

    def keep(self, page: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Keep a table for a page, in which the figures that were printed at length are in short."""
        self.tables[page] = common.format_table(header, rows)


def run(
    description: str | None,
    title: str,
    measure: Callable[[argparse.Namespace, Report], None],
    add_options: Callable[[argparse.ArgumentParser], None] | None = None,
    one_core: bool = True,
) -> None:
    """Run a benchmark: parse its command line, describe the machine, measure, and write the results.

    Args:
        description: text of the benchmark's module.
        title: heading of what is printed.
        measure: the benchmark.
        add_options: adds its own options.
        one_core: False for a benchmark that measures no times, which may run beside others.
    """
    args = common.parse_arguments(description or '', add_options, one_core)
    machine = common.describe_machine()
    print(f'# {title}\n\n{machine}', flush=True)
    given = [
        w for before, w in zip(['', *sys.argv[1:]], sys.argv[1:], strict=False) if '--json' not in (before, w)
    ]
    command = ' '.join(['benchmarks/' + Path(sys.argv[0]).name, *given])
    about = {'begun': time.time(), 'command': command, 'machine': machine, 'quick': args.quick}
    report = Report(args.json, about)
    measure(args, report)
    report.add()


def add_sections(sections: Iterable[str]) -> Callable[[argparse.ArgumentParser], None]:
    """Return the function that adds the option --only, which chooses sections of a benchmark."""
    names = list(sections)

    def add(parser: argparse.ArgumentParser) -> None:
        parser.add_argument('--only', nargs='+', choices=names, metavar='SECTION', help=f'of {", ".join(names)}')

    return add


def select(records: Iterable[Record], **values: object) -> list[Any]:
    """Return the records that have these values."""
    return [r for r in records if all(r[k] == v for k, v in values.items())]


def group(records: Iterable[Record], *keys: str) -> dict[tuple[Any, ...], list[Any]]:
    """Return the records by their values of some keys, in the order in which these first appear."""
    groups: dict[tuple[Any, ...], list[Any]] = {}
    for record in records:
        groups.setdefault(tuple(record[k] for k in keys), []).append(record)
    return groups


def cross(
    records: Iterable[Record],
    row: str,
    column: str,
    cell: Callable[[list[Any]], object],
    names: Mapping[str, str] | None = None,
) -> tuple[list[str], list[list[object]]]:
    """Return the header and the rows of a table of one key against another.

    Args:
        records: what the table shows.
        row: key whose values are the rows.
        column: key whose values are the columns.
        cell: of the records that have both values.
        names: what the table calls a key or a value that it does not call by its own name.
    """
    groups, names = group(records, row, column), names or {}
    rows, columns = (list(dict.fromkeys(values[i] for values in groups)) for i in (0, 1))
    header = [str(names.get(n, n)) for n in (row, *columns)]
    cells = [[names.get(r, r), *(cell(groups[r, c]) if (r, c) in groups else None for c in columns)] for r in rows]
    return header, cells
