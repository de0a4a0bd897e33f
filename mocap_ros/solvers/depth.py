# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Measured depths of surfaces, as evidence of where joints are along their lines of sight.

A depth camera sees the surface before joint j at d_j along the optical axis, the joint is t_j behind it, and
a.(r_j, 1) turns that to the axis a of the camera that faces the person. A body whose middle is Z away has the
joint at Z (1 + p_j), with p_j of its pose, in units of the distance:

    z_j = a.(r_j, 1) (d_j + t_j)
    z_j ~ Q_j N(Z (1 + p_j), (Z_0 s_j)^2 + n_j^2) + (1 - Q_j) / W,    n_j^2 = N_0^2 + (N_1 z_j^2)^2
    Z / Z_0 - 1 ~ Cauchy(P)

s_j is the deviation of the pose along the line of sight and N_1 z^2 the error of a stereo camera. What else is
seen at a joint (furniture, the wall, another part of the body) is anywhere within W. Q is the share of joints that
are seen themselves: half of them, since a detector's points lie beside limbs, and next to none of those that have
a part of the body before them, a capsule of its radius. Z is the likeliest, and k_j the probability that the joint
was seen, by which its depth counts less:

    p_j <- p_j + c_j,    c_j = g_j (z_j / Z - 1 - p_j),    g_j = s_j^2 / (s_j^2 + n_j^2 / (k_j Z^2))
    s_j^2 <- s_j^2 (1 - g_j)

and what hangs on a joint goes with it. Live, c_j follows with the time constant T, as k_j and the depths jump from
frame to frame. Lifted poses are corrected in this way, where Z_0 follows from the body height. Of solved poses,
x = ln(Z / Z_0) is the logarithm of the person's size.

