# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What robots get of people: places, velocities, covariances, predictions and capsules.

Persons on whom no model was trained, scaled to body heights of 1.5 to 1.95 m, stand 2 to 6 m before a camera that
looks down at them by 5 to 20 degrees, seen with clean points and through three models of detectors. The robot
knows nothing more, their heights, or the floor, whose tilt it has wrong by 0.3 degrees.

Errors of predictions are those of the joints when the place of the root at the time of the image counts as right.
The ratio is that of the mean error over all samples to the better of two others: standing still, and going on with
the velocities that are published. Bodies are put about the true joints, by stated girths (`bodies.py`): of their
volume, shares are in the capsules, as these are published, and when the place of the root counts as right.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

import common
import numpy as np
from bodies import sample_body
from detected import RobotScene, choose_trials, look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray
from report import Report, run

from mocap_ros.bridges.capsules import compute_capsules
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.people import HIPS, Person3D
from mocap_ros.skeleton import CORE_COUNT

Array = NDArray[np.float64]
Records = Sequence[Mapping[str, Any]]

STATURES_M = 1.5, 1.65, 1.8, 1.95  # of the persons in turn
WAYS = 'nothing', 'height', 'floor'  # what the robot knows besides
KNOWN_HEIGHT_STD_M = 0.02  # of a body height that somebody measured or stated
TIMES_S = 0.2, 0.4, 0.6, 1.0  # of the predictions
GAITS = 'walk', 'run'
MIN_FRAMES = 120  # of a trial
WARM_UP = 15  # frames at the beginning of a trial that are not scored
WITHIN_95 = 7.815  # 1; squared Mahalanobis distance of 95 of 100 in three dimensions
CAPSULE_STEP = 5  # frames between two whose capsules are scored
TARGETS = {
    'root_share_height': '0.02', 'root_share_floor': '0.03', 'root_share_nothing': '0.06',
    'velocity_rms_walk': '0.25', 'velocity_rms_general': '0.4', 'velocity_over_differences': '0.33',
    'coverage95_joints': '0.95 within 0.03',
    **{f'coverage95_roots{way}': '0.95 within 0.03' for way in ('', '_floor', '_nothing')},
    **{f'coverage95_prediction_{t:g}': '0.95 within 0.05' for t in (0.4, 1.0)},
    'prediction_ratio_walk_run': '0.7', 'prediction_ratio_general': '0.9', 'capsule_inside': '0.95',
}  # fmt: skip


def follow(scene: RobotScene, way: str, model: BasePoses, parameters: common.Parameters) -> list[dict[str, Any]]:
    """Return a record of each frame of a scene that is scored."""
    if way == 'height':
        known = {'tracker.body_height': scene.stature, 'tracker.body_height_std': KNOWN_HEIGHT_STD_M}
        parameters = {**parameters, **known}
    truth, roots = scene.view.true_poses, scene.root
    speeds = np.gradient(truth, 1 / common.FPS, axis=0)
    out: list[dict[str, Any]] = []
    before: Array | None = None
    floor = scene.floor if way == 'floor' else None
    for frame, tracker, person in track_scene(scene, model, parameters, floor):
        joints = person.joints[:CORE_COUNT]
        difference = None if before is None else (joints - before) * common.FPS
        before = joints
        if frame < WARM_UP or person.predicted or difference is None or frame + 1 == len(truth):
            continue
        record = {
            'category': scene.category,
            'detector': scene.detector,
            'joints': joints - truth[frame],
            'place': person.root,
            'root': person.root - roots[frame],
            'depth_share': float(np.linalg.norm(person.root) / np.linalg.norm(roots[frame])) - 1,
            'std': person.std[:CORE_COUNT],
            'root_covariance': person.root_covariance,
            'velocity': person.velocity[:CORE_COUNT] - speeds[frame],
            'difference': difference - speeds[frame],
        }
        if way == 'height':
            future = look_ahead(truth, frame, TIMES_S)
            ahead = [people[0] for people in tracker.predict(TIMES_S)]
            record |= {
                'predicted': np.array([p.joints[:CORE_COUNT] for p in ahead]) - future,
                'predicted_std': np.array([p.std[:CORE_COUNT] for p in ahead]),
                'predicted_covariance': np.array([p.root_covariance for p in ahead]),
                'still': joints - future,
                'constant': joints + np.array(TIMES_S)[:, None, None] * person.velocity[:CORE_COUNT] - future,
                'inside': measure_inside(scene, frame, person) if frame % CAPSULE_STEP == 0 else None,
            }
        out.append(record)
    return out


def measure_inside(scene: RobotScene, frame: int, person: Person3D) -> tuple[float, float]:
    """Return the share of the body in its capsules: with the root in its place, and as published."""
    start, end, radius = compute_capsules(person.joints, person.std, person.skeleton)
    axis = end - start

    def find_share(points: Array) -> float:
        along = np.einsum('npk,pk->np', points[:, None] - start, axis) / np.maximum((axis**2).sum(axis=1), 1e-12)
        nearest = start + along.clip(0, 1)[..., None] * axis
        return float((np.linalg.norm(points[:, None] - nearest, axis=2) <= radius).any(axis=1).mean())

    body = sample_body(scene.bodies[frame], scene.stature, np.random.default_rng(frame))
    return find_share(body + person.root - scene.root[frame]), find_share(body)


