# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view`: show any recording or result in 3D over time."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from mocap_ros.cli.keypoint_input import (
    add_input_options,
    add_model_option,
    list_sources,
    load_models,
    name_file_in_errors,
    read_video_options,
    show_detection_progress,
)
from mocap_ros.cli.lines import print_remark, print_result
from mocap_ros.cli.options import add_config_options, derive_output_stem, load_config
from mocap_ros.cli.progress import show_progress
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.formats.result_file import is_result_file
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.runtime.load_scene import SceneOptions, load_keyframe_marks, load_scene, place_marks
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene

SUFFIX = '.html'  # of the file that this command writes


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Shows skeletons in 3D beside the 2D input, and over time residual, cadence, kind of motion, undone swaps '
        'of left and right, predicted frames and dropped inputs, on a page: one file that opens in any browser, '
        'offline. Skeletons in a result of `reconstruct` (.npz, .mcap) or in a bag are shown as they are; all '
        'people in any other input that `reconstruct` accepts are reconstructed.'
    )
    add_input_options(parser)
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT.html',
        help='page to write (default: IN.html in the current folder)',
    )
    parser.add_argument(
        '--keyframes',
        type=Path,
        metavar='FILE',
        help='keyframes to mark on the time line, in the file that `keyframes` writes (default: none)',
    )
    add_model_option(parser)
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Load the scene of the input and write its page."""
    output: Path = args.output or Path(f'{derive_output_stem(args.input)}{SUFFIX}')
    given = any((args.topic, args.camera_info, args.model, args.config, args.set))
    if given and args.input.is_file() and is_result_file(args.input):
        raise InputError(
            f'{args.input}: holds a result, which is shown as it is; --topic, --camera-info, --model, --config '
            'and --set apply to keypoints only'
        )
    if output.suffix != SUFFIX:
        raise InputError(f'{output}: unknown file type; expected {SUFFIX}')
    config = load_config(args)
    sources = list_sources(args, config)
    check_output(output, *sources)
    scene = _load(args, config)
    with replace_output(output, *sources) as unfinished:
        unfinished.write_text(build_page(scene), encoding='utf-8')
    print_result(output)
    return 0


def _load(args: argparse.Namespace, config: Config) -> Scene:
    """Load the scene that the options describe, and print on stderr what was left out."""
    marks, marks_start_ns = ([], None) if args.keyframes is None else load_keyframe_marks(args.keyframes)
    options = SceneOptions(
        config=config,
        models=load_models(args, config),
        video=read_video_options(args),
        person=args.person,
        topic=args.topic,
        camera_info=args.camera_info,
        show_detection=show_detection_progress,
    )
    scene, lines = load_scene(args.input, options, lambda items, total: show_progress(items, 'view', total))
    for line in lines:
        print_remark(line)
    if marks_start_ns is not None:
        with name_file_in_errors(args.keyframes):
            marks = place_marks(marks, marks_start_ns, scene.stamps_ns)
    return replace(scene, marks=tuple(sorted((*scene.marks, *marks), key=lambda mark: mark.time_s)))
