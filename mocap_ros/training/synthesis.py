# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Synthesis of training examples for the lifter: motion capture seen by random cameras and imperfect detectors.

An example is drawn from motion capture. Its body is varied, joints are moved to where detectors place them, and a
random camera projects it; `detector_errors` then adds the errors of a detector. Poses are in m with z up. Images
are in m at the person's distance, so that all magnitudes below are in metres. Shapes: N examples, T slots of the
history (newest first), J joints of `skeleton.BODY26`,
J_c of its core `skeleton.CMU15`.

The magnitudes are estimates. The mixture as a whole was chosen on CMU subjects 02, 16 and 49, with lifters that
had seen neither these nor the test subjects. Shares are shares of the examples.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from mocap_ros.models.lifter_input import (
    HISTORY_SLOTS_S,
    JOINT_COUNT,
    MIRROR_PERMUTATION,
    encode_features,
    weigh_vertical,
)
from mocap_ros.skeleton import BODY26, CORE_COUNT
from mocap_ros.training.detector_errors import JOINT_ROWS, OFFSET_STD_M, DetectorErrors
from mocap_ros.training.example_arrays import (
    AGO,
    Array,
    Array64,
    Bools,
    RandomArrays,
    add_bones,
    axis_rotations,
    find_trunks,
    rotate_points,
    rotations_from_vectors,
)
from mocap_ros.training.motion_library import FPS, MotionLibrary
from mocap_ros.training.postures import FACE, LIMBS, joint_indices, limb_indices, take_postures

# Bodies and poses: the library has few people and motions, and the lifter meets many.
MIRRORED_SHARE = 0.5  # share; people are left- and right-handed alike
BONE_LENGTH_STD = 0.07  # 1, standard deviation of the factor on each bone length
MAX_BONE_LENGTH_DEVIATIONS = 2.5  # standard deviations; bounds the factor to 0.83 and 1.18
MIN_BONE_LENGTH_M = 1e-6  # m; guards divisions by the length of bones that a trial lacks
BORROWED_LIMB_SHARES = {'arms': 0.25, 'larm': 0.12, 'lleg': 0.04, 'legs': 0.12}  # with another example's limb
ROTATED_LIMB_SHARE = 0.25  # share, for each limb; the limb is held differently for the whole example
LIMB_ROTATION_STD_RAD = 0.25  # rad, standard deviation of each component of the limb's rotation
TILTED_SHARE = 0.06  # share of strongly tilted bodies, as in falls and acrobatics, which the library lacks
STRONG_TILT_STD_RAD = 0.5  # rad, standard deviation of each component of their rotation
SLIGHT_TILT_STD_RAD = 0.05  # rad, the same for all other bodies, as real floors and leaning differ

# Offsets between the joints of motion capture and those of detectors, which define joints differently.
PRECISE_SHARE = 0.2  # share of examples whose points have neither offsets nor noise; keeps precise points precise
OFFSET_SIZE_RANGE = (0.3, 2.2)  # 1, factor on the offsets of an example, log-uniform; detectors differ

# Cameras.
TURNING_SHARE = 0.3  # share of examples in which camera or person turns beyond the recorded motion
HEADING_RATE_STD = 0.4  # rad/s, standard deviation of the rate of the heading in these
ELEVATION_RATE_STD = 0.1  # rad/s, standard deviation of the rate of the elevation in these
# Degrees above the horizon: most cameras are on robots, tripods and walls and look slightly down.
COMMON_ELEVATION_SHARE = 0.6  # share of the examples with such a camera
COMMON_ELEVATION_DEG = (12, 14)  # degrees, mean and standard deviation of the elevation in these
ELEVATION_RANGE_DEG = (-20, 45)  # degrees in the others; from a camera on the floor to one under the ceiling
ROLL_STD_DEG = 7  # degrees, standard deviation; hand-held cameras and cameras that are not levelled

