"""The 3D person of a track in one solved frame of its window."""

from __future__ import annotations

from dataclasses import replace

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.people import Person3D
from mocap_ros.tracking.track import Track


def make_person(track: Track, frame: int, model: BasePoses, camera: Intrinsics) -> Person3D:
    """Return the person of a track in one solved frame of its window.

    Args:
        track: the track.
        frame: index of the frame.
        model: base poses of the track's solution.
        camera: intrinsics of the real camera.
    """
    size = 1 / track.stature_ratio
    rotation, root = track.rotation[frame], track.roots[frame] * size
    inferred = track.corrected_weight[frame] == 0
    lifted_std = None if track.lifted is None else track.lifted.std[frame] * root[2]
    joints = model.poses(track.theta[frame]) @ rotation.T * size + root
    category = track.periodic_model_name or track.model_name
    return Person3D(
        id=track.id,
        joints=joints,
        std=estimate_joint_std(track.joint_std * size, inferred, lifted_std),
        inferred=inferred,
        scale=float(camera.focal / root[2]),
        rotation=rotation,
        translation=camera.project(root),
        motion=replace(track.motion, category=category, residual=track.residual),
        residual=track.frame_residual,
        scale_known=camera.is_focal_known,
        predicted=False,
    )
