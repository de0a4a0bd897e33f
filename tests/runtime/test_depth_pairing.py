# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints get the depths of the image of their time: sampling, encodings, pairing, and what cannot be used."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.depth_image import sample_depth
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE, decode_depth_image
from mocap_ros.messages.input_types import COCO17
from mocap_ros.messages.keypoints import decode_keypoints, encode_keypoints
from mocap_ros.runtime.depth_pairing import MAX_WAIT_S, DepthPairing
from mocap_ros.units import NS_PER_S
from tests.support.camera_messages import create_header, create_message, encode

LIMITS, SIZE, STEP_NS = NodeConfig(), (64, 48), NS_PER_S // 30
# A limb 2 m away, 8 px wide, before a wall 5 m away; a hole, and two pixels that fly before the limb.
SCENE_MM = np.full(SIZE[::-1], 5000, np.uint16)
SCENE_MM[:, 28:36] = 2000
SCENE_MM[40:, :] = 0
SCENE_MM[20, 30:32] = 900
POINTS = np.tile([[32.0, 20.0]], (17, 1))
POINTS[1:6] = [10.0, 10.0], [32.0, 46.0], [np.nan, np.nan], [-9.0, 5.0], [36.0, 30.0]
EXPECTED_M = 2.0, 5.0, np.nan, np.nan, np.nan, 2.0


def encode_image(stamp_ns: int, frame_id: str = 'optical', **fields: Any) -> bytes:
    """Encode an image of the scene, or of other fields."""
    height, width = SCENE_MM.shape
    plain = {'height': height, 'width': width, 'encoding': '16UC1', 'is_bigendian': 0, 'step': 2 * width}
    values = {**plain, 'data': SCENE_MM.view(np.uint8).ravel(), **fields}
    return encode(create_message(IMAGE, header=create_header(Header(stamp_ns, frame_id)), **values), IMAGE)


def encode_compressed(
    kind: str, numbers: np.ndarray, parameters: tuple[float, float] = (0.0, 0.0), file_bytes: int | None = None
) -> bytes:
    file = io.BytesIO()
    Image.fromarray(numbers).save(file, 'PNG')
    head = np.zeros(1, '<i4').tobytes() + np.array(parameters, '<f4').tobytes()
    data = np.frombuffer(head + file.getvalue()[:file_bytes], np.uint8)
    fields = {'header': create_header(Header(1, 'optical')), 'format': kind, 'data': data}
    return encode(create_message(COMPRESSED_IMAGE, **fields), COMPRESSED_IMAGE)


def encode_person(stamp_ns: int, frame_id: str = 'optical', size: tuple[int, int] = SIZE) -> bytes:
    score = np.isfinite(POINTS[:, 0]).astype(float)
    return encode_keypoints(Header(stamp_ns, frame_id), size, [Person2D('a', COCO17, POINTS, score)])


def test_the_limb_is_seen_and_not_the_wall_beside_it() -> None:
    np.testing.assert_allclose(sample_depth(SCENE_MM, 1e-3, POINTS)[:6], EXPECTED_M)


def test_every_encoding_gives_the_same_depths() -> None:
    metres = np.where(SCENE_MM > 0, SCENE_MM / 1e3, np.nan).astype('<f4')
    a, b = 1e5, 10.0
    quantised = np.where(SCENE_MM > 0, a / np.fmax(metres, 1e-3) + b, 0).astype(np.uint16)
    floats: dict[str, Any] = {'encoding': '32FC1', 'step': 4 * SIZE[0], 'data': metres.view(np.uint8).ravel()}
    big: dict[str, Any] = {'is_bigendian': 1, 'data': SCENE_MM.astype('>u2').view(np.uint8).ravel()}
    messages = [
        (encode_image(1), IMAGE),
        (encode_image(1, **floats), IMAGE),
        (encode_image(1, **big), IMAGE),
        (encode_compressed('16UC1; compressedDepth png', SCENE_MM), COMPRESSED_IMAGE),
        (encode_compressed('32FC1; compressedDepth', quantised, (a, b)), COMPRESSED_IMAGE),
    ]
    for raw, msgtype in messages:
        _, image, unit_m = decode_depth_image(raw, msgtype, LIMITS)
        np.testing.assert_allclose(sample_depth(image, unit_m, POINTS)[:6], EXPECTED_M, rtol=1e-4)


@pytest.mark.parametrize(
    ('raw', 'msgtype', 'place'),
    [
        (encode_image(1, encoding='rgb8'), IMAGE, 'encoding'),
        (encode_image(1, step=7), IMAGE, 'step'),
        (encode_image(1, height=480), IMAGE, 'data'),
        (encode_compressed('16UC1; png compressed', SCENE_MM), COMPRESSED_IMAGE, 'format'),
        (encode_compressed('16UC1; compressedDepth png', SCENE_MM, file_bytes=40), COMPRESSED_IMAGE, 'data'),
    ],
)
def test_what_is_no_depth_image_is_refused(raw: bytes, msgtype: str, place: str) -> None:
    with pytest.raises(InputError, match=f'^{place}'):
        decode_depth_image(raw, msgtype, LIMITS)


def test_keypoints_wait_for_their_image_and_are_never_lost() -> None:
    pairing = DepthPairing()
    pairing.add_depth(encode_image(0))
    pairing.add_keypoints(encode_person(STEP_NS), now_s=0.0)
    assert list(pairing.take(MAX_WAIT_S / 2)) == []
    pairing.add_depth(encode_image(STEP_NS + STEP_NS // 4))
    ((raw, reason),) = pairing.take(MAX_WAIT_S / 2)
    (person,) = decode_keypoints(raw, LIMITS).people
    assert person.depth is not None
    np.testing.assert_allclose(person.depth[:6], EXPECTED_M)
    assert reason == ''
    pairing.add_keypoints(encode_person(3 * STEP_NS), now_s=1.0)
    pairing.add_keypoints(b'nothing', now_s=1.0)
    (late, why), (lost, error) = pairing.take(1.0 + 2 * MAX_WAIT_S)
    assert decode_keypoints(late, LIMITS).people[0].depth is None
    assert 's away' in why
    assert lost == b''
    assert error


@pytest.mark.parametrize(
    ('image', 'person', 'words'),
    [
        ({'frame_id': 'depth_optical'}, {}, 'aligned_depth_to_color'),
        ({}, {'size': (640, 480)}, 'aligned_depth_to_color'),
        ({'encoding': 'rgb8'}, {}, 'encoding'),
        (None, {}, 'no depth image'),
    ],
)
def test_images_that_do_not_fit_are_told(
    image: Mapping[str, Any] | None, person: Mapping[str, Any], words: str
) -> None:
    pairing = DepthPairing()
    if image is not None:
        pairing.add_depth(encode_image(5, **image))
    pairing.add_keypoints(encode_person(5, **person), now_s=0.0)
    ((raw, reason),) = pairing.take(MAX_WAIT_S)
    assert words in reason
    assert decode_keypoints(raw, LIMITS).people[0].depth is None
