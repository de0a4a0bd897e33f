# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Classification into periodic and other motion on CMU trials, and the choice of the default thresholds.

Every second of each trial is labelled in `periodic_labels.csv`: `periodic` (walking, running), `other` (jumping,
standing), or `transition` (starting, stopping, turning, stepping aside; not scored). The labels were made from the
true motion, by the speed and the height of the body's centre. For each second, the section of
`classifier.section` s around its middle is classified with base poses that never saw the subject, and with
thresholds chosen on the other subjects.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from report import Report, run

from mocap_ros.config import ClassifierConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.classification import PeriodicFit, fit_periodic, is_periodic
from mocap_ros.solvers.window import Window

LABELS = Path(__file__).with_name('periodic_labels.csv')
SOLVER = common.make_config(components=ClassifierConfig().components)  # as the tracker fits the periodic model
HEADINGS_DEG = (45, 250)  # degrees, two directions that are not symmetric to each other
NOISE = 0.01  # option `noise` of the protocol, as of a good detector
# Trials of --quick, from each category.
QUICK_TRIALS = ('35_02', '35_17', '07_04', '09_01', '13_11', '16_01', '02_04')
# Thresholds that are compared, by parameter of the group `classifier`.
GRID: dict[str, Sequence[float]] = {
    'walk_residual': np.arange(0.010, 0.0205, 0.00125).tolist(),
    'run_residual': np.arange(0.014, 0.0285, 0.002).tolist(),
    'walk_cadence': (0.5, 0.55, 0.6, 0.65),
    'run_cadence': (0.9, 1.0, 1.1),
    'amplitude': np.arange(0.020, 0.035, 0.002).tolist(),
}


@dataclass(frozen=True, eq=False)
class Section:
    """One second of one view, with its label and its periodic fit."""

    trial: str
    subject: str
    category: str
    label: str
    fit: PeriodicFit


def load_labels() -> dict[str, list[str]]:
    """Load the label of each second, by trial."""
    found: dict[str, list[str]] = {}
    with LABELS.open(newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            found.setdefault(row['trial'], []).append(row['label'])
    return found


def train_models_without(subject: str) -> dict[str, BasePoses]:
    """Train base poses of walks and of runs without a subject."""
    return {c: common.train_base_poses(c, without_subjects=(subject,)) for c in ('walk', 'run')}


def cut_window(window: Window, middle: float, length: float) -> Window:
    """Return the frames from `middle` - `length` / 2 to `middle` + `length` / 2, in s."""
    inside = np.abs(window.times - middle) <= length / 2
    return Window(window.points[inside], window.weight[inside], window.times[inside])


def fit_sections(chosen: dict[str, list[str]]) -> list[Section]:
    """Fit the periodic model to every labelled second."""
    trial_of = {t.name: t for t in common.list_trials()}
    length = ClassifierConfig().section
    out = []
    for name, seconds in common.show_progress(chosen.items(), 'sections', len(chosen)):
        trial = trial_of[name]
        for view in common.make_views(name, HEADINGS_DEG, frames=len(trial.poses), noise=NOISE):
            for second, label in enumerate(seconds):
                window = cut_window(view.window, second + 0.5, length)
                fit = fit_periodic(window, train_models_without(trial.subject), SOLVER)
                out.append(Section(name, trial.subject, trial.category, label, fit))
    return out


def compute_balanced_accuracy(answers: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean of the shares of correct answers among the periodic and among the other seconds."""
    return float((answers[truth].mean() + (~answers[~truth]).mean()) / 2)


def choose_thresholds(answers: np.ndarray, true: np.ndarray, thresholds: list[ClassifierConfig]) -> np.ndarray:
    """Return the medians (T,) of all thresholds whose answers are close to the best, in the order of `GRID`."""
    accuracy = np.array([compute_balanced_accuracy(a, true) for a in answers])
    values = np.array([[getattr(t, name) for name in GRID] for t in thresholds])
    return np.asarray(np.median(values[accuracy >= accuracy.max() - 0.003], axis=0))


def classify_left_out_subjects(
    found: list[Section], answers: np.ndarray, true: np.ndarray, thresholds: list[ClassifierConfig]
) -> np.ndarray:
    """Classify the sections of each subject with thresholds chosen on the other subjects."""
    subjects = np.array([s.subject for s in found])
    said = np.zeros(len(found), bool)
    for subject in set(subjects):
        others = subjects != subject
        chosen = choose_thresholds(answers[:, others], true[others], thresholds)
        config = ClassifierConfig(**dict(zip(GRID, chosen.tolist(), strict=True)))
        said[~others] = [is_periodic(s.fit, config) for s in itertools.compress(found, ~others)]
    return said


def show_confusion(report: Report, found: list[Section], answers: np.ndarray, said: str, page: str) -> None:
    """Show the answers by category and label."""
    rows = []
    for category, label in itertools.product(('walk', 'run', 'jump'), ('periodic', 'other')):
        chosen = np.array([s.category == category and s.label == label for s in found])
        if chosen.any():
            counts = (int(chosen.sum()), int(answers[chosen].sum()), int((~answers[chosen]).sum()))
            rows.append((category, label, *counts))
    report.table(('trials', 'truth', 'seconds', 'called periodic', 'called other'), rows, said, page=page)


def measure(args: argparse.Namespace, report: Report) -> None:
    chosen = {t: ls for t, ls in load_labels().items() if not args.quick or t in QUICK_TRIALS}
    found = [s for s in fit_sections(chosen) if s.label != 'transition']
    true = np.array([s.label == 'periodic' for s in found])
    shipped = np.array([is_periodic(s.fit, ClassifierConfig()) for s in found])
    balanced = compute_balanced_accuracy(shipped, true)
    report.add(seconds=len(found), balanced_accuracy_defaults=balanced)
    said = f'Shipped thresholds: balanced accuracy {balanced:.1%} of {len(found)} seconds'
    show_confusion(report, found, shipped, said, 'classification.shipped')
    if not args.quick:
        thresholds = [
            replace(ClassifierConfig(), **dict[str, Any](zip(GRID, v, strict=True)))
            for v in itertools.product(*GRID.values())
        ]
        by_threshold = np.array([[is_periodic(s.fit, t) for s in found] for t in thresholds])
        answers = classify_left_out_subjects(found, by_threshold, true, thresholds)
        balanced = compute_balanced_accuracy(answers, true)
        report.add(balanced_accuracy_subject_left_out=balanced)
        said = f'Thresholds chosen on the other subjects: balanced accuracy {balanced:.1%}'
        show_confusion(report, found, answers, said, 'classification.left_out')
        middle = choose_thresholds(by_threshold, true, thresholds).round(4).tolist()
        wrong = Counter(f'{s.trial} ({s.label})' for s in itertools.compress(found, answers != true))
        report.text(f'Median of the best thresholds over all subjects: {dict(zip(GRID, middle, strict=True))}')
        report.text(f'Wrongly classified seconds by trial: {dict(wrong.most_common(12))}')


if __name__ == '__main__':
    run(__doc__, 'Classification', measure)
