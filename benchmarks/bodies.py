# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies with surfaces before a depth camera: motion capture drives the body model Anny, whose depth is rendered.

    benchmarks/bodies.py views FOLDER [--sets train test] [--jobs 2] [--only NAME] [--picture FRAME]
    benchmarks/bodies.py table FOLDER

`views` writes one sequence file a view, `train_*.npz` with the motion of persons on whom models are trained and
`test_*.npz` with that of `HELD_OUT_SUBJECTS`. The truth is the body model's own joints, which need not be those of
the motion capture. Besides `keypoints`, `joint_names`, `timestamps`, `image_size`, `camera_matrix`, `joints3d` (m,
in the camera's optical frame) and `joints3d_names`, a file holds

    depth            (F, J) m, as the camera measures it where the detector sees each keypoint; NaN is unknown
    true_surface     (F, J) m, of the first surface at the true keypoint, without errors
    true_keypoints   (F, J, 2) px
    points3d         (F, 28, 3) m, all joints of `BODY26`, then the points midway between shoulders and hips
    points3d_names   (28,)
    points_surface   (F, 28) m, of the first surface at each of these points' projections
    facing           (F,) degrees between the direction in which the trunk faces and that of the camera, 0 to 180
    distance, heading, detector, occluder, trial, stature, gender, weight    of the view

`table` prints by how much the surface lies before the joints, from the training views alone.

It wants, besides the package, Anny (Apache-2.0, its mesh CC0), embreex and PyTorch (`pip install anny embreex
torch`). Anny's first use builds its cache for two minutes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import FPS
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.spatial.transform import Rotation

from mocap_ros import skeleton
from mocap_ros.keypoints.depth_image import sample_depth

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FRAMES = 150  # of a view
CMU15, BODY26 = skeleton.CMU15.joints, skeleton.BODY26.joints
POINTS = (*BODY26, 'midshoulders', 'midhips')

# The body.
BONES = {'shoulder': 'upperarm01', 'elbow': 'lowerarm01', 'wrist': 'wrist', 'hip': 'upperleg01'}
BONES |= {'knee': 'lowerleg01', 'ankle': 'foot'}  # whose heads are the joints
SURFACE_POINTS = {'toe': 'big_toe', 'heel': 'heel', 'eye': 'eye', 'ear': 'ear'}  # of Anny's regressor of keypoints
AGE = 0.7  # of Anny, a young adult
HEAD_OFFSET = (
    0.065 / 1.7
)  # of the stature; of the tip of the head bone above the ears, as `keypoints.joint_map` has it
PELVIS_OFFSET = (0.0, 0.105 / 1.7, -0.035 / 1.7)  # of the stature; from the middle of the hips in motion capture
SPINE_SHARES = {'spine05': 0.25, 'spine04': 0.5, 'spine03': 0.75, 'spine02': 1.0, 'spine01': 1.0}  # of the chest's
NECK_SHARES = {'neck01': 0.25, 'neck02': 0.5, 'neck03': 0.75, 'head': 1.0}  # of the head's rotation
HEAD_PITCH_DEG = 17.0  # degrees by which the line from the ears to the nose points lower in motion capture
HINGE_WEIGHT = 0.3  # of the direction that a hinge has without twist; the sine of the bend is that of the true one

# The camera, like a RealSense D435.
IMAGE_SIZES = ((848, 480), (640, 480))
FIELD_OF_VIEW_DEG = 69.0  # horizontal
DISTANCES_M = 1.5, 5.0
MAX_PITCH_DEG = 20.0
MAX_RISE_M = 0.9  # of the camera above the point at which it looks
BASELINE_M = 0.05
NOISE_M, NOISE_DISTANCE_M = 0.02, 4.0  # standard deviation of the depth at a distance
NOISE_SIGMA_PX = 2.0  # of the filter that makes it smooth
FIXED_NOISE = 0.5  # share of the variance that stays in its pixel for the whole view
DISPARITY_STEP_PX = 1 / 32
EDGE_JUMP_M = 0.06  # at 1 m, and more in proportion to the distance
EDGE_HOLES, EDGE_FLYING = 0.65, 0.2  # shares of the band at edges
BLANK_SHARE = 0.015  # of the surface elsewhere
WALL_M = 1.0, 3.0  # behind the person
MAX_DEPTH_M = 10.0
MARGIN_PX = 60  # about the keypoints; what is rendered, more than is sampled
OUTLIER_M = 0.15  # of the table

# Trials: held-out persons, and others.
TEST_TRIALS = (
    *('14_29', '14_30', '14_31', '14_32', '14_27', '86_09', 'ui_s07_m01', 'ui_s08_m05', 'ui_s07_m03'),
    *('ui_s08_m04', '14_02', '14_06', '14_13', '14_21', '13_29', '13_30', '05_09', '135_06', '135_11'),
    *('UB_03', 'UT_01', 'UWW_01', 'UW_24', '94_n08'),
)
TRAIN_TRIALS = (
    *('01_08', '01_05', 'ui_s01_m01', 'ui_s02_m05', 'ui_s04_m03', 'ui_s06_m04', 'ui_s05_m05', 'ui_s03_m01'),
    *('29_25', '29_16', '02_06', '02_10', '02_05', '16_21', '127_02', '17_10', '49_18', '49_15', '91_04'),
    *('91_17', '09_12', '29_04', '55_01', '60_05'),
)


@cache
def load_trials() -> Mapping[str, Array]:
    """Load the motion capture (F, 26, 3) mm with y up by trial."""
    archive: Mapping[str, Array] = np.load(common.data_path('data', 'motion', 'body26_30fps.npz'))
    return archive


def load_poses(prefix: str) -> tuple[str, Array]:
    """Return the first trial with this beginning of its name, and `FRAMES` of it from its middle, in m.

    A trial that is shorter is played back and forth.
    """
    archive = load_trials()
    names = [str(name) for name in archive['_joints']]
    trial = prefix if prefix in archive else min(name for name in archive if name.startswith(prefix))
    poses = archive[trial][:, [names.index(joint) for joint in BODY26]].astype(float) / 1000
    while len(poses) < FRAMES:
        poses = np.concatenate([poses, poses[-2:0:-1]])
    first = (len(poses) - FRAMES) // 2
    return trial, poses[first : first + FRAMES]


# --- rotations ---------------------------------------------------------------------------------------------------


def normalise(vectors: Array) -> Array:
    """Return vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def make_frame(first: Array, second: Array) -> Array:
    """Return rotations (..., 3, 3) whose first column is the first vector, and whose second is near the second."""
    x = normalise(first)
    y = normalise(second - (second * x).sum(-1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], -1)


def swing(start: Array, end: Array) -> Array:
    """Return the smallest rotations (..., 3, 3) that turn one direction (..., 3) into another."""
    a, b = np.broadcast_arrays(normalise(start), normalise(end))
    axis, cosine = np.cross(a, b), (a * b).sum(-1)
    cross = np.zeros((*axis.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    cross -= np.swapaxes(cross, -1, -2).copy()
    return np.asarray(np.eye(3) + cross + cross @ cross / np.maximum(1 + cosine, 1e-3)[..., None, None])


def blend(start: Array, end: Array, share: float) -> Array:
    """Return the rotations (F, 3, 3) at a share of the way from one to another."""
    step = Rotation.from_matrix(np.swapaxes(start, -1, -2) @ end).as_rotvec() * share
    return np.asarray(start @ Rotation.from_rotvec(step).as_matrix())


# --- the body ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Body:
    """A body at rest, with y up and facing z, in m."""

    vertices: Array  # (V, 3)
    faces: NDArray[np.int64]  # (T, 3)
    weights: Any  # (V, B) sparse, of the bones on the vertices
    bones: tuple[str, ...]
    parents: tuple[int, ...]
    heads: Array  # (B, 3) of the bones
    landmarks: Any  # (L, V) sparse, that make points of the surface from vertices
    landmark_names: tuple[str, ...]
    stature: float

    def joint(self, joint: str) -> Array:
        """Return a joint at rest."""
        if joint == 'head':
            ears = (self.joint('lear') + self.joint('rear')) / 2
            return np.asarray(ears + np.array([0.0, HEAD_OFFSET * self.stature, 0.0]))
        if joint == 'pelvis':
            hips = (self.joint('lhip') + self.joint('rhip')) / 2
            return np.asarray(hips + np.array(PELVIS_OFFSET) * self.stature)
        if joint == 'neck':
            shoulders, clavicle = (self.joint('lshoulder') + self.joint('rshoulder')) / 2, self.bone('clavicle.L')
            return np.array([0.0, clavicle[1], shoulders[2]])
        if joint[1:] in BONES:
            return self.bone(f'{BONES[joint[1:]]}.{joint[0].upper()}')
        if joint[1:] == 'hand':
            return np.mean([self.bone(f'finger{n}-1.{joint[0].upper()}') for n in (2, 3, 4, 5)], axis=0)
        return np.asarray(self.landmarks[[self.landmark_names.index(joint)]] @ self.vertices)[0]

    def bone(self, name: str) -> Array:
        """Return the head of a bone at rest."""
        return np.asarray(self.heads[self.bones.index(name)])

    def carrier(self, joint: str) -> int:
        """Return the bone with which a joint moves that is no point of the surface, or -1."""
        name = {'head': 'head', 'pelvis': 'spine05', 'neck': 'spine01'}.get(joint, '')
        if not name and joint[1:] in BONES:
            name = f'{BONES[joint[1:]]}.{joint[0].upper()}'
        if joint[1:] == 'hand':
            name = f'wrist.{joint[0].upper()}'
        return self.bones.index(name) if name else -1


@cache
def _load_anny() -> tuple[Any, Any]:
    import anny
    import torch

    torch.set_num_threads(1)
    model = anny.Anny(rig='makehuman', topology='anny')
    return model, anny.KeypointsRegressor.coco(model)


def make_body(stature: float, gender: float, weight: float, muscle: float) -> Body:
    """Return a body of a stature in m; the others are Anny's, from 0 to 1, where gender 0 is male."""
    model, regressor = _load_anny()
    low, high = 0.0, 1.0
    for _ in range(14):
        height = (low + high) / 2
        shape = {'gender': gender, 'age': AGE, 'muscle': muscle, 'weight': weight, 'height': height}
        output = model(phenotype_kwargs=shape)
        size = float(np.ptp(output['rest_vertices'][0, :, 2].numpy()))
        low, high = (height, high) if size < stature else (low, height)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up, facing -y, to y up, facing z
    vertices, heads = (output[f'rest_{k}'][0].numpy() @ turn.T for k in ('vertices', 'bone_heads'))
    bones = tuple(str(label) for label in model.bone_labels)
    indices, values = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    rows = np.repeat(np.arange(len(vertices)), indices.shape[1])
    weights = sparse.csr_matrix((values.ravel(), (rows, indices.ravel())), (len(vertices), len(bones)))
    names = {'nose': 'nose'}
    for side, word in (('l', 'left'), ('r', 'right')):
        names |= {side + point: f'{word}_{label}' for point, label in SURFACE_POINTS.items()}
    labels = [str(label) for label in regressor.labels]
    landmarks = regressor.regression_weights.numpy()[[labels.index(label) for label in names.values()]]
    faces = model.get_triangular_faces().numpy()
    return Body(
        vertices, faces, weights, bones, tuple(int(p) for p in model.bone_parents), heads,
        sparse.csr_matrix(landmarks), tuple(names), size,
    )  # fmt: skip


def retarget(body: Body, poses: Array) -> tuple[Array, Array]:
    """Return the rotations (F, B, 3, 3) of the bones from rest, and the positions (F, B, 3) of their heads.

    Pelvis and chest follow the frames of hips and shoulders, the spine turns between them, the head follows
    ears and nose. Each limb turns into the directions of its bones, with the twist that its hinge asks for.
    """
    at = {joint: poses[:, i] for i, joint in enumerate(BODY26)}
    rest = {joint: body.joint(joint) for joint in BODY26}

    def frames(joints: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        hips, ears = (joints['lhip'] + joints['rhip']) / 2, (joints['lear'] + joints['rear']) / 2
        return (
            make_frame(joints['lhip'] - joints['rhip'], joints['pelvis'] - hips),
            make_frame(joints['lshoulder'] - joints['rshoulder'], joints['neck'] - joints['pelvis']),
            make_frame(joints['lear'] - joints['rear'], joints['nose'] - ears),
        )

    pitch = Rotation.from_euler('x', HEAD_PITCH_DEG, degrees=True).as_matrix()
    pelvis, chest, head = (np.asarray(a @ b.T) for a, b in zip(frames(at), frames(rest), strict=True))
    head = blend(chest, head @ pitch.T, 0.95)
    turned: dict[str, Array] = {'root': pelvis}
    turned |= {name: blend(pelvis, chest, share) for name, share in SPINE_SHARES.items()}
    turned |= {name: blend(chest, head, share) for name, share in NECK_SHARES.items()}

    def turn_limb(joints: tuple[str, str, str], base: Array, hinge: Array | None) -> tuple[Array, Array, Array]:
        """Return the rotations of a limb's first half of its upper bone, of its other half, of its lower bone."""
        upper, lower = (rest[joints[1]] - rest[joints[0]]), (rest[joints[2]] - rest[joints[1]])
        hinge = np.cross(upper, lower) if hinge is None else hinge
        to_upper, to_lower = at[joints[1]] - at[joints[0]], at[joints[2]] - at[joints[1]]
        swung = swing(base @ upper, to_upper) @ base
        to_hinge = np.cross(normalise(to_upper), normalise(to_lower)) + HINGE_WEIGHT * swung @ normalise(hinge)
        far = make_frame(to_upper, to_hinge) @ make_frame(upper, hinge).T
        below = make_frame(to_lower, to_hinge) @ make_frame(lower, hinge).T
        return blend(swung, far, 0.5), far, below

    for side in 'lr':
        end = '.' + side.upper()
        # the shoulder blade moves from where it usually is in this motion
        local = np.swapaxes(chest, -1, -2) @ (at[side + 'shoulder'] - at['neck'])[..., None]
        lifted = chest @ swing(np.median(local[..., 0], axis=0), local[..., 0])
        turned |= {f'clavicle{end}': lifted, f'shoulder01{end}': lifted}
        names = (side + 'shoulder', side + 'elbow', side + 'wrist')
        near, far, below = turn_limb(names, lifted, None)
        hand = swing(below @ (rest[side + 'hand'] - rest[side + 'wrist']), at[side + 'hand'] - at[side + 'wrist'])
        turned |= {f'upperarm01{end}': near, f'upperarm02{end}': far, f'lowerarm01{end}': below}
        turned |= {f'lowerarm02{end}': below, f'wrist{end}': hand @ below}
        names = (side + 'hip', side + 'knee', side + 'ankle')
        near, far, below = turn_limb(names, pelvis, np.array([1.0, 0.0, 0.0]))
        foot = swing(below @ (rest[side + 'toe'] - rest[side + 'heel']), at[side + 'toe'] - at[side + 'heel'])
        turned |= {f'upperleg01{end}': near, f'upperleg02{end}': far, f'lowerleg01{end}': below}
        turned |= {f'lowerleg02{end}': below, f'foot{end}': foot @ below}

    rotations = np.zeros((len(poses), len(body.bones), 3, 3))
    heads = np.zeros((len(poses), len(body.bones), 3))
    for bone, (name, parent) in enumerate(zip(body.bones, body.parents, strict=True)):
        rotations[:, bone] = turned[name] if name in turned else rotations[:, parent]
        if parent >= 0:
            heads[:, bone] = heads[:, parent] + rotations[:, parent] @ (body.heads[bone] - body.heads[parent])
    hips = (at['lhip'] + at['rhip']) / 2
    bones = (('lhip', 'lknee'), ('lknee', 'lankle'))
    legs = [sum(np.linalg.norm(j[a] - j[b], axis=-1).mean() for a, b in bones) for j in (rest, at)]
    mine = (heads[:, body.bones.index('upperleg01.L')] + heads[:, body.bones.index('upperleg01.R')]) / 2
    return rotations, heads + (hips * (legs[0] / legs[1]) - mine)[:, None]


def skin(body: Body, rotations: Array, heads: Array) -> Array:
    """Return the vertices (V, 3) for one frame's rotations (B, 3, 3) and heads (B, 3) of the bones."""
    shifts = heads - np.einsum('bij,bj->bi', rotations, body.heads)
    mixed = body.weights @ np.concatenate([rotations.reshape(-1, 9), shifts], 1)
    return np.asarray(np.einsum('vij,vj->vi', mixed[:, :9].reshape(-1, 3, 3), body.vertices) + mixed[:, 9:])


def find_joints(body: Body, rotations: Array, heads: Array, vertices: Array) -> Array:
    """Return the joints (26, 3) of `BODY26` of one frame."""
    surface = np.asarray(body.landmarks @ vertices)
    out = np.zeros((len(BODY26), 3))
    for i, joint in enumerate(BODY26):
        bone = body.carrier(joint)
        if bone < 0:
            out[i] = surface[body.landmark_names.index(joint)]
        else:
            out[i] = heads[bone] + rotations[bone] @ (body.joint(joint) - body.heads[bone])
    return out


# --- the camera --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Camera:
    """A pinhole camera."""

    size: tuple[int, int]  # px, width and height

    @property
    def focal_length(self) -> float:
        """The focal length in px."""
        return float(self.size[0] / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG / 2)))

    @property
    def matrix(self) -> Array:
        """The matrix (3, 3) in px."""
        f, (width, height) = self.focal_length, self.size
        return np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])

    def project(self, points: Array) -> Array:
        """Return the pixels (..., 2) of points (..., 3) in m."""
        return np.asarray(points[..., :2] / points[..., 2:] * self.focal_length + self.matrix[:2, 2])

    def rays(self, pixels: Array) -> Array:
        """Return the directions (..., 3) through pixels (..., 2), 1 long along the optical axis."""
        slopes = (pixels - self.matrix[:2, 2]) / self.focal_length
        return np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], -1)


