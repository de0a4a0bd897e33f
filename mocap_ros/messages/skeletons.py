# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Skeleton3DArray, SkeletonDefinition and WeakPerspectiveCameraArray: the people in 3D.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import (
    BYTE,
    MOCAP_ROS_MSGS,
    SINGLE,
    Array,
    CdrWriter,
    Header,
    create_message,
    decode,
    encode,
)
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.skeleton import Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'
CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'


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
    writer, placement = CdrWriter(), camera or CameraPlacement(header.frame_id)
    writer.add_header(header)
    writer.add_count(len(people))
    for person in people:
        _add_person(writer, person)
    direction, std = (np.zeros(3), math.nan) if vertical is None else vertical
    writer.add_numbers(direction)
    writer.add_numbers(std, SINGLE)
    writer.add_text(placement.frame_id)
    pose = placement.pose
    writer.add_numbers(SAME_POSE if pose is None else (*pose.translation, *pose.quaternion))
    return writer.finish()


def _add_person(writer: CdrWriter, person: Person3D) -> None:
    """Append a Skeleton3D."""
    motion = person.motion
    writer.add_text(person.id)
    writer.add_text(person.skeleton.name)
    writer.add_sequence(person.joints)
    writer.add_sequence(person.std, SINGLE)
    writer.add_sequence(person.inferred, BYTE)
    writer.add_numbers(_compute_camera(person))
    writer.add_numbers(motion.kind, BYTE)
    writer.add_text(motion.category)
    writer.add_numbers((motion.residual, motion.cadence, person.residual), SINGLE)
    writer.add_numbers((person.scale_known, person.predicted, person.tentative), BYTE)
    writer.add_sequence(person.velocity)
    writer.add_sequence(person.velocity_std, SINGLE)
    for numbers in (person.root, person.root_covariance, person.root_velocity, person.root_velocity_covariance):
        writer.add_numbers(numbers)
    writer.add_numbers((person.age, person.unseen_for), SINGLE)
    writer.add_sequence(person.orientation)
    writer.add_sequence(person.turn_inferred, BYTE)


def _compute_camera(person: Person3D) -> Array:
    """Return the fields of a WeakPerspectiveCamera (15,): scale, quaternion x, y, z, w, translation and matrix."""
    matrix = np.column_stack([person.scale * person.rotation[:2], person.translation])
    quaternion = quaternion_from_rotation(person.rotation)
    return np.array([person.scale, *quaternion, *person.translation, *matrix.ravel()])


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the cameras of all people in an image as a WeakPerspectiveCameraArray."""
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(people))
    for person in people:
        writer.add_text(person.id)
    writer.add_sequence([_compute_camera(person) for person in people])
    return writer.finish()


def decode_skeletons(raw: bytes) -> Any:
    """Decode a Skeleton3DArray, with joints, root covariances and vertical in the camera's optical frame.

    Other fields, such as velocities and orientations, stay as they are.

    Args:
        raw: CDR bytes.

    Raises:
        InputError: the bytes are no Skeleton3DArray, or its camera pose is not valid.
    """
    array = decode(raw, SKELETONS)
    position, orientation = array.camera_pose.position, array.camera_pose.orientation
    numbers = (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)
    if numbers == SAME_POSE:
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
    up = array.vertical
    up.x, up.y, up.z = to_optical_frame.rotate(np.array([up.x, up.y, up.z])).tolist()
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
