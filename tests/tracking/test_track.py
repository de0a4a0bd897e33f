# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tracks: which known person a detection is, frames that come and go, and the solution that follows; solutions
that are interpolated, of another model, moved on, and refined in their newest frames."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.engine.motion import sample_joints
from mocap_ros.engine.refinement import finish_newest
from mocap_ros.engine.terms import Prior
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.keypoints.matching import NEW_ID_GATE, NEW_ID_GATE_GROWTH_PER_S, DetectedBody, match_detections
from mocap_ros.models.base_poses import PoseModel, arrange_model
from mocap_ros.models.joint_std import HIDDEN_SHARE, expect_stature
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint import JointReconstruction
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.objective import pose_problem
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import SolverStatus
from mocap_ros.tracking.refinement import EXTRAPOLATION_SHARE, MAX_EXTRAPOLATION_STEPS, collect_newest_frames
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import (
    BODY_TO_OPTICAL,
    CAMERA,
    MIRROR,
    STEP_NS,
    UPPER,
    change,
    make_detection,
    make_track,
    make_walk,
    see,
)

TRACK_FRAMES = 12


@pytest.fixture(scope='module')
def points(walk_model: PoseModel) -> Array:
    return make_walk(walk_model, TRACK_FRAMES)[2] + [200.0, -50.0]  # px; off the optical axis


@pytest.fixture
def solution() -> TrackSolution:
    number = np.arange(float(TRACK_FRAMES))
    return TrackSolution(
        model_name='walk',
        model=load_base_poses('walk'),
        theta=number[:, None] + [0.1, 0.2],
        rotation=np.eye(3) * (1 + number)[:, None, None],
        roots=np.stack([number, -number, 4 + number], axis=-1),
        bone_lengths=np.tile(number[:, None], 14),
        noise=0.01,
        stature_ratio=1.0,
        joint_std=np.full(15, 0.02),
        residual=0.01,
        frame_residuals=np.full(TRACK_FRAMES, 2.0),
    )


def test_frames_that_are_too_old_leave_the_window_and_the_solution(points: Array, solution: TrackSolution) -> None:
    lifted = LiftedPoses(
        np.arange(TRACK_FRAMES * 45.0).reshape(TRACK_FRAMES, 15, 3), np.ones((TRACK_FRAMES, 15, 3))
    )
    track = make_track(points)
    rays, weight = track.rays, np.linspace(0.2, 1.0, TRACK_FRAMES * 15).reshape(TRACK_FRAMES, 15)
    track.weight, track.observed = weight, replace(track.observed, lifted=lifted)
    track.solution = solution
    track.add_frame(TRACK_FRAMES * STEP_NS, make_detection(points[0]), window_s=5.5 * STEP_NS / 1e9)
    assert track.stamps_ns == tuple(i * STEP_NS for i in range(7, 13))
    np.testing.assert_array_equal(track.rays[:-1], rays[7:])
    np.testing.assert_array_equal(track.weight[:-1], weight[7:])
    assert track.swap_filter.is_swapped.shape == (6, 3)
    assert track.observed.lifted is not None
    np.testing.assert_array_equal(track.observed.lifted.joints, lifted.joints[7:])
    assert track.has_unsolved_frame
    assert track.solved.theta[:, 0] == pytest.approx(np.arange(7, 12) + 0.1)
    assert track.solved.roots[:, 2] == pytest.approx(np.arange(11, 16))
    assert track.solved.rotation[:, 0, 0] == pytest.approx(np.arange(8, 13))
    assert track.solved.bone_lengths[:, 3] == pytest.approx(np.arange(7, 12))
    assert track.first_ns == 0
    track.add_frame(10**11, make_detection(points[0]), window_s=2.0)
    assert len(track.stamps_ns) == 1
    with pytest.raises(ValueError, match='not solved'):
        _ = track.solved


