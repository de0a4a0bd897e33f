# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a benchmark prints and leaves: Markdown tables, and one JSON with command, commit, date and machine.

A benchmark is a set of sections, functions of a `Report` that may return results. Those named by `--only` run, or
all. The JSON goes to `build/figures/`, from where `figures.py write` takes the tables of whole runs into the
record.
"""

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from types import FrameType
from typing import Any

import common
import numpy as np
import scipy

Record = Mapping[str, Any]
Records = Sequence[Record]
FOLDER = common.ROOT / 'build' / 'figures'


@dataclass
class Report:
    """What one run of a benchmark has found so far.

    Attributes:
        args: the command line.
        about: command, commit, date, machine and whether the run is a short one.
        tables: Markdown by the names that stand between the marks of a page.
        results: numbers and records by name.
    """

    args: argparse.Namespace
    about: dict[str, Any]
    tables: dict[str, str] = field(default_factory=dict)
    results: dict[str, Any] = field(default_factory=dict)

    @property
    def quick(self) -> bool:
        return bool(self.args.quick)

    def save(self) -> None:
        """Write the JSON, so that a run that is interrupted leaves what it has."""
        self.args.json.parent.mkdir(parents=True, exist_ok=True)
        found = {**self.about, 'tables': self.tables, 'results': self.results}
        self.args.json.write_text(json.dumps(found, indent=1, default=_to_builtin) + '\n', encoding='utf-8')

    def text(self, text: str) -> None:
        print(f'\n{text}', flush=True)

    def table(
        self, header: Sequence[str], rows: Iterable[Sequence[object]], title: str = '', page: str = ''
    ) -> None:
        """Print a table below its title, and keep it for a page if it has a name there."""
        table = format_table(header, rows)
        self.text(f'## {title or page}\n\n{table}')
        if page:
            self.tables[page] = table

    def rows(self, title: str, records: Records, page: str = '') -> None:
        """Print records as a table with a column for each of their keys."""
        header = list(dict.fromkeys(k for r in records for k in r))
        self.table(header, ([r.get(k) for k in header] for r in records), title, page)

    def quantities(
        self,
        found: Mapping[str, float],
        targets: Mapping[str, object],
        page: str,
        words: Mapping[str, str] | None = None,
    ) -> None:
        """Print quantities, in words if there are any, beside their targets, and keep them as results."""
        words = words or {}
        values = {k: f'{v:.3g}' if abs(v) < 1000 else f'{v:.0f}' for k, v in found.items()}
        shown = ((words.get(k, k), value, targets.get(k)) for k, value in values.items())
        self.table(['quantity', 'measured', 'target'], shown, page=page)
        self.results |= found


Section = Callable[[Report], Record | None]


def run(
    description: str | None,
    sections: Mapping[str, Section],
    add_options: Callable[[argparse.ArgumentParser], None] = lambda _: None,
    one_core: bool = False,
) -> None:
    """Run the sections of a benchmark, and leave its JSON.

    Args:
        description: text of the benchmark's module.
        sections: by the names of `--only`.
        add_options: adds options of the benchmark.
        one_core: whether it measures times, and runs on one core.
    """
    name = Path(sys.argv[0]).stem
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--quick', action='store_true', help='a short version, a minute or two')
    parser.add_argument('--json', type=Path, metavar='FILE', help='default: build/figures/NAME.json')
    parser.add_argument('--only', nargs='+', choices=list(sections), metavar='SECTION', help=', '.join(sections))
    add_options(parser)
    args = parser.parse_args()
    if not common.data_path('bench', 'protocol.py').is_file():
        print(f'skipped: no evaluation data in {common.data_path()}; set MOCAP_ROS_SHARED to its folder')
        return
    args.json = args.json or FOLDER / f'{name}{".quick" if args.quick else ""}.json'
    signal.signal(signal.SIGTERM, _exit_at_signal)
    if one_core and hasattr(os, 'sched_setaffinity'):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    given = [w for w in sys.argv[1:] if w not in ('--json', str(args.json))]
    report = Report(args, {'command': ' '.join([f'benchmarks/{name}.py', *given]), **describe_run()})
    report.about['quick'] = args.quick
    print(f'{report.about["command"]}\n{report.about["machine"]}', flush=True)
    for section in args.only or sections:
        report.results |= sections[section](report) or {}
        report.save()


def _exit_at_signal(number: int, _frame: FrameType | None) -> None:
    """End the process as at its end, so that the nodes that it has started do not remain."""
    sys.exit(128 + number)


def describe_run() -> dict[str, str]:
    """Return commit, date and machine, with the present CPU time of the reference kernel."""
    git = ['git', '-C', str(common.ROOT)]
    commit = subprocess.run([*git, 'rev-parse', '--short', 'HEAD'], capture_output=True, text=True, check=False)
    dirty = subprocess.run([*git, 'status', '--porcelain', '-uno'], capture_output=True, check=False).stdout
    info = Path('/proc/cpuinfo')
    models = [x.partition(':')[2].strip() for x in info.read_text().splitlines() if 'model name' in x]
    versions = f'Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}'
    kernel = f'{common.REFERENCE_KERNEL}: {common.measure_reference_kernel_s():.2f} s'
    return {
        'commit': commit.stdout.strip() + '+' * bool(dirty),
        'date': datetime.now(timezone.utc).date().isoformat(),
        'machine': f'{models[0] if models else platform.machine()}; {versions}; {kernel}',
    }


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
    """Return header and rows of a table of one key against another; `names` are those that are shown instead."""
    groups, names = group(records, row, column), names or {}
    rows, columns = (list(dict.fromkeys(values[i] for values in groups)) for i in (0, 1))
    header = [str(names.get(n, n)) for n in (row, *columns)]
    cells = [[names.get(r, r), *(cell(groups[r, c]) if (r, c) in groups else None for c in columns)] for r in rows]
    return header, cells


def format_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a Markdown table; floats get two decimals, None becomes a dash."""
    cells = [[f'{c:.2f}' if isinstance(c, float) else '-' if c is None else str(c) for c in row] for row in rows]
    lines = ['| ' + ' | '.join(header) + ' |', '|' + ' --- |' * len(header)]
    return '\n'.join(lines + ['| ' + ' | '.join(row) + ' |' for row in cells])


def _to_builtin(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f'the results contain a {type(value).__name__}')
