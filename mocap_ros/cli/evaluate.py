"""`mocap-ros evaluate`: reconstruct sequence files that contain the truth, and print every error."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mocap_ros.cli.options import (
    add_config_options,
    add_model_option,
    load_config,
    load_models,
    name_file_in_errors,
)
from mocap_ros.cli.progress import show_progress
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.evaluation.evaluate import check_truth, estimate_frame_rate, evaluate, measure_person_size
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.formats.text_files import guard_output
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.runtime.load_keypoints import load_sequence_file

# Columns of the table: key of the record, title, unit and number format.
COLUMNS = (
    ('mpjpe_mm', 'MPJPE', 'mm', '.1f'),
    ('pa_mpjpe_mm', 'PA-MPJPE', 'mm', '.1f'),
    ('seq_mpjpe_mm', 'sequence', 'mm', '.1f'),
    ('metric_mpjpe_mm', 'metric', 'mm', '.1f'),
    ('e_paper_cm', 'e', 'cm', '.2f'),
    ('bone_std_mm', 'bone std', 'mm', '.1f'),
    ('residual_px', 'residual', 'px', '.2f'),
    ('frames', 'frames', '', '.0f'),
    ('failed_frames', 'failed', '', '.0f'),
    ('fps', 'rate', 'fps', '.0f'),
    ('seconds', 'took', 's', '.1f'),
)
# The sentence below the table, which explains its columns.
LEGEND = (
    'MPJPE: mean joint error of centred poses after one scale per sequence, without rotation; '
    'PA-MPJPE: after one similarity transform per frame; sequence: after one similarity transform per sequence; '
    'metric: without scale; e: eq. 25 of TPAMI 2016; bone std: standard deviation of the bone lengths over time; '
    'residual: mean reprojection error.'
)
MAX_PERSON_SIZE_M = 10.0  # m; a larger truth is probably in mm


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser(
        'evaluate',
        help='print the errors of the reconstruction of sequence files that contain the truth',
        description='Reconstructs sequence files as a whole and compares the results with the truth in the files. '
        f'{LEGEND}',
    )
    parser.add_argument(
        'input', type=Path, nargs='+', metavar='SEQUENCE.npz', help='sequence file with the true joints, joints3d'
    )
    add_model_option(parser)
    parser.add_argument(
        '--joints',
        choices=['common', 'limbs'],
        default='common',
        help='joints to compare: all that the truth and the result have in common, or the twelve joints of the '
        'limbs, in frames in which more than eight of them are seen',
    )
    parser.add_argument('--json', type=Path, metavar='FILE', help='file for all numbers as JSON (default: none)')
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate every file, and print a table of the errors."""
    config = load_config(args)
    models = load_models(args, config)
    records, warnings = [], []
    for path in show_progress(args.input, 'evaluate'):
        sequence = load_sequence_file(path)
        if sequence.truth is None:
            raise InputError(f'{path}: joints3d: missing, but the evaluation needs the truth')
        if measure_person_size(sequence.truth.joints) > MAX_PERSON_SIZE_M:
            warnings.append(f'{path}: joints3d: the values look like mm, but m are expected')
        with name_file_in_errors(path):
            record = reconstruct_and_evaluate(sequence, models, config, args.joints == 'limbs')
        records.append({'file': path.name, **record})
    if args.json is not None:
        with guard_output(args.json, *args.input):
            args.json.write_text(_format_json(records), encoding='utf-8')
    print_table(records)
    for warning in warnings:
        print(f'mocap-ros: {warning}', file=sys.stderr)
    return 0


def reconstruct_and_evaluate(
    sequence: KeypointSequence, models: Mapping[str, BasePoses], config: Config, limbs_only: bool
) -> dict[str, float]:
    """Reconstruct one sequence and compare it with its truth.

    Joints that are unknown in every frame of the truth are not compared. Of the frames, only those are compared in
    which the truth of all other joints is known.

    Args:
        sequence: the keypoints and the truth.
        models: base poses by name.
        config: parameters of the reconstruction.
        limbs_only: True to compare the twelve limb joints only, in the frames in which most of them are seen.

    Returns:
        The record of `Evaluation.as_dict`, with `seconds` added: the time that the reconstruction took.

    Raises:
        InputError: the sequence has no truth or cannot be reconstructed, or nothing is left to compare.
    """
    truth = sequence.truth
    if truth is None:
        raise InputError('joints3d: missing')
    check_truth(truth.joints)
    start_s = time.perf_counter()
    result = reconstruct_file(sequence, models, config)
    seconds = time.perf_counter() - start_s
    evaluation = evaluate(
        result.joints,
        result.skeleton,
        result.solution.residual,
        truth.joints,
        truth.joint_names,
        estimate_frame_rate(sequence.timestamps),
        sequence.joint_names,
        sequence.keypoints[..., 2] if limbs_only else None,
    )
    return {**evaluation.as_dict(), 'seconds': seconds}


def print_table(records: list[dict[str, Any]]) -> None:
    """Print a table with a line for each sequence, and one for their mean."""
    rows = list(records)
    if len(records) > 1:
        values = {key: [r[key] for r in records if key in r] for key, *_ in COLUMNS}
        rows.append({'file': 'mean', **{key: sum(v) / len(v) for key, v in values.items() if v}})
    cells = [
        ['', *(title for _, title, _, _ in COLUMNS)],
        ['', *(unit for _, _, unit, _ in COLUMNS)],
        *(
            [row['file'], *(format(row[key], form) if key in row else '-' for key, _, _, form in COLUMNS)]
            for row in rows
        ),
    ]
    first, *others = (max(map(len, column)) for column in zip(*cells, strict=True))
    for name, *numbers in cells:
        print(f'{name:<{first}}', *(f'{cell:>{width + 1}}' for cell, width in zip(numbers, others, strict=True)))
    print(LEGEND)


def _format_json(records: list[dict[str, Any]]) -> str:
    """Return the records as JSON, in which numbers that are not finite become null."""
    finite = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}
        for record in records
    ]
    return json.dumps(finite, indent=1, allow_nan=False) + '\n'
