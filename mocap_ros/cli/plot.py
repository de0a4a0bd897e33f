"""`mocap-ros plot`: draw a picture of a reconstruction."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.cli.options import (
    add_config_options,
    add_input_options,
    add_model_option,
    derive_output_stem,
    load_config,
    load_input_sequence,
    load_models,
    name_file_in_errors,
)
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import guard_output
from mocap_ros.skeleton import skeleton_from_joints
from mocap_ros.viewing import plots

MAX_POSES = 30  # frames in a picture; more would be too small to see


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser(
        'plot',
        help='draw a picture of the 2D input and the 3D result',
        description='Reconstructs any input that `reconstruct` accepts and draws some frames of it: the '
        'keypoints and the 3D result as seen from the camera and from the side. If the file contains the true 3D '
        'joints, the error over time is drawn as well.',
    )
    add_input_options(parser)
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT.png',
        help='picture to write; its ending selects the format (default: IN.png in the current folder)',
    )
    parser.add_argument(
        '--poses', type=int, default=8, metavar='N', help=f'number of frames to draw, 1 to {MAX_POSES}'
    )
    add_model_option(parser)
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reconstruct the input and draw the result."""
    output = args.output or Path(f'{derive_output_stem(args.input)}.png')
    plots.check_picture_format(output)
    config = load_config(args)
    models = load_models(args, config)
    sequence = load_input_sequence(args, config)
    with name_file_in_errors(args.input):
        result = reconstruct_file(sequence, models, config)
    truth = None
    if sequence.truth is not None:
        names = list(sequence.truth.joint_names)
        if set(result.skeleton.joints) <= set(names):
            truth = sequence.truth.joints[:, [names.index(n) for n in result.skeleton.joints]]
    drawn = plots.PlotData(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=skeleton_from_joints(sequence.joint_names),
        joints=result.joints,
        seen=result.seen,
        skeleton=result.skeleton,
        truth=truth,
    )
    if not 1 <= args.poses <= MAX_POSES:
        raise InputError(f'--poses {args.poses}: expected 1 to {MAX_POSES}')
    count = min(args.poses, len(sequence))
    frames = np.linspace(0, len(sequence) - 1, count).round().astype(int).tolist()
    labels = [f'{sequence.timestamps[f] - sequence.timestamps[0]:.2f} s' for f in frames]
    figure = plots.draw_poses_figure(drawn, frames, args.input.name, labels)
    with guard_output(output, args.input):
        plots.save_figure(figure, output)
    print(output)
    return 0
