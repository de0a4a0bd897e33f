# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Does a humanoid that follows a person by `examples/humanoid.py` do what the person does?

The views are those of `feet.py`. The robot stands beside one that follows the true motion by the same inverse
kinematics: mean absolute differences (degrees) of the angles of legs and arms and of the pitch of the pelvis, also
of upright people (thighs within 30 degrees of the vertical) and seated ones (beyond 60); the speed of its ankles
while heel and toe of the person stand (mm/s) and the acceleration of its root (m/s^2), with the true ones behind
the slash; p95 of the CPU time of the inverse kinematics (ms). `jitter` are angular accelerations of segments in
recorded detections at 60 Hz, median and RMS (rad/s^2). Needs mink and daqp; `--robot` is an MJCF with the names of
a Unitree G1.
"""

import argparse
from functools import partial
from typing import Any

import common
import feet
import numpy as np
from common import WAYS, View
from numpy.typing import NDArray
from report import Report, Section, group, run
from scipy.spatial.transform import Rotation

import mocap_ros
from mocap_ros.geometry.level import build_world
from mocap_ros.skeleton import BODY26, CMU15, estimate_stature
from mocap_ros.solvers.extremities import SEGMENT_OF, ExtremityEvidence, smooth_extremities

Array = NDArray[np.float64]

TRUE_STD_M = 0.003  # of true joints, from which the true orientations come
LEFT_OUT = 15  # frames at the start of a recording
GROUPS = {'legs': ('_hip', '_knee', '_ankle'), 'arms': ('_shoulder', '_elbow')}  # joints of the robot
ARMS = ('lshoulder', 'lelbow', 'rshoulder', 'relbow')


def find_turns(way: str, view: View, model: Any = 'auto', given: common.Parameters | None = None) -> list[Array]:
    """Return joints (F, 26, 3) m and orientations (F, 26, 4) of one of `WAYS`."""
    if way == 'live':
        live = common.track(view, model, given)
        return [live.joints, live.turns]
    options: dict[str, Any] = {**view.camera, 'model': model, 'parameters': given}
    whole = mocap_ros.reconstruct(view.keypoints, view.joint_names, view.times, **options)
    return [whole.joints, whole.joint_orientation]


def find_true_turns(view: View) -> tuple[Array, Array]:
    joints = np.ascontiguousarray(view.select_truth(BODY26.joints))
    seen = ExtremityEvidence.without_image(np.ascontiguousarray(joints[:, : len(CMU15.joints)]))
    seen = seen._replace(lifted=joints, lifted_std=np.full(joints.shape, TRUE_STD_M))
    found = smooth_extremities(view.times, seen, estimate_stature(seen.core, CMU15))
    return joints, found.quaternions[:, SEGMENT_OF]


def follow(path: str, joints: Array, turns: Array, world: Array) -> dict[str, Array]:
    """Return angles in degrees, root and ankles in m of the robot in all frames, and the times in ms."""
    example = common.load_module(common.ROOT / 'examples' / 'humanoid.py')
    robot, pose, rows, ankles, times = example.Humanoid(path), example.mink.SE3.from_matrix(world), [], [], []
    for frame in zip(joints, turns, strict=True):
        (row, seconds), links = common.measure_time(partial(robot.follow, *frame, pose)), robot.robot.data
        rows.append(row)
        times.append(1e3 * seconds)
        ankles.append([links.body(f'{side}_ankle_roll_link').xpos.copy() for side in ('left', 'right')])
    q = np.array(rows)
    pitch = np.degrees(np.arcsin(-Rotation.from_quat(q[:, 3:7]).as_matrix()[:, 2, 0]))
    found = {'root': q[:, :3], 'ankles': np.array(ankles), 'ms': np.array(times), 'pitch': pitch}
    for name, parts in GROUPS.items():
        found[name] = np.degrees(q[:, 7:][:, [any(p in n for p in parts) for n in robot.joint_names]])
    return found


def measure(path: str, view: View, upward: Array, joints: Array, turns: Array) -> dict[str, Any]:
    """Return what the module's text says, of frames."""
    known = np.isfinite(turns).all(axis=(1, 2))
    truth, true_turns = (a[known] for a in find_true_turns(view))
    world = build_world(truth, upward, None)
    own, true = follow(path, joints[known], turns[known], world), follow(path, truth, true_turns, world)
    out: dict[str, Any] = {g: np.abs(own[g] - true[g]).ravel() for g in (*GROUPS, 'pitch')} | {'ms': own['ms']}
    at = dict(zip(BODY26.joints, np.swapaxes(truth, 0, 1), strict=True))
    thighs = np.array([at[side + 'hip'] - at[side + 'knee'] for side in 'lr'])
    tilts = np.degrees(np.arccos(thighs @ upward / np.linalg.norm(thighs, axis=-1)))
    out |= {'upright': out['pitch'][tilts.max(axis=0) < 30], 'seated': out['pitch'][tilts.min(axis=0) > 60]}
    stand = partial(feet.load_measures().standing, truth, upward)
    stands = np.array([[stand(BODY26.index(side + j)) for j in ('heel', 'toe')] for side in 'lr']).all(axis=1).T
    for name, robot in (('', own), (' true', true)):
        speed = np.linalg.norm(np.diff(robot['ankles'], axis=0)[..., :2], axis=-1) * common.FPS
        out['slide' + name] = 1e3 * speed[stands[1:] & stands[:-1]]
        out['acceleration' + name] = np.linalg.norm(np.diff(robot['root'], 2, axis=0), axis=1) * common.FPS**2
    return out


