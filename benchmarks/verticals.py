# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vertical that people show: how far it is off, and whether its standard deviation says so.

One person before a camera 4 m away that looks down by -10 to 30 degrees, in 4 s of a trial, seen from three sides
through three models of detectors, with and without the calibration. `lean` is by how much farther down the camera
seems to look than it does; errors and deviations are those of the middle frame, in degrees. `--persons training`
has the people whom the constants may be fitted on.
"""

import argparse
from collections.abc import Sequence
from itertools import product
from typing import Any

import common
import numpy as np
from common import View
from detected import choose_trials, load_middle, load_motion
from report import Records, Report, group, run

from mocap_ros.config import Config
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.models.upward_direction import Stances
from mocap_ros.offline.whole_sequence import choose_vertical
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import RAY_FOCAL, observe_sequence, sample_unlifted_histories

PITCHES_DEG = -10.0, 0.0, 10.0, 20.0, 30.0
HEADINGS_DEG = {'front': 0.0, 'side': 90.0, 'back': 180.0}
HEADING_RANGE_DEG = 20.0  # degrees, about each of these, drawn evenly
SEEN_BY = 'clean', 'openpose', 'mediapipe'
DISTANCE_M, FRAMES = 4.0, 120
POSTURES = {'stands': 0.9, 'partly stands': 0.1, 'hardly stands': 0.0}  # least share of the time, 1
TRIALS = 8  # drawn for each seed, of the longest of each person and motion
SEEDS = 1, 2, 3


def measure(trial: str, heading: float, pitch: float, detector: str, seed: int) -> Records:
    """Return a record of a view with, and one without the calibration."""
    joints = load_motion()[1]
    options: dict[str, Any] = {'frames': FRAMES, 'seed': seed, 'distance': DISTANCE_M}
    if detector != 'clean':
        options['detector'] = detector
    protocol = common.load_protocol()
    view = View(protocol.make_view(load_middle(trial, FRAMES), joints, heading, pitch, **options), heading)
    standing = float(Stances.of(view.true_poses).standing.mean())
    posture = next(name for name, share in POSTURES.items() if standing >= share)
    truth = protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, pitch)[0]
    records = []
    for is_calibrated in (True, False):
        matrix = view.camera['camera_matrix'] if is_calibrated else None
        found, std = find(view, matrix)
        error = float(np.degrees(np.arccos(np.clip(found @ truth, -1, 1))))
        lean = float(np.degrees(np.arctan2(-found[2], -found[1]))) - pitch
        about = {
            'calibrated': is_calibrated,
            'detector': detector,
            'pitch': pitch,
            'posture': posture,
        }
        records.append({**about, 'lean': lean, 'error': error, 'deviation': float(np.degrees(std))})
    return records


def find(view: View, camera_matrix: Any) -> tuple[Any, float]:
    """Return the vertical (3,) of the middle frame, and its standard deviation in rad, by the lifted poses."""
    config, lifter = Config().tracker, load_prior_lifter(str(common.HELD_OUT_LIFTER), CMU15)
    assert lifter is not None
    keypoints, size = view.keypoints, view.camera['image_size']
    sequence = KeypointSequence(keypoints, view.joint_names, view.times, size, camera_matrix)
    observed = observe_sequence(sequence, config)
    points, weight, cameras = sample_unlifted_histories([observed])
    joints = lifter.lift(points, weight, RAY_FOCAL).joints @ cameras
    verticals = choose_vertical(observed, joints, weight.max(axis=1), config)
    middle = len(view.times) // 2
    return verticals.direction[middle], float(verticals.std[middle])


def summarise(records: Records, keys: Sequence[str]) -> Records:
    """Return a row for each value of the keys."""
    rows = []
    for values, members in group(records, *keys).items():
        error, std, lean = (np.array([r[k] for r in members]) for k in ('error', 'deviation', 'lean'))
        found = {'views': len(members), 'lean': lean.mean(), 'error': error.mean(), 'deviation': std.mean()}
        shares = {f'within {n}': f'{100 * (error <= n * std).mean():.0f} %' for n in (1, 2, 4)}
        shown = {k: v if isinstance(v, int) else f'{v:.1f}' for k, v in found.items()}
        rows.append({**dict(zip(keys, values, strict=True)), **shown, **shares})
    return rows


def measure_verticals(report: Report) -> None:
    """Print the tables by posture, and of those who stand by detector and side."""
    records: list[Any] = []
    for seed in report.args.seeds:
        rng = np.random.default_rng(seed)
        trials = rng.permutation(choose_trials(report.args.persons, 1, FRAMES // 2))
        chosen = trials[: 2 if report.quick else TRIALS].tolist()
        for trial, pitch, (side, heading), detector in product(chosen, PITCHES_DEG, HEADINGS_DEG.items(), SEEN_BY):
            turned = heading + float(rng.uniform(-HEADING_RANGE_DEG, HEADING_RANGE_DEG))
            records += [{'side': side, **r} for r in measure(trial, turned, pitch, detector, seed)]
    report.rows('all', summarise(records, ('posture', 'calibrated', 'pitch')))
    standing = [r for r in records if r['posture'] == 'stands']
    report.rows('people who stand', summarise(standing, ('calibrated', 'detector', 'side', 'pitch')))
    report.results['all'] = summarise(records, ('posture', 'calibrated'))


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--seeds', nargs='+', type=int, metavar='N', default=list(SEEDS))


if __name__ == '__main__':
    run(__doc__, {'verticals': measure_verticals}, add_options)
