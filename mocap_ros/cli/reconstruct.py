"""`mocap-ros reconstruct`: a whole sequence at once, from keypoints to 3D."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.bags.reader import files_in
from mocap_ros.cli.keyframes import stages
from mocap_ros.cli.options import (
    about,
    add_config_options,
    add_input_options,
    add_model_option,
    config_from,
    input_from,
    models_from,
    name_of,
    seen_in,
)
from mocap_ros.config import Config, load_yaml
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import Sequence
from mocap_ros.formats.text_files import read_text, writing
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.keyframes import reconstruct
from mocap_ros.offline.keyframes.taylor import Choice, choices_from
from mocap_ros.offline.whole_sequence import SequenceResult, reconstruct_sequence
from mocap_ros.runtime import save_results

LARGEST_CHOICES = 16 << 20


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'reconstruct',
        help='a whole sequence to 3D, every frame helping the others',
        description='Reconstructs one person over a whole sequence: a sequence file, a bag, OpenPose JSON or COCO '
        'keypoints. The ending of the output says what it is: .npz, .csv, .mcap (a bag of skeletons, cameras and '
        'markers), .bvh (for animation, cm) or .trc (for OpenSim, mm), both with y up and at a constant rate.',
    )
    add_input_options(p)
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT',
        help=f'{", ".join(save_results.ENDINGS)} (default: IN_3d.npz in this folder)',
    )
    p.add_argument(
        '--method',
        choices=['whole', 'keyframes'],
        default='whole',
        help='whole: all frames in one solve; keyframes: key poses fitted to the image, for minutes of mixed '
        'action with outliers',
    )
    p.add_argument(
        '--choices',
        type=Path,
        metavar='FILE',
        help='which limbs point towards the camera, for key poses by hand, in the file that `keyframes` writes '
        '(default: none)',
    )
    add_model_option(p)
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reconstruct, save, and say how well the image is explained."""
    output = args.output or Path(f'{name_of(args.input)}_3d.npz')
    if output.suffix not in save_results.ENDINGS:
        raise InputError(f'{output}: can write {", ".join(save_results.ENDINGS)}')
    config = config_from(args)
    models = models_from(args, config)
    sequence = input_from(args, config)
    if args.choices is not None and args.method != 'keyframes':
        raise InputError(f'{args.choices}: choices are for --method keyframes')
    if args.method == 'keyframes':
        result, said = _by_keyframes(args, sequence, models, config)
    else:
        with about(args.input):
            result = reconstruct_file(sequence, models, config)
        said = f'{result.solution.iterations} iterations' + (
            '' if result.solution.converged else ' (not converged)'
        )
    with writing(output, args.input, *files_in(args.input)):
        intrinsics = sequence.intrinsics(config.tracker.nominal_focal_length)
        save_results.save(output, save_results.Reconstructed(sequence, result, intrinsics))
    solution = result.solution
    print(
        f'{output}: {len(sequence)} frames, base poses {result.category}, residual '
        f'{np.nanmean(solution.residual):.2f} px, {said}'
    )
    return 0


def _by_keyframes(
    args: argparse.Namespace, sequence: Sequence, models: Mapping[str, BasePoses], config: Config
) -> tuple[SequenceResult, str]:
    """The reconstruction by keyframes, and what to say of it."""
    choices: tuple[Choice, ...] = ()
    if args.choices is not None:
        text = read_text(args.choices, largest=LARGEST_CHOICES)
        choices = choices_from(load_yaml(text, str(args.choices)), str(args.choices))
    with about(args.input), stages() as say:
        done = reconstruct.reconstruct(*seen_in(sequence, config), models, config, choices, say)
    upper, lower = (len(half.frames) for half in done.keyframes)
    wrong = int(done.outliers.sum())
    return done.result, f'{upper} keyframes of the upper body, {lower} of the lower, {wrong} outliers filled'


def reconstruct_file(sequence: Sequence, models: Mapping[str, BasePoses], config: Config) -> SequenceResult:
    """The reconstruction of a sequence file's content."""
    return reconstruct_sequence(*seen_in(sequence, config), models, config)
