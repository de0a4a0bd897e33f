# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros batch`: replay, reconstruct or summarise many recordings, on this machine or on a cluster."""

from __future__ import annotations

import argparse
import shutil
import time

from mocap_ros.cli.inputs import TOPIC_OPTIONS, VIDEO_OPTIONS, read_lens_parameters, read_options
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, load_config_file, option, parse_changes
from mocap_ros.cli.terminal import make_bar, print_note, print_result
from mocap_ros.config import Config
from mocap_ros.errors import InputError, MocapError, tell_installation
from mocap_ros.recordings.save_results import SUFFIXES
from mocap_ros.runtime.replay import ReplayOptions

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
        from mocap_ros.batch.job import RECORDS, RESULTS, UNFINISHED, Settings
        from mocap_ros.batch.recordings import find_recordings, open_path
        from mocap_ros.batch.run import connect, run_jobs, save_report, summarise
    except ModuleNotFoundError as error:
        raise MocapError(f'{error.name} is not installed: {tell_installation("cluster")}') from None
    if args.scheduler is not None and (args.workers is not None or args.memory != 'auto'):
        raise InputError(
            '--workers and --memory are for this machine; the workers of a --scheduler have their own'
        )
    is_replay = args.work == 'replay'
    changes = parse_changes(args)
    if is_replay:
        changes |= read_lens_parameters(args)
    options = ReplayOptions(load_config_file(args), args.topic, args.camera_info, changes=changes)
    reading = read_options(args, Config())._replace(show_detection=None)  # in a worker
    settings = Settings(args.work, open_path(args.output), options, reading, args.suffix)
    own_folders = [settings.out / name for name in (RESULTS, RECORDS, UNFINISHED)]
    key = settings.compute_key()
    recordings = find_recordings(args.source, print_note, only_bags=is_replay, leave_out=own_folders)
    start = time.monotonic()
    outcomes = []
    has_failed = False
    with (
        connect(args.scheduler, args.workers, args.memory) as client,
        make_bar(desc='batch', total=len(recordings)) as bar,
    ):
        print_note(f'{len(recordings)} recordings; dashboard: {client.dashboard_link}')
        for outcome in run_jobs(client, recordings, settings, key):
            bar.update()
            outcomes.append(outcome)
            row = outcome.rows[0]
            if outcome.status == 'failed':
                print_note(row['error'])
            elif row.get('grade') in ('doubtful', 'wrong'):
                print_note(f'{row["url"]}: {row["note"]}')
            has_failed |= outcome.status == 'failed' or (args.strict and row.get('grade') == 'wrong')
    shutil.rmtree(str(own_folders[-1]), ignore_errors=True)  # what lost workers have left
    for line in (*save_report(outcomes, settings.out), *summarise(outcomes, time.monotonic() - start)):
        print_result(line)
    return int(has_failed)
