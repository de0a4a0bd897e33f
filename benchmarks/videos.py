# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How good are detectors for the pose in 3D, on real video with truth, and how fast are they?

A person balances on a beam: 100 images at 60 Hz of three calibrated cameras, of the demo of Pose2Sim
(BSD-3-Clause, github.com/perfanalytics/pose2sim, `Pose2Sim/Demo_SinglePerson/videos`), with joints triangulated
from four views. Each model looks at the videos; its keypoints are reconstructed whole and live. MPJPE / PA-MPJPE
in mm of the twelve joints of the limbs, mean of the cameras; and images per second of processor time.
`--videos FOLDER` holds `cam01.mp4` and so on; it is skipped without.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import WAYS, View
from report import Report, run

from mocap_ros.detectors.detector import FINDER
from mocap_ros.formats.detections import select_person
from mocap_ros.recordings.detect_people import detect_in_video

DEFAULT = 'as shipped'


def detect(report: Report, model: Path | None, camera: int) -> tuple[View, float]:
    """Return the keypoints that a model finds, beside the truth, and images per second of processor time."""
    recorded = common.load_recording('openpose', camera)
    start_s = time.process_time()
    detections = detect_in_video(report.args.videos / f'cam{camera:02d}.mp4', model)
    rate = len(detections.people) / (time.process_time() - start_s)
    sequence, _ = select_person(detections)
    count, keypoints = len(recorded.times), sequence.keypoints
    first = int(np.argmin(np.abs(np.array(detections.stamps_ns) - sequence.stamps_ns[0])))
    whole = np.full((count, *keypoints.shape[1:]), [np.nan, np.nan, 0.0])
    whole[first : first + len(keypoints)] = keypoints[: count - first]
    found = {'keypoints': whole, 'joint_names': np.array(sequence.joint_names)}
    return View({**recorded.sequence, **found}), rate


def report_models(report: Report) -> dict[str, Any]:
    """Measure every model, and the recorded detections of other programs."""
    if not (report.args.videos / 'cam01.mp4').is_file():
        print(f'skipped: no videos in {report.args.videos}')
        return {}
    models = {DEFAULT: None, FINDER.stem: FINDER} | {path.stem: path for path in report.args.models}
    rows, records = [], []
    for name in (*models, *common.RECORDED_DETECTORS):
        errors: dict[str, list[dict[str, float]]] = {way: [] for way in WAYS}
        rates = []
        for camera in common.CAMERAS:
            if name in models:
                view, rate = detect(report, models[name], camera)
                rates.append(rate)
            else:
                view = common.load_recording(name, camera)
            for way in WAYS:
                found = common.compute_errors(view, common.reconstruct(way, view), joints='limbs')
                errors[way].append(found)
                records.append({'model': name, 'camera': camera, 'way': way, **found})
        cells = [
            '{:.0f} / {:.0f}'.format(*(common.mean_error(errors[way], k) for k in ('mpjpe_mm', 'pa_mpjpe_mm')))
            for way in WAYS
        ]
        rows.append([name, *cells, f'{np.mean(rates):.0f}' if rates else None])
        print(rows[-1], flush=True)
    report.table(['model', *WAYS, 'images/s'], rows, page='videos.models')
    return {'models': records}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--videos', type=Path, default=common.ROOT / 'build' / 'videos', metavar='FOLDER')
    parser.add_argument('--models', type=Path, nargs='*', default=[], metavar='FILE')


if __name__ == '__main__':
    run(__doc__, {'models': report_models}, add_options)
