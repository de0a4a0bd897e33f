"""mocap_ros_msgs/Skeleton3DArray and SkeletonDefinition: the people in 3D, and the names of their joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.messages.cameras import create_camera
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, create_header, create_message, create_points, encode
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15, Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'


def encode_skeletons(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode all people in an image as a Skeleton3DArray."""
    message = create_message(SKELETONS, header=create_header(header), people=[_create_skeleton(p) for p in people])
    return encode(message, SKELETONS)


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """Encode the names and the tree of a skeleton's joints as a SkeletonDefinition."""
    message = create_message(
        SKELETON_DEFINITION,
        name=skeleton.name,
        joint_names=list(skeleton.joints),
        parents=np.array(skeleton.parents, np.int32),
        bones=np.array(skeleton.bones, np.uint32).ravel(),
    )
    return encode(message, SKELETON_DEFINITION)


def _create_skeleton(person: Person3D) -> Any:
    motion = create_message(
        MOCAP_ROS_MSGS + 'MotionState',
        state=int(person.motion.kind),
        category=person.motion.category,
        residual=person.motion.residual,
        cadence=person.motion.cadence,
    )
    return create_message(
        MOCAP_ROS_MSGS + 'Skeleton3D',
        id=person.id,
        skeleton=CMU15.name,
        joints=create_points(person.joints),
        joint_std=person.std.astype(np.float32),
        inferred=np.asarray(person.inferred, np.bool_),
        camera=create_camera(person),
        motion=motion,
        reprojection_residual=person.residual,
        scale_source=int(person.scale_known),
        predicted=person.predicted,
    )
