# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Are people named as standing, sitting, crouching and lying who are?

Persons on whom no model was trained, in motion capture and in the postures of `training.postures`, which are moved
into for 0.8 s and held for 1.2 s; 4 m before a camera that looks down by 10 degrees, which is known, or found
with `--found`. Every view is by the next detector in turn. The true posture of a frame is that of the synthesised
kind, or by the true joints:

    lying      shoulders below 0.45, hips below 0.4 legs over the lowest joint, the trunk 37 degrees from level
    standing   hips more than 0.8 legs over the lower ankle
    sitting    hips less than 0.7 legs over it, and on the floor or with the body not above the feet
    crouching  as low, with the body above the feet or a knee on the floor

Frames between are left out, and those of acrobatics that are neither standing nor lying. `--persons training` has
those on whom the shapes of `solvers.posture` were fitted.
"""

import argparse
from collections.abc import Iterator
from typing import Any

import common
import numpy as np
from common import WAYS, View
from detected import HEADING_STEP_DEG, choose_trials, load_middle, load_motion
from numpy.typing import NDArray
from report import Report, run

import mocap_ros
from mocap_ros.people import Posture
from mocap_ros.skeleton import BODY26
from mocap_ros.solvers.posture import measure_shapes
from mocap_ros.training.example_arrays import AGO, RandomArrays, add_bones
from mocap_ros.training.postures import KINDS, take_postures

Array = NDArray[np.float64]

DETECTORS = ('openpose', 'mediapipe', 'movenet')
DISTANCE_M, ELEVATION_DEG = 4.0, 10.0
FRAMES, MIN_FRAMES, HELD_FRAMES = 180, 60, 36  # of a trial; of a posture that is held
TRIALS = 2  # of a person and a kind of motion
CLIPS, QUICK_CLIPS = 16, 1  # of a kind of posture
BODIES = 200  # of which some take a posture at a time
LEFT_OUT, OTHER = -1, 0
SYNTHESISED = {
    'lie': Posture.LYING, 'floor': Posture.SITTING, 'chair': Posture.SITTING, 'kneel': Posture.CROUCHING,
    'fours': OTHER, 'bridge': OTHER, 'handstand': OTHER, 'recline': Posture.SITTING,
}  # fmt: skip
POSTURES = {p: p.name.lower() for p in (*Posture, Posture.UNKNOWN) if p} | {Posture.UNKNOWN: 'none of these'}


def label(kind: str, joints: Array, upward: Array) -> NDArray[np.int_]:
    """Return the true postures (F,) of true joints (F, 26, 3) m, by the rules at the top."""
    if kind in SYNTHESISED:
        return np.full(len(joints), SYNTHESISED[kind])
    at = {name: joints[:, n] @ upward for n, name in enumerate(BODY26.joints)}
    shapes = measure_shapes(joints, np.zeros(joints.shape[:2], bool), upward[None])
    trunk, balance = shapes[:, 0], shapes[:, 3]
    ends = [[joints[:, BODY26.index(f'l{n}')] for n in pair] for pair in (('hip', 'knee'), ('knee', 'ankle'))]
    leg = sum(np.linalg.norm(a - b, axis=1) for a, b in ends)
    lowest = np.min([*at.values()], axis=0)
    shoulders, hips = ((at[f'l{n}'] + at[f'r{n}']) / 2 for n in ('shoulder', 'hip'))
    over_feet = (hips - np.minimum(at['lankle'], at['rankle'])) / leg
    over_floor, chest = (hips - lowest) / leg, (shoulders - lowest) / leg
    knees = (np.minimum(at['lknee'], at['rknee']) - lowest) / leg
    lies = (chest < 0.45) & (over_floor < 0.4) & (np.abs(trunk) < 0.6)
    is_bent_over = (over_feet > 0.8) & (chest > 0.5) & (over_floor > 0.75)
    is_other = ~lies & (trunk < 0.25) & ~is_bent_over
    sits = (over_floor < 0.2) | ((balance > 0.25) & (knees > 0.2))
    found = np.where(over_feet > 0.8, Posture.STANDING, LEFT_OUT)
    found = np.where(over_feet < 0.7, np.where(sits, Posture.SITTING, Posture.CROUCHING), found)
    found = np.where(lies, Posture.LYING, np.where(is_other, OTHER, found))
    if kind.startswith('acrobatics'):
        found[~np.isin(found, [Posture.STANDING, Posture.LYING])] = LEFT_OUT
    return found


def synthesise(persons: str, count: int) -> Iterator[tuple[str, Array]]:
    """Yield kinds of postures, and poses (F, 26, 3) mm with y up of bodies that take them."""
    bodies = np.concatenate([load_middle(t, FRAMES) for t in choose_trials(persons, 1, MIN_FRAMES)])
    bodies = bodies[..., [0, 2, 1]] * [1e-3, -1e-3, 1e-3]
    rng, random, parents = np.random.default_rng(0), RandomArrays(0), np.maximum(BODY26.parents, 0)
    grid = np.arange(-AGO.max(), 0, 1 / common.FPS)
    for kind in (*SYNTHESISED, 'bend'):
        found: list[Array] = []
        while len(found) < count:
            poses = bodies[rng.integers(len(bodies), size=BODIES)]
            left = (poses[:, BODY26.index('lhip')] - poses[:, BODY26.index('rhip')]) * [1.0, 1.0, 0.0]
            left /= np.linalg.norm(left, axis=1, keepdims=True)
            up = np.broadcast_to([0.0, 0.0, 1.0], left.shape)
            poses = poses @ np.stack([np.cross(left, up), left, up], axis=2)  # which face +x
            vectors = np.repeat((poses - poses[:, parents])[:, None], len(AGO), axis=1).astype(np.float32)
            taken = take_postures(vectors, random, [k for k in KINDS if k != kind])
            found += [*add_bones(taken[(taken != vectors).any(axis=(1, 2, 3))]).astype(float)]
        for slots in found[:count]:
            columns = slots[::-1].reshape(len(AGO), -1).T
            moving = np.stack([np.interp(grid, -AGO[::-1], c) for c in columns], axis=1)
            poses = np.concatenate(
                [moving.reshape(-1, *slots.shape[1:]), np.repeat(slots[:1], HELD_FRAMES, axis=0)]
            )
            yield kind, poses[..., [0, 2, 1]] * [1e3, 1e3, -1e3]


def list_views(report: Report) -> Iterator[tuple[str, str, View, Array]]:
    """Yield source and kind of each view, and the direction upwards in its camera."""
    protocol, joints, rows = common.load_protocol(), load_motion()[1], load_motion()[2]
    persons = report.args.persons
    clips = [('synthesised', *clip) for clip in synthesise(persons, QUICK_CLIPS if report.quick else CLIPS)]
    trials = choose_trials(persons, TRIALS, MIN_FRAMES)[:: 10 if report.quick else 1]
    clips += [('captured', rows[t]['category'], load_middle(t, FRAMES)) for t in trials]
    for number, (source, kind, poses) in common.show_progress(list(enumerate(clips)), 'views'):
        heading, detector = number * HEADING_STEP_DEG % 360, DETECTORS[number % len(DETECTORS)]
        options: dict[str, Any] = {'frames': FRAMES, 'distance': DISTANCE_M, 'detector': detector}
        view = View(protocol.make_view(poses, joints, heading, ELEVATION_DEG, **options), heading)
        yield source, kind, view, protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, ELEVATION_DEG)[0]


def find_named(way: str, view: View, **given: Any) -> NDArray[np.integer[Any]]:
    """Return the postures (F,) that one of `WAYS` names."""
    if way == 'whole':
        return mocap_ros.reconstruct(view.keypoints, view.joint_names, view.times, **given).posture
    tracker = mocap_ros.Tracker(view.joint_names, **given)
    frames = [tracker.update(t, [k]) for t, k in zip(view.times.tolist(), view.keypoints, strict=True)]
    return np.array([f.people.posture[0] if len(f.people) else Posture.UNKNOWN for f in frames])


def report_postures(report: Report) -> dict[str, Any]:
    size = len(POSTURES)
    model, parameters = common.provide_held_out()
    counts: dict[tuple[str, str], NDArray[np.int_]] = {}  # (truth, named) of a source and a way
    for source, kind, view, upward in list_views(report):
        truth = label(kind, view.select_truth(BODY26.joints), upward)
        vertical = 'auto' if report.args.found else '{} {} {}'.format(*upward)
        known = parameters | {'tracker.vertical': vertical}
        given = {**view.camera, 'model': model, 'parameters': known}
        for way in WAYS:
            pairs = (truth * size + find_named(way, view, **given))[truth != LEFT_OUT]
            table = counts.setdefault((source, way), np.zeros((size, size), int))
            table += np.bincount(pairs, minlength=size * size).reshape(size, size)
    rows = []
    for source in dict.fromkeys(source for source, _ in counts):
        for posture, name in POSTURES.items():
            found = [counts[source, way][posture] for way in ('live', 'whole')]
            if total := int(found[0].sum()):
                shares = [[f'{100 * own[n] / total:.2f}' for own in found] for n in POSTURES]
                rows.append([f'{name}, {source}', total, *(' / '.join(pair) for pair in shares)])
    header = [*POSTURES.values()][:-1]
    report.table(['live / whole, %', 'frames', *header, 'unknown'], rows, page='postures.confusion')
    return {f'{source}, {way}': table for (source, way), table in counts.items()}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--found', action='store_true', help='the vertical is found and not given')


if __name__ == '__main__':
    run(__doc__, {'postures': report_postures}, add_options)
