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

from mocap_ros.arrays import Array
from mocap_ros.cli.inputs import (
    INPUT_OPTIONS,
    MODEL_OPTIONS,
    list_sources,
    load_models,
    load_sequences,
    name_file_in_errors,
)
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, derive_output_stem, load_config, option
from mocap_ros.cli.terminal import ShareBar, finish, print_note, print_result, show_stages
from mocap_ros.config import Config, load_yaml, with_values
from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import BLENDER_IMPORT
from mocap_ros.formats.text_files import check_output, read_text, replace_output
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.offline.keyframes.taylor import DepthChoice, parse_depth_choices
from mocap_ros.offline.whole_sequence import (
    Report,
    SequenceResult,
    describe_height_faults,
    reconstruct_without_floor,
)
from mocap_ros.recordings import save_results
from mocap_ros.recordings.reconstruct import Method, reconstruct_people
from mocap_ros.verdict.summary import summarise

MAX_ENDING = 64  # characters of a person's id in the name of a file
MAX_CHOICES_BYTES = 16 << 20  # bytes; guards against parsing a huge file as keyframes

DESCRIPTION = (
    'Reconstructs one person over a whole sequence, so that every frame supports the others. The input is a '
    'sequence file, a bag, OpenPose JSON, COCO keypoints or a video. The ending of the output file selects its '
    'format: .npz, .csv, .mcap (a bag of skeletons, cameras and markers), .bvh (for animation, in cm), '
    '.angles.csv (joint angles), or .trc (markers for OpenSim, in mm). In .bvh and .trc, y points up and the '
    'frame rate is constant.'
)
OPTIONS: Options = {
    **INPUT_OPTIONS,
    '--all-people': 'reconstruct every person who is seen in ten frames or more, into files whose names end with '
    "the person's id (default: one person)",
    '-o --output OUT': option(
        f'file to write: {", ".join(save_results.SUFFIXES)}; may be repeated (default: IN_3d.npz in the '
        'current folder)',
        action='append',
        default=[],
    ),
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
    models = load_models(args, config)
    sequences, endings = load_sequences(args, config, all_people=args.all_people), ['']
    if args.all_people:
        endings = choose_endings([sequence.person_id for sequence in sequences])
    method, is_all_saved = _choose_method(args), True
    with ShareBar('reconstruct') as report:
        with name_file_in_errors(args.input):
            people, notes = reconstruct_people(sequences, models, config, report, method)
        for note in notes:
            print_note(f'{args.input}: {note}')
        found, results = [person.sequence for person in people], [person.result for person in people]
        height = 'tracker.camera_height' if args.floor_height is None else '--floor-height'
        for fault in describe_height_faults(results):
            print_note(f'{args.input}: {height} {fault}')
        for place, sequence, person_id, result in people:
            summary = summarise([sequence], [result], config)
            reconstructed = save_results.ReconstructedSequence(sequence, result, summary)
            try:
                _save(args, reconstructed, [add_ending(path, endings[place]) for path in outputs], sources)
            except InputError as error:  # one whom a format cannot hold does not stop the others
                if len(sequences) == 1:
                    raise
                print_note(f'{error} (person {person_id!r} is not saved)')
                is_all_saved = False
    if len(found) > 1:
        summary = summarise(found, results, config)
    return finish(args.input, summary, summary.is_wrong, is_strict=args.strict) or int(not is_all_saved)


def _check_options(args: argparse.Namespace, outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    for output in outputs:
        if not save_results.find_suffix(output):
            raise InputError(f'{output}: unknown file type; expected {", ".join(save_results.SUFFIXES)}')
        check_output(output, *sources)
    if args.all_people and args.person is not None:
        raise InputError(f'{args.input}: --person and --all-people exclude each other')
    if args.floor_height is not None and args.method == 'keyframes':
        raise InputError(f'{args.input}: --floor-height does not apply to --method keyframes')
    if args.choices is not None and args.method != 'keyframes':
        raise InputError(f'{args.choices}: --choices needs --method keyframes')


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
        keypoints: Array,
        names: tuple[str, ...],
        times: Array,
        camera: Intrinsics,
        models: Mapping[str, BasePoses],
        config: Config,
        _: Report,
    ) -> SequenceResult:
        with show_stages() as set_stage:
            observed = keypoints, names, times, camera
            return keyframe_method.reconstruct(*observed, models, config, choices, set_stage).result

    return by_keyframes if args.method == 'keyframes' else reconstruct_without_floor


def _save(
    args: argparse.Namespace,
    found: save_results.ReconstructedSequence,
    outputs: Sequence[Path],
    sources: Sequence[Path],
) -> None:
    """Write the files, put them in place when all of them are written, and print their names."""
    with ExitStack() as replacements:
        for output in outputs:
            unfinished = replacements.enter_context(replace_output(output, *sources))
            with name_file_in_errors(args.input, InputError):
                save_results.save(unfinished, found)
    missing = int(np.isnan(found.result.joints).any(axis=(1, 2)).sum())
    if missing:
        line = f'{missing} frames in which the person was out of sight have no skeleton'
        print_note(f'{args.input}: {line}')
    solution = found.result.solution
    for output in outputs:
        print_result(output if solution.success else f'{output}: {solution.message}')
        if output.suffix == '.bvh':
            is_known = np.isfinite(average_vertical(found.result.vertical, found.result.vertical_std)).all()
            up = 'y up' if is_known else 'y up, as for a level camera'
            print_result(f'{output}: in cm, {up}. In Blender: {BLENDER_IMPORT}')