def make_box(low: Sequence[float], high: Sequence[float]) -> Array:
    """Return the triangles (12, 3, 3) of a box that is parallel to the axes."""
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([corners[[a, b, c]] for p, q, r, s in quads for a, b, c in ((p, q, r), (p, r, s))])


def cast(scene: Any, rays: Array) -> Array:
    """Return the distances (...,) along the optical axis of the first surfaces on rays (..., 3)."""
    flat = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
    found = scene.run(np.zeros_like(flat), flat, query='DISTANCE').astype(float)
    return np.where((found > 0) & (found < MAX_DEPTH_M), found, MAX_DEPTH_M).reshape(rays.shape[:-1])


class DepthSensor:
    """The errors of a stereo camera of depth in one view."""

    def __init__(self, camera: Camera, rng: np.random.Generator) -> None:
        self._scale = camera.focal_length * BASELINE_M  # px m
        self._rng = rng
        self._noise_px = NOISE_M / NOISE_DISTANCE_M**2 * self._scale
        self._fixed = self._smooth(camera.size[::-1], NOISE_SIGMA_PX)
        self._blank = self._smooth(camera.size[::-1], 3.0)

    def _smooth(self, shape: tuple[int, ...], sigma: float) -> Array:
        out = ndimage.gaussian_filter(self._rng.standard_normal(shape), sigma)
        return np.asarray(out * (2 * np.sqrt(np.pi) * sigma))

    def measure(self, depth: Array, first: tuple[int, int]) -> Array:
        """Return what the camera measures, 0 where nothing, of a part of an image with this first pixel."""
        rng, shape = self._rng, depth.shape
        part = np.s_[first[1] : first[1] + shape[0], first[0] : first[0] + shape[1]]
        disparity = self._scale / depth
        near, far = ndimage.minimum_filter(depth, 3), ndimage.maximum_filter(depth, 3)
        edge = far - near > EDGE_JUMP_M * np.maximum(near, 1.0)
        band = ndimage.binary_dilation(edge, iterations=1) if rng.random() < 0.5 else edge  # 4 px or 2 px wide
        draw = ndimage.gaussian_filter(rng.random(shape), 0.8)
        draw = draw.ravel().argsort().argsort().reshape(shape) / draw.size
        holes, flying = band & (draw < EDGE_HOLES), band & (draw > 1 - EDGE_FLYING)
        low, high = self._scale / ndimage.maximum_filter(depth, 5), self._scale / ndimage.minimum_filter(depth, 5)
        disparity = np.where(flying, low + rng.random(shape) * (high - low), disparity)
        noise = np.sqrt(FIXED_NOISE) * self._fixed[part] + np.sqrt(1 - FIXED_NOISE) * self._smooth(
            shape, NOISE_SIGMA_PX
        )
        noisy = np.round((disparity + self._noise_px * noise) / DISPARITY_STEP_PX) * DISPARITY_STEP_PX
        # what the other imager, to the right, does not see beside something nearer
        seen = np.arange(shape[1]) - self._scale / depth
        hidden = seen > np.minimum.accumulate(seen[:, ::-1], axis=1)[:, ::-1] + 0.5
        blank = 0.7 * self._blank[part] + 0.7 * self._smooth(shape, 3.0) > 2.17  # normal quantile of BLANK_SHARE
        out = self._scale / np.maximum(noisy, 1e-3)
        out[holes | hidden | blank | (depth >= MAX_DEPTH_M) | (noisy <= 0)] = 0.0
        return np.asarray(out)


