"""Velocity of a person's joints, and how sure it and the place of the person are.

With a motion filter they are of its state. Without one, as with a lag, the solution before and after a frame is
smooth, and the velocity is the central difference of the frames beside it (`geometry.differences`).

The covariance of the root's position has two parts: that of its joints, and the body height, which is not known
and moves the whole body along the line of sight u at the distance d:

    C = std^2 / 3 I + (s d)^2 u u^T,    s^2 = s_height^2 (+ s_focal^2 without a CameraInfo)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.differences import central_velocity
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import HIPS
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

# 1; factors on the filter's standard deviations of velocities in x, y, z. The filter takes the tremble for white
# noise, but it lasts for several frames, most of all along the line of sight, so the filter is too sure of itself.
# With these factors, 57 of 100 errors on the demo are within the standard deviation: 81 of a walk, 32 of a run.
STD_FACTORS = np.array([1.5, 1.5, 3.0])
HEIGHT_SHARE = 0.059  # 1; standard deviation of the body heights of adults over their mean: 0.10 m of 1.70 m
FOCAL_SHARE = 0.2  # 1; usual focal lengths are 0.8 to 1.2 image widths, and the nominal one is 1 image width


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
        variance = motion_filter.velocity_variance * STD_FACTORS**2
        root_variance = variance[HIPS, :].mean(axis=0)  # the errors of both hips are mostly the same
        return JointVelocity(motion_filter.velocity, np.sqrt(variance.sum(axis=1)), np.diag(root_variance))
    solution, joints = track.solved, np.full((len(model.mean), 3), np.nan)
    if 0 < frame < len(solution.theta) - 1:
        frames = np.arange(frame - 1, frame + 2)
        times = np.array([stamps_ns[i] - stamps_ns[frame] for i in frames]) / NS_PER_S
        places = solution.compute_joints(model, frames) + solution.roots[frames, None]
        joints = central_velocity(times, places / solution.stature_ratio)[1]
    return JointVelocity(joints, np.full(len(joints), np.nan), np.full((3, 3), np.nan))


def estimate_root_covariance(root: Array, std: float, *, is_focal_known: bool) -> Array:
    """Return the covariance (3, 3) m^2 of the place of a person (formula of the module).

    Args:
        root: (3,) m, the place in the camera's optical frame.
        std: m, standard deviation of the joints there; NaN if unknown.
        is_focal_known: whether the focal length is that of a CameraInfo.
    """
    share = HEIGHT_SHARE if is_focal_known else math.hypot(HEIGHT_SHARE, FOCAL_SHARE)
    return np.asarray(std**2 / 3 * np.eye(3) + share**2 * np.outer(root, root))
