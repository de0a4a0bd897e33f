# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rigid transforms agree with SciPy's rotations, and a camera's pose puts the world where it belongs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.rigid_transform import RigidTransform, interpolate, parse_camera_pose


def make_transform(seed: int) -> tuple[RigidTransform, np.ndarray]:
    """Return a random transform, and the same as a matrix (4, 4)."""
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
