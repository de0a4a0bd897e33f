# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vertical of a camera: what poses show of it, what is given, and cameras that are turned; the floor."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.config import Config, TrackerConfig, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import MAX_CERTAIN_STD, Floor, build_world
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.models.upward_direction import Stances
from mocap_ros.offline.floor import share_floor
from mocap_ros.offline.whole_sequence import Solved
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.solvers import vertical as module
from mocap_ros.solvers.floor import HEEL_M, SIZE_RANGE, TOE_M, FloorFit, Stander, fit_floor
from mocap_ros.solvers.image_roll import CameraSide, find_camera_roll, find_sides
from mocap_ros.solvers.vertical import Vertical, find_vertical, read_given_vertical, turn_towards_vertical
from mocap_ros.tracking.tracker import PeopleTracker
from tests.support.bodies import UPRIGHT, angles_deg
from tests.support.synthetic_walk import CAMERA, STEP_NS, feed, make_sequence, make_walk, with_scores
from tests.support.whole_sequence import reconstruct_sequence

UP = np.array([0.0, -math.cos(0.3), -math.sin(0.3)])  # of a camera that looks down by 17 degrees
LEVEL = np.array([0.0, -math.cos(math.radians(10)), -math.sin(math.radians(10))])  # where nobody stands


def scatter(rng: np.random.Generator, count: int, std_deg: float, up: np.ndarray = UP) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(std_deg) * rng.normal(size=(count, 3))).apply(up)


def show(upward: np.ndarray, standing: np.ndarray | float = 1.0, seen: float = 1.0) -> Stances:
    count = len(upward)
    return Stances(upward, np.array(np.broadcast_to(standing, count), float), np.full(count, seen))


def advance(vertical: Vertical | None, upward: np.ndarray, standing: float = 1.0, seen: float = 1.0) -> Vertical:
    for directions in upward:
        stances = show(directions, standing, seen)
        if vertical is None:
            vertical = Vertical.begin(STEP_NS, stances)
        else:
            vertical = vertical.advance(vertical.stamp_ns + STEP_NS, stances)
    assert vertical is not None
    return vertical


def test_several_people_make_the_vertical_more_certain_than_one(rng: np.random.Generator) -> None:
    upward = scatter(rng, 900, 8.0).reshape(300, 3, 3)
    together, alone = advance(None, upward), advance(None, upward[:, :1])
    later = alone.advance(alone.stamp_ns + 30 * 10**9, show(scatter(rng, 1, 4.0)))
    assert later.std > alone.std
    assert angles_deg(together.direction, UP) < 2
    assert 0 < together.std < alone.std < advance(None, upward[:3, :1]).std == math.radians(module.MAX_STD_DEG)


def test_who_lies_does_not_change_the_vertical(rng: np.random.Generator) -> None:
    upright, lying = scatter(rng, 300, 4.0), scatter(rng, 300, 4.0, np.array([1.0, 0.0, 0.0]))
    learned = advance(None, upright[:, None])
    misled = advance(learned, lying[:100, None])
    assert angles_deg(misled.direction, UP) < 3
    both = np.concatenate([lying[:100], upright])
    directions, _ = find_vertical(np.arange(400) / 30, show(both))
    assert angles_deg(directions, UP).max() < 3


def test_who_sits_hardly_counts(rng: np.random.Generator) -> None:
    leaning = Rotation.from_rotvec([math.radians(22), 0, 0]).apply(UP)
    seated, upright = scatter(rng, 1800, 4.0, leaning), scatter(rng, 150, 4.0)
    only_seated = advance(None, seated.reshape(450, 4, 3), standing=0.0)
    assert angles_deg(only_seated.direction, LEVEL) < 2, 'a level camera is likelier'
    assert only_seated.std == math.radians(module.MAX_STD_DEG), 'however many sit, and however long'
    alone = advance(None, seated[:, None], standing=0.0)
    assert angles_deg(advance(alone, upright[:, None]).direction, UP) < 4
    both, standing = np.concatenate([seated, upright]), np.repeat([0.0, 1.0], [1800, 150])
    directions, std = find_vertical(np.arange(1950) / 30, show(both, standing))
    assert angles_deg(directions[-1], UP) < 4
    assert std[-1] < math.radians(6)
    assert std[0] > MAX_CERTAIN_STD


