# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A person's joints and their velocity in one frame, and how sure velocity and place are.

With a motion filter they are of its state. Without one, as with a lag, the solution before and after a frame is
smooth, and the velocity is the central difference of the frames beside it (`geometry.interpolation`).

What is published of the newest frame has the filter's velocity with a learned correction, if the pose was lifted
(`models/velocity_correction.py`). With the filter's standard deviation s_j and the correction c_j of a joint, and
likewise with the filter's covariance S of the root's velocity and the correction c_0 of that, these become

    sqrt((f s_j)^2 + (g |c_j|)^2)        h^2 (f^2 S + g^2 c_0 c_0^T)

The covariance of the root's position has three parts: that of its joints, that of the person's size, which has
the relative standard deviation s (`tracking/body_size.py`) and moves the body along the line of sight u at the
distance d, and that of the focal length, which has the relative standard deviation t and moves the body along the
optical axis e at the depth z:

    C = (F std)^2 (I / 6 + u u^T / 2) + (s d)^2 u u^T + (t z)^2 e e^T    (the first term: `models/joint_std.py`)

with std that of the hips, and F = `ROOT_FACTOR`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, INPUT_1D, INPUT_2D, kernel
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import spread_along_sight
from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import SPANS_S, VelocityPast
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

ROOT_FACTOR = 1.1  # 1; detectors put both hips off the same way; chosen by the errors of training persons' roots
CORRECTED_STD = 0.7  # 1; f, for two thirds of the errors to be within, of persons in no training as well
CORRECTION_STD = 0.7  # 1; g, chosen likewise (docs/tracker.md)
ROOT_SPREAD = 1.3  # 1; h, for errors of the root's velocity are often small and at times large: 95 % are within

_AGO = -np.array(SPANS_S)


class CoreMotion(NamedTuple):
    """The core of a person and its velocity in one frame, in the camera's optical frame.

    Attributes:
        joints: (J, 3) m.
        root: (3,) m, position of the body's origin, which is the mean of its joints.
        velocity: (J, 3) m/s; NaN if unknown.
        velocity_std: (J,) m/s, standard deviation of each joint's velocity; NaN if unknown.
        root_velocity_covariance: (3, 3) m^2/s^2, covariance of the velocity of the place between the hips; NaN if
            unknown.
    """

    joints: Array
    root: Array
    velocity: Array
    velocity_std: Array
    root_velocity_covariance: Array


def locate_core(track: Track, frame: int, model: BasePoses) -> Array:
    """Return the joints (J, 3) m of `find_motion` alone."""
    motion_filter = track.motion_filter
    if motion_filter is not None and motion_filter.stamps_ns[-1] == track.seen.stamps_ns[frame]:
        return motion_filter.joints
    return track.solved.locate_joints(frame, model)


def find_motion(track: Track, frame: int, model: BasePoses) -> CoreMotion:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    motion_filter, stamps_ns = track.motion_filter, track.seen.stamps_ns
    if motion_filter is not None and motion_filter.stamps_ns[-1] == stamps_ns[frame]:
        filtered = motion_filter.read()
        return CoreMotion(
            filtered.joints, filtered.root, filtered.velocity, *_find_velocity_std(filtered.velocity_variance)
        )
    solution, velocity = track.solved, np.full((len(model.mean), 3), np.nan)
    if 0 < frame < len(solution.theta) - 1:
        frames = np.arange(frame - 1, frame + 2)
        times = np.array([stamps_ns[i] - stamps_ns[frame] for i in frames]) / NS_PER_S
        places = solution.compute_joints(model, frames) + solution.roots[frames, None]
        velocity = central_velocity(times, places / solution.stature_ratio)[1]
    joints, root = solution.locate_joints(frame, model), solution.roots[frame] / solution.stature_ratio
    return CoreMotion(joints, root, velocity, np.full(len(velocity), np.nan), np.full((3, 3), np.nan))


