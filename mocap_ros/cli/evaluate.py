# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros evaluate`: compare results, or reconstructions of sequence files, with the truth."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.cli.inputs import MODEL_OPTIONS, list_sources, load_models, name_file_in_errors
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, load_config, option
from mocap_ros.cli.terminal import ShareBar, print_note, print_result
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import check_timestamps
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.offline.whole_sequence import report_part
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.input_kind import InputKind, check_options, find_kind_with_results, require_kind
from mocap_ros.recordings.load_keypoints import load_sequence_file
from mocap_ros.recordings.load_results import load_result
from mocap_ros.recordings.reconstruct import ReconstructionOptions, reconstruct
from mocap_ros.summary import Summary
from mocap_ros.verdict.accuracy import (
    MAX_PERSON_SIZE_M,
    check_truth,
    estimate_frame_rate,
    evaluate,
    measure_person_size,
)
from mocap_ros.verdict.coverage import SHARES, compute_coverage

# Columns of the table: key of the record, title, unit and number format.
COLUMNS = (
    ('mpjpe_mm', 'MPJPE', 'mm', '.1f'),
    ('pa_mpjpe_mm', 'PA-MPJPE', 'mm', '.1f'),
    ('seq_mpjpe_mm', 'sequence', 'mm', '.1f'),
    ('metric_mpjpe_mm', 'metric', 'mm', '.1f'),
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
    'metric: without scale; bone std: standard deviation of the bone lengths over time; '
    'residual: root mean square reprojection error, mean over the frames.'
)
MAX_TIME_DIFFERENCE_NS = 1_000_000  # ns; between equal times of two files, of which one may be rounded to ms
ACCEPTED_KINDS = (InputKind.SEQUENCE, InputKind.RESULT, InputKind.BAG)
ACCEPTED_FORMATS = 'a result of reconstruct (.npz, .mcap), a bag of skeletons, or a sequence file (.npz)'

