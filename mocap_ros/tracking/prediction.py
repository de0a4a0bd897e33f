"""Prediction of a person through a gap: the last pose, moved with the velocity of the root.

    joints(t) = joints(t0) + v (t - t0),    std(t)^2 = std(t0)^2 + (c (t - t0))^2

with t0 the time of the last detection, v the velocity of the root (m/s) and c the growth of the standard
deviation (m/s).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.tracking.person_in_frame import make_person
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

PREDICTION_STD_PER_S = 0.5  # m/s; growth of the std in a prediction, for limbs and velocity change meanwhile
MIN_CLEARANCE_M = 0.1  # m; a predicted body must stay this far in front of the camera, or its image is meaningless


def predict_person(track: Track, stamp_ns: int, model: BasePoses) -> Person3D:
    """Return the person of a track at a time after its last detection: the last pose, moved with its velocity.

    A movement that would bring the body behind the camera is left out. The standard deviation grows with time.

    Args:
        track: a solved track.
        stamp_ns: ns, time of the prediction.
        model: base poses of the track's solution.
    """
    solution, stamps_ns, intrinsics = track.solved, track.seen.stamps_ns, track.seen.intrinsics
    age_s = (stamp_ns - stamps_ns[-1]) / NS_PER_S
    last = make_person(track, len(stamps_ns) - 1, model)
    movement = solution.estimate_velocity(stamps_ns) * age_s / solution.stature_ratio
    root = last.joints.mean(axis=0) + movement
    joints = last.joints + movement
    if root[2] < joints[:, 2].max() - root[2] + MIN_CLEARANCE_M:
        joints, root = last.joints, last.joints.mean(axis=0)
    return replace(
        last,
        joints=joints,
        std=np.sqrt(last.std**2 + (PREDICTION_STD_PER_S * age_s) ** 2),
        inferred=np.ones_like(last.inferred),
        scale=float(intrinsics.focal / root[2]),
        translation=intrinsics.project(root),
        residual=float('nan'),
        predicted=True,
    )
