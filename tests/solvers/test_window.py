# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Windows as a solver gets them (joints, sides, rays, px, chosen frames, lifting, initial values), how solvers
end and go on in pieces, Algorithm 1, and windows that cannot be solved."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig, TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.rays import Extremities
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.lifter_input import sample_histories
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import joint, observed_window, periodic
from mocap_ros.solvers.alternation import reconstruct
from mocap_ros.solvers.image_roll import turn_about_axis
from mocap_ros.solvers.observed_window import RAY_FOCAL, ObservedWindow, append_lifted, observe_sequence
from mocap_ros.solvers.window import Reconstruction, SolverStatus, Window, choose_initial_values
from tests.support.bodies import make_swinging_body
from tests.support.synthetic_walk import make_sequence, make_walk, mpjpe_mm, with_scores

FRAMES = 60
CAMERA = Intrinsics(600.0, (320.0, 240.0), True, 1.05, Distortion('plumb_bob', (-0.1, 0.02, 0.001, -0.001, 0.0)))
PLACE_M = np.array([1.5, -0.3, 4.0])  # m in the camera's frame: 20 degrees off the optical axis
TRACKING = TrackerConfig()
MIRROR = np.array(CMU15.mirror)
SINGLE_CAMERA = pytest.mark.parametrize('single_camera', [False, True], ids=['camera a frame', 'one camera'])


def lift(observed: ObservedWindow, lifter: Lifter) -> ObservedWindow:
    points, weight, cameras = observed_window.sample_unlifted_histories([observed])
    append_lifted([observed], lifter.lift(points, weight, RAY_FOCAL), cameras)
    return observed


def make_person() -> tuple[Array, Array, Array]:
    """Return keypoints (F, 15, 3) in px, times (F,) s and joints (F, 15, 3) m in the camera's frame."""
    poses, times = make_swinging_body(FRAMES)
    joints = poses + PLACE_M + np.linspace(0, 0.5, FRAMES)[:, None, None] * [1, 0, 1]
    return with_scores(CAMERA.project(joints), 0.9), times, joints


def observe(single_camera: bool = False) -> ObservedWindow:
    keypoints, times, _ = make_person()
    observed = observe_sequence(make_sequence(keypoints, times, CAMERA), TRACKING)
    if not single_camera:
        return observed
    camera = VirtualCamera.look_at_mean_position(observed.rays, observed.weight, CAMERA)
    return replace(observed, virtual_camera=camera)


def test_rays_are_those_of_the_joints_with_the_right_sides() -> None:
    keypoints, times, joints = make_person()
    keypoints[20:25] = keypoints[20:25][:, MIRROR]
    keypoints[30, 3] = np.nan, np.nan, 0.9
    keypoints[31, 3, 2] = TRACKING.min_score / 2
    observed = observe_sequence(make_sequence(keypoints, times, CAMERA), TRACKING)
    unseen = np.zeros((FRAMES, 15), bool)
    unseen[[30, 31], 3] = True
    assert observed.rays[~unseen] == pytest.approx((joints[..., :2] / joints[..., 2:])[~unseen], abs=1e-6)
    assert (observed.weight == np.where(unseen, 0, 0.9)).all()
    assert (observed.points[unseen] == 0).all()
    assert (observed.times == times).all()
    as_given = observe_sequence(make_sequence(keypoints, times, CAMERA), replace(TRACKING, undo_swaps=False))
    assert as_given.rays[22] == pytest.approx(observed.rays[22][MIRROR])


@pytest.mark.parametrize(
    ('places', 'value', 'message'),
    [
        (np.s_[:, 3:, 2], 0.0, 'four seen joints'),
        (np.s_[:, :, :2], 100.0, 'one place'),
        (None, 1.76e9, 'the times span 17600000'),  # s, of a stamp that was not set
    ],
)
def test_sequences_that_show_no_motion_are_refused(places: Any, value: float, message: str) -> None:
    keypoints, times, _ = make_person()
    if places is None:
        times[1:] += value
    else:
        keypoints[places] = value
    with pytest.raises(InputError, match=message):
        observe_sequence(make_sequence(keypoints, times, CAMERA), TRACKING)


@SINGLE_CAMERA
def test_the_solver_gets_the_px_of_a_camera_that_faces_the_person(single_camera: bool) -> None:
    _, _, joints = make_person()
    observed = observe(single_camera)
    facing = joints @ np.swapaxes(observed.virtual_camera.rotation, -1, -2)
    expected = CAMERA.focal * facing[..., :2] / facing[..., 2:]
    window = observed.build_solver_window()
    assert window.points == pytest.approx(expected, abs=1e-3)
    assert np.abs(expected.mean(axis=(0, 1))).max() < 5, 'px; the person is near the optical axis'
    assert window.times is observed.times
    np.testing.assert_array_equal(window.weight, observed.evidence)
    assert window.focal == CAMERA.focal


