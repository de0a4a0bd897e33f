# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What comes out of a run besides the results: a table, a picture and a summary on the terminal."""

from __future__ import annotations

import io
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import yaml
from pyarrow import parquet

from mocap_ros.batch.job import COLUMNS, Outcome, Settings, Status
from mocap_ros.batch.recordings import Work
from mocap_ros.batch.storage import join_url, write_whole
from mocap_ros.config import to_yaml
from mocap_ros.people import MotionKind
from mocap_ros.viewing.corpus_plot import draw_corpus_figure

TABLE = 'table.parquet'  # file of the table in the folder of the run
PICTURE = 'summary.png'  # file of the picture
MOTIONS = tuple(kind.name.lower() for kind in MotionKind)  # kinds of motion, as columns of the table name them


def save_report(outcomes: Sequence[Outcome], settings: Settings) -> list[str]:
    """Write the table and the picture of a run, and return their URLs.

    Raises:
        OSError: a file cannot be written.
    """
    table, picture = join_url(settings.out, TABLE), join_url(settings.out, PICTURE)
    write_whole(table, encode_table(outcomes, _describe_parameters(settings)))
    rows = _list_appearances(outcomes)
    figure = draw_corpus_figure(
        {kind.replace('_', ' '): sum(row[f'{kind}_s'] for row in rows) for kind in MOTIONS},
        [row['cadence_hz'] for row in rows if row['cadence_hz'] is not None],
        [row['residual_px'] for row in rows if row['residual_px'] is not None],
        [outcome.seconds for outcome in outcomes if outcome.status is not Status.FAILED],
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', facecolor='white')
    write_whole(picture, buffer.getvalue())
    return [table, picture]


def _describe_parameters(settings: Settings) -> str:
    """Return the parameter file that gives what is the same for all recordings of a run.

    Where bags are replayed with the parameters of their recorded runs, it gives only those that replace them.
    """
    if settings.config is not None or settings.work is not Work.REPLAY:
        return to_yaml(settings.parameters)
    return yaml.safe_dump(dict(settings.changes)) if settings.changes else ''


def _list_appearances(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return the rows of the table that describe an appearance."""
    return [row for outcome in outcomes for row in outcome.rows if row['from_ns'] is not None]


def encode_table(outcomes: Sequence[Outcome], parameters: str) -> bytes:
    """Return the table of a run as a Parquet file: a row for each appearance of a person.

    Args:
        outcomes: what became of the recordings.
        parameters: the parameters of the run as YAML, which the file holds as metadata.
    """
    schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in COLUMNS.items()])
    rows = [row for outcome in sorted(outcomes, key=lambda o: o.job.recording.name) for row in outcome.rows]
    rows = [{key: _make_printable(value) for key, value in row.items()} for row in rows]
    table = pa.Table.from_pylist(rows, schema=schema.with_metadata({'mocap_ros.yaml': parameters}))
    buffer = io.BytesIO()
    parquet.write_table(table, buffer, compression='zstd')
    return buffer.getvalue()


def _make_printable(value: Any) -> Any:
    """Return a text with bytes of a file's name that are no UTF-8 written as escapes; anything else as it is."""
    return os.fsencode(value).decode('utf-8', 'backslashreplace') if isinstance(value, str) else value


def summarise(outcomes: Sequence[Outcome], wall_seconds: float, lost_workers: int = 0) -> list[str]:
    """Return the lines of the summary: what became of the recordings, who was seen, and what it cost.

    Args:
        outcomes: what became of the recordings.
        wall_seconds: s that the run took.
        lost_workers: number of the workers that were lost with work.
    """
    counts = Counter(outcome.status for outcome in outcomes)
    rows = _list_appearances(outcomes)
    shown = {kind: sum(row[f'{kind}_s'] for row in rows) for kind in MOTIONS}
    work = sum(outcome.seconds for outcome in outcomes if outcome.status is Status.DONE)
    people = (
        f'{len(rows)} appearances of people: {shown["periodic"]:.0f} s walking or running, '
        f'{shown["non_periodic"]:.0f} s in other motion, {shown["unknown"]:.0f} s not classified'
    )
    lost = 'a worker was lost; its work was given to another'
    if lost_workers > 1:
        lost = f'{lost_workers} workers were lost; their work was given to others'
    return [
        ', '.join(f'{count} {status.value}' for status, count in sorted(counts.items())),
        people,
        f'{work:.0f} CPU seconds of work in {wall_seconds:.0f} s',
        *([lost] if lost_workers else []),
    ]
