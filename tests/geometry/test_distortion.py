# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Lens distortion: undistortion inverts distortion, and invalid coefficients are refused with a reason."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion

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


def test_invalid_coefficients_are_refused() -> None:
    assert Distortion.from_coefficients('', (0.0, 0.0)) == Distortion()
    with pytest.raises(InputError, match="'thin_prism': expected plumb_bob, rational_polynomial, equidistant"):
        Distortion.from_coefficients('thin_prism', (0.1,))
    with pytest.raises(InputError, match=f"distortion model '{'x' * 60}': expected plumb_bob"):
        Distortion.from_coefficients('x' * 1000, (0.1,))
    with pytest.raises(InputError, match='plumb_bob takes 4 or 5 coefficients, not 2'):
        Distortion.from_coefficients('plumb_bob', (0.1, 0.2))
