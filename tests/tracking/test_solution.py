# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Solutions of a track: states in the real camera, kept frames, predictions, and what a solver gets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import Array, SolverStatus
from mocap_ros.tracking.solution import (
    EXTRAPOLATION_SHARE,
    MAX_EXTRAPOLATION_STEPS,
    TrackSolution,
    append_prediction,
    build_refinement_window,
    select_start,
)
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import BODY_TO_OPTICAL
from tests.support.tracks import CAMERA, STEP_NS, make_track

FRAMES, COMPONENTS = 9, 3
ALL = np.arange(FRAMES)


@pytest.fixture(scope='module')
def model(walk_model: BasePoses) -> BasePoses:
    return walk_model.truncate(COMPONENTS)


@pytest.fixture(scope='module')
def truth(model: BasePoses) -> TrackSolution:
    """A person off the optical axis, who moves, turns and bends at constant rates."""
    number = np.arange(float(FRAMES))
    theta = 0.1 * number[:, None] * model.std
    return TrackSolution(
        model_name='walk',
        model=model,
        theta=theta,
        rotation=Rotation.from_rotvec(number[:, None] * [0.01, 0.04, 0.0]).as_matrix() @ BODY_TO_OPTICAL,
        roots=np.array([1.5, -0.3, 4.0]) + number[:, None] * [0.02, 0.01, 0.05],
        bone_lengths=model.skeleton.bone_lengths(model.poses(theta)),
        noise=0.01,
        stature_ratio=1.0,
        joint_std=np.full(15, 0.02),
        residual=0.01,
        frame_residuals=np.full(len(number), 2.0),
    )


@pytest.fixture(scope='module')
def track(truth: TrackSolution) -> Track:
    """The track of this person's image, without a solution."""
    return make_track(CAMERA.project(truth.compute_joints(ALL) + truth.roots[:, None]))


def keep(truth: TrackSolution, frames: int) -> TrackSolution:
    """Return the solution of the first frames."""
    names = ('theta', 'rotation', 'roots', 'bone_lengths', 'frame_residuals')
    return replace(truth, **{name: getattr(truth, name)[:frames] for name in names})


def predict(stamps_ns: Sequence[int], solution: TrackSolution) -> tuple[Array, Array, Array]:
    """Return theta (K,), rotation (3, 3) and root (3,) that are predicted for the newest frame."""
    theta, rotation, roots = append_prediction(stamps_ns, solution, first=len(solution.theta))
    return theta[0], rotation[0], roots[0]


def reconstruct(
    truth: TrackSolution,
    model: BasePoses,
    observed: ObservedWindow,
    frames: NDArray[np.intp] | slice,
    noise: float = 0.03,
) -> JointReconstruction:
    """Return the true states of some frames as a solver returns them, in the image of the virtual camera."""
    to_virtual = observed.virtual_camera.rotation
    roots = truth.roots[frames] @ to_virtual.T
    rotation = to_virtual @ truth.rotation[frames]
    joints = model.poses(truth.theta[frames]) @ np.swapaxes(rotation, -1, -2)
    return JointReconstruction(
        joints=joints,
        theta=truth.theta[frames],
        cameras=WeakPerspectiveCameras(CAMERA.focal / roots[:, 2], rotation),
        translation=CAMERA.focal * roots[:, :2] / roots[:, 2:],
        residual=np.linspace(1.0, 3.0, len(roots)),
        status=SolverStatus.CONVERGED,
        history=(2e-4, 1e-4),
        iterations=1,
        noise=noise,
        joint_std=np.full(15, 0.04),
    )


def assert_states(solution: TrackSolution, truth: TrackSolution, frames: slice = slice(None)) -> None:
    for name in ('theta', 'rotation', 'roots', 'bone_lengths'):
        assert getattr(solution, name)[frames] == pytest.approx(getattr(truth, name)[frames], abs=1e-9), name


@pytest.mark.parametrize('frames', [[0, 8], [0, 3, 8], [4, 6, 8], list(range(9))])
def test_a_first_solution_is_interpolated_in_the_real_camera_after_the_earlier_states(
    truth: TrackSolution, model: BasePoses, track: Track, frames: list[int]
) -> None:
    observed, chosen = track.observed, np.array(frames)
    result = reconstruct(truth, model, observed, chosen)
    earlier = replace(truth, theta=truth.theta + 1, roots=truth.roots + 2, rotation=truth.rotation[::-1])
    solution = TrackSolution.interpolate(result, observed, chosen, 'a name', model, earlier if frames[0] else None)
    assert_states(solution, truth, slice(frames[0], None))
    assert_states(solution, earlier, slice(frames[0]))
    assert (solution.model_name, solution.noise, solution.frame_residuals[-1]) == ('a name', 0.03, 3.0)
    body_px = np.sqrt((result.joints[-1, :, :2] ** 2).sum(axis=1).mean()) * result.cameras.scale[-1]
    assert solution.residual == pytest.approx(np.sqrt((result.residual**2).mean()) / body_px)


