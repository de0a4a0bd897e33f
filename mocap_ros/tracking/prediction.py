"""Prediction of a person through a gap: the last pose, moved with the velocity of the root; gaits go on.

    joints(t) = joints(t0) + v (t - t0) + R (P(t - nT) - P(t0 - nT)),    std(t)^2 = std(t0)^2 + (c (t - t0))^2

with t0 the time of the last detection, v the velocity of the root (m/s) and c the growth of the standard
deviation (m/s). Where the motion is periodic, P is the pose in the body frame that the tracker found at a time, R
the last rotation from the body to the camera, T the length of a cycle, and n the smallest number of cycles for
which t - nT is before the gap. For other motion, or if the window does not reach back to t0 - nT, the last term is
absent.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import MotionKind, Person3D
from mocap_ros.tracking.person_in_frame import make_person
from mocap_ros.tracking.solution import interpolate_linearly
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

PREDICTION_STD_PER_S = 0.5  # m/s; growth of the std in a prediction, for limbs and velocity change meanwhile
MIN_CLEARANCE_M = 0.1  # m; a predicted body must stay this far in front of the camera, or its image is meaningless


def predict_person(track: Track, stamp_ns: int, model: BasePoses) -> Person3D:
    """Return the person of a track at a time after its last detection (formula of the module).

    A movement that would bring the body behind the camera is left out. The standard deviation grows with time.

    Args:
        track: a solved track.
        stamp_ns: ns, time of the prediction.
        model: base poses of the track's solution.
    """
    solution, stamps_ns, intrinsics = track.solved, track.seen.stamps_ns, track.seen.intrinsics
    age_s = (stamp_ns - stamps_ns[-1]) / NS_PER_S
    last = make_person(track, len(stamps_ns) - 1, model)
    velocity = solution.estimate_velocity(stamps_ns) / solution.stature_ratio
    movement = velocity * age_s
    root = last.joints.mean(axis=0) + movement
    joints = last.joints + movement + _continue_gait(track, age_s, model)
    if root[2] < joints[:, 2].max() - root[2] + MIN_CLEARANCE_M:
        joints, root, velocity = last.joints, last.joints.mean(axis=0), np.zeros(3)
    return replace(
        last,
        joints=joints,
        std=np.sqrt(last.std**2 + (PREDICTION_STD_PER_S * age_s) ** 2),
        inferred=np.ones_like(last.inferred),
        scale=float(intrinsics.focal / root[2]),
        translation=intrinsics.project(root),
        residual=float('nan'),
        predicted=True,
        velocity=np.tile(velocity, (len(joints), 1)),
        velocity_std=np.hypot(last.velocity_std, PREDICTION_STD_PER_S),
        root_covariance=last.root_covariance + (PREDICTION_STD_PER_S * age_s) ** 2 / 3 * np.eye(3),
        root_velocity_covariance=last.root_velocity_covariance + PREDICTION_STD_PER_S**2 / 3 * np.eye(3),
        age=last.age + age_s,
        unseen_for=age_s,
    )


def _continue_gait(track: Track, age_s: float, model: BasePoses) -> Array:
    """Return the change of the joints (J, 3) m about the root since the last detection, if the motion is periodic.

    Args:
        track: a solved track.
        age_s: s, time since the last detection, positive.
        model: base poses of the track's solution.
    """
    solution, motion = track.solved, track.schedule.classification.motion
    still = np.zeros_like(model.mean)
    if motion.kind is not MotionKind.PERIODIC:
        return still
    times = (np.array(track.seen.stamps_ns) - track.seen.stamps_ns[-1]) / NS_PER_S
    cycles_s = math.ceil(age_s * motion.cadence) / motion.cadence
    if times[0] > -cycles_s:
        return still
    now, then = model.poses(interpolate_linearly(np.array([age_s - cycles_s, -cycles_s]), times, solution.theta))
    change = (now - then) @ solution.rotation[-1].T
    return np.asarray((change - change.mean(axis=0)) / solution.stature_ratio)
