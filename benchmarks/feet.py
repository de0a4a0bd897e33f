# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Do standing feet stand, and is the root where it is?

Motion capture of people on whom no model was trained, seen by a fixed camera with known intrinsics, 4 m from the
nearest point and 10 degrees above, with clean points and as detectors give them; whole sequences and live. The
measures are those of `bench/feet.py`: the slide of heels and toes that stand in truth (horizontal, mm a frame of
1/30 s), the root after one rigid alignment (ATE, mm), its displacement over 1 s (mm), its velocity (rms, mm/s; and
along the line of sight), where it is (mm), angles of knees and hips (rms degrees), and MPJPE with PA (mm). People
who walk are also seen by a camera that shakes and goes around them; they are measured in its first frame,
by its true motion, and are in no mean. `--persons training` tests other people, for tuning; with `--floor` the
vertical and the camera's height are given.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from types import ModuleType
from typing import Any

import common
import numpy as np
from common import WAYS, View
from detected import CLEAN, DETECTORS, HEADING_STEP_DEG, choose_trials, load_middle, load_motion
from numpy.typing import NDArray
from report import Records, Report, cross, group, run

from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.skeleton import BODY26, CMU15

Array = NDArray[np.float64]

POINTS = (CLEAN, 'openpose', 'mediapipe')
DISTANCE_M, ELEVATION_DEG = 4.0, 10.0
FRAMES, MIN_FRAMES = 240, 40  # of a view, and of its trial
TRIALS = 6  # of a kind of motion; a third with `--quick`
# Kinds of motion, and the categories of the motion capture that show them.
MOTIONS = {
    'walk': ('walk', 'styled_walk', 'turn', 'walk_uneven'),
    'run': ('run', 'run_jump_over'),
    'jump': ('jump', 'reach_jump'),
    'sit': ('sit_stand', 'sit_stand_walk', 'squat'),
    'gestures': ('gesture', 'household', 'expression', 'arm_raise'),
    'other': ('dance', 'martial_arts', 'lunge', 'step_over'),
}
MOVING = 'walk, moving camera'
CAMERA_MOTION = {'orbit': 10.0, 'shake': 1.0}  # degrees/s around the person, and degrees
ROOT = ('ate', 'displacement 1 s', 'velocity', 'velocity along sight', 'absolute')
POSE = ('knee', 'hip', 'mpjpe', 'pa')
FEET = [BODY26.index(n) for n in ('lheel', 'ltoe', 'rheel', 'rtoe')]
ANGLES = {
    'knee': (('lhip', 'lknee', 'lankle'), ('rhip', 'rknee', 'rankle')),
    'hip': (('neck', 'lhip', 'lknee'), ('neck', 'rhip', 'rknee')),
}


def load_measures() -> ModuleType:
    """Load bench/feet.py of the evaluation data."""
    return common.load_module(common.data_path('bench', 'feet.py'))


def list_trials(persons: str, count: int) -> list[tuple[str, str]]:
    """Return kinds of motion and the longest trials of them, of different people where there are."""
    found, rows = [], load_motion()[2]
    for motion, categories in MOTIONS.items():
        own = [rows[t] for t in choose_trials(persons, 999, MIN_FRAMES) if rows[t]['category'] in categories]
        by_person = group(sorted(own, key=lambda r: -int(r['frames'])), 'subject').values()
        ranks = sorted((rank, -int(r['frames']), r['trial']) for mine in by_person for rank, r in enumerate(mine))
        found += [(motion, trial) for *_, trial in ranks[:count]]
    return [*found, *((MOVING, trial) for motion, trial in found if motion == 'walk')]


def list_views(report: Report) -> Iterator[tuple[dict[str, Any], View, Array]]:
    """Yield each view with what is known of it, and the direction upwards in its first camera."""
    protocol, names = common.load_protocol(), load_motion()[1]
    trials = list_trials(report.args.persons, TRIALS // 3 if report.quick else TRIALS)
    for number, (motion, trial) in common.show_progress(list(enumerate(trials)), 'trials'):
        heading = number * HEADING_STEP_DEG % 360
        upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, ELEVATION_DEG)[0]
        for points in report.args.points:
            options: dict[str, Any] = {'frames': FRAMES, 'distance': DISTANCE_M}
            options |= {} if points == CLEAN else {'detector': points}
            options |= CAMERA_MOTION if motion == MOVING else {}
            poses = load_middle(trial, FRAMES)
            view = View(protocol.make_view(poses, names, heading, ELEVATION_DEG, **options), heading)
            height = float(poses[0, 0, 1] * 1e-3 - view.truth[0, 0] @ upward)  # the floor of the capture is at 0
            if motion == MOVING:  # true directions of the first camera, in which these views are measured
                upward = fit_rotation(centre_poses(poses), centre_poses(view.truth))[0] @ [0.0, 1.0, 0.0]
            yield {'motion': motion, 'trial': trial, 'points': points, 'camera_height': height}, view, upward


