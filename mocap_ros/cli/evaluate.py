"""`mocap-ros evaluate`: reconstruct sequence files that hold their truth, and report every error."""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros import metrics
from mocap_ros.base_poses import BasePoses, load_model
from mocap_ros.cli.options import add_config_options, config_from, progress
from mocap_ros.cli.reconstruct import reconstruct_file
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.io.sequence import Sequence, load_sequence

COLUMNS = (
    ('mpjpe_mm', 'MPJPE'),
    ('pa_mpjpe_mm', 'PA-MPJPE'),
    ('seq_mpjpe_mm', 'sequence'),
    ('metric_mpjpe_mm', 'metric'),
    ('e_paper_cm', 'e, cm'),
    ('bone_std_mm', 'bone std'),
    ('residual_px', 'px'),
    ('frames', 'frames'),
    ('fps', 'fps'),
    ('seconds', 's'),
)


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'evaluate',
        help='errors of the reconstruction on sequence files with truth',
        description='Errors in mm. MPJPE: poses centred, one scale a sequence, no rotation; PA-MPJPE: one '
        'similarity a frame; sequence: one similarity a sequence; metric: no scale; e: eq. 25 of TPAMI 2016.',
    )
    p.add_argument('files', nargs='+', type=Path, metavar='SEQUENCE.npz')
    p.add_argument('--model', help='base poses: a shipped name or a file (default: tracker.model)')
    p.add_argument(
        '--joints',
        choices=['common', 'limbs'],
        default='common',
        help='limbs: twelve limb joints, in frames with more than eight of them seen',
    )
    p.add_argument('--json', type=Path, metavar='FILE', help='also write the records here')
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate every file and print a table."""
    config = config_from(args)
    model = load_model(args.model or config.tracker.model)
    records = []
    for path in progress(args.files, 'evaluate'):
        sequence = load_sequence(path)
        if sequence.truth is None:
            raise InputError(f'{path}: joints3d: missing; without the truth there is nothing to evaluate')
        records.append({'file': path.name, **evaluate(sequence, model, config, args.joints == 'limbs')})
    if args.json is not None:
        args.json.write_text(json.dumps(records, indent=1) + '\n', encoding='utf-8')
    print_table(records)
    return 0


def evaluate(sequence: Sequence, model: BasePoses, config: Config, limbs_only: bool) -> dict[str, float]:
    """The record of one sequence: all errors of `metrics.errors`, and what the solver says of itself."""
    truth = sequence.truth
    if truth is None:
        raise InputError('joints3d: missing')
    begun = time.perf_counter()
    result = reconstruct_file(sequence, model, config)
    seconds = time.perf_counter() - begun
    mine, theirs = metrics.common_joints(result.skeleton.joints, truth.joint_names, limbs_only)
    score = sequence.keypoints[..., 2]
    frames = metrics.well_seen(sequence.joint_names, score) if limbs_only else None
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
    width = max(len(str(r['file'])) for r in records)
    print(' ' * width, *(f'{title:>9}' for _, title in COLUMNS))
    for record in records:
        print(f'{record["file"]:<{width}}', *(_cell(record.get(key)) for key, _ in COLUMNS))
    if len(records) > 1:
        values = {k: [r[k] for r in records if k in r] for k, _ in COLUMNS}
        means = {k: sum(v) / len(v) if v else None for k, v in values.items()}
        print(f'{"mean":<{width}}', *(_cell(means[key]) for key, _ in COLUMNS))


def _cell(value: float | None) -> str:
    return f'{"-" if value is None else f"{value:.2f}":>9}'
