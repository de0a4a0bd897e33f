# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cameras, lenses and rays; rotations and rigid transforms, their derivatives and interpolation."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.arrays import Array
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, camera_jacobian
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.gravity import FIRST_STD, GRAVITY, LOW_PASS_S, Gravity
from mocap_ros.geometry.interpolation import find_nearest, interpolate_linearly, interpolate_rotations
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import LEVEL_UP, average_vertical, rotation_to_level
from mocap_ros.geometry.rigid_transform import RigidTransform, interpolate, parse_camera_pose
from mocap_ros.geometry.rotations import quaternion_from_rotation, rotation_from_vector, vector_from_rotation
from mocap_ros.geometry.virtual_camera import VirtualCamera, rotate_rays, rotation_to_optical_axis
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.skeleton import CMU15
from mocap_ros.units import NS_PER_S
from tests.support.bodies import make_swinging_body


def test_points_and_rays_follow_the_camera_matrix() -> None:
    camera = Intrinsics.from_matrix(np.array([[500.0, 0, 320], [0, 600, 240], [0, 0, 1]]))
    points = np.array([[1.0, -2.0, 4.0], [0.0, 0.0, 1.0]])
    pixels = np.array([[500 * 0.25 + 320, 600 * -0.5 + 240], [320, 240]])
    assert camera.project(points) == pytest.approx(pixels)
    assert camera.pixels_to_rays(pixels) == pytest.approx(np.array([[0.25, -0.5], [0, 0]]), abs=1e-12)
    assert camera.focal == pytest.approx(np.sqrt(500 * 600))
    assert camera.is_focal_known


@pytest.mark.parametrize('size', [(640, 480), (480, 640)])
def test_a_nominal_focal_length_is_in_longer_sides_of_the_image(size: tuple[int, int]) -> None:
    camera = Intrinsics.from_image_size(*size, 0.75)
    assert camera.focal == pytest.approx(480)
    assert (camera.center, camera.aspect) == ((size[0] / 2, size[1] / 2), 1)
    assert not camera.is_focal_known


def test_a_resized_camera_sees_the_points_where_the_resized_image_has_them() -> None:
    matrix = np.array([[500.0, 0, 310], [0, 600, 250], [0, 0, 1]])
    camera = Intrinsics.from_matrix(matrix, image_size=(640, 480))
    points = np.array([[1.0, -2.0, 4.0], [0.2, 0.1, 1.0]])
    sizes = ((1280, 960), (640, 360), None)
    doubled, cropped, unknown = (Intrinsics(1.0, (0, 0), True, image_size=size) for size in sizes)
    assert camera.resize_like(doubled).project(points) == pytest.approx(2 * camera.project(points))
    assert camera.resize_like(cropped).project(points) == pytest.approx(camera.project(points) - [0, 60])
    assert camera.resize_like(unknown) is camera
    nominal, larger = (Intrinsics.from_image_size(*size, 1.2) for size in ((640, 480), (1280, 960)))
    assert nominal.resize_like(larger) == larger


@pytest.mark.parametrize('entry', [(0, 0, 1e200), (0, 0, 1e-200), (0, 2, 1e308), (1, 2, float('nan'))])
def test_impossible_camera_matrices_are_rejected(entry: tuple[int, int, float]) -> None:
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    matrix[entry[0], entry[1]] = entry[2]
    with pytest.raises(InputError, match=r'focal lengths|principal point'):
        Intrinsics.from_matrix(matrix)


LENSES = [
    Distortion('plumb_bob', (-0.28, 0.07, 0.0002, 0.00002, 0.0)),
    Distortion('rational_polynomial', (2.0, 1.5, 0.0004, -0.0003, 0.1, 2.3, 2.2, 0.5)),
    Distortion('equidistant', (-0.01, 0.02, -0.02, 0.005)),
]


@pytest.mark.parametrize('lens', LENSES, ids=lambda lens: lens.model)
def test_undistort_inverts_distort(lens: Distortion) -> None:
    side = np.linspace(-0.6, 0.6, 9)
    points = np.stack(np.meshgrid(side, side), axis=-1)
    shown = lens.distort(points)
    assert np.abs(shown - points).max() > 0.005
    assert lens.undistort(shown) == pytest.approx(points, abs=1e-6)


