# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The scene of the demo: a person walks past, breaks into a run, jumps and walks on, and a robot's head follows.

The scene is harder than an inversion of the solver's own model. The bodies come from base poses of their own, with
all components, and have bone lengths that no training subject has. The perspective camera pans and shakes. The
detector is noisy and misses joints, for a short time it misses the whole person, and for a while one arm is
hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap_ros.arrays import Array
from mocap_ros.demo.motions import FRAME_RATE_HZ, load_motions
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.skeleton import CMU15, keypoint_layout
from mocap_ros.training.fit_base_poses import scale_bones

IMAGE_SIZE = (640, 480)  # px, width and height of a common USB camera
FOCAL_LENGTH_PX = 600.0  # px, a horizontal field of view of 56 degrees, as common USB cameras have
# px, without distortion
CAMERA_MATRIX = np.array(
    [[FOCAL_LENGTH_PX, 0, IMAGE_SIZE[0] / 2], [0, FOCAL_LENGTH_PX, IMAGE_SIZE[1] / 2], [0, 0, 1]]
)
CAMERA_HEIGHT_M = 1.3  # m, height of a robot's head above the ground
CIRCLE_RADIUS_M = 2.8  # m, radius of the path, so that the person is seen from all sides
CIRCLE_DISTANCE_M = 6.5  # m, from the camera to the centre of the path, so that the whole body is in the image
BLEND_S = 0.4  # s, time over which one motion turns into the next
SEED = 7  # random seed with which the shipped recording was made

# The motions of the person in order: name, duration in s, and the second of the motion at which it starts.
SCRIPT = (('walk', 4.5, 0.0), ('run', 3.0, 0.0), ('jump', 2.2, 0.5), ('walk', 3.3, 0.4))
HIDDEN_ARM_S = (2.0, 3.2)  # s, begin and end of the time in which the left elbow and wrist are not detected
MISSED_PERSON_S = (5.6, 5.75)  # s, begin and end of the time in which the person is not detected

# Factors on the bone lengths, by the outer joint of the bone; both sides of the body have the same.
BONE_FACTORS = {
    'knee': 1.07, 'ankle': 1.05, 'elbow': 0.94, 'wrist': 1.08, 'hip': 1.1, 'shoulder': 0.93,
    'neck': 0.95, 'head': 1.04, 'pelvis': 1.0,
}  # fmt: skip
HEIGHT_FACTOR = 1.06  # factor on the height of the body's centre, since these legs are longer

# Positions of the face's keypoints: along the vector from the neck to the head as a share of its length, then
# forward and to the left in m.
FACE_OFFSETS = {
    'nose': (0.72, 0.11, 0.0), 'leye': (0.85, 0.085, 0.032), 'reye': (0.85, 0.085, -0.032),
    'lear': (0.78, 0.0, 0.075), 'rear': (0.78, 0.0, -0.075),
}  # fmt: skip

# Standard deviation of the detector's noise in each coordinate, as a share of the body height in the image.
KEYPOINT_NOISE = {
    'nose': 0.004, 'eye': 0.004, 'ear': 0.005, 'shoulder': 0.008, 'elbow': 0.009,
    'wrist': 0.011, 'hip': 0.012, 'knee': 0.009, 'ankle': 0.009,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Recording:
    """The demo recording and its truth."""

    # (F, 17, 3) keypoints of layout COCO-17, x and y in px and a score; NaN and score 0 if not seen
    keypoints: Array
    timestamps: Array  # (F,) s
    truth: Array  # (F, 15, 3) m in the camera's optical frame, joints of `CMU15`

    def sequence(self, *, is_calibrated: bool = False) -> KeypointSequence:
        """Return the content of a sequence file; users often lack the camera's intrinsics."""
        return KeypointSequence(
            keypoints=self.keypoints,
            joint_names=keypoint_layout('coco17').joints,
            timestamps=self.timestamps,
            image_size=IMAGE_SIZE,
            camera_matrix=CAMERA_MATRIX if is_calibrated else None,
            truth=GroundTruth(self.truth, CMU15.joints),
        )


def motion_name_at(time_s: float) -> str:
    """Return the name of the person's motion at this time."""
    end = 0.0
    for name, duration, _ in SCRIPT:
        end += duration
        if time_s < end:
            return name
    return SCRIPT[-1][0]


def make_recording() -> Recording:
    """Generate the recording, the same every time."""
    rng = np.random.default_rng(SEED)
    model, motions = load_motions()
    parts = [
        motions[name].sample(start + np.arange(round(duration * FRAME_RATE_HZ)) / FRAME_RATE_HZ)
        for name, duration, start in SCRIPT
    ]
    samples = _concatenate_motions(parts)
    factor = np.array([_look_up_joint(BONE_FACTORS, CMU15.joints[child]) for _, child in CMU15.bones])
    body = scale_bones(model.poses(samples[:, :-2]), CMU15, factor)
    body -= body.mean(axis=1, keepdims=True)
    truth = _transform_to_camera(_place_in_world(body, samples[:, -2], samples[:, -1]), rng)
    timestamps = np.arange(len(truth)) / FRAME_RATE_HZ
    return Recording(_simulate_detector(truth, timestamps, rng), timestamps, truth)


def _look_up_joint(table: dict[str, float], joint: str) -> float:
    """Return the value of a joint in a table that gives both sides of the body one value, such as `knee`."""
    return table[joint if joint in table else joint[1:]]


def _concatenate_motions(tables: list[Array]) -> Array:
    """Concatenate samples (N, K + 2) of motions, and blend each with the next over `BLEND_S`."""
    half = round(BLEND_S * FRAME_RATE_HZ / 2)
    out = np.concatenate(tables)
    seam = 0
    for table in tables[:-1]:
        seam += len(table)
        ramp = np.linspace(0, 1, 2 * half + 2)[1:-1, None]
        ramp = ramp**2 * (3 - 2 * ramp)
        before = np.concatenate([out[seam - half : seam], np.repeat(out[seam - 1 : seam], half, axis=0)])
        after = np.concatenate([np.repeat(out[seam : seam + 1], half, axis=0), out[seam : seam + half]])
        out[seam - half : seam + half] = (1 - ramp) * before + ramp * after
    return out


def _place_in_world(body: Array, height: Array, speed: Array) -> Array:
    """Move the body (F, 15, 3) in m anticlockwise along the circle; x right, y away from the camera, z up."""
    distance = np.cumsum(speed) / FRAME_RATE_HZ
    angle = np.radians(-150) + distance / CIRCLE_RADIUS_M
    heading = angle + np.pi / 2
    c, s, o = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    rotation = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, o + 1], -1)], -2)
    x, y = CIRCLE_RADIUS_M * np.cos(angle), CIRCLE_DISTANCE_M + CIRCLE_RADIUS_M * np.sin(angle)
    centre = np.stack([x, y, height * HEIGHT_FACTOR], axis=-1)
    return np.asarray(body @ np.swapaxes(rotation, -1, -2) + centre[:, None])