def test_swapped_sides_are_put_right_and_later_frames_may_change_the_decision(points: Array) -> None:
    """The first frame alone cannot show that its sides are swapped; a few more frames can."""
    seen_points = points.copy()
    seen_points[0] = points[0][MIRROR]
    tracks = [make_track(seen_points[: n + 1]) for n in range(TRACK_FRAMES)]
    decisions = [[bool(frame.all()) for frame in t.swap_filter.is_swapped] for t in tracks]
    changed = next(n for n, decision in enumerate(decisions) if decision[0])
    assert 1 < changed < 10
    assert not any(d[0] for d in decisions[:changed])
    before, after = tracks[changed - 1], tracks[changed]
    assert after.observed.rays[0] == pytest.approx(after.rays[0][MIRROR])
    assert before.observed.rays[0] == pytest.approx(after.rays[0])

    for track, frame, is_relabelled in ((before, changed, True), (after, changed + 1, False)):
        lifted = LiftedPoses(np.ones((frame, 15, 3)), np.ones((frame, 15, 3)))
        track.observed = replace(track.observed, lifted=lifted)
        track.schedule.check_at(10**12)
        track.add_frame(frame * STEP_NS, make_detection(seen_points[frame]), window_s=2.0)
        assert (track.observed.lifted is None) is is_relabelled
        assert track.schedule.next_check_ns == (frame * STEP_NS if is_relabelled else 10**12)


@pytest.mark.parametrize('lens', [Distortion(), Distortion('plumb_bob', (-0.1, 0.02, 0.001, -0.001, 0.0))])
def test_a_change_of_the_camera_keeps_the_image(points: Array, solution: TrackSolution, lens: Distortion) -> None:
    track = change(make_track(points), solution=solution)
    other = Intrinsics(650.0, (300.0, 260.0), is_focal_known=True, aspect=1.1, distortion=lens)
    changed = track.copy()
    changed.change_camera(other, focal=650.0)
    assert changed.intrinsics == other
    assert changed.observed.focal == 650.0
    directions = np.concatenate([changed.rays, np.ones((TRACK_FRAMES, 15, 1))], axis=-1)
    assert other.project(directions) == pytest.approx(points, abs=1e-6)
    assert other.project(changed.solved.roots) == pytest.approx(CAMERA.project(track.solved.roots), abs=1e-6)
    assert changed.solved.roots[:, 2] == pytest.approx(track.solved.roots[:, 2] * 650 / 500)
    back = changed.copy()
    back.change_camera(CAMERA, CAMERA.focal)
    assert back.rays == pytest.approx(track.rays, abs=1e-9)
    assert back.observed.virtual_camera.rotation == pytest.approx(track.observed.virtual_camera.rotation, abs=1e-9)
    assert back.solved.roots == pytest.approx(track.solved.roots, abs=1e-7)


def test_the_best_seen_frame_of_each_step_is_selected(points: Array) -> None:
    track = make_track(points)
    track.weight[:, 0] = [0.1, 0.5, 0.9, 0.1, 0.9, 0.2, 0.3, 0.4, 0.8, 0.1, 0.2, 0.0]
    # Steps of 0.1 s about the ages 0, 0.1, 0.2, ... s: frames 0 | 1 to 3 | 4 to 6 | 7 to 9 | 10 and 11
    assert track.select_frames(0.1, 1.0).tolist() == [0, 2, 4, 8, 11], 'the newest frame in any case'
    assert track.select_frames(0.1, 0.25).tolist() == [4, 8, 11]


# the frame in which a person is certain
@pytest.mark.parametrize(('fps', 'frames'), [(5, 3), (10, 3), (25, 3), (30, 3), (60, 5), (100, 8)])
@pytest.mark.parametrize('window_s', [2.0, 0.1])
def test_a_new_track_is_tentative_for_a_while(points: Array, fps: int, frames: int, window_s: float) -> None:
    track = make_track(points[:1])
    tentative = [track.is_tentative]
    for frame in range(1, 12):
        track.add_frame(int(frame * 1e9 / fps), make_detection(points[0]), window_s)
        tentative.append(track.is_tentative)
    if window_s > 1:
        assert tentative == [True] * (frames - 1) + [False] * (13 - frames)
    track.add_frame(10**11, make_detection(points[0]), window_s)
    assert not track.is_tentative, 'who was certain stays so, when all frames have left the window'


