# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What robots get of people: places, velocities, covariances, predictions, and what these cost.

Persons on whom no model was trained, scaled to body heights of 1.5 to 1.95 m, stand 2 to 6 m before a camera that
looks down at them by 5 to 20 degrees, seen with clean points and through three models of detectors. The robot
knows nothing more, their heights, or the floor, whose tilt it has wrong by 0.3 degrees.

Errors of predictions are those of the joints when the place of the root at the time of the image counts as right.
The ratio is that of the mean error over all samples to the better of two others: standing still, and going on with
the velocities that are published.

Bodies are put about the true joints, by stated girths (`experiments/body_volume.py`): of their volume, shares are
in the capsules, as these are published, and when the place of the root counts as right, as the error of that is in
no radius. Inflation is by how much a radius is larger than half the thickness of a heavy adult.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from experiments.body_volume import PARTS, find_inside, sample_body
from experiments.detector_views import choose_trials
from experiments.robot_scenes import RobotScene, look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray
from reconstruction import JOINTS, Models, list_people, provide_held_out
from report import Report, run

from mocap_ros.bridges.capsules import arrange_body_parts, compute_capsules
from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, NodeConfig, with_values
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.skeletons import PredictedFrame
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.people import HIPS, Person3D
from mocap_ros.runtime.outputs import SWITCHED_OUTPUTS, OutputEncoder
from mocap_ros.skeleton import BODY26
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

STATURES_M = 1.5, 1.65, 1.8, 1.95  # of the persons in turn
WAYS = 'nothing', 'height', 'floor'  # what the robot knows besides
KNOWN_HEIGHT_STD_M = 0.02  # of a body height that somebody measured or stated
TIMES_S = 0.2, 0.4, 0.6, 1.0  # of the predictions
GAITS = 'walk', 'run'
MIN_FRAMES = 120  # of a trial
WARM_UP = 15  # frames at the beginning of a trial that are not scored
WITHIN_95 = 7.815  # 1; squared Mahalanobis distance of 95 of 100 in three dimensions
CAPSULE_STEP = 5  # frames between two whose capsules are scored
CAPSULE_VIEW = 'openpose', 3.0  # detector, and distance in m, of the inflation
PEOPLE = 10  # before the camera whose costs are measured
TARGETS = {
    'root_share_height': '0.02', 'root_share_floor': '0.03', 'root_share_nothing': '0.06',
    'velocity_rms_walk': '0.25', 'velocity_rms_general': '0.4', 'velocity_over_differences': '0.33',
    'coverage95_joints': '0.95 within 0.03', 'coverage95_roots': '0.95 within 0.03',
    'coverage95_roots_floor': '0.95 within 0.03', 'coverage95_roots_nothing': '0.95 within 0.03',
    **{f'coverage95_prediction_{t:g}': '0.95 within 0.05' for t in (0.4, 1.0)},
    'prediction_ratio_walk_run': '0.7', 'prediction_ratio_general': '0.9',
    'capsule_inside': '0.95', 'capsule_inflation_mm': '60',
    'cost_defaults_share': '0.1', 'cost_all_share': '0.3',
}  # fmt: skip


def configure(scene: RobotScene, way: str, config: Config) -> Config:
    """Return the parameters of a robot that knows something."""
    if way != 'height':
        return config
    return with_values(
        config, {'tracker.body_height': scene.stature, 'tracker.body_height_std': KNOWN_HEIGHT_STD_M}
    )


