# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies and people in 3D: one that stands and swings all its limbs, people as the tracker returns them, and one
that stands upright with hanging arms, as its segments' axes are defined by it; angles of directions."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.offline.keyframes.motion import assemble_poses, compute_limb_directions
from mocap_ros.people import Motion, MotionKind, People, Person3D
from mocap_ros.skeleton import CMU15, Skeleton

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


def make_person_3d(person_id: str, x: float = 0.0) -> Person3D:
    return People(
        ids=(person_id,),
        skeleton=CMU15,
        joints=np.arange(45.0).reshape(1, 15, 3) + x,
        inferred=np.arange(15)[None] == 2,
        scale=np.array([120.0]),
        rotation=Rotation.from_euler('zx', [30, 80], degrees=True).as_matrix()[None],
        translation=np.array([[320.0, 240.0]]),
        motion=(Motion(MotionKind.UNKNOWN, 'all', 0.1, float('nan')),),
        reprojection_residual=np.array([2.5]),
        is_scale_known=True,
    )[0]


def gather(people: Sequence[Person3D], skeleton: Skeleton = CMU15) -> People:
    """Return people of one frame, who all have the same skeleton, as columns."""
    if not people:
        return People.none(skeleton)
    first, rows = people[0], [vars(person) for person in people]
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    ids, motion = tuple(columns.pop('id')), tuple(person.motion for person in people)
    fixed: dict[str, Any] = {'skeleton': first.skeleton, 'is_scale_known': first.is_scale_known, 'motion': motion}
    return People(ids=ids, **{**columns, **fixed})


def make_standing_person(person_id: str) -> Person3D:
    """Return a person who stands 4 m before the camera."""
    return replace(make_person_3d(person_id), joints=STANDING + [0, 0, 4])


_HALF = {'shoulder': (0.18, 1.42), 'elbow': (0.18, 1.14), 'wrist': (0.18, 0.88), 'hip': (0.09, 0.92)}
_HALF |= {'knee': (0.09, 0.5), 'ankle': (0.09, 0.08)}  # m to the side, m above the floor
_MIDDLE = {'head': 1.65, 'neck': 1.48, 'pelvis': 1.0}  # m above the floor
# m, (15, 3) of `CMU15`: x forward, y to the left, z up
UPRIGHT = np.array(
    [
        (0.0, 0.0, _MIDDLE[name])
        if name in _MIDDLE
        else (0.0, _HALF[name[1:]][0] * (1 if name[0] == 'l' else -1), _HALF[name[1:]][1])
        for name in CMU15.joints
    ]
)


def angles_deg(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (...) between directions (..., 3) of any length."""
    norms = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1) / norms, -1, 1)))
