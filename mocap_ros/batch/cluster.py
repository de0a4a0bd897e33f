# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the work on many recordings on Dask: on the cores of this machine, or on the workers of a scheduler.

Dask alone decides what runs where and when, and does the work of a lost worker again. This module gives it a task
for each recording, largest first, and collects what became of them.
"""

from __future__ import annotations

import logging
import os
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from mocap_ros.batch.job import Job, Outcome, Status, describe_failure, join_parts, process
from mocap_ros.errors import MocapError

SILENT = logging.CRITICAL  # level of Dask's own messages
CONNECT_SECONDS = 10  # s without an answer after which a scheduler has gone; busy ones need a few seconds
# Number of workers that may be lost while they do one recording before the recording is taken for the cause. With
# fewer, recordings of 6 s of work would be given up by chance where a worker is lost every 10 s.
LOST_WORKERS = 9
LOCAL_SETTINGS = {
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
EVENTS = 'all'  # topic of the scheduler on which it tells of all workers
CLIENT_SETTINGS = {'distributed.comm.timeouts.connect': CONNECT_SECONDS}


@contextmanager
def connect(scheduler: str | None, workers: int | None = None, memory: str = 'auto') -> Iterator[Client]:
    """Provide a client of a scheduler, or of a cluster of this machine that ends with the context.

    Args:
        scheduler: address of a running scheduler, such as `tcp://host:8786`; None for a cluster of this machine.
        workers: number of processes of the local cluster; None for one on each core.
        memory: memory of a process of the local cluster, such as `2GB`, above which Dask ends it; `auto` for
            an equal share of the machine's.

    Raises:
        MocapError: the scheduler does not answer.
    """
    logging.getLogger('distributed').setLevel(SILENT)  # what matters of it is told by the outcomes
    warnings.filterwarnings('ignore', message='Creating scratch directories')  # a slow disk, once at the start
    with dask.config.set(CLIENT_SETTINGS):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=CONNECT_SECONDS)
            except (OSError, ValueError) as error:
                raise MocapError(f'{scheduler}: no scheduler answers ({" ".join(str(error).split())})') from None
            with client:
                yield client
            return
        count = workers or len(os.sched_getaffinity(0))
        with (
            dask.config.set(LOCAL_SETTINGS),
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                memory_limit=memory,
                dashboard_address=':0',
                silence_logs=SILENT,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client


def run_jobs(client: Client, jobs: Sequence[Job], report: Callable[[Outcome], None]) -> int:
    """Do all jobs, and report each outcome as it comes.

    A bag that is cut becomes tasks of its parts and one that joins them. A worker whose disk is full gets no more
    work, and its job is done by another.

    Args:
        client: client of the scheduler.
        jobs: the jobs; those that come first begin first.
        report: called with the outcome of each job.

    Returns:
        Number of the workers that were lost with unfinished work, or with results that they had not told yet.

    Raises:
        MocapError: the scheduler has gone, or no worker has space on its disk.
    """
    run = uuid.uuid4().hex[:8]  # so that another run on the same scheduler has tasks of its own
    jobs = [replace(job, run=run) for job in jobs]
    keys = [(f'recording-{run}', number) for number in range(len(jobs))]
    futures = client.map(process, jobs, key=keys, pure=False)
    job_of = dict(zip(futures, jobs, strict=True))
    waiting = as_completed(futures)
    with _note_lost_workers(client) as lost_workers:
        for future in waiting:
            job = job_of.pop(future)
            outcome = _read_outcome(client, future, job)
            future.release()
            if outcome.status is Status.CUT:
                joined = _submit_parts(client, outcome)
                job_of[joined] = job
                waiting.add(joined)
            elif outcome.status is Status.DISK_FULL:
                _retire(client, outcome)
                again = client.submit(process, job, pure=False)
                job_of[again] = job
                waiting.add(again)
            else:
                report(outcome)
    return len(lost_workers)


@contextmanager
def _note_lost_workers(client: Client) -> Iterator[list[str]]:
    """Provide a list to which the address of every worker is added that the scheduler loses with its work."""
    lost: list[str] = []

    def note(event: tuple[float, Mapping[str, Any]]) -> None:
        _, content = event
        is_lost = content.get('action') == 'remove-worker' and not content.get('expected')
        if is_lost and (content.get('processing-tasks') or content.get('lost-computed-tasks')):
            lost.append(str(content.get('worker')))

    client.subscribe_topic(EVENTS, note)
    try:
        yield lost
    finally:
        if client.status == 'running':
            client.unsubscribe_topic(EVENTS)


def _submit_parts(client: Client, outcome: Outcome) -> Future:
    """Submit the parts of a recording and the task that joins them; return the future of the latter."""
    jobs = [replace(outcome.job, part=part) for part in outcome.parts]
    parts = [client.submit(process, job, pure=False, priority=1) for job in jobs]
    return client.submit(join_parts, outcome.job, parts, pure=False, priority=2)


def _read_outcome(client: Client, future: Future, job: Job) -> Outcome:
    """Return the outcome of a task that has ended, whatever ended it."""
    if future.status == 'finished':
        with suppress(OSError, TimeoutError):
            outcome: Outcome = future.result()
            return outcome
    error = future.exception() if future.status == 'error' else None
    if isinstance(error, KilledWorker):
        return describe_failure(
            job,
            f'{job.recording.url}: the worker was lost each time; its memory may be too small',
        )
    if error is not None:
        return describe_failure(job, f'{job.recording.url}: internal error: {type(error).__name__}: {error}')
    raise MocapError(
        f'{_describe_scheduler(client)}: the scheduler has gone; the same command goes on where it ended'
    )


def _describe_scheduler(client: Client) -> str:
    return str(client._scheduler_identity.get('address') or 'Dask')


def _retire(client: Client, outcome: Outcome) -> None:
    """Give a worker no more work, because its disk is full.

    Raises:
        MocapError: it is the last one.
    """
    workers = set(client.scheduler_info(n_workers=-1)['workers'])
    if workers <= {outcome.worker}:
        raise MocapError(f'{outcome.reason}; no worker has space left; what is done is kept')
    if outcome.worker in workers:
        client.retire_workers([outcome.worker], close_workers=True)