@pytest.fixture(scope='module')
def image(walk_model: PoseModel) -> Array:
    return make_walk(walk_model, 1).points[0]


def make_known(image: Array, name: str, given_id: str = '') -> Track:
    return change(make_track(image[None]), id=name, given_id=given_id, is_tentative=False)


def match(tracks: Sequence[Track], *detections: DetectedBody, stamp_ns: int = STEP_NS) -> list[Track | None]:
    """Return the track of each detection in the frame after the first; no person is replaced by another."""
    matches = match_detections(stamp_ns, tracks, detections)
    assert matches.replaced == []
    return matches.tracks


def test_ids_decide_before_the_position(image: Array) -> None:
    ann, bob = make_known(image, 'ann', 'a'), make_known(image + [150, 0], 'bob', 'b')
    detections = [make_detection(image, 'b'), make_detection(image + [150, 0], 'a'), make_detection(image, 'b')]
    assert match((ann, bob), *detections) == [bob, ann]
    left, right = make_known(image - [200, 0], 'left'), make_known(image + [200, 0], 'right')
    unnamed = [make_detection(image + [x, 0]) for x in (205.0, 2.0, -190.0)]
    found = match((left, ann, right), *unnamed)
    assert found == [right, ann, left], 'a detection without an id may be a person who had one'
    assert match((), unnamed[0]) == [None]


def test_an_id_far_away_was_given_to_another_person(image: Array) -> None:
    ann = make_known(image, 'the first ann', 'a')
    assert match((ann,), make_detection(image + [300, 0], 'a')) == [ann]
    far = match_detections(STEP_NS, (ann,), [make_detection(image + [3000, 0], 'a')])
    assert (far.tracks, far.replaced) == ([None], [ann])


@pytest.mark.parametrize('ids', [('', ''), ('x', ''), ('', 'x'), ('x', 'y'), ('a', 'x'), ('x', 'a'), ('a', 'a')])
@pytest.mark.parametrize('known_id', ['a', ''])
def test_two_parts_of_a_person_are_the_person(image: Array, ids: tuple[str, str], known_id: str) -> None:
    ann, bob = make_known(image, 'ann', known_id), make_known(image + [150, 0], 'bob', 'b')
    moved = image + [4, 0]
    parts = [make_detection(moved, name, 0.9 * seen) for name, seen in zip(ids, (UPPER, ~UPPER), strict=True)]
    for both in (parts, parts[::-1]):
        matches = match_detections(STEP_NS, (bob, ann), [*both, make_detection(image + [150, 0], 'b')])
        assert (matches.tracks, matches.replaced) == ([ann, bob], [])
        whole = matches.detections[0]
        assert (whole.weight > 0).all()
        assert CAMERA.focal * whole.rays + CAMERA.center == pytest.approx(moved)
        assert whole.size == pytest.approx(make_detection(moved).size)


def test_a_new_person_beside_another_is_no_part(image: Array) -> None:
    ann = make_known(image, 'ann', 'a')
    new = make_detection(image[:, ::-1] + [40, -30], 'x')  # in another pose, at nearly the same position
    assert match((ann,), make_detection(image, 'a'), new) == [ann, None]


def test_a_new_id_goes_on_with_a_person_who_is_near(image: Array) -> None:
    ann, size = make_known(image, 'a', 'a'), CAMERA.focal * make_detection(image).size
    gate = size * (NEW_ID_GATE + NEW_ID_GATE_GROWTH_PER_S * STEP_NS / 1e9)
    within, beyond = (make_detection(image + [share * gate, 0], 'x') for share in (0.98, 1.02))
    assert (match((ann,), within), match((ann,), beyond)) == ([ann], [None])
    for other in (change(ann, is_tentative=True), make_known(image, 'a'), make_known(image, 'a', 'old')):
        assert match((other,), beyond) == [other], 'whose id was not steady may have another one'


