"""The 3D person of a track in one solved frame of its window."""

from __future__ import annotations

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.people import Motion, Person3D
from mocap_ros.tracking.track import Track


def make_person(track: Track, frame: int, model: BasePoses) -> Person3D:
    """Return the person of a track in one solved frame of its window.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    solution, observed, classification = track.solved, track.seen.observed, track.schedule.classification
    intrinsics, lifted = track.seen.intrinsics, observed.lifted
    size = 1 / solution.stature_ratio
    rotation, root = solution.rotation[frame], solution.roots[frame] * size
    inferred = observed.weight[frame] == 0
    lifted_std = None if lifted is None else lifted.std[frame] * root[2]
    joints = model.poses(solution.theta[frame]) @ rotation.T * size + root
    motion, category = classification.motion, classification.periodic_model_name or solution.model_name
    return Person3D(
        id=track.id,
        joints=joints,
        std=estimate_joint_std(solution.joint_std * size, inferred, lifted_std),
        inferred=inferred,
        scale=float(intrinsics.focal / root[2]),
        rotation=rotation,
        translation=intrinsics.project(root),
        motion=Motion(motion.kind, category, solution.residual, motion.cadence),
        residual=solution.frame_residual,
        scale_known=intrinsics.is_focal_known,
        predicted=False,
    )
