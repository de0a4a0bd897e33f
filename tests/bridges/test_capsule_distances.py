# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Distances to the capsules of a body, as a library for collisions measures them (`pip install .[collision]`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from mocap_ros.bridges.bridge import Bridge
from mocap_ros.bridges.capsules import compute_capsules
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.foreign_types import COLLISION_OBJECT
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.skeleton import BODY26
from tests.support.people import make_person_3d

coal = pytest.importorskip('coal', reason='coal (400 MB) is not installed, .[collision]')
Array = NDArray[np.float64]
ROD = np.array([[0.0, 3.0, 0.2], [0.3, 3.0, 1.4]])  # m, ends of a robot's forearm
ROD_RADIUS_M = 0.06


def measure_distance(start: Array, end: Array) -> float:
    """Return the distance in m of the segment from start to end (3,) from that of the robot, by a search."""

    def square(share: Array) -> float:
        return float(((start + share[0] * (end - start) - ROD[0] - share[1] * (ROD[1] - ROD[0])) ** 2).sum())

    found = minimize(square, [0.5, 0.5], bounds=[(0, 1), (0, 1)], options={'ftol': 1e-15, 'gtol': 1e-12})
    return float(np.sqrt(found.fun))


def measure_by_coal(shape: object, position: Array, quaternion: Array) -> float:
    """Return the distance in m of a shape from the robot's forearm as coal measures it."""
    axis = ROD[1] - ROD[0]
    turn, _ = Rotation.align_vectors([axis], [[0, 0, 1]])
    robot = coal.Capsule(ROD_RADIUS_M, float(np.linalg.norm(axis)))
    at_robot = coal.Transform3s(turn.as_matrix(), ROD.mean(axis=0))
    at_body = coal.Transform3s(Rotation.from_quat(quaternion).as_matrix(), position)
    return float(coal.distance(shape, at_body, robot, at_robot, coal.DistanceRequest(), coal.DistanceResult()))


@pytest.mark.parametrize('seed', range(5))
def test_capsules_built_from_the_messages_are_as_far_away_as_their_segments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    person = replace(
        make_person_3d('anna'), joints=rng.normal(size=(26, 3)) * 0.4, std=np.full(26, 0.05), skeleton=BODY26
    )
    (output,) = Bridge(['collision_objects']).feed_skeletons(encode_skeletons(Header(1, 'map'), [person]))
    added = decode(output.data, COLLISION_OBJECT)
    for start, end, radius, cylinder, pose in zip(
        *compute_capsules(person.joints, person.std, BODY26), added.primitives, added.primitive_poses, strict=True
    ):
        p, q = pose.position, pose.orientation
        place = np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])
        height, cylinder_radius = cylinder.dimensions
        capsule = coal.Capsule(float(radius), float(height - 2 * radius))
        true = measure_distance(start, end) - radius - ROD_RADIUS_M
        assert measure_by_coal(capsule, *place) == pytest.approx(true, abs=1e-5)
        around = measure_by_coal(coal.Cylinder(float(cylinder_radius), float(height)), *place)
        assert around <= true + 1e-5, 'the cylinder holds the capsule'