def test_a_refinement_replaces_the_newest_states_and_no_others(
    truth: TrackSolution, model: BasePoses, track: Track
) -> None:
    observed = track.observed
    before = replace(
        truth,
        theta=truth.theta[:-1] + 1,
        roots=truth.roots[:-1] + 2,
        rotation=truth.rotation[1:],
        bone_lengths=truth.bone_lengths[:-1] + 3,
    )
    result = reconstruct(truth, model, observed, slice(5, None))
    solution = before.refine(result, observed, first=5, fixed_frames=1)
    assert len(solution.theta) == FRAMES
    assert_states(solution, truth, slice(6, None))
    for name in ('theta', 'rotation', 'roots', 'bone_lengths'):
        np.testing.assert_array_equal(getattr(solution, name)[:6], getattr(before, name)[:6])
    share = np.exp(-4 / 9)  # of the old noise: 4 of 9 frames were solved
    assert solution.noise**2 == pytest.approx(share * before.noise**2 + (1 - share) * 0.03**2)


def test_joints_between_frames_are_interpolated(truth: TrackSolution) -> None:
    solution, times = replace(truth, stature_ratio=1.1), -np.cumsum(np.linspace(0.02, 0.05, FRAMES))[::-1]
    joints = (solution.compute_joints(ALL) + solution.roots[:, None]) / 1.1
    wanted = np.array([times[0] - 0.01, times[0], -0.17, -0.1, times[4], times[-1]])
    found = solution.sample_joints(times, wanted)
    assert np.isnan(found[0]).all()
    expected = [np.interp(wanted[1:], times, column) for column in joints.reshape(FRAMES, -1).T]
    np.testing.assert_allclose(found[1:].reshape(5, -1).T, expected, atol=1e-12)


def test_poses_of_another_model_approximate_the_same_joints(truth: TrackSolution, walk_model: BasePoses) -> None:
    """A model with all base poses represents the poses of one with some of them; its body frame may be turned."""
    turn = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
    target = replace(walk_model, mean=walk_model.mean @ turn, components=walk_model.components @ turn)
    changed = truth.change_model('turned', target)
    assert changed.model_name == 'turned'
    assert changed.compute_joints(ALL) == pytest.approx(truth.compute_joints(ALL), abs=1e-6)
    assert np.abs(changed.rotation - truth.rotation).max() > 0.1
    np.testing.assert_array_equal(changed.roots, truth.roots)
    assert changed.bone_lengths == pytest.approx(truth.bone_lengths, abs=1e-6)


def test_with_a_lifter_a_new_frame_starts_from_its_lifted_pose(
    truth: TrackSolution, model: BasePoses, track: Track
) -> None:
    solution = keep(truth, FRAMES - 1)
    depth, turn = truth.roots[-1, 2], Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix()
    pose = 0.7 * model.poses(solution.theta[-1] + 0.2 * model.std) @ turn.T / depth
    lifted = np.zeros((FRAMES, 15, 3))
    lifted[-1] = pose - pose.mean(axis=0)
    poses = LiftedPoses(lifted, np.full_like(lifted, 0.001))  # along the real camera's axes, in the units of rays
    observed = replace(track.observed, lifted=poses)
    window = build_refinement_window(track.stamps_ns, observed, solution, first=5, fixed_frames=1)
    assert window.start is not None
    assert window.lifted is not None
    start = window.start.cameras
    joints = model.poses(window.start.theta[-1]) @ start.rotation[-1].T
    size = np.linalg.norm(window.lifted.joints[-1]) / np.linalg.norm(joints)
    assert np.abs(size * joints - window.lifted.joints[-1]).max() < 0.05 * np.abs(window.lifted.joints[-1]).max()
    plain = build_refinement_window(track.stamps_ns, track.observed, solution, first=5, fixed_frames=1)
    assert plain.start is not None
    np.testing.assert_array_equal(start.scale, plain.start.cameras.scale)
    np.testing.assert_array_equal(window.start.theta[:-1], plain.start.theta[:-1])
    lifted[-1, 3, 1] = np.nan  # too few joints were seen for the lifter
    without = build_refinement_window(track.stamps_ns, observed, solution, first=5, fixed_frames=1)
    assert without.start is not None
    np.testing.assert_array_equal(without.start.theta, plain.start.theta)
    np.testing.assert_array_equal(without.start.cameras.rotation, plain.start.cameras.rotation)


