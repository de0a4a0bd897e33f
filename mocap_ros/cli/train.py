# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros train`: train base poses from motion capture (Wandt et al., TPAMI 2016, section 4.1)."""

from __future__ import annotations

import argparse
from pathlib import Path

from mocap_ros.cli.keypoint_input import list_sources
from mocap_ros.cli.lines import print_result
from mocap_ros.cli.options import parse_positive
from mocap_ros.cli.progress import show_progress
from mocap_ros.errors import MocapError
from mocap_ros.formats.mocap.joint_maps import LENGTH_UNITS_M, load_marker_map
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials, select_trials
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.models import model_file
from mocap_ros.training.balance import balance_trials
from mocap_ros.training.base_poses import fit_base_poses


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Trains base poses from motion capture: folders or files of ASF/AMC, BVH and C3D, or .npz. '
        'An .npz file holds an (F, J, 3) array in mm with y up for each trial, and under the key _joints the J '
        'joint names, among them those of the model. A manifest.csv beside the data gives the subject and the '
        'category of each trial, by which the training is balanced; without it, the category of a file is the '
        'name of its folder.'
    )
    parser.add_argument(
        'data', nargs='+', type=Path, metavar='DATA', help='motion capture: folder, .amc, .bvh, .c3d or .npz'
    )
    parser.add_argument(
        '-o', '--output', type=Path, required=True, metavar='MODEL.npz', help='model file to write'
    )
    parser.add_argument(
        '--markers',
        type=Path,
        metavar='YAML',
        help='file that maps each joint of the model to the joints or markers whose mean is the joint (default: '
        'the maps of known rigs)',
    )
    parser.add_argument(
        '--unit',
        type=parse_positive,
        metavar='M',
        help='length of the unit of the data in m (default: the unit that the file states, or else the one of '
        f'{", ".join(LENGTH_UNITS_M)} that suits a person)',
    )
    parser.add_argument(
        '--every',
        type=int,
        default=1,
        metavar='N',
        help='use every Nth frame, such as every 4th of a recording at 120 Hz',
    )
    parser.add_argument('--name', help='name of the model (default: the category, or all without --category)')
    parser.add_argument(
        '--manifest',
        type=Path,
        metavar='CSV',
        help='table with the columns trial, subject, category and interior_glitches (default: manifest.csv beside '
        'the data, if it exists)',
    )
    for option, selection, default in (
        ('--category', 'use only trials of this category', 'all'),
        ('--subject', 'use only trials of this subject', 'all'),
        ('--without-subject', 'use no trials of this subject', 'none left out'),
        ('--without-trial', 'do not use this trial', 'none left out'),
    ):
        parser.add_argument(
            option,
            action='append',
            default=[],
            metavar='NAME',
            help=f'{selection}; may be repeated (default: {default})',
        )
    parser.add_argument('--components', type=int, default=45, metavar='N', help='maximum number of base poses')
    parser.add_argument(
        '--alignment',
        choices=['rotation', 'heading'],
        help='alignment of the poses before the principal component analysis (default: heading with --category, '
        'rotation without)',
    )
    parser.add_argument(
        '--mirror',
        action=argparse.BooleanOptionalAction,
        help='add the mirror images of the poses (default: only with --category)',
    )
    parser.add_argument(
        '--bodies',
        type=int,
        metavar='N',
        help='number of bodies with random bone lengths to add for each trial (default: 2 with --category, 0 '
        'without)',
    )
    parser.add_argument(
        '--source', default='', metavar='TEXT', help='origin of the data, saved in the model (default: empty)'
    )
    parser.add_argument(
        '--acknowledgement',
        default='',
        metavar='TEXT',
        help='acknowledgement that the owner of the data asks for, saved in the model (default: empty)',
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train and save a model, and print a summary of it."""
    if min(args.components, args.every) < 1 or (args.bodies or 0) < 0:
        raise MocapError('--components and --every must be positive, and --bodies must not be negative')
    sources = list_sources(args)
    check_output(args.output, *sources)
    markers = None if args.markers is None else load_marker_map(args.markers)
    options = TrialOptions(args.manifest, markers, args.unit, args.every)
    trials = select_trials(
        [t for path in args.data for t in load_trials(path, options, lambda files: show_progress(files, 'read'))],
        categories=args.category,
        only_subjects=args.subject,
        without_subjects=args.without_subject,
        without_trials=args.without_trial,
    )
    if not trials:
        raise MocapError('the options select no trial')
    one_category = bool(args.category)
    model = fit_base_poses(
        [t.poses for t in trials],
        labels=[t.name for t in trials],
        shares=balance_trials(
            [t.category for t in trials], [t.subject for t in trials], [len(t.poses) for t in trials]
        ),
        name=args.name or '+'.join(args.category) or 'all',
        components=args.components,
        alignment=args.alignment or ('heading' if one_category else 'rotation'),
        mirror=one_category if args.mirror is None else args.mirror,
        bodies=(2 if one_category else 0) if args.bodies is None else args.bodies,
        provenance={
            'data': [path.name for path in args.data],
            'source': args.source,
            'acknowledgement': args.acknowledgement,
            'trials': [t.name for t in trials],
        },
    )
    with replace_output(args.output, *sources) as unfinished:
        model_file.save_base_poses(model, unfinished)
    explained_by_ten = model.explained[min(9, len(model.explained) - 1)]
    print_result(
        f'{args.output}: {len(model.std)} base poses from {len(trials)} trials, '
        f'{sum(len(t.poses) for t in trials)} poses; the first ten base poses explain '
        f'{explained_by_ten:.1%} of the variance'
    )
    return 0