def test_the_lenses_show_points_as_the_formulas_say() -> None:
    x, y = point = np.array([0.4, -0.3])  # r = 0.5
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients = (0.3, -0.2, 0.01, -0.02, 0.5, 0.4, -0.1, 0.7)
    for count, model in ((5, 'plumb_bob'), (8, 'rational_polynomial')):
        radial = 1 + k1 * 0.25 + k2 * 0.25**2 + k3 * 0.25**3
        if count == 8:
            radial /= 1 + k4 * 0.25 + k5 * 0.25**2 + k6 * 0.25**3
        tangential = [2 * p1 * x * y + p2 * (0.25 + 2 * x**2), p1 * (0.25 + 2 * y**2) + 2 * p2 * x * y]
        found = Distortion(model, coefficients[:count]).distort(point)
        assert found == pytest.approx(radial * point + tangential, abs=1e-14), model
    angle = np.arctan(0.5)
    factor = angle / 0.5 * (1 + k1 * angle**2 + k2 * angle**4 + p1 * angle**6 + p2 * angle**8)
    assert Distortion('equidistant', coefficients[:4]).distort(point) == pytest.approx(factor * point, abs=1e-14)


@given(st.lists(st.floats(-50, 50), min_size=4, max_size=4), st.sampled_from(['plumb_bob', 'equidistant']))
def test_any_coefficients_give_finite_rays(coefficients: list[float], model: str) -> None:
    lens = Distortion.from_coefficients(model, tuple(coefficients))
    assert np.isfinite(lens.undistort(np.array([[0.3, -0.8], [2.0, 5.0], [0.0, 0.0]]))).all()


@pytest.mark.parametrize(
    ('model', 'coefficients', 'message'),
    [('thin_prism', (0.1,), "'thin_prism'.*plumb_bob"), ('plumb_bob', (0.1, 0.2), 'plumb_bob .*not 2')],
)
def test_invalid_coefficients_are_refused(model: str, coefficients: tuple[float, ...], message: str) -> None:
    assert Distortion.from_coefficients('', (0.0, 0.0)) == Distortion()
    with pytest.raises(InputError, match=message):
        Distortion.from_coefficients(model, coefficients)


FRAMES = 6
SMOOTHING_S = 0.5
CAMERA = Intrinsics(600.0, (320.0, 240.0), True, 1.05, Distortion('plumb_bob', (-0.1, 0.02, 0.001, -0.001, 0.0)))
AT_EDGE_M = np.array([4.5, -0.4, 5.0])  # m in the camera's frame: 42 degrees off the optical axis

slope = st.floats(-50, 50)  # 1, x / z or y / z of a ray; 50 is 89 degrees off the optical axis


def to_rays(points: Array) -> Array:
    return np.asarray(points[..., :2] / points[..., 2:])


def check_smallest_turn(rotation: Array, start: Array, end: Array, tolerance: float) -> None:
    """Check that a rotation turns one direction (3,) into another by the smallest angle."""
    assert rotation @ start == pytest.approx(end, abs=1e-11)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    angle = np.arctan2(np.linalg.norm(np.cross(start, end)), start @ end)
    assert Rotation.from_matrix(rotation).magnitude() == pytest.approx(angle, abs=tolerance)


@given(slope, slope)
def test_the_rotation_to_the_optical_axis_is_the_smallest(x: float, y: float) -> None:
    (rotation,) = rotation_to_optical_axis(np.array([[x, y]]))
    check_smallest_turn(rotation, np.array([x, y, 1.0]) / math.hypot(x, y, 1.0), np.array([0, 0, 1]), 1e-7)


