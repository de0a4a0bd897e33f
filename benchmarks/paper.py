"""The experiments of TPAMI 2016, section 4, and the targets of the project; the full run writes docs/paper.md."""

from __future__ import annotations

import common

# isort: split
import argparse
import time
from collections.abc import Callable
from pathlib import Path

from experiments import accuracy, cameras, gait, stability
from experiments.report import Section, write_report
from experiments.targets import measure_targets

# The experiments in the order of the report, by their names on the command line.
EXPERIMENTS: dict[str, Callable[[bool], Section]] = {
    'targets': measure_targets,
    'table1': accuracy.measure_table_1,
    'cameras': cameras.measure_moving_cameras,
    'base_poses': accuracy.measure_number_of_base_poses,
    'beta': accuracy.measure_bone_regulariser,
    'bones': accuracy.measure_bone_lengths,
    'norms': accuracy.measure_printed_norms,
    'convergence': stability.measure_convergence,
    'noisy_starts': stability.measure_noisy_starts,
    'initial_cameras': stability.measure_initial_cameras,
    'hidden': stability.measure_hidden_limbs,
    'missing': stability.measure_missing_points,
    'noise': stability.measure_noise,
    'weights': stability.measure_weights_under_noise,
    'flips': cameras.measure_flip_regulariser,
    'differences': cameras.compare_differences,
    'sines': gait.measure_sines,
    'classification': gait.measure_classification,
    'claims': gait.measure_claims,
}
# The introduction of the report.
HEAD = """
# The paper's experiments

This page repeats the experiments of section 4 of Wandt, Ackermann, Rosenhahn: 3D Reconstruction of Human Motion
from Monocular Image Sequences, TPAMI 2016, with this project's solvers beside the printed values of the paper. The
code is in `benchmarks/experiments/`; `.venv/bin/python benchmarks/paper.py` writes this page and measures every
number except those attributed to the paper (`--only NAME ...` runs single sections). The terms are in the
[glossary](glossary.md).

- Data: CMU motion capture at 30 fps, 15 joints. HumanEva and KTH Football, which the paper also uses, are not
  available. Test views: orthographic at 300 px/m, elevation 10 degrees, the first 120 frames; the heading is the
  direction that the camera looks from, 0 the front.
- "Algorithm 1" is the paper's method (`mocap_ros.solvers.alternation`): no prior, no smoothness, K base poses from
  the poses alone (here with their heading aligned, since the paper's walking directions are unknown). "Joint",
  "project" and "defaults" are this project's solvers with all terms on. "Np" is the non-periodic model. No model
  was trained on the trial it is tested on, unless stated otherwise.
- MPJPE: mean distance of a joint, mm, each pose centred, one scale per sequence, no rotation. e: eq. 25 of the
  paper, cm, after one similarity transform per sequence; it falls with the root of the number of frames f. 2D
  errors are in mm at the body.
- Weights of the terms are this project's: squared errors in m², time in seconds. They are not the paper's.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--only',
        nargs='+',
        choices=list(EXPERIMENTS),
        metavar='NAME',
        help='experiments to run, of ' + ', '.join(EXPERIMENTS),
    )
    parser.add_argument(
        '--output',
        type=Path,
        default=common.ROOT / 'docs',
        metavar='FOLDER',
        help='folder for paper.md and img/paper',
    )


def main() -> None:
    args = common.parse_arguments(__doc__ or '', add_options)
    machine = common.describe_machine()
    print(machine, flush=True)
    sections: dict[str, Section] = {}
    seconds: dict[str, float] = {}
    for name in common.show_progress(args.only or list(EXPERIMENTS), 'paper'):
        start_s = time.perf_counter()
        sections[name] = EXPERIMENTS[name](args.quick)
        seconds[name] = time.perf_counter() - start_s
        print(f'\n{sections[name].plain()}\n\n({name}: {seconds[name]:.1f} s)', flush=True)
    if not args.quick:
        write_report(args.output / 'paper.md', f'{HEAD}\nMeasured on: {machine}.', sections, list(EXPERIMENTS))
    record = {name: s.data for name, s in sections.items()}
    common.write_json(args.json, {'machine': machine, 'quick': args.quick, 'seconds': seconds, 'results': record})


if __name__ == '__main__':
    main()
