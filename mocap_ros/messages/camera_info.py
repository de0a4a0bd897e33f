"""sensor_msgs/CameraInfo: image size and intrinsics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KeypointsFrame

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'


@dataclass(frozen=True)
class CameraInfo:
    """The part of a sensor_msgs/CameraInfo that is used: image size (px, 0 unknown) and intrinsics."""

    width: int
    height: int
    intrinsics: Intrinsics


def image_size(camera: CameraInfo | None, node: NodeConfig) -> tuple[int, int]:
    """Of images whose messages do not say it: (width, height) px by CameraInfo, else by the parameters, else 0."""
    if camera is not None and camera.width and camera.height:
        return camera.width, camera.height
    return (node.image_width, node.image_height) if node.image_width and node.image_height else (0, 0)


def check_size(frame: KeypointsFrame, camera: CameraInfo) -> None:
    """Refuse an image that is not of this camera.

    Raises:
        InputError: both say a size, and not the same.
    """
    said, calibrated = (frame.image_width, frame.image_height), (camera.width, camera.height)
    if all(said) and all(calibrated) and said != calibrated:
        raise InputError(
            'image_width, image_height: {} x {} px, but CameraInfo is for {} x {} px'.format(*said, *calibrated)
        )


def decode_camera_info(raw: bytes, *, rectified: bool = False) -> CameraInfo:
    """Image size and intrinsics of a sensor_msgs/CameraInfo.

    Args:
        raw: CDR.
        rectified: whether keypoints are those of the rectified image: P holds then (K where P is not set), and the
            lens has no distortion.

    Raises:
        InputError: not a CameraInfo, its matrix is not set, or its distortion model is not known.
    """
    message = decode(raw, CAMERA_INFO)
    field, matrix = 'k', np.asarray(message.k, np.float64).reshape(3, 3)
    if rectified and message.p[0]:
        field, matrix = 'p', np.asarray(message.p, np.float64).reshape(3, 4)[:, :3]
    lens = Distortion()
    if not rectified:
        lens = Distortion.named(message.distortion_model, tuple(map(float, message.d)))
    try:
        intrinsics = Intrinsics.from_matrix(matrix, lens)
    except InputError as error:
        raise InputError(f'{field}: {error}; the camera is not calibrated') from None
    return CameraInfo(message.width, message.height, intrinsics)