def follow(scene: RobotScene, way: str, models: Models, config: Config) -> list[dict[str, Any]]:
    """Return a record of each frame of a scene that is scored."""
    truth, roots = scene.view.true_poses, scene.root
    speeds = np.gradient(truth, 1 / common.FPS, axis=0)
    out: list[dict[str, Any]] = []
    before: Array | None = None
    floor = scene.floor if way == 'floor' else None
    for frame, tracker, person in track_scene(scene, models, configure(scene, way, config), floor):
        joints = person.joints[:JOINTS]
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
            'distance': float(np.linalg.norm(roots[frame])),
            'depth_share': float(np.linalg.norm(person.root) / np.linalg.norm(roots[frame])) - 1,
            'std': person.std[:JOINTS],
            'root_covariance': person.root_covariance,
            'velocity': person.velocity[:JOINTS] - speeds[frame],
            'difference': difference - speeds[frame],
        }
        if way == 'height':
            future = look_ahead(truth, frame, TIMES_S)
            ahead = [people[0] for people in tracker.predict(TIMES_S)]
            record |= {
                'predicted': np.array([p.joints[:JOINTS] for p in ahead]) - future,
                'predicted_std': np.array([p.std[:JOINTS] for p in ahead]),
                'predicted_covariance': np.array([p.root_covariance for p in ahead]),
                'still': joints - future,
                'inside': measure_inside(scene, frame, person) if frame % CAPSULE_STEP == 0 else None,
                'constant': joints + np.array(TIMES_S)[:, None, None] * person.velocity[:JOINTS] - future,
            }
        out.append(record)
    return out


def measure_inside(scene: RobotScene, frame: int, person: Person3D) -> dict[str, tuple[float, float]]:
    """Return the share of each part of the body in the capsules: with the root in its place, and as published."""
    capsules = compute_capsules(person.joints, person.std, person.skeleton)
    off = person.root - scene.root[frame]
    body = sample_body(scene.bodies[frame], scene.stature, np.random.default_rng(frame))
    return {
        name: (find_inside(points + off, capsules).mean(), find_inside(points, capsules).mean())
        for name, points in {**body, 'all': np.concatenate([*body.values()])}.items()
    }


