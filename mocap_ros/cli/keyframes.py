# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros keyframes`: summarise a long sequence by a few poses (Loy et al., ECCV 2004)."""

from __future__ import annotations

import argparse
from pathlib import Path

from mocap_ros.cli.inputs import INPUT_OPTIONS, list_sources, load_sequences, name_file_in_errors
from mocap_ros.cli.options import CONFIG_OPTIONS, Options, derive_output_stem, load_config
from mocap_ros.cli.terminal import print_result, show_stages
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.recordings.save_keyframes import describe_keyframes, list_keyframe_entries
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.viewing import plots

MAX_PRINTED_SPANS = 6  # spans of a keyframe in its line of the table, so that the line fits a wide terminal

DESCRIPTION = (
    'Finds the poses that recur in the motion of one person (Loy et al. 2004), separately for the upper and the '
    'lower body. Prints a table of these keyframes and saves them with two pictures: the keyframes with the times '
    'at which they occur, and the distances between the poses of all frames. `reconstruct --method keyframes` '
    'computes 3D poses from the keyframes.'
)
OPTIONS: Options = {
    **INPUT_OPTIONS,
    '-o --output OUT.yaml': 'file for the keyframes; the pictures are saved beside it (default: '
    'IN_keyframes.yaml in the current folder)',
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Find the keyframes, save and draw them, and print a table."""
    output = args.output or Path(f'{derive_output_stem(args.input)}_keyframes.yaml')
    if output.suffix not in ('.yaml', '.yml'):
        raise InputError(f'{output}: unknown file type; expected .yaml')
    config = load_config(args)
    sources = list_sources(args, config)
    pictures = output.with_suffix('.png'), output.with_name(f'{output.stem}_distances.png')
    for path in (output, *pictures):
        check_output(path, *sources)
    (sequence,) = load_sequences(args, config)
    with name_file_in_errors(args.input), show_stages() as set_stage:
        found = describe_keyframes(sequence, args.input.name, config, set_stage)
    with replace_output(output, *sources) as unfinished:
        unfinished.write_text(found.listed, encoding='utf-8')
    for path, figure in zip(pictures, (found.poses, found.distances), strict=True):
        with replace_output(path, *sources) as unfinished:
            plots.save_figure(figure, unfinished)
    print_table(found.observed, found.keyframes)
    for path in (output, *pictures):
        print_result(path)
    return 0


def print_table(observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet]) -> None:
    """Print a table with a line for each keyframe, and the coverage of each half of the body."""
    print_result(f'{"half":<6} {"time, s":>9} {"frames":>7}  spans, s')
    for entry in list_keyframe_entries(observed, keyframes):
        spans = [f'{start:.1f}-{end:.1f}' for start, end in entry['spans'][:MAX_PRINTED_SPANS]]
        more = ', ...' if len(entry['spans']) > MAX_PRINTED_SPANS else ''
        print_result(
            f'{entry["half"]:<6} {entry["time"]:>9.2f} {entry["represents"]:>7}  {", ".join(spans)}{more}'
        )
    seconds = float(observed.times[-1] - observed.times[0])
    for half in keyframes:
        print_result(
            f'{half.body_half.name} body: {len(half.frames)} keyframes cover {half.coverage:.1%} of '
            f'{int(half.has_pose.sum())} frames, {seconds:.1f} s'
        )
