# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint angles of a person, as biomechanics name them.

The axes of every segment are x forward, y up and z to the right of a person who stands upright with hanging arms.
There all angles are 0. The ground has y up as well. With R_a(q) the rotation by the angle q about the axis a, the
segments are turned, from the ground outwards, by

    pelvis = R_y(pelvis_rotation) R_x(pelvis_list) R_z(pelvis_tilt)
    torso  = pelvis R_z(lumbar_extension) R_x(lumbar_bending) R_y(lumbar_rotation)
    head   = torso R_z(neck_extension) R_x(neck_bending)
    thigh  = pelvis R_z(hip_flexion) R_x(+-hip_adduction) R_y(+-hip_rotation),    shank = thigh R_z(-knee_angle)
    arm    = torso R_z(arm_flex) R_x(+-arm_add) R_y(+-arm_rot),                   forearm = arm R_z(elbow_flex)

with + on the right and - on the left side of the body. Names, signs and orders are those of OpenSim's model
Rajagopal2016 but for the pelvis, whose turn about the vertical comes first here: so tilt and list mean the same
for every heading (Baker, Gait & Posture 13, 2001). The neck is no joint of that model.

Joint positions determine the segments like this:

- pelvis: z from the left to the right hip; y at a constant angle, `UPRIGHT_DEG`, in front of the direction from
  the middle between the hips to the joint `pelvis`, which in CMU's skeleton is 0.1 m above and behind.
- torso: y from the pelvis to the neck, z as near as possible to the direction from the left to the right shoulder.
- thigh, shank, arm, forearm, head: along the bone. The turn of thigh and arm about themselves follows from the
  plane in which knee or elbow is bent, e^(i psi) with the weight w = |sin(knee_angle)|. Where that is nearly
  straight, w < W, it is smoothed, or interpolated between the frames in which it is bent:

      z = argmin sum_t w_t^2 |z_t - e^(i psi_t)|^2 + c_t |z_(t+1) - z_t|^2 + E |z_t - 1|^2,   psi = arg z
      c_t = (T r)^2 max(0, W^2 - min(w_t, w_(t+1))^2)

  with r the frames per second. The angle hip_flexion or arm_flex is smoothed in the same way, with w the cosine of
  the second angle, as it means nothing where the limb points straight to the side.

Whether the second angle is beyond 90 degrees, and whether knee or elbow is a little overstretched, as of those
who stand, is what lets the first angle turn least (`_follow_sign`); whole turns are those of `_drop_turns`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.skeleton import CMU15

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ComplexArray = NDArray[np.complex128]

UPRIGHT_DEG = 23.0  # degrees; with it lumbar_extension is 0 in the mean pose of walkers (`walk.npz`)
WEAK_SINE = 0.2  # W; sine of 12 degrees, that separates a bent joint from the noise of a straight one
SMOOTHING_S = 0.1  # T, s; over about this time an angle is smoothed where its weight is near W
NEUTRAL_WEIGHT = 1e-6  # E; decides only where a limb is straight in all frames
SWITCH_COST = 0.01  # 1; cost of a half turn between two frames in which the angle means nothing
UNUSUAL_COST = 1e-4  # 1 a frame; cost of a second angle beyond 90 degrees
BACKWARDS_COST = 1e-3  # 1 a frame; of a limb that is turned backwards
OVERSTRETCHED_COST = 1.0  # 1 a frame; of a limb that is bent the wrong way by more than W
TINY = np.finfo(float).tiny  # guards divisions by the length of a vector

SIDES = {'r': 1.0, 'l': -1.0}  # suffix of a side in the names of angles, and its sign above
POSITIONS = ('pelvis_tx', 'pelvis_ty', 'pelvis_tz')  # m; all other coordinates are angles
LEG = 'hip_flexion', 'hip_adduction', 'hip_rotation', 'knee_angle'
ARM = 'arm_flex', 'arm_add', 'arm_rot', 'elbow_flex'
COORDINATES = (
    'pelvis_tilt', 'pelvis_list', 'pelvis_rotation', *POSITIONS,
    *(f'{name}_{side}' for side in SIDES for name in LEG),
    'lumbar_extension', 'lumbar_bending', 'lumbar_rotation', 'neck_extension', 'neck_bending',
    *(f'{name}_{side}' for side in SIDES for name in ARM),
)  # fmt: skip