# What the lifter gets of the vertical.
KNOWN_VERTICAL_SHARE = 0.5  # share of the examples in which it is known
VERTICAL_STD_RANGE_RAD = (0.008, 0.25)  # rad, by how much it is off, log-uniform; 0.5 to 14 degrees

# Projection.
ORTHOGRAPHIC_SHARE = 0.35  # share; distant people, and the weak-perspective images of the solvers
DISTANCE_RANGE_M = (1.6, 7.0)  # m from the camera; nearer, a whole person does not fit into an image
MIN_DISTANCE_M = 1.2  # m; bounds an approach within the history
APPROACH_SHARE = 0.3  # share of examples in which the distance changes
APPROACH_SPEED_STD = 0.8  # m/s, standard deviation of the speed in these, about walking speed
OFF_AXIS_SHARE = 0.3  # share of examples in which the person is clearly off the optical axis
OFF_AXIS_STD = 0.2  # 1, standard deviation of x / z and y / z of the person in these
NEAR_AXIS_STD = 0.03  # 1, the same in the others, as a virtual camera does not face the person perfectly
MIN_RELATIVE_DEPTH = 0.2  # distances; keeps joints in front of the camera
UNKNOWN_FOCAL_SHARE = 0.4  # share of the perspective images whose focal length the lifter is not given

_FRAMES_AGO = np.round(HISTORY_SLOTS_S * FPS).astype(int)  # frames from each slot to the newest frame

# (J,) index of the joint whose factor on the bone length each joint shares: both sides, and all of a face.
_SAME_FACTOR = np.minimum(np.arange(JOINT_COUNT), MIRROR_PERMUTATION)
_SAME_FACTOR[joint_indices(*FACE)] = BODY26.index(FACE[0])
_RIGHT = [right for _, right in BODY26.left_right_pairs]


@dataclass(frozen=True, eq=False)
class ExampleBatch:
    """N training examples."""

    features: Array  # (N, FEATURE_COUNT) features of the network, as this and the next from `encode_features`
    newest: Array  # (N, J, 2) newest image points
    target: Array  # (N, J, 3) true pose relative to the mean of its core, in the unit of the features
    size: Array  # (N,) m, the unit of the features
    is_known: Bools  # (N, J) whether the true joint is known


