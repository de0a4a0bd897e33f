# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People that the tracker gives and predicts: velocities, face, feet and hands, and how certain all of it is; the
filter of the newest frame against its formulas, on exact motion, on noise and at uneven times."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import Config, with_settings, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.engine.motion import MOTION, describe_cores, filter_motion
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Person3D, Posture
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, HIPS
from mocap_ros.solvers.extremities import ExtremityEvidence
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.motion_filter import UNFILTERED
from mocap_ros.tracking.output import Shown, locate_past
from mocap_ros.tracking.prediction import MIN_CLEARANCE_M, predict_people
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.tracker import PeopleTracker
from tests.support.synthetic_walk import CAMERA, STEP_NS, change, feed, make_walk, see

FRAMES = 75  # 2.5 s of the demo, in which the person walks
FIRST = 30  # the first second, until the filter knows the jitter, is not judged


def track_demo(frames: int = FRAMES, **values: object) -> dict[int, Person3D]:
    """Return the person of the demo by the frame that is output; in the last one nothing was detected."""
    config = with_values(Config(), {f'tracker.{name}': value for name, value in values.items()})
    tracker, sequence = PeopleTracker(load_base_pose_models('auto'), config), make_recording().sequence()
    found = {}
    for frame in range(frames + 1):
        seen = [sequence.person(frame)] if frame < frames else []
        tracked = tracker.update(sequence.stamps_ns[frame], seen, sequence.intrinsics(1.0))
        for person in tracked.people:
            found[sequence.stamps_ns.index(tracked.stamp_ns)] = person
        tracker.run_deferred_work()
    return found


@pytest.fixture(scope='module')
def demo() -> dict[int, Person3D]:
    return track_demo()


def true_velocity() -> np.ndarray:
    return central_velocity(make_recording().timestamps, make_recording().truth)


def test_live_velocities_are_better_than_differences_and_as_good_as_they_say(
    demo: dict[int, Person3D],
) -> None:
    truth = true_velocity()
    errors, differences, std = [], [], []
    for frame in range(FIRST, FRAMES):
        person = demo[frame]
        errors.append(np.linalg.norm(person.joint_velocity[:CORE_COUNT] - truth[frame], axis=1))
        difference = (person.core - demo[frame - 1].core) / (STEP_NS / 1e9)
        differences.append(np.linalg.norm(difference - truth[frame], axis=1))
        std.append(person.joint_velocity_std[:CORE_COUNT])
        assert person.age == pytest.approx(frame * STEP_NS / 1e9, abs=1e-6)
        assert person.unseen_for == 0
        assert (np.linalg.eigvalsh(person.root_velocity_covariance) > 0).all()
    assert np.sqrt(np.mean(np.square(errors))) < 0.9 * np.sqrt(np.mean(np.square(differences)))
    assert 0.5 < np.mean(np.array(errors) < np.array(std)) < 0.97