def make_room(occluder: str, ground: float, wall: float, rng: np.random.Generator) -> Array:
    """Return the triangles (T, 3, 3) of floor and wall, and of a `box` or `table` before the person at the origin.

    `ground` is the y of the floor, downwards, and `wall` the z of the wall, away from the camera, in m.
    """
    boxes = [make_box((-9, -9, wall), (9, 9, wall + 1)), make_box((-9, ground, -9), (9, ground + 1, 9))]
    side, front = rng.uniform(-0.3, 0.3), -rng.uniform(0.45, 0.65)
    if occluder == 'box':
        boxes.append(make_box((side - 0.25, ground - 0.7, front - 0.4), (side + 0.25, ground, front)))
    elif occluder == 'table':
        boxes.append(make_box((side - 0.6, ground - 0.75, front - 0.6), (side + 0.6, ground - 0.71, front)))
        for x in (side - 0.58, side + 0.53):
            legs = [(x, z) for z in (front - 0.58, front - 0.07)]
            boxes += [make_box((x, ground - 0.72, z), (x + 0.05, ground, z + 0.05)) for x, z in legs]
    return np.concatenate(boxes)


# --- views -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """What is drawn for one view."""

    name: str
    trial: str
    heading: float  # degrees; 0 looks at the person's front
    distance: float  # m
    detector: str
    occluder: str  # empty, `box` or `table`
    stature: float  # m
    gender: float
    weight: float
    muscle: float
    size: tuple[int, int]  # px


