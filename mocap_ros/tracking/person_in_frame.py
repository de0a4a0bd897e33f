"""The 3D person of a track in one solved frame of its window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.people import Motion, Person3D
from mocap_ros.tracking.joint_velocity import estimate_velocity
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]


def locate_joints(track: Track, frame: int, model: BasePoses) -> Array:
    """Return the joints (J, 3) m in the camera's frame as they were solved; arguments as for `make_person`."""
    solution = track.solved
    pose = model.poses(solution.theta[frame]) @ solution.rotation[frame].T + solution.roots[frame]
    return np.asarray(pose / solution.stature_ratio)


def locate_output_joints(track: Track, frame: int, model: BasePoses) -> Array:
    """Return the core (J, 3) m as it is put out, filtered if there is a filter; arguments as of `make_person`."""
    motion_filter = track.motion_filter
    if motion_filter is not None and motion_filter.stamps_ns[-1] == track.seen.stamps_ns[frame]:
        return motion_filter.joints
    return locate_joints(track, frame, model)


def make_person(track: Track, frame: int, model: BasePoses) -> Person3D:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter.

    `body_size.resize` gives the person the size that is known, and with it the covariance of the root.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    solution, observed, classification = track.solved, track.seen.observed, track.schedule.classification
    intrinsics, lifted = track.seen.intrinsics, observed.lifted
    size = 1 / solution.stature_ratio
    motion_filter = track.motion_filter
    if motion_filter is not None and motion_filter.stamps_ns[-1] == track.seen.stamps_ns[frame]:
        joints = motion_filter.joints
        root = joints.sum(axis=0) / len(joints)
    else:
        joints, root = locate_joints(track, frame, model), solution.roots[frame] * size
    inferred = observed.weight[frame] == 0
    lifted_std = None if lifted is None else lifted.std[frame, : len(joints)] * root[2]
    motion, category = classification.motion, classification.periodic_model_name or solution.model_name
    std = estimate_joint_std(solution.joint_std * size, inferred, lifted_std, solution.noise * size)
    velocity = estimate_velocity(track, frame, model)
    return Person3D(
        id=track.id,
        joints=joints,
        std=std,
        inferred=inferred,
        scale=float(intrinsics.focal / root[2]),
        rotation=solution.rotation[frame],
        translation=intrinsics.project(root),
        motion=Motion(motion.kind, category, solution.residual, motion.cadence),
        residual=solution.frame_residual,
        scale_known=intrinsics.is_focal_known,
        predicted=False,
        tentative=track.is_tentative,
        velocity=velocity.joints,
        velocity_std=velocity.std,
        root_velocity_covariance=velocity.root_covariance,
        age=(track.seen.stamps_ns[frame] - track.first_ns) / NS_PER_S,
    )
