"""The experiments of TPAMI 2016, section 4, and the targets of the project: the sections of docs/paper.md."""

from __future__ import annotations

import common

# isort: split
import argparse
import time
from collections.abc import Callable

from experiments import accuracy, cameras, gait, stability
from experiments.report import Section
from experiments.targets import measure_targets
from report import Report, run

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


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--only',
        nargs='+',
        choices=list(EXPERIMENTS),
        metavar='NAME',
        help='experiments to run, of ' + ', '.join(EXPERIMENTS),
    )


def measure(args: argparse.Namespace, report: Report) -> None:
    seconds: dict[str, float] = {}
    results = {}
    for name in common.show_progress(args.only or list(EXPERIMENTS), 'paper'):
        start_s = time.perf_counter()
        section = EXPERIMENTS[name](args.quick)
        seconds[name], results[name] = time.perf_counter() - start_s, section.data
        report.text(section.plain(), f'({name}: {seconds[name]:.1f} s)')
        report.tables[f'paper.{name}'] = section.markdown()
        if not args.quick:
            for path, figure in section.figures.items():
                report.picture(figure, path)
        report.add(seconds=seconds, results=results)


def main() -> None:
    run(__doc__, 'The experiments of the paper', measure, add_options)


if __name__ == '__main__':
    main()