def plan_views(kind: str) -> list[Plan]:
    """Return the views of a set, `train` or `test`, spread over headings, distances, detectors and bodies."""
    trials = TEST_TRIALS if kind == 'test' else TRAIN_TRIALS
    rng = np.random.default_rng(zlib.crc32(kind.encode()))
    count = len(trials)
    steps = np.arange(count)
    headings = rng.permutation(steps * 360 / count + rng.uniform(0, 360 / count))
    low, high = DISTANCES_M
    distances = rng.permutation(low + (high - low) * (steps + 0.5) / count)
    out = []
    for i, trial in enumerate(trials):
        gender = float(rng.integers(2))
        stature = rng.uniform(1.66, 1.95) if gender == 0 else rng.uniform(1.55, 1.80)
        weight, muscle = rng.uniform(0.3, 0.95), rng.uniform(0.35, 0.8)
        occluder = {2: 'box', 5: 'table'}.get(i % 8, '')
        detector = ('openpose', 'mediapipe')[i % 2]
        name = f'{kind}_{i:02d}_{trial}'
        out.append(
            Plan(name, trial, headings[i], distances[i], detector, occluder, stature, gender, weight, muscle,
                 IMAGE_SIZES[int(rng.integers(2))])
        )  # fmt: skip
    return out


