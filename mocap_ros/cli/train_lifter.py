"""`mocap-ros train-lifter`: the network that proposes 3D poses, from motion capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import progress
from mocap_ros.errors import MocapError
from mocap_ros.formats.mocap.trials import EVERYTHING, load_trials, select
from mocap_ros.formats.text_files import writing
from mocap_ros.models import model_file

STEPS = 20000


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'train-lifter',
        help='train the network that proposes 3D poses, from motion capture',
        description='Trains the lifter, a small network from 2D joints to 3D poses, on motion capture at 30 '
        'frames a second seen by random cameras and by a detector that errs. Needs PyTorch: '
        'pip install mocap_ros[train]. Data as for `mocap-ros train`.',
    )
    p.add_argument('data', nargs='+', type=Path, metavar='DATA', help='folder, .amc, .bvh, .c3d or .npz')
    p.add_argument('-o', '--output', type=Path, required=True, metavar='LIFTER.npz', help='lifter to write')
    p.add_argument(
        '--without-subject',
        action='append',
        default=[],
        metavar='NAME',
        help='no trials of this subject; may be repeated (default: none left out)',
    )
    p.add_argument('--steps', type=int, default=STEPS, metavar='N', help='of the optimiser')
    p.add_argument('--seed', type=int, default=0, metavar='N', help='of weights and examples')
    p.add_argument('--threads', type=int, default=1, metavar='N', help='cores to train on')
    p.add_argument(
        '--source', default='', metavar='TEXT', help='where the data is from, kept in the lifter (default: empty)'
    )
    p.add_argument(
        '--acknowledgement',
        default='',
        metavar='TEXT',
        help='what its owner asks for, kept in the lifter (default: empty)',
    )
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train and save a lifter."""
    if min(args.steps, args.threads) < 1:
        raise MocapError('--steps and --threads must be positive')
    try:
        import torch

        from mocap_ros.training.lifter import Training, train
    except ImportError as error:
        raise MocapError(f'{error}: training needs PyTorch (pip install mocap_ros[train])') from None
    torch.set_num_threads(args.threads)
    trials = select(
        [t for path in args.data for t in load_trials(path, EVERYTHING, lambda files: progress(files, 'read'))],
        without_subjects=args.without_subject,
    )
    if not trials:
        raise MocapError('no trial is left after the selection')
    provenance = {
        'data': [path.name for path in args.data],
        'source': args.source,
        'acknowledgement': args.acknowledgement,
        'without_subjects': args.without_subject,
        'trials': [t.name for t in trials],
    }
    settings = Training(steps=args.steps, seed=args.seed)
    trained = train([t.poses for t in trials], settings, provenance, lambda steps: progress(steps, 'train'))
    with writing(args.output):
        model_file.save_lifter(trained, args.output)
    frames = sum(len(t.poses) for t in trials)
    print(
        f'{args.output}: trained on {len(trials)} trials, {frames} poses; mean error '
        f'{trained.provenance["error_mm"]} mm on the last examples'
    )
    return 0
