# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The tracker: what the newest frame costs against whole sequences, and whether its deviations are right.

It is measured on subjects on which neither the base poses nor the lifter were trained. Sections of `--only`:

    lags         MPJPE of the newest frame, of frames that are answered later, and of whole sequences
    reliability  share of true errors within the predicted standard deviation, for seen and for hidden joints
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray
from report import Report, group, run

from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

LAG_TRIALS = {
    '35_02': 'walk',
    '35_12': 'walk',
    '35_17': 'run',
    '35_22': 'run',
    '13_11': 'jump',
    '13_32': 'jump',
}
LAGS_S = (0.0, 0.1, 0.5)
# Trials of which none served to choose the factors of the deviations.
RELIABILITY_TRIALS = ('35_20', '35_23', 'UW_22', '13_19x', 'UT_01', 'UWW_01', '135_04', '135_08')
HIDDEN_LIMBS = ((), ('lelbow', 'lwrist'), ('rknee', 'rankle'))
NOISES = (0.0, 0.01, 0.02)  # option `noise` of the protocol
START_FRAMES = 15  # that do not count for deviations


def report_lags(report: Report) -> None:
    model, parameters = common.provide_held_out()
    trials = list(LAG_TRIALS.items())[:: 2 if report.quick else 1]
    rows: list[dict[str, Any]] = []
    for trial, category in common.show_progress(trials, 'lags'):
        views = common.make_views(trial, (45,) if report.quick else common.HEADINGS_DEG)
        found = {'whole': [common.reconstruct_whole(v, model, parameters) for v in views]}
        for lag in LAGS_S:
            found[f'lag {lag:g} s'] = [
                common.track(v, model, {**parameters, 'tracker.lag': lag}).joints for v in views
            ]
        errors = {way: common.mean_error(common.compute_all_errors(views, f)) for way, f in found.items()}
        ratio = errors['lag 0 s'] / errors['whole']
        rows.append({'trial': f'{trial} {category}', **errors, 'lag 0 s / whole': ratio})
    report.rows('Newest frame and whole sequences, clean points: MPJPE, mm', rows, 'tracker.lags')


def report_reliability(report: Report) -> None:
    model, parameters = common.provide_held_out()
    trials, noises = RELIABILITY_TRIALS[:: 4 if report.quick else 1], NOISES[:: 2 if report.quick else 1]
    records: list[dict[str, Any]] = []
    for number, trial in enumerate(common.show_progress(trials, 'reliability')):
        for noise in noises:
            for view in common.make_views(
                trial, [h + 37 * number for h in ((20,) if report.quick else (20, 200))], frames=100, noise=noise
            ):
                for limb in HIDDEN_LIMBS:
                    found = common.track(view.hide_joints(limb), model, parameters)
                    core = slice(len(CMU15.joints))
                    pose, truth = common.align_scale(found.joints[:, core], view.true_poses)
                    wrong, std, inferred = (
                        np.linalg.norm(pose - truth, axis=-1),
                        found.std[:, core],
                        found.inferred[:, core],
                    )
                    for label, chosen in (('seen', ~inferred), ('hidden', inferred)):
                        late = chosen & (np.arange(view.frames) >= START_FRAMES)[:, None]
                        pair = np.stack([std[late], wrong[late]])
                        records.append({'joints': label, 'noise': f'noise {noise:g}', 'pair': pair})

    def compute_share(some: Sequence[Any]) -> str:
        std, wrong = np.concatenate([r['pair'] for r in some], axis=1)
        return f'{(wrong <= std).mean():.2f}'

    rows = []
    for (label,), mine in group(records, 'joints').items():
        by_noise = {noise: compute_share(some) for (noise,), some in group(mine, 'noise').items()}
        rows.append({'joints': label, 'all': compute_share(mine), **by_noise})
    report.rows('Share of the errors within the predicted standard deviation', rows, 'tracker.reliability')


if __name__ == '__main__':
    run(__doc__, {'lags': report_lags, 'reliability': report_reliability})
