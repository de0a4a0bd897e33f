"""The experiments of TPAMI 2016, section 4, and the project's targets; the full run writes docs/paper.md."""

from __future__ import annotations

import common

# isort: split
import argparse
import time
from collections.abc import Callable
from pathlib import Path

from experiments import accuracy, cameras, gait, stability
from experiments.report import Section, write_report
from experiments.targets import targets

EXPERIMENTS: dict[str, Callable[[bool], Section]] = {
    'targets': targets,
    'table1': accuracy.table_1,
    'cameras': cameras.moving,
    'base_poses': accuracy.number_of_base_poses,
    'beta': accuracy.bone_regulariser,
    'bones': accuracy.bone_lengths,
    'convergence': stability.convergence,
    'noisy_starts': stability.noisy_starts,
    'hidden': stability.hidden,
    'missing': stability.occlusion,
    'noise': stability.noise,
    'weights': stability.weights_under_noise,
    'flips': cameras.flip_regulariser,
    'differences': cameras.differences,
    'sines': gait.fitted_sines,
    'classification': gait.classification,
    'claims': gait.claims,
}
HEAD = """
# The paper's experiments

Wandt, Ackermann, Rosenhahn: 3D Reconstruction of Human Motion from Monocular Image Sequences, TPAMI 2016,
section 4, with this project's solvers beside the paper's printed values. Made by `python benchmarks/paper.py`;
every number but those called the paper's is measured by it.

- Data: CMU motion capture at 30 fps, 15 joints. HumanEva and KTH Football, which the paper uses too, are not to
  be had. Test views: orthographic at 300 px/m, elevation 10 degrees, the first 120 frames; the heading is the
  direction that the camera looks from, 0 the front.
- "Algorithm 1" is the paper's method (`mocap_ros.alternation`): no prior, no smoothness, K base poses from the
  poses alone (here with their heading aligned, since the paper's walking directions are unknown). "Joint",
  "project" and "defaults" are this project's solvers with everything on. No model ever saw the trial it is tested
  on, unless said.
- MPJPE: mean distance of a joint, mm, each pose centred, one scale a sequence, no rotation. e: eq. 25 of the
  paper, cm, after one similarity a sequence; it falls with the root of the number of frames f. 2D errors are in
  mm at the body.
- Weights of the terms are this project's: squared errors in m², time in seconds. They are not the paper's.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--only', nargs='+', choices=list(EXPERIMENTS), metavar='NAME', help='some of ' + ', '.join(EXPERIMENTS)
    )
    parser.add_argument(
        '--output', type=Path, default=common.ROOT / 'docs', metavar='FOLDER', help='of paper.md and img/paper'
    )


def main() -> None:
    args = common.arguments(__doc__ or '', add_options)
    machine = common.machine()
    print(machine, flush=True)
    sections: dict[str, Section] = {}
    seconds: dict[str, float] = {}
    for name in common.progress(args.only or list(EXPERIMENTS), 'paper'):
        begun = time.perf_counter()
        sections[name] = EXPERIMENTS[name](args.quick)
        seconds[name] = time.perf_counter() - begun
        print(f'\n{sections[name].plain()}\n\n({name}: {seconds[name]:.1f} s)', flush=True)
    if not args.quick:
        write_report(args.output / 'paper.md', f'{HEAD}\nMeasured on: {machine}.', sections, list(EXPERIMENTS))
    record = {name: s.data for name, s in sections.items()}
    common.write_json(args.json, {'machine': machine, 'quick': args.quick, 'seconds': seconds, 'results': record})


if __name__ == '__main__':
    main()
