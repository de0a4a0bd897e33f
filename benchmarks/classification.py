"""Periodic or not, on CMU walk, run and jump trials; where the thresholds of ClassifierConfig come from.

Every second of each trial is labelled in `periodic_labels.csv`: `periodic` (walking, running), `other` (jumping,
standing), or `transition` (starting, stopping, turning, stepping aside; not scored). The labels were made from the
true motion, by the speed and height of the body's centre. A section of `classifier.section` s about the middle of
each second is judged by base poses that never saw the subject, with thresholds chosen on other subjects.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from dataclasses import dataclass
from pathlib import Path

import common
import numpy as np

from mocap_ros.config import ClassifierConfig, TrackerConfig
from mocap_ros.solvers.classification import PeriodicFit, PeriodicSwitch, fit_periodic, is_periodic
from mocap_ros.solvers.window import Window

LABELS = Path(__file__).with_name('periodic_labels.csv')
SOLVER = common.changed(components=TrackerConfig().components)
HEADINGS = (45, 250)
NOISE = 0.01
QUICK_TRIALS = ('35_02', '35_17', '07_04', '09_01', '13_11', '16_01', '02_04')
GRID = {
    'walk_residual': np.arange(0.010, 0.0205, 0.00125),
    'run_residual': np.arange(0.014, 0.0285, 0.002),
    'walk_cadence': (0.5, 0.55, 0.6, 0.65),
    'run_cadence': (0.9, 1.0, 1.1),
    'amplitude': np.arange(0.020, 0.035, 0.002),
}


@dataclass(frozen=True, eq=False)
class Section:
    """One second of one view."""

    trial: str
    subject: str
    category: str
    label: str
    fit: PeriodicFit


def labels() -> dict[str, list[str]]:
    """Label of each second, by trial."""
    found: dict[str, list[str]] = {}
    with LABELS.open(newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            found.setdefault(row['trial'], []).append(row['label'])
    return found


def models_without(subject: str) -> dict[str, common.BasePoses]:
    return {c: common.trained(c, without_subjects=(subject,)) for c in ('walk', 'run')}


def cut(window: Window, middle: float, length: float) -> Window:
    """The frames at most half of `length` s from `middle` s."""
    own = np.abs(window.times - middle) <= length / 2
    return Window(window.points[own], window.weight[own], window.times[own])


def sections(chosen: dict[str, list[str]]) -> list[Section]:
    """The periodic fit of every labelled second."""
    known = {t.name: t for t in common.trials()}
    length = ClassifierConfig().section
    out = []
    for name, seconds in common.progress(chosen.items(), 'sections', len(chosen)):
        trial = known[name]
        for view in common.views(name, HEADINGS, frames=len(trial.poses), noise=NOISE):
            for second, label in enumerate(seconds):
                window = cut(view.window, second + 0.5, length)
                fit = fit_periodic(window, models_without(trial.subject), SOLVER)
                out.append(Section(name, trial.subject, trial.category, label, fit))
    return out


def balanced(said: np.ndarray, true: np.ndarray) -> float:
    """Mean of the shares of periodic and of other seconds that are told right."""
    return float((said[true].mean() + (~said[~true]).mean()) / 2)


def all_answers(found: list[Section], thresholds: list[ClassifierConfig]) -> np.ndarray:
    """(thresholds, sections) of answers."""
    return np.array([[is_periodic(s.fit, t) for s in found] for t in thresholds])


def left_out_answers(found: list[Section], thresholds: list[ClassifierConfig]) -> np.ndarray:
    """Each subject's answers under thresholds chosen on the others: the middle of the best plateau."""
    answers = all_answers(found, thresholds)
    true = np.array([s.label == 'periodic' for s in found])
    subjects = np.array([s.subject for s in found])
    values = np.array([[getattr(t, name) for name in GRID] for t in thresholds])
    said = np.zeros(len(found), bool)
    for subject in set(subjects):
        others = subjects != subject
        accuracy = np.array([balanced(a[others], true[others]) for a in answers])
        plateau = np.median(values[accuracy >= accuracy.max() - 0.003], axis=0)
        config = ClassifierConfig(**dict(zip(GRID, plateau.tolist(), strict=True)))
        said[~others] = [is_periodic(s.fit, config) for s in itertools.compress(found, ~others)]
    return said