def _facing(points: Array) -> Array:
    """Return the directions (..., 3) in which trunks (..., J, 3) of `BODY26` face."""
    at = {joint: points[..., i, :] for i, joint in enumerate(BODY26)}
    left = at['lshoulder'] - at['rshoulder'] + at['lhip'] - at['rhip']
    up = at['lshoulder'] + at['rshoulder'] - at['lhip'] - at['rhip']
    return normalise(np.cross(left, up))


def detect(plan: Plan, camera: Camera, joints: Array) -> tuple[Array, list[str], list[int]]:
    """Return a detector's keypoints (F, J, 3) by the protocol, their names, and their indices in `BODY26`."""
    protocol = common.load_protocol()
    rng = np.random.default_rng(zlib.crc32(plan.name.encode()))
    moved, error, score, order = protocol.detect(joints, list(BODY26), FPS, plan.detector, rng)
    xy = camera.project(moved) + error / moved[..., 2:] * camera.focal_length
    xy, score = np.take_along_axis(xy, order[..., None], 1), np.take_along_axis(score, order, 1)
    seen = ((xy >= 0) & (xy <= np.array(camera.size) - 1)).all(-1) & (score > 0)
    xy[~seen] = np.nan
    given = protocol.GIVEN[plan.detector]
    columns = [i for i, joint in enumerate(BODY26) if joint in given]
    keypoints = np.concatenate([xy, (seen * score)[..., None]], -1)[:, columns]
    return keypoints, [given[BODY26[i]] for i in columns], columns


