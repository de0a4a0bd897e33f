# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a benchmark prints and writes: its text, tables and pictures, and the JSON file that the record takes in.

A benchmark is a function that takes the command line and a `Report`, or several sections by name; `run` calls
them. What a page shows has the name that stands between the page's markers (see `figure_record`).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import common
import numpy as np
import scipy

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
        quick: whether this is a short run, which draws no picture.
    """

    file: Path | None = None
    results: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    pictures: list[str] = field(default_factory=list)
    quick: bool = False
    _page: list[str] | None = None  # what the part of a page that is being written has so far

    def add(self, **results: Any) -> None:
        """Add results, and write the file, so that a run that is interrupted leaves what it has."""
        self.results |= results
        if self.file is not None:
            found = {**self.results, 'tables': self.tables, 'pictures': self.pictures}
            self.file.write_text(json.dumps(found, indent=1, default=_to_builtin) + '\n', encoding='utf-8')

    @contextmanager
    def write_page(self, name: str) -> Iterator[None]:
        """Keep all text, tables and pictures until the end of the context as what a page shows."""
        self._page = []
        yield
        self.tables[name], self._page = '\n\n'.join(self._page), None

    def text(self, *paragraphs: str) -> None:
        """Print paragraphs, an empty line before each."""
        for paragraph in paragraphs:
            text = paragraph if self._page is None else ' '.join(paragraph.split())
            print(f'\n{text}', flush=True)
            self._keep(text)

    def _keep(self, text: str) -> None:
        if self._page is not None:
            self._page.append(text)

    def table(
        self, header: Sequence[str], rows: Iterable[Sequence[object]], title: str = '', *notes: str, page: str = ''
    ) -> None:
        """Print a table below its title and notes, and keep it for a page if that has a name for it."""
        text = format_table(header, rows)
        self.text(*([f'## {title}'] if title else []), *notes)
        print(f'\n{text}', flush=True)
        self._keep(text)
        if page:
            self.tables[page] = text

    def rows(self, title: str, records: Sequence[Record], *notes: str, page: str = '') -> None:
        """Print records as a table with a column for each of their keys."""
        header = list(dict.fromkeys(k for r in records for k in r))
        self.table(header, ([r.get(k) for k in header] for r in records), title, *notes, page=page)

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
        """Save a Matplotlib figure for a page, at a path from the root of the repository; not in a short run."""
        if not self.quick:
            (common.ROOT / path).parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(common.ROOT / path, dpi=110, metadata={'Software': None})
            self.pictures.append(path)

    def paper_figure(self, name: str, figure: Any, alternative: str) -> None:
        """Save a figure of the paper's experiments, and show it on the page that is being written."""
        self.picture(figure, f'docs/img/paper/{name}.png')
        self._keep(f'![{alternative}](img/paper/{name}.png)')

    def keep(self, page: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Keep a table for a page, in which the figures that were printed at length are in short."""
        self.tables[page] = format_table(header, rows)


# A part of a benchmark: of the report and whether the run is a short one; its results.
Section = Callable[[Report, bool], Mapping[str, Any] | None]


def run(
    description: str | None,
    title: str,
    measure: Callable[[argparse.Namespace, Report], None] | Mapping[str, Section],
    add_options: Callable[[argparse.ArgumentParser], None] | None = None,
    one_core: bool = True,
) -> None:
    """Run a benchmark: parse its command line, describe the machine, measure, and write the results.

    The process ends here, with a message, if the evaluation data is missing.

    Args:
        description: text of the benchmark's module.
        title: heading of what is printed.
        measure: the benchmark, or its sections by name, of which the option --only chooses some.
        add_options: adds its own options.
        one_core: False for a benchmark that measures no times, which may run beside others.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--quick', action='store_true', help='run a short version, which takes less than a minute')
    parser.add_argument('--json', type=Path, metavar='FILE', help='also write the results to this file')
    if isinstance(measure, Mapping):
        add_sections(parser, measure)
    if add_options is not None:
        add_options(parser)
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, _exit_at_signal)
    if one_core and hasattr(os, 'sched_setaffinity'):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    protocol = common.data_path('bench', 'protocol.py')
    if not protocol.is_file():
        print(f'skipped: no evaluation data in {protocol.parent.parent}; set MOCAP_ROS_SHARED to its folder')
        sys.exit(0)
    machine = describe_machine()
    print(f'# {title}\n\n{machine}', flush=True)
    given = [
        w for before, w in zip(['', *sys.argv[1:]], sys.argv[1:], strict=False) if '--json' not in (before, w)
    ]
    command = ' '.join(['benchmarks/' + Path(sys.argv[0]).name, *given])
    about = {'begun': time.time(), 'command': command, 'machine': machine, 'quick': args.quick}
    report = Report(args.json, about, quick=args.quick)
    if isinstance(measure, Mapping):
        for name in args.only or measure:
            report.add(**(measure[name](report, args.quick) or {}))
    else:
        measure(args, report)
    report.add()


def _exit_at_signal(number: int, _frame: FrameType | None) -> None:
    """End the process as at its end, so that the nodes that it has started do not remain."""
    sys.exit(128 + number)


def add_sections(parser: argparse.ArgumentParser, sections: Iterable[str]) -> None:
    """Add the option --only, which chooses sections of a benchmark."""
    names = list(sections)
    parser.add_argument('--only', nargs='+', choices=names, metavar='SECTION', help=f'of {", ".join(names)}')


def describe_machine() -> str:
    """Describe the machine in one line: processor, versions, and the current CPU time of the reference kernel."""
    cpu = platform.processor() or platform.machine()
    info = Path('/proc/cpuinfo')
    if info.is_file():
        models = [line.partition(':')[2].strip() for line in info.read_text().splitlines() if 'model name' in line]
        cpu = models[0] if models else cpu
    cores = len(os.sched_getaffinity(0))
    return (
        f'{cpu}, {cores} cores, one BLAS thread; Python {platform.python_version()}, NumPy {np.__version__}, '
        f'SciPy {scipy.__version__}; reference kernel ({common.REFERENCE_KERNEL}): '
        f'{common.measure_reference_kernel_s():.3f} s'
    )


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


def format_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a Markdown table; floats get two decimals, None becomes a dash."""
    cells = [[_format_cell(c) for c in row] for row in rows]
    lines = ['| ' + ' | '.join(header) + ' |', '|' + ' --- |' * len(header)]
    return '\n'.join(lines + ['| ' + ' | '.join(row) + ' |' for row in cells])


def _format_cell(value: object) -> str:
    return f'{value:.2f}' if isinstance(value, float) else '-' if value is None else str(value)


def _to_builtin(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f'the results contain a {type(value).__name__}')