The thickness is t_j = t_0 + t_f max(cos h, 0) + t_b max(-cos h, 0), with the angle h between the directions in
which the trunk faces and in which the camera is. All constants, also those in `engine/depth.pyx`, were chosen on
simulated bodies before a simulated stereo camera, with the motion of training persons (`benchmarks/depth.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import depth as engine
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import CMU15, HIPS
from mocap_ros.solvers.extremities import SEGMENT_OF

EXPECTED_SHARE = 0.09  # 1; P, of the distance that the body height and a pose show
FADE_S = 0.08  # s; T
POSE_STD_M = 0.05  # m; s_j of a solved pose
MIN_SEEN = 1.5  # joints, a sum of probabilities; fewer show no size
MAX_JUMP = 0.2  # 1; of x from one frame to the known size; more is somebody or something else
LEAST_STD_M = 0.015  # m; of the depth of a body, whose surfaces and depth camera have lasting errors
OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])  # of the real camera, along which solved bodies are compared
# m; t_0, t_f and t_b
THICKNESS_M = {
    'shoulder': (0.07, 0.0, 0.025),
    'elbow': (0.047, 0.0, 0.0),
    'wrist': (0.03, 0.0, 0.0),
    'hip': (0.085, 0.055, 0.0),
    'knee': (0.07, 0.0, 0.01),
    'ankle': (0.048, 0.0, 0.0),
}
# m; radii of the parts of the body between two joints
TRUNK_RADII_M = {
    ('neck', 'pelvis'): 0.12,
    ('lshoulder', 'rshoulder'): 0.07,
    ('lhip', 'rhip'): 0.09,
    ('neck', 'head'): 0.09,
}
# m; of those of each side
SIDE_RADII_M = {
    ('shoulder', 'hip'): 0.09,
    ('shoulder', 'elbow'): 0.05,
    ('elbow', 'wrist'): 0.04,
    ('hip', 'knee'): 0.075,
    ('knee', 'ankle'): 0.05,
}


def _list_thickness() -> Array:
    return np.array([THICKNESS_M.get(joint[1:], (0.0, 0.0, 0.0)) for joint in CMU15.joints])


def _list_segments() -> tuple[NDArray[np.int64], Array]:
    radii = dict(TRUNK_RADII_M)
    for (start, end), radius in SIDE_RADII_M.items():
        radii |= {(side + start, side + end): radius for side in 'lr'}
    return np.array([[CMU15.index(joint) for joint in ends] for ends in radii]), np.array([*radii.values()])


def _list_carriers() -> Array:
    """Return the share (15, 15) of each joint's correction in that of every joint; the trunk follows its ends."""
    carriers = np.eye(len(CMU15.joints))
    for joint, of_shoulders in (('head', 1.0), ('neck', 1.0), ('pelvis', 0.2)):
        row = carriers[CMU15.index(joint)]
        row[:] = 0
        row[list(SHOULDERS)], row[list(HIPS)] = of_shoulders / 2, (1 - of_shoulders) / 2
    return carriers


SHOULDERS = CMU15.index('lshoulder'), CMU15.index('rshoulder')
THICKNESS, SEGMENTS, CARRIERS = _list_thickness(), _list_segments(), _list_carriers()


class Corrections(NamedTuple):
    """What measured depths change of N poses along the axes of their virtual cameras, in units of the distance."""

    depth: Array  # (N, 15) c_j
    kept: Array  # (N, 15) 1 - g_j, the share of the variance that is left

    def apply(self, lifted: LiftedPoses) -> LiftedPoses:
        """Return lifted poses with these corrections, in the axes of the virtual cameras."""
        moved = self.depth @ CARRIERS.T
        moved -= moved.mean(axis=1, keepdims=True)
        joints, std = lifted.joints.copy(), lifted.std.copy()
        joints[..., 2] += moved[:, SEGMENT_OF]
        std[..., 2] *= np.sqrt(self.kept)[:, SEGMENT_OF]
        return LiftedPoses(joints, std)


def fade(before: Array, found: Array, step_s: float) -> Array:
    """Return the correction (15,) of a live frame, some time in s after one that had another."""
    return np.asarray(before - (found - before) * math.expm1(-step_s / FADE_S))


def find_corrections(
    surface: Array, rays: Array, cameras: Array, lifted: LiftedPoses, body_height: Array | float
) -> Corrections:
    """Return what the depths of surfaces (N, 15) m at joints with rays (N, 15, 2) change of lifted poses.

    Args:
        surface: (N, 15) m along the optical axis of the real camera; NaN where unknown.
        rays: (N, 15, 2) x / z and y / z of the joints in the real camera.
        cameras: (N, 3, 3) rotations from the real camera to the virtual ones, in whose axes the poses are.
        lifted: N poses.
        body_height: m, stature of the person, or (N,) in each frame.
    """
    poses, std = lifted.joints[:, : len(CMU15.joints)], lifted.std[:, : len(CMU15.joints), 2]
    stature = CMU15.bone_lengths(poses) @ CMU15.stature_per_bone
    _, _, deviation, trust, noise = _measure(surface, rays, cameras[:, 2], poses, std, body_height / stature)
    share = std**2 / (std**2 + noise**2 / np.maximum(trust, 1e-9))
    is_known = trust > 0
    return Corrections(np.where(is_known, share * deviation, 0.0), np.where(is_known, 1 - share, 1.0))


class BodyDepth(NamedTuple):
    """How much farther away N bodies are measured than solved."""

    log_size: Array  # (N,) x; NaN where too few joints are measured
    std: Array  # (N,) standard deviation of x in this frame

    def find_displacement(self, core: Array, size: Array) -> Array:
        """Return by how much bodies (N, 15, 3) m are to move along the optical axis; `size` (N,) is their r.

        Returns (N, 2) m, and the information on them in 1/m^2, 0 where nothing is known.
        """
        depth, beyond = core[..., 2].mean(axis=1), self.log_size - np.log(size)
        is_known = np.abs(beyond) < MAX_JUMP  # not of NaN
        ahead = depth * np.expm1(beyond)
        information = 1 / ((depth * self.std) ** 2 + LEAST_STD_M**2)
        return np.where(is_known[:, None], np.column_stack([ahead, information]), 0.0)


def compare_depths(surface: Array, core: Array, size: Array) -> BodyDepth:
    """Compare the depths (N, 15) m of surfaces with those of solved bodies (N, 15, 3) m in the real camera.

    `size` (N,) is r, by which the bodies are expected to be larger.
    """
    middle = core.mean(axis=1)
    distance = np.ascontiguousarray(middle[:, 2])
    poses = (core - middle[:, None]) / distance[:, None, None]
    std = np.repeat(POSE_STD_M / distance[:, None], core.shape[1], axis=1)
    axes = np.tile(OPTICAL_AXIS, (len(core), 1))
    found, variance, _, trust, _ = _measure(surface, core[..., :2], axes, poses, std, size * distance)
    is_known = (trust.sum(axis=1) >= MIN_SEEN) & np.isfinite(distance)
    return BodyDepth(np.where(is_known, np.log(found / distance), np.nan), np.sqrt(variance) / found)


def _measure(
    surface: Array, rays: Array, axes: Array, poses: Array, std: Array, expected: Array
) -> tuple[Array, Array, Array, Array, Array]:
    left = poses[:, SHOULDERS[0]] - poses[:, SHOULDERS[1]] + poses[:, HIPS[0]] - poses[:, HIPS[1]]
    up = poses[:, SHOULDERS].sum(axis=1) - poses[:, HIPS].sum(axis=1)
    forwards = left[:, [1, 2, 0]] * up[:, [2, 0, 1]] - left[:, [2, 0, 1]] * up[:, [1, 2, 0]]
    towards = -forwards[:, 2] / np.sqrt((forwards**2).sum(axis=1))  # cos h
    angle = np.array([np.ones(len(poses)), np.fmax(towards, 0), np.fmax(-towards, 0)]).T
    return engine.measure_depths(
        np.ascontiguousarray(surface),
        np.ascontiguousarray(rays),
        np.ascontiguousarray(axes),
        np.ascontiguousarray(poses),
        np.ascontiguousarray(std),
        expected,
        EXPECTED_SHARE,
        angle @ THICKNESS.T,
        *SEGMENTS,
    )
