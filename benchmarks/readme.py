# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The README's table: how good the result is, in a row for each kind of input.

What ships is measured here: on the recorded detections, whose person no model saw, and on the recording of the
demo. The other rows show what other benchmarks have measured, as the record has it; this one runs last.
"""

import re
from importlib.resources import files

import common
import numpy as np
from detected import CLEAN, DETECTORS
from detectors import PAGE_NAMES, measure_recordings
from figures import find_cell, load_record
from report import Records, Report, run

import mocap_ros
from mocap_ros.skeleton import BODY26

OURS = ('this project', 'Algorithm 1')  # rows of the rivals' table that are this project's


def find_numbers(table: str, row: str, column: str) -> list[float]:
    """Return the numbers in a cell of the record.

    Raises:
        ValueError: the record has no such cell, or there are none in it.
    """
    numbers = re.findall(r'\d+(?:\.\d+)?', find_cell(table, row, column, common.ROOT))
    if not numbers:
        raise ValueError(f'there is no number in table {table}, row {row}, column {column}')
    return [float(n) for n in numbers]


def list_recordings() -> list[list[str]]:
    """Return the rows of the recorded detections, by the models that ship."""
    records = measure_recordings('all', {}, common.WAYS[:1])

    def describe(some: Records) -> list[str]:
        errors = [[r[key] for r in some] for key in ('mpjpe_mm', 'pa_mpjpe_mm')]
        return [f'{min(e):.0f} to {max(e):.0f}' for e in errors]

    own = describe([r for r in records if r['way'] not in common.WAYS])
    names = {
        'openpose': 'OpenPose, a person balancing on a beam, a motion that no model was trained on, three views',
        'mediapipe': f"MediaPipe's 2D points of the same (MediaPipe's own 3D: {own[0]}, PA {own[1]})",
    }
    return [
        [
            f'**real detections**: {name}',
            *describe([r for r in records if r['detector'] == detector and r['way'] in common.WAYS]),
            '`benchmarks/readme.py`',
        ]
        for detector, name in names.items()
    ]


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
    size, camera = sequence.image_size, sequence.camera_matrix
    tracker = mocap_ros.Tracker(sequence.joint_names, image_size=size, camera_matrix=camera)
    joints = np.full((len(sequence), len(BODY26.joints), 3), np.nan)
    for frame, (time_s, keypoints) in enumerate(zip(sequence.timestamps, sequence.keypoints, strict=True)):
        for person in tracker.update(float(time_s), [keypoints]).people:
            joints[frame] = person.joints
    live = mocap_ros.evaluate(joints, sequence.truth, times=sequence.timestamps)
    whole = mocap_ros.evaluate(mocap_ros.reconstruct(sequence), sequence.truth)
    name = '`make demo`: live, noisy synthetic detector, a person that no model was trained on'
    by = '`mocap-ros evaluate mocap_ros/demo/demo.npz`'
    errors = [[f'{e.mpjpe_mm:.0f}', f'{e.pa_mpjpe_mm:.0f}'] for e in (live, whole)]
    return [[name, *errors[0], '`make demo`'], ['the same recording as a whole', *errors[1], by]]


def list_clean_points() -> list[list[str]]:
    """Return the rows of points without errors."""
    *_, left_out = find_numbers('paper.targets', 'subject left out, category known: 35_02', 'measured')
    same_person, *_ = find_numbers('paper.targets', '35_02, walk; trained on the other walk', 'measured')
    columns = [f'fixed: {category}' for category in ('walk', 'run', 'jump')]
    ours = [find_numbers('rivals.errors', 'this project, joint solver', c)[1] for c in columns]
    lines = load_record(common.ROOT)['rivals.errors']['text'].splitlines()[2:]
    names = [name for name in (line.strip('| ').split(' | ')[0] for line in lines) if not name.startswith(OURS)]
    others = [find_numbers('rivals.errors', name, column)[1] for name in names for column in columns]
    link = '[other methods](docs/accuracy.md#other-methods-on-the-same-views)'
    rivals = f'{link}: {min(others):.0f} to {max(others):.0f}'
    category = 'CMU walking and running of persons whom no model was trained on, base poses of the category'
    own = "a CMU walk, base poses of the same person's other walks, `solver.prior: pca`"
    rows = (
        (category, f'{left_out:.0f}', 'paper.py --only targets'),
        (f'walk / run / jump before a fixed camera ({rivals})', ' / '.join(f'{e:.0f}' for e in ours), 'table1.py'),
        (own, f'{same_person:.1f}', 'paper.py --only targets'),
    )
    return [[f'clean points: {name}', error, '', f'`benchmarks/{command}`'] for name, error, command in rows]


def report_accuracy(report: Report) -> None:
    rows = [*list_recordings(), *list_modelled_detectors(), *list_demo(), *list_clean_points()]
    report.table(('input', 'MPJPE', 'PA', 'measured by'), rows, page='readme.accuracy')


if __name__ == '__main__':
    run(__doc__, {'accuracy': report_accuracy})
