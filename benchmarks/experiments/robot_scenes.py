# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People before a robot's camera: of many heights, 2 to 6 m away, on a floor that the camera looks down at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray
from reconstruction import Models, list_people

from experiments.detector_views import CLEAN, DETECTORS, HEADING_STEP_DEG, load_middle, load_motion
from mocap_ros.config import Config
from mocap_ros.geometry.level import Floor
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, estimate_stature
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

DISTANCES_M = 2.0, 6.0  # m, of the nearest point of a person from the camera; drawn evenly
ELEVATIONS_DEG = 5.0, 20.0  # degrees by which the camera looks down, drawn evenly
TILT_STD_DEG = 0.3  # degrees; of the tilt of the camera that the robot believes, about the true one
FLOOR_QUANTILE = 0.05  # of the lowest points of the feet, which is the floor


@dataclass(frozen=True, eq=False)
class RobotScene:
    """One person before a robot's camera.

    Attributes:
        trial: name of the trial.
        category: kind of the motion.
        detector: name of the detector.
        view: the sequence, truth included.
        stature: m, true body height.
        floor: floor that the robot believes.
    """

    trial: str
    category: str
    detector: str
    view: View
    stature: float
    floor: Floor

    @property
    def bodies(self) -> Array:
        """True joints (F, 26, 3) m, in the order of `BODY26`."""
        names = [str(name) for name in self.view.sequence['joints3d_names']]
        return np.asarray(self.view.truth[:, [names.index(joint) for joint in BODY26.joints]])

    @property
    def root(self) -> Array:
        """True places (F, 3) m between the hips."""
        poses = self.view.true_poses
        return np.asarray((poses[:, CMU15.index('lhip')] + poses[:, CMU15.index('rhip')]) / 2)


def make_robot_scene(
    trial: str,
    number: int,
    frames: int,
    stature: float | None = None,
    detector: str | None = None,
    distance: float | None = None,
) -> RobotScene:
    """Return the middle of a trial before a camera that depends on a number.

    Args:
        trial: name of the trial.
        number: seed of the camera and of the detector's errors, and which detector it is.
        frames: most frames.
        stature: m, body height that the person is scaled to; None for the own one.
        detector: name of the detector; None for that of the number.
        distance: m, of the nearest point of the person; None for one that is drawn.
    """
    _, joints, rows = load_motion()
    rng, poses = np.random.default_rng(number), load_middle(trial, frames).astype(float)
    own = estimate_stature(poses[:, [joints.index(n) for n in CMU15.joints]] / 1e3, CMU15)
    if stature is not None:
        poses = poses * (stature / own)
    detector = detector or DETECTORS[number % len(DETECTORS)]
    elevation = float(rng.uniform(*ELEVATIONS_DEG))
    drawn = float(rng.uniform(*DISTANCES_M))
    options: dict[str, Any] = {'frames': frames, 'seed': number, 'distance': distance or drawn}
    if detector != CLEAN:
        options['detector'] = detector
    heading, protocol = number * HEADING_STEP_DEG % 360, common.load_protocol()
    sequence = protocol.make_view(poses, joints, heading, elevation, **options)
    view = View(sequence, heading)
    upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), heading, elevation)[0]
    feet = [i for i, name in enumerate(sequence['joints3d_names']) if name.endswith(('toe', 'heel'))]
    heights = (view.truth[:, feet] @ upward).min(axis=1)
    camera_height = -float(np.quantile(heights, FLOOR_QUANTILE))
    tilt = np.radians(TILT_STD_DEG) * rng.standard_normal()
    believed = np.array([upward[0], upward[1] - tilt * upward[2], upward[2] + tilt * upward[1]])
    floor = Floor(believed / np.linalg.norm(believed), camera_height)
    return RobotScene(trial, rows[trial]['category'], detector, view, stature or own, floor)


def track_scene(
    scene: RobotScene, models: Models, config: Config, floor: Floor | None = None
) -> Iterator[tuple[int, Tracker, Person3D]]:
    """Yield each frame in which the person is tracked and certain, with the tracker and the person."""
    tracker, camera = Tracker(models, config), scene.view.intrinsics
    for frame, (person, time_s) in enumerate(
        zip(list_people(scene.view), scene.view.sequence['timestamps'], strict=True)
    ):
        people = tracker.update(round(time_s * NS_PER_S) + 1, [person], camera, floor)
        if people and not people[0].tentative:
            yield frame, tracker, people[0]
        tracker.run_deferred_work()


def look_ahead(truth: Array, frame: int, times_s: Sequence[float]) -> Array:
    """Return the true poses (N, J, 3) at times after a frame of poses (F, J, 3); NaN after the last."""
    at = [frame + round(t * common.FPS) for t in times_s]
    unknown = np.full(truth.shape[1:], np.nan)
    return np.array([truth[i] if i < len(truth) else unknown for i in at])
