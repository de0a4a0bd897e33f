# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What measured depths are worth: poses, distances and deviations without and with them.

The views are those of `bodies.py`: a body model with a surface moves as people on whom no model was trained,
before a simulated stereo camera with its noise, holes and flying pixels, 1.5 to 5 m away, some behind a box or a
table; keypoints are as OpenPose and MediaPipe give them, and depths are sampled where the detector sees them.
`half missing` leaves out every second depth at random. Measures: MPJPE and PA-MPJPE in mm, acceleration error in
m/s^2, the distance of the root (error in per cent), the slide of standing ankles (mm a frame), and, live, the
shares of true errors within the ellipsoids of 95 % of joints and roots. `--persons train` tests the views on which
the constants were chosen.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import WAYS, View
from numpy.typing import NDArray
from report import Record, Records, Report, group, run

from mocap_ros.skeleton import BODY26, CMU15, HIPS
from mocap_ros.verdict.coverage import compute_coverage

Array = NDArray[np.float64]

MODES = ('without', 'with', 'half missing')
STANDING_M_S = 0.1  # m/s; a slower ankle stands
MEASURES = {
    'mpjpe_mm': 'MPJPE', 'pa_mpjpe_mm': 'PA', 'accel': 'acceleration', 'distance': 'distance, %',
    'slide': 'slide', 'joints95': 'joints within', 'roots95': 'roots within',
}  # fmt: skip
RANGES_M = ((0.0, 2.5), (2.5, 4.0), (4.0, np.inf))


def list_views(report: Report) -> Iterator[tuple[Record, View]]:
    """Yield every view without and with its depths, and what is known of it."""
    paths = sorted(report.args.views.glob(f'{report.args.persons}_*.npz'))[:: 4 if report.quick else 1]
    if not paths:
        print(f'skipped: no views in {report.args.views}; make them with benchmarks/bodies.py')
    for number, path in enumerate(common.show_progress(paths, 'views')):
        with np.load(path) as archive:
            given = dict(archive)
        distance, occluder = float(given['distance']), str(given['occluder'])
        low, high = next(r for r in RANGES_M if r[0] <= distance < r[1])
        about = {
            'view': path.stem,
            'detector': str(given['detector']),
            'range': f'{low:g} to {high:g} m' if np.isfinite(high) else f'from {low:g} m',
            'occluder': 'behind furniture' if occluder else 'in the open',
        }
        depth = given.pop('depth')
        lost = np.random.default_rng(number).random(depth.shape) < 0.5
        depths = {'without': None, 'with': depth, 'half missing': np.where(lost, np.nan, depth)}
        for mode in MODES:
            known = {} if depths[mode] is None else {'depth': depths[mode]}
            yield {**about, 'mode': mode}, View({**given, **known})


def measure(view: View, joints: Array) -> dict[str, float]:
    """Return the errors of joints (F, 26, 3) m."""
    errors, truth, found = common.compute_errors(view, joints), view.true_poses, joints[:, : len(CMU15.joints)]
    root, true_root = (poses[:, HIPS].mean(axis=1)[:, 2] for poses in (found, truth))
    ankles = [CMU15.index('lankle'), CMU15.index('rankle')]
    steps, true_steps = (np.linalg.norm(np.diff(p[:, ankles], axis=0), axis=-1) for p in (found, truth))
    stands = true_steps * common.FPS < STANDING_M_S
    return {
        'mpjpe_mm': errors['mpjpe_mm'],
        'pa_mpjpe_mm': errors['pa_mpjpe_mm'],
        'accel': errors['accel_mm_s2'] / 1e3,
        'distance': float(100 * np.nanmean(np.abs(root / true_root - 1))),
        'slide': float(1e3 * np.nanmean(steps[stands])) if stands.any() else np.nan,
    }


def summarise(records: Records) -> list[object]:
    """Return the cells of a row: the means, and the worst view."""
    known = [key for key in MEASURES if key in records[0]]
    means = [f'{np.nanmean([r[key] for r in records]):.3g}' for key in known]
    return [*means, f'{max(r["mpjpe_mm"] for r in records):.0f}', len(records)]


def report_way(report: Report, way: str) -> dict[str, Any]:
    """Measure all views in one of `WAYS`."""
    model, parameters = common.provide_held_out()
    records: list[dict[str, Any]] = []
    for about, view in list_views(report):
        if way == 'whole':
            found = measure(view, common.reconstruct_whole(view, model, parameters))
        else:
            tracked = common.track(view, model, parameters)
            spread = tracked.std, tracked.root_covariance, BODY26
            names = [str(name) for name in view.sequence['joints3d_names']]
            found = measure(view, tracked.joints) | compute_coverage(tracked.joints, *spread, view.truth, names)
        records.append({**about, 'way': way, **found})
    if records:
        header = [MEASURES[key] for key in MEASURES if key in records[0]]
        rows = {('all', mode): rs for (mode,), rs in group(records, 'mode').items()}
        for key in ('range', 'occluder'):
            rows |= group(records, key, 'mode')
        shown = ([*names, *summarise(rs)] for names, rs in rows.items())
        report.table(['views', 'depth', *header, 'worst', 'number'], shown, way, f'depth.{way}')
    return {way: records}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('test', 'train'), default='test')
    parser.add_argument('--views', type=Path, default=common.ROOT / 'build' / 'bodies', metavar='FOLDER')


if __name__ == '__main__':
    sections: dict[str, Callable[[Report], Any]] = {way: partial(report_way, way=way) for way in WAYS}
    run(__doc__, sections, add_options)
