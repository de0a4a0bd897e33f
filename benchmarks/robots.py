# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What robots get of people: places, velocities, covariances, predictions and capsules.

Persons on whom no model was trained, scaled to body heights of 1.5 to 1.95 m, stand 2 to 6 m before a camera that
looks down at them by 5 to 20 degrees, seen with clean points and through three models of detectors. The robot
knows nothing more, their heights, or the floor, whose tilt it has wrong by 0.3 degrees.

Errors of predictions are those of the joints when the place of the root at the time of the image counts as right.
The ratio is that of the mean error over all samples to the better of two others: standing still, and going on with
the velocities that are published. Bodies are put about the true joints, by stated girths (`LIMBS`): of their
volume, shares are in the capsules: as these are published, and without the part of the radii that is the root's
when the place of the root counts as right.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from detected import RobotScene, choose_trials, look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray
from report import Report, run

from mocap_ros.bridges.capsules import compute_capsules
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CORE_COUNT, HIPS

Array = NDArray[np.float64]
Records = Sequence[Mapping[str, Any]]

STATURES_M = 1.5, 1.65, 1.8, 1.95  # of the persons in turn
WAYS = 'nothing', 'height', 'floor'  # what the robot knows besides
KNOWN_HEIGHT_STD_M = 0.02  # of a body height that somebody measured or stated
TIMES_S = 0.2, 0.4, 0.6, 1.0  # of the predictions
GAITS = 'walk', 'run'
MIN_FRAMES, MAX_FRAMES = 120, 180  # of a trial
WARM_UP = 15  # frames at the beginning of a trial that are not scored
WITHIN_95 = 7.815  # 1; squared Mahalanobis distance of 95 of 100 in three dimensions
CAPSULE_STEP = 5  # frames between two whose capsules are scored
TARGETS = {
    'root_share_height': '0.02', 'root_share_floor': '0.03', 'root_share_nothing': '0.06',
    'velocity_rms_walk': '0.25', 'velocity_rms_general': '0.4', 'velocity_over_differences': '0.33',
    'coverage95_joints': '0.95 within 0.03',
    **{f'coverage95_roots{way}': '0.95 within 0.03' for way in ('', '_floor', '_nothing')},
    **{f'coverage95_prediction_{t:g}': '0.95 within 0.05' for t in (0.4, 1.0)},
    'prediction_ratio_walk_run': '0.7', 'prediction_ratio_general': '0.9',
    'capsule_inside': '0.95', 'capsule_inside_published': '0.95',
}  # fmt: skip

WORDS = {  # what the page calls the quantities
    'root_share_nothing': 'median error of the distance, share of it: nothing known',
    'root_share_height': 'the same: height known',
    'root_share_floor': 'the same: floor known',
    'velocity_rms_walk': 'error of the velocity, RMS, m/s: walking',
    'velocity_rms_general': 'the same: neither walking nor running',
    'velocity_over_differences': 'the same: all, over that of differences of positions',
    'coverage95_joints': 'true joints in their ellipsoids of 95 %, share',
    'coverage95_roots': 'true roots likewise: height known',
    'coverage95_roots_floor': 'the same: floor known',
    'coverage95_roots_nothing': 'the same: nothing known',
    'capsule_inside': "share of the body's volume in its capsules, root in its true place",
    'capsule_inside_published': 'the same: as published',
    'prediction_ratio_walk_run': 'error 0.4 s ahead over that of standing still or going on: walking, running',
    'prediction_ratio_general': 'the same: other motion',
    'coverage95_prediction_0.4': 'joints 0.4 s ahead in their ellipsoids of 95 %, share',
    'coverage95_predicted_root_0.4': 'roots 0.4 s ahead likewise',
    'coverage95_prediction_1': 'joints 1 s ahead likewise',
    'coverage95_predicted_root_1': 'roots 1 s ahead likewise',
}

