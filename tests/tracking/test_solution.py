# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Solutions of a track: interpolated, of another model, moved on, and refined in their newest frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.engine.motion import sample_joints
from mocap_ros.engine.refinement import NewestFrames
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import HIDDEN_SHARE, expect_stature
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import SolverStatus
from mocap_ros.tracking.refinement import EXTRAPOLATION_SHARE, MAX_EXTRAPOLATION_STEPS, collect_newest_frames
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import BODY_TO_OPTICAL
from tests.support.tracks import CAMERA, STEP_NS, make_track

FRAMES, COMPONENTS = 9, 3
FIRST, FIXED = 5, 1  # frame that a refinement begins with, and how many of its frames stay
STATES = 'theta', 'rotation', 'roots', 'bone_lengths', 'frame_residuals'
ALL = np.arange(FRAMES)


@pytest.fixture(scope='module')
def model(walk_model: BasePoses) -> BasePoses:
    return walk_model.truncate(COMPONENTS)


@pytest.fixture(scope='module')
def truth(model: BasePoses) -> TrackSolution:
    """A person off the optical axis, who moves, turns and bends at constant rates."""
    number = np.arange(float(FRAMES))
    theta = 0.1 * number[:, None] * model.std
    rotation = Rotation.from_rotvec(number[:, None] * [0.01, 0.04, 0.0]).as_matrix() @ BODY_TO_OPTICAL
    roots = np.array([1.5, -0.3, 4.0]) + number[:, None] * [0.02, 0.01, 0.05]
    lengths, residuals = model.skeleton.bone_lengths(model.poses(theta)), np.full(FRAMES, 2.0)
    fit = 0.01, 1.0, np.full(15, 0.02), 0.01
    return TrackSolution('walk', model, theta, rotation, roots, lengths, residuals, *fit)


@pytest.fixture
def track(truth: TrackSolution) -> Track:
    """The track of this person's image, of which all frames but the newest are solved."""
    track = make_track(CAMERA.project(truth.compute_joints(ALL) + truth.roots[:, None]))
    track.solution = keep(truth, FRAMES - 1)
    return track


def keep(truth: TrackSolution, frames: int) -> TrackSolution:
    return replace(truth, **{name: getattr(truth, name)[:frames] for name in STATES})


def reconstruct(truth: TrackSolution, observed: ObservedWindow, frames: NDArray[np.intp]) -> JointReconstruction:
    """Return the true states of some frames as a solver returns them, in the image of the virtual camera."""
    to_virtual = observed.virtual_camera.rotation
    roots = truth.roots[frames] @ to_virtual.T
    rotation = to_virtual @ truth.rotation[frames]
    joints = truth.model.poses(truth.theta[frames]) @ np.swapaxes(rotation, -1, -2)
    return JointReconstruction(
        joints=joints,
        theta=truth.theta[frames],
        cameras=WeakPerspectiveCameras(CAMERA.focal / roots[:, 2], rotation),
        translation=CAMERA.focal * roots[:, :2] / roots[:, 2:],
        residual=np.linspace(1.0, 3.0, len(roots)),
        status=SolverStatus.CONVERGED,
        history=(2e-4, 1e-4),
        iterations=1,
        noise=0.03,
        misfit=0.03,
        joint_std=np.full(15, 0.04),
    )


def assert_states(solution: TrackSolution, truth: TrackSolution, frames: slice = slice(None)) -> None:
    for name in STATES[:4]:
        assert getattr(solution, name)[frames] == pytest.approx(getattr(truth, name)[frames], abs=1e-9), name


@pytest.mark.parametrize('frames', [[0, 8], [0, 3, 8], [4, 6, 8], list(range(9))])
def test_a_first_solution_interpolates(
    truth: TrackSolution, model: BasePoses, track: Track, frames: list[int]
) -> None:
    observed, chosen = track.observed, np.array(frames)
    result = reconstruct(truth, observed, chosen)
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
    (found,) = sample_joints(times[-1] - wanted, [FRAMES - 1], [SimpleNamespace(times=times)], [solution])
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
    error, way = result.compute_joints(np.array([after - dropped]))[0] - expected, joints[1] - joints[0]
    assert np.linalg.norm(error, axis=-1).mean() < 0.25 * np.linalg.norm(way, axis=-1).mean() + 0.01


def collect(track: Track, fixed_frames: int = FIXED) -> NewestFrames:
    return collect_newest_frames([track], [(FIRST, fixed_frames)], track.solved.model)


@pytest.mark.parametrize('step', [0.5, 1.0, 1.5, 5.0])
def test_a_new_frame_continues_movement(step: float, truth: TrackSolution, model: BasePoses, track: Track) -> None:
    track.stamps_ns = *track.stamps_ns[:-1], track.stamps_ns[-2] + round(step * STEP_NS)
    found = collect_newest_frames([track], [(len(track.solved.theta), 0)], track.solved.model)
    to_virtual = track.observed.virtual_camera.rotation
    depth = float(CAMERA.focal / (found.units[0] * np.exp(found.log_scale[-1])))
    share = EXTRAPOLATION_SHARE * min(step, MAX_EXTRAPOLATION_STEPS)
    root = truth.roots[-2] + share * np.array([0.02, 0.01, 0.05])
    assert found.theta[-1] == pytest.approx(truth.theta[-2] + share * 0.1 * model.std, abs=1e-8)
    assert depth == pytest.approx(to_virtual[2] @ root)
    turned = Rotation.from_matrix(to_virtual.T @ found.rotation[-1] @ truth.rotation[-2].T).as_rotvec()
    assert turned == pytest.approx(share * np.array([0.01, 0.04, 0.0]), abs=1e-8)