def test_with_a_lag_velocities_are_those_of_the_smooth_solution_without_deviations() -> None:
    people, truth = track_demo(lag=0.2), true_velocity()
    errors = [
        np.linalg.norm(p.joint_velocity[:CORE_COUNT] - truth[f], axis=1) for f, p in people.items() if f >= FIRST
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 0.7 * np.sqrt((truth[FIRST:FRAMES] ** 2).sum(axis=-1).mean())
    assert all(np.isnan(p.joint_velocity_std).all() for p in people.values())


def test_the_position_of_a_body_is_least_certain_along_the_line_of_sight() -> None:
    root, share = np.array([1.0, -0.5, 4.0]), 0.06
    sizes = [BodySize(1.0, share, focal) for focal in (0.0, 0.2)]
    seen = ExtremityEvidence.without_image(np.tile(root, (2, 15, 1)))
    seen = seen._replace(noise=np.full(2, 0.02), weight=np.ones((2, 26)))
    known = np.full((2, 15), 0.01), seen, seen.core, np.array(sizes)
    std, (covariance, wider) = describe_cores(*known, np.full((2, 3), np.nan), np.array(HIPS))
    variances, axes = np.linalg.eigh(covariance)
    own, both = std[0, 0] ** 2, 0.02**2
    expected = [own / 6 + both, own / 6 + both, own * 2 / 3 + both + share**2 * root @ root]
    np.testing.assert_allclose(variances, expected, rtol=1e-9)
    assert abs(axes[:, 2] @ root) == pytest.approx(np.linalg.norm(root))
    np.testing.assert_allclose(wider - covariance, np.diag([0, 0, (0.2 * root[2]) ** 2]), atol=1e-12)
    _, (displaced, _) = describe_cores(*known, np.tile([0.0, 0.1, 0.2], (2, 1)), np.array(HIPS))
    np.testing.assert_allclose(displaced - covariance, np.outer([0, 0.1, 0.2], [0, 0.1, 0.2]), atol=1e-12)
    seen.weight[:, [*HIPS, 2, 3]] = 0
    std, (inferred, _) = describe_cores(*known, np.full((2, 3), np.nan), np.array(HIPS))
    own = (std[0, HIPS[0]] * 15 / 11) ** 2  # the body's origin is where 11 of 15 joints are
    assert np.linalg.eigvalsh(inferred)[:2] == pytest.approx(own / 6 + both)


FACE = [BODY26.index(n) for n in ('nose', 'leye', 'reye', 'lear', 'rear')]


def test_without_face_feet_and_hands_people_have_the_same_core() -> None:
    whole, core = track_demo(24), track_demo(24, skeleton='cmu15')
    for frame in range(25):
        one, other = whole[frame], core[frame]
        assert (one.skeleton, other.skeleton) == (BODY26, CMU15)
        for name in ('joints', 'joint_std', 'inferred', 'joint_velocity', 'joint_orientation', 'turn_inferred'):
            np.testing.assert_array_equal(getattr(one, name)[:CORE_COUNT], getattr(other, name))
        np.testing.assert_array_equal(one.core, other.joints)


def test_what_the_detector_gives_is_seen_and_the_rest_inferred(demo: dict[int, Person3D]) -> None:
    last, predicted = demo[FRAMES - 1], demo[FRAMES]
    others = [j for j in range(CORE_COUNT, len(BODY26.joints)) if j not in FACE]
    given = make_recording().sequence().person(FRAMES - 1)
    scores = dict(zip(given.joints, given.score, strict=True))  # of coco17
    np.testing.assert_array_equal(last.inferred[FACE], [scores[BODY26.joints[j]] < 0.1 for j in FACE])
    assert not last.inferred[FACE].all()
    assert last.inferred[others].all()
    assert predicted.predicted
    assert predicted.inferred.all()
    assert predicted.turn_inferred.all()
    for person in (last, predicted):
        assert (person.joint_std[CORE_COUNT:] > 0).all()
        assert np.isfinite(person.joint_velocity).all()
        assert np.linalg.norm(person.joint_orientation, axis=1) == pytest.approx(np.ones(len(BODY26.joints)))
    before, after = (person.joints - person.core.mean(axis=0) for person in (last, predicted))
    assert np.linalg.norm(after - before, axis=1).max() < 0.15  # m in one frame


SEEN_FRAMES = 20
GAP = 12  # frames without a detection; 0.4 s


def track_walk(
    model: PoseModel, start: list[float], velocity: list[float], vertical: str = 'auto'
) -> tuple[PeopleTracker, Person3D]:
    """Return a tracker of a walk, and its person; start in m in the camera's frame, velocity in m/s."""
    walk = make_walk(model, SEEN_FRAMES)
    poses = walk.poses(model) * Config().tracker.body_height / model.stature
    joints = poses + np.array(start) + walk.times[:, None, None] * np.array(velocity)
    known = {'solver.components': 8, 'tracker.predict_for': 1.0, 'tracker.vertical': vertical}
    tracker = PeopleTracker(model, with_settings(Config(), known))
    last = feed(tracker, CAMERA.project(joints))[-1]
    tracker.run_deferred_work()
    return tracker, last


def predict(track: Track, stamp_ns: int, ratio: float = 1.0) -> Person3D:
    (person,) = predict_people([track], stamp_ns, None, [BodySize(ratio, 0.08)], CMU15)
    return person


def test_a_person_who_walks_on_is_found_farther_on_and_less_certain(walk_model: PoseModel) -> None:
    tracker, last = track_walk(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0])
    soon, late = (tracker.update((SEEN_FRAMES - 1 + gap) * STEP_NS, [], CAMERA).people[0] for gap in (3, GAP))
    assert 0.5 < (late.root - last.root)[0] / (0.9 * 0.4) < 1.3, 'slower, as it walks otherwise than it moves'
    root = late.core.mean(axis=0)
    assert late.translation == pytest.approx(CAMERA.project(root))
    assert late.scale == pytest.approx(CAMERA.focal / root[2])
    assert 0.3 < late.root_velocity[0] < 1.5
    assert late.predicted
    assert late.inferred.all()
    assert late.unseen_for == pytest.approx(0.4, abs=1e-6)
    for before, after in ((last, soon), (soon, late)):
        assert (before.joint_std[:CORE_COUNT] <= after.joint_std[:CORE_COUNT]).all(), 'about the root'
        assert before.joint_std.mean() < after.joint_std.mean()
        assert (np.linalg.eigvalsh(after.root_covariance - before.root_covariance) > 0).all()