DESCRIPTION = (
    'Compares results of `reconstruct` (.npz or .mcap), or the skeletons in bags, with the truth in the '
    'sequence file that --truth names, at the times that both have; skeletons that were predicted through a '
    'gap count like all others. Reconstructs sequence files as a whole first, and compares them with the '
    f'truth in them, unless --truth is given. {LEGEND}'
)
OPTIONS: Options = {
    'input IN': option('result (.npz or .mcap), bag of skeletons, or sequence file', nargs='+'),
    '--truth SEQUENCE.npz': 'sequence file with the true joints, joints3d, such as the one that a result was '
    'made from (default: the input, if it is a sequence file)',
    '--person ID': 'person in a bag of skeletons (default: the person with most skeletons)',
    **MODEL_OPTIONS,
    '--limbs-only': 'compare the twelve joints of the limbs, in the frames in which most of them were seen '
    '(default: all joints and frames)',
    '--json FILE': 'file for all numbers as JSON, also the error e of TPAMI 2016 (eq. 25), `e_paper_cm` (default: '
    'none)',
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Evaluate every input, and print a table of the errors."""
    config = load_config(args)
    sources = list_sources(args, config)
    if args.json is not None:
        check_output(args.json, *sources)
    models = load_models(args, config)
    truths = {} if args.truth is None else {args.truth: _load_truth(args.truth)}
    records, is_wrong, count = [], False, len(args.input)
    with ShareBar('evaluate') as report:
        for index, path in enumerate(args.input):
            part = report_part(report, index, count)
            place, timing = args.truth or path, {}
            if require_kind(path, ACCEPTED_KINDS, ACCEPTED_FORMATS) is InputKind.SEQUENCE:
                check_options(path, {'person': args.person}, InputKind.SEQUENCE)
                sequence = load_sequence_file(path) if args.truth else truths.setdefault(path, _load_truth(path))
                start_s = time.perf_counter()
                with name_file_in_errors(path):
                    recording = reconstruct([sequence], ReconstructionOptions(config, models), part)
                (result,), summary = recording.people, recording.summary
                timing = {'seconds': time.perf_counter() - start_s}
                if isinstance(summary, Summary) and summary.reason:
                    print_note(f'{path}: {summary}')
                is_wrong |= summary.is_wrong
            else:
                kind = find_kind_with_results(path)
                check_options(path, vars(args) | {'person': None}, kind)
                result = load_result(path, args.person)
                if args.truth is None:
                    raise InputError(f'{path}: holds no truth; give the sequence file that does by --truth')
            with name_file_in_errors(path):
                record, warning = compare_with_truth(result, truths[place], limbs_only=args.limbs_only)
            if warning:
                print_note(f'{path}: {warning}')
            records.append({'file': path.name, **record, **timing})
    if args.json is not None:
        with replace_output(args.json, *sources) as unfinished:
            unfinished.write_text(_format_json(records), encoding='utf-8')
    print_table(records)
    print_coverage(records)
    for path, sequence in truths.items():
        if measure_person_size(_get_truth(sequence).joints) > MAX_PERSON_SIZE_M:
            print_note(f'{path}: joints3d: the values look like mm, but m are expected')
    return int(args.strict and is_wrong)


def _load_truth(path: Path) -> KeypointSequence:
    sequence = load_sequence_file(path)
    with name_file_in_errors(path):
        check_truth(_get_truth(sequence).joints)
    return sequence


def _get_truth(sequence: KeypointSequence) -> GroundTruth:
    if sequence.truth is None:
        raise InputError('joints3d: missing, but the evaluation needs the truth')
    return sequence.truth


def compare_with_truth(
    result: PoseSequence, reference: KeypointSequence, *, limbs_only: bool = False
) -> tuple[dict[str, Any], str]:
    """Compare a result with the truth of a sequence in the frames whose times both have.

    Joints that are unknown in every frame of the truth are not compared. Of the frames, only those are compared in
    which the truth of all other joints is known; with `limbs_only`, only the joints of the limbs, where most of
    them were seen. Returns the errors, with the shares of true errors within the covariances if the result
    has any, and a warning if fewer than half of the frames of the shorter recording are compared.
    """
    truth = _get_truth(reference)
    frames, reference_frames = _match_times(result.stamps_ns, reference.stamps_ns)
    warning = ''
    if 2 * len(frames) < min(len(result.times), len(reference)):
        check_timestamps(result.times)
        warning = (
            f'timestamps: only {len(frames)} of {len(result.times)} frames are compared; the others have no time '
            f'of the {len(reference)} frames of the truth'
        )
    if not len(frames):
        raise InputError(
            f'timestamps: none of {result.times[0]:.3f} to {result.times[-1]:.3f} s is that of a frame of the '
            f'truth, {reference.timestamps[0]:.3f} to {reference.timestamps[-1]:.3f} s'
        )
    joints, true_joints = result.joints[frames], truth.joints[reference_frames]
    if not np.isfinite(joints).all(axis=(1, 2)).any():
        raise InputError('no frame has a skeleton at a time of the truth')
    errors = evaluate(
        joints,
        result.skeleton,
        result.reprojection_residual[frames],
        true_joints,
        truth.joint_names,
        estimate_frame_rate(result.times[frames]),
        reference.joint_names,
        reference.keypoints[reference_frames, :, 2] if limbs_only else None,
        times=reference.timestamps[reference_frames],
    )
    coverage: dict[str, float] = {}
    if np.isfinite(result.joint_std).any():
        std, covariance = result.joint_std[frames], result.root_covariance[frames]
        coverage = compute_coverage(joints, std, covariance, result.skeleton, true_joints, truth.joint_names)
    return {**errors.as_dict(), **coverage}, warning


def _match_times(
    stamps_ns: Sequence[int], reference_ns: Sequence[int]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the frames of a result, and those of the truth that have the same stamps but for rounding."""
    stamps, reference = np.array(stamps_ns, np.int64), np.array(reference_ns, np.int64)
    after = np.minimum(np.searchsorted(reference, stamps), len(reference) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(reference[before] - stamps) < np.abs(reference[after] - stamps), before, after)
    frames = np.flatnonzero(np.abs(reference[nearest] - stamps) <= MAX_TIME_DIFFERENCE_NS)
    return frames, nearest[frames]


def print_table(records: list[dict[str, Any]]) -> None:
    """Print a table with a line for each sequence, and one for their mean."""
    rows = list(records)
    if len(records) > 1:
        values = {key: [r[key] for r in records if key in r and not math.isnan(r[key])] for key, *_ in COLUMNS}
        rows.append({'file': 'mean', **{key: sum(v) / len(v) for key, v in values.items() if v}})
    names = ['', '', *(row['file'] for row in rows)]
    lines = [f'{name:<{max(map(len, names))}}' for name in names]
    for key, title, unit, form in COLUMNS:
        cells = [title, unit, *(format(row[key], form) if key in row else '-' for row in rows)]
        lines = [f'{line} {cell:>{max(map(len, cells)) + 1}}' for line, cell in zip(lines, cells, strict=True)]
    for line in [*lines, LEGEND]:
        print_result(line)


def print_coverage(records: Sequence[Mapping[str, Any]]) -> None:
    """Print, for each result with covariances, how many of its true errors are within them."""
    wanted = ' and '.join(f'{100 * p:.0f}' for p in SHARES)
    for record in records:
        for kind, what in (('joints', 'joints'), ('roots', 'points between the hips')):
            keys = [f'{kind}{100 * p:.0f}' for p in SHARES]
            if shares := ' and '.join(f'{100 * record[key]:.0f}' for key in keys if key in record):
                print_result(
                    f'{record["file"]}: covariances: {shares} of 100 true {what} are in the ellipsoids that '
                    f'should hold {wanted}'
                )


def _format_json(records: list[dict[str, Any]]) -> str:
    finite = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}
        for record in records
    ]
    return json.dumps(finite, indent=1, allow_nan=False) + '\n'
