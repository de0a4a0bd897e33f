# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The experiments of TPAMI 2016, section 4, and the targets of the project: the sections of docs/paper.md."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping

import common
from experiments import accuracy, cameras, gait, stability, targets
from report import Report, Section, add_sections, run

# The experiments in the order of the page, by their names on the command line and between its markers.
EXPERIMENTS: Mapping[str, Section] = {
    'targets': targets.measure_targets,
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


def measure(args: argparse.Namespace, report: Report) -> None:
    seconds: dict[str, float] = {}
    for name in common.show_progress(args.only or EXPERIMENTS, 'paper'):
        experiment, start_s = EXPERIMENTS[name], time.perf_counter()
        report.text(f'## {(experiment.__doc__ or name).partition(chr(10))[0].rstrip(".")}')
        with report.write_page(f'paper.{name}'):
            found = experiment(report, args.quick)
        seconds[name] = time.perf_counter() - start_s
        report.text(f'({name}: {seconds[name]:.1f} s)')
        report.add(seconds=seconds, **{name: found})


if __name__ == '__main__':
    run(__doc__, 'The experiments of the paper', measure, lambda p: add_sections(p, EXPERIMENTS))
