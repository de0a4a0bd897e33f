# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""CameraInfo of images that a camera has cut out of its full resolution, or binned."""

from __future__ import annotations

import math
import re
from typing import Any

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


OPENCV = (0.1, -0.2, 0.001, 0.002, 0.03, 0.04, 0.05, 0.06)


@pytest.mark.parametrize(
    ('model', 'd', 'used'),
    [
        ('plumb_bob', OPENCV[:5], ('plumb_bob', 5)),
        ('Plumb Bob', OPENCV[:4], ('plumb_bob', 4)),
        ('radtan', OPENCV[:4], ('plumb_bob', 4)),
        ('plumb_bob', OPENCV, ('rational_polynomial', 8)),
        ('rational_polynomial', (*OPENCV, *[0.0] * 6), ('rational_polynomial', 8)),  # as DepthAI sends them
        ('fisheye', OPENCV[:4], ('equidistant', 4)),
        ('kannala_brandt4', OPENCV[:4], ('equidistant', 4)),
        ('', OPENCV[:5], ('plumb_bob', 5)),
        ('unknown', (0.0,) * 5, ('plumb_bob', 0)),
        ('none', (), ('plumb_bob', 0)),
    ],
)
def test_models_of_lenses_have_several_names(model: str, d: tuple[float, ...], used: tuple[str, int]) -> None:
    camera = decode_camera_info(camera_info(model=model, d=d))
    distortion = camera.intrinsics.distortion
    assert (distortion.model, distortion.coefficients, camera.note) == (used[0], d[: used[1]], '')


@pytest.mark.parametrize(
    ('fields', 'used', 'note'),
    [
        ({'model': 'double_sphere', 'd': OPENCV[:5]}, (640, 480, 600.0), "distortion model 'double_sphere'"),
        ({'model': 'equidistant', 'd': OPENCV[:3]}, (640, 480, 600.0), 'takes 4 coefficients, not 3'),
        ({'model': 'rational_polynomial', 'd': (*OPENCV, 0, 0, 0, 0.1)}, (640, 480, 600.0), 'not 12'),
        ({'d': (math.nan, 0, 0, 0, 0)}, (640, 480, 600.0), 'not finite'),
        ({'d': (1.0, -1e300, 0, 0)}, (640, 480, 600.0), r'^d: -1e\+300, more than a lens has'),
        ({'focal': 0.0}, (640, 480, None), 'k: .*not calibrated: its image size of 640 x 480 px'),
        ({'centre': 1.0}, (640, 480, 600.0), 'k: principal point 640, 480 px .* for another size'),
        ({'focal': math.nan}, (640, 480, None), 'k: .*not calibrated'),
        ({'focal': 1.0}, (640, 480, None), 'k: focal length of 1 px in an image 640 px wide; .*not calibrated'),
        ({'focal': 0.0, 'binning': (2, 2), 'd': OPENCV[:5]}, (320, 240, None), '320 x 240 px'),
    ],
)
def test_a_field_that_cannot_be_used_leaves_the_others(
    fields: dict[str, Any], used: tuple[int, int, float | None], note: str
) -> None:
    camera = decode_camera_info(camera_info(**{'focal': 600.0, **fields}))
    intrinsics = camera.intrinsics
    assert (*camera.size, intrinsics.focal if intrinsics.is_focal_known else None) == used
    assert not intrinsics.distortion.coefficients
    assert re.search(note, camera.note)


def test_a_camera_info_without_anything_is_refused() -> None:
    with pytest.raises(InputError, match='k: is 0; the camera is not calibrated, and width and height are 0'):
        decode_camera_info(camera_info(0, 0, focal=0.0))