STATURE_M = 1.75  # m; of the body with the girths below, those of an adult of usual weight without clothes
POINTS = 400  # of a body, shared by volume
HEAD_HALF_AXES_M = np.array([0.1, 0.078, 0.115])  # m; forward, to the left, up: a head 0.2 m long and 0.23 m high
HEAD_OVER_EARS_M = 0.02  # m; of the middle of the head
# Each limb: the joints whose middles are its start and its end; m, half axes at the start and at the end, the
# first from left to right of the body where they differ; and how far it reaches beyond start and end, as a share
# of its length. Girths of 0.33 m (upper arm), 0.29 and 0.18 m (forearm, wrist), 0.6 and 0.4 m (thigh, above the
# knee), 0.39 and 0.24 m (calf, ankle) and 0.38 m (neck) are radii of girth / 2 pi; a trunk is 0.34 by 0.24 m at
# the hips and 0.32 by 0.2 m at the shoulders. A hand with half-bent fingers and a foot are 0.16 and 0.26 m long.
LIMBS = (
    (('lhip', 'rhip'), ('lshoulder', 'rshoulder'), ((0.17, 0.12), (0.16, 0.1)), (0.0, 0.0)),
    (('lshoulder', 'rshoulder'), ('lear', 'rear'), ((0.06, 0.06), (0.06, 0.06)), (0.0, 0.0)),
    *(
        ((side + start,), (side + end,), axes, beyond)
        for side in 'lr'
        for start, end, axes, beyond in (
            ('shoulder', 'elbow', ((0.053, 0.053), (0.045, 0.045)), (0.0, 0.0)),
            ('elbow', 'wrist', ((0.046, 0.046), (0.029, 0.029)), (0.0, 0.0)),
            ('wrist', 'hand', ((0.04, 0.03), (0.03, 0.02)), (0.0, 0.6)),
            ('hip', 'knee', ((0.095, 0.095), (0.064, 0.064)), (0.0, 0.0)),
            ('knee', 'ankle', ((0.062, 0.062), (0.038, 0.038)), (0.0, 0.0)),
            ('heel', 'toe', ((0.035, 0.04), (0.045, 0.025)), (0.1, 0.25)),
        )
    ),
)


def follow(scene: RobotScene, way: str, model: PoseModel, parameters: common.Parameters) -> list[dict[str, Any]]:
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
            'std': person.joint_std[:CORE_COUNT],
            'root_covariance': person.root_covariance,
            'velocity': person.joint_velocity[:CORE_COUNT] - speeds[frame],
            'difference': difference - speeds[frame],
        }
        if way == 'height':
            future = look_ahead(truth, frame, TIMES_S)
            ahead = tracker.predict(TIMES_S)
            record |= {
                'predicted': np.array([then.joints[0] for then in ahead]) - future,
                'predicted_std': np.array([then.joint_std[0] for then in ahead]),
                'predicted_covariance': np.array([then.root_covariance[0] for then in ahead]),
                'still': joints - future,
                'constant': joints
                + np.array(TIMES_S)[:, None, None] * person.joint_velocity[:CORE_COUNT]
                - future,
                'inside': measure_inside(scene, frame, person) if frame % CAPSULE_STEP == 0 else None,
            }
        out.append(record)
    return out


def measure_inside(scene: RobotScene, frame: int, person: Person3D) -> tuple[float, float]:
    """Return the share of the body in its capsules: with the root in its place, and as published."""
    body = sample_body(scene.bodies[frame], scene.stature, np.random.default_rng(frame))
    sure = replace(person, root_covariance=np.zeros((3, 3)))
    return find_share(body + person.root - scene.root[frame], sure), find_share(body, person)


def find_share(points: Array, person: Person3D) -> float:
    """Return the share of points (N, 3) m that are in the capsules of a person."""
    spread = person.joint_std, person.root_covariance
    start, end, radius = compute_capsules(person.joints, *spread, person.skeleton)
    axis = end - start
    along = np.einsum('npk,pk->np', points[:, None] - start, axis) / np.maximum((axis**2).sum(axis=1), 1e-12)
    nearest = start + along.clip(0, 1)[..., None] * axis
    return float((np.linalg.norm(points[:, None] - nearest, axis=2) <= radius).any(axis=1).mean())