@pytest.mark.parametrize(('pitch_deg', 'is_certain'), [(-10, True), (10, True), (35, True), (48, False)])
def test_lifted_poses_err_towards_usual_cameras_and_few_look_far_down(pitch_deg: float, is_certain: bool) -> None:
    pitch = math.radians(pitch_deg)
    upward = np.tile([0.0, -math.cos(pitch), -math.sin(pitch)], (300, 1))
    directions, std = find_vertical(np.arange(300) / 30, show(upward))
    live = advance(None, upward[:, None])
    for direction, std_rad in ((live.direction, live.std), (directions[150], std[150])):
        shown_deg = math.degrees(math.atan2(-direction[2], -direction[1]))
        assert shown_deg == pytest.approx(10 + (1 + module.SHRINKAGE) * (pitch_deg - 10), abs=0.3)
        assert (std_rad < MAX_CERTAIN_STD) == is_certain
        assert std_rad > math.radians(module.BODY_STD_DEG)


def test_inferred_legs_show_no_balance(rng: np.random.Generator) -> None:
    """Straight legs that nobody saw are those of usual people: the camera may be any before seated people."""
    upward = scatter(rng, 300, 4.0)
    live = advance(None, upward[:, None], seen=0.0)
    directions, std = find_vertical(np.arange(300) / 30, show(upward, seen=0.0))
    for direction, std_rad in ((live.direction, live.std), (directions[150], std[150])):
        assert angles_deg(direction, LEVEL) < 1
        assert std_rad == pytest.approx(math.radians(module.MAX_STD_DEG))


@pytest.mark.parametrize('seen', [1.0, 0.0])
@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize('lying', [(1.0, 0.1, 0.0), (0.1, -0.1, 0.99), (0.1, 0.99, -0.1)])
def test_where_nobody_is_upright(
    rng: np.random.Generator, lying: tuple[float, float, float], sign: float, seen: float
) -> None:
    standing = np.full(90, float(sign > 0))  # where the image was turned, those with bent hips may lie as well
    stances = show(scatter(rng, 90, 4.0, np.array(lying) * [1, sign, 1]), standing, seen)
    half_turn = np.array([sign, sign, 1.0])
    turned = stances._replace(upward=stances.upward * half_turn)
    directions, std = find_vertical(np.arange(90) / 30, turned, is_turned=sign < 0)
    directions = directions * half_turn
    live = Vertical.begin(0, Stances(*(shown[:1] for shown in stances)), sign)
    live = live.advance(STEP_NS, Stances(*(shown[1:2] for shown in stances)), sign)
    for direction, std_rad in ((directions[40], std[40]), (live.direction, live.std)):
        assert angles_deg(direction, LEVEL * [1, sign, 1]) < 3
        assert std_rad == pytest.approx(math.radians(module.ASKEW_STD_DEG), rel=0.03)


def test_a_camera_that_was_tilted_is_forgotten(rng: np.random.Generator) -> None:
    tilted = np.array([0.0, -math.cos(0.6), -math.sin(0.6)])  # by 17 degrees more
    before, after = scatter(rng, 600, 4.0), scatter(rng, 1800, 4.0, tilted)
    assert angles_deg(advance(advance(None, before[:, None]), after[:, None]).direction, tilted) < 2
    directions, _ = find_vertical(np.arange(2400) / 30, show(np.concatenate([before, after])))
    assert angles_deg(directions[0], UP) < 12, 'about half of the tilt: later frames count a little'
    assert angles_deg(directions[-1], tilted) < 2