def test_with_a_lifter_a_new_frame_starts_from_its_lifted_pose(model: BasePoses, track: Track) -> None:
    depth, turn = track.solved.roots[-1, 2], Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix()
    pose = 0.7 * model.poses(track.solved.theta[-1] + 0.2 * model.std) @ turn.T / depth
    lifted, plain = np.zeros((FRAMES, 15, 3)), collect(track)
    lifted[-1] = pose - pose.mean(axis=0)
    # along the real camera's axes, in the units of rays
    track.observed = replace(track.observed, lifted=LiftedPoses(lifted, np.full_like(lifted, 0.001)))
    started = collect(track)
    joints = model.poses(started.theta[-1]) @ started.rotation[-1].T
    size = np.linalg.norm(started.lifted[-1]) / np.linalg.norm(joints)
    assert np.abs(size * joints - started.lifted[-1]).max() < 0.05 * np.abs(started.lifted[-1]).max()
    np.testing.assert_array_equal(started.log_scale, plain.log_scale)
    np.testing.assert_array_equal(started.theta[:-1], plain.theta[:-1])
    assert started.precision == pytest.approx(np.full_like(started.precision, 0.01**-2))
    lifted[-1, 3, 1] = np.nan  # too few joints were seen for the lifter
    without = collect(track)
    np.testing.assert_array_equal(without.theta, plain.theta)
    np.testing.assert_array_equal(without.rotation, plain.rotation)
    assert (without.precision[-1, 3, 1], without.lifted[-1, 3, 1]) == (0, 0)


def test_a_solver_gets_the_solution_in_its_camera(truth: TrackSolution, model: BasePoses, track: Track) -> None:
    found, to_virtual, solved = collect(track), track.observed.virtual_camera.rotation, slice(FIRST, FRAMES - 1)
    roots = truth.roots @ to_virtual.T
    np.testing.assert_array_equal(found.theta[:-1], truth.theta[solved])
    assert found.units[0] * np.exp(found.log_scale[:-1]) == pytest.approx(CAMERA.focal / roots[solved, 2])
    assert found.rotation[:-1] == pytest.approx(to_virtual @ truth.rotation[solved])
    assert found.image == pytest.approx(track.observed.points[FIRST:] / found.units[0])
    assert found.focal == pytest.approx(np.full(FRAMES - FIRST, CAMERA.focal / found.units[0]))
    assert found.times == pytest.approx(np.arange(FIRST, FRAMES) / 30)
    assert (found.is_free.tolist(), found.earlier_frames.tolist()) == ([False, True, True, True], [FIRST])
    lengths = model.skeleton.bone_lengths(model.poses(truth.theta[:FIRST])).mean(axis=0)
    assert found.earlier_lengths[0] == pytest.approx(lengths)
    free = collect(track, fixed_frames=0)
    assert (free.is_free.tolist(), free.earlier_frames.tolist()) == ([True] * 4, [0])


def test_a_refinement_replaces_the_newest_states_and_no_others(
    truth: TrackSolution, model: BasePoses, track: Track, rng: np.random.Generator
) -> None:
    """What the solver found is the truth, in the image of the virtual camera; before, all was wrong.

    Bones may have more depth than those of the pose, by as much as NumPy says too.
    """
    newest, to_virtual, old = collect(track), track.observed.virtual_camera.rotation, track.solved
    rotation, roots = to_virtual @ truth.rotation[FIRST:], truth.roots[FIRST:] @ to_virtual.T
    joints, scale = model.poses(truth.theta[FIRST:]) @ np.swapaxes(rotation, 1, 2), CAMERA.focal / roots[:, 2]
    wrong = old.theta + 1, old.rotation[::-1].copy(), old.roots + 2, old.bone_lengths + 3, old.frame_residuals
    translation = CAMERA.focal * roots[:, :2] / roots[:, 2:]
    body_px = np.sqrt((joints[-1, :, :2] ** 2).sum(axis=1).mean()) * scale[-1]
    lifted = LiftedPoses(np.zeros((FRAMES, 15, 3)), rng.uniform(0, 0.1, (FRAMES, 15, 3)))
    lifted.std[1] = np.nan
    for residual, rms, seen in (([np.nan, 3.0, np.nan, 4.0], 12.5**0.5, lifted), ([np.nan] * 4, np.nan, None)):
        found = truth.theta[FIRST:], rotation, joints, scale, translation, np.array(residual)
        per_bone, start = model.skeleton.stature_per_bone, replace(old, **dict(zip(STATES, wrong, strict=True)))
        people = [FIXED], [replace(track.observed, lifted=seen)], [start]
        ((*states, stature, fit),) = newest.finish(*people, *found, per_bone, HIDDEN_SHARE)
        for name, value, before in zip(STATES[:4], states, wrong, strict=False):
            assert value[FIRST + 1 :] == pytest.approx(getattr(truth, name)[FIRST + 1 :], abs=1e-9), name
            np.testing.assert_array_equal(value[: FIRST + 1], before[: FIRST + 1])
        np.testing.assert_array_equal(states[4], [2.0] * FIRST + residual)
        mean = (states[3] @ per_bone).mean()
        expected = expect_stature(states[3], CMU15, seen, states[2] @ to_virtual[2])
        assert stature == pytest.approx(expected, rel=1e-12)
        assert stature > 1.001 * mean if seen else stature == pytest.approx(mean, rel=1e-12)
        assert fit == pytest.approx(rms / body_px, nan_ok=True)
