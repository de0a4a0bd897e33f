"""`mocap-ros evaluate`: reconstruct sequence files that hold their truth, and report every error."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.cli.options import about, add_config_options, add_model_option, config_from, models_from, progress
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.evaluation import metrics
from mocap_ros.formats.sequence_file import Sequence, load_sequence
from mocap_ros.formats.text_files import writing
from mocap_ros.models.base_poses import BasePoses

Array = NDArray[np.float64]

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
LEGEND = (
    'MPJPE: poses centred, one scale a sequence, no rotation; PA-MPJPE: one similarity a frame; '
    'sequence: one similarity a sequence; metric: no scale; e: eq. 25 of TPAMI 2016; '
    'bone std: of bone lengths over time; residual: in the image.'
)
SMALLEST_PERSON, LARGEST_PERSON = 0.01, 10.0


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'evaluate',
        help='errors of the reconstruction on sequence files with truth',
        description=f'Reconstructs sequence files as a whole and compares them with their truth. {LEGEND}',
    )
    p.add_argument('input', type=Path, nargs='+', metavar='SEQUENCE.npz', help='sequence file with joints3d')
    add_model_option(p)
    p.add_argument(
        '--joints',
        choices=['common', 'limbs'],
        default='common',
        help='limbs: twelve limb joints, in frames with more than eight of them seen',
    )
    p.add_argument('--json', type=Path, metavar='FILE', help='also write all figures here (default: not)')
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate every file and print a table."""
    config = config_from(args)
    models = models_from(args, config)
    records, doubts = [], []
    for path in progress(args.input, 'evaluate'):
        sequence = load_sequence(path)
        if sequence.truth is None:
            raise InputError(f'{path}: joints3d: missing; without the truth there is nothing to evaluate')
        if _size(sequence.truth.joints) > LARGEST_PERSON:
            doubts.append(f'{path}: joints3d: looks like mm; m expected')
        with about(path):
            record = evaluate(sequence, models, config, args.joints == 'limbs')
        records.append({'file': path.name, **record})
    if args.json is not None:
        with writing(args.json, *args.input):
            args.json.write_text(_as_json(records), encoding='utf-8')
    print_table(records)
    for doubt in doubts:
        print(f'mocap-ros: {doubt}', file=sys.stderr)
    return 0


def evaluate(
    sequence: Sequence, models: Mapping[str, BasePoses], config: Config, limbs_only: bool
) -> dict[str, float]:
    """The record of one sequence: all errors of `metrics.errors`, and what the solver says of itself.

    Joints of the truth that are known in no frame are left out, then frames in which one is not known.

    Raises:
        InputError: nothing is left to compare.
    """
    truth = sequence.truth
    if truth is None:
        raise InputError('joints3d: missing')
    known = np.asarray(np.isfinite(truth.joints).all(axis=-1))
    if not known.any():
        raise InputError('joints3d: no joint is known in any frame')
    begun = time.perf_counter()
    result = reconstruct_file(sequence, models, config)
    seconds = time.perf_counter() - begun
    names = tuple(n if known[:, i].any() else '' for i, n in enumerate(truth.joint_names))
    mine, theirs = metrics.common_joints(result.skeleton.joints, names, limbs_only)
    frames = np.asarray(known[:, theirs].all(axis=1))
    if limbs_only:
        frames &= metrics.well_seen(sequence.joint_names, sequence.keypoints[..., 2])
    if frames.any() and _size(truth.joints[frames][:, theirs]) < SMALLEST_PERSON:
        raise InputError('joints3d: all joints at one place')
    if not frames.any():
        raise InputError('joints3d: no frame in which all joints are known' + ' and most are seen' * limbs_only)
    fps = 1 / float(np.median(np.diff(sequence.timestamps))) if len(sequence) > 1 else math.nan
    return {
        **metrics.errors(result.joints[:, mine], truth.joints[:, theirs], fps, frames),
        'bone_std_mm': metrics.bone_std_mm(result.joints, result.skeleton),
        'residual_px': float(np.nanmean(result.solution.residual)),
        'fps': fps,
        'seconds': seconds,
    }


def print_table(records: list[dict[str, Any]]) -> None:
    """A table with one line a sequence, and their mean."""
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


def _as_json(records: list[dict[str, Any]]) -> str:
    """Numbers that are not finite, which JSON does not know, become null."""
    finite = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}
        for record in records
    ]
    return json.dumps(finite, indent=1, allow_nan=False) + '\n'


def _size(truth: Array) -> float:
    """Longest side of the box around a person; `truth` (F, J, 3), 0 where no frame is whole."""
    whole = truth[np.isfinite(truth).all(axis=(1, 2))]
    return float(np.median(np.ptp(whole, axis=1).max(axis=-1))) if len(whole) else 0.0
