# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Solutions of a track: states in the real camera, kept frames and other models."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import SolverStatus
from mocap_ros.tracking.solution import (
    TrackSolution,
    select_start,
)
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import BODY_TO_OPTICAL
from tests.support.tracks import CAMERA, make_track

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


def test_joints_between_frames_are_interpolated(truth: TrackSolution) -> None:
    solution, times = replace(truth, stature_ratio=1.1), -np.cumsum(np.linspace(0.02, 0.05, FRAMES))[::-1]
    joints = (solution.compute_joints(ALL) + solution.roots[:, None]) / 1.1
    wanted = np.array([times[0] - 0.01, times[0], -0.17, -0.1, times[4], times[-1]])
    found = solution.sample_joints(times, FRAMES - 1, times[-1] - wanted)
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


def test_a_check_gets_the_solution_in_the_virtual_camera(
    truth: TrackSolution, model: BasePoses, track: Track
) -> None:
    frames = np.array([1, 4, 8])
    _, start = select_start(track.observed, truth, frames)
    expected = reconstruct(truth, model, track.observed, frames)
    assert start.theta == pytest.approx(expected.theta)
    assert start.cameras.scale == pytest.approx(expected.cameras.scale)
    assert start.cameras.rotation == pytest.approx(expected.cameras.rotation)
