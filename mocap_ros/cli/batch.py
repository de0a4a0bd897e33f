# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros batch`: replay, reconstruct or summarise many recordings, on this machine or on a cluster."""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

from mocap_ros.cli.inputs import TOPIC_OPTIONS, VIDEO_OPTIONS, read_lens_parameters, read_video_options
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, load_config_file, option, parse_changes
from mocap_ros.cli.terminal import make_bar, print_note, print_result
from mocap_ros.errors import InputError, MocapError, tell_installation
from mocap_ros.runtime.save_results import SUFFIXES

if TYPE_CHECKING:
    from mocap_ros.batch.job import Outcome, Settings

DESCRIPTION = (
    'Replays every bag, or reconstructs or summarises every recording, that a folder, a pattern or a list '
    'names. Each is a task of Dask, which uses the cores of this machine or the workers of a running '
    'scheduler. Inputs and outputs may be URLs, such as s3://bucket/folder. What was done before is not done '
    'again, so a run that was stopped goes on. A bag that the node recorded is replayed with the parameters '
    'of the recording: --set changes single ones of them, and --config replaces all. Needs: '
    + tell_installation('cluster')
)
OPTIONS: Options = {
    'source FOLDER|GLOB|LIST': 'folder to search, pattern, or text file (.txt) of these',
    '-o --output OUT': option('folder for the results, the records and the table', required=True, type=str),
    '--work WORK': option(
        'what to do with each', choices=['replay', 'reconstruct', 'keyframes'], default='replay'
    ),
    '--scheduler ADDRESS': 'running scheduler, such as tcp://host:8786 (default: this machine)',
    '--workers N': 'processes on this machine (default: one on each core)',
    '--memory SIZE': option(
        'memory of a process on this machine, such as 2GB, above which it is ended (auto: an equal share)',
        default='auto',
    ),
    '--suffix SUFFIX': option('format of the results of --work reconstruct', choices=SUFFIXES, default='.npz'),
    **TOPIC_OPTIONS,
    **VIDEO_OPTIONS,
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Do the work on all recordings, write the table and the picture, and print the summary."""
    try:
        from mocap_ros.batch.cluster import connect, run_jobs
        from mocap_ros.batch.job import OWN_FOLDERS, UNFINISHED, Job, Status
        from mocap_ros.batch.recordings import find_recordings, is_local
        from mocap_ros.batch.report import save_report, summarise
    except ModuleNotFoundError as error:
        raise MocapError(f'{error.name} is not installed: {tell_installation("cluster")}') from None
    if args.scheduler is not None and (args.workers is not None or args.memory != 'auto'):
        raise InputError(
            '--workers and --memory are for this machine; the workers of a --scheduler have their own'
        )
    settings = _make_settings(args)
    own_folders = [settings.place(folder) for folder in OWN_FOLDERS]
    recordings = find_recordings(args.source, settings.work, own_folders, print_note)
    start = time.monotonic()
    outcomes: list[Outcome] = []
    with (
        connect(args.scheduler, args.workers, args.memory) as client,
        make_bar(desc='batch', total=len(recordings)) as bar,
    ):
        print_note(f'{len(recordings)} recordings; dashboard: {client.dashboard_link}')

        def report(outcome: Outcome) -> None:
            outcomes.append(outcome)
            bar.update()

        run_jobs(client, [Job(recording, settings) for recording in recordings], report)
    if is_local(settings.out):  # what lost workers have left
        shutil.rmtree(settings.place(UNFINISHED), ignore_errors=True)
    for path in save_report(outcomes, settings):
        print_result(path)
    for line in summarise(outcomes, time.monotonic() - start):
        print_result(line)
    failed = [outcome for outcome in outcomes if outcome.status is Status.FAILED]
    for outcome in failed:
        print_note(outcome.reason)
    rows = [row for outcome in outcomes for row in outcome.rows[:1]]
    unsound = [row for row in rows if row.get('grade') in ('doubtful', 'wrong')]
    for row in unsound:
        print_note(f'{row["url"]}: {row["note"]}')
    return int(bool(failed) or (args.strict and any(row['grade'] == 'wrong' for row in unsound)))


def _make_settings(args: argparse.Namespace) -> Settings:
    from mocap_ros.batch.job import Settings
    from mocap_ros.batch.recordings import Work

    changes = parse_changes(args)
    if args.work == Work.REPLAY.value:
        changes |= read_lens_parameters(args)
    settings = Settings(
        Work(args.work),
        args.output if '://' in args.output else str(Path(args.output).resolve()),
        config=load_config_file(args),
        changes=changes,
        topic=args.topic,
        camera_info=args.camera_info,
        video=read_video_options(args),
        suffix=args.suffix,
    )
    return settings.seal()