def test_a_person_of_half_the_size_is_not_the_person(image: Array) -> None:
    """A detector that makes a small whole person of half of a person, with the person's id."""
    small = image.mean(axis=0) + (image - image.mean(axis=0)) / 2
    ann, large = make_known(image, 'ann', 'ann'), make_known(small, 'ann', 'ann')
    assert match((ann,), make_detection(small, 'ann')) == [None]
    assert match((large,), make_detection(image, 'ann')) == [large]
    assert match((ann,), make_detection(small, 'ann'), stamp_ns=10**9) == [ann], 'later it may be'


def test_a_known_person_gets_a_detection_sooner_than_a_tentative_one(image: Array) -> None:
    ann, near = make_known(image, 'ann'), make_detection(image + [3, 0])
    ghost = change(make_known(image, 'ghost'), is_tentative=True)
    assert match((ann, ghost), near) == match((ghost, ann), near) == [ann]
    new = change(ghost, stamps_ns=(9 * STEP_NS,))
    found = match((ann, new), near, stamp_ns=10 * STEP_NS)
    assert found == [new], 'but who was lost does not take the detection of a new person'


def test_a_new_person_does_not_make_people_change_their_names(image: Array) -> None:
    """Bob was lost 0.9 s ago, within his reach of where ann is; ghost may be no person, and is nearer."""
    ann, bob = make_known(image, 'ann'), make_known(image + [90, 0], 'bob')
    ann = change(ann, stamps_ns=(27 * STEP_NS,))
    ghost = change(ann, id='ghost', is_tentative=True)
    nearly, another = make_detection(image + [4, 0]), make_detection(image + [3000, 0])
    for tracks in ((ann, bob), (bob, ann), (ann, ghost)):
        for detections in ([nearly], [nearly, another], [another, nearly]):
            found = match(tracks, *detections, stamp_ns=28 * STEP_NS)
            assert found == [ann if d is nearly else None for d in detections]


@pytest.mark.parametrize(('seen', 'is_usable'), [(5, False), (6, True)])
def test_a_detection_needs_enough_joints(image: Array, seen: int, is_usable: bool) -> None:
    person = see(image, score=np.where(np.arange(15) < seen, 0.5, 0.05))
    (detection,) = DetectedBody.from_people([person], CAMERA, min_score=0.1, min_joints=6)
    assert (detection is not None) is is_usable
    if detection is not None:
        assert (detection.weight > 0).sum() == seen
        assert CAMERA.focal * detection.size == pytest.approx(np.sqrt(2 * image[:seen].var(axis=0).mean()))


FRAMES, COMPONENTS = 9, 3
FIRST, FIXED = 5, 1  # frame that a refinement begins with, and how many of its frames stay
STATES = 'theta', 'rotation', 'roots', 'bone_lengths', 'frame_residuals'
ALL = np.arange(FRAMES)


@pytest.fixture(scope='module')
def model(walk_model: PoseModel) -> PoseModel:
    return walk_model.truncate(COMPONENTS)


@pytest.fixture(scope='module')
def truth(model: PoseModel) -> TrackSolution:
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
    truth: TrackSolution, model: PoseModel, track: Track, frames: list[int]
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


@pytest.mark.parametrize('rate', [10, 25, 30, 50])
def test_the_first_frame_of_a_window_is_known_at_every_age(truth: TrackSolution, rate: int) -> None:
    """Stamps count from the person's first frame, so differences of equal times differ in the last digit."""
    for age in range(200):
        times = (age + np.arange(FRAMES)) / rate
        ago = np.array([(FRAMES - 1) / rate])
        assert np.isfinite(sample_joints(ago, [FRAMES - 1], [SimpleNamespace(times=times)], [truth])).all()


