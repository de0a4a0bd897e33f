# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Images of all encodings, and the CameraInfo of images that a camera has cut out or binned."""

import io
import math
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.camera_info import decode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.images import COMPRESSED_IMAGE, ENCODINGS, IMAGE, decode_image
from tests.support.camera_messages import camera_info, encode_pixels
from tests.support.message_objects import create_header, create_message, encode

HEADER = Header(5_000_000_007, 'optical')
LIMITS = NodeConfig()


def make_image() -> np.ndarray:
    """Return an image (10, 12, 3) of colours that change little inside squares of 2 x 2 px."""
    squares = np.random.default_rng(0).integers(0, 256, (5, 6, 3))
    squares[0, 0] = 255
    return squares.repeat(2, axis=0).repeat(2, axis=1).astype(np.uint8)


def encode_message(msgtype: str = IMAGE, **fields: Any) -> bytes:
    fields['data'] = np.frombuffer(fields['data'], np.uint8)
    return encode(create_message(msgtype, header=create_header(HEADER), **fields), msgtype)


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize(('padding', 'is_bigendian'), [(0, False), (5, True)])
def test_every_encoding_gives_red_green_and_blue(encoding: str, padding: int, is_bigendian: bool) -> None:
    image = make_image()
    fields = encode_pixels(image, encoding, padding, is_bigendian)
    header, pixels = decode_image(encode_message(**fields), IMAGE, LIMITS)
    assert header == HEADER
    assert pixels.dtype == np.uint8
    is_grey = encoding in ('mono8', '8UC1', 'mono16', '16UC1')
    expected = image.mean(axis=-1, keepdims=True).repeat(3, axis=-1) if is_grey else image
    tolerance = 3 if encoding.startswith(('yu', 'uy')) else 1
    assert np.abs(pixels.astype(float) - expected).max() <= tolerance


def test_an_infrared_png_is_stretched_as_the_plain_image_is() -> None:
    grey = np.linspace(0, 4000, 12 * 10).reshape(12, 10).astype(np.uint16)
    file = io.BytesIO()
    Image.fromarray(grey).save(file, 'PNG')
    fields: dict[str, Any] = {'height': 12, 'width': 10, 'encoding': 'mono16', 'is_bigendian': 0, 'step': 20}
    plain = decode_image(encode_message(**fields, data=grey.astype('<u2').tobytes()), IMAGE, LIMITS)[1]
    message = encode_message(COMPRESSED_IMAGE, format='mono16; png compressed', data=file.getvalue())
    found = decode_image(message, COMPRESSED_IMAGE, LIMITS)[1]
    assert (found == plain).all()
    assert len(np.unique(found)) > 100


def test_an_odd_image_of_a_bayer_pattern_keeps_its_size() -> None:
    image = make_image()[:9, :11]
    _, pixels = decode_image(encode_message(**encode_pixels(image, 'bayer_grbg8')), IMAGE, LIMITS)
    assert pixels.shape == (9, 11, 3)
    assert np.abs(pixels[:8, :10].astype(int) - image[:8, :10]).max() <= 1  # the colour of the rest is not known


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'encoding': 'rgb9'}, "encoding: 'rgb9', expected one of rgb8, "),
        ({'step': 35}, 'step: 35 bytes, less than a row of 12 pixels in rgb8'),
        ({'height': 11}, 'data: 360 bytes, expected 396'),
        ({'width': 0}, 'width, height: 0 x 10 px'),
        ({'height': 0}, 'width, height: 12 x 0 px'),
        ({'width': 2**20, 'height': 2**20}, 'width, height: 1048576 x 1048576 px'),
        ({'encoding': 'uyvy', 'width': 11}, 'width: 11 is odd'),
        ({'encoding': 'bayer_rggb8', 'height': 1}, 'width, height: 12 x 1 px, less than a Bayer pattern'),
        ({'data': b''}, 'data: 0 bytes, expected 360'),
    ],
)
def test_fields_that_do_not_fit_are_named(changes: dict[str, Any], reason: str) -> None:
    fields = {**encode_pixels(make_image(), 'rgb8'), **changes}
    with pytest.raises(InputError, match='^' + reason):
        decode_image(encode_message(**fields), IMAGE, LIMITS)


@pytest.mark.parametrize('rectified', [False, True])
@pytest.mark.parametrize('binning', [(1, 1), (2, 2), (4, 2)])
@pytest.mark.parametrize('region', [(0, 0, 0, 0), (100, 40, 800, 600)])
def test_a_binned_part_of_the_image_shows_the_same_rays(
    rng: np.random.Generator, region: tuple[int, int, int, int], binning: tuple[int, int], rectified: bool
) -> None:
    p = (900.0, 0, 650, 0, 0, 900, 470, 0, 0, 0, 1, 0)
    part_info = camera_info(1280, 960, 900.0, p=p, binning=binning, region=region)
    whole = decode_camera_info(camera_info(1280, 960, 900.0, p=p), rectified=rectified)
    part = decode_camera_info(part_info, rectified=rectified)
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
def test_bad_fields_leave_others(fields: dict[str, Any], used: tuple[int, int, float | None], note: str) -> None:
    camera = decode_camera_info(camera_info(**{'focal': 600.0, **fields}))
    intrinsics = camera.intrinsics
    assert (*camera.size, intrinsics.focal if intrinsics.is_focal_known else None) == used
    assert not intrinsics.distortion.coefficients
    assert re.search(note, camera.note)