@SINGLE_CAMERA
def test_selected_frames_and_excluded_points_leave_the_others_as_they_are(single_camera: bool) -> None:
    observed = lift(observe(single_camera), load_shipped_lifter())
    frames, excluded = np.array([3, 4, 20, 59]), np.zeros((FRAMES, 15), bool)
    excluded[20, 2:5] = True
    whole = observed.build_solver_window()
    part = observed.exclude_points(excluded).select_frames(frames).build_solver_window()
    seen = ~excluded[frames]
    assert (part.points[seen] == whole.points[frames][seen]).all()
    assert (part.points[~seen] == 0).all()
    assert (part.weight == seen * whole.weight[frames]).all()
    assert (part.times == whole.times[frames]).all()
    assert part.lifted is not None
    assert whole.lifted is not None
    assert part.lifted.joints == pytest.approx(whole.lifted.joints[frames], abs=1e-12)
    assert (part.lifted.std == whole.lifted.std[frames]).all()


@SINGLE_CAMERA
def test_lifted_poses_reach_the_solver_in_px_of_the_virtual_camera(single_camera: bool) -> None:
    observed, lifter = observe(single_camera), load_shipped_lifter()
    whole = observed.view_body(slice(None), CAMERA.focal)
    expected = lifter.lift_sequence(*whole, observed.times, CAMERA.focal).select_core()
    found = lift(observed, lifter).build_solver_window().lifted
    assert found is not None
    assert found.joints == pytest.approx(expected.joints, abs=1e-3)  # px; the network computes in single precision
    assert found.std == pytest.approx(expected.std, rel=1e-4)


@SINGLE_CAMERA
def test_histories_are_those_that_the_whole_window_gives(single_camera: bool, rng: np.random.Generator) -> None:
    """They are so in turned images too, and lifted poses are turned back into the axes of the real camera."""
    observed = observe(single_camera)
    lifted = LiftedPoses(np.zeros((1, 26, 3)), np.ones((1, 26, 3)))
    for _ in range(50):
        steps_s = rng.choice([0.02, 1 / 30, 0.1, 0.148, 0.2, 0.8], FRAMES, p=[0.3, 0.3, 0.1, 0.1, 0.1, 0.1])
        weight = np.where(rng.random((FRAMES, 15)) < 0.8, 0.9, 0.0)
        known = int(rng.integers(1, FRAMES))
        window = replace(
            observed,
            times=np.cumsum(steps_s),
            weight=weight,
            extremities=Extremities(rng.normal(size=(FRAMES, 11, 2)), np.full((FRAMES, 11), 0.7)),
            lifted=lifted.select_frames(np.zeros(known, int)),
        )
        body = window.view_body(slice(None), RAY_FOCAL)
        expected = sample_histories(*body, window.times, np.arange(known, FRAMES))
        for found, wanted in zip(observed_window.sample_unlifted_histories([window]), expected, strict=False):
            np.testing.assert_array_equal(found, wanted)
        turned, _, cameras = observed_window.sample_unlifted_histories([window], 0.7)
        assert turned == pytest.approx(turn_about_axis(expected[0], 0.7), abs=1e-12)
        to_the_right = np.repeat(cameras[:, None, :, 0], 26, axis=1)
        append_lifted([window], LiftedPoses(to_the_right, np.ones_like(to_the_right)), cameras)
        assert window.lifted is not None
        assert window.lifted.joints[known:] == pytest.approx(
            np.broadcast_to([1, 0, 0], to_the_right.shape), abs=1e-12
        )
        assert (window.lifted.joints[:known] == 0).all()


@SINGLE_CAMERA
def test_initial_values_are_the_state_in_the_virtual_camera(single_camera: bool) -> None:
    observed = observe(single_camera)
    camera = observed.virtual_camera
    _, _, joints = make_person()
    rotation, roots = Rotation.random(FRAMES, random_state=0).as_matrix(), joints.mean(axis=1)
    theta = np.arange(3.0 * FRAMES).reshape(FRAMES, 3)
    start = observed.convert_to_initial_values(theta, rotation, roots)
    facing = (camera.to_virtual_camera(roots[:, None]))[:, 0]
    assert (start.theta == theta).all()
    assert camera.body_rotations(start.cameras) == pytest.approx(rotation, abs=1e-12)
    translation = CAMERA.focal * facing[:, :2] / facing[:, 2:]
    assert camera.root_positions(start.cameras, translation) == pytest.approx(roots, abs=1e-9)
    behind = observed.convert_to_initial_values(theta, rotation, -roots).cameras.scale
    assert ((behind > 0) & np.isfinite(behind)).all()


