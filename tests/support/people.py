# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People in 3D, as the tracker returns them."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mocap_ros.people import Motion, MotionKind, Person3D
from tests.support.swinging_body import STANDING


def make_person_3d(person_id: str, x: float = 0.0) -> Person3D:
    joints = np.arange(45.0).reshape(15, 3) + x
    return Person3D(
        id=person_id,
        joints=joints,
        std=np.full(15, np.nan),
        inferred=np.arange(15) == 2,
        scale=120.0,
        rotation=Rotation.from_euler('zx', [30, 80], degrees=True).as_matrix(),
        translation=np.array([320.0, 240.0]),
        motion=Motion(MotionKind.UNKNOWN, 'all', 0.1, float('nan')),
        residual=2.5,
        scale_known=True,
        predicted=False,
    )


def make_standing_person(person_id: str) -> Person3D:
    """Return a person who stands 4 m before the camera."""
    return replace(make_person_3d(person_id), joints=STANDING + [0, 0, 4])