def test_whole_sequences_do_not_depend_on_the_direction_of_time(rng: np.random.Generator) -> None:
    times, steady = np.cumsum(rng.uniform(0.02, 0.05, 100)), np.arange(100) / 30
    upward = scatter(rng, 100, 6.0)
    upward[10:20] = np.nan
    forward, std = find_vertical(steady, show(upward))
    backward, _ = find_vertical(steady, show(upward[::-1].copy()))
    assert forward == pytest.approx(backward[::-1], abs=1e-6)
    assert np.isfinite(std).all()
    known, _ = find_vertical(times, show(upward))
    assert np.isfinite(known).all(), 'also where the person is not'
    unknown, unknown_std = find_vertical(times, show(np.full((100, 3), np.nan), np.nan))
    assert np.isnan(unknown).all()
    assert np.isnan(unknown_std).all()
    assert np.isfinite(find_vertical(times[:1], show(upward[:1]))[0]).all(), 'one frame'


def make_pose(knee: tuple[float, float], ankle: tuple[float, float]) -> np.ndarray:
    """(15, 3) m in optical axes, of a person who faces the camera, with y and z of knees and ankles."""
    pose = np.zeros((15, 3))
    for joint, *yz in (('neck', -0.5, 0.0), ('knee', *knee), ('ankle', *ankle)):
        for name in (joint, 'l' + joint, 'r' + joint):
            if name in CMU15.joints:
                pose[CMU15.joints.index(name), 1:] = yz
    return pose


NO_TURN = np.tile(np.eye(3), (2, 1, 1))
POSES = {'standing': make_pose((0.4, 0.0), (0.8, 0.0)), 'seated': make_pose((0.05, -0.4), (0.45, -0.4))}


def test_thighs_and_trunk_show_who_stands() -> None:
    walking = POSES['standing'].copy()
    walking[CMU15.joints.index('lknee')] = POSES['seated'][CMU15.joints.index('lknee')]  # one leg is raised
    unknown, waving = np.full((15, 3), np.nan), POSES['standing'].copy()
    waving[CMU15.joints.index('lwrist'), 1] = -1.0
    hanging = waving.copy()
    hanging[CMU15.joints.index('rwrist'), 1] = -1.0
    shares = Stances.of(np.stack([*POSES.values(), walking, waving, hanging, unknown])).standing
    assert shares[:5].tolist() == [1, 0, 1, 1, 0]
    assert np.isnan(shares[5])


@pytest.mark.parametrize(
    ('unseen', 'expected'),
    [((), 1), (('lankle', 'rankle'), 1), (('lknee',), 0.5), (('lknee', 'rknee'), 0), (('lhip', 'lknee'), 0)],
)
def test_a_stance_needs_hips_and_knees(unseen: tuple[str, ...], expected: float) -> None:
    weight = np.array([[float(joint not in unseen) for joint in CMU15.joints]])
    assert Stances.of(POSES['standing'][None], weight=weight).seen == expected


def test_the_lifter_gets_a_vertical_for_those_who_stand_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = np.stack([*POSES.values()])

    def lift(_: Lifter, *args: np.ndarray | float) -> LiftedPoses:  # 1 m higher under a vertical
        is_given = len(args) > 3
        return LiftedPoses(poses - [0, is_given, 0], np.full_like(poses, 2.0 if is_given else 1.0))

    monkeypatch.setattr(Lifter, 'lift', lift)
    lifter, history = load_prior_lifter('learned', CMU15), (np.zeros((2, 1, 15, 2)), np.ones((2, 1, 15)))
    assert lifter is not None
    lifted = module.lift_under_vertical(lifter, *history, (np.tile(UP, (2, 1)), np.full(2, 0.02)))
    assert lifted.joints == pytest.approx(np.stack([POSES['standing'] - [0, 1, 0], POSES['seated']]))
    assert lifted.std[:, 0, 0].tolist() == [2, 1]
    assert module.lift_under_vertical(lifter, *history, None).joints == pytest.approx(poses)