def sample_body(joints: Array, stature: float, rng: np.random.Generator) -> Array:
    """Return points (N, 3) m in the volume of a body of the true joints (26, 3) m and stature in m."""
    size, at = stature / STATURE_M, dict(zip(BODY26.joints, joints, strict=True))
    left = at['lhip'] - at['rhip'] + at['lshoulder'] - at['rshoulder']
    cones, volumes = [], []
    for start, end, axes, (before, beyond) in LIMBS:
        p, q = (np.mean([at[name] for name in ends], axis=0) for ends in (start, end))
        p, q = p - before * (q - p), q + beyond * (q - p)
        half = np.array(axes) * size
        cones.append((p, q, half))
        volumes.append(float(np.linalg.norm(q - p) * np.pi * half.prod(axis=1).mean()))
    head = HEAD_HALF_AXES_M * size
    volumes.append(float(4 / 3 * np.pi * head.prod()))
    counts = np.maximum(np.round(np.array(volumes) / sum(volumes) * POINTS), 1).astype(int).tolist()
    found = [_sample_cone(*cone, left, count, rng) for cone, count in zip(cones, counts[:-1], strict=True)]
    ears = (at['lear'] + at['rear']) / 2
    forward, side = at['nose'] - ears, at['lear'] - at['rear']
    frame = np.stack([_unit(forward), _unit(np.cross(np.cross(forward, side), forward)), np.zeros(3)])
    frame[2] = np.cross(frame[0], frame[1])
    inside = rng.normal(size=(counts[-1], 3))
    inside *= (rng.random(len(inside)) ** (1 / 3) / np.linalg.norm(inside, axis=1))[:, None]
    return np.concatenate([*found, ears + (inside * head + [0, 0, HEAD_OVER_EARS_M * size]) @ frame])


def _sample_cone(p: Array, q: Array, axes: Array, left: Array, count: int, rng: np.random.Generator) -> Array:
    """Return points (count, 3) in an elliptic cone from p to q (3,) with half axes a, b (2,) at either end.

    They are p + s (q - p) + sqrt(u) (a(s) cos w e_1 + b(s) sin w e_2), with s of the
    density a(s) b(s), u and w uniform.
    """
    way = rng.random(8 * count)
    area = (axes[0] + way[:, None] * (axes[1] - axes[0])).prod(axis=1)
    way = rng.choice(way, count, p=area / area.sum())
    half = axes[0] + way[:, None] * (axes[1] - axes[0])
    along = _unit(q - p)
    first = _unit(left - (left @ along) * along)
    angle, radius = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.random(count))
    across = (radius * np.cos(angle) * half[:, 0])[:, None] * first
    across += (radius * np.sin(angle) * half[:, 1])[:, None] * np.cross(along, first)
    return np.asarray(p + way[:, None] * (q - p) + across)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def stack(records: Records, key: str) -> Array:
    return np.array([r[key] for r in records])


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
    for name, chosen in (
        ('walk', stack(known, 'category') == 'walk'),
        ('general', ~np.isin(stack(known, 'category'), GAITS)),
    ):
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
    gait, out = np.isin(stack(records, 'category'), GAITS), dict[str, float]()
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
    trials = choose_trials('held-out', 1, MIN_FRAMES)[:: 6 if report.quick else 1]
    frames = 90 if report.quick else MAX_FRAMES
    records: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for number, trial in enumerate(common.show_progress(trials, 'trials')):
        scene = make_robot_scene(trial, number, frames, STATURES_M[number // 4 % 4])
        for way in WAYS:
            records[way] += follow(scene, way, model, parameters)
    predictions, rows = score_predictions(records['height'])
    report.quantities({**score_places(records), **predictions}, TARGETS, 'robots.quantities', WORDS)
    header = ['motion', 's ahead', 'standing still, mm', 'constant velocity, mm', 'prediction, mm', 'ratio']
    report.table(header, rows, 'Predictions', 'robots.predictions')
    by_detector = []
    for detector in dict.fromkeys(r['detector'] for r in records['nothing']):
        shares = [stack([r for r in records[w] if r['detector'] == detector], 'depth_share') for w in WAYS]
        by_detector.append([detector, *(f'{np.median(np.abs(s)) * 100:.1f}' for s in shares)])
    report.table(['detector', *WAYS], by_detector, 'Distance, % (median)', 'robots.distances')


if __name__ == '__main__':
    run(__doc__, {'people': report_people})