def make_view(plan: Plan, picture: tuple[int, Path] | None = None) -> dict[str, Any]:
    """Return the arrays of one view's file; `picture` is a frame of which a whole image is drawn, and its path."""
    protocol, rng = common.load_protocol(), np.random.default_rng(zlib.crc32(plan.name.encode()) + 1)
    body = make_body(plan.stature, plan.gender, plan.weight, plan.muscle)
    trial, poses = load_poses(plan.trial)
    rotations, heads = retarget(body, poses)
    # the camera follows the person's way, but not every step of it
    root = heads[:, body.bones.index('root')]
    way = ndimage.gaussian_filter1d(root[:, [0, 2]], 0.7 * FPS, axis=0, mode='nearest')
    drift = ndimage.gaussian_filter1d(rng.standard_normal((FRAMES, 2)), FPS, axis=0, mode='wrap')
    drift *= 0.15 / max(drift.std(), 1e-9)
    heads[:, :, [0, 2]] += (drift - way)[:, None]
    bodies = [skin(body, r, h) for r, h in zip(rotations, heads, strict=True)]
    joints = np.stack([find_joints(body, *v) for v in zip(rotations, heads, bodies, strict=True)])
    floor = float(np.quantile([v[:, 1].min() for v in bodies], 0.05))

    ahead = _facing(joints)[:, [0, 2]].mean(axis=0)
    heading = plan.heading - float(np.degrees(np.arctan2(ahead[0], ahead[1])))
    elevation = rng.uniform(0, min(MAX_PITCH_DEG, np.degrees(np.arcsin(MAX_RISE_M / plan.distance))))
    near = 1 - np.clip((plan.distance - 2.0) / 1.5, 0, 1)  # a close camera looks at the chest
    middle = joints[:, [BODY26.index(j) for j in ('lhip', 'rhip')]].mean(axis=(0, 1))
    target = middle + near * 0.8 * (joints[:, BODY26.index('neck')].mean(axis=0) - middle)
    turn = protocol.view(np.eye(3), heading, elevation).T  # from the world to the camera
    away = np.array([rng.uniform(-0.1, 0.1) * plan.distance, 0, plan.distance])
    camera = Camera(plan.size)
    joints = (joints - target) @ turn.T + away

    level = protocol.view(np.eye(3), heading, 0.0).T  # a camera that does not look down
    ground = float((level @ (np.array([0, floor, 0]) - target))[1])
    back = float(np.quantile([((v - target) @ level.T)[:, 2].max() for v in bodies[::10]], 0.9))
    room = make_room(plan.occluder, ground, back + rng.uniform(*WALL_M), rng) @ (turn @ level.T).T + away

    keypoints, names, columns = detect(plan, camera, joints)
    index = {joint: i for i, joint in enumerate(BODY26)}
    middles = [joints[:, [index['l' + j], index['r' + j]]].mean(axis=1) for j in ('shoulder', 'hip')]
    points = np.concatenate([joints, np.stack(middles, 1)], 1)
    pixels = camera.project(points)
    sensor = DepthSensor(camera, rng)
    depth = np.full(keypoints.shape[:2], np.nan)
    surface = np.full(points.shape[:2], np.nan)
    for frame in range(FRAMES):
        scene = EmbreeScene()
        vertices = (bodies[frame] - target) @ turn.T + away
        triangles = np.concatenate([vertices[body.faces], room])
        TriangleMesh(scene, np.ascontiguousarray(triangles, np.float32))
        surface[frame] = cast(scene, camera.rays(pixels[frame]))
        if picture and picture[0] == frame:
            draw_picture(picture[1], camera, scene, DepthSensor(camera, np.random.default_rng(0)), pixels[frame])
        xy = keypoints[frame, :, :2]
        if not np.isfinite(xy).any():
            continue
        low = np.maximum(np.nanmin(xy, axis=0).astype(int) - MARGIN_PX, 0)
        high = np.minimum(np.nanmax(xy, axis=0).astype(int) + MARGIN_PX + 1, camera.size)
        grid = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), -1).astype(float)
        image = sensor.measure(cast(scene, camera.rays(grid)), (int(low[0]), int(low[1])))
        depth[frame] = sample_depth(image, 1.0, xy - low)
    inside = ((pixels >= 0) & (pixels <= np.array(camera.size) - 1)).all(-1) & (points[..., 2] > 0.1)
    surface[~inside] = np.nan
    to_camera = -normalise(joints[:, BODY26.index('pelvis')])
    cosine = (_facing(joints) * to_camera).sum(-1)
    return {
        'keypoints': keypoints.astype('f4'),
        'joint_names': np.array(names),
        'timestamps': np.arange(FRAMES) / FPS,
        'image_size': np.array(camera.size),
        'camera_matrix': camera.matrix,
        'joints3d': joints[:, : len(CMU15)].astype('f4'),
        'joints3d_names': np.array(CMU15),
        'depth': depth.astype('f4'),
        'true_surface': surface[:, columns].astype('f4'),
        'true_keypoints': pixels[:, columns].astype('f4'),
        'points3d': points.astype('f4'),
        'points3d_names': np.array(POINTS),
        'points_surface': surface.astype('f4'),
        'facing': np.degrees(np.arccos(np.clip(cosine, -1, 1))).astype('f4'),
        'distance': plan.distance,
        'heading': plan.heading,
        'elevation': elevation,
        'detector': plan.detector,
        'occluder': plan.occluder,
        'trial': trial,
        'stature': body.stature,
        'gender': plan.gender,
        'weight': plan.weight,
    }