def test_poses_are_turned_towards_the_vertical_by_how_uncertain_their_depths_are() -> None:
    turned = []
    for depth_std in (0.02, 0.2):
        noise = np.random.default_rng(0).normal(scale=0.03, size=(2, 15, 3))
        lifted = LiftedPoses(POSES['standing'] + noise, np.tile([0.02, 0.02, depth_std], (2, 15, 1)))
        angles = np.array([0.1, -0.05])
        stances = Stances.of(lifted.joints)
        unseen = stances._replace(seen=np.zeros(2))
        vertical = Rotation.from_rotvec(angles[:, None] * [1, 0, 0]).apply(stances.upward)
        joints = turn_towards_vertical(lifted, stances, NO_TURN, vertical, np.full(2, 0.03)).joints
        unturned = turn_towards_vertical(lifted, unseen, NO_TURN, vertical, np.full(2, 0.03)).joints
        assert unturned == pytest.approx(lifted.joints)
        turn = Rotation.from_matrix(fit_rotation(lifted.joints, joints)).as_rotvec()
        assert turn[:, 1:] == pytest.approx(0, abs=1e-9), 'about the horizontal axis alone'
        turned.append(turn[:, 0] / angles)
    assert (turned[0] > 0).all()
    assert (turned[0] < 0.3).all()
    assert ((turned[1] > 0.5) & (turned[1] < 1)).all()
    lying = Rotation.from_rotvec([1.2, 0, 0]).apply(stances.upward)
    assert turn_towards_vertical(lifted, stances, NO_TURN, lying, np.full(2, 0.03)).joints == pytest.approx(
        lifted.joints
    )


def test_a_given_vertical_is_never_changed_by_what_people_do(rng: np.random.Generator) -> None:
    given_vertical = read_given_vertical(TrackerConfig(vertical='0 -0.8, -0.6'))
    assert given_vertical is not None
    assert given_vertical.direction == pytest.approx([0, -0.8, -0.6])
    assert given_vertical.std == pytest.approx(math.radians(module.GIVEN_STD_DEG))
    assert given_vertical.advance(10**9, show(scatter(rng, 3, 5.0))) is given_vertical
    assert given_vertical.forget() is given_vertical
    assert advance(None, scatter(rng, 3, 5.0)[:, None]).forget() is None
    assert read_given_vertical(TrackerConfig()) is None
    assert read_given_vertical(TrackerConfig(vertical='none')) is None


@pytest.mark.parametrize(
    'text', ['', 'up', '0 -1', '0 -1 0 0', '0 0 0', '0 -9.81 0', 'nan 0 1', '0 inf 0', 'AUTO']
)
def test_a_vertical_that_is_no_unit_vector_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r'tracker\.vertical = '):
        read_given_vertical(TrackerConfig(vertical=text))


FRAMES = 30
WRISTS = [CMU15.index(name) for name in ('lwrist', 'rwrist')]
STANDING, TURNED, OTHER = (True, False), (False, True), (False, False)


@pytest.fixture(scope='module')
def points(walk_model: PoseModel) -> Array:
    return make_walk(walk_model, FRAMES)[2]


