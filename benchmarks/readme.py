# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The README's table: how good the result is, in a row for each kind of input.

What ships is measured here: on the recorded detections, whose person no model saw, and on the recording of the
demo. The other rows show what other benchmarks have measured, as `figures.json` has it; this one runs last.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from importlib.resources import files

import common
import numpy as np
from detectors import PAGE_NAMES, Measurement, load_models, measure_recordings
from experiments.detector_views import CLEAN, DETECTORS
from figure_record import RECORD, find_cell, load_record
from reconstruction import WAYS
from report import Records, Report, run, select

import mocap_ros
from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config
from mocap_ros.skeleton import BODY26

ERRORS = ('mpjpe_mm', 'pa_mpjpe_mm')
HEADER = ('input', 'MPJPE', 'PA', 'measured by')
OURS = ('this project', 'algorithm 1', 'periodic, one sine')  # rows of the rivals' table that are this project's
BEST = 'this project, joint solver'  # of these rows


def find_numbers(table: str, row: str, column: str) -> list[float]:
    """Return the numbers in a cell of the record.

    Raises:
        ValueError: the record has no such cell.
    """
    cell = find_cell(load_record(common.ROOT / RECORD), table, (row.casefold(),), column)
    numbers = re.findall(r'\d+(?:\.\d+)?', cell)
    if not numbers:
        raise ValueError(f'{table} has no numbers in the row {row} and the column {column}')
    return [float(n) for n in numbers]


def describe_range(records: Records, key: str) -> str:
    """Return the smallest and the largest of some errors in mm."""
    errors = [r[key] for r in records]
    return f'{min(errors):.0f} to {max(errors):.0f}'


def list_recordings(quick: bool) -> list[list[str]]:
    """Return the rows of the recorded detections, by the models that ship."""
    models, config = load_models(True, Config())
    records = measure_recordings(Measurement(models, config, quick, 'held-out', DETECTORS, (0,), WAYS[:1], None))
    own = [describe_range(select(records, way="the detector's own 3D"), key) for key in ERRORS]
    names = {
        'openpose': 'OpenPose, a person balancing on a beam, a motion that no model was trained on, three views',
        'mediapipe': f"MediaPipe's 2D points of the same (MediaPipe's own 3D: {own[0]}, PA {own[1]})",
    }
    rows = []
    for detector, name in names.items():
        found = select(records, detector=detector, way=WAYS[0])
        errors = [describe_range(found, key) for key in ERRORS]
        rows.append([f'**real detections**: {name}', *errors, '`benchmarks/readme.py`'])
    return rows


def list_modelled_detectors() -> list[list[str]]:
    """Return the rows of the views with errors like those of detectors, and of heads and feet in them."""
    names = [PAGE_NAMES[d] for d in DETECTORS if d != CLEAN]
    makers = ' / '.join(f"{name.removesuffix('-like')}'s" for name in names)
    inputs = {
        'whole sequence': '103 motions of persons whom no model was trained on, each from three sides, with '
        f'errors like {makers}',
        'live': 'the same live (the newest frame)',
    }
    rows = []
    for column, name in inputs.items():
        cells = [find_numbers('detectors.points', points, column) for points in names]
        # a cell has the MPJPE, its spread, and the error after a similarity transform
        errors = [' / '.join(f'{numbers[i]:.0f}' for numbers in cells) for i in (0, 2)]
        rows.append([name, *errors, '`benchmarks/detectors.py --only whole live`'])
    row = f'walking, gestures | {names[0]} | live'
    head, foot = (find_numbers('detectors.extremities', row, column)[0] for column in ('head', 'feet'))
    directions = f'where they look and where their feet point (medians), walking and gestures, live, {names[0]}'
    degrees = f'{head:.0f} and {foot:.0f} degrees'
    return [*rows, [directions, degrees, '', '`benchmarks/detectors.py --only extremities`']]


def list_demo() -> list[list[str]]:
    """Return the rows of the demo: frame by frame, as the node does it, and as a whole."""
    sequence = mocap_ros.read(str(files('mocap_ros') / 'demo' / 'demo.npz'))
    assert sequence.truth is not None
    tracker = mocap_ros.Tracker(sequence.joint_names, image_size=sequence.image_size)
    joints = np.full((len(sequence), len(BODY26.joints), 3), np.nan)
    for frame, (time_s, keypoints) in enumerate(zip(sequence.timestamps, sequence.keypoints, strict=True)):
        for person in tracker.update(float(time_s), [keypoints]):
            joints[frame] = person.joints
    live = mocap_ros.evaluate(joints, sequence.truth, times=sequence.timestamps)
    whole = mocap_ros.evaluate(mocap_ros.reconstruct(sequence), sequence.truth)
    name = '`make demo`: live, noisy synthetic detector, a person that no model was trained on'
    return [
        [name, f'{live.mpjpe_mm:.0f}', f'{live.pa_mpjpe_mm:.0f}', '`make demo`'],
        [
            'the same recording as a whole',
            f'{whole.mpjpe_mm:.0f}',
            f'{whole.pa_mpjpe_mm:.0f}',
            '`mocap-ros evaluate mocap_ros/demo/demo.npz`',
        ],
    ]


def list_clean_points() -> list[list[str]]:
    """Return the rows of points without errors."""
    targets = 'paper.targets'
    *_, category_known = find_numbers(targets, 'subject left out, category known: 35_02', 'measured')
    same_person, *_ = find_numbers(targets, '35_02, walk; trained on the other walk', 'measured')
    columns = [f'fixed: {category}' for category in ('walk', 'run', 'jump')]
    ours = ' / '.join(f'{find_numbers("rivals.errors", BEST, c)[1]:.0f}' for c in columns)
    others = list_rivals(columns)
    link = '[other methods](docs/accuracy.md#other-methods-on-the-same-views)'
    rivals = f'{link}: {min(others):.0f} to {max(others):.0f}'
    left_out = 'CMU walking and running of persons whom no model was trained on, base poses of the category'
    own = "a CMU walk, base poses of the same person's other walks, `solver.prior: pca`"
    rows = (
        (left_out, f'{category_known:.0f}', 'paper.py --only targets'),
        (f'walk / run / jump before a fixed camera ({rivals})', ours, 'table1.py'),
        (own, f'{same_person:.1f}', 'paper.py --only targets'),
    )
    return [[f'clean points: {name}', error, '', f'`benchmarks/{command}`'] for name, error, command in rows]


def list_rivals(columns: Sequence[str]) -> list[float]:
    """Return the MPJPE in mm of all other methods of the rivals' table in some columns."""
    record = load_record(common.ROOT / RECORD)
    rows = [line.strip('| ') for line in record['table1']['tables']['rivals.errors'].splitlines()[2:]]
    names = [name for name, *_ in (row.split(' | ') for row in rows) if not name.casefold().startswith(OURS)]
    return [find_numbers('rivals.errors', name, column)[1] for name in names for column in columns]


def measure(args: argparse.Namespace, report: Report) -> None:
    compile_kernels()
    rows = [
        *list_recordings(args.quick),
        *list_modelled_detectors(),
        *list_demo(),
        *list_clean_points(),
    ]
    report.table(HEADER, rows, page='readme.accuracy')


if __name__ == '__main__':
    run(__doc__, 'README', measure, one_core=False)
