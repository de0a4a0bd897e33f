# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a first solution tells the lifter: points and orientation that are nearer to the truth."""

from __future__ import annotations

import numpy as np

from mocap_ros.config import Config
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.offline.whole_sequence import (
    SEEN_SHARE,
    draw_points,
    find_unexplained_points,
    hide_unexplained_points,
)
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import observe_sequence
from mocap_ros.solvers.window import Reconstruction, SolverStatus
from tests.support.swinging_body import make_swinging_body

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)


def test_points_are_drawn_to_where_the_solution_has_them(rng: np.random.Generator) -> None:
    body, times = make_swinging_body(30)
    joints = centre_poses(body) + [0.8, 0.2, 4.0]
    exact = CAMERA.project(joints)
    noisy = exact + rng.normal(0, 3, exact.shape)
    noisy[4, 11] += 200.0  # a point that is somewhere else
    score = np.ones(exact.shape[:2])
    score[7, 3] = 0.0
    keypoints = np.concatenate([noisy, score[..., None]], axis=-1)
    observed = observe_sequence(keypoints, CMU15.joints, times, CAMERA, Config().tracker)
    camera, roots = observed.virtual_camera, joints.mean(axis=1)
    cameras = camera.weak_perspective_cameras(np.tile(np.eye(3), (30, 1, 1)), roots)
    in_virtual = camera.to_virtual_camera(joints)
    middle = in_virtual.mean(axis=1)
    truth = Reconstruction(
        joints=centre_poses(in_virtual),
        theta=np.zeros((30, 1)),
        cameras=cameras,
        translation=CAMERA.focal * middle[:, :2] / middle[:, 2:],
        residual=np.zeros(30),
        status=SolverStatus.CONVERGED,
        history=(0.0,),
        iterations=1,
    )
    believed = hide_unexplained_points(observed, observed.build_solver_window(), truth)
    corrected = draw_points(believed, truth)
    is_hidden = observed.weight != corrected.weight
    assert np.argwhere(is_hidden).tolist() == [[4, 11]]
    seen = corrected.weight > 0
    before, after = ((r - joints[..., :2] / joints[..., 2:])[seen] for r in (observed.rays, corrected.rays))
    np.testing.assert_allclose(after, SEEN_SHARE * before, atol=1e-9)


def test_unexplained_points_stand_out_from_the_other_errors_of_the_sequence() -> None:
    error = np.random.default_rng(0).uniform(0.02, 0.06, (20, 15))
    seen = np.ones(error.shape, bool)
    error[3:9, 4], error[7, 6], error[12, 2] = 0.3, 0.19, 0.3
    error[15, :3] = 0.3  # so many joints: the solution is wrong
    seen[12, 2] = False
    found = find_unexplained_points(error, seen)
    assert set(zip(*np.nonzero(found), strict=True)) == {(frame, 4) for frame in range(3, 9)} | {(7, 6)}
    assert not find_unexplained_points(error / 5, seen).any(), 'precise points are believed'
