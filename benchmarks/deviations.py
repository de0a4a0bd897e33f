# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether deviations hold in every row: true joints and roots in their ellipsoids, by posture, detector, distance.

People of statures as they are assumed, on whom no model was trained (`--persons train`: those on whom the factors
of the deviations were chosen), stand, walk, sit, are on the floor, or are seen without their legs (every second
without hips), 2 to 3.5 m (near) and 3.5 to 6 m (far) before a camera that looks down by 5 to 20 degrees, as three
models of detectors see them. Postures that the motion capture lacks are made from it (`training/postures.py`).
Measured live, half with the height known to 2 cm and half with none: the shares of seen and inferred joints about
the body's middle in the ellipsoids of 90 % of `joint_std`, and of roots in those of `root_covariance`; the
share of a body's volume in its capsules, which should hold 95 %; the shares of verticals and of bodies' directions
within 90 % of theirs, and how often feet stand of which that has a given probability.
"""

import argparse
import multiprocessing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise, product
from typing import Any

import common
import numpy as np
from detected import DISTANCES_M, ELEVATIONS_DEG, RobotScene, load_middle, load_motion, track_scene
from numpy.typing import NDArray
from report import Records, Report, group, run
from robots import find_share, sample_body
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from mocap_ros.bridges.detections_3d import compute_heading_stds
from mocap_ros.geometry.level import Floor
from mocap_ros.messages.transforms import compute_links
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, estimate_stature
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.training.example_arrays import AGO, RandomArrays, add_bones
from mocap_ros.training.postures import KINDS, take_postures

Array = NDArray[np.float64]
Record = dict[str, Any]

FRAMES, WARM_UP, STEP = (
    90,
    15,
    3,
)  # of a scene: all, those at its beginning that are not scored, and one in three is
STATURE_M, STATURE_STD_M = 1.70, 0.12  # as is assumed where nothing is known
FAR_M = 3.5  # from here it is far
WITHIN_90 = 6.251  # 1; squared Mahalanobis distance of 90 of 100 in three dimensions
ANGLE_WITHIN_90 = 1.645  # 1; deviations of an angle that 90 of 100 are within
CONTACT_BINS = 0.0, 0.1, 0.5, 0.9, 1.0  # 1; limits of probabilities that are counted together
WAYS = 'height', 'nothing'  # what the robot knows besides
KNOWN_HEIGHT_STD_M = 0.02
DETECTORS = 'openpose', 'mediapipe', 'movenet'
# Kinds of motion of a posture, and kinds of `POSTURES` that are made of these if there are any.
POSTURES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    'standing': (('gesture', 'arm_raise', 'arm_rotation', 'household', 'expression', 'boxing', 'exercise'), ()),
    'walking': (('walk', 'turn', 'run', 'styled_walk', 'walk_uneven'), ()),
    'seated': (('gesture', 'household', 'expression', 'sit_stand', 'walk'), ('chair',)),
    'floor': (('gesture', 'household', 'expression', 'sit_stand', 'walk'), ('floor', 'kneel', 'lie', 'fours')),
    'half body': (('gesture', 'arm_raise', 'household', 'expression', 'boxing'), ()),
}
LEGS = tuple(j for j in BODY26.joints if j[1:] in ('knee', 'ankle', 'toe', 'heel'))
SEATED_KINDS = ('sit_stand', 'sit_stand_walk')  # of motion capture in which people sit
SEATED_HEIGHT = 0.65  # of a leg; of the hips over the lower ankle, of somebody who sits
MEASURES = 'seen', 'inferred', 'roots', 'in capsules', 'vertical', 'direction'
MIN_COUNT = 100  # joints or frames of a share
DRAWS = 400  # of which one shows the posture


@dataclass(frozen=True)
class Plan:
    """What is drawn for a scene."""

    posture: str
    detector: str
    is_far: bool
    number: int


def list_trials(persons: str, kinds: Sequence[str]) -> list[str]:
    """Return trials of these kinds of motion by people of a set, in an order in which people take turns."""
    trials: dict[str, list[str]] = {}
    for name, row in sorted(load_motion()[2].items()):
        is_test = row['subject'] in common.HELD_OUT_SUBJECTS
        if is_test == (persons == 'test') and row['category'] in kinds and int(row['frames']) >= FRAMES:
            trials.setdefault(row['subject'], []).append(name)
    rounds = range(max(map(len, trials.values())))
    return [names[n] for n in rounds for names in trials.values() if n < len(names)]


def find_seated(trial: str) -> Array | None:
    """Return the poses (F, 26, 3) m of a part of a trial in which somebody sits, if there is one."""
    poses, joints = load_middle(trial, 10**6) / 1e3, load_motion()[1]
    hip, knee, ankle = (poses[:, [joints.index(s + n) for s in 'lr']] for n in ('hip', 'knee', 'ankle'))
    leg = (np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)).mean(axis=1)
    is_low = (hip[..., 1].mean(axis=1) - ankle[..., 1].min(axis=1)) / leg < SEATED_HEIGHT
    sums = np.convolve(is_low, np.ones(FRAMES), 'valid')
    first = int(sums.argmax())
    return poses[first : first + FRAMES] if sums[first] >= 0.9 * FRAMES else None


@cache
def list_seated(persons: str) -> list[Array]:
    return [p for t in list_trials(persons, SEATED_KINDS) if (p := find_seated(t)) is not None]


def take_posture(poses: Array, kinds: Sequence[str], seed: int) -> Array | None:
    """Return poses (F, 26, 3) m of a posture, taken by the body of poses with y up; it moves to and fro."""
    ordered = poses[:, [load_motion()[1].index(j) for j in BODY26.joints]]
    body = ordered[len(ordered) // 2][:, [2, 0, 1]].astype(np.float32)  # x forward, y left, z up
    root = BODY26.parents.index(-1)
    bones = body - body[[root if p < 0 else p for p in BODY26.parents]]
    given = np.broadcast_to(bones, (DRAWS, len(AGO), *bones.shape)).copy()
    without = [k for k in KINDS if k not in kinds]
    taken = take_postures(given, RandomArrays(seed), without)
    changed = np.flatnonzero(np.abs(taken - given).max(axis=(1, 2, 3)) > 1e-4)
    if not len(changed):
        return None
    joints = add_bones(taken[changed[0]])
    swing = AGO[-1] / 2 * (1 - np.cos(2 * np.pi * np.arange(FRAMES) / FRAMES))  # s ago
    order = np.argsort(AGO)
    flat = joints.reshape(len(AGO), -1)[order].astype(float)
    moved = np.stack([np.interp(swing, AGO[order], column) for column in flat.T], axis=1)
    out = np.zeros((FRAMES, len(BODY26.joints), 3))
    out[:, [load_motion()[1].index(j) for j in BODY26.joints]] = moved.reshape(FRAMES, -1, 3)[..., [1, 2, 0]]
    return out


def make_scene(plan: Plan, persons: str) -> RobotScene | None:
    """Return a scene of one person."""
    kinds, postures = POSTURES[plan.posture]
    rng = np.random.default_rng([plan.number, plan.is_far, *map(ord, plan.posture + plan.detector + persons)])
    if plan.posture == 'seated' and plan.number % 2:
        if not (found := list_seated(persons)):
            return None
        poses = found[int(rng.integers(len(found)))]
    else:
        trials = list_trials(persons, kinds)
        trial = trials[int(rng.integers(len(trials)))]
        poses = load_middle(trial, FRAMES) / 1e3
        if postures:
            taken = take_posture(poses, postures, int(rng.integers(2**31)))
            if taken is None:
                return None
            poses = taken
    joints = load_motion()[1]
    own = estimate_stature(poses[:, [joints.index(n) for n in CMU15.joints]], CMU15)
    stature = STATURE_M + STATURE_STD_M * float(norm.ppf(rng.uniform(0.02, 0.98)))
    low, high = (FAR_M, DISTANCES_M[1]) if plan.is_far else (DISTANCES_M[0], FAR_M)
    heading, elevation = float(rng.uniform(0, 360)), float(rng.uniform(*ELEVATIONS_DEG))
    distance = float(rng.uniform(low, high))
    options = {'frames': FRAMES, 'seed': plan.number, 'distance': distance, 'detector': plan.detector}
    protocol = common.load_protocol()
    made = protocol.make_view(1e3 * poses * stature / own, joints, heading, elevation, **options)
    view = common.View(made, heading)
    if plan.posture == 'half body':
        hidden = LEGS + (('lhip', 'rhip') if plan.number % 2 else ())
        names = protocol.GIVEN[plan.detector]
        view = view.hide_joints([names[joint] for joint in hidden if joint in names])
    upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, elevation)[0]
    return RobotScene(plan.posture, plan.detector, view, stature, Floor(upward, None))


@cache
def load_models() -> tuple[PoseModel, dict[str, Any]]:
    return common.provide_held_out()


def measure_scene(job: tuple[Plan, str]) -> list[Record]:
    """Return a record of each frame of a scene that is scored, for each of `WAYS`."""
    plan, persons = job
    model, parameters = load_models()
    scene = make_scene(plan, persons)
    if scene is None:
        return []
    known = {'tracker.body_height': scene.stature, 'tracker.body_height_std': KNOWN_HEIGHT_STD_M}
    about, stands = asdict(plan), find_standing(scene)
    out: list[Record] = []
    for way, more in zip(WAYS, (known, {}), strict=True):
        for frame, tracker, person in track_scene(scene, model, {**parameters, **more}):
            if frame >= WARM_UP and not person.predicted and frame % STEP == 0:
                measured = measure(scene, frame, person) | measure_vertical(scene, tracker)
                contact = list(zip(person.contact.tolist(), stands[frame].tolist(), strict=True))
                out.append({**about, 'way': way, **measured, 'contact': contact})
    return out


def find_standing(scene: RobotScene) -> NDArray[np.bool_]:
    """Return whether the left and the right foot (F, 2) stand in truth: its heel or its toe does."""
    protocol = common.load_module(common.data_path('bench', 'feet.py'))
    points = [[BODY26.index(side + name) for name in ('heel', 'toe')] for side in 'lr']
    standing = [[protocol.standing(scene.bodies, scene.floor.upward, p) for p in foot] for foot in points]
    return np.array(standing).any(axis=1).T


def measure_vertical(scene: RobotScene, tracker: PeopleTracker) -> Record:
    """Return whether the vertical that was found, if one was, is within 90 % of its deviation."""
    if (found := tracker.vertical) is None:
        return {'vertical': []}
    angle = np.arccos(np.clip(found.direction @ scene.floor.upward, -1, 1))
    return {'vertical': [bool(angle <= ANGLE_WITHIN_90 * found.std)]}


def measure(scene: RobotScene, frame: int, person: Person3D) -> Record:
    """Return what `MEASURES` names: which joints and roots are within, and how much of the body."""
    found, truth = (joints[:CORE_COUNT] for joints in (person.joints, scene.bodies[frame]))
    middle = found.mean(axis=0)
    error = found - middle - truth + truth.mean(axis=0)
    own = compute_joint_covariance(person.joint_std[:CORE_COUNT], np.broadcast_to(middle, found.shape))
    is_within, is_seen = is_in_ellipsoid(error, own), ~person.inferred[:CORE_COUNT]
    body = sample_body(scene.bodies[frame], scene.stature, np.random.default_rng(frame))
    axes, true_axes = (compute_links(joints[None])[2][0] for joints in (found, truth))
    turn = Rotation.from_matrix(axes @ true_axes.T).as_rotvec()
    direction_std = compute_heading_stds(found[None], person.joint_std[None])[0]
    return {
        'direction': [bool(turn @ turn <= WITHIN_90 * direction_std**2)],
        'seen': is_within[is_seen].tolist(),
        'inferred': is_within[~is_seen].tolist(),
        'roots': is_in_ellipsoid(person.root - scene.root[frame], person.root_covariance).tolist(),
        'in capsules': find_share(body, person),
    }


def is_in_ellipsoid(error: Array, covariance: Array) -> NDArray[np.bool_]:
    """Return whether errors (..., 3) are within the ellipsoids of 90 of 100 of covariances (..., 3, 3)."""
    return np.asarray((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1) <= WITHIN_90)


def show_share(records: Records, key: str) -> str:
    values = np.concatenate([np.ravel(r[key]) for r in records])
    return f'{100 * values.mean():.0f}' if len(values) >= MIN_COUNT else '-'


def report_rows(report: Report) -> None:
    count = 1 if report.quick else report.args.scenes
    plans = [Plan(*values) for values in product(POSTURES, DETECTORS, (False, True), range(count))]
    with multiprocessing.get_context('spawn').Pool(report.args.jobs) as pool:
        jobs = [(plan, report.args.persons) for plan in plans]
        records = [r for some in common.show_progress(pool.imap(measure_scene, jobs), 'scenes') for r in some]
    for title, ways, page in (('All', WAYS, 'deviations.rows'), *((way, (way,), '') for way in WAYS)):
        mine = [r for r in records if r['way'] in ways]
        rows: list[list[object]] = []
        for keys in (('posture', 'detector'), ('posture',)):
            for names, some in group(mine, *keys).items():
                halves = [[r for r in some if r['is_far'] == is_far] for is_far in (False, True)]
                cells = [show_share(half, key) for half in halves for key in MEASURES]
                rows.append([names[0], names[1] if len(names) > 1 else 'all', *cells])
        header = ['posture', 'detector', *(f'{name}, {key}' for name in ('near', 'far') for key in MEASURES)]
        report.table(header, rows, title, page)
    report_contacts(report, records)


def report_contacts(report: Report, records: Records) -> None:
    """Print which share of feet stands, of those with probabilities between two of `CONTACT_BINS`."""
    bins = [f'{low:g} to {high:g}' for low, high in pairwise(CONTACT_BINS)]
    rows: list[list[object]] = []
    for (posture,), some in group(records, 'posture').items():
        chance, stands = np.array([pair for r in some for pair in r['contact']]).T
        at = np.digitize(chance, CONTACT_BINS[1:-1])
        known = np.isfinite(chance)
        shares = [stands[known & (at == n)] for n in range(len(bins))]
        rows.append([posture, *(f'{100 * s.mean():.0f}' if len(s) >= MIN_COUNT else '-' for s in shares)])
    report.table(['posture', *bins], rows, 'Standing feet', 'deviations.contacts')


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('test', 'train'), default='test')
    parser.add_argument('--scenes', type=int, default=8, help='of each row and distance')
    parser.add_argument('--jobs', type=int, default=2)


if __name__ == '__main__':
    run(__doc__, {'rows': report_rows}, add_options)
