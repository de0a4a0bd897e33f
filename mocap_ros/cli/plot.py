# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros plot`: draw a picture of a reconstruction."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_ros.cli.keypoint_input import (
    add_input_options,
    add_model_option,
    list_sources,
    load_input_sequence,
    load_models,
    name_file_in_errors,
)
from mocap_ros.cli.lines import print_result
from mocap_ros.cli.options import add_config_options, derive_output_stem, load_config
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.runtime.input_kind import KEYPOINT_FORMATS, KEYPOINT_KINDS, InputKind, require_kind
from mocap_ros.runtime.load_keypoints import load_input
from mocap_ros.runtime.load_results import holds_result, load_result
from mocap_ros.runtime.load_scene import select_true_joints
from mocap_ros.skeleton import skeleton_from_joints
from mocap_ros.viewing import plots

MAX_POSES = 30  # frames in a picture; more would be too small to see


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Draws some frames of a result of `reconstruct` (.npz or .mcap), or of a bag that holds skeletons, as '
        'they are. Reconstructs any other input that `reconstruct` accepts, and draws some frames of it. Each '
        'frame shows the keypoints and the 3D result as seen from the camera and from the side; a result in .npz '
        'does not hold the keypoints. If a sequence file contains the true 3D joints, the error over time is '
        'drawn as well.'
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
    """Draw the result that the input holds, or reconstruct the input and draw the result."""
    output = args.output or Path(f'{derive_output_stem(args.input)}.png')
    plots.check_picture_format(output)
    if not 1 <= args.poses <= MAX_POSES:
        raise InputError(f'--poses {args.poses}: expected 1 to {MAX_POSES}')
    require_kind(args.input, (*KEYPOINT_KINDS, InputKind.RESULT), f'{KEYPOINT_FORMATS}, or a result (.npz, .mcap)')
    config = load_config(args)
    sources = list_sources(args, config)
    check_output(output, *sources)
    drawn = _load_result(args) if holds_result(args.input) else _reconstruct(args, config)
    count = min(args.poses, len(drawn.times))
    frames = np.linspace(0, len(drawn.times) - 1, count).round().astype(int).tolist()
    labels = [f'{drawn.times[f] - drawn.times[0]:.2f} s' for f in frames]
    figure = plots.draw_poses_figure(drawn, frames, args.input.name, labels)
    with replace_output(output, *sources) as unfinished:
        plots.save_figure(figure, unfinished)
    print_result(output)
    return 0


def _reconstruct(args: argparse.Namespace, config: Config) -> plots.PlotData:
    """Reconstruct the keypoints of the input."""
    models = load_models(args, config)
    sequence = load_input_sequence(args, config)
    with name_file_in_errors(args.input):
        result = reconstruct_file(sequence, models, config)
    truth = None
    if sequence.truth is not None:
        found = select_true_joints(sequence.truth.joints, sequence.truth.joint_names, result.skeleton)
        truth = None if found is None else found.astype(np.float64)
    return plots.PlotData(
        times=sequence.timestamps,
        joints=result.joints,
        seen=result.seen,
        skeleton=result.skeleton,
        truth=truth,
        keypoints=sequence.keypoints,
        keypoint_skeleton=skeleton_from_joints(sequence.joint_names),
    )


def _load_result(args: argparse.Namespace) -> plots.PlotData:
    """Load the result that the input holds, and from a bag the keypoints of the same person as well.

    Raises:
        InputError: the result cannot be read, or an option is given that only applies to a reconstruction.
    """
    read_options = args.topic, args.camera_info, args.fps, args.image_size, args.layout, args.hfov, args.focal
    if any((*read_options, args.model, args.config, args.set)):
        raise InputError(
            f'{args.input}: holds a result, which is drawn as it is; --topic, --camera-info, --fps, --image-size, '
            '--hfov, --focal, --layout, --model, --config and --set apply to keypoints only'
        )
    result, person = load_result(args.input, args.person)
    drawn = plots.PlotData(result.times, result.joints, result.seen, result.skeleton)
    if not person:
        return drawn
    try:
        sequence, _ = load_input(args.input, Video(), Config().node, person)
    except InputError:  # the bag holds no keypoints, or the tracker chose another id than the detector
        return drawn
    keypoints = np.full((len(result.times), *sequence.keypoints.shape[1:]), [np.nan, np.nan, 0.0])
    frame_of = {stamp: frame for frame, stamp in enumerate(result.stamps_ns)}
    for stamp, points in zip(sequence.stamps_ns, sequence.keypoints, strict=True):
        if stamp in frame_of:
            keypoints[frame_of[stamp]] = points
    return replace(drawn, keypoints=keypoints, keypoint_skeleton=skeleton_from_joints(sequence.joint_names))