def compute_joint_angles(joints: Array, fps: float) -> Array:
    """Return the coordinates (F, C) of a motion, in the order of `COORDINATES`.

    They are angles in degrees, without jumps by a full turn, and positions in m. Joints (F, 15, 3) are in m, y up,
    in the order of `skeleton.CMU15`, all finite.
    """
    from scipy.spatial.transform import Rotation

    at = {name: joints[:, i] for i, name in enumerate(CMU15.joints)}
    trunk = at['neck'] - at['pelvis']
    between_hips = (at['lhip'] + at['rhip']) / 2
    backward = _align(across=at['rhip'] - at['lhip'], up=at['pelvis'] - between_hips, is_up_exact=False)
    pelvis = backward * Rotation.from_euler('z', -UPRIGHT_DEG, degrees=True)
    torso = _align(across=at['rshoulder'] - at['lshoulder'], up=trunk, is_up_exact=True)
    angles: dict[str, Array] = {}
    angles |= zip(('pelvis_rotation', 'pelvis_list', 'pelvis_tilt'), _follow_pelvis(pelvis).T, strict=True)
    lumbar = pelvis.inv() * torso
    extension, bending = _split_direction(lumbar.apply([0.0, -1.0, 0.0]), fps)
    bent = Rotation.from_euler('ZX', np.stack([extension, bending], axis=1))
    right = (bent.inv() * lumbar).apply([0.0, 0.0, 1.0])
    angles['lumbar_extension'], angles['lumbar_bending'] = extension, bending
    angles['lumbar_rotation'] = np.unwrap(np.arctan2(right[:, 0], right[:, 2]))
    head = _normalise(torso.inv().apply(at['head'] - at['neck']))
    angles['neck_extension'], angles['neck_bending'] = _split_direction(-head, fps)
    limbs = ((pelvis, ('hip', 'knee', 'ankle'), LEG, -1.0), (torso, ('shoulder', 'elbow', 'wrist'), ARM, 1.0))
    for side, sign in SIDES.items():
        for parent, chain, names, bend in limbs:
            begin, middle, end = (at[side + joint] for joint in chain)
            upper, lower = (_normalise(parent.inv().apply(bone)) for bone in (middle - begin, end - middle))
            values = _measure_limb(upper, lower, sign, bend, fps)
            angles |= {f'{name}_{side}': v for name, v in zip(names, values, strict=True)}
    columns = {name: np.degrees(values) for name, values in angles.items()}
    columns |= dict(zip(POSITIONS, at['pelvis'].T, strict=True))
    return np.column_stack([columns[name] for name in COORDINATES])


def _align(across: Array, up: Array, *, is_up_exact: bool) -> Rotation:
    """Return the rotations of segments whose z axis points across and y axis up (F, 3), one of them exactly."""
    from scipy.spatial.transform import Rotation

    exact = _normalise(up if is_up_exact else across)
    other = across if is_up_exact else up
    x = np.cross(exact, other) if is_up_exact else np.cross(other, exact)
    is_line = np.linalg.norm(x, axis=1) == 0
    x[is_line] = np.cross(
        exact[is_line], np.eye(3)[np.abs(exact[is_line]).argmin(axis=1)]
    )  # any that is square to it
    x = _normalise(x)
    y, z = (exact, np.cross(x, exact)) if is_up_exact else (np.cross(exact, x), exact)
    return Rotation.from_matrix(np.stack([x, y, z], axis=-1))


def _normalise(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.maximum(length, TINY), [0.0, 1.0, 0.0])


def _follow_pelvis(pelvis: Rotation) -> Array:
    """Return rotation, list and tilt (F, 3) in rad, of two equal triples the one nearer to the frame before."""
    matrix = pelvis.as_matrix()
    lean = np.arcsin(np.clip(-matrix[:, 1, 2], -1.0, 1.0))
    turn = np.arctan2(matrix[:, 0, 2], matrix[:, 2, 2])
    tilt = np.arctan2(matrix[:, 1, 0], matrix[:, 1, 1])
    usual = np.stack([turn, lean, tilt], axis=1)
    other = np.stack([turn + np.pi, np.pi - lean, tilt + np.pi], axis=1)
    chosen = usual.copy()
    for frame in range(1, len(usual)):
        distance = [np.abs(_wrap(v[frame] - chosen[frame - 1])).sum() for v in (usual, other)]
        chosen[frame] = (usual if distance[0] <= distance[1] else other)[frame]
    return np.unwrap(chosen, axis=0)