def draw_picture(path: Path, camera: Camera, scene: Any, sensor: DepthSensor, pixels: Array) -> None:
    """Draw the true and the measured depth of a whole image side by side, with the joints of `CMU15` in it."""
    from PIL import Image, ImageDraw

    width, height = camera.size
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(float)
    true = cast(scene, camera.rays(grid))
    panes = np.concatenate([true, sensor.measure(true, (0, 0))], 1)
    low, high = np.quantile(true, 0.01), np.quantile(true, 0.9)
    # nearer is brighter, with stripes of 5 cm for the shape
    grey = 230 - 180 * np.clip((panes - low) / (high - low), 0, 1) - 40 * (panes % 0.05 / 0.05)
    image = Image.fromarray(np.where(panes > 0, np.clip(grey, 0, 255), 0).astype(np.uint8)).convert('RGB')
    pen = ImageDraw.Draw(image)
    for x, y in pixels[: len(CMU15)]:
        pen.ellipse((x - 3, y - 3, x + 3, y + 3), outline=(255, 0, 0), width=2)
    image.save(path)


def write_view(job: tuple[Plan, Path, int]) -> str:
    """Write the file of one view, and a picture of one of its frames beside it if that is not negative."""
    plan, folder, frame = job
    start = time.perf_counter()
    picture = (frame, folder / f'{plan.name}_{frame:03d}.png') if frame >= 0 else None
    view = make_view(plan, picture)
    np.savez_compressed(folder / f'{plan.name}.npz', **view)
    return f'{plan.name}: {view["trial"]}, {time.perf_counter() - start:.0f} s'


# --- the table ---------------------------------------------------------------------------------------------------


def describe(values: Array) -> str:
    """Return median, robust standard deviation and share of outliers of offsets in m, in cm and %."""
    values = values[np.isfinite(values)]
    if len(values) < 50:
        return '-'
    middle = np.median(values)
    spread = 1.4826 * np.median(np.abs(values - middle))
    outliers = np.mean(np.abs(values - middle) > OUTLIER_M)
    return f'{middle * 100:6.1f} {spread * 100:5.1f} {outliers * 100:5.1f}%'


