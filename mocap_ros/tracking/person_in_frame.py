# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The 3D person of a track in one solved frame of its window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.people import Motion, Person3D
from mocap_ros.tracking.core_motion import find_published_motion
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]


def make_person(track: Track, frame: int, model: BasePoses) -> Person3D:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter.

    `body_size.resize` gives the person the size that is known, and with it the covariance of the root.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    solution, classification, intrinsics = track.solved, track.schedule.classification, track.seen.intrinsics
    found = find_published_motion(track, frame, model)
    motion, category = classification.motion, classification.periodic_model_name or solution.model_name
    return Person3D(
        id=track.id,
        joints=found.joints,
        std=find_joint_std(track, frame, found.root),
        inferred=_find_inferred(track, frame),
        scale=float(intrinsics.focal / found.root[2]),
        rotation=solution.rotation[frame].copy(),  # the caller may change it
        translation=intrinsics.project(found.root),
        motion=Motion(motion.kind, category, solution.residual, motion.cadence),
        residual=float(solution.frame_residuals[frame]),
        scale_known=intrinsics.is_focal_known,
        predicted=False,
        tentative=track.is_tentative,
        velocity=found.velocity,
        velocity_std=found.velocity_std,
        root_velocity_covariance=found.root_velocity_covariance,
        age=(track.seen.stamps_ns[frame] - track.first_ns) / NS_PER_S,
    )


def find_joint_std(track: Track, frame: int, root: Array) -> Array:
    """Return the standard deviations (J,) m of the joints of a person of the assumed size in one solved frame.

    Args:
        track: a solved track.
        frame: index of the frame.
        root: (3,) m, origin of the person's body.
    """
    solution, observed = track.solved, track.seen.observed
    return estimate_joint_std(
        solution.joint_std,
        _find_inferred(track, frame),
        None if observed.lifted is None else observed.lifted.std[frame],
        solution.noise,
        size=1 / solution.stature_ratio,
        depth=float(observed.virtual_camera.measure_depth(root[None])[0]),
    )


def _find_inferred(track: Track, frame: int) -> NDArray[np.bool_]:
    """Return a mask (J,) of the joints that are not seen in a frame."""
    return np.asarray(track.seen.observed.weight[frame] == 0)
