# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture as detectors see it: trials of `data/motion` through the protocol's models of detectors."""

import csv
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.level import Floor
from mocap_ros.models.base_poses import ALL_MOTIONS, PoseModel
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, estimate_stature
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

CLEAN = 'clean'  # no detector: the true image points with scores of 1
DETECTORS = (CLEAN, 'openpose', 'mediapipe', 'movenet')
# Options of the protocol for the two cameras; the perspective one is 3 m from the nearest point of the person.
CAMERAS: Mapping[str, dict[str, float]] = {'orthographic': {}, 'perspective': {'distance': 3.0}}
HEADING_STEP_DEG = 77.0  # degrees between the headings of successive trials, so that they come from all sides
SEED_STEP_DEG = 120.0  # degrees between the headings of successive seeds
DISTANCES_M = 2.0, 6.0  # m, of the nearest point of a person from a robot's camera; drawn evenly
ELEVATIONS_DEG = 5.0, 20.0  # degrees by which that camera looks down, drawn evenly
TILT_STD_DEG = 0.3  # degrees; of the tilt of the camera that the robot believes, about the true one
FLOOR_QUANTILE = 0.05  # of the lowest points of the feet, which is the floor


@functools.cache
def load_motion() -> tuple[Mapping[str, Array], list[str], dict[str, dict[str, str]]]:
    """Load the trials, (F, 26, 3) mm with y up, the names of their joints, and their rows of the manifest."""
    folder = common.data_path('data', 'motion')
    archive = np.load(folder / 'body26_30fps.npz')
    with (folder / 'manifest.csv').open(newline='', encoding='utf-8') as file:
        rows = {row['trial']: row for row in csv.DictReader(file)}
    return archive, [str(j) for j in archive['_joints']], rows


def load_middle(trial: str, frames: int) -> Array:
    """Load the poses (F, 26, 3) mm in the middle of a trial: many trials begin and end standing."""
    poses = load_motion()[0][trial].astype(float)
    first = max(len(poses) - frames, 0) // 2
    return poses[first : first + frames]


def choose_trials(persons: str, count: int, min_frames: int = 0) -> list[str]:
    """Return the longest trials of each kind of motion, so that no person and no motion dominates.

    `persons` are `held-out`, on whom no model is trained, each with `count` trials of a kind of motion, or
    `training`, all others together.
    """
    groups: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for name, row in load_motion()[2].items():
        is_held_out, frames = row['subject'] in common.HELD_OUT_SUBJECTS, int(row['frames'])
        if is_held_out == (persons == 'held-out') and frames >= min_frames:
            person = row['subject'].partition('_')[0] if is_held_out else ''
            groups.setdefault((person, row['category']), []).append((-frames, name))
    return [name for group in groups.values() for _, name in sorted(group)[:count]]


@dataclass(frozen=True)
class ViewOptions:
    """How a trial is seen: by one of `CAMERAS`, from a heading in degrees, with a detector's errors of a seed."""

    trial: str
    detector: str
    camera: str
    heading: float
    frames: int
    seed: int

    @property
    def category(self) -> str:
        return load_motion()[2][self.trial]['category']

    def make_view(self) -> View:
        options: dict[str, Any] = {'frames': self.frames, 'seed': self.seed, **CAMERAS[self.camera]}
        if self.detector != CLEAN:
            options['detector'] = self.detector
        poses, joints = load_middle(self.trial, self.frames), load_motion()[1]
        return View(common.load_protocol().make_view(poses, joints, self.heading, **options), self.heading)


def list_views(
    trials: Sequence[str], detectors: Sequence[str], frames: int, seeds: Sequence[int]
) -> list[ViewOptions]:
    """Return one view for each trial, seed and detector, with headings and cameras in turn."""
    cameras = list(CAMERAS)
    return [
        ViewOptions(
            trial,
            detector,
            cameras[(number + seed) % len(cameras)],
            (number * HEADING_STEP_DEG + seed * SEED_STEP_DEG) % 360,
            frames,
            seed,
        )
        for number, trial in enumerate(trials)
        for seed in seeds
        for detector in detectors
    ]


@dataclass(frozen=True, eq=False)
class RobotScene:
    """One person of a stature in m before a robot's camera, and the floor that the robot believes."""

    category: str
    detector: str
    view: View
    stature: float
    floor: Floor

    @property
    def bodies(self) -> Array:
        """True joints (F, 26, 3) m, in the order of `BODY26`."""
        return self.view.select_truth(BODY26.joints)

    @property
    def root(self) -> Array:
        """True places (F, 3) m between the hips."""
        return np.asarray(self.view.select_truth(('lhip', 'rhip')).mean(axis=1))


def make_robot_scene(trial: str, number: int, frames: int, stature: float | None = None) -> RobotScene:
    """Return the middle of a trial before a camera and a detector that depend on a number.

    The person is scaled to the stature in m, if one is given.
    """
    _, joints, rows = load_motion()
    rng, poses = np.random.default_rng(number), load_middle(trial, frames).astype(float)
    own = estimate_stature(poses[:, [joints.index(n) for n in CMU15.joints]] / 1e3, CMU15)
    poses = poses * ((stature or own) / own)
    detector = DETECTORS[number % len(DETECTORS)]
    elevation, distance = float(rng.uniform(*ELEVATIONS_DEG)), float(rng.uniform(*DISTANCES_M))
    options: dict[str, Any] = {'frames': frames, 'seed': number, 'distance': distance}
    if detector != CLEAN:
        options['detector'] = detector
    heading, protocol = number * HEADING_STEP_DEG % 360, common.load_protocol()
    view = View(protocol.make_view(poses, joints, heading, elevation, **options), heading)
    upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, elevation)[0]
    feet = [str(n) for n in view.sequence['joints3d_names'] if str(n).endswith(('toe', 'heel'))]
    heights = (view.select_truth(feet) @ upward).min(axis=1)
    tilt = np.radians(TILT_STD_DEG) * rng.standard_normal()
    believed = np.array([upward[0], upward[1] - tilt * upward[2], upward[2] + tilt * upward[1]])
    floor = Floor(believed / np.linalg.norm(believed), -float(np.quantile(heights, FLOOR_QUANTILE)))
    return RobotScene(rows[trial]['category'], detector, view, stature or own, floor)


def track_scene(
    scene: RobotScene, model: PoseModel, parameters: common.Parameters, floor: Floor | None = None, step: int = 1
) -> Iterator[tuple[int, PeopleTracker, Person3D]]:
    """Yield each of the frames, one in `step`, in which the person is tracked and certain."""
    tracker = PeopleTracker({ALL_MOTIONS: model}, with_values(Config(), parameters))
    camera, times = scene.view.intrinsics, scene.view.times
    for frame, person in list(enumerate(scene.view.list_people()))[::step]:
        people = tracker.update(round(times[frame] * NS_PER_S) + 1, [person], camera, floor).people
        if people and not people[0].tentative:
            yield frame, tracker, people[0]


def look_ahead(truth: Array, frame: int, times_s: Sequence[float]) -> Array:
    """Return the true poses (N, J, 3) at times after a frame of poses (F, J, 3); NaN after the last."""
    at = [frame + round(t * common.FPS) for t in times_s]
    unknown = np.full(truth.shape[1:], np.nan)
    return np.array([truth[i] if i < len(truth) else unknown for i in at])