CONFIG = SolverConfig(components=8, adapt_noise=False)


@pytest.fixture
def window(walk_model: PoseModel) -> Window:
    """Noisy points of a walk, with fixed initial values and unit, so that all solutions have one objective."""
    window = make_walk(walk_model).window
    window = replace(window, points=window.points + 2 * np.random.default_rng(0).normal(size=window.points.shape))
    start, unit = choose_initial_values(window, walk_model.truncate(CONFIG.components), 1.0)
    return replace(window, start=start, unit=unit)


def solve_jointly(window: Window, model: PoseModel, config: SolverConfig) -> Reconstruction:
    (result,) = joint.solve([window], model, config)
    return result


SOLVERS = [solve_jointly, reconstruct, periodic.solve]


@pytest.mark.parametrize('solve', SOLVERS)
def test_status_tells_convergence_from_the_limit_of_iterations(
    walk_model: PoseModel, window: Window, solve: Callable[[Window, PoseModel, SolverConfig], Reconstruction]
) -> None:
    converged = solve(window, walk_model, replace(CONFIG, max_iterations=500))
    assert converged.status is SolverStatus.CONVERGED
    assert converged.success
    assert 1 < converged.iterations < 500
    stopped = solve(window, walk_model, replace(CONFIG, max_iterations=converged.iterations - 1))
    assert stopped.status is SolverStatus.MAX_ITERATIONS
    assert not stopped.success
    assert stopped.iterations == converged.iterations - 1
    assert stopped.cost > converged.cost


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_numbers_that_overflow_are_no_success(walk_model: PoseModel, window: Window) -> None:
    (result,) = joint.solve([replace(window, points=1e200 * window.points)], walk_model, CONFIG)
    assert result.status is SolverStatus.SINGULAR
    assert not result.success


def test_recovers_a_synthetic_walk(walk_model: PoseModel) -> None:
    walk = make_walk(walk_model)
    config = SolverConfig(
        prior_weight=1e-7, bone_weight=0.05, flip_weight=1e-5, components=4,
        max_iterations=400, tolerance=1e-7,
    )  # fmt: skip
    result = reconstruct(walk.window, walk_model, config)
    assert mpjpe_mm(result.joints, walk.poses(walk_model)) < 1.1 * 1.67  # mm; measured: 1.667
    assert result.residual.max() < 1.1 * 0.25  # px; measured: 0.249
    assert result.translation == pytest.approx(np.tile([320, 240], (40, 1)), abs=1e-3)  # px


@settings(max_examples=15)
@example(seed=405, bone=0.0, prior=0.0, flip=0.0, missing=0.5)  # nothing determines the weights of a frame
@given(
    seed=st.integers(0, 1000),
    bone=st.floats(0, 100),
    prior=st.floats(0, 1e-2),
    flip=st.floats(0, 1),
    missing=st.floats(0, 0.5),
)
def test_objective_never_rises(
    walk_model: PoseModel, seed: int, bone: float, prior: float, flip: float, missing: float
) -> None:
    config = SolverConfig(bone_weight=bone, prior_weight=prior, flip_weight=flip, components=8, max_iterations=6)
    exact, rng = make_walk(walk_model, frames=12, seed=seed).window, np.random.default_rng(seed)
    points = exact.points + 5 * rng.normal(size=exact.points.shape)
    weight = rng.uniform(0.1, 1, points.shape[:2]) * (rng.random(points.shape[:2]) >= missing)
    for solve in (reconstruct, solve_jointly):
        result = solve(Window(points, weight, exact.times), walk_model, config)
        assert (np.diff(result.history) <= 1e-9 * np.abs(result.history[0])).all()
        assert np.isfinite(result.joints).all()


@pytest.mark.parametrize(('kept', 'seen', 'message'), [(39, 1, 'do not fit'), (40, 0, 'nothing to reconstruct')])
def test_unsolvable_windows_are_refused(walk_model: PoseModel, kept: int, seen: int, message: str) -> None:
    _, _, points, times = make_walk(walk_model)
    with pytest.raises(InputError, match=message):
        Window(points[:kept], np.full((40, 15), float(seen)), times)
