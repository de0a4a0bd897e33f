# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether the intrinsics of a frame count as those of the frames before.

A camera with autofocus, or a calibration that goes on while the robot runs, sends a CameraInfo that differs a
little from image to image. Under new intrinsics the whole window is lifted anew, velocities begin from nothing and
the vertical is forgotten, so small differences are left out. With f the focal length, a the aspect and c the
principal point, two intrinsics are of the same camera if

    |f' / f - 1| <= e,   |a' / a - 1| <= e,   |c' - c| <= e f

and distortion and image size are equal. The intrinsics of a frame are compared with those in use, not with those
that the frame before came with, so differences do not add up.
"""

from __future__ import annotations

import math

from mocap_ros.geometry.intrinsics import Intrinsics

# 1; e: 4 mm of the depth of a person 4 m away, and below a pixel in the image, where detectors err by several
MAX_DIFFERENCE = 1e-3


def is_same_camera(used: Intrinsics, given: Intrinsics) -> bool:
    """Return whether the intrinsics that a frame comes with count as those in use."""
    return (
        used.is_focal_known == given.is_focal_known
        and used.image_size == given.image_size
        and used.distortion == given.distortion
        and abs(given.focal / used.focal - 1) <= MAX_DIFFERENCE
        and abs(given.aspect / used.aspect - 1) <= MAX_DIFFERENCE
        and math.dist(given.center, used.center) <= MAX_DIFFERENCE * used.focal
    )
