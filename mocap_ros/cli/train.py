"""`mocap-ros train`: base poses from motion capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import positive, progress
from mocap_ros.errors import MocapError
from mocap_ros.formats.mocap.joint_maps import UNITS, load_markers
from mocap_ros.formats.mocap.trials import Source, load_trials, select
from mocap_ros.formats.text_files import writing
from mocap_ros.models import model_file
from mocap_ros.training.base_poses import fit_base_poses


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'train',
        help='train base poses from motion capture',
        description='Trains base poses from motion capture: folders or files of ASF/AMC, BVH and C3D, or .npz '
        '((F, 15, 3) arrays in mm, y up, one key a trial, joint names under _joints). A manifest.csv beside them '
        'says subjects and categories; else the category of a file is the name of its folder.',
    )
    p.add_argument('data', nargs='+', type=Path, metavar='DATA', help='folder, .amc, .bvh, .c3d or .npz')
    p.add_argument('-o', '--output', type=Path, required=True, metavar='MODEL.npz', help='model to write')
    p.add_argument(
        '--markers',
        type=Path,
        metavar='YAML',
        help='joint of the model: the joints or markers whose mean it is (default: those of known rigs)',
    )
    p.add_argument(
        '--unit',
        type=positive,
        metavar='M',
        help=f'unit of length in m (default: as the file says, or what suits people: {", ".join(UNITS)})',
    )
    p.add_argument(
        '--every', type=int, default=1, metavar='N', help='take every Nth frame, such as 4 of 120 a second'
    )
    p.add_argument('--name', help='name of the model (default: the category, or all)')
    p.add_argument(
        '--manifest',
        type=Path,
        metavar='CSV',
        help='trial, subject, category, interior_glitches (default: manifest.csv beside the data, if there)',
    )
    for option, what, kept in (
        ('--category', 'only trials of this category', 'all'),
        ('--subject', 'only trials of this subject', 'all'),
        ('--without-subject', 'no trials of this subject', 'none left out'),
        ('--without-trial', 'not this trial', 'none left out'),
    ):
        p.add_argument(
            option, action='append', default=[], metavar='NAME', help=f'{what}; may be repeated (default: {kept})'
        )
    p.add_argument('--components', type=int, default=45, metavar='N', help='base poses kept at most')
    p.add_argument(
        '--alignment',
        choices=['rotation', 'heading'],
        help='of poses before the analysis (default: heading for a category, rotation for all)',
    )
    p.add_argument(
        '--mirror', action=argparse.BooleanOptionalAction, help='add mirror images (default: for a category)'
    )
    p.add_argument(
        '--bodies',
        type=int,
        metavar='N',
        help='added bodies with random bone lengths, a trial (default: 2 for a category, 0 for all)',
    )
    p.add_argument(
        '--source', default='', metavar='TEXT', help='where the data is from, kept in the model (default: empty)'
    )
    p.add_argument(
        '--acknowledgement',
        default='',
        metavar='TEXT',
        help='what its owner asks for, kept in the model (default: empty)',
    )
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train and save a model, and say what it holds."""
    if min(args.components, args.every) < 1 or (args.bodies or 0) < 0:
        raise MocapError('--components and --every must be positive and --bodies not negative')
    markers = None if args.markers is None else load_markers(args.markers)
    source = Source(args.manifest, markers, args.unit, args.every)
    trials = select(
        [t for path in args.data for t in load_trials(path, source, lambda files: progress(files, 'read'))],
        categories=args.category,
        only_subjects=args.subject,
        without_subjects=args.without_subject,
        without_trials=args.without_trial,
    )
    if not trials:
        raise MocapError('no trial is left after the selection')
    one_category = bool(args.category)
    model = fit_base_poses(
        [t.poses for t in trials],
        labels=[t.name for t in trials],
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
    with writing(args.output, *args.data):
        model_file.save_base_poses(model, args.output)
    ten = model.explained[min(9, len(model.explained) - 1)]
    print(
        f'{args.output}: {len(model.std)} base poses from {len(trials)} trials, '
        f'{sum(len(t.poses) for t in trials)} poses; the first ten hold {ten:.1%} of the variance'
    )
    return 0