@pytest.mark.parametrize(('vertical', 'expected'), [('0', Posture.STANDING), ('none', Posture.UNKNOWN)])
def test_a_walker_stands_until_not_seen_for_long(walk_model: PoseModel, vertical: str, expected: Posture) -> None:
    tracker, last = track_walk(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0], vertical)
    assert last.posture == expected
    assert (last.posture_probability > 0.8) == (expected is Posture.STANDING)
    for away_s, posture in ((0.3, expected), (0.6, Posture.UNKNOWN)):
        (predicted,) = tracker.update((SEEN_FRAMES - 1) * STEP_NS + round(away_s * 1e9), [], CAMERA).people
        assert predicted.posture == posture


def test_who_is_smaller_is_nearer_and_as_much_more_certain(walk_model: PoseModel) -> None:
    tracker, _ = track_walk(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0])
    whole, small = (predict(tracker.tracks[0], (SEEN_FRAMES + GAP) * STEP_NS, ratio) for ratio in (1.0, 0.7))
    for name, power in {'joints': 1, 'joint_std': 1, 'joint_velocity': 1, 'root_covariance': 2}.items():
        np.testing.assert_allclose(getattr(small, name), 0.7**power * getattr(whole, name), rtol=1e-9, atol=1e-9)
    assert small.translation == pytest.approx(whole.translation)


def test_a_person_who_reaches_the_camera_stays_there(walk_model: PoseModel) -> None:
    tracker, _ = track_walk(walk_model, [0.0, 0.0, 4.0], [0.0, 0.0, -2.5])
    (track,) = tracker.tracks
    solution = track.solved
    depth = locate_past(Shown.of([track]))[0][0, :, 2]
    nearer = [0.0, 0.0, depth.max() - 2 * depth.mean() + 0.6]  # m; then some of the way is left
    moved = replace(solution, roots=solution.roots + nearer)
    near = change(track, solution=moved, filters=UNFILTERED)
    predicted = [predict(near, (SEEN_FRAMES + gap) * STEP_NS) for gap in range(20)]
    depth = predicted[-1].joints[:CORE_COUNT, 2]
    assert 2 * depth.mean() - depth.max() == pytest.approx(MIN_CLEARANCE_M, abs=0.01)
    assert predicted[-1].joints[:, 2].min() > 0
    speeds = np.array([person.root_velocity[2] for person in predicted])
    assert speeds[0] < -1
    assert abs(speeds[-1]) < 0.5
    assert speeds.max() < 0.5, 'no jump back to where the person was'
    depths = np.array([person.root[2] for person in predicted])
    assert np.diff(depths).max() < 0.02
    assert depths[-1] < depths[0] - 0.3


