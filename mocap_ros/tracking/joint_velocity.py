"""Velocity of a person's joints, and how sure it and the place of the person are.

With a motion filter they are of its state. Without one, as with a lag, the solution before and after a frame is
smooth, and the velocity is the central difference of the frames beside it (`geometry.differences`).

The covariance of the root's position has two parts: that of its joints, and that of the person's size, which has
the relative standard deviation s (`tracking/body_size.py`) and moves the body along the line of sight u at the
distance d:

    C = std^2 / 3 I + (s d)^2 u u^T
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.differences import central_velocity
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import HIPS
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]


class JointVelocity(NamedTuple):
    """Velocity of a person's joints in the camera's optical frame.

    Attributes:
        joints: (J, 3) m/s; NaN if unknown.
        std: (J,) m/s, standard deviation of each joint's velocity; NaN if unknown.
        root_covariance: (3, 3) m^2/s^2, covariance of the velocity of the place between the hips; NaN if unknown.
    """

    joints: Array
    std: Array
    root_covariance: Array


def estimate_velocity(track: Track, frame: int, model: BasePoses) -> JointVelocity:
    """Return the velocity of a track's joints in one solved frame of its window.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    motion_filter, stamps_ns = track.motion_filter, track.seen.stamps_ns
    if motion_filter is not None and motion_filter.stamps_ns[-1] == stamps_ns[frame]:
        variance = motion_filter.velocity_variance
        root_variance = variance[HIPS, :].mean(axis=0)  # the errors of both hips are mostly the same
        return JointVelocity(motion_filter.velocity, np.sqrt(variance.sum(axis=1)), np.diag(root_variance))
    solution, joints = track.solved, np.full((len(model.mean), 3), np.nan)
    if 0 < frame < len(solution.theta) - 1:
        frames = np.arange(frame - 1, frame + 2)
        times = np.array([stamps_ns[i] - stamps_ns[frame] for i in frames]) / NS_PER_S
        places = solution.compute_joints(model, frames) + solution.roots[frames, None]
        joints = central_velocity(times, places / solution.stature_ratio)[1]
    return JointVelocity(joints, np.full(len(joints), np.nan), np.full((3, 3), np.nan))


def estimate_root_covariance(root: Array, std: Array, share: float) -> Array:
    """Return the covariance (3, 3) m^2 of the place of a person (formula of the module).

    Args:
        root: (3,) m, the place in the camera's optical frame.
        std: (J,) m, standard deviations of the person's joints; NaN if unknown.
        share: s, standard deviation of the size as a share of it.
    """
    own = float(std[HIPS[0]] + std[HIPS[1]]) / 2
    return np.asarray(own**2 / 3 * np.eye(3) + share**2 * np.outer(root, root))