@given(slope, slope, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_rays_of_points_in_front_are_rotated_as_points_are(x: float, y: float, right: float, down: float) -> None:
    rotation = rotation_to_optical_axis(np.array([[x, y]]))
    ahead = np.array([[[right, down]]])  # in the rotated camera
    point = np.concatenate([ahead, np.ones((1, 1, 1))], axis=-1) @ rotation
    if point[0, 0, 2] > 0.05:  # in front of the unrotated camera, too
        assert rotate_rays(to_rays(point), rotation) == pytest.approx(ahead, abs=1e-9)
        assert rotate_rays(ahead, np.swapaxes(rotation, -1, -2)) == pytest.approx(to_rays(point), rel=1e-9)


def test_rays_behind_the_rotated_camera_are_finite_and_far_outside_the_image() -> None:
    far_right = rotation_to_optical_axis(np.array([[8.0, 0.0]]))  # 83 degrees
    rays = np.array([[[-8.0, 0.0], [-1.0, 0.5], [-0.05, 0.0], [8.0, 0.0]]])
    behind_left, behind, side, ahead = rotate_rays(rays, far_right)[0]
    for ray in (behind_left, behind, side):
        assert np.isfinite(ray).all()
        assert ray[0] < -5, 'to the left, 79 degrees off the axis or more'
    assert behind[1] > 0, 'below the axis, as before'
    assert ahead == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize('position', [np.array([0.0, 0.0, 5.0]), AT_EDGE_M, AT_EDGE_M * [-1, -1, 1]])
def test_positions_and_rotations_come_back_to_the_real_camera(position: Array) -> None:
    poses, times = make_swinging_body(FRAMES)
    joints, weight = poses + position, np.ones(poses.shape[:2])
    rays = CAMERA.pixels_to_rays(CAMERA.project(joints))
    view = VirtualCamera.look_at_person(rays, weight, times, SMOOTHING_S, CAMERA)
    pelvis = joints[:, [CMU15.index('pelvis')]]
    body = Rotation.random(FRAMES, random_state=0).as_matrix()

    seen_pelvis = pelvis @ np.swapaxes(view.rotation, -1, -2)  # in the virtual cameras' frames
    image = CAMERA.focal * rotate_rays(to_rays(pelvis), view.rotation)
    cameras = WeakPerspectiveCameras(CAMERA.focal / seen_pelvis[:, 0, 2], view.rotation @ body)
    assert image == pytest.approx(CAMERA.focal * to_rays(seen_pelvis), abs=1e-9)
    assert view.root_positions(cameras, image[:, 0]) == pytest.approx(pelvis[:, 0], abs=1e-9)
    assert view.to_real_camera(seen_pelvis) == pytest.approx(pelvis, abs=1e-12)
    assert view.body_rotations(cameras) == pytest.approx(body, abs=1e-12)


def test_the_direction_of_a_long_sequence_is_that_of_all_frames_at_once(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.choice([0.03, 0.04, 0.05], 2500))
    times[1200:] += 400.0  # s; a pause in which no person is seen
    weight = rng.random((2500, 3))
    weight[rng.random(2500) < 0.3] = 0
    weight[1190:1900] = 0
    rays = rng.normal(0, 0.3, (2500, 3, 2)) + np.sin(times / 20)[:, None, None]
    total = weight.sum(axis=1)
    centroid = (weight[..., None] * rays).sum(axis=1) / np.maximum(total, 1e-12)[:, None]
    kernel = (np.exp(-0.5 * ((times[:, None] - times) / 0.5) ** 2) + 1e-12) * (total > 0)
    expected = rotation_to_optical_axis(kernel @ centroid / kernel.sum(axis=1, keepdims=True))
    found = VirtualCamera.look_at_person(rays, weight, times, 1.0, CAMERA)
    assert found.rotation == pytest.approx(expected, abs=1e-9)


def test_rotations_as_vectors_and_quaternions() -> None:
    turns = Rotation.random(200, random_state=0).as_matrix()
    half = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for matrix in [np.eye(3), *half, *turns]:
        assert Rotation.from_quat(quaternion_from_rotation(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-12)
    assert rotation_from_vector(vector_from_rotation(turns)) == pytest.approx(turns, abs=1e-9)


STEP = 1e-6  # of the central differences; their error is about its square, that of rounding 1e-10


@pytest.mark.parametrize('rows', [2, 3])
def test_jacobian_agrees_with_finite_differences(rng: np.random.Generator, rows: int) -> None:
    points = rng.normal(size=(4, 5, 3))

    def move(step: np.ndarray) -> np.ndarray:
        return np.exp(step[3]) * (points @ rotation_from_vector(step[:3]).T)

    steps = STEP * np.eye(CAMERA_UNKNOWNS)
    expected = np.stack([(move(step) - move(-step)) / (2 * STEP) for step in steps], axis=-1)
    assert camera_jacobian(points, rows) == pytest.approx(expected[..., :rows, :], abs=1e-8)


@given(
    steps=st.lists(st.floats(1e-6, 10.0), min_size=0, max_size=12),
    times=st.lists(st.floats(-5.0, 50.0), min_size=1, max_size=12),
)
def test_each_column_is_interpolated_and_kept_beyond_the_ends(steps: list[float], times: list[float]) -> None:
    sample_times = np.concatenate([[0.0], np.cumsum(steps)])
    samples = np.random.default_rng(len(steps)).normal(size=(len(sample_times), 3))
    found = interpolate_linearly(np.array(times), sample_times, samples)
    expected = np.stack([np.interp(times, sample_times, column) for column in samples.T], axis=-1)
    assert found == pytest.approx(expected, abs=1e-9)


def test_the_nearest_time_is_that_of_a_comparison_with_all(rng: np.random.Generator) -> None:
    times = np.arange(400) / 8  # multiples of a power of two, so that many are equally near
    for share in (0.003, 0.1, 0.5, 1.0):
        known = times[(rng.random(400) < share) | (np.arange(400) == 77)]
        np.testing.assert_array_equal(find_nearest(times, known), np.abs(times[:, None] - known).argmin(axis=1))


def test_rotations_are_interpolated_on_the_shortest_arc(rng: np.random.Generator) -> None:
    known, times = np.array([0.0, 0.5, 0.6, 2.0]), np.r_[np.sort(rng.uniform(0, 2, 30)), 0.5, 2.0]
    turns = Rotation.random(4, random_state=1)
    found = interpolate_rotations(times, known, turns.as_matrix())
    assert found == pytest.approx(Slerp(known, turns)(times).as_matrix(), abs=1e-9)


ANGLES = st.floats(-180, 180)


@given(ANGLES, ANGLES)
@example(180.0, 0.0)
@example(180.0, 0.002)
@example(180.0, 1e-7)
def test_the_vertical_becomes_that_of_a_level_camera_by_the_smallest_turn(pitch: float, roll: float) -> None:
    vertical = Rotation.from_euler('xz', [pitch, roll], degrees=True).apply(LEVEL_UP)
    check_smallest_turn(rotation_to_level(vertical), vertical, LEVEL_UP, 1e-11)


def test_the_mean_leaves_out_what_is_not_known() -> None:
    assert (rotation_to_level(np.full(3, np.nan)) == np.eye(3)).all()
    vertical = np.array([[0.6, -0.8, 0], [-0.6, -0.8, 0], [np.nan] * 3])
    assert average_vertical(vertical, np.zeros(len(vertical))) == pytest.approx(LEVEL_UP)
    assert np.isnan(average_vertical(vertical, np.ones(len(vertical)))).all()
    assert np.isnan(average_vertical(np.empty((0, 3)), np.empty(0))).all()


def make_transform(seed: int) -> tuple[RigidTransform, np.ndarray]:
    rng = np.random.default_rng(seed)
    rotation, matrix = Rotation.random(random_state=seed), np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), rng.normal(size=3)
    return RigidTransform.from_numbers((*matrix[:3, 3], *rotation.as_quat())), matrix


def to_matrix(transform: RigidTransform) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = transform.rotation, transform.translation
    return matrix


@given(st.integers(0, 2**31), st.integers(0, 2**31))
def test_they_compose_and_invert_as_matrices_do(one: int, other: int) -> None:
    (a, a_matrix), (b, b_matrix) = make_transform(one), make_transform(other)
    np.testing.assert_allclose(to_matrix(a.compose(b)), a_matrix @ b_matrix, atol=1e-12)
    np.testing.assert_allclose(to_matrix(a.inverse()), np.linalg.inv(a_matrix), atol=1e-12)
    points = np.arange(12.0).reshape(2, 2, 3)
    np.testing.assert_allclose(a.apply(points), points @ a_matrix[:3, :3].T + a_matrix[:3, 3], atol=1e-12)
    covariance = np.diag([1.0, 4.0, 9.0])
    turned = a_matrix[:3, :3] @ covariance @ a_matrix[:3, :3].T
    np.testing.assert_allclose(a.rotate_covariance(covariance), turned, atol=1e-12)


@given(st.integers(0, 2**31), st.integers(0, 2**31), st.floats(0, 1))
def test_between_two_of_them_the_way_is_straight_and_the_arc_shortest(one: int, two: int, share: float) -> None:
    (a, a_matrix), (b, b_matrix) = make_transform(one), make_transform(two)
    found = interpolate(a, b, share)
    arc = Slerp([0, 1], Rotation.from_matrix([a_matrix[:3, :3], b_matrix[:3, :3]]))
    np.testing.assert_allclose(found.rotation, arc(share).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(found.translation, (1 - share) * a.translation + share * b.translation, atol=1e-12)


@pytest.mark.parametrize('numbers', [(0.0,) * 7, (0, 0, 0, 1, 1, 0, 0), (0, np.nan, 0, 0, 0, 0, 1)])
def test_numbers_that_are_no_transform_are_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match='not finite or absurdly far, or the quaternion'):
        RigidTransform.from_numbers(numbers)


def test_a_level_camera_looks_along_x_and_a_positive_pitch_lowers_its_view() -> None:
    level = parse_camera_pose('1 2 1.5 0 0 0', 'p')
    np.testing.assert_allclose(level.apply(np.array([0.0, 0.0, 3.0])), [4, 2, 1.5], atol=1e-12)  # 3 m ahead
    np.testing.assert_allclose(level.apply(np.array([1.0, 0.0, 0.0])), [1, 1, 1.5], atol=1e-12)  # to the right
    np.testing.assert_allclose(level.apply(np.array([0.0, 1.0, 0.0])), [1, 2, 0.5], atol=1e-12)  # down
    lowered = parse_camera_pose('0 0 0 0 0.5 0', 'p').apply(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(lowered, [np.cos(0.5), 0, -np.sin(0.5)], atol=1e-12)
    turned = parse_camera_pose(f'0 0 0 0 0 {np.pi / 2}', 'p').apply(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-12)


@given(st.text('0123456789.-e naif\t', max_size=40))
def test_any_text_is_a_pose_or_an_error_that_names_the_parameter(text: str) -> None:
    try:
        parse_camera_pose(text, 'node.camera_pose')
    except ConfigError as error:
        assert str(error).startswith('node.camera_pose = ')  # noqa: PT017


IMU_HZ = 200
AT_REST = np.array([0.0, -GRAVITY * math.cos(0.3), -GRAVITY * math.sin(0.3)])  # m/s^2; looks down by 0.3 rad


def add_accelerations(gravity: Gravity, accelerations: Array, start_s: float = 0.0) -> tuple[Array, float]:
    """Add accelerations (F, 3) that begin at a time; return the direction and its deviation in the end."""
    stamps_ns = np.round((start_s + np.arange(len(accelerations)) / IMU_HZ) * NS_PER_S).astype(int).tolist()
    for stamp_ns, acceleration in zip(stamps_ns, accelerations, strict=True):
        gravity.add(stamp_ns, acceleration)
    return gravity.find(stamps_ns[-1])


def test_gravity_is_the_low_passed_acceleration() -> None:
    accelerations = AT_REST + np.random.default_rng(0).normal(0, 0.5, (400, 3))
    share = 1 - math.exp(-1 / IMU_HZ / LOW_PASS_S)
    low_passed = lfilter([share], [1, share - 1], accelerations[1:], axis=0, zi=(1 - share) * accelerations[:1])[0]
    found, _ = add_accelerations(gravity := Gravity(), accelerations)
    assert found == pytest.approx(low_passed[-1] / np.linalg.norm(low_passed[-1]), abs=1e-9)
    gravity.add(0, np.array([GRAVITY, 0, 0]))
    assert gravity.find(2 * NS_PER_S)[0] is not None
    assert gravity.find(2 * NS_PER_S)[0] == pytest.approx(found), 'one that is too late has no effect'
    turned = gravity, np.array([[GRAVITY, 0, 0]]), 60.0
    assert add_accelerations(*turned)[0] == pytest.approx([1, 0, 0]), 'after a gap it begins anew'
    assert add_accelerations(*turned)[1] == pytest.approx(FIRST_STD / GRAVITY, rel=0.1)


@pytest.mark.parametrize(('hz', 'size', 'largest_deg'), [(0.0, 0.0, 1.3), (15.0, 3.0, 1.5), (0.1, 0.6, 5.0)])
def test_the_deviation_of_gravity_is_that_of_a_robot_that_vibrates_or_drives(
    hz: float, size: float, largest_deg: float
) -> None:
    times = np.arange(20 * IMU_HZ) / IMU_HZ
    driving = size * np.sin(2 * np.pi * hz * times)[:, None] * [0, np.sin(0.3), -np.cos(0.3)]
    gravity, errors = Gravity(), list[float]()
    for first in range(10 * IMU_HZ, len(times), IMU_HZ):  # s by s, after ten seconds
        before = 0 if not errors else first - IMU_HZ
        found, std = add_accelerations(gravity, (AT_REST + driving)[before:first], times[before])
        assert std < math.radians(largest_deg)
        errors.append(math.acos(min(float(found @ AT_REST) / GRAVITY, 1.0)) / std)
    assert max(errors) < 2.5
