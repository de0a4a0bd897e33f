# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a run leaves besides the results: a table, a picture and a summary on the terminal."""

from __future__ import annotations

import io
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import yaml
from pyarrow import parquet

from mocap_ros.batch.job import COLUMNS, Outcome, Rows, Settings, Status, write_file
from mocap_ros.batch.recordings import Work
from mocap_ros.config import to_yaml
from mocap_ros.people import MotionKind
from mocap_ros.viewing.plots import draw_corpus_figure

MOTIONS = tuple(kind.name.lower() for kind in MotionKind)  # kinds of motion, as columns of the table name them


def save_report(outcomes: Sequence[Outcome], settings: Settings) -> list[str]:
    """Write the table and the picture of a run, and return their URLs.

    The table is a Parquet file with a row for each appearance of a person. Its metadata hold the parameters that
    are the same for all recordings: where bags are replayed with their own, only those that replace them.
    """
    parameters = yaml.safe_dump(dict(settings.changes)) if settings.changes else ''
    if settings.config is not None or settings.work is not Work.REPLAY:
        parameters = to_yaml(settings.parameters)
    schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in COLUMNS.items()])
    rows = [row for outcome in sorted(outcomes, key=lambda o: o.job.recording.name) for row in outcome.rows]
    rows = [{key: _make_printable(value) for key, value in row.items()} for row in rows]
    data = pa.Table.from_pylist(rows, schema=schema.with_metadata({'mocap_ros.yaml': parameters}))
    table, picture = io.BytesIO(), io.BytesIO()
    parquet.write_table(data, table, compression='zstd')
    seen = _list_appearances(outcomes)
    figure = draw_corpus_figure(
        {kind.replace('_', ' '): sum(row[f'{kind}_s'] for row in seen) for kind in MOTIONS},
        [row['cadence_hz'] for row in seen if row['cadence_hz'] is not None],
        [row['residual_px'] for row in seen if row['residual_px'] is not None],
        [outcome.seconds for outcome in outcomes if outcome.status is not Status.FAILED],
    )
    figure.savefig(picture, format='png', facecolor='white')
    files = {settings.place('table.parquet'): table, settings.place('summary.png'): picture}
    for url, content in files.items():
        write_file(url, content.getvalue())
    return list(files)


def summarise(outcomes: Sequence[Outcome], wall_seconds: float) -> list[str]:
    """Return the lines of the summary: what became of the recordings, who was seen, and what it cost."""
    counts = Counter(outcome.status for outcome in outcomes)
    seen = _list_appearances(outcomes)
    shown = {kind: sum(row[f'{kind}_s'] for row in seen) for kind in MOTIONS}
    work = sum(outcome.seconds for outcome in outcomes if outcome.status is Status.DONE)
    people = (
        f'{len(seen)} appearances of people: {shown["periodic"]:.0f} s walking or running, '
        f'{shown["non_periodic"]:.0f} s in other motion, {shown["unknown"]:.0f} s not classified'
    )
    grades = Counter(
        outcome.rows[0]['grade'] for outcome in outcomes if outcome.rows and outcome.rows[0].get('grade')
    )
    return [
        ', '.join(f'{count} {status.value}' for status, count in sorted(counts.items())),
        people,
        'input: ' + ', '.join(f'{count} {grade}' for grade, count in sorted(grades.items())),
        f'{work:.0f} CPU seconds of work in {wall_seconds:.0f} s',
    ]


def _list_appearances(outcomes: Sequence[Outcome]) -> Rows:
    return [row for outcome in outcomes for row in outcome.rows if row['from_ns'] is not None]


def _make_printable(value: Any) -> Any:
    """Return a text with bytes of a file's name that are no UTF-8 written as escapes; anything else as it is."""
    return os.fsencode(value).decode('utf-8', 'backslashreplace') if isinstance(value, str) else value