class Offsets:
    """The offsets joint z - surface z in m of all frames of views."""

    def __init__(self, views: Sequence[Mapping[str, Any]]) -> None:
        self._views = views
        facing = np.concatenate([v['facing'] for v in views])
        self.groups = {'facing': facing < 45, 'side': (facing >= 45) & (facing <= 135), 'behind': facing > 135}
        self.groups['all'] = np.ones(len(facing), bool)

    def true(self, joint: str, point: str) -> Array:
        """Return how far the first surface at a point's projection is before a joint, without furniture."""
        column, other = POINTS.index(joint), POINTS.index(point)
        offsets = [v['points3d'][:, column, 2] - v['points_surface'][:, other] for v in self._views]
        clear = [np.where(str(v['occluder']) == '', o, np.nan) for v, o in zip(self._views, offsets, strict=True)]
        return np.concatenate(clear)

    def sampled(self, joint: str, point: str, detector: str) -> Array:
        """Return how far what is sampled at a keypoint is before a joint, for `both` detectors or one."""
        out = []
        for v in self._views:
            z, given = v['points3d'][:, POINTS.index(joint), 2], [str(n) for n in v['joint_names']]
            use = point in given and detector in {'both', str(v['detector'])}
            out.append(z - v['depth'][:, given.index(point)] if use else np.full(len(z), np.nan))
        return np.concatenate(out)

    def _is_near(self, joint: str) -> Bools:
        """Return the frames in which a joint is the nearer one of its pair."""
        columns = POINTS.index(joint), POINTS.index(('r' if joint[0] == 'l' else 'l') + joint[1:])
        z = np.concatenate([v['points3d'][:, columns, 2] for v in self._views])
        return np.asarray(z[:, 0] < z[:, 1])

    def print_row(self, label: str, values: Sequence[Array], pair: Sequence[str] = ()) -> None:
        """Print one row: median, spread and outliers for each group of frames.

        Where the values belong to a pair of joints, the near one and the far one from the side come after these.
        """
        cells = [describe(np.concatenate([v[mask] for v in values])) for mask in self.groups.values()]
        for wanted in (True, False) if pair else ():
            masks = [self.groups['side'] & (self._is_near(joint) == wanted) for joint in pair]
            cells.append(describe(np.concatenate([v[m] for v, m in zip(values, masks, strict=True)])))
        print(f'{label:24}' + ''.join(f'{cell:>21}' for cell in cells))


def print_table(folder: Path) -> None:
    """Print joint z - surface z of the training views."""
    views = [dict(np.load(path)) for path in sorted(folder.glob('train_*.npz'))]
    offsets = Offsets(views)
    print(f'{len(views)} views; frames: ' + ', '.join(f'{k} {m.sum()}' for k, m in offsets.groups.items()))
    title = f'{"":24}' + ''.join(f'{k:>21}' for k in (*offsets.groups, 'side, near one', 'side, far one'))
    pairs = ('shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle', 'eye', 'ear', 'heel')
    print('\nnoise-free surface at the true keypoint: median cm, robust std cm, > 15 cm from the median\n' + title)
    for joint in (*CMU15, 'nose'):
        offsets.print_row(joint, [offsets.true(joint, joint)])
    for joint in (*pairs, 'toe', 'hand'):
        pair = 'l' + joint, 'r' + joint
        offsets.print_row(f'{joint}s', [offsets.true(j, j) for j in pair], pair)
    for joint, points in (
        ('neck', 'midshoulders'),
        ('pelvis', 'midhips'),
        ('head', 'nose'),
        ('head', 'lear rear'),
    ):
        offsets.print_row(f'{joint} - {points}', [offsets.true(joint, point) for point in points.split()])
    for detector in ('both', 'openpose', 'mediapipe'):
        print(f'\nsampled depth at the keypoint of the detector: {detector}\n' + title)
        for joint in (*CMU15, 'nose'):
            if detector == 'both' or joint in {'neck', 'pelvis', 'nose'}:
                offsets.print_row(joint, [offsets.sampled(joint, joint, detector)])
        for joint in pairs:
            pair = 'l' + joint, 'r' + joint
            offsets.print_row(f'{joint}s', [offsets.sampled(j, j, detector) for j in pair], pair)
        for points in ('nose', 'lear rear'):
            offsets.print_row(f'head - {points}', [offsets.sampled('head', p, detector) for p in points.split()])
    known = [np.isfinite(v['depth'][v['keypoints'][..., 2] > 0]).mean() for v in views]
    print(f'\nkeypoints with a depth: {np.mean(known) * 100:.0f} %')


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest='command', required=True)
    views = commands.add_parser('views')
    views.add_argument('folder', type=Path)
    views.add_argument('--sets', nargs='+', choices=('train', 'test'), default=['train', 'test'])
    views.add_argument('--jobs', type=int, default=2)
    views.add_argument('--only', default='', help='views whose name has this in it')
    views.add_argument('--picture', type=int, default=-1, metavar='FRAME')
    commands.add_parser('table').add_argument('folder', type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    if arguments.command == 'table':
        print_table(folder)
        return
    folder.mkdir(parents=True, exist_ok=True)
    plans = [plan for kind in arguments.sets for plan in plan_views(kind) if arguments.only in plan.name]
    jobs = [(plan, folder, int(arguments.picture)) for plan in plans if not (folder / f'{plan.name}.npz').exists()]
    with multiprocessing.get_context('spawn').Pool(min(arguments.jobs, max(len(jobs), 1))) as pool:
        for line in pool.imap_unordered(write_view, jobs):
            print(line, flush=True)
            sys.stdout.flush()


if __name__ == '__main__':
    main()
