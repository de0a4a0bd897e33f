# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros train`: train base poses (Wandt et al., TPAMI 2016, section 4.1) or the lifter."""

from __future__ import annotations

import argparse
import io
import os
import pickle
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.cli.inputs import list_sources
from mocap_ros.cli.options import Options, option, parse_count
from mocap_ros.cli.terminal import print_note, print_result, show_progress
from mocap_ros.errors import InputError, MocapError, tell_installation
from mocap_ros.formats.mocap.joint_maps import LENGTH_UNITS_M, load_marker_map
from mocap_ros.formats.mocap.trials import Trial, TrialOptions, load_trials, select_trials
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.models import model_file
from mocap_ros.training.fit_base_poses import fit_base_poses
from mocap_ros.training.motion_library import balance_trials
from mocap_ros.training.postures import KINDS

LIFTER_OPTIONS = ('steps', 'checkpoint', 'start_from', 'seed', 'without')  # options with --lifter only
DEFAULT_STEPS = 60000  # optimiser steps; more gain more
MAX_SEED = 2**63 - 1  # the largest that PyTorch takes for sure

DESCRIPTION = (
    'Trains base poses from motion capture: folders or files of ASF/AMC, BVH and C3D, or .npz. '
    'An .npz file holds an (F, J, 3) array in mm with y up for each trial, and under the key _joints the J '
    'joint names, among them those of the model. A manifest.csv beside the data gives the subject and the '
    'category of each trial, by which the training is balanced; without it, the category of a file is the '
    'name of its folder. With --lifter it trains instead the network that estimates 3D poses from 2D joints, '
    'on images that are synthesised from the motion capture at 30 frames per second with random cameras and '
    'the errors of a detector; this needs PyTorch: ' + tell_installation('train')
)
OPTIONS: Options = {
    'data DATA': option('motion capture: folder, .amc, .bvh, .c3d or .npz', nargs='+'),
    '-o --output MODEL.npz': option('model file to write', required=True),
    '--lifter': 'train a lifter (default: base poses)',
    '--markers YAML': 'file that maps each joint of the model to the joints or markers whose mean is the joint '
    '(default: the maps of known rigs)',
    '--unit M': 'length of the unit of the data in m (default: the unit that the file states, or else the one of '
    f'{", ".join(LENGTH_UNITS_M)} that suits a person)',
    '--every N': option(
        'use every Nth frame, such as every 4th of a recording at 120 Hz; a lifter wants 30 a second', default=1
    ),
    '--manifest CSV': 'table with the columns trial, subject, category and interior_glitches (default: '
    'manifest.csv beside the data, if it exists)',
    '--category NAME': option(
        'use only trials of this category; may be repeated (default: all)', action='append', default=[]
    ),
    '--without-subject NAME': option(
        'use no trials of this subject; may be repeated (default: none left out)', action='append', default=[]
    ),
    '--source TEXT': option('origin of the data, saved in the model (default: empty)', default=''),
    '--acknowledgement TEXT': option(
        'acknowledgement that the owner of the data asks for, saved likewise (default: empty)', default=''
    ),
    '--steps N': f'with --lifter, number of optimiser steps (default: {DEFAULT_STEPS})',
    '--checkpoint FILE': 'with --lifter, file that keeps the state of the training every few minutes; a training '
    'that finds one goes on from there, also with more --steps (default: none is kept)',
    '--start-from LIFTER.npz': 'with --lifter, one whose weights the training begins with, at a lower learning '
    'rate and with its batch norms as they are, and of which the result keeps a part; give another --seed than it '
    'had, so that the examples are new (default: random weights)',
    '--seed N': option(
        'with --lifter, random seed of the initial weights and the examples (default: 0)',
        type=partial(parse_count, low=0, high=MAX_SEED),
    ),
    '--without KIND': option(
        'with --lifter, leave out kinds of synthesised postures, to measure what they are good for: '
        f'{", ".join(KINDS)} (default: none)',
        nargs='+',
        choices=KINDS,
    ),
}


