# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whole sequences: the most probable base poses, cameras, the learned prior, and points that are not explained."""

from typing import Any

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models, load_base_poses, load_shipped_lifter
from mocap_ros.offline import whole_sequence
from mocap_ros.offline.keyframes.keyframe_method import reconstruct
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, estimate_stature
from mocap_ros.solvers.observed_window import observe_sequence
from mocap_ros.solvers.window import Reconstruction, SolverStatus
from tests.support.bodies import make_swinging_body
from tests.support.synthetic_walk import make_walk, mpjpe_mm, with_scores

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
CONFIG = with_settings(Config(), {'solver.components': 12, 'solver.prior': 'pca'})


def test_the_most_probable_of_several_models_is_used() -> None:
    models = {name: load_base_poses(name) for name in ('walk', 'jump', 'all')}
    walk = make_walk(models['walk'])
    given = with_scores(walk.points), CMU15.joints, walk.times, CAMERA
    several = reconstruct_sequence(*given, models, CONFIG)
    assert several.category == 'walk'
    alone = reconstruct_sequence(*given, models['walk'], CONFIG)
    assert (alone.joints == several.joints).all()
    assert alone.core[..., 2].mean() > 1
    assert estimate_stature(alone.joints, CMU15) == pytest.approx(CONFIG.tracker.body_height, rel=1e-3)
    alternating = with_settings(CONFIG, {'solver.method': 'alternation'})
    one, other = (reconstruct_sequence(*given, m, alternating).joints for m in (models, models['walk']))
    assert (one == other).all()
    assert not np.allclose(one, several.joints, atol=1e-6)


@pytest.mark.parametrize('method', ['whole', 'keyframes'])
def test_the_result_knows_its_cameras(walk_model: BasePoses, method: str) -> None:
    poses, times = make_swinging_body(45)
    truth = poses + [1.5, 0.2, 4.0]
    given: Any = with_scores(CAMERA.project(truth)), CMU15.joints, times, CAMERA, {'walk': walk_model}, CONFIG
    result = reconstruct(*given).result if method == 'keyframes' else reconstruct_sequence(*given)
    cameras, translation = result.cameras_in_real_image()
    roots = result.core.mean(axis=1)
    assert translation == pytest.approx(CAMERA.project(roots), abs=1e-9)
    assert cameras.scale == pytest.approx(CAMERA.focal / roots[:, 2])
    recovered = fit_rotation(result.solution.joints, centre_poses(result.core))  # from virtual to real camera
    assert cameras.rotation == pytest.approx(recovered @ result.solution.cameras.rotation, abs=0.01)  # feet stand
    axis = result.virtual_camera.to_real_camera(np.tile([0.0, 0.0, 1.0], (45, 1, 1)))[:, 0]
    assert axis[:, :2] / axis[:, 2:] == pytest.approx((truth[..., :2] / truth[..., 2:]).mean(axis=1), abs=0.02)


def test_where_no_person_is_no_joint_was_seen(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model)
    anchors = [CMU15.index(side + joint) for joint in ('ankle', 'wrist') for side in 'lr']
    toes_heels_hands = points[:, [*anchors[:2], *anchors]] + 3.0  # px
    body = np.concatenate([points, toes_heels_hands, np.repeat(points[:, :1], 5, axis=1)], axis=1)
    keypoints = with_scores(body)
    keypoints[:3, :CORE_COUNT, 2] = 0  # face, feet and hands alone
    keypoints[20] = 100, 100, 1  # all at one position
    result = reconstruct_sequence(keypoints, BODY26.joints, times, CAMERA, walk_model, CONFIG)
    assert np.flatnonzero(np.isnan(result.joints).any(axis=(1, 2))).tolist() == [0, 1, 2]
    assert np.flatnonzero(~result.seen.any(axis=1)).tolist() == [0, 1, 2, 20]
    assert result.seen[3].all()
    assert result.orientation is not None
    assert result.turn_inferred is not None
    assert np.isnan(result.orientation[:3]).all()
    assert result.turn_inferred[:3].all()
    assert not result.turn_inferred[3:].all()


def test_the_learned_prior_is_better_than_the_base_poses_alone() -> None:
    walk_model = load_base_poses('walk')
    walk = make_walk(walk_model, frames=45)
    truth, points = walk.poses(walk_model), walk.points + np.random.default_rng(0).normal(size=walk.points.shape)
    unknown = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    models, given = load_base_pose_models('auto'), (with_scores(points), CMU15.joints, walk.times, unknown)
    both, alone = (
        reconstruct_sequence(*given, m, with_settings(Config(), {'solver.prior': p}))
        for m, p in ((models, 'learned'), (models['all'], 'pca'))
    )
    assert both.category == 'all'
    network = load_shipped_lifter().lift_sequence(points, np.ones(points.shape[:2]), walk.times).select_core()
    error = mpjpe_mm(both.core, truth)
    assert error < 1.1 * 24.3  # mm, measured; the base poses alone: 26.8, the network alone: 19.2
    assert error < mpjpe_mm(alone.core, truth)
    assert error < 1.35 * mpjpe_mm(network.joints, truth)


def test_points_are_drawn_to_where_the_solution_has_them(rng: np.random.Generator) -> None:
    body, times = make_swinging_body(30)
    joints = centre_poses(body) + [0.8, 0.2, 4.0]
    exact = CAMERA.project(joints)
    noisy = exact + rng.normal(0, 3, exact.shape)
    noisy[4, 11] += 200.0  # a point that is somewhere else
    keypoints = with_scores(noisy)
    keypoints[7, 3, 2] = 0.0
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
    believed = whole_sequence.hide_unexplained_points(observed, observed.build_solver_window(), truth)
    corrected = whole_sequence.draw_points(believed, truth)
    is_hidden = observed.weight != corrected.weight
    assert np.argwhere(is_hidden).tolist() == [[4, 11]]
    seen = corrected.weight > 0
    before, after = ((r - joints[..., :2] / joints[..., 2:])[seen] for r in (observed.rays, corrected.rays))
    np.testing.assert_allclose(after, whole_sequence.SEEN_SHARE * before, atol=1e-9)


def test_unexplained_points_stand_out_from_the_other_errors_of_the_sequence() -> None:
    error = np.random.default_rng(0).uniform(0.02, 0.06, (20, 15))
    seen = np.ones(error.shape, bool)
    error[3:9, 4], error[7, 6], error[12, 2] = 0.3, 0.19, 0.3
    error[15, :3] = 0.3  # so many joints: the solution is wrong
    seen[12, 2] = False
    found = whole_sequence.find_unexplained_points(error, seen)
    assert set(zip(*np.nonzero(found), strict=True)) == {(frame, 4) for frame in range(3, 9)} | {(7, 6)}
    assert not whole_sequence.find_unexplained_points(error / 5, seen).any(), 'precise points are believed'
