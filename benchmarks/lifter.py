# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifter brings: the network alone, the joint solver with base poses alone, and both.

Motion capture with clean points and with those of a bad detector, at most 120 frames of three trials a row, four
headings. Neither lifter nor base poses were trained on the tested subjects.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import common
from report import Report, run

from mocap_ros.config import Config, SolverConfig
from mocap_ros.formats.mocap.trials import Trial
from mocap_ros.models.lifter import scale_to_metres
from mocap_ros.models.model_file import load_lifter
from mocap_ros.solvers.joint.solver import solve_hypotheses

# Rows of the table: which trials belong to the row, and the target of its MPJPE in mm.
ROWS: dict[str, tuple[Callable[[Trial], bool], float]] = {
    '35 walk': (lambda t: t.subject == '35' and t.category == 'walk', 16),
    '35 run': (lambda t: t.subject == '35' and t.category == 'run', 22),
    '13 jump': (lambda t: t.subject == '13' and t.category == 'jump', 40),
    '05 dance': (lambda t: t.subject == '05' and t.category == 'dance', 65),
    '135 martial arts': (lambda t: t.subject == '135', 60),
    'U* gestures': (lambda t: t.subject.startswith('U') and t.category == 'gesture', 34),
}
CONDITIONS: dict[str, dict[str, Any]] = {'clean': {}, 'noisy': {'noise': 0.02, 'missing': 0.1}}
MAX_FRAMES = 120


def report_methods(report: Report) -> None:
    common.choose_capture('motion')
    lifter, height = load_lifter(report.args.lifter), Config().tracker.body_height
    poses = common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)
    rows = []
    for row, (is_chosen, target) in common.show_progress(list(ROWS.items())[: 2 if report.quick else 6], 'rows'):
        names = [t.name for t in common.list_trials() if t.clean and is_chosen(t)]
        names = names[:: max(1, len(names) // (1 if report.quick else 3))]
        record, both = {'motion': row}, []
        for condition, options in CONDITIONS.items():
            headings = common.HEADINGS_DEG[::2]
            views = [v for n in names for v in common.make_views(n, headings, frames=MAX_FRAMES, **options)]
            windows = [v.window for v in views]
            lifted = [lifter.lift_sequence(w.points, w.weight, w.times, w.focal).select_core() for w in windows]
            given = [replace(w, lifted=out) for w, out in zip(windows, lifted, strict=True)]
            found = {
                'network': [scale_to_metres(o, w.times, height) for o, w in zip(lifted, windows, strict=True)],
                'factorisation': solve_hypotheses(windows, poses, SolverConfig()),
                'both': solve_hypotheses(given, poses, SolverConfig()),
            }
            errors = {m: common.mean_error(common.compute_all_errors(views, f)) for m, f in found.items()}
            record |= {f'{m}, {condition}': f'{e:.1f}' for m, e in errors.items()}
            both.append(errors['both'])
        rows.append({**record, 'target, clean': f'{target:g}', 'noisy / clean': f'{both[1] / both[0]:.2f}'})
    report.rows('MPJPE, mm', rows, 'lifter.solver')


def add_options(parser: argparse.ArgumentParser) -> None:
    help_text = 'lifter that was not trained on the tested subjects'
    parser.add_argument('--lifter', type=Path, default=common.HELD_OUT_LIFTER, metavar='NPZ', help=help_text)


if __name__ == '__main__':
    run(__doc__, {'methods': report_methods}, add_options)
