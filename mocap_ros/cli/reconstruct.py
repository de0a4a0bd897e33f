"""`mocap-ros reconstruct`: a whole sequence at once, from a sequence file to 3D."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.base_poses import BasePoses
from mocap_ros.cli.options import add_config_options, add_sequence_options, config_from, models_from
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.io.sequence import Sequence, load_sequence
from mocap_ros.offline import SequenceResult, reconstruct_sequence

WRITERS = ('.npz', '.csv')


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'reconstruct',
        help='a whole sequence to 3D, every frame helping the others',
        description='Reconstructs a sequence file (.npz) as a whole. Bags: use replay.',
    )
    add_sequence_options(p)
    p.add_argument(
        '-o', '--output', type=Path, metavar='OUT', help='.npz or .csv (default: SEQUENCE_3d.npz in this folder)'
    )
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reconstruct, save, and say how well the image is explained."""
    output = args.output or Path(f'{args.input.stem}_3d.npz')
    if output.suffix not in WRITERS:
        raise InputError(f'{output}: can write {" or ".join(WRITERS)}')
    config = config_from(args)
    sequence = load_sequence(args.input)
    result = reconstruct_file(sequence, models_from(args, config), config)
    (_write_npz if output.suffix == '.npz' else _write_csv)(output, sequence, result)
    solution = result.solution
    print(
        f'{output}: {len(sequence)} frames, base poses {result.category}, residual '
        f'{np.nanmean(solution.residual):.2f} px, {solution.iterations} iterations'
        + ('' if solution.converged else ' (not converged)')
    )
    return 0


def reconstruct_file(sequence: Sequence, models: Mapping[str, BasePoses], config: Config) -> SequenceResult:
    """The reconstruction of a sequence file's content."""
    return reconstruct_sequence(
        sequence.keypoints,
        sequence.joint_names,
        sequence.timestamps,
        sequence.intrinsics(config.tracker.nominal_focal_length),
        models,
        config,
    )


def _write_npz(path: Path, sequence: Sequence, result: SequenceResult) -> None:
    np.savez_compressed(
        path,
        joints3d=result.joints.astype('f4'),
        joint_names=np.array(result.skeleton.joints),
        parents=np.array(result.skeleton.parents),
        timestamps=sequence.timestamps,
        seen=result.seen,
        scale=result.solution.cameras.scale,
        rotation=result.solution.cameras.rotation,
        translation=result.solution.translation,
        residual_px=result.solution.residual,
        theta=result.solution.theta,
    )


def _write_csv(path: Path, sequence: Sequence, result: SequenceResult) -> None:
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        names = result.skeleton.joints
        writer.writerow(['time_s', *(f'{n}_{axis}_m' for n in names for axis in 'xyz')])
        for time, joints in zip(sequence.timestamps, result.joints, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in joints.ravel())])
