# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pixels and rays by camera matrix and lens; cameras that cannot be are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics


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
    doubled, cropped, unknown = (
        Intrinsics(1.0, (0, 0), True, image_size=s) for s in ((1280, 960), (640, 360), None)
    )
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