def run(args: argparse.Namespace) -> int:
    """Train and save a model, and print a summary of it."""
    for name in () if args.lifter else LIFTER_OPTIONS:
        if getattr(args, name) is not None:
            raise InputError(f'--{name.replace("_", "-")}: applies only to --lifter')
    sources = list_sources(args)
    for path in filter(None, (args.output, args.checkpoint)):
        check_output(path, *sources)
    if args.checkpoint is not None and os.path.realpath(args.output) == os.path.realpath(args.checkpoint):
        raise MocapError(f'{args.output}: not written, because it is the checkpoint as well')
    (_train_lifter if args.lifter else _train_base_poses)(args, sources)
    return 0


def _load_trials(args: argparse.Namespace) -> tuple[list[Trial], NDArray[np.float64], dict[str, Any]]:
    markers = None if args.markers is None else load_marker_map(args.markers)
    options = TrialOptions(args.manifest, markers, args.unit, args.every)
    trials = select_trials(
        [t for path in args.data for t in load_trials(path, options, lambda files: show_progress(files, 'read'))],
        categories=args.category,
        without_subjects=args.without_subject,
    )
    if not trials:
        raise MocapError('the options select no trial')
    provenance = {
        'data': [path.name for path in args.data],
        'source': args.source,
        'acknowledgement': args.acknowledgement,
        'trials': [t.name for t in trials],
    }
    categories, subjects = [t.category for t in trials], [t.subject for t in trials]
    return trials, balance_trials(categories, subjects, [len(t.poses) for t in trials]), provenance


def _train_base_poses(args: argparse.Namespace, sources: Sequence[Path]) -> None:
    """Train base poses: of one category of motion aligned by heading, with mirror images and other bodies."""
    trials, shares, provenance = _load_trials(args)
    one_category = bool(args.category)
    model = fit_base_poses(
        [t.poses for t in trials],
        labels=[t.name for t in trials],
        shares=shares,
        name='+'.join(args.category) or 'all',
        alignment='heading' if one_category else 'rotation',
        mirror=one_category,
        bodies=2 if one_category else 0,
        provenance=provenance,
    )
    with replace_output(args.output, *sources) as unfinished:
        model_file.save_base_poses(model, unfinished)
    explained_by_ten = model.explained[min(9, len(model.explained) - 1)]
    print_result(
        f'{args.output}: {len(model.std)} base poses from {len(trials)} trials, '
        f'{sum(len(t.poses) for t in trials)} poses; the first ten base poses explain '
        f'{explained_by_ten:.1%} of the variance'
    )


def _train_lifter(args: argparse.Namespace, sources: Sequence[Path]) -> None:
    try:
        import torch

        from mocap_ros.training import lifter as training
    except ImportError as error:
        raise MocapError(f'{error}: training needs PyTorch: {tell_installation("train")}') from None
    torch.set_num_threads(1)
    trials, shares, provenance = _load_trials(args)
    provenance['without_subjects'] = args.without_subject
    steps = args.steps or DEFAULT_STEPS
    path = args.checkpoint
    start = None if args.start_from is None else model_file.load_lifter(args.start_from)
    settings = training.TrainingSettings(steps=steps, seed=args.seed or 0, without=tuple(args.without or ()))
    if start is not None:
        provenance['started_from'] = dict(start.provenance)
        settings = replace(settings, rate=training.START_FROM_RATE)
    checkpoint = None if path is None or not path.exists() else _load_checkpoint(path, steps)
    # a training that goes on keeps its precision, also on another processor
    precision = checkpoint['fixed']['precision'] if checkpoint else training.find_fastest_precision(settings)
    print_note(f'the network is trained in {precision}')
    lifter = training.train_lifter(
        [t.all_joints for t in trials],
        shares,
        replace(settings, precision=precision),
        provenance,
        start=start,
        checkpoint=checkpoint,
        keep=None if path is None else lambda state: _save_checkpoint(state, path, sources),
        progress=lambda numbers: show_progress(numbers, 'train'),
    )
    with replace_output(args.output, *sources) as unfinished:
        model_file.save_lifter(lifter, unfinished)
    print_result(
        f'{args.output}: trained on {len(trials)} trials, {sum(len(t.poses) for t in trials)} poses; mean error '
        f'{lifter.provenance["error_mm"]} mm on the last examples'
    )


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
