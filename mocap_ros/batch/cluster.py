# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the work on many recordings on Dask: on the cores of this machine, or on the workers of a scheduler.

Dask alone decides what runs where and when, and does the work of a lost worker again.
"""

from __future__ import annotations

import logging
import os
import signal
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from multiprocessing import resource_tracker

import dask
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from mocap_ros.batch.job import Job, Outcome, process
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
CLIENT_SETTINGS = {'distributed.comm.timeouts.connect': CONNECT_SECONDS}


@contextmanager
def connect(scheduler: str | None, workers: int | None = None, memory: str = 'auto') -> Iterator[Client]:
    """Provide a client of a scheduler, or of a cluster of this machine that ends with the context.

    The cluster has `workers` processes, by default one on each core, of which Dask ends those that need more than
    `memory`, such as `2GB`; `auto` is an equal share of the machine's.
    """
    logging.getLogger('distributed').setLevel(SILENT)  # the outcomes say what matters of it
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
        options = {'threads_per_worker': 1, 'memory_limit': memory, 'dashboard_address': ':0'}
        options['n_workers'] = workers or len(os.sched_getaffinity(0))
        # Threads and processes that begin now never see Ctrl-C, which ends this thread, and with it the workers.
        # The first process of the standard library unblocks the signal, so it begins before.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with (
                dask.config.set(LOCAL_SETTINGS),
                LocalCluster(silence_logs=SILENT, **options) as cluster,
                Client(cluster) as client,
            ):
                signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
                yield client
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def run_jobs(client: Client, jobs: Sequence[Job], report: Callable[[Outcome], None]) -> None:
    """Do all jobs, those that come first begin first, and report each outcome as it comes."""
    run = uuid.uuid4().hex[:8]  # so that another run on the same scheduler has tasks of its own
    keys = [(f'recording-{run}', number) for number in range(len(jobs))]
    futures = client.map(process, jobs, key=keys, pure=False)
    job_of = dict(zip(futures, jobs, strict=True))
    for future in as_completed(futures):
        job = job_of.pop(future)
        error = future.exception() if future.status == 'error' else None
        if isinstance(error, KilledWorker):
            report(job.fail('the worker was lost each time; its memory may be too small'))
        elif error is not None:
            report(job.fail(f'internal error: {type(error).__name__}: {error}'))
        else:
            try:
                report(future.result())
            except (OSError, TimeoutError, CancelledError):
                address = client._scheduler_identity.get('address') or 'Dask'
                reason = 'the scheduler has gone; the same command goes on where it ended'
                raise MocapError(f'{address}: {reason}') from None
        future.release()