def _transform_to_camera(world: Array, rng: np.random.Generator) -> Array:
    """Transform joints (F, 15, 3) into the frame of a camera that follows the person late and shakes."""
    frames = len(world)
    centre = world.mean(axis=1)
    pan = gaussian_filter1d(np.arctan2(centre[:, 0], centre[:, 1]), 0.4 * FRAME_RATE_HZ, mode='nearest')
    pan = np.concatenate([np.repeat(pan[:1], 6), pan[:-6]])
    shake = gaussian_filter1d(rng.standard_normal((frames, 3)), 0.1 * FRAME_RATE_HZ, axis=0)
    pan = pan + np.radians(1.0) * shake[:, 0]
    tilt = np.radians(4.0) + np.radians(1.0) * shake[:, 1]
    roll = np.radians(1.0) * shake[:, 2]
    p = world - [0, 0, CAMERA_HEIGHT_M]
    right = np.cos(pan)[:, None] * p[..., 0] - np.sin(pan)[:, None] * p[..., 1]
    away = np.sin(pan)[:, None] * p[..., 0] + np.cos(pan)[:, None] * p[..., 1]
    down = -p[..., 2]
    ct, st = np.cos(tilt)[:, None], np.sin(tilt)[:, None]
    down, away = ct * down - st * away, st * down + ct * away
    cr, sr = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([cr * right - sr * down, sr * right + cr * down, away], axis=-1)


def project(points: Array) -> Array:
    """Project points (..., 3) in m in the camera's optical frame to pixels (..., 2)."""
    centre = np.array(IMAGE_SIZE) / 2
    return np.asarray(points[..., :2] / points[..., 2:] * FOCAL_LENGTH_PX + centre)


def _add_face(truth: Array) -> Array:
    """Return the COCO-17 joints (F, 17, 3): those of the body, and eyes, ears and nose placed on the head."""
    joint = {name: truth[:, i] for i, name in enumerate(CMU15.joints)}
    up = joint['head'] - joint['neck']
    left = joint['lshoulder'] - joint['rshoulder'] + joint['lhip'] - joint['rhip']
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    forward = np.cross(left, up)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    for name, (share_up, forward_m, left_m) in FACE_OFFSETS.items():
        joint[name] = joint['neck'] + share_up * up + forward_m * forward + left_m * left
    return np.stack([joint[name] for name in keypoint_layout('coco17').joints], axis=1)


def _simulate_detector(truth: Array, timestamps: Array, rng: np.random.Generator) -> Array:
    """Return the keypoints (F, 17, 3) that a detector would give of joints (F, 15, 3) in the optical frame.

    The noise is correlated over time. A joint that is farther from the camera than the body's centre counts as
    probably occluded by the body: its noise is larger, its score lower, and it is missed more often.
    """
    names = keypoint_layout('coco17').joints
    points3d = _add_face(truth)
    xy = project(points3d)
    frames = len(xy)
    body_height_px = 1.7 * FOCAL_LENGTH_PX / points3d[..., 2].mean(axis=1)

    depth = points3d[..., 2] - truth.mean(axis=1)[:, None, 2]
    occlusion = 1 / (1 + np.exp(-(depth - 0.12) / 0.03))
    spread = np.array([_look_up_joint(KEYPOINT_NOISE, n) for n in names]) * (1 + 1.5 * occlusion)
    noise = rng.standard_normal(xy.shape)
    for t in range(1, frames):
        noise[t] = 0.6 * noise[t - 1] + 0.8 * noise[t]
    xy = xy + noise * (spread * body_height_px[:, None])[..., None]
    score = np.clip(0.95 - 0.4 * occlusion + 0.05 * rng.standard_normal(occlusion.shape), 0.15, 1.0)

    missed = rng.random(score.shape) < 0.02 + 0.06 * occlusion
    arm_hidden = (timestamps >= HIDDEN_ARM_S[0]) & (timestamps < HIDDEN_ARM_S[1])
    for name in ('lelbow', 'lwrist'):
        missed[arm_hidden, names.index(name)] = True
    missed[(timestamps >= MISSED_PERSON_S[0]) & (timestamps < MISSED_PERSON_S[1])] = True
    missed |= ((xy < 0) | (xy >= IMAGE_SIZE)).any(axis=-1)
    xy[missed], score[missed] = np.nan, 0.0
    return np.concatenate([xy, score[..., None]], axis=-1)
