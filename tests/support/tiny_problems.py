# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Small problems for all kernels of the live tracker, and their solution as a program prints it.

`python -m tests.support.tiny_problems` prints the numbers as JSON.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, SolverConfig, with_settings
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import joint
from mocap_ros.solvers.window import Window
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS

Array = NDArray[np.float64]

COMPONENTS = 5  # base poses; uncompiled loops are a hundred times slower
FRAMES = 6
ITERATIONS = 3  # so few that rounding errors have no time to grow


def solve_window(model: BasePoses) -> Array:
    """Return the joints (F, J, 3) m of a noisy window with missing points and lifted poses, in perspective."""
    theta, _, points, times = make_walk(model, frames=FRAMES)
    rng = np.random.default_rng(0)
    weight = rng.uniform(0.3, 1, points.shape[:2]) * (rng.random(points.shape[:2]) > 0.1)
    poses = 200 * model.poses(theta)
    lifted = LiftedPoses(poses + 10 * rng.normal(size=poses.shape), rng.uniform(5, 50, poses.shape))
    window = Window(points + rng.normal(size=points.shape), weight, times, focal=800.0, lifted=lifted)
    config = SolverConfig(components=COMPONENTS, max_iterations=ITERATIONS)
    (result,) = joint.solve([window], model, config)
    return result.joints


def track_person(model: BasePoses) -> Array:
    """Return the joints (F, J, 3) m of the frames of the tracker."""
    _, _, points, _ = make_walk(model, frames=FRAMES)
    changed = {'tracker.iterations': 1, 'solver.max_iterations': ITERATIONS, 'solver.components': COMPONENTS}
    tracker = Tracker(model, with_settings(Config(), changed))
    joints = []
    for frame, image in enumerate(points):
        detection = Person2D('', CMU15.joints, image, np.ones(len(image)))
        (person,) = tracker.update(frame * STEP_NS, [detection], CAMERA)
        joints.append(person.joints)
    return np.array(joints)


def solve_all() -> dict[str, list[Any]]:
    """Return all solutions by the name of their problem."""
    model = load_base_poses('walk').truncate(COMPONENTS)
    return {'window': solve_window(model).tolist(), 'person': track_person(model).tolist()}


if __name__ == '__main__':
    print(json.dumps(solve_all()))