def find_published_motion(track: Track, frame: int, model: BasePoses) -> CoreMotion:
    """Return what `find_motion` does, with the velocity corrected where that is learned (module).

    The arguments are those of `find_motion`.
    """
    found = find_motion(track, frame, model)
    past = sample_velocity_past(track, model, found) if frame == len(track.seen.stamps_ns) - 1 else None
    if past is None:
        return found
    correction = load_velocity_correction().correct(past)
    if not correction.any():
        return found
    uncertainty = _correct_uncertainty(found.velocity_std, found.root_velocity_covariance, correction)
    return CoreMotion(found.joints, found.root, found.velocity + correction, *uncertainty)


def sample_velocity_past(track: Track, model: BasePoses, filtered: CoreMotion) -> VelocityPast | None:
    """Return what the correction of the velocities in the newest frame rests on; None where it is not trained for.

    Args:
        track: a solved track.
        model: base poses of the track's solution.
        filtered: what the filter says of the newest frame.
    """
    lifted, motion_filter, stamps_ns = track.seen.observed.lifted, track.motion_filter, track.seen.stamps_ns
    is_filtered = motion_filter is not None and motion_filter.stamps_ns[-1] == stamps_ns[-1]
    if lifted is None or not is_filtered or model.skeleton.joints != CMU15.joints:
        return None
    frame, solution = len(stamps_ns) - 1, track.solved
    return VelocityPast(
        filtered.velocity,
        filtered.velocity_std,
        solution.locate_joints(frame, model),
        solution.sample_joints(model, track.seen.times_s, _AGO),
        solution.rotation[frame],
    )


@kernel(types.Tuple((FLOATS_1D, FLOATS_2D))(INPUT_1D, INPUT_2D, INPUT_2D))
def _correct_uncertainty(std: Array, covariance: Array, correction: Array) -> tuple[Array, Array]:
    """Return the last two attributes of `CoreMotion` from those of the filter and corrections (J, 3) m/s."""
    out, root = np.empty(len(std)), (ROOT_SPREAD * CORRECTED_STD) ** 2 * covariance
    for j in range(len(std)):
        squared = correction[j, 0] ** 2 + correction[j, 1] ** 2 + correction[j, 2] ** 2
        out[j] = math.sqrt((CORRECTED_STD * std[j]) ** 2 + CORRECTION_STD**2 * squared)
    at_root = (correction[HIPS[0]] + correction[HIPS[1]]) / 2
    for i in range(3):
        for k in range(3):
            root[i, k] += (ROOT_SPREAD * CORRECTION_STD) ** 2 * at_root[i] * at_root[k]
    return out, root


@kernel(types.Tuple((FLOATS_1D, FLOATS_2D))(INPUT_2D))
def _find_velocity_std(variance: Array) -> tuple[Array, Array]:
    """Return the last two attributes of `CoreMotion` from the variance (J, 3) m^2/s^2 of each coordinate.

    The errors of both hips are mostly the same, so the variance of the place between them is their mean.
    """
    std, covariance = np.empty(len(variance)), np.zeros((3, 3))
    for j in range(len(variance)):
        std[j] = math.sqrt(variance[j, 0] + variance[j, 1] + variance[j, 2])
    for i in range(3):
        covariance[i, i] = (variance[HIPS[0], i] + variance[HIPS[1], i]) / 2
    return std, covariance


@kernel(FLOATS_2D(INPUT_1D, INPUT_1D, FLOAT, FLOAT))
def estimate_root_covariance(root: Array, std: Array, share: float, focal_share: float) -> Array:
    """Return the covariance (3, 3) m^2 of the place of a person (formula of the module).

    Args:
        root: (3,) m, the place in the camera's optical frame.
        std: (J,) m, standard deviations of the person's joints; NaN if unknown.
        share: s, standard deviation of the size as a share of it.
        focal_share: t, that of the focal length as a share of it.
    """
    out = spread_along_sight(ROOT_FACTOR * (std[HIPS[0]] + std[HIPS[1]]) / 2, root)
    for i in range(3):
        for k in range(3):
            out[i, k] += share**2 * root[i] * root[k]
    out[2, 2] += (focal_share * root[2]) ** 2
    return out