class ExampleSynthesiser:
    """An endless stream of training examples; the same arguments give the same examples.

    `without` names those of `postures.KINDS` that are left out, to measure what they are good for.
    """

    def __init__(self, library: MotionLibrary, seed: int, without: Collection[str] = ()) -> None:
        self.library = library
        self.without = without
        self.random = RandomArrays(seed)
        self.errors = DetectorErrors(self.random)

    def make_batch(self, count: int) -> ExampleBatch:
        """Make the next `count` examples."""
        vectors, is_recorded, is_known = self._draw_motion(count)
        vectors = self._vary_bodies(vectors)
        points = add_bones(vectors)  # (N, T, J, 3)
        is_precise = self.random.chance(count, PRECISE_SHARE)
        offsets = np.where(is_precise[:, None, None, None], np.float32(0), self._draw_offsets(points))
        rotation = self._draw_cameras(count)
        truth = rotate_points(points[:, :1], rotation[:, :1])[:, 0]
        in_camera = rotate_points(points + offsets, rotation)
        image, focal = self._project(in_camera)
        image, weight = self.errors.detect(image, in_camera[:, 0, :, 2], is_recorded, is_known, is_precise)
        upward = self._draw_verticals(rotation[:, 0])
        features, newest, size = encode_features(image, weight, focal, upward)
        target = (truth - truth[:, :CORE_COUNT].mean(axis=1, keepdims=True)) / size[:, None, None]
        return ExampleBatch(
            features, newest.astype(np.float32), target.astype(np.float32), size.astype(np.float32), is_known
        )

    def _draw_motion(self, count: int) -> tuple[Array, Bools, Bools]:
        """Draw histories of motion.

        Returns:
            (N, T, J, 3) m, bone vectors of bodies that face +x in the newest frame; (N, T) whether the trial had
            begun at the slot, before which its first pose is repeated; and (N, J) whether the trial has the joint.
        """
        newest = np.searchsorted(self.library.cumulative_probability, self.random.rng.random(count))
        index = newest[:, None] - _FRAMES_AGO
        first = self.library.first_frame[newest][:, None]
        vectors = self.library.bone_vectors[np.maximum(index, first)]
        is_mirrored = self.random.chance(count, MIRRORED_SHARE, axes=3)
        mirrored = vectors[:, :, MIRROR_PERMUTATION] * np.array([1, -1, 1], np.float32)
        vectors = np.where(is_mirrored, mirrored, vectors)
        poses = add_bones(vectors[:, 0])
        left, right = (list(side) for side in zip(*BODY26.left_right_pairs, strict=True))
        trunk = [left.index(j) for j in joint_indices('lhip', 'lshoulder')]
        across = (poses[:, left] - poses[:, right])[:, trunk].sum(axis=1)
        x, y = across[:, 0], across[:, 1]
        yaw = np.pi / 2 - np.arctan2(y, x)
        is_known = self.library.has_extremities[newest][:, None] | (np.arange(JOINT_COUNT) < CORE_COUNT)
        return rotate_points(vectors, axis_rotations(2, yaw)[:, None]), index >= first, is_known

    def _vary_bodies(self, vectors: Array) -> Array:
        """Vary bone vectors (N, T, J, 3): lengths, borrowed limbs, rotated limbs, postures, tilted bodies."""
        random = self.random
        count = len(vectors)
        limit = MAX_BONE_LENGTH_DEVIATIONS
        factor = 1 + BONE_LENGTH_STD * np.clip(random.normal(count, JOINT_COUNT), -limit, limit)
        vectors = vectors * factor[:, None, _SAME_FACTOR, None]
        donor = np.roll(vectors, 1, axis=0)
        for limb, share in BORROWED_LIMB_SHARES.items():
            own = np.flatnonzero(random.chance(count, share))
            joints = limb_indices(limb)
            limbs, given = vectors[own][:, :, joints], donor[own][:, :, joints]
            lengths, given_lengths = (np.linalg.norm(v[:, :1], axis=-1, keepdims=True) for v in (limbs, given))
            has_bone = given_lengths > MIN_BONE_LENGTH_M  # of a trial that lacks it there is nothing to borrow
            borrowed = given * lengths / np.maximum(given_lengths, MIN_BONE_LENGTH_M)
            vectors[own[:, None], :, joints] = np.moveaxis(np.where(has_bone, borrowed, limbs), 2, 1)
        for limb in LIMBS:
            chosen = np.flatnonzero(random.chance(count, ROTATED_LIMB_SHARE))
            joints = limb_indices(limb)
            rotation = rotations_from_vectors(np.float32(LIMB_ROTATION_STD_RAD) * random.normal(len(chosen), 3))
            rotated = rotate_points(vectors[chosen][:, :, joints], rotation[:, None])
            vectors[chosen[:, None], :, joints] = np.moveaxis(rotated, 2, 1)
        vectors = take_postures(vectors, random, self.without)
        tilt_std = random.choose(count, TILTED_SHARE, STRONG_TILT_STD_RAD, SLIGHT_TILT_STD_RAD, axes=1)
        tilt = tilt_std * random.normal(count, 3)
        return rotate_points(vectors, rotations_from_vectors(tilt)[:, None])

    def _draw_offsets(self, points: Array) -> Array:
        """Return offsets (N, T, J, 3) in m from the joints of motion capture to those of a detector.

        They are fixed in the frame of the trunk, constant over an example and the same on both sides: joints of
        real detectors are 25 to 40 mm off, half of it so.
        """
        count = len(points)
        offsets = OFFSET_STD_M * self.random.normal(count, *OFFSET_STD_M.shape)
        offsets = offsets[:, JOINT_ROWS] * self.random.log_uniform(OFFSET_SIZE_RANGE, count, 1, 1)
        offsets[:, _RIGHT, 1] *= -1
        return np.asarray(offsets[:, None] @ np.swapaxes(find_trunks(points), -1, -2))

    def _draw_cameras(self, count: int) -> Array:
        """Return rotations (N, T, 3, 3) from the body frame to the camera's optical frame; some turn slowly."""
        random = self.random
        turning_time = random.choose(count, TURNING_SHARE, 1, 0, axes=1) * AGO
        heading = random.uniform(-np.pi, np.pi, count, 1)
        heading = heading + HEADING_RATE_STD * random.normal(count, 1) * turning_time
        mean, std = COMMON_ELEVATION_DEG
        is_common = random.chance(count, COMMON_ELEVATION_SHARE, axes=1)
        elevation = np.where(
            is_common, mean + std * random.normal(count, 1), random.uniform(*ELEVATION_RANGE_DEG, count, 1)
        )
        elevation = np.radians(elevation)
        elevation = elevation + ELEVATION_RATE_STD * random.normal(count, 1) * turning_time
        roll = np.radians(ROLL_STD_DEG) * random.normal(count, 1)
        roll = np.broadcast_to(roll, heading.shape)
        to_optical = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], np.float32)
        rotation = axis_rotations(2, roll) @ axis_rotations(0, elevation) @ to_optical
        return np.asarray(rotation @ axis_rotations(2, heading))

    def _draw_verticals(self, rotation: Array) -> Array64:
        """Return what the lifter gets of the vertical (N, 3); rotations (N, 3, 3) from body to camera."""
        random = self.random
        count = len(rotation)
        std = random.log_uniform(VERTICAL_STD_RANGE_RAD, count)
        error = rotations_from_vectors(std[:, None].astype(np.float32) * random.normal(count, 3))
        seen = (error @ rotation[:, :, 2, None])[..., 0].astype(float)
        return weigh_vertical(seen, np.where(random.chance(count, KNOWN_VERTICAL_SHARE), std, np.inf))

    def _project(self, points: Array) -> tuple[Array, Array64]:
        """Project points (N, T, J, 3) in m, in the camera's axes, by random perspective or orthographic cameras.

        Returns:
            (N, T, J, 2) image points in m at the person's distance, and (N,) focal lengths in the same unit as
            given to the lifter; infinite if orthographic or unknown.
        """
        random = self.random
        count = len(points)
        relative = points - points[:, :1, :CORE_COUNT].mean(axis=2, keepdims=True)
        is_orthographic = random.chance(count, ORTHOGRAPHIC_SHARE, axes=1)
        newest_distance = random.uniform(*DISTANCE_RANGE_M, count, 1)
        speed = random.choose(count, APPROACH_SHARE, APPROACH_SPEED_STD, 0, axes=1) * random.normal(count, 1)
        distance = newest_distance + speed * AGO
        distance = np.maximum(distance, np.float32(MIN_DISTANCE_M))[..., None]
        off_axis = random.choose(count, OFF_AXIS_SHARE, OFF_AXIS_STD, NEAR_AXIS_STD, axes=1)
        aside = off_axis * newest_distance * random.normal(count, 2)
        depth = (distance + relative[..., 2]) / newest_distance[..., None]
        depth = np.maximum(depth, np.float32(MIN_RELATIVE_DEPTH))
        depth = np.where(is_orthographic[..., None], np.float32(1), depth)
        image = (relative[..., :2] + aside[:, None, None]) / depth[..., None]
        is_unknown = random.chance(count, UNKNOWN_FOCAL_SHARE)
        focal = np.where(is_orthographic[:, 0] | is_unknown, np.inf, newest_distance[:, 0])
        return image, focal