def test_the_movement_is_repeated_for_a_limited_time(truth: TrackSolution, model: BasePoses, track: Track) -> None:
    solution, stamps_ns = keep(truth, FRAMES - 1), track.stamps_ns
    steps = np.array([0.5, 1.0, 1.5, 5.0])
    for step in steps:
        newest_ns = stamps_ns[-2] + round(step * STEP_NS)
        theta, rotation, root = predict((*stamps_ns[:-1], newest_ns), solution)
        share = EXTRAPOLATION_SHARE * min(step, MAX_EXTRAPOLATION_STEPS)
        assert theta == pytest.approx(truth.theta[-2] + share * 0.1 * model.std, abs=1e-8)
        assert root == pytest.approx(truth.roots[-2] + share * np.array([0.02, 0.01, 0.05]), abs=1e-8)
        turned = Rotation.from_matrix(rotation @ truth.rotation[-2].T).as_rotvec()
        assert turned == pytest.approx(share * np.array([0.01, 0.04, 0.0]), abs=1e-8)


def test_no_person_is_expected_behind_the_camera(truth: TrackSolution) -> None:
    """At a few frames a second a person who comes towards the camera and stops would be."""
    before, last = np.array([0.3, 0.1, 2.0]), np.array([0.1, 0.1, 0.8])
    first = replace(keep(truth, 2), roots=np.stack([before, last]))
    _, _, root = predict((0, STEP_NS, 2 * STEP_NS), first)
    assert root[2] == pytest.approx((1 - 0.5) * last[2])
    assert root - last == pytest.approx((last - before) / 3)
    stays = predict((0, STEP_NS), keep(truth, 1))
    for found, expected in zip(stays, (truth.theta[0], truth.rotation[0], truth.roots[0]), strict=True):
        assert found == pytest.approx(expected, abs=1e-15), 'after a single solved frame'


def test_newer_frames_move_as_the_person_has_moved(truth: TrackSolution, walk_model: BasePoses) -> None:
    """A found solution that is turned, farther away and in another pose stays so, and moves on."""
    model, dropped, last, after = walk_model, 2, 5, 8
    own = replace(truth, model=model, theta=np.pad(truth.theta, [(0, 0), (0, len(model.std) - COMPONENTS)]))
    turn = Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()
    found = replace(keep(own, last + 1), theta=own.theta[: last + 1] + 0.02, roots=2 * own.roots[: last + 1])
    found.rotation = found.rotation @ turn
    kept, newer = found.drop_oldest(dropped), own.drop_oldest(dropped)
    assert kept is not None
    assert newer is not None
    result = kept.follow(newer)
    assert len(result.theta) == FRAMES - dropped
    np.testing.assert_array_equal(result.theta[: last + 1 - dropped], found.theta[dropped:])
    turned = own.rotation[after] @ own.rotation[last].T
    assert result.rotation[after - dropped] == pytest.approx(turned @ found.rotation[last], abs=1e-12)
    moved = 2 * (own.roots[after] - own.roots[last])
    assert result.roots[after - dropped] == pytest.approx(found.roots[last] + moved, abs=1e-9)
    joints = own.compute_joints(np.array([last, after]))
    expected = found.compute_joints(np.array([last]))[0] + joints[1] - joints[0]
    error = result.compute_joints(np.array([after - dropped]))[0] - expected
    assert (
        np.linalg.norm(error, axis=-1).mean() < 0.25 * np.linalg.norm(joints[1] - joints[0], axis=-1).mean() + 0.01
    )


def test_a_solver_gets_the_solution_in_the_virtual_camera(
    truth: TrackSolution, model: BasePoses, track: Track
) -> None:
    solution = keep(truth, FRAMES - 1)
    frames = np.arange(5, FRAMES)
    window = build_refinement_window(track.stamps_ns, track.observed, solution, first=5, fixed_frames=1)
    expected = reconstruct(truth, model, track.observed, frames)
    _, for_check = select_start(track.observed, truth, frames[:-1])
    for start in (window.start, for_check):
        assert start is not None
        assert start.theta[:3] == pytest.approx(expected.theta[:-1])
        assert start.cameras.scale[:3] == pytest.approx(expected.cameras.scale[:-1])
        assert start.cameras.rotation[:3] == pytest.approx(expected.cameras.rotation[:-1])
    assert window.start is not None
    np.testing.assert_array_equal(window.start.theta[-1], predict(track.stamps_ns, solution)[0])
    assert (window.noise, window.fixed_frames, window.focal) == (0.01, 1, CAMERA.focal)
    assert window.times == pytest.approx(frames / 30)
    assert window.earlier_frames is not None
    assert window.earlier_frames.count == 5
    lengths = model.skeleton.bone_lengths(model.poses(truth.theta[:5])).mean(axis=0)
    assert window.earlier_frames.mean_bone_lengths == pytest.approx(lengths)
