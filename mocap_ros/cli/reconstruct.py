# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros reconstruct`: reconstruct a whole sequence in 3D from its 2D keypoints."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from mocap_ros.cli.keypoint_input import (
    add_input_options,
    add_model_option,
    list_sources,
    load_input_people,
    load_input_sequence,
    load_models,
    name_file_in_errors,
)
from mocap_ros.cli.lines import print_remark, print_result
from mocap_ros.cli.options import add_config_options, derive_output_stem, load_config
from mocap_ros.cli.progress import StageDisplay
from mocap_ros.config import Config, load_yaml
from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import BLENDER_IMPORT
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.formats.text_files import check_output, read_text, replace_output
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.keyframes import reconstruct
from mocap_ros.offline.keyframes.taylor import DepthChoice, parse_depth_choices
from mocap_ros.offline.whole_sequence import SequenceResult, reconstruct_sequence
from mocap_ros.runtime import save_results

MAX_ENDING = 64  # characters of a person's id in the name of a file
MAX_CHOICES_BYTES = 16 << 20  # bytes; guards against parsing a huge file as keyframes


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Reconstructs one person over a whole sequence, so that every frame supports the others. The '
        'input is a sequence file, a bag, OpenPose JSON, COCO keypoints or a video. The ending of the output file '
        'selects its format: .npz, .csv, .mcap (a bag of skeletons, cameras and markers), .bvh (for animation, in '
        'cm), .angles.csv (joint angles), or .trc (markers for OpenSim, in mm). In .bvh and .trc, y points up and '
        'the frame rate is constant.'
    )
    add_input_options(parser)
    parser.add_argument(
        '--all-people',
        action='store_true',
        help='reconstruct every person who is seen in ten frames or more, into files whose names end with the '
        "person's id (default: one person)",
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        action='append',
        default=[],
        metavar='OUT',
        help=f'file to write: {", ".join(save_results.SUFFIXES)}; may be repeated (default: IN_3d.npz in the '
        'current folder)',
    )
    parser.add_argument(
        '--method',
        choices=['whole', 'keyframes'],
        default='whole',
        help='whole: all frames are solved together; keyframes: key poses are fitted to the image, for minutes of '
        'mixed action with outliers',
    )
    parser.add_argument(
        '--choices',
        type=Path,
        metavar='FILE',
        help='limbs that point towards the camera, for key poses chosen by hand, in the file that `keyframes` '
        'writes (default: none)',
    )
    add_model_option(parser)
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reconstruct the input, save the result, and print its residual."""
    outputs = args.output or [Path(f'{derive_output_stem(args.input)}_3d.npz')]
    config = load_config(args)
    sources = list_sources(args, config)
    for output in outputs:
        if not save_results.find_suffix(output):
            raise InputError(f'{output}: unknown file type; expected {", ".join(save_results.SUFFIXES)}')
        check_output(output, *sources)
    if args.all_people and args.person is not None:
        raise InputError(f'{args.input}: --person and --all-people exclude each other')
    if args.choices is not None and args.method != 'keyframes':
        raise InputError(f'{args.choices}: --choices needs --method keyframes')
    models = load_models(args, config)
    if args.all_people:
        sequences = load_input_people(args, config)
        endings = choose_endings([sequence.person_id for sequence in sequences])
    else:
        sequences, endings = [load_input_sequence(args, config)], ['']
    errors = []
    for sequence, ending in zip(sequences, endings, strict=True):
        paths = [add_ending(path, ending) for path in outputs]
        error = _find_error(partial(_reconstruct_and_save, args, sequence, models, config, paths, sources))
        if error is not None:
            errors.append(error)
            if len(errors) < len(sequences):
                print_remark(f'{error} (person {sequence.person_id!r} is left out)')
    if len(errors) == len(sequences):
        raise errors[-1]
    return 0


def _find_error(work: Callable[[], None]) -> InputError | None:
    """Do some work, and return the error that its input caused; None if there was none."""
    try:
        work()
    except InputError as error:
        return error
    return None


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


def _reconstruct_and_save(
    args: argparse.Namespace,
    sequence: KeypointSequence,
    models: Mapping[str, BasePoses],
    config: Config,
    outputs: Sequence[Path],
    sources: Sequence[Path],
) -> None:
    """Reconstruct one person, write the files, and print a line about each."""
    if args.method == 'keyframes':
        result, summary = _reconstruct_by_keyframes(args, sequence, models, config)
    else:
        with name_file_in_errors(args.input):
            result = reconstruct_file(sequence, models, config)
        summary = f'{result.solution.iterations} iterations'
    _save_all(args.input, save_results.ReconstructedSequence(sequence, result), outputs, sources)
    solution = result.solution
    warning = '' if solution.success else f'. {solution.message}'
    missing = int(np.isnan(result.joints).any(axis=(1, 2)).sum())
    if missing:
        line = f'{missing} frames before the first and after the last sight of the person have no skeleton'
        print_remark(f'{args.input}: {line}')
    distance = f'{np.nanmedian(result.joints[..., 2]):.1f} m away'
    if not sequence.is_camera_known:
        distance += (
            ' by a nominal focal length, to which it is proportional (--hfov or --focal gives the true one)'
        )
    for output in outputs:
        print_result(
            f'{output}: {len(sequence)} frames, base poses {result.category}, residual '
            f'{np.nanmean(solution.residual):.2f} px, {distance}, {summary}{warning}'
        )
        if output.suffix == '.bvh':
            print_result(f'{output}: in cm, y up, as for a level camera. In Blender: {BLENDER_IMPORT}')


def _save_all(
    source: Path,
    reconstruction: save_results.ReconstructedSequence,
    outputs: Sequence[Path],
    sources: Sequence[Path],
) -> None:
    """Write the files, and put them in place when all of them are written.

    Raises:
        InputError: the times of the input, which the error names, do not fit a format.
        MocapError: a file cannot be written.
    """
    with ExitStack() as replacements:
        for output in outputs:
            unfinished = replacements.enter_context(replace_output(output, *sources))
            try:
                save_results.save(unfinished, reconstruction)
            except InputError as error:
                raise InputError(f'{source}: {error}') from None


def _reconstruct_by_keyframes(
    args: argparse.Namespace, sequence: KeypointSequence, models: Mapping[str, BasePoses], config: Config
) -> tuple[SequenceResult, str]:
    """Reconstruct a sequence by keyframes, and summarise the keyframes in a phrase."""
    choices: tuple[DepthChoice, ...] = ()
    if args.choices is not None:
        text = read_text(args.choices, max_bytes=MAX_CHOICES_BYTES)
        choices = parse_depth_choices(load_yaml(text, str(args.choices)), str(args.choices))
    with name_file_in_errors(args.input), StageDisplay() as set_stage:
        found = reconstruct.reconstruct(
            *extract_observations(sequence, config.tracker.nominal_focal_length),
            models,
            config,
            choices,
            set_stage,
        )
    upper, lower = (len(half.frames) for half in found.keyframes)
    outliers = int(found.outliers.sum())
    summary = f'{upper} keyframes of the upper body and {lower} of the lower body, {outliers} outliers replaced'
    return found.result, summary


def reconstruct_file(
    sequence: KeypointSequence, models: Mapping[str, BasePoses], config: Config
) -> SequenceResult:
    """Reconstruct the content of a sequence file as a whole."""
    return reconstruct_sequence(
        *extract_observations(sequence, config.tracker.nominal_focal_length), models, config
    )
