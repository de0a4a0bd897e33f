"""mocap_ros_msgs/Skeleton3DArray and SkeletonDefinition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.messages.cameras import _new_camera
from mocap_ros.messages.cdr import OWN, Header, encode, new, new_header, new_points
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15, Skeleton

SKELETONS = OWN + 'Skeleton3DArray'


SKELETON_DEFINITION = OWN + 'SkeletonDefinition'


def encode_skeletons(header: Header, people: Sequence[Person3D]) -> bytes:
    """A Skeleton3DArray."""
    message = new(SKELETONS, header=new_header(header), people=[_new_skeleton(p) for p in people])
    return encode(message, SKELETONS)


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """A SkeletonDefinition."""
    message = new(
        SKELETON_DEFINITION,
        name=skeleton.name,
        joint_names=list(skeleton.joints),
        parents=np.array(skeleton.parents, np.int32),
        bones=np.array(skeleton.bones, np.uint32).ravel(),
    )
    return encode(message, SKELETON_DEFINITION)


def _new_skeleton(person: Person3D) -> Any:
    motion = new(
        OWN + 'MotionState',
        state=int(person.motion.kind),
        category=person.motion.category,
        residual=person.motion.residual,
        cadence=person.motion.cadence,
    )
    return new(
        OWN + 'Skeleton3D',
        id=person.id,
        skeleton=CMU15.name,
        joints=new_points(person.joints),
        joint_std=person.std.astype(np.float32),
        inferred=np.asarray(person.inferred, np.bool_),
        camera=_new_camera(person),
        motion=motion,
        reprojection_residual=person.residual,
        scale_source=int(person.scale_known),
        predicted=person.predicted,
    )
