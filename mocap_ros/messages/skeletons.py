"""mocap_ros_msgs/Skeleton3DArray and SkeletonDefinition: the people in 3D, and the names of their joints."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cameras import compute_camera_numbers
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, CdrWriter, Header, create_message, encode
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15, Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'

# Fields of Skeleton3D from motion.residual on: it, motion.cadence, reprojection_residual, scale_source, predicted
# and tentative.
_LAST_FIELDS = struct.Struct('<fffB??')


def encode_skeletons(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode all people in an image as a Skeleton3DArray."""
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(people))
    for person, camera in zip(people, compute_camera_numbers(people), strict=True):
        motion = person.motion
        writer.add_text(person.id)
        writer.add_text(CMU15.name)
        writer.add_sequence(np.asarray(person.joints, np.float64))
        writer.add_sequence(person.std.astype(np.float32))
        writer.add_sequence(np.asarray(person.inferred, np.bool_))
        writer.add(8, camera.tobytes())
        writer.add(1, bytes([motion.kind]))
        writer.add_text(motion.category)
        numbers = motion.residual, motion.cadence, person.residual
        writer.add(4, _LAST_FIELDS.pack(*numbers, person.scale_known, person.predicted, person.tentative))
    return writer.finish()


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
