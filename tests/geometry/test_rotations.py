# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations and rigid transforms: representations, derivatives, interpolation, poses of cameras, level cameras."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, camera_jacobian
from mocap_ros.geometry.interpolation import find_nearest, interpolate_linearly, interpolate_rotations
from mocap_ros.geometry.level import LEVEL_UP, average_vertical, rotation_to_level
from mocap_ros.geometry.rigid_transform import RigidTransform, interpolate, parse_camera_pose
from mocap_ros.geometry.rotations import (
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
)


def test_rotations_as_vectors_and_quaternions() -> None:
    turns = Rotation.random(200, random_state=0)
    half = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for matrix in [np.eye(3), *half, *turns.as_matrix()]:
        assert Rotation.from_quat(quaternion_from_rotation(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-12)
    assert rotation_from_vector(vector_from_rotation(turns.as_matrix())) == pytest.approx(
        turns.as_matrix(), abs=1e-9
    )


STEP = 1e-6  # of the central differences; their error is about its square, that of rounding 1e-10


def differentiate(points: np.ndarray) -> np.ndarray:
    """(..., 3, 4) central differences of points that a step of the camera rotates and scales."""

    def move(step: np.ndarray) -> np.ndarray:
        return np.exp(step[3]) * (points @ rotation_from_vector(step[:3]).T)

    steps = STEP * np.eye(CAMERA_UNKNOWNS)
    return np.stack([(move(step) - move(-step)) / (2 * STEP) for step in steps], axis=-1)


@pytest.mark.parametrize('rows', [2, 3])
def test_jacobian_agrees_with_finite_differences(rng: np.random.Generator, rows: int) -> None:
    points = rng.normal(size=(4, 5, 3))
    assert camera_jacobian(points, rows) == pytest.approx(differentiate(points)[..., :rows, :], abs=1e-8)


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
    rotation = rotation_to_level(vertical)
    assert rotation @ vertical == pytest.approx(LEVEL_UP, abs=1e-11)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    angle = np.arctan2(np.linalg.norm(np.cross(vertical, LEVEL_UP)), vertical @ LEVEL_UP)
    assert Rotation.from_matrix(rotation).magnitude() == pytest.approx(angle, abs=1e-11)


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
def test_between_two_of_them_the_way_is_straight_and_the_arc_is_the_shortest(
    one: int, two: int, share: float
) -> None:
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