def stack(records: Records, key: str) -> Array:
    return np.array([r[key] for r in records])


def is_gait(records: Records) -> NDArray[np.bool_]:
    return np.array([r['category'] in GAITS for r in records])


def compute_coverage(error: Array, covariance: Array) -> float:
    """Return the share of errors (..., 3) within the ellipsoid of 95 of 100 of their covariances (..., 3, 3)."""
    distance = (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1)
    return float((distance[np.isfinite(distance)] <= WITHIN_95).mean())


def compute_rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=-1).mean()))


def score_places(records: Mapping[str, Records]) -> dict[str, float]:
    """Return what is measured of places, velocities and capsules."""
    known = records['height']
    out = {f'root_share_{w}': float(np.median(np.abs(stack(records[w], 'depth_share')))) for w in records}
    velocity = stack(known, 'velocity')
    for name, chosen in (('walk', stack(known, 'category') == 'walk'), ('general', ~is_gait(known))):
        if chosen.any():
            out[f'velocity_rms_{name}'] = compute_rms(velocity[chosen])
    out['velocity_over_differences'] = compute_rms(velocity) / compute_rms(stack(known, 'difference'))
    std, place = stack(known, 'std'), stack(known, 'place')
    own = compute_joint_covariance(std, np.broadcast_to(place[:, None], (*std.shape, 3)))
    joints = stack(known, 'root_covariance')[:, None] + own
    out['coverage95_joints'] = compute_coverage(stack(known, 'joints'), joints)
    for way, key in (('height', ''), ('floor', '_floor'), ('nothing', '_nothing')):
        covariance = stack(records[way], 'root_covariance')
        out[f'coverage95_roots{key}'] = compute_coverage(stack(records[way], 'root'), covariance)
    inside, published = np.mean([r['inside'] for r in known if r['inside'] is not None], axis=0)
    return out | {'capsule_inside': float(inside), 'capsule_inside_published': float(published)}


def score_predictions(records: Records) -> tuple[dict[str, float], list[list[object]]]:
    """Return what is measured of predictions, and a row of errors in mm for each kind of motion and time."""
    moved = stack(records, 'root')[:, None, None]  # error of the root at the time of the image
    errors = {k: stack(records, k) - moved for k in ('still', 'constant', 'predicted')}
    gait, out = is_gait(records), dict[str, float]()
    rows: list[list[object]] = []
    known = np.asarray(np.isfinite(errors['still']).all(axis=(2, 3)))
    for name, chosen in (('walk_run', gait), ('general', ~gait)):
        for k, time_s in enumerate(TIMES_S):
            if (use := chosen & known[:, k]).any():
                mean = {n: float(np.linalg.norm(e[use, k], axis=-1).mean() * 1e3) for n, e in errors.items()}
                ratio = mean['predicted'] / min(mean['still'], mean['constant'])
                shown = (f'{m:.0f}' for m in mean.values())
                rows.append([name.replace('_', ', '), time_s, *shown, f'{ratio:.2f}'])
                if time_s == 0.4:
                    out[f'prediction_ratio_{name}'] = ratio
    about = (stack(records, 'predicted_std') ** 2 / 3)[..., None, None] * np.eye(3)
    roots = stack(records, 'predicted_covariance')
    for k, time_s in enumerate(TIMES_S):
        if time_s in (0.4, 1.0) and (use := known[:, k]).any():
            error = stack(records, 'predicted')[use, k]
            covariance = roots[use, k, None] + about[use, k]
            out[f'coverage95_prediction_{time_s:g}'] = compute_coverage(error, covariance)
            root = (error[:, HIPS[0]] + error[:, HIPS[1]]) / 2
            out[f'coverage95_predicted_root_{time_s:g}'] = compute_coverage(root, roots[use, k])
    return out, rows


def report_people(report: Report) -> None:
    model, parameters = common.provide_held_out()
    trials, frames = choose_trials('held-out', report.args.trials, MIN_FRAMES), report.args.frames
    if report.quick:
        trials, frames = trials[::6], 90
    records: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for number, trial in enumerate(common.show_progress(trials, 'trials')):
        scene = make_robot_scene(trial, number, frames, STATURES_M[number // 4 % 4])
        for way in WAYS:
            records[way] += follow(scene, way, model, parameters)
    predictions, rows = score_predictions(records['height'])
    report.quantities({**score_places(records), **predictions}, TARGETS, 'robots.quantities')
    header = ['motion', 's ahead', 'standing still, mm', 'constant velocity, mm', 'prediction, mm', 'ratio']
    report.table(header, rows, 'Predictions', 'robots.predictions')
    by_detector = []
    for detector in dict.fromkeys(r['detector'] for r in records['nothing']):
        shares = [stack([r for r in records[w] if r['detector'] == detector], 'depth_share') for w in WAYS]
        by_detector.append([detector, *(f'{np.median(np.abs(s)) * 100:.1f}' for s in shares)])
    report.table(['detector', *WAYS], by_detector, 'Distance, % (median)', 'robots.distances')


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--trials', type=int, default=1, metavar='N', help='of each kind of motion and person')
    parser.add_argument('--frames', type=int, default=180, metavar='N', help='of a trial, at 30 Hz')


if __name__ == '__main__':
    run(__doc__, {'people': report_people}, add_options)
