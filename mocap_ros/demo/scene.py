"""The demo's scene: someone walks past, breaks into a run, jumps and walks on; a robot's head follows.

Synthetic and no inverse crime: the bodies come from a basis of their own with all its components, on bones that
no training subject has, through a perspective camera that pans and shakes; the detector is noisy, loses joints,
loses the person, and for a while an arm is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mocap_ros.demo.gait import RATE, Curves, load
from mocap_ros.formats.sequence_file import Sequence, Truth
from mocap_ros.skeleton import CMU15, layout
from mocap_ros.training.base_poses import with_bone_lengths

Array = NDArray[np.float64]

IMAGE_SIZE = (640, 480)
FOCAL_LENGTH = 600.0
CAMERA_HEIGHT = 1.3
CIRCLE_RADIUS, CIRCLE_DISTANCE = 2.8, 6.5
BLEND = 0.4
SEED = 7

# (motion, seconds it lasts, second of the motion at which it starts)
ACTS = (('walk', 4.5, 0.0), ('run', 3.0, 0.0), ('jump', 2.2, 0.5), ('walk', 3.3, 0.4))
HIDDEN_ARM = (2.0, 3.2)
LOST = (5.6, 5.75)

BONE_FACTORS = {
    'knee': 1.07, 'ankle': 1.05, 'elbow': 0.94, 'wrist': 1.08, 'hip': 1.1, 'shoulder': 0.93,
    'neck': 0.95, 'head': 1.04, 'pelvis': 1.0,
}  # fmt: skip

# head frame: the head joint seen from the neck is `up`; m, forward and left
FACE = {
    'nose': (0.72, 0.11, 0.0), 'leye': (0.85, 0.085, 0.032), 'reye': (0.85, 0.085, -0.032),
    'lear': (0.78, 0.0, 0.075), 'rear': (0.78, 0.0, -0.075),
}  # fmt: skip

# detector noise, share of stature, one standard deviation a coordinate
NOISE = {
    'nose': 0.004, 'eye': 0.004, 'ear': 0.005, 'shoulder': 0.008, 'elbow': 0.009,
    'wrist': 0.011, 'hip': 0.012, 'knee': 0.009, 'ankle': 0.009,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Recording:
    """The demo recording and its truth.

    Attributes:
        keypoints: (F, 17, 3) COCO-17 x, y in px and score; NaN and 0 where not seen.
        timestamps: (F,) s.
        truth: (F, 15, 3) m, camera optical frame, joints of `CMU15`.
    """

    keypoints: Array
    timestamps: Array
    truth: Array

    def sequence(self) -> Sequence:
        """As a sequence file holds it; the camera is not in it, as a user's would not be."""
        return Sequence(
            keypoints=self.keypoints,
            joint_names=layout('coco17').joints,
            timestamps=self.timestamps,
            image_size=IMAGE_SIZE,
            truth=Truth(self.truth, CMU15.joints),
        )


def act_at(time: float) -> str:
    """What the person does at this time, s."""
    end = 0.0
    for name, seconds, _ in ACTS:
        end += seconds
        if time < end:
            return name
    return ACTS[-1][0]


def make_recording(seed: int = SEED) -> Recording:
    """Generate the recording; the same seed gives the same recording."""
    rng = np.random.default_rng(seed)
    model, motions = load()
    pieces = [motions[n].at(start + np.arange(round(s * RATE)) / RATE) for n, s, start in ACTS]
    curves = _joined(pieces)
    factor = np.array([_by_part(BONE_FACTORS, CMU15.joints[c]) for _, c in CMU15.bones])
    body = with_bone_lengths(model.poses(curves.theta), CMU15, factor)
    body -= body.mean(axis=1, keepdims=True)
    truth = _seen_by_camera(_placed(body, curves), rng)
    timestamps = np.arange(len(truth)) / RATE
    return Recording(_detected(truth, timestamps, rng), timestamps, truth)


def _by_part(table: dict[str, float], joint: str) -> float:
    return table[joint if joint in table else joint[1:]]


def _joined(pieces: list[Curves]) -> Curves:
    """The pieces one after the other; seams are blended over `BLEND` s."""
    half = round(BLEND * RATE / 2)
    columns = [np.column_stack([p.theta, p.height, p.advance]) for p in pieces]
    out = np.concatenate(columns)
    at = 0
    for piece in columns[:-1]:
        at += len(piece)
        ramp = np.linspace(0, 1, 2 * half + 2)[1:-1, None]
        ramp = ramp**2 * (3 - 2 * ramp)
        before = np.concatenate([out[at - half : at], np.repeat(out[at - 1 : at], half, axis=0)])
        after = np.concatenate([np.repeat(out[at : at + 1], half, axis=0), out[at : at + half]])
        out[at - half : at + half] = (1 - ramp) * before + ramp * after
    return Curves(out[:, :-2], out[:, -2], out[:, -1])