def test_poses_of_another_model_approximate_the_same_joints(truth: TrackSolution, walk_model: PoseModel) -> None:
    """A model with all base poses represents the poses of one with some of them; its body frame may be turned."""
    turn = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
    target = replace(walk_model, mean=walk_model.mean @ turn, components=walk_model.components @ turn)
    changed = truth.change_model('turned', target)
    assert changed.model_name == 'turned'
    assert changed.compute_joints(ALL) == pytest.approx(truth.compute_joints(ALL), abs=1e-6)
    assert np.abs(changed.rotation - truth.rotation).max() > 0.1
    np.testing.assert_array_equal(changed.roots, truth.roots)
    assert changed.bone_lengths == pytest.approx(truth.bone_lengths, abs=1e-6)


def test_newer_frames_move_as_the_person_has_moved(truth: TrackSolution, walk_model: PoseModel) -> None:
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


def collect(track: Track, fixed_frames: int = FIXED) -> Batch:
    return collect_newest_frames([track], [(FIRST, fixed_frames)], track.solved.model)


@pytest.mark.parametrize('step', [0.5, 1.0, 1.5, 5.0])
def test_a_new_frame_continues_movement(step: float, truth: TrackSolution, model: PoseModel, track: Track) -> None:
    track.stamps_ns = *track.stamps_ns[:-1], track.stamps_ns[-2] + round(step * STEP_NS)
    found = collect_newest_frames([track], [(len(track.solved.theta), 0)], track.solved.model)
    to_virtual = track.observed.virtual_camera.rotation
    depth = float(CAMERA.focal / (found.sequences['unit'][0] * np.exp(found.log_scale[-1])))
    share = EXTRAPOLATION_SHARE * min(step, MAX_EXTRAPOLATION_STEPS)
    root = truth.roots[-2] + share * np.array([0.02, 0.01, 0.05])
    assert found.theta[-1] == pytest.approx(truth.theta[-2] + share * 0.1 * model.std, abs=1e-8)
    assert depth == pytest.approx(to_virtual[2] @ root)
    turned = Rotation.from_matrix(to_virtual.T @ found.rotation[-1] @ truth.rotation[-2].T).as_rotvec()
    assert turned == pytest.approx(share * np.array([0.01, 0.04, 0.0]), abs=1e-8)


def test_with_a_lifter_a_new_frame_starts_from_its_lifted_pose(model: PoseModel, track: Track) -> None:
    depth, turn = track.solved.roots[-1, 2], Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix()
    pose = 0.7 * model.poses(track.solved.theta[-1] + 0.2 * model.std) @ turn.T / depth
    lifted, plain = np.zeros((FRAMES, 15, 3)), collect(track)
    lifted[-1] = pose - pose.mean(axis=0)
    # along the real camera's axes, in the units of rays
    track.observed = replace(track.observed, lifted=LiftedPoses(lifted, np.full_like(lifted, 0.001)))
    started = collect(track)
    joints = model.poses(started.theta[-1]) @ started.rotation[-1].T
    given = started.frames['lifted'][-1]
    size = np.linalg.norm(given) / np.linalg.norm(joints)
    assert np.abs(size * joints - given).max() < 0.05 * np.abs(given).max()
    np.testing.assert_array_equal(started.log_scale, plain.log_scale)
    np.testing.assert_array_equal(started.theta[:-1], plain.theta[:-1])
    assert started.frames['precision'] == pytest.approx(np.full((4, 15, 3), 0.01**-2))
    lifted[-1, 3, 1] = np.nan  # too few joints were seen for the lifter
    without = collect(track)
    np.testing.assert_array_equal(without.theta, plain.theta)
    np.testing.assert_array_equal(without.rotation, plain.rotation)
    assert (without.frames['precision'][-1, 3, 1], without.frames['lifted'][-1, 3, 1]) == (0, 0)


