# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/CameraInfo: the image size and the intrinsics of a camera.

Size and matrices are those of the full resolution. An image that the camera has cut out of it, at (x_0, y_0), and
binned, b_x by b_y pixels in one, has

    f_x' = f_x / b_x,   c_x' = (c_x - x_0) / b_x,   width' = width of the region / b_x

and likewise f_y', c_y' and its height.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.plain import encode_plain

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
MIN_FOCAL_SHARE = 0.04  # image widths; less than any lens has: drivers without a calibration send the unit matrix
MAX_COEFFICIENT = 1e6  # 1; rational polynomials that are poorly determined reach thousands; keeps results finite
# Shares of the image between which a principal point lies; that of a matrix for half or twice the size does not
CENTRE_RANGE = 0.3, 0.7
NO_DISTORTION_COEFFICIENTS = (0.0,) * 5  # with which drivers of cameras say that a lens does not distort


@dataclass(frozen=True)
class CameraInfo:
    """The parts of a sensor_msgs/CameraInfo that are used."""

    size: ImageSize  # (width, height) in px of the image that the camera sends, with 0 where unknown
    # Focal length, principal point and distortion. Where the camera is not calibrated, its focal length is not
    # known, and whoever uses it has to choose one
    intrinsics: Intrinsics
    # Name of the camera's optical frame; empty where unknown. It is not compared
    frame_id: str = field(default='', compare=False)
    note: str = ''  # why a field is not used or may be wrong, or empty
    raw: bytes = field(default=b'', compare=False, repr=False)  # the message as CDR


def may_be_one_camera(frame_id: str, other: str) -> bool:
    """Return whether two `frame_id` may be of one camera: an empty one says nothing.

    A camera's optical frame has `_optical` in its name, its other frame has not (REP 103), as of the ZED wrapper;
    names of ROS 1 may begin with `/`.
    """
    first, second = (name.lstrip('/').replace('_optical', '') for name in (frame_id, other))
    return first == second or not (first and second)


def describe_other_camera(frame_id: str, camera: CameraInfo, topic: str) -> str:
    """Return why the CameraInfo on a topic is not used for the images of another camera, in words."""
    return (
        f'header.frame_id: {frame_id!r}, but the CameraInfo on {topic or "camera_info"} is of '
        f'{camera.frame_id!r}, another camera, and is not used; correct header.frame_id, give the CameraInfo of '
        f'{frame_id!r}, or the focal length (node.focal, --focal)'
    )


def check_image_size(frame: KeypointsFrame, camera: CameraInfo) -> None:
    """Raise InputError if an image and a CameraInfo both give a size, and the sizes differ."""
    frame_size = frame.image_width, frame.image_height
    if all(frame_size) and all(camera.size) and frame_size != camera.size:
        own, stated = (f'{width} x {height} px' for width, height in (frame_size, camera.size))
        raise InputError(f'image_width, image_height: {own}, but CameraInfo is for {stated}')


def encode_camera_info(header: Header, camera: CameraInfo) -> bytes:
    """Encode a camera, whose whole image is sent as it is, so that `decode_camera_info` gives the same."""
    (fx, fy), (cx, cy) = camera.intrinsics.focal_lengths, camera.intrinsics.center
    distortion = camera.intrinsics.distortion
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    message = {
        'header': header,
        'height': camera.size[1],
        'width': camera.size[0],
        'distortion_model': distortion.model,
        'd': distortion.coefficients or NO_DISTORTION_COEFFICIENTS,
        'k': matrix,
        'r': np.eye(3),
        'p': np.column_stack([matrix, np.zeros(3)]),
    }  # neither binned nor a part of the image
    return encode_plain(message, CAMERA_INFO)


def decode_camera_info(raw: bytes, *, rectified: bool = False) -> CameraInfo:
    """Decode the image size and the intrinsics of a sensor_msgs/CameraInfo.

    Where the keypoints were detected in the rectified image, the projection matrix P is used (K where P is not
    set), and no distortion. A matrix or a distortion that cannot be used is left out, and `CameraInfo.note` says
    so.
    """
    message = decode(raw, CAMERA_INFO)
    name, matrix = 'k', np.asarray(message.k, np.float64).reshape(3, 3)
    if rectified and message.p[0]:
        name, matrix = 'p', np.asarray(message.p, np.float64).reshape(3, 4)[:, :3]
    distortion, note = Distortion(), ''
    if not rectified:
        try:
            distortion = Distortion.from_coefficients(message.distortion_model, tuple(map(float, message.d)))
            check_coefficients(distortion, 'd')
        except InputError as error:
            distortion, note = Distortion(), f'{error}; it is not used'
    full = message.width, message.height
    if all(full) and not all(
        CENTRE_RANGE[0] <= c / s <= CENTRE_RANGE[1] for c, s in zip(matrix[:2, 2], full, strict=True)
    ):
        centre = f'principal point {matrix[0, 2]:g}, {matrix[1, 2]:g} px in an image of {full[0]} x {full[1]} px'
        note = '; '.join(
            filter(None, (note, f'{name}: {centre}; check that it is not calibrated for another size'))
        )
    size, matrix = _select_region(message, matrix)
    try:
        intrinsics = Intrinsics.from_matrix(matrix, distortion, size if all(size) else None)
        if intrinsics.focal < MIN_FOCAL_SHARE * size[0]:
            raise InputError(f'focal length of {intrinsics.focal:g} px in an image {size[0]} px wide')
    except InputError as error:
        reason = error if matrix[[0, 1], [0, 1]].any() else 'is 0'
        fault = f'{name}: {reason}; the camera is not calibrated'
        if not all(size):
            raise InputError(
                f'{fault}, and width and height are 0: set node.image_width and node.image_height'
            ) from None
        note = f'{fault}: its image size of {size[0]} x {size[1]} px is used, with a nominal focal length'
        intrinsics = Intrinsics.from_image_size(*size, focal_in_sides=1.0)
    return CameraInfo(size, intrinsics, message.header.frame_id, note, raw)


def check_coefficients(distortion: Distortion, name: str) -> None:
    """Raise InputError, which begins with the name, if a coefficient is beyond those of any lens."""
    largest = max(distortion.coefficients, key=abs, default=0.0)
    if abs(largest) > MAX_COEFFICIENT:
        raise InputError(f'{name}: {largest:g}, more than a lens has ({MAX_COEFFICIENT:g})')


def _select_region(message: Any, matrix: Array) -> tuple[ImageSize, Array]:
    """Return the size and, of that of the full resolution, the camera matrix (3, 3) of what is sent, in px."""
    region = message.roi
    binning = np.maximum([message.binning_x, message.binning_y], 1)
    full = message.width, message.height
    sides = np.array([region.width or full[0], region.height or full[1]]) // binning
    out = matrix.copy()
    out[:2, 2] -= region.x_offset, region.y_offset
    out[:2] /= binning[:, None]
    return (int(sides[0]), int(sides[1])), out
