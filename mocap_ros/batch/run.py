# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the work on many recordings on Dask, and report on it: a table, a picture and a summary on the terminal.

Dask alone decides what runs where and when, on the cores of this machine or the workers of a scheduler, and does
the work of a lost worker again.
"""

from __future__ import annotations

import logging
import os
import signal
import uuid
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from operator import itemgetter
from pathlib import Path
from typing import Any

import dask
import pyarrow as pa
from distributed import Client, as_completed
from distributed.scheduler import KilledWorker
from pyarrow import parquet

from mocap_ros import MocapError
from mocap_ros.batch.job import Outcome, Settings, process
from mocap_ros.batch.recordings import BatchInput
from mocap_ros.errors import make_printable_line
from mocap_ros.viewing.plots import draw_corpus_figure

SILENT = logging.CRITICAL  # level of Dask's own messages
CONNECT_SECONDS = 10  # s without an answer after which a scheduler has gone; busy ones need a few seconds
# Number of workers that may be lost while they do one recording before the recording is taken for the cause. With
# fewer, recordings of 6 s of work would be given up by chance where a worker is lost every 10 s.
LOST_WORKERS = 9
DASK_SETTINGS = {
    'distributed.comm.timeouts.connect': CONNECT_SECONDS,
    # Of a cluster on this machine:
    'distributed.scheduler.allowed-failures': LOST_WORKERS,
    'distributed.deploy.lost-worker-timeout': '10m',  # after 15 s a busy machine has not started another one yet
    'distributed.scheduler.worker-saturation': 1.0,  # tasks that wait stay with the scheduler, and are not lost
    'distributed.worker.profile.enabled': False,  # takes 1 % of the time of a worker
    'distributed.admin.low-level-log-length': 0,  # memory of long runs
    # How often each process of the cluster looks at itself, which by default takes 4 % of a core.
    'distributed.admin.tick.interval': '1s',  # whether its event loop stands still
    'distributed.admin.system-monitor.interval': '5s',  # what the dashboard shows of the machine
    'distributed.worker.memory.monitor-interval': '500ms',  # whether it needs too much memory
}


# The columns of the table. `bag_` begins what counts for the whole recording, and is the same in all its rows.
MOTIONS = {'periodic_s': 'walking or running', 'non_periodic_s': 'in other motion', 'unknown_s': 'not classified'}
TEXTS = ('bag', 'url', 'person', 'grade', 'note', 'error', 'version', 'configuration')
COUNTS = ('from_ns', 'to_ns', 'bag_frames', 'bag_dropped', 'bag_invalid', 'bag_swaps')
NUMBERS = (*MOTIONS, 'cadence_hz', 'residual_px', 'bag_work_s')
SCHEMA = pa.schema(
    dict.fromkeys(TEXTS, pa.string()) | dict.fromkeys(COUNTS, pa.int64()) | dict.fromkeys(NUMBERS, pa.float64())
)


@contextmanager
def connect(scheduler: str | None, workers: int | None = None, memory: str = 'auto') -> Iterator[Client]:
    """Provide a client of a scheduler, or of a cluster of this machine that ends with the context.

    The cluster has `workers` processes, by default one on each core, of which Dask ends those that need more than
    `memory`, such as `2GB`; `auto` is an equal share of the machine's.
    """
    logging.getLogger('distributed').setLevel(SILENT)  # the outcomes say what matters of it
    warnings.filterwarnings('ignore', message='Creating scratch directories')  # a slow disk, once at the start
    options: dict[str, Any] = {'address': scheduler, 'timeout': CONNECT_SECONDS}
    if scheduler is None:
        options = {'n_workers': workers or len(os.sched_getaffinity(0)), 'threads_per_worker': 1}
        options |= {'memory_limit': memory, 'dashboard_address': ':0', 'silence_logs': SILENT}
    # Threads and processes that begin now never see Ctrl-C, which ends this thread, and with it the workers.
    # The first process of the standard library unblocks the signal, so it begins before.
    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        with dask.config.set(DASK_SETTINGS):
            try:
                client = Client(**options)
            except (OSError, ValueError) as error:
                raise MocapError(f'{scheduler}: no scheduler answers ({error})') from None
            with client:
                signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
                yield client
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def run_jobs(client: Client, recordings: Sequence[BatchInput], settings: Settings, key: str) -> Iterator[Outcome]:
    """Do the work on all recordings, those that come first begin first, and yield each outcome as it comes.

    `key` is that of the settings.
    """
    run = uuid.uuid4().hex[:8]  # so that another run on the same scheduler has tasks of its own
    keys = [(f'recording-{run}', number) for number in range(len(recordings))]
    work = partial(process, settings=settings, key=key)
    futures = client.map(work, recordings, key=keys, pure=False)
    recording_of = dict(zip(futures, recordings, strict=True))
    for future in as_completed(futures):
        recording = recording_of.pop(future)
        name, url = make_printable_line(recording.name), make_printable_line(str(recording.path))
        if future.status == 'error':
            reason = _explain(future.exception())
            outcome = Outcome('failed', [{'error': reason if url in reason else f'{url}: {reason}'}])
        else:
            try:
                outcome = future.result()
            except (OSError, TimeoutError, CancelledError):
                raise MocapError('the scheduler has gone; the same command goes on where it ended') from None
        future.release()
        common = {'bag': name, 'url': url, 'version': settings.version}
        yield Outcome(outcome.status, [{**common, **row} for row in outcome.rows])


def _explain(error: BaseException) -> str:
    reason = getattr(error, 'strerror', None) or str(error)
    if isinstance(error, KilledWorker):
        reason = 'the worker was lost each time; its memory may be too small'
    elif not isinstance(error, MocapError | OSError):
        reason = f'internal error: {type(error).__name__}: {reason}'
    return make_printable_line(reason)


def save_report(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """Write the table, with a row for each appearance of a person, and the picture; return their paths."""
    rows = sorted((row for outcome in outcomes for row in outcome.rows), key=itemgetter('bag'))
    table = pa.Table.from_pylist(rows, schema=SCHEMA)
    values = {name: [value for value in table[name].to_pylist() if value is not None] for name in NUMBERS}
    seconds = {motion: sum(values[name]) for name, motion in MOTIONS.items()}
    work = [outcome.rows[0]['bag_work_s'] for outcome in outcomes if outcome.status != 'failed']
    figure = draw_corpus_figure(seconds, values['cadence_hz'], values['residual_px'], work)
    paths = [folder / 'table.parquet', folder / 'summary.png']
    folder.mkdir(parents=True, exist_ok=True)
    with paths[0].open('wb') as file:
        parquet.write_table(table, file, compression='zstd')
    with paths[1].open('wb') as file:
        figure.savefig(file, format='png', facecolor='white')
    return paths


def summarise(outcomes: Sequence[Outcome], wall_seconds: float) -> list[str]:
    """Return the lines of the summary: what became of the recordings, who was seen, and what it cost."""
    rows = [row for outcome in outcomes for row in outcome.rows]
    shares = [f'{sum(row.get(name, 0) for row in rows):.0f} s {motion}' for name, motion in MOTIONS.items()]
    work = sum(outcome.rows[0]['bag_work_s'] for outcome in outcomes if outcome.status == 'done')
    return [
        _count([outcome.status for outcome in outcomes]),
        f'input: {_count([outcome.rows[0].get("grade") for outcome in outcomes])}',
        f'{sum("person" in row for row in rows)} appearances of people: {", ".join(shares)}',
        f'{work:.0f} CPU seconds of work in {wall_seconds:.0f} s',
    ]


def _count(words: Iterable[str | None]) -> str:
    return ', '.join(f'{count} {word}' for word, count in sorted(Counter(filter(None, words)).items()))
