# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""CameraInfo of images that a camera has cut out of its full resolution, or binned."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.camera_info import decode_camera_info
from tests.support.camera_infos import camera_info


@pytest.mark.parametrize('rectified', [False, True])
@pytest.mark.parametrize('binning', [(1, 1), (2, 2), (4, 2)])
@pytest.mark.parametrize('region', [(0, 0, 0, 0), (100, 40, 800, 600)])
def test_a_binned_part_of_the_image_shows_the_same_rays(
    rng: np.random.Generator, region: tuple[int, int, int, int], binning: tuple[int, int], rectified: bool
) -> None:
    p = (900.0, 0, 650, 0, 0, 900, 470, 0, 0, 0, 1, 0)
    whole = decode_camera_info(camera_info(1280, 960, 900.0, p=p), rectified=rectified)
    part = decode_camera_info(
        camera_info(1280, 960, 900.0, p=p, binning=binning, region=region), rectified=rectified
    )
    width, height = region[2:] if region[2] else (1280, 960)
    assert part.size == (width // binning[0], height // binning[1])
    points = rng.uniform(-1, 1, (20, 3)) + [0, 0, 4]
    expected = (whole.intrinsics.project(points) - region[:2]) / binning
    assert part.intrinsics.project(points) == pytest.approx(expected)


def test_an_unknown_size_stays_unknown() -> None:
    camera = decode_camera_info(camera_info(0, 0, binning=(2, 2)))
    assert (camera.size, camera.intrinsics.image_size) == ((0, 0), None)


@pytest.mark.parametrize('model', ['plumb_bob', 'equidistant'])
def test_coefficients_that_no_lens_has_are_refused(model: str) -> None:
    assert decode_camera_info(camera_info(model=model, d=(1e5, 0, 0, 0))).intrinsics.distortion.coefficients
    with pytest.raises(InputError, match=r'^d: -1e\+300, more than a lens has \(1e\+06\)$'):
        decode_camera_info(camera_info(model=model, d=(1.0, -1e300, 0, 0)))


@pytest.mark.parametrize('count', [12, 14])
def test_opencv_s_further_coefficients_are_left_out_where_they_are_0(count: int) -> None:
    """Drivers such as DepthAI's send all 14 of OpenCV's."""
    coefficients = (0.1, -0.2, 0.001, 0.002, 0.03, 0.04, 0.05, 0.06, *[0.0] * (count - 8))
    camera = decode_camera_info(camera_info(model='rational_polynomial', d=coefficients))
    assert camera.intrinsics.distortion.coefficients == coefficients[:8]
    with pytest.raises(InputError, match=f'takes 8 coefficients, not {count}'):
        decode_camera_info(camera_info(model='rational_polynomial', d=(*coefficients[:-1], 0.01)))