def measure_inflation(trials: Sequence[str], frames: int, models: Models, config: Config) -> Array:
    """Return the inflation (N, P) in mm of the capsules of bodies that `CAPSULE_VIEW` shows."""
    detector, distance = CAPSULE_VIEW
    found = []
    for number, trial in enumerate(trials):
        scene = make_robot_scene(trial, number, frames, STATURES_M[number // 4 % 4], detector, distance)
        for frame, _, person in track_scene(scene, models, configure(scene, 'height', config)):
            if frame >= WARM_UP and not person.predicted:
                parts = arrange_body_parts(person.skeleton)
                radius = compute_capsules(person.joints, person.std, person.skeleton).radius
                found.append((radius - parts.half_thickness) * 1e3)
    return np.array(found)


def score_capsules(
    records: Sequence[Mapping[str, Any]], inflation: Array
) -> tuple[dict[str, float], list[list[object]], list[list[object]]]:
    """Return what is measured of capsules, a row for each part of the body, and a row for each capsule."""
    shares = [r['inside'] for r in records if r['inside'] is not None]
    rows: list[list[object]] = []
    for name in (*PARTS, 'all'):
        right, published = np.mean([s[name] for s in shares], axis=0)
        rows.append([name, f'{right:.3f}', f'{published:.3f}'])
    named: dict[str, list[Array]] = {}
    for name, values in zip(arrange_body_parts(BODY26).names, inflation.T, strict=True):
        named.setdefault(name.removeprefix('l_').removeprefix('r_').replace('_', ' '), []).append(values)
    capsules: list[list[object]] = [[name, f'{np.median(values):.0f}'] for name, values in named.items()]
    quantities = {
        'capsule_inside': float(np.mean([s['all'][0] for s in shares])),
        'capsule_inside_least_part': min(float(str(row[1])) for row in rows),
        'capsule_inside_published': float(np.mean([s['all'][1] for s in shares])),
        'capsule_inflation_mm': float(np.median(inflation)),
    }
    return quantities, rows, capsules


def stack(records: Sequence[Mapping[str, Any]], key: str) -> Array:
    return np.array([r[key] for r in records])


def is_gait(records: Sequence[Mapping[str, Any]]) -> NDArray[np.bool_]:
    return np.array([r['category'] in GAITS for r in records])


def measure_distances(error: Array, covariance: Array) -> Array:
    """Return the squared Mahalanobis distances (...,) of errors (..., 3)."""
    return np.asarray((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1))


def compute_coverage(error: Array, covariance: Array) -> float:
    """Return the share of errors (..., 3) within the ellipsoid of 95 of 100 of their covariances (..., 3, 3)."""
    distance = measure_distances(error, covariance)
    return float((distance[np.isfinite(distance)] <= WITHIN_95).mean())


def compare_with_constant(error: Array, covariance: Array) -> float:
    """Return by how much the mean log-likelihood of errors (N, J, 3) is above that of the best constant ones."""
    constant = np.einsum('nji,njk->jik', error, error) / len(error)
    own = measure_distances(error, covariance) + np.linalg.slogdet(covariance)[1]
    other = measure_distances(error, np.broadcast_to(constant, covariance.shape)) + np.linalg.slogdet(constant)[1]
    return float((other - own).mean() / 2)


def score_places(records: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """Return what is measured of places and velocities."""
    known = records['height']
    out = {f'root_share_{w}': float(np.median(np.abs(stack(records[w], 'depth_share')))) for w in records}
    gait, velocity = is_gait(known), stack(known, 'velocity')
    for name, chosen in (('walk', stack(known, 'category') == 'walk'), ('general', ~gait)):
        if chosen.any():
            out[f'velocity_rms_{name}'] = float(np.sqrt((velocity[chosen] ** 2).sum(axis=-1).mean()))
    difference = np.sqrt((stack(known, 'difference') ** 2).sum(axis=-1).mean())
    out['velocity_over_differences'] = float(np.sqrt((velocity**2).sum(axis=-1).mean()) / difference)
    std, place = stack(known, 'std'), stack(known, 'place')
    own = compute_joint_covariance(std, np.broadcast_to(place[:, None], (*std.shape, 3)))
    joints = stack(known, 'root_covariance')[:, None] + own
    out['coverage95_joints'] = compute_coverage(stack(known, 'joints'), joints)
    for way, key in (('height', ''), ('floor', '_floor'), ('nothing', '_nothing')):
        covariance = stack(records[way], 'root_covariance')
        out[f'coverage95_roots{key}'] = compute_coverage(stack(records[way], 'root'), covariance)
    out['likelihood_joints_over_constant'] = compare_with_constant(stack(known, 'joints'), joints)
    return out


def score_predictions(records: Sequence[Mapping[str, Any]]) -> tuple[dict[str, float], list[list[object]]]:
    """Return what is measured of predictions, and a row of errors in mm for each kind of motion and time."""
    moved = stack(records, 'root')[:, None, None]  # error of the root at the time of the image
    errors = {k: stack(records, k) - moved for k in ('still', 'constant', 'predicted')}
    gait, rows, out = is_gait(records), [], {}
    known = np.asarray(np.isfinite(errors['still']).all(axis=(2, 3)))
    for name, chosen in (('walk_run', gait), ('general', ~gait)):
        for k, time_s in enumerate(TIMES_S):
            use = chosen & known[:, k]
            if not use.any():
                continue
            mean = {n: float(np.linalg.norm(e[use, k], axis=-1).mean() * 1e3) for n, e in errors.items()}
            ratio = mean['predicted'] / min(mean['still'], mean['constant'])
            rows.append([name.replace('_', ', '), time_s, *(f'{m:.0f}' for m in mean.values()), f'{ratio:.2f}'])
            if time_s == 0.4:
                out[f'prediction_ratio_{name}'] = ratio
    std = stack(records, 'predicted_std')
    about = (std**2 / 3)[..., None, None] * np.eye(3)
    covariance = stack(records, 'predicted_covariance')[..., None, :, :] + about
    for k, time_s in enumerate(TIMES_S):
        if time_s in (0.4, 1.0) and known[:, k].any():
            use = known[:, k]
            error = stack(records, 'predicted')[use, k]
            out[f'coverage95_prediction_{time_s:g}'] = compute_coverage(error, covariance[use, k])
            root = (error[:, HIPS[0]] + error[:, HIPS[1]]) / 2
            own = stack(records, 'predicted_covariance')[use, k]
            out[f'coverage95_predicted_root_{time_s:g}'] = compute_coverage(root, own)
    return out, rows


def measure_cost(scene: RobotScene, models: Models, config: Config, frames: int) -> dict[str, float]:
    """Return the time of the outputs for ten people, defaults and all switched on, as a share of the tracker's."""
    every = with_values(config, {f'node.{field}': True for field in SWITCHED_OUTPUTS}).node
    names = [f'person_{i}' for i in range(PEOPLE)]
    detections = [list_people(scene.view, name)[:frames] for name in names]
    tracker, spent = Tracker(models, config), {'tracker': 0.0, 'defaults': 0.0, 'all': 0.0}
    encoders = {'defaults': OutputEncoder(), 'all': OutputEncoder()}
    width = float(scene.view.sequence['image_size'][0])
    for frame in range(frames):
        stamp = round(frame * NS_PER_S / common.FPS) + 1
        seen = [
            replace(people[frame], points=people[frame].points + [place * width, 0])
            for place, people in enumerate(detections)
        ]
        if frame == WARM_UP:  # what is loaded once is no cost
            spent = dict.fromkeys(spent, 0.0)
        begun = time.process_time()
        found = tracker.update(stamp, seen, scene.view.intrinsics)
        tracker.run_deferred_work()
        spent['tracker'] += time.process_time() - begun
        for name, node in (('defaults', NodeConfig()), ('all', every)):
            begun = time.process_time()
            times = TIMES_S if node.publish_predictions else ()  # the pipeline asks for none otherwise
            ahead = [*map(PredictedFrame, times, tracker.predict(times))] if times else []
            encoders[name].encode(Header(stamp, 'camera'), found, node, None, tracker.vertical, ahead)
            spent[name] += time.process_time() - begun
    return {
        'cost_defaults_share': spent['defaults'] / spent['tracker'],
        'cost_all_share': spent['all'] / spent['tracker'],
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--trials', type=int, default=1, metavar='N', help='of each kind of motion and person')
    parser.add_argument('--frames', type=int, default=180, metavar='N', help='of a trial, at 30 Hz')


def measure(args: argparse.Namespace, report: Report) -> None:
    common.choose_capture('motion')
    compile_kernels()
    models, config = provide_held_out()
    trials, frames = choose_trials('held-out', args.trials, MIN_FRAMES), args.frames
    if args.quick:
        trials, frames = trials[::6], 90
    records: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for number, trial in enumerate(common.show_progress(trials, 'trials')):
        scene = make_robot_scene(trial, number, frames, STATURES_M[number // 4 % 4])
        for way in WAYS:
            records[way] += follow(scene, way, models, config)
    quantities = score_places(records)
    predictions, rows = score_predictions(records['height'])
    cost = measure_cost(make_robot_scene(trials[0], 1, frames, 1.7), models, config, min(frames, 60))
    inflation = measure_inflation(trials[:: 1 if args.quick else 3], min(frames, 90), models, config)
    capsules, by_part, by_capsule = score_capsules(records['height'], inflation)
    report.quantities({**quantities, **predictions, **capsules, **cost}, TARGETS, 'robots.quantities')
    header = ['motion', 's ahead', 'standing still, mm', 'constant velocity, mm', 'prediction, mm', 'ratio']
    report.table(header, rows, 'Predictions', page='robots.predictions')
    by_detector = []
    for detector in dict.fromkeys(r['detector'] for r in records['nothing']):
        shares = [stack([r for r in records[w] if r['detector'] == detector], 'depth_share') for w in WAYS]
        by_detector.append([detector, *(f'{np.median(np.abs(s)) * 100:.1f}' for s in shares)])
    report.table(['detector', *WAYS], by_detector, 'Distance, % (median)', page='robots.distances')
    header = ['part', 'inside, root in its place', 'inside as published, height known']
    report.table(header, by_part, 'Share of the volume of bodies in the capsules', page='robots.capsules')
    report.table(
        ['capsule', 'mm'], by_capsule, 'Inflation at 3 m, OpenPose-like (median)', page='robots.inflation'
    )


if __name__ == '__main__':
    run(__doc__, 'For robots', measure, add_options)
