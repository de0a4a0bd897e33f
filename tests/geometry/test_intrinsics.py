# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pixels and rays by the camera matrix; intrinsics that no camera can have are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.errors import InputError
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
