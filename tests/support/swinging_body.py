# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A synthetic body that stands and swings all its limbs."""

import numpy as np

from mocap_ros.offline.keyframes.motion import assemble_poses, compute_limb_directions
from mocap_ros.skeleton import CMU15

# m, a standing pose (15, 3) of `CMU15` in the camera's optical frame: x right, y down, z away
STANDING = np.array(
    [
        [0, -0.75, 0], [0, -0.5, 0], [0.18, -0.48, 0.02], [0.25, -0.2, 0.05], [0.28, 0.05, -0.1],
        [-0.18, -0.48, 0.02], [-0.25, -0.2, 0.0], [-0.3, 0.03, -0.12], [0, 0, 0], [0.1, 0.05, 0.01],
        [0.12, 0.45, -0.05], [0.13, 0.88, 0.05], [-0.1, 0.05, 0.01], [-0.12, 0.46, -0.02], [-0.12, 0.87, 0.1],
    ]
)  # fmt: skip
BONE_LENGTHS = CMU15.bone_lengths(STANDING)


def make_swinging_body(frames: int, fps: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (F, 15, 3) m of a body that swings all limbs, and times (F,) s."""
    times = np.arange(frames) / fps
    directions = np.repeat(compute_limb_directions(STANDING, CMU15.bones)[None], frames, axis=0)
    for bone, (_, child) in enumerate(CMU15.bones):
        angle = 0.6 * np.sin(2 * np.pi * (0.4 + 0.03 * child) * times + child) * (child not in (0, 1, 2, 5, 9, 12))
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = directions[:, bone].T
        directions[:, bone] = np.stack([x, c * y - s * z, s * y + c * z], axis=-1)
    return assemble_poses(directions, BONE_LENGTHS, CMU15), times