def hold_camera(view: View, about: dict[str, Any], joints: Array) -> Array:
    """Return joints (F, J, 3) m of each frame in the camera of the first one, by the true motion of the camera."""
    poses = load_middle(about['trial'], FRAMES) * 1e-3
    turns = fit_rotation(centre_poses(poses), centre_poses(view.truth))
    middles = view.truth.mean(axis=1, keepdims=True)
    in_capture = (joints - middles) @ turns + poses.mean(axis=1, keepdims=True)
    return np.asarray((in_capture - poses[0].mean(axis=0)) @ turns[0].T + middles[0])


def find_angles(joints: Array, triples: tuple[tuple[str, str, str], ...]) -> Array:
    """Return the angles (F, 2) in degrees at the middle joints."""
    at = [[joints[:, BODY26.index(n)] for n in triple] for triple in triples]
    sides = [[(p - b) / np.linalg.norm(p - b, axis=-1, keepdims=True) for p in (a, c)] for a, b, c in at]
    return np.stack([np.degrees(np.arccos(np.clip((u * v).sum(axis=-1), -1, 1))) for u, v in sides], axis=1)


def measure(view: View, about: dict[str, Any], joints: Array, upward: Array) -> dict[str, Any]:
    """Return all measures of joints (F, 26, 3) m, and the slides of each pair of frames."""
    measures, truth, seen = load_measures(), view.select_truth(BODY26.joints), joints
    if about['motion'] == MOVING:
        joints, truth = (hold_camera(view, about, poses) for poses in (joints, truth))
    slides = [measures.slide(p, truth, upward, FEET).tolist() for p in (joints, truth)]
    out = {'slides': slides[0], 'true slides': slides[1]}
    out |= measures.root_errors(joints, truth, CMU15.index('pelvis'))
    for name, triples in ANGLES.items():
        out[name] = float(np.sqrt(np.nanmean((find_angles(joints, triples) - find_angles(truth, triples)) ** 2)))
    errors = common.compute_errors(view, seen[:, : len(CMU15.joints)], CMU15.joints, 'body15')
    return out | {'mpjpe': errors['mpjpe_mm'], 'pa': errors['pa_mpjpe_mm']}


def summarise(records: Records) -> list[str]:
    """Return the cells of a row: slides over all frames, all else the mean over the views."""
    pooled = [np.concatenate([r[k] for r in records]) for k in ('slides', 'true slides')]
    slide = ' / '.join(f'{s.mean():.1f}' if len(s) else '-' for s in pooled)
    mean = {k: np.mean([r[k] for r in records if k in r]) for k in (*ROOT, *POSE)}
    return [slide, *(f'{mean[k]:.0f}' for k in ROOT), *(f'{mean[k]:.1f}' for k in POSE)]


def summarise_briefly(records: Records) -> str:
    slide, ate, second, *_ = summarise(records)
    return f'{slide.split()[0]}/{ate}/{second}'


def report_way(report: Report, way: str) -> dict[str, Any]:
    model, parameters = common.provide_held_out()
    records = []
    for about, view, upward in list_views(report):
        floor = {'tracker.camera_height': about['camera_height'], 'tracker.vertical': '{} {} {}'.format(*upward)}
        joints = common.reconstruct(way, view, model, parameters | (floor if report.args.floor else {}))
        records.append({**about, 'way': way, **measure(view, about, joints, upward)})
    header = ['slide / true', *ROOT, *POSE]
    by_points = group([r for r in records if r['motion'] != MOVING], 'points')
    report.table(['points', *header], ([*k, *summarise(r)] for k, r in by_points.items()), way)
    by_motion = sorted(group(records, 'motion', 'points').items(), key=lambda item: DETECTORS.index(item[0][1]))
    report.table(['motion', 'points', *header], ([*k, *summarise(r)] for k, r in by_motion), f'{way}, by motion')
    report.results[way] = records
    shown = [r | {'column': f'{w}, {r["points"]}-like'} for w in WAYS for r in report.results.get(w, ())]
    total = [r | {'motion': 'all, fixed camera'} for r in shown if r['motion'] != MOVING]
    shown = [r for r in (*shown, *total) if r['points'] != CLEAN and r['motion'] != 'other']
    report.table(*cross(shown, 'motion', 'column', summarise_briefly), page='feet.motions')
    return {way: records}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--floor', action='store_true')
    parser.add_argument('--points', nargs='+', choices=DETECTORS, default=list(POINTS))


if __name__ == '__main__':
    sections: dict[str, Callable[[Report], Any]] = {way: partial(report_way, way=way) for way in WAYS}
    run(__doc__, sections, add_options)