def test_ahead_of_the_newest_image_and_through_a_gap_are_one_prediction(walk_model: PoseModel) -> None:
    tracker, _ = track_walk(walk_model, [-0.6, 0.0, 4.0], [0.9, 0.0, 0.0])
    half_way, end = tracker.predict((GAP / 2 / 30, GAP / 30))
    (at_gap,) = tracker.update((SEEN_FRAMES - 1 + GAP // 2) * STEP_NS, [], CAMERA).people
    np.testing.assert_allclose(half_way.joints[0], at_gap.core, atol=1e-6)
    np.testing.assert_allclose(half_way.joint_std[0], at_gap.joint_std[:15], atol=1e-6)
    np.testing.assert_allclose(half_way.root_covariance[0], at_gap.root_covariance, atol=1e-6)
    (from_gap,) = tracker.predict((GAP / 2 / 30,))
    np.testing.assert_allclose(from_gap.joints, end.joints, atol=1e-6)
    assert from_gap.ids == (at_gap.id,)


JOINTS = 15


def filter_states(times: np.ndarray, joints: np.ndarray, image_noise: float = np.inf) -> np.ndarray:
    """Return the filters (F,) `MOTION` of all frames of a person, with an image noise in m at the body."""
    own, filters = np.full((1, MOTION.itemsize // 8), np.nan), []
    for time, pose in zip(times, joints, strict=True):
        filter_pose(own, time, pose, image_noise)
        filters.append(own.copy())
    return np.concatenate(filters).view(MOTION)[:, 0]


def filter_pose(own: np.ndarray, time: float, pose: np.ndarray, image_noise: float) -> np.ndarray:
    """Advance a filter (1, R), and return its joints (15, 3)."""
    known = np.array([time]), pose[None].copy(), np.array([image_noise]), np.array(HIPS)
    return np.asarray(filter_motion(own, *known, is_steady=True)[0][0])


def advance_plainly(
    state: np.ndarray, recent: np.ndarray, times: np.ndarray, max_jitter: float, *, is_centre: bool
) -> np.ndarray:
    """The formulas of the module for one point: state (5, 3), recent (3, 3); the gains are those of the poles."""
    x, v, second, speed, _ = state
    h = times[-1] - times[-2]
    c = np.array([1 / np.prod(np.delete(times[i] - times, i)) for i in range(3)])
    squares = (np.sqrt(6) * c @ recent / np.linalg.norm(c)) ** 2
    second = second + (1 - np.exp(-h / 0.25)) * (np.minimum(squares, 6.0 * second) - second)
    speed = speed + (1 - np.exp(-h / 0.077)) * (v**2 - speed)
    s_0 = 0.2 if is_centre else 0.055
    s = np.sqrt(speed.sum() + s_0**2)
    if is_centre:
        w, constants = np.sqrt(second / 6), (np.full(3, 20.0), 1.0, 0.5)
        factors = (1.1, 1.1, 1.1), (0.14, 0.14, 0.55), 0.07
    else:
        w = np.full(3, min(np.sqrt(second.mean() / 6), max_jitter))
        constants = np.array([46.0, 46.0, 31.0]), 0.5, 6.4
        factors = (1.6, 1.6, 0.5), (0.0, 0.0, 0.62), 0.0
    stiffness, zeta, b = constants
    omega = stiffness * s**0.73 / (w / 0.005) ** 0.45
    poles = np.exp([(-zeta + sign * 1j * np.sqrt(1 - zeta**2)) * omega * h for sign in (1, -1)])
    expected = x + (1 - np.exp(-b * h)) / b * v
    x = expected + (1 - poles[0] * poles[1]).real * (recent[-1] - expected)
    v = np.exp(-b * h) * v + ((1 - poles[0]) * (1 - poles[1])).real / h * (recent[-1] - expected)
    by_jitter, by_speed, floor = factors
    variance = (np.array(by_jitter) * w * omega) ** 2 + (np.array(by_speed) * s) ** 2 + floor**2
    return np.stack([x, v, second, speed, variance])


@pytest.mark.parametrize('max_jitter', [0.002, 1.0])
def test_a_step_is_that_of_the_formulas(rng: np.random.Generator, max_jitter: float) -> None:
    before = np.zeros(1, MOTION)
    state, before['times'] = before['state'][0], [np.nan, 1.0, 1.03]
    state[:] = rng.uniform(0.5, 1, (5, 16, 3))
    state[2] = rng.uniform(1e-5, 1e-3, (16, 3))
    state[1] = rng.uniform(-0.3, 0.3, (16, 3))  # m/s; slow enough for springs that turn by less than a right angle
    state[3] = state[1] ** 2
    state[0] -= [*[state[0, :-1].mean(axis=0)] * 15, [0, 0, -2]]
    before['recent'] = rng.normal(0, 0.02, (3, 16, 3)) + state[0]
    state = state.copy()
    joints = state[0, :-1] + state[0, -1] + rng.normal(0, 0.02, (15, 3))
    filter_pose(before.view(float)[None], 1.07, joints, 2 * max_jitter)
    found, centre = before[0], joints.mean(axis=0)
    np.testing.assert_allclose(found['recent'][2], [*(joints - centre), centre], atol=1e-12)
    for p in range(16):
        points = state[:, p], found['recent'][:, p], np.array([-0.07, -0.04, 0.0])
        expected = advance_plainly(*points, max_jitter, is_centre=p == 15)
        np.testing.assert_allclose(found['state'][:, p], expected, rtol=1e-9)


def test_the_filter_begins_anew_where_another_solution_is_found(rng: np.random.Generator) -> None:
    """Depth from 100 m to 5 m, and after a gap: no filtered frame is on the way."""
    poses = rng.normal(0, 0.3, (1, JOINTS, 3)) + rng.normal(0, 0.01, (40, JOINTS, 3))
    poses[:20] += [0, 0, 100.0]
    poses[20:] += [0, 0, 5.0]
    times = np.arange(40) / 30
    for gap_s in (0.0, 2.0):
        later = times + gap_s * (np.arange(40) >= 20)
        own = np.full((1, MOTION.itemsize // 8), np.nan)
        filtered = [filter_pose(own, time, pose, np.inf) for time, pose in zip(later, poses, strict=True)]
        assert np.abs(filtered - poses).max() < 0.2


@settings(max_examples=40)
@given(
    steps=st.lists(st.floats(1e-6, 30.0), min_size=2, max_size=30),
    size=st.sampled_from([0.0, 1e-9, 0.1, 100.0]),
)
def test_joints_stay_finite_and_variances_positive(steps: list[float], size: float) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    poses = np.random.default_rng(0).normal(0, size, (len(times), JOINTS, 3))
    states = filter_states(times, poses, 0.02)['state']
    assert np.isfinite(states).all()
    assert (states[:, 2:] >= 0).all(), 'mean squares and variances'


def test_the_tracker_filters_its_output_and_nothing_else(walk_model: PoseModel, rng: np.random.Generator) -> None:
    """The joints jitter less; the solution behind them, and what a longer lag shows, are the same."""
    points = make_walk(walk_model, frames=60).points + rng.normal(0, 2, (60, JOINTS, 2))  # px
    outputs, solutions = {}, {}
    for lag, steady in itertools.product((0.0, 0.2), (False, True)):
        values = {'tracker.lag': lag, 'tracker.steady_output': steady, 'solver.prior': 'pca'}
        tracker = PeopleTracker(walk_model, with_settings(Config(), {'solver.components': 8, **values}))
        found = [tracker.update(i * STEP_NS, [see(image)], CAMERA).people for i, image in enumerate(points)]
        outputs[lag, steady] = np.array([frame[0].joints for frame in found if frame])
        solutions[lag, steady] = tracker.tracks[0].solved.theta
    np.testing.assert_array_equal(solutions[0.0, False], solutions[0.0, True])
    np.testing.assert_array_equal(outputs[0.2, False], outputs[0.2, True])
    jitter = [np.abs(np.diff(outputs[0.0, steady][20:], 2, axis=0)).mean() for steady in (False, True)]
    assert jitter[1] < 0.7 * jitter[0]
