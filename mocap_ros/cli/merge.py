# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros merge`: merge the people whom several cameras saw."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mocap_ros.arrays import Array
from mocap_ros.cli.inputs import MODEL_OPTIONS, list_sources, load_models
from mocap_ros.cli.options import CONFIG_OPTIONS, Options, derive_output_stem, load_config, option
from mocap_ros.cli.reconstruct import OUTPUT_OPTION, check_outputs, choose_endings, save_people
from mocap_ros.cli.terminal import ShareBar, print_note
from mocap_ros.errors import InputError
from mocap_ros.formats.cameras_file import Cameras, load_cameras
from mocap_ros.offline.whole_sequence import report_part
from mocap_ros.recordings.merge_people import merge_recordings
from mocap_ros.recordings.reconstruct import ReconstructionOptions, load_or_reconstruct

MAX_PEOPLE = 16  # of a recording that is reconstructed; each one takes seconds

DESCRIPTION = (
    'Merges the people whom two cameras or more saw at the same time: results of `reconstruct`, bags of '
    'skeletons, or what `reconstruct` reads, which is reconstructed. The result is in the optical frame and at '
    'the times of the first camera, with its keypoints, and can be used like any other. Where the cameras are is '
    'in a file, which `mocap-ros cameras` finds from the same recordings.'
)
OPTIONS: Options = {
    'input IN': option('recording of each camera: a result, bag, or what `reconstruct` reads', nargs='+'),
    '--cameras FILE': option('file of the poses of the cameras, in the order of the inputs', required=True),
    '--all-people': 'save every person, into files whose names end with their ids (default: the one seen most)',
    '-o --output OUT': OUTPUT_OPTION,
    **MODEL_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Load or reconstruct the recordings, merge them, and save the people."""
    first: Path = args.input[0]
    outputs = args.output or [Path(f'{derive_output_stem(first)}_merged.npz')]
    config = load_config(args)
    sources = [*list_sources(args, config), args.cameras]
    check_outputs(outputs, sources)
    if len(args.input) < 2:
        raise InputError(f'{first}: expected the recordings of two cameras or more')
    poses, offsets = choose_cameras(load_cameras(args.cameras), args.input, args.cameras)
    options = ReconstructionOptions(config, load_models(args, config), max_people=MAX_PEOPLE)
    recordings = []
    with ShareBar('merge') as report:
        for index, path in enumerate(args.input):
            recordings.append(load_or_reconstruct(path, options, report_part(report, index, len(args.input) + 1)))
        people = merge_recordings(
            [recording.people for recording in recordings],
            poses,
            offsets,
            report_part(report, len(args.input), len(args.input) + 1),
        )
    for recording in recordings:
        for note in recording.notes:
            print_note(note)
    if not args.all_people:
        people = (max(people, key=lambda poses: int(poses.in_sight.sum())),)
    endings = choose_endings([poses.id for poses in people]) if args.all_people else ['']
    return int(not save_people(first, people, endings, outputs, sources))


def choose_cameras(cameras: Cameras, inputs: Sequence[Path], path: Path) -> tuple[Array, Array]:
    """Return the poses (C, 4, 4) and clock offsets (C,) s of the inputs' cameras, by name or in their order."""
    names = [derive_output_stem(source) for source in inputs]
    if set(names) <= set(cameras.names) and len(set(names)) == len(names):
        rows = [cameras.names.index(name) for name in names]
        return cameras.poses[rows], cameras.clock_offsets[rows]
    if len(inputs) != len(cameras.names):
        raise InputError(f'{path}: {len(cameras.names)} cameras, but {len(inputs)} recordings')
    return cameras.poses, cameras.clock_offsets