def test_a_solver_gets_the_solution_in_its_camera(truth: TrackSolution, model: PoseModel, track: Track) -> None:
    found, to_virtual, solved = collect(track), track.observed.virtual_camera.rotation, slice(FIRST, FRAMES - 1)
    roots = truth.roots @ to_virtual.T
    np.testing.assert_array_equal(found.theta[:-1], truth.theta[solved])
    assert found.sequences['unit'][0] * np.exp(found.log_scale[:-1]) == pytest.approx(
        CAMERA.focal / roots[solved, 2]
    )
    assert found.rotation[:-1] == pytest.approx(to_virtual @ truth.rotation[solved])
    assert found.frames['image'] == pytest.approx(track.observed.points[FIRST:] / found.sequences['unit'][0])
    assert found.frames['focal'] == pytest.approx(
        np.full(FRAMES - FIRST, CAMERA.focal / found.sequences['unit'][0])
    )
    assert found.times == pytest.approx(np.arange(FIRST, FRAMES) / 30)
    assert (found.frames['is_free'].tolist(), found.sequences['earlier_frames'].tolist()) == (
        [0, 1, 1, 1],
        [FIRST],
    )
    lengths = model.skeleton.bone_lengths(model.poses(truth.theta[:FIRST])).mean(axis=0)
    assert found.sequences['earlier_lengths'][0] == pytest.approx(lengths)
    free = collect(track, fixed_frames=0)
    assert (free.frames['is_free'].tolist(), free.sequences['earlier_frames'].tolist()) == ([1] * 4, [0])


def test_a_refinement_replaces_the_newest_states_and_no_others(
    truth: TrackSolution, model: PoseModel, track: Track, rng: np.random.Generator
) -> None:
    """What the solver found is the truth, in the image of the virtual camera; before, all was wrong.

    Bones may have more depth than those of the pose, by as much as NumPy says too.
    """
    newest, to_virtual, old = collect(track), track.observed.virtual_camera.rotation, track.solved
    rotation, roots = to_virtual @ truth.rotation[FIRST:], truth.roots[FIRST:] @ to_virtual.T
    joints, scale = model.poses(truth.theta[FIRST:]) @ np.swapaxes(rotation, 1, 2), CAMERA.focal / roots[:, 2]
    wrong = old.theta + 1, old.rotation[::-1].copy(), old.roots + 2, old.bone_lengths + 3, old.frame_residuals
    translation = CAMERA.focal * roots[:, :2] / roots[:, 2:]
    unit, arrays = newest.sequences['unit'][0], arrange_model(model)
    problem = pose_problem(newest, model, (Prior(np.zeros(COMPONENTS)),))
    problem.start(truth.theta[FIRST:], rotation, np.log(scale / unit), translation / unit)
    body_px = np.sqrt((joints[-1, :, :2] ** 2).sum(axis=1).mean()) * scale[-1]
    lifted = LiftedPoses(np.zeros((FRAMES, 15, 3)), rng.uniform(0, 0.1, (FRAMES, 15, 3)))
    lifted.std[1] = np.nan
    for residual, rms, seen in (([np.nan, 3.0, np.nan, 4.0], 12.5**0.5, lifted), ([np.nan] * 4, np.nan, None)):
        per_bone, start = model.skeleton.stature_per_bone, replace(old, **dict(zip(STATES, wrong, strict=True)))
        newest.frames['score'] = np.isfinite(residual)[:, None]
        errors = np.tile((np.array(residual) / unit)[:, None] ** 2, (1, 15))
        people = [FIXED], [replace(track.observed, lifted=seen)], [start]
        bones = per_bone, arrays.parents, arrays.children
        ((*states, stature, fit),) = finish_newest(newest, problem.frames, errors, *people, *bones, HIDDEN_SHARE)
        for name, value, before in zip(STATES[:4], states, wrong, strict=False):
            assert value[FIRST + 1 :] == pytest.approx(getattr(truth, name)[FIRST + 1 :], abs=1e-9), name
            np.testing.assert_array_equal(value[: FIRST + 1], before[: FIRST + 1])
        assert states[4] == pytest.approx([2.0] * FIRST + residual, nan_ok=True)
        mean = (states[3] @ per_bone).mean()
        expected = expect_stature(states[3], CMU15, seen, states[2] @ to_virtual[2])
        assert stature == pytest.approx(expected, rel=1e-12)
        assert stature > 1.001 * mean if seen else stature == pytest.approx(mean, rel=1e-12)
        assert fit == pytest.approx(rms / body_px, nan_ok=True)
