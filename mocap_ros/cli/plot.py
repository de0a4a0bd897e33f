"""`mocap-ros plot`: a picture of a reconstruction."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.cli.options import (
    about,
    add_config_options,
    add_input_options,
    add_model_option,
    config_from,
    input_from,
    models_from,
    name_of,
)
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import writing
from mocap_ros.skeleton import skeleton_of
from mocap_ros.viewing import plots

MOST_POSES = 30


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'plot',
        help='a picture of a sequence: 2D input and 3D result',
        description='Reconstructs what `reconstruct` takes and draws some frames: the keypoints, the 3D result '
        'from the camera and from the side, and the error over time where the file holds the truth.',
    )
    add_input_options(p)
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT.png',
        help='picture; its ending says the format (default: IN.png in this folder)',
    )
    p.add_argument('--poses', type=int, default=8, metavar='N', help=f'frames to show, 1 to {MOST_POSES}')
    add_model_option(p)
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reconstruct and draw."""
    output = args.output or Path(f'{name_of(args.input)}.png')
    plots.check_ending(output)
    config = config_from(args)
    models = models_from(args, config)
    sequence = input_from(args, config)
    with about(args.input):
        result = reconstruct_file(sequence, models, config)
    truth = None
    if sequence.truth is not None:
        names = list(sequence.truth.joint_names)
        if set(result.skeleton.joints) <= set(names):
            truth = sequence.truth.joints[:, [names.index(n) for n in result.skeleton.joints]]
    drawn = plots.Result(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=skeleton_of(sequence.joint_names),
        joints=result.joints,
        seen=result.seen,
        skeleton=result.skeleton,
        truth=truth,
    )
    if not 1 <= args.poses <= MOST_POSES:
        raise InputError(f'--poses {args.poses}: expected 1 to {MOST_POSES}')
    count = min(args.poses, len(sequence))
    frames = np.linspace(0, len(sequence) - 1, count).round().astype(int).tolist()
    labels = [f'{sequence.timestamps[f] - sequence.timestamps[0]:.2f} s' for f in frames]
    figure = plots.poses_figure(drawn, frames, args.input.name, labels)
    with writing(output, args.input):
        plots.save_figure(figure, output)
    print(output)
    return 0
