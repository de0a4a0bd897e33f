# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The volume of a body about its true joints, by stated girths: what capsules should hold.

Limbs are elliptic cones between two joints, with the half axes a and b at either end; a point of their volume is

    x = p + s (q - p) + sqrt(u) (a(s) cos w e_1 + b(s) sin w e_2)

with s of the density a(s) b(s), u and w uniform. The head is an ellipsoid about the ears. The lengths are those of
`STATURE_M` and scale with the true stature.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26

Array = NDArray[np.float64]

STATURE_M = 1.75  # m; of the body with the girths below, those of an adult of usual weight without clothes
POINTS = 400  # of a body, shared by volume
HEAD_HALF_AXES_M = np.array([0.1, 0.078, 0.115])  # m; forward, to the left, up: a head 0.2 m long and 0.23 m high
HEAD_OVER_EARS_M = 0.02  # m; of the middle of the head
# Each limb: the joints whose middles are its start and its end; m, half axes at the start and at the end, the
# first from left to right of the body where they differ; and how far it reaches beyond start and end, as a share
# of its length. Girths of 0.33 m (upper arm), 0.29 and 0.18 m (forearm, wrist), 0.6 and 0.4 m (thigh, above the
# knee), 0.39 and 0.24 m (calf, ankle) and 0.38 m (neck) are radii of girth / 2 pi; a trunk is 0.34 by 0.24 m at
# the hips and 0.32 by 0.2 m at the shoulders. A hand with half-bent fingers and a foot are 0.16 and 0.26 m long.
LIMBS = (
    (('lhip', 'rhip'), ('lshoulder', 'rshoulder'), ((0.17, 0.12), (0.16, 0.1)), (0.0, 0.0)),
    (('lshoulder', 'rshoulder'), ('lear', 'rear'), ((0.06, 0.06), (0.06, 0.06)), (0.0, 0.0)),
    *(
        ((side + start,), (side + end,), axes, beyond)
        for side in 'lr'
        for start, end, axes, beyond in (
            ('shoulder', 'elbow', ((0.053, 0.053), (0.045, 0.045)), (0.0, 0.0)),
            ('elbow', 'wrist', ((0.046, 0.046), (0.029, 0.029)), (0.0, 0.0)),
            ('wrist', 'hand', ((0.04, 0.03), (0.03, 0.02)), (0.0, 0.6)),
            ('hip', 'knee', ((0.095, 0.095), (0.064, 0.064)), (0.0, 0.0)),
            ('knee', 'ankle', ((0.062, 0.062), (0.038, 0.038)), (0.0, 0.0)),
            ('heel', 'toe', ((0.035, 0.04), (0.045, 0.025)), (0.1, 0.25)),
        )
    ),
)


def sample_body(joints: Array, stature: float, rng: np.random.Generator) -> Array:
    """Return points (N, 3) m in the volume of a body.

    Args:
        joints: (26, 3) m, true joints in the order of `BODY26`.
        stature: m, true stature.
        rng: draws the points.
    """
    size, at = stature / STATURE_M, dict(zip(BODY26.joints, joints, strict=True))
    left = at['lhip'] - at['rhip'] + at['lshoulder'] - at['rshoulder']
    cones, volumes = [], []
    for start, end, axes, (before, beyond) in LIMBS:
        p, q = (np.mean([at[name] for name in ends], axis=0) for ends in (start, end))
        p, q = p - before * (q - p), q + beyond * (q - p)
        half = np.array(axes) * size
        cones.append((p, q, half))
        volumes.append(float(np.linalg.norm(q - p) * np.pi * half.prod(axis=1).mean()))
    head = HEAD_HALF_AXES_M * size
    volumes.append(float(4 / 3 * np.pi * head.prod()))
    counts = np.maximum(np.round(np.array(volumes) / sum(volumes) * POINTS), 1).astype(int).tolist()
    found = [_sample_cone(*cone, left, count, rng) for cone, count in zip(cones, counts[:-1], strict=True)]
    ears = (at['lear'] + at['rear']) / 2
    forward, side = at['nose'] - ears, at['lear'] - at['rear']
    frame = np.stack([_unit(forward), _unit(np.cross(np.cross(forward, side), forward)), np.zeros(3)])
    frame[2] = np.cross(frame[0], frame[1])
    inside = rng.normal(size=(counts[-1], 3))
    inside *= (rng.random(len(inside)) ** (1 / 3) / np.linalg.norm(inside, axis=1))[:, None]
    return np.concatenate([*found, ears + (inside * head + [0, 0, HEAD_OVER_EARS_M * size]) @ frame])


def _sample_cone(p: Array, q: Array, axes: Array, left: Array, count: int, rng: np.random.Generator) -> Array:
    """Return points (count, 3) in an elliptic cone from p to q (3,) with half axes (2, 2), as in the module."""
    way = rng.random(8 * count)
    area = (axes[0] + way[:, None] * (axes[1] - axes[0])).prod(axis=1)
    way = rng.choice(way, count, p=area / area.sum())
    half = axes[0] + way[:, None] * (axes[1] - axes[0])
    along = _unit(q - p)
    first = _unit(left - (left @ along) * along)
    angle, radius = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.random(count))
    across = (radius * np.cos(angle) * half[:, 0])[:, None] * first
    across += (radius * np.sin(angle) * half[:, 1])[:, None] * np.cross(along, first)
    return np.asarray(p + way[:, None] * (q - p) + across)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))
