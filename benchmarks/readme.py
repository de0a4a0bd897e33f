# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The README's table: how good the result is, in a row for each kind of input; and a table in the terms of papers.

What ships is measured here: on the recorded detections, whose person no model saw, and on the recording of the
demo. The other rows show what other benchmarks have measured, as the record has it; this one runs last.
"""

import re
from importlib.resources import files

import common
import numpy as np
from detected import CLEAN, DETECTORS
from detectors import PAGE_NAMES, measure_recordings
from figures import find_cell
from report import Records, Report, run

import mocap_ros
from mocap_ros.skeleton import BODY26
from mocap_ros.verdict.accuracy import LIMB_JOINTS, find_well_seen_frames

# Errors in mm that papers give of lifters that were trained on Human3.6M: the data, the points, protocols 1 and 2
PUBLISHED = (
    ('VideoPose3D, as PoseAug gives it (arXiv 2105.02465)', 'MPI-INF-3DHP', 'true points', '86.6', '-'),
    ('VideoPose3D with PoseAug (arXiv 2105.02465)', 'MPI-INF-3DHP', 'true points', '73.0', '-'),
    ('the same with AugLift (arXiv 2508.07112)', 'MPI-INF-3DHP', 'true points, estimated depth', '62.4', '-'),
    ('the same with AugLift (arXiv 2508.07112)', '3DPW', 'true points, estimated depth', '92.6', '-'),
    ('ST-GCN with PoseAug (arXiv 2105.02465)', '3DPW', 'HRNet', '-', '73.2'),
)


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
    return rows


def list_demo() -> list[list[str]]:
    """Return the row of the demo as a whole."""
    sequence = mocap_ros.read(str(files('mocap_ros') / 'demo' / 'demo.npz'))
    whole = mocap_ros.evaluate(mocap_ros.reconstruct(sequence), sequence.truth)
    name = 'the recording of `make demo`: noisy synthetic detector, a person that no model was trained on'
    by = '`mocap-ros evaluate mocap_ros/demo/demo.npz`'
    return [[name, f'{whole.mpjpe_mm:.0f}', f'{whole.pa_mpjpe_mm:.0f}', by]]


def measure_root_aligned(view: common.View, joints: common.Array) -> float:
    """Return the mean error in mm of the joints of the limbs about the middle of the hips, without a scale.

    It is protocol 1 of papers on lifting; the frames are those of `limbs_only`.
    """
    names = [BODY26.index(name) for name in LIMB_JOINTS]
    truth, found = view.select_truth(LIMB_JOINTS), joints[:, names]
    frames = find_well_seen_frames(view.joint_names, view.keypoints[..., 2]) & np.isfinite(truth).all(axis=(1, 2))
    hips = [LIMB_JOINTS.index(name) for name in ('lhip', 'rhip')]
    found, truth = (p[frames] - p[frames][:, hips].mean(axis=1, keepdims=True) for p in (found, truth))
    return float(np.linalg.norm(found - truth, axis=-1).mean() * 1e3)


def report_papers(report: Report) -> None:
    """Report the recorded detections in the terms of papers, beside what these give."""
    rows = []
    for detector in common.RECORDED_DETECTORS:
        views = [common.load_recording(detector, camera) for camera in common.CAMERAS]
        found = [common.reconstruct('whole', view, 'all') for view in views]
        errors = common.compute_all_errors(views, found, 'limbs')
        first = np.mean([measure_root_aligned(view, joints) for view, joints in zip(views, found, strict=True)])
        second = common.mean_error(errors, 'pa_mpjpe_mm')
        test = 'a person on a beam, 3 views (demo of Pose2Sim)'
        rows.append(
            ['this project', test, PAGE_NAMES[detector].removesuffix('-like'), f'{first:.1f}', f'{second:.1f}']
        )
    header = ('method', 'tested on', '2D points', 'protocol 1', 'protocol 2')
    report.table(header, [*rows, *map(list, PUBLISHED)], page='readme.papers')


def report_accuracy(report: Report) -> None:
    rows = [*list_recordings(), *list_modelled_detectors(), *list_demo()]
    report.table(('input', 'MPJPE', 'PA', 'measured by'), rows, page='readme.accuracy')


if __name__ == '__main__':
    run(__doc__, {'accuracy': report_accuracy, 'papers': report_papers})