def turn(points: Array, roll: float, camera: Intrinsics = CAMERA) -> Array:
    """Return points (..., 2) px turned clockwise about the principal point by an angle in rad."""
    matrix = np.array([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    return (points - camera.center) @ matrix.T + camera.center


@pytest.mark.parametrize(
    ('angle_deg', 'wrists', 'unseen', 'expected'),
    [
        (0, 'down', (), STANDING),
        (30, 'down', (), STANDING),
        (90, 'down', (), OTHER),  # lies, or the camera is on its side
        (-170, 'down', (), TURNED),
        (180, 'raised', (), OTHER),  # stands on the hands
        (0, 'raised', (), STANDING),
        (180, 'down', ('lwrist',), TURNED),
        (180, 'down', ('lwrist', 'rwrist'), OTHER),
        (180, 'down', ('lknee', 'rknee', 'lankle', 'rankle'), TURNED),
        (180, 'down', ('head', 'neck', 'lshoulder', 'rshoulder'), OTHER),
    ],
)
def test_who_is_upside_down_and_not_on_the_hands_shows_the_camera_upside_down(
    points: Array, angle_deg: float, wrists: str, unseen: tuple[str, ...], expected: tuple[bool, bool]
) -> None:
    body = points[:1].copy()
    if wrists == 'raised':
        head, pelvis = (body[:, CMU15.index(name)] for name in ('head', 'pelvis'))
        body[:, WRISTS] = (head + 0.5 * (head - pelvis))[:, None]
    weight = np.where(np.isin(CMU15.joints, unseen), 0.0, 0.9)[None]
    rays = (turn(body, math.radians(angle_deg)) - CAMERA.center) / CAMERA.focal
    assert tuple(bool(side[0]) for side in find_sides(rays, weight)) == expected


def test_a_somersault_does_not_turn_a_camera_and_a_wrong_start_is_mended(points: Array) -> None:
    upright = points[:1] - CAMERA.center
    weight, times = np.ones((1, 15)), np.arange(60) / 30
    for turned, at_once in ((range(0), False), (range(10, 22), False), (range(2), True)):
        side, found = CameraSide(), []
        for frame in range(60):
            side.advance(frame * STEP_NS, -upright if frame in turned else upright, weight)
            found.append(side.is_upside_down)
        assert (found[0], found[-1]) == (at_once, False)
        assert sum(np.diff(found)) <= 1
        body = np.where(np.isin(np.arange(60), turned)[:, None, None], -upright, upright)
        assert find_camera_roll(body, np.ones((60, 15)), times) == 0
    short = np.tile(-upright, (5, 1, 1))
    assert find_camera_roll(short, np.ones((5, 15)), times[:5]) == math.pi


@pytest.mark.parametrize('roll_deg', [90.0, -90.0])
@pytest.mark.parametrize('lengths', [0.5, 2.0])
def test_who_travels_across_the_body_shows_a_turned_camera(points: Array, roll_deg: float, lengths: float) -> None:
    body = points - CAMERA.center
    body = body - body.mean(axis=1, keepdims=True)
    height, along = np.ptp(body[0, :, 1]), np.linspace(0, 1, FRAMES)[:, None]
    body[..., 0] += lengths * height * along
    roll = math.radians(roll_deg)
    turned = turn(body, -roll, Intrinsics(1.0, (0.0, 0.0), is_focal_known=True))
    found = find_camera_roll(turned, np.ones((FRAMES, 15)), np.arange(FRAMES) / 30)
    assert found == pytest.approx(roll if lengths > 1 else 0.0)


@pytest.mark.parametrize(('roll_deg', 'is_given'), [(180, True), (90, True), (-35, True), (180, False)])
def test_people_turn_with_a_camera(walk_model: PoseModel, points: Array, roll_deg: float, is_given: bool) -> None:
    """With the vertical given, and without for a camera that is upside down; whole and live."""
    roll = math.radians(roll_deg)
    rotation = Rotation.from_rotvec([0, 0, roll])
    found: list[list[Array]] = []
    for angle in (0.0, roll):
        up = Rotation.from_rotvec([0, 0, angle]).apply([0.0, -1.0, 0.0])
        config = with_values(Config(), {'tracker.vertical': ' '.join(map(str, up)) if is_given else 'auto'})
        keypoints, times = with_scores(turn(points, angle)), np.arange(FRAMES) / 30
        whole = reconstruct_sequence(make_sequence(keypoints, times, CAMERA), walk_model, config)
        live = [person.core for person in feed(PeopleTracker(walk_model, config), keypoints[..., :2])]
        found.append([whole.core, np.array(live), whole.vertical])
    for upright, turned in zip(*found, strict=True):
        off = np.abs(turned - rotation.apply(upright.reshape(-1, 3)).reshape(upright.shape))
        assert np.quantile(off, 0.95) < 3e-3, 'm'
        assert off.max() < 0.05, 'm; a check may be decided a frame earlier or later'


FLOOR_FRAMES, CAMERA_HEIGHT_M = 240, 1.6
TIMES = np.arange(FLOOR_FRAMES) / 30
UPWARD = Rotation.from_euler('xz', [-12.0, 3.0], degrees=True).apply([0.0, -1.0, 0.0])
CONTACT = np.ones((FLOOR_FRAMES, 4))
SEEN_TWICE = np.where(np.arange(FLOOR_FRAMES) < 2, 1.0, np.nan)[:, None, None]


def stand(camera_height: float = CAMERA_HEIGHT_M) -> Array:
    """Joints (F, 26, 3) m in the camera of a person who slides about on a floor, from 3 to 6 m away."""
    body = np.zeros((26, 3))  # m, over the floor: x right, y ahead, z up
    body[:15] = UPRIGHT[:, [1, 0, 2]] * [-1, 1, 1]
    for side in 'lr':
        x = body[BODY26.index(side + 'ankle'), 0]
        body[BODY26.index(side + 'heel')] = x, -0.05, HEEL_M
        body[BODY26.index(side + 'toe')] = x, 0.2, TOE_M
    way = np.stack([np.sin(TIMES), 4.5 + 1.5 * np.cos(0.8 * TIMES), 0 * TIMES], axis=1)
    in_world = body + way[:, None] - [0.0, 0.0, camera_height]
    level = in_world * [1, 1, -1]
    return level[..., [0, 2, 1]] @ Rotation.align_vectors([UPWARD], [[0.0, -1.0, 0.0]])[0].as_matrix().T


def fit_to(joints: Array, floor: Floor) -> FloorFit:
    fit = fit_floor([Stander(joints, CONTACT, TIMES, 0.08)], floor)
    assert fit is not None
    return fit


def test_a_known_height_gives_size_distance_and_vertical() -> None:
    true = stand()
    wrong_depth = 1 + 0.02 * np.sin(TIMES / 0.7)[:, None, None]
    joints = true / 1.12 * wrong_depth
    lean = Rotation.from_rotvec([0.02, 0.0, 0.0]).apply(UPWARD)
    fit = fit_to(joints, Floor(lean, CAMERA_HEIGHT_M, math.radians(2)))
    assert fit.sizes[0] == pytest.approx(1.12, abs=0.03)
    assert math.acos(fit.floor.upward @ UPWARD) < 0.006 < 0.02
    exact = fit_to(joints, Floor(UPWARD, CAMERA_HEIGHT_M))
    assert exact.sizes[0] == pytest.approx(1.12, abs=0.01)
    placed = exact.place(0, joints)
    assert np.abs(placed - true).max() < 0.1
    assert np.abs(placed - true).mean() < 0.6 * np.abs(joints * 1.12 - true).mean()

    for height, low, high in ((3.2, SIZE_RANGE[1], math.inf), (0.4, 0.0, SIZE_RANGE[0])):
        wrong = fit_to(joints, Floor(UPWARD, height))
        assert low < wrong.sizes[0] <= high


def test_a_floor_is_found_by_feet_and_leaves_the_size() -> None:
    fit = fit_to(stand(), Floor(UPWARD, None, math.radians(4)))
    assert fit.sizes[0] == 1.0
    assert fit.floor.camera_height == pytest.approx(CAMERA_HEIGHT_M, abs=0.01)
    assert 0.08 * CAMERA_HEIGHT_M < fit.floor.height_std < 0.3
    assert fit.floor.tilt_std < math.radians(4)
    world = build_world(stand(), fit.floor.upward, fit.floor.camera_height)
    in_world = stand() @ world[:3, :3].T + world[:3, 3]
    assert in_world[:, BODY26.index('lheel'), 2] == pytest.approx(HEEL_M, abs=0.01)
    assert in_world[0, BODY26.index('pelvis'), :2] == pytest.approx(0.0, abs=1e-9)
    ahead = in_world[0, BODY26.index('ltoe')] - in_world[0, BODY26.index('lheel')]
    assert ahead[:2] == pytest.approx([0.25, 0.0], abs=1e-6)
    assert world[:3, :3] @ world[:3, :3].T == pytest.approx(np.eye(3))
    assert np.linalg.det(world[:3, :3]) == pytest.approx(1.0)


def test_several_people_stand_on_one_floor_in_one_world() -> None:
    people = [stand() * 0.95, (stand() + np.cross(UPWARD, [0.0, 0.0, 1.0])) * 1.05]
    found = []
    for joints in people:
        poses = PoseSequence(
            id='',
            times=TIMES,
            skeleton=BODY26,
            joints=joints,
            inferred=np.zeros((FLOOR_FRAMES, 26), bool),
            reprojection_residual=np.zeros(FLOOR_FRAMES),
            intrinsics=CAMERA,
            vertical=np.tile(UPWARD, (FLOOR_FRAMES, 1)),
            vertical_std=np.full(FLOOR_FRAMES, math.radians(3.0)),
            body_height=1.0,
        )
        found.append(Solved(poses, CONTACT))
    one, other = (person.poses for person in found)
    lain = Rotation.from_rotvec([0.1, 0.0, 0.0]).apply(one.vertical)
    found.append(Solved(replace(one, vertical=lain, vertical_std=2 * TIMES), CONTACT * np.nan))
    above = Solved(replace(other, joints=other.joints + 0.8 * UPWARD), CONTACT)
    for people_found in ([found[0], above], [above, found[0]]):  # one stands on a platform
        apart, faults = share_floor(people_found, TrackerConfig())
        assert [(p.body_height, p.camera_height) for p in apart] == [(1.0, None)] * 2
        assert not faults
    opposite = Solved(replace(other, vertical=-one.vertical), CONTACT)
    assert all(p.camera_height is None for p in share_floor([found[0], opposite], TrackerConfig())[0])
    (first, second, unknown), _ = share_floor(found, TrackerConfig())
    assert (unknown.vertical == first.vertical).all()
    assert (unknown.body_height, unknown.camera_height) == (1.0, first.camera_height)
    assert (unknown.world_from_camera == first.world_from_camera).all()
    assert (first.body_height, second.body_height) == pytest.approx((1 / 0.95, 1 / 1.05), abs=0.015)
    assert [first.camera_height, second.camera_height] == pytest.approx([CAMERA_HEIGHT_M] * 2, rel=0.03)
    assert (first.world_from_camera == second.world_from_camera).all()
    for result, joints, size in ((first, people[0], 1 / 0.95), (second, people[1], 1 / 1.05)):
        world = result.world_from_camera
        heels = result.joints[:, BODY26.index('lheel')] @ world[:3, :3].T + world[:3, 3]
        assert heels[:, 2] == pytest.approx(HEEL_M, abs=0.02)
        bodies = [np.linalg.norm(j[:, 0] - j[:, 1], axis=1).mean() for j in (result.joints, joints)]
        assert bodies[0] / bodies[1] == pytest.approx(size, abs=0.015)


def sit(joints: Array) -> Array:
    """Return joints with the knees in front of the hips."""
    bent = joints.copy()
    for side in 'lr':
        hip, knee = BODY26.index(side + 'hip'), BODY26.index(side + 'knee')
        bent[:, knee] = bent[:, hip]
        bent[:, knee, 2] -= np.linalg.norm(joints[:, knee] - joints[:, hip], axis=1)
    return bent


@pytest.mark.parametrize(
    ('joints', 'contact', 'tilt_deg'),
    [
        pytest.param(stand(), CONTACT * 0.5, 3.0, id='no foot stands'),
        pytest.param(stand(), CONTACT * np.nan, 3.0, id='feet not seen'),
        pytest.param(stand() * np.nan, CONTACT, 3.0, id='not seen'),
        pytest.param(stand() * SEEN_TWICE, CONTACT, 3.0, id='two frames'),
        pytest.param(stand(), CONTACT, 25.0, id='vertical not known'),
        pytest.param(stand(), CONTACT, math.nan, id='no vertical'),
        pytest.param(sit(stand()), CONTACT, 3.0, id='seated'),
        pytest.param(stand(-1.0), CONTACT, 3.0, id='above the camera'),
    ],
)
def test_nothing_shows_a_floor(joints: Array, contact: Array, tilt_deg: float) -> None:
    assert fit_floor([Stander(joints, contact, TIMES, 0.08)], Floor(UPWARD, None, math.radians(tilt_deg))) is None


def test_a_world_without_floor_or_vertical() -> None:
    joints = stand()
    joints[:5] = np.nan
    world = build_world(joints, np.full(3, np.nan), None)
    in_world = joints @ world[:3, :3].T + world[:3, 3]
    assert in_world[5, BODY26.index('pelvis'), :2] == pytest.approx(0.0, abs=1e-9)
    assert np.nanpercentile(in_world[..., 2].min(axis=1), 5) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(build_world(joints * np.nan, UPWARD, 1.0)).all()
