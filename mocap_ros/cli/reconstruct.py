# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros reconstruct`: reconstruct a whole sequence in 3D from its 2D keypoints."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from mocap_ros.cli.inputs import (
    INPUT_OPTIONS,
    MODEL_OPTIONS,
    list_sources,
    load_models,
    name_file_in_errors,
    read_options,
)
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, derive_output_stem, load_config, option
from mocap_ros.cli.terminal import ShareBar, finish, print_note, print_result, show_stages
from mocap_ros.config import Config, load_yaml, with_values
from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import BLENDER_IMPORT
from mocap_ros.formats.text_files import check_output, read_text, replace_output
from mocap_ros.geometry.level import average_vertical
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.offline.keyframes.taylor import DepthChoice, parse_depth_choices
from mocap_ros.offline.whole_sequence import Report, Solved, solve_sequence
from mocap_ros.people import PoseSequence
from mocap_ros.recordings import save_results
from mocap_ros.recordings.reconstruct import Method, ReconstructionOptions, reconstruct

MAX_ENDING = 64  # characters of a person's id in the name of a file
MAX_CHOICES_BYTES = 16 << 20  # bytes; guards against parsing a huge file as keyframes

DESCRIPTION = (
    'Reconstructs one person over a whole sequence, so that every frame supports the others. The input is a '
    'sequence file, a bag, JSON or a table of a detector, or a video. The ending of the output file selects its '
    'format: .npz, .csv, .mcap (a bag of skeletons, cameras and markers), .bvh (for animation, in cm), '
    '.angles.csv (joint angles), or .trc (markers for OpenSim, in mm). In .bvh and .trc, y points up and the '
    'frame rate is constant.'
)
OUTPUT_OPTION = option(
    f'file to write: {", ".join(save_results.SUFFIXES)}; may be repeated (default: IN_3d.npz, of `merge` '
    'IN_merged.npz, in the current folder)',
    action='append',
    default=[],
)
OPTIONS: Options = {
    **INPUT_OPTIONS,
    '--all-people': 'reconstruct every person who is seen in ten frames or more, into files whose names end with '
    "the person's id (default: one person)",
    '-o --output OUT': OUTPUT_OPTION,
    '--method METHOD': option(
        'whole: all frames are solved together; keyframes: key poses are fitted to the image, for minutes of '
        'mixed action with outliers',
        choices=['whole', 'keyframes'],
        default='whole',
    ),
    '--choices FILE': 'limbs that point towards the camera, for key poses chosen by hand, in the file that '
    '`keyframes` writes (default: none)',
    '--floor-height H': 'm, height of the camera above the floor; give tracker.vertical as well (default: the '
    'parameter tracker.camera_height)',
    **MODEL_OPTIONS,
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Reconstruct the people in the input, save the results, and print what they rest on."""
    outputs = args.output or [Path(f'{derive_output_stem(args.input)}_3d.npz')]
    config = load_config(args)
    if args.floor_height is not None:
        config = with_values(config, {'tracker.camera_height': args.floor_height})
    sources = list_sources(args, config)
    _check_options(args, outputs, sources)
    options = ReconstructionOptions(
        config,
        load_models(args, config),
        read_options(args, config),
        max_people=None if args.all_people else 1,
        method=_choose_method(args),
    )
    with ShareBar('reconstruct') as report:
        recording = reconstruct(args.input, options, report)
    for note in recording.notes:
        named = note if args.floor_height is None else note.replace('tracker.camera_height', '--floor-height', 1)
        print_note(named)
    endings = choose_endings([poses.id for poses in recording.people]) if args.all_people else ['']
    is_all_saved = save_people(args.input, recording.people, endings, outputs, sources)
    summary = recording.summary
    return finish(args.input, summary, summary.is_wrong, is_strict=args.strict) or int(not is_all_saved)


def _check_options(args: argparse.Namespace, outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    check_outputs(outputs, sources)
    if args.all_people and args.person is not None:
        raise InputError(f'{args.input}: --person and --all-people exclude each other')
    if args.floor_height is not None and args.method == 'keyframes':
        raise InputError(f'{args.input}: --floor-height does not apply to --method keyframes')
    if args.choices is not None and args.method != 'keyframes':
        raise InputError(f'{args.choices}: --choices needs --method keyframes')


def check_outputs(outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    """Check the files to write, which must be of a known type and none of the sources."""
    for output in outputs:
        if not save_results.find_suffix(output):
            raise InputError(f'{output}: unknown file type; expected {", ".join(save_results.SUFFIXES)}')
        check_output(output, *sources)


def choose_endings(person_ids: Sequence[str]) -> list[str]:
    """Return endings of file names, one for each person, which differ and hold no character that paths do not."""
    endings: list[str] = []
    for person_id in person_ids:
        ending = '_' + re.sub(r'[^A-Za-z0-9_-]', '_', person_id)[:MAX_ENDING]
        taken = sum(other == ending or other.startswith(f'{ending}.') for other in endings)
        endings.append(f'{ending}.{taken + 1}' if taken else ending)
    return endings


def add_ending(path: Path, ending: str) -> Path:
    """Return a path whose name has an ending before the suffix that selects the format."""
    suffix = save_results.find_suffix(path)
    return path.with_name(path.name.removesuffix(suffix) + ending + suffix)


def _choose_method(args: argparse.Namespace) -> Method:
    choices: tuple[DepthChoice, ...] = ()
    if args.choices is not None:
        text = read_text(args.choices, max_bytes=MAX_CHOICES_BYTES)
        choices = parse_depth_choices(load_yaml(text, str(args.choices)), str(args.choices))

    def by_keyframes(
        sequence: KeypointSequence, models: Mapping[str, PoseModel], config: Config, _: Report
    ) -> Solved:
        with show_stages() as set_stage:
            return keyframe_method.reconstruct(sequence, models, config, choices, set_stage).solved

    return by_keyframes if args.method == 'keyframes' else solve_sequence


def save_people(
    source: Path,
    people: Sequence[PoseSequence],
    endings: Sequence[str],
    outputs: Sequence[Path],
    sources: Sequence[Path],
) -> bool:
    """Save people of a source, whose files have these endings; return whether all could be saved."""
    is_all_saved = True
    for poses, ending in zip(people, endings, strict=True):
        try:
            _save(source, poses, [add_ending(path, ending) for path in outputs], sources)
        except InputError as error:  # noqa: PERF203 # one whom a format cannot hold does not stop the others
            if len(people) == 1:
                raise
            print_note(f'{error} (person {poses.id!r} is not saved)')
            is_all_saved = False
    return is_all_saved


def _save(source: Path, poses: PoseSequence, outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    """Write the files, put them in place when all of them are written, and print their names."""
    with ExitStack() as replacements:
        for output in outputs:
            unfinished = replacements.enter_context(replace_output(output, *sources))
            with name_file_in_errors(source, InputError):
                save_results.save(unfinished, poses)
    missing = int((~poses.in_sight).sum())
    if missing:
        print_note(f'{source}: {missing} frames in which the person was out of sight have no skeleton')
    for output in outputs:
        print_result(output if poses.success else f'{output}: {poses.message}')
        if output.suffix == '.bvh':
            is_known = np.isfinite(average_vertical(poses.vertical, poses.vertical_std)).all()
            up = 'y up' if is_known else 'y up, as for a level camera'
            print_result(f'{output}: in cm, {up}. In Blender: {BLENDER_IMPORT}')
