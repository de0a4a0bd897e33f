"""Where a detector's trunk joints lie beside the model's.

A detector's pelvis may be the middle of its hips, the model's lies a hand's breadth above them. A motion whose
limbs have fixed lengths cannot meet such points, and bends everything else instead. So the mean offset of each
joint of the trunk, constant in the body's frame, is found from 3D proposals and taken off the image points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import centred, rotation_to
from mocap_ros.offline.keyframes.gradient_fit import Placed
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

TRUNK = tuple(CMU15.index(j) for j in ('head', 'neck', 'lshoulder', 'rshoulder', 'pelvis', 'lhip', 'rhip'))
ROUNDS, ROBUST, RIDGE = 4, 0.05, 0.2
SMALLEST = 1e-9


def body_rotations(joints: Array, body: Array) -> Array:
    """(F, 3, 3) from the frame of a mean pose `body` (J, 3) to that of poses (F, J, 3)."""
    return rotation_to(np.broadcast_to(body - body.mean(axis=0), joints.shape), centred(joints))


def joint_offsets(motion: Placed, points: Array, weight: Array, focal: float, body: Array) -> Array:
    """Mean offsets of detected joints from the model's, by robust least squares over all frames.

    Args:
        motion: 3D proposals placed in the image.
        points: (F, J, 2) px, anything where the weight is 0.
        weight: (F, J).
        focal: px, or infinite.
        body: (J, 3) m, mean pose, whose frame is the body's.

    Returns:
        (J, 3) m in the body's frame; 0 for limbs.
    """
    seen = body_rotations(motion.joints, body)[:, None, :2]
    away = motion.lifted(points, focal) - motion.joints[..., :2]
    out = np.zeros_like(body)
    for joint in TRUNK:
        offset = np.zeros(3)
        rows, target = seen[:, 0], away[:, joint]
        for _ in range(ROUNDS):
            error = target - rows @ offset
            trust = weight[:, joint] / (1 + (error**2).sum(axis=-1) / ROBUST**2)
            normal = np.einsum('f,fdi,fdj->ij', trust, rows, rows)
            side = np.einsum('f,fdi,fd->i', trust, rows, target)
            offset = np.linalg.solve(normal + (RIDGE * trust.sum() + SMALLEST) * np.eye(3), side)
        out[joint] = offset
    return out


def without_offsets(offsets: Array, motion: Placed, points: Array, focal: float, body: Array) -> Array:
    """(F, J, 2) px, image points moved to where the model's joints are; arguments as of `joint_offsets`."""
    turned = (body_rotations(motion.joints, body) @ offsets.T).swapaxes(-1, -2)
    return np.asarray(points - (motion.scale[:, None] / motion.depth(focal))[..., None] * turned[..., :2])