def _wrap(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _measure_limb(upper: Array, lower: Array, sign: float, bend: float, fps: float) -> tuple[Array, ...]:
    """Return flexion, adduction, rotation and bend (F,) in rad of a limb.

    The directions (F, 3) of its bones point downwards, in the axes of the parent; `sign` is 1 for the right and -1
    for the left side, `bend` 1 if the lower bone is bent forwards (elbow), -1 if backwards (knee).
    """
    from scipy.spatial.transform import Rotation

    mirror = np.array([1.0, 1.0, sign])
    flexion, adduction = _split_direction(upper * mirror, fps)
    turned = Rotation.from_euler('ZX', np.stack([flexion, adduction], axis=1)).inv().apply(lower * mirror)
    plane: ComplexArray = bend * (turned[:, 0] - 1j * turned[:, 2])
    weight = np.abs(plane)
    backwards = BACKWARDS_COST * plane.real / np.maximum(weight, TINY)
    bent = np.where(turned[:, 1] > 0, 1.0, weight)  # the sine, and 1 beyond 90 degrees
    wrong = backwards + OVERSTRETCHED_COST * np.maximum(bent - WEAK_SINE, 0.0) ** 2
    rotation = _unwrap_phase(_smooth(_follow_sign(plane, np.stack([-backwards, wrong], axis=1)) * plane, fps))
    in_plane = (plane * np.exp(-1j * rotation)).real
    knee = np.arctan2(in_plane, -turned[:, 1])
    return _drop_turns(flexion, -np.pi / 2), adduction, _drop_turns(rotation, -np.pi), knee


def _split_direction(down: Array, fps: float) -> tuple[Array, Array]:
    """Return the angles q, p (F,) in rad of R_z(q) R_x(p) that turn the downward direction to these (F, 3)."""
    plane: ComplexArray = -down[:, 1] + 1j * down[:, 0]  # e^(iq) cos(p)
    unusual = UNUSUAL_COST * (1 + 9 * (1 - down[:, 2] ** 2))
    sign = _follow_sign(plane, np.stack([np.zeros(len(down)), unusual], axis=1))
    first = _unwrap_phase(_smooth(sign * plane, fps))
    return first, np.unwrap(np.arctan2(-down[:, 2], (plane * np.exp(-1j * first)).real))


def _unwrap_phase(numbers: ComplexArray) -> Array:
    return np.unwrap(np.arctan2(numbers.imag, numbers.real))


def _drop_turns(angle: Array, least: float) -> Array:
    """Return angles (F,) in rad, moved together by whole turns so that their median is the next above `least`."""
    return np.asarray(angle - 2 * np.pi * np.floor((np.median(angle) - least) / (2 * np.pi)))


def _follow_sign(plane: ComplexArray, unusual: Array) -> Array:
    """Return the signs (F,) with which numbers (F,) turn least from frame to frame, by dynamic programming.

    The costs `unusual` (F, 2) of the signs 1 and -1 in each frame are added.
    """
    weight = np.abs(plane)
    direction = plane / np.maximum(weight, TINY)
    cost = unusual[0]
    came_from = np.zeros((len(plane), 2), int)
    for frame in range(1, len(plane)):
        cosine = float((direction[frame] * direction[frame - 1].conj()).real)
        scale = weight[frame] * weight[frame - 1] + SWITCH_COST
        step = scale * np.array([[1 - cosine, 1 + cosine], [1 + cosine, 1 - cosine]])
        total = cost[:, None] + step
        came_from[frame] = total.argmin(axis=0)
        cost = total.min(axis=0) + unusual[frame]
    state = int(cost.argmin())
    signs = np.empty(len(plane))
    for frame in range(len(plane) - 1, -1, -1):
        signs[frame] = 1.0 if state == 0 else -1.0
        state = came_from[frame, state]
    return signs


def _smooth(numbers: ComplexArray, fps: float) -> ComplexArray:
    """Return numbers w e^(i psi) (F,), smoothed where w is small, as the formula at the top has it."""
    from scipy.linalg import solveh_banded

    if len(numbers) == 1:  # has no neighbour
        return numbers + NEUTRAL_WEIGHT
    weight = np.abs(numbers)
    weaker = np.minimum(weight[1:], weight[:-1])
    coupling = (SMOOTHING_S * fps) ** 2 * np.maximum(WEAK_SINE**2 - weaker**2, 0.0)
    bands = np.zeros((2, len(numbers)))
    bands[0, 1:] = -coupling
    bands[1] = weight**2 + NEUTRAL_WEIGHT
    bands[1, 1:] += coupling
    bands[1, :-1] += coupling
    return np.asarray(solveh_banded(bands, weight * numbers + NEUTRAL_WEIGHT))