def _placed(body: Array, curves: Curves) -> Array:
    """(F, 15, 3) m in the world: x right, y away from the camera, z up; anticlockwise on a circle."""
    gone = np.cumsum(curves.advance) / RATE
    angle = np.radians(-150) + gone / CIRCLE_RADIUS
    heading = angle + np.pi / 2
    c, s, o = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    turn = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, o + 1], -1)], -2)
    centre = np.stack(
        [
            CIRCLE_RADIUS * np.cos(angle),
            CIRCLE_DISTANCE + CIRCLE_RADIUS * np.sin(angle),
            curves.height * 1.06,
        ],
        axis=-1,
    )
    return np.asarray(body @ np.swapaxes(turn, -1, -2) + centre[:, None])


def _seen_by_camera(world: Array, rng: np.random.Generator) -> Array:
    """(F, 15, 3) m in the optical frame of a camera that follows the person late and shakes a little."""
    frames = len(world)
    centre = world.mean(axis=1)
    pan = gaussian_filter1d(np.arctan2(centre[:, 0], centre[:, 1]), 0.4 * RATE, mode='nearest')
    pan = np.concatenate([np.repeat(pan[:1], 6), pan[:-6]])
    shake = gaussian_filter1d(rng.standard_normal((frames, 3)), 0.1 * RATE, axis=0)
    pan = pan + np.radians(1.0) * shake[:, 0]
    tilt = np.radians(4.0) + np.radians(1.0) * shake[:, 1]
    roll = np.radians(1.0) * shake[:, 2]
    p = world - [0, 0, CAMERA_HEIGHT]
    right = np.cos(pan)[:, None] * p[..., 0] - np.sin(pan)[:, None] * p[..., 1]
    away = np.sin(pan)[:, None] * p[..., 0] + np.cos(pan)[:, None] * p[..., 1]
    down = -p[..., 2]
    ct, st = np.cos(tilt)[:, None], np.sin(tilt)[:, None]
    down, away = ct * down - st * away, st * down + ct * away
    cr, sr = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([cr * right - sr * down, sr * right + cr * down, away], axis=-1)


def project(points: Array) -> Array:
    """(..., 3) m in the optical frame -> (..., 2) px."""
    centre = np.array(IMAGE_SIZE) / 2
    return np.asarray(points[..., :2] / points[..., 2:] * FOCAL_LENGTH + centre)


def _with_face(truth: Array) -> Array:
    """(F, 17, 3) the COCO-17 joints, eyes, ears and nose placed on the head."""
    joint = {n: truth[:, i] for i, n in enumerate(CMU15.joints)}
    up = joint['head'] - joint['neck']
    left = joint['lshoulder'] - joint['rshoulder'] + joint['lhip'] - joint['rhip']
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    forward = np.cross(left, up)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    for name, (along, ahead, aside) in FACE.items():
        joint[name] = joint['neck'] + along * up + ahead * forward + aside * left
    return np.stack([joint[n] for n in layout('coco17').joints], axis=1)


def _detected(truth: Array, timestamps: Array, rng: np.random.Generator) -> Array:
    """(F, 17, 3) what a detector makes of it."""
    names = layout('coco17').joints
    points3d = _with_face(truth)
    xy = project(points3d)
    frames = len(xy)
    stature_px = 1.7 * FOCAL_LENGTH / points3d[..., 2].mean(axis=1)

    depth = points3d[..., 2] - truth.mean(axis=1)[:, None, 2]
    behind = 1 / (1 + np.exp(-(depth - 0.12) / 0.03))
    spread = np.array([_by_part(NOISE, n) for n in names]) * (1 + 1.5 * behind)
    white = rng.standard_normal(xy.shape)
    for t in range(1, frames):
        white[t] = 0.6 * white[t - 1] + 0.8 * white[t]
    xy = xy + white * (spread * stature_px[:, None])[..., None]
    score = np.clip(0.95 - 0.4 * behind + 0.05 * rng.standard_normal(behind.shape), 0.15, 1.0)

    lost = rng.random(score.shape) < 0.02 + 0.06 * behind
    hidden = (timestamps >= HIDDEN_ARM[0]) & (timestamps < HIDDEN_ARM[1])
    for name in ('lelbow', 'lwrist'):
        lost[hidden, names.index(name)] = True
    lost[(timestamps >= LOST[0]) & (timestamps < LOST[1])] = True
    lost |= ((xy < 0) | (xy >= IMAGE_SIZE)).any(axis=-1)
    xy[lost], score[lost] = np.nan, 0.0
    return np.concatenate([xy, score[..., None]], axis=-1)
