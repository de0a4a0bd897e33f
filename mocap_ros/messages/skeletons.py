"""mocap_ros_msgs/Skeleton3DArray and SkeletonDefinition: the people in 3D, and the names of their joints."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cameras import compute_camera_numbers
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, CdrWriter, Header, create_message, decode, encode
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.skeleton import Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'

# Fields of Skeleton3D from motion.residual on: it, motion.cadence, reprojection_residual, scale_source, predicted
# and tentative.
_IMAGE_FIELDS = struct.Struct('<fffB??')
_ROOT_NUMBERS = 3 + 9 + 3 + 9  # numbers of root, root_covariance, root_velocity and root_velocity_covariance
_TIMES = struct.Struct('<ff')  # age, unseen_for
_VERTICAL_STD = struct.Struct('<f')
_POSE = struct.Struct('<7d')  # Skeleton3DArray.camera_pose: position and quaternion


def encode_skeletons(
    header: Header,
    people: Sequence[Person3D],
    vertical: CameraVertical | None = None,
    camera: CameraPlacement | None = None,
) -> bytes:
    """Encode all people in an image as a Skeleton3DArray.

    Args:
        header: time of the image, and the frame in which the people and the vertical are.
        people: all people in the image.
        vertical: what is known of the camera's vertical; None if nothing is.
        camera: the camera in that frame; None where the frame is the camera's.
    """
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(people))
    for person, image_camera in zip(people, compute_camera_numbers(people), strict=True):
        motion = person.motion
        writer.add_text(person.id)
        writer.add_text(person.skeleton.name)
        writer.add_sequence(np.asarray(person.joints, np.float64))
        writer.add_sequence(person.std.astype(np.float32))
        writer.add_sequence(np.asarray(person.inferred, np.bool_))
        writer.add(8, image_camera.tobytes())
        writer.add(1, bytes([motion.kind]))
        writer.add_text(motion.category)
        numbers = motion.residual, motion.cadence, person.residual
        writer.add(4, _IMAGE_FIELDS.pack(*numbers, person.scale_known, person.predicted, person.tentative))
        writer.add_sequence(np.asarray(person.velocity, np.float64))
        writer.add_sequence(person.velocity_std.astype(np.float32))
        root = np.empty(_ROOT_NUMBERS)
        root[:3], root[3:12] = person.root, person.root_covariance.ravel()
        root[12:15], root[15:] = person.root_velocity, person.root_velocity_covariance.ravel()
        writer.add(8, root.tobytes())
        writer.add(4, _TIMES.pack(person.age, person.unseen_for))
        writer.add_sequence(np.asarray(person.orientation, np.float64))
        writer.add_sequence(np.asarray(person.turn_inferred, np.bool_))
    direction, std = (np.zeros(3), math.nan) if vertical is None else vertical
    writer.add(8, np.asarray(direction, np.float64).tobytes())
    writer.add(4, _VERTICAL_STD.pack(std))
    placement = camera or CameraPlacement(header.frame_id)
    writer.add_text(placement.frame_id)
    pose = placement.pose
    pose_numbers = SAME_POSE if pose is None else (*pose.translation.tolist(), *pose.quaternion)
    writer.add(8, _POSE.pack(*pose_numbers))
    return writer.finish()


def decode_skeletons(raw: bytes) -> Any:
    """Decode a Skeleton3DArray, with joints and root covariances in the camera's optical frame whatever its own.

    Other fields, such as velocities and orientations, stay as they are.

    Args:
        raw: CDR bytes.

    Raises:
        InputError: the bytes are no Skeleton3DArray, or its camera pose is not valid.
    """
    array = decode(raw, SKELETONS)
    position, orientation = array.camera_pose.position, array.camera_pose.orientation
    numbers = (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)
    if numbers == SAME_POSE or not any(numbers[3:]):  # version 0.1 recorded no pose, which is converted to zeros
        return array
    try:
        to_optical_frame = RigidTransform.from_numbers(numbers).inverse()
    except InputError as error:
        raise InputError(f'camera_pose: {error}') from None
    for skeleton in array.people:
        joints = to_optical_frame.apply(np.array([(p.x, p.y, p.z) for p in skeleton.joints]).reshape(-1, 3))
        for point, (x, y, z) in zip(skeleton.joints, joints.tolist(), strict=True):
            point.x, point.y, point.z = x, y, z
        covariance = to_optical_frame.rotate_covariance(skeleton.root_covariance.reshape(3, 3))
        skeleton.root_covariance = covariance.ravel()
    return array


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
