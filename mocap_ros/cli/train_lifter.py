# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros train-lifter`: train the lifter, the network that estimates 3D poses from 2D joints."""

from __future__ import annotations

import argparse
import io
import os
import pickle
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocap_ros.cli.keypoint_input import list_sources
from mocap_ros.cli.lines import print_remark, print_result
from mocap_ros.cli.progress import show_progress
from mocap_ros.errors import MocapError, tell_installation
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials, select_trials
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.models import model_file
from mocap_ros.training.balance import balance_trials

DEFAULT_STEPS = 60000  # optimiser steps; more gain more (docs/lifter.md)
MAX_SEED = 2**63 - 1  # the largest that PyTorch takes for sure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Trains the lifter, a small network that estimates 3D poses from 2D joints. The training '
        'images are synthesised from motion capture at 30 frames per second with random cameras and the errors '
        'of a detector. The data has the formats of `mocap-ros train`. Needs PyTorch: '
        + tell_installation('train')
    )
    parser.add_argument(
        'data', nargs='+', type=Path, metavar='DATA', help='motion capture: folder, .amc, .bvh, .c3d or .npz'
    )
    parser.add_argument(
        '-o', '--output', type=Path, required=True, metavar='LIFTER.npz', help='lifter file to write'
    )
    parser.add_argument(
        '--without-subject',
        action='append',
        default=[],
        metavar='NAME',
        help='use no trials of this subject; may be repeated (default: none left out)',
    )
    parser.add_argument(
        '--every',
        type=int,
        default=1,
        metavar='N',
        help='use every Nth frame, such as every 4th of a recording at 120 Hz, so that 30 a second are left',
    )
    parser.add_argument('--steps', type=int, default=DEFAULT_STEPS, metavar='N', help='number of optimiser steps')
    parser.add_argument(
        '--checkpoint',
        type=Path,
        metavar='FILE',
        help='file that keeps the state of the training every few minutes; a training that finds one goes on from '
        'there, also with more --steps (default: none is kept)',
    )
    parser.add_argument(
        '--start-from',
        type=Path,
        metavar='LIFTER.npz',
        help='lifter whose weights the training begins with, at a lower learning rate and with its batch norms as '
        'they are; give another --seed than it had, so that the examples are new (default: random weights)',
    )
    parser.add_argument(
        '--seed', type=int, default=0, metavar='N', help='random seed of the initial weights and the examples'
    )
    parser.add_argument('--threads', type=int, default=1, metavar='N', help='number of threads of PyTorch')
    parser.add_argument(
        '--source', default='', metavar='TEXT', help='origin of the data, saved in the lifter (default: empty)'
    )
    parser.add_argument(
        '--acknowledgement',
        default='',
        metavar='TEXT',
        help='acknowledgement that the owner of the data asks for, saved in the lifter (default: empty)',
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train and save a lifter, and print its error."""
    if min(args.steps, args.threads, args.every) < 1:
        raise MocapError('--steps, --threads and --every must be positive')
    if not 0 <= args.seed <= MAX_SEED:
        raise MocapError(f'--seed {args.seed}: expected 0 to {MAX_SEED}')
    sources = list_sources(args)
    for path in (args.output, args.checkpoint):
        if path is not None:
            check_output(path, *sources)
    if args.checkpoint is not None and os.path.realpath(args.output) == os.path.realpath(args.checkpoint):
        raise MocapError(f'{args.output}: not written, because it is the checkpoint as well')
    try:
        import torch

        from mocap_ros.training.lifter import (
            START_FROM_RATE,
            TrainingSettings,
            find_fastest_precision,
            train_lifter,
        )
    except ImportError as error:
        raise MocapError(f'{error}: training needs PyTorch: {tell_installation("train")}') from None
    torch.set_num_threads(args.threads)
    trials = select_trials(
        [
            t
            for path in args.data
            for t in load_trials(path, TrialOptions(every=args.every), lambda files: show_progress(files, 'read'))
        ],
        without_subjects=args.without_subject,
    )
    if not trials:
        raise MocapError('the options select no trial')
    start = None if args.start_from is None else model_file.load_lifter(args.start_from)
    provenance = {
        'data': [path.name for path in args.data],
        'source': args.source,
        'acknowledgement': args.acknowledgement,
        'without_subjects': args.without_subject,
        'trials': [t.name for t in trials],
    }
    if start is not None:
        provenance['started_from'] = dict(start.provenance)
    shares = balance_trials(
        [t.category for t in trials], [t.subject for t in trials], [len(t.poses) for t in trials]
    )
    rate = TrainingSettings.rate if start is None else START_FROM_RATE
    settings = TrainingSettings(steps=args.steps, seed=args.seed, rate=rate)
    path = args.checkpoint
    checkpoint = None if path is None or not path.exists() else _load_checkpoint(path, args.steps)
    # a training that goes on keeps its precision, also on another processor
    precision = find_fastest_precision(settings) if checkpoint is None else checkpoint['fixed']['precision']
    settings = replace(settings, precision=precision)
    print_remark(f'the network is trained in {settings.precision}')
    lifter = train_lifter(
        [t.all_joints for t in trials],
        shares,
        settings,
        provenance,
        start=start,
        checkpoint=checkpoint,
        keep=None if path is None else lambda state: _save_checkpoint(state, path, sources),
        progress=lambda steps: show_progress(steps, 'train'),
    )
    with replace_output(args.output, *sources) as unfinished:
        model_file.save_lifter(lifter, unfinished)
    frames = sum(len(t.poses) for t in trials)
    print_result(
        f'{args.output}: trained on {len(trials)} trials, {frames} poses; mean error '
        f'{lifter.provenance["error_mm"]} mm on the last examples'
    )
    return 0


def _load_checkpoint(path: Path, steps: int) -> Mapping[str, Any]:
    """Return the checkpoint in a file; raises `MocapError` if it holds none, or one after more steps."""
    import torch

    checkpoint = None
    try:
        if zipfile.is_zipfile(path):  # as PyTorch writes it; it reads anything else as an old form, with any error
            checkpoint = torch.load(path, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise MocapError(f'{path}: no checkpoint of a training: {error}') from None
    if not isinstance(checkpoint, dict) or 'precision' not in checkpoint.get('fixed', ''):
        raise MocapError(f'{path}: no checkpoint of a training by this version')
    if checkpoint['step'] > steps:
        raise MocapError(f'{path}: has made {checkpoint["step"]} steps already, more than --steps {steps}')
    return checkpoint


def _save_checkpoint(checkpoint: Mapping[str, Any], path: Path, sources: Sequence[Path]) -> None:
    """Write a checkpoint, which must be none of the sources, as `replace_output` writes a file."""
    import torch

    content = io.BytesIO()  # PyTorch, writing a file by itself, hides why it cannot be written
    torch.save(dict(checkpoint), content)
    with replace_output(path, *sources) as unfinished:
        unfinished.write_bytes(content.getbuffer())