def report_way(report: Report, way: str) -> None:
    model, parameters = common.provide_held_out()
    records = []
    for about, view, upward in feet.list_views(report):
        floor = {'tracker.vertical': '{} {} {}'.format(*upward), 'tracker.camera_height': about['camera_height']}
        found = find_turns(way, view, model, parameters | (floor if report.args.floor else {}))
        records.append(about | measure(report.args.robot, view, upward, *found))
    rows: list[list[str]] = []
    for name, mine in [*group(records, 'points').items(), *group(records, 'points', 'motion').items()]:
        pooled = {k: np.concatenate([r[k] for r in mine]) for k, v in mine[0].items() if isinstance(v, np.ndarray)}
        mean = {k: f'{v.mean():.1f}' if v.size else '-' for k, v in pooled.items()}
        cells = [mean[k] for k in ('legs', 'arms', 'pitch', 'upright', 'seated')]
        cells += [f'{mean[k]} / {mean[f"{k} true"]}' for k in ('slide', 'acceleration')]
        rows.append([' '.join(name), *cells, f'{np.percentile(pooled["ms"], 95):.1f}'])
    header = ['points', 'legs', 'arms', 'pitch', 'upright', 'seated', 'slide / true', 'acceleration / true', 'ms']
    report.table(header, rows, way)


def report_jitter(report: Report) -> None:
    parts, rows = {'arms': ARMS, 'all': CMU15.joints}, []
    for way in WAYS:
        found = []
        for view in (common.load_recording(d, c) for d in common.RECORDED_DETECTORS for c in common.CAMERAS):
            turns, step_s = find_turns(way, view)[1], float(np.diff(view.times).mean())
            turns = np.swapaxes(turns[np.isfinite(turns).all(axis=(1, 2)), : len(CMU15.joints)], 0, 1)
            spins = [(q[1:] * q[:-1].inv()).as_rotvec() / step_s for q in map(Rotation.from_quat, turns)]
            found.append(np.linalg.norm(np.diff(spins, axis=1), axis=-1)[:, LEFT_OUT:] / step_s)
        pooled = [np.concatenate(found, axis=1)[[CMU15.index(j) for j in p]] for p in parts.values()]
        rows.append([way, *(f'{np.median(p):.0f} / {np.sqrt((p**2).mean()):.0f}' for p in pooled)])
    report.table(['way', *parts], rows, 'jitter, median / RMS')


def add_options(parser: argparse.ArgumentParser) -> None:
    feet.add_options(parser)
    parser.set_defaults(points=['openpose'])
    parser.add_argument('--robot', default=str(common.ROOT / 'tests' / 'data' / 'humanoid.xml'), metavar='FILE')


if __name__ == '__main__':
    sections: dict[str, Section] = {way: partial(report_way, way=way) for way in WAYS}
    run(__doc__, {**sections, 'jitter': report_jitter}, add_options)