def confusion(found: list[Section], said: np.ndarray) -> str:
    rows = []
    for category, label in itertools.product(('walk', 'run', 'jump'), ('periodic', 'other')):
        mine = np.array([s.category == category and s.label == label for s in found])
        if mine.any():
            rows.append((category, label, int(mine.sum()), int(said[mine].sum()), int((~said[mine]).sum())))
    return common.table(('trials', 'truth', 'seconds', 'called periodic', 'called other'), rows)


def splice() -> str:
    """A run, a jump, a run, judged as it goes by, with hysteresis."""
    motion, _ = common.capture()
    parts = [motion['35_17'], motion['16_02'][30:90], motion['35_18']]
    joined = np.concatenate(parts)
    ends = np.cumsum([len(p) for p in parts]) / common.FPS
    (view,) = common.views(joined, (90,), frames=len(joined), noise=NOISE)
    switch = PeriodicSwitch(ClassifierConfig())
    rows = []
    for end in np.arange(1.0, ends[-1] + 0.01, 0.25):
        window = cut(view.window, end - 0.5, 1.0)
        fit = fit_periodic(window, models_without('35'), SOLVER)
        answer = 'periodic' if switch.update(fit) else 'other'
        truth = 'run' if end - 0.5 < ends[0] or end - 0.5 > ends[1] else 'jump'
        rows.append((f'{end - 0.5:.2f}', truth, f'{fit.residual:.4f}', fit.category, answer))
    return common.table(('middle, s', 'truth', 'residual, of stature', 'best category', 'answer'), rows)


def main() -> None:
    args = common.arguments(__doc__ or '', _add)
    chosen = {t: ls for t, ls in labels().items() if not args.quick or t in QUICK_TRIALS}
    found = [s for s in sections(chosen) if s.label != 'transition']
    true = np.array([s.label == 'periodic' for s in found])
    thresholds = [
        ClassifierConfig(**dict(zip(GRID, map(float, v), strict=True))) for v in itertools.product(*GRID.values())
    ]
    shipped = np.array([is_periodic(s.fit, ClassifierConfig()) for s in found])
    record = {'seconds': len(found), 'balanced_accuracy_defaults': balanced(shipped, true)}
    print(common.machine())
    print(f'\nShipped thresholds: balanced accuracy {balanced(shipped, true):.1%} of {len(found)} seconds\n')
    print(confusion(found, shipped))
    if not args.quick:
        said = left_out_answers(found, thresholds)
        record['balanced_accuracy_subject_left_out'] = balanced(said, true)
        print(f'\nThresholds chosen on other subjects: balanced accuracy {balanced(said, true):.1%}\n')
        print(confusion(found, said))
        accuracy = np.array([balanced(a, true) for a in all_answers(found, thresholds)])
        values = np.array([[getattr(t, n) for n in GRID] for t in thresholds])
        plateau = np.median(values[accuracy >= accuracy.max() - 0.003], axis=0)
        middle = dict(zip(GRID, plateau.round(4).tolist(), strict=True))
        print('\nMiddle of the best plateau over all subjects:', middle)
        wrong = {}
        for s, a in zip(found, said, strict=True):
            if a != (s.label == 'periodic'):
                wrong[f'{s.trial} ({s.label})'] = wrong.get(f'{s.trial} ({s.label})', 0) + 1
        print('Wrong seconds by trial:', dict(sorted(wrong.items(), key=lambda kv: -kv[1])[:12]))
    print('\nSplice of 35/17 (run), 16/02 (jump), 35/18 (run), sections of 1 s, with hysteresis:\n')
    print(splice())
    common.write_json(args.json, record)


def _add(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


if __name__ == '__main__':
    main()
